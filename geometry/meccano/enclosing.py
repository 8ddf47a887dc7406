"""Octrees around polycubes: the T-mesh of a cube that contains the cells of all blocks of a polycube.

The paper extends T-splines to polycubes by an octree of an enclosing cube (section 4.3): its cells outside the solid
give knots, but no anchors.

Axis letters: c cell, k block, d dimension.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.meccano.morton import ancestors, key_of
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.tmesh import DEPTH, TMesh, grown
from iga.errors import InputError

Index = NDArray[np.int64]


def enclosing(tmesh: TMesh) -> tuple[TMesh, Index]:
    """Octree of a cube around a polycube of unit cubes on a grid, with the cells of all blocks among its own.

    Returns
    -------
    The T-mesh of one cube, and (c,) the block of its cells, -1 outside; for a cube, the mesh itself.

    Raises
    ------
    InputError : the blocks are not unit cubes on a grid, or their cells are too fine for one tree.
    """
    blocks, d = tmesh.blocks, tmesh.dim
    origin, axes, unit = frames_of(blocks)
    above = LEVELS - int(unit).bit_length() + 1
    # Lowest corners in the enclosing cube: where an axis runs backwards, the far end of the cell is the lower one.
    step = axes[tmesh.block]
    corner = np.einsum("ci,cij->cj", tmesh.corner, step) + (tmesh.size[:, None, None] * np.minimum(step, 0)).sum(axis=1)
    corner = (corner >> above) + origin[tmesh.block] * unit
    level = tmesh.level + above
    if int(level.max()) > DEPTH:
        raise InputError(f"cells of level {tmesh.level.max()} are too fine for one tree around all blocks")
    root = Blocks(np.arange(2**d, dtype=np.int64)[None], blocks.cell.vertices.copy())
    key = key_of(np.zeros(tmesh.cells, dtype=np.int64), corner >> (LEVELS - level)[:, None], level)
    made = grown(root, ancestors(key, level, d), 0, False, 2**62)
    owner = np.full(made.cells, -1, dtype=np.int64)
    owner[np.searchsorted(made.code, key << (d * (DEPTH - level)))] = tmesh.block
    return made, owner


def frames_of(blocks: Blocks) -> tuple[Index, Index, int]:
    """Lowest-corner frames of unit cubes on a grid: origin (k, d), axes (k, d, d) by rows, and the unit of the grid.

    A point xi of a block lies at (origin + xi @ axes) * unit, in units of 2^-LEVELS of the enclosing cube.

    Raises
    ------
    InputError : a block is no unit cube on the grid.
    """
    d = blocks.dim
    ends = np.vstack([np.zeros(d), np.eye(d)])
    first = (blocks.cell.vertices == ends[:, None]).all(axis=2).argmax(axis=1)
    corners = blocks.places[blocks.corners[:, first]]
    whole = np.round(corners).astype(np.int64)
    axes = whole[:, 1:] - whole[:, :1]
    square = (np.abs(axes).sum(axis=2) == 1).all(axis=1) & (np.abs(axes).sum(axis=1) == 1).all(axis=1)
    bad = np.flatnonzero(~square | (np.abs(whole - corners) > 1e-9).any(axis=(1, 2)))
    if len(bad):
        raise InputError(f"block {bad[0]} is no unit cube on a grid; T-splines need a cube or a polycube of such cubes")
    span = np.concatenate([whole[:, 0], whole[:, 0] + axes.sum(axis=1)])
    low = span.min(axis=0)
    width = int((span.max(axis=0) - low).max())
    return whole[:, 0] - low, axes, (1 << LEVELS) >> int(width - 1).bit_length()
