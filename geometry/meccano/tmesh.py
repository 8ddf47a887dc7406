r"""T-meshes: an octree (quadtree, in the plane) in every block of a meccano.

The paper's rule (section 3.1): a cell is split while its *open interior* contains a node of the tetrahedral mesh. A
node lies inside a cell of size 2^-l exactly if none of its coordinates is a multiple of that size, and then it also
lies inside all larger cells around it; so the cells to split at each level are simply those around such nodes.

Cells are known by keys (`morton`). Leaf cells are kept in the order of the keys of their lowest corner on the finest
level, so a point is found by one binary search.

Two conditions may be asked of a mesh beyond the nodes; both only ever split more cells, and one sweep from the finest
level to the coarsest establishes them:

    equal levels   the cells on the two sides of a side shared by two blocks are the same;
    grading g      around a split cell of level l all cells within g cells of that size are of level >= l.

g = 1 is the usual 2:1 balance. g = p makes the hierarchical splines of degree p admissible of class 2: at most two
levels of truncated functions act on any cell (Buffa and Giannelli, "Adaptive isogeometric methods with hierarchical
splines", M3AS 26, 2016, section 3).

Axis letters: c cell, d dimension, k block, f side, m key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.meccano.morton import ancestors, key_of, place_of
from geometry.meccano.parametrisation import LEVELS
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DEPTH = 15
"""Finest level of a cell: keys of three dimensions and 2^17 blocks fit 63 bits."""


@dataclass(frozen=True, eq=False)
class TMesh:
    """Leaf cells of the octrees of all blocks; make it with `uniform`, `octree` or `refined`.

    Attributes
    ----------
    blocks : the meccano.
    block : (c,) block of each cell, ascending.
    level : (c,) level l; the cell's size is 2^-l.
    corner : (c, d) lowest corner in the block, integers over 2^LEVELS.
    grading : the g of the module docstring, kept by `refined`; 0 for none.
    """

    blocks: Blocks
    block: Index
    level: Index
    corner: Index
    grading: int = 0

    @property
    def dim(self) -> int:
        """Dimension d."""
        return self.blocks.dim

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.block)

    @property
    def size(self) -> Index:
        """Edge length of each cell in units of 2^-LEVELS, (c,)."""
        return np.left_shift(1, LEVELS - self.level)

    @cached_property
    def key(self) -> Index:
        """Key of each cell among those of its own level, (c,)."""
        return key_of(self.block, self.corner >> (LEVELS - self.level)[:, None], self.level)

    @cached_property
    def code(self) -> Index:
        """Key of each cell's lowest corner on level DEPTH, (c,), ascending."""
        return np.left_shift(self.key, self.dim * (DEPTH - self.level))

    @cached_property
    def split(self) -> tuple[Index, ...]:
        """Keys of the split cells of each level, ascending."""
        return tuple(ancestors(self.key, self.level, self.dim))

    @cached_property
    def tree(self) -> tuple[Nodes, ...]:
        """All cells of the trees, level by level."""
        made = []
        offset = np.arange(2**self.dim)
        keys = np.arange(len(self.blocks.corners), dtype=np.int64)
        for level in range(int(self.level.max(initial=0)) + 1):
            own = np.flatnonzero(self.level == level)
            leaf = np.full(len(keys), -1, dtype=np.int64)
            leaf[np.searchsorted(keys, self.key[own])] = own
            made.append(Nodes(level, keys, *place_of(keys, level, self.dim), leaf))
            keys = ((keys[leaf < 0] << self.dim)[:, None] + offset).ravel()
        return tuple(made)


@dataclass(frozen=True, eq=False)
class Nodes:
    """All cells of one level, split or not.

    Attributes
    ----------
    level : l.
    key : (m,) ascending.
    block, place : (m,) and (m, d), place in units of 2^-l.
    leaf : (m,) number of the leaf cell, or -1 for a split cell.
    """

    level: int
    key: Index
    block: Index
    place: Index
    leaf: Index


def uniform(blocks: Blocks, level: int, grading: int = 0) -> TMesh:
    """T-mesh of (2^level)^d cells in every block."""
    _check_level(level)
    d = blocks.dim
    keys = np.arange(len(blocks.corners) << (d * level), dtype=np.int64)
    block, place = place_of(keys, level, d)
    return TMesh(blocks, block, np.full(len(keys), level, dtype=np.int64), place << (LEVELS - level), grading)


def octree(
    blocks: Blocks, block: Index, places: Index, grading: int = 0, equal: bool = True, least: int = 0,
    limit: int = 2_000_000,
) -> TMesh:
    """Split every cell whose open interior contains a node.

    Parameters
    ----------
    block, places : (n,) and (n, d), the nodes: integer coordinates over 2^LEVELS in their blocks.
    grading : g of the module docstring, 0 for none.
    equal : whether to make the cells equal on both sides of shared block sides.
    least : level that every cell has at least.
    limit : most cells.

    Raises
    ------
    InputError : nodes outside the blocks or finer than level DEPTH, or more than ``limit`` cells.
    """
    _check_level(least)
    d, full = blocks.dim, 1 << LEVELS
    places = np.asarray(places, dtype=np.int64).reshape(-1, d)
    outside = (places < 0) | (places > full)
    if outside.any():
        raise InputError(f"node {int(np.argwhere(outside)[0, 0])} lies outside its block")
    # A node is inside cells of level l as long as each coordinate needs more than l bits: those of its lowest set bit.
    bits = np.full(places.shape, -1, dtype=np.int64)
    inner = (places > 0) & (places < full)
    bits[inner] = LEVELS - np.round(np.log2(places[inner] & -places[inner])).astype(np.int64)
    depth = bits.min(axis=1, initial=LEVELS)
    if depth.max(initial=0) > DEPTH:
        raise InputError(f"node {int(depth.argmax())} needs cells of level {depth.max()}; the finest level is {DEPTH}")
    split = []
    for level in range(max(int(depth.max(initial=0)), least)):
        if level < least:
            split.append(np.arange(len(blocks.corners) << (d * level), dtype=np.int64))
        else:
            own = depth > level
            split.append(np.unique(key_of(block[own], places[own] >> (LEVELS - level), level)))
    return grown(blocks, split, grading, equal, limit)


def refined(
    tmesh: TMesh, cells: Index | None = None, equal: bool = True, reach: int = 0, limit: int = 2_000_000
) -> TMesh:
    """Split cells (all by default), and as many more as grading and equal levels on block sides need.

    Parameters
    ----------
    cells : numbers, or a boolean mask (c,).
    equal : whether to make the cells equal on both sides of shared block sides.
    reach : how many neighbours of the cell's size around each, in its block, are split as well.
    limit : most cells.

    Raises
    ------
    InputError : cells finer than level DEPTH would be needed, or more than ``limit`` cells.
    """
    mask = np.zeros(tmesh.cells, dtype=bool)
    mask[slice(None) if cells is None else cells] = True
    _check_level(int(tmesh.level[mask].max(initial=-1)) + 1)
    split = list(tmesh.split)
    for level in np.unique(tmesh.level[mask]).tolist():
        own = tmesh.key[mask & (tmesh.level == level)]
        if reach:
            own = _around(own, level, tmesh.dim, reach)
        if level == len(split):
            split.append(own)
        else:
            split[level] = np.union1d(split[level], own)
    return grown(tmesh.blocks, split, tmesh.grading, equal, limit)


def cells_at(tmesh: TMesh, block: Index, xi: Array) -> Index:
    """Leaf cells (q,) that contain points xi (q, d) of blocks (q,); on a common side the one of larger coordinates."""
    place = np.clip(np.floor(np.asarray(xi) * 2.0**DEPTH), 0, 2**DEPTH - 1).astype(np.int64)
    return cells_of(tmesh, block, place << (LEVELS - DEPTH))


def cells_of(tmesh: TMesh, block: Index, places: Index) -> Index:
    """Leaf cells (q,) that contain the integer points (q, d) over 2^LEVELS; a cell holds its lowest corner."""
    key = key_of(np.asarray(block), np.asarray(places) >> (LEVELS - DEPTH), DEPTH)
    return np.searchsorted(tmesh.code, key, side="right") - 1


def on_side(tmesh: TMesh, block: int, side: int) -> Index:
    """Leaf cells that touch a side of a block."""
    low, high = np.searchsorted(tmesh.block, [block, block + 1])
    d, end = divmod_side(tmesh.blocks, side)
    place = tmesh.corner[low:high, d]
    touches = place + tmesh.size[low:high] == 1 << LEVELS if end else place == 0
    return low + np.flatnonzero(touches)


def divmod_side(blocks: Blocks, side: int) -> tuple[int, int]:
    """Direction normal to a side, and 0 or 1 for its coordinate there."""
    corners = blocks.cell.vertices[list(blocks.cell.faces[side].vertices)]
    d = int(np.flatnonzero(np.ptp(corners, axis=0) == 0)[0])
    return d, int(corners[0, d])


def to_arrays(tmesh: TMesh) -> dict[str, NDArray[Any]]:
    """Plain arrays that `from_arrays` takes, to be saved with a domain."""
    return {
        "block_corners": tmesh.blocks.corners, "block_places": tmesh.blocks.places, "cell_block": tmesh.block,
        "cell_level": tmesh.level, "cell_corner": tmesh.corner, "cell_grading": np.array(tmesh.grading),
    }


def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> TMesh:
    """Undo `to_arrays`.

    Raises
    ------
    InputError : an array is missing, or the cells do not fill the blocks.
    """
    try:
        blocks = Blocks(arrays["block_corners"], arrays["block_places"])
        made = TMesh(
            blocks, arrays["cell_block"], arrays["cell_level"], arrays["cell_corner"], int(arrays["cell_grading"])
        )
    except KeyError as error:
        raise InputError(f"the domain does not hold the T-mesh it was built on ({error} is missing)") from None
    volume = np.bincount(made.block, 0.5 ** (made.dim * made.level), len(blocks.corners))
    if (np.diff(made.code) <= 0).any() or not (volume == 1.0).all():
        raise InputError("the cells of the stored T-mesh do not fill its blocks")
    return replace(made, grading=made.grading)


def transitions(blocks: Blocks) -> tuple[Index, Index]:
    """Affine maps xi' = A xi + t from a block to the coordinates of its neighbours, on their common sides.

    Returns
    -------
    A (k, f, d, d) with columns zero along the side's normal, t (k, f, d); zeros where a side is on the boundary.
    """
    cell, across, count = blocks.cell, blocks.across, len(blocks.corners)
    d = blocks.dim
    corners = cell.vertices.astype(np.int64)
    A = np.zeros((count, len(cell.faces), d, d), dtype=np.int64)
    t = np.zeros((count, len(cell.faces), d), dtype=np.int64)
    for f, face in enumerate(cell.faces):
        own = np.flatnonzero(across[:, f, 0] >= 0)
        there = blocks.corners[across[own, f, 0]]
        axes = face.axes.astype(np.int64)
        vertices = np.array(face.vertices)
        ends = [int(np.flatnonzero((face.cell.vertices == unit).all(axis=1))[0]) for unit in np.eye(face.cell.dim)]
        found = [
            corners[(there == blocks.corners[own, v][:, None]).argmax(axis=1)]
            for v in vertices[[0, *ends]].tolist()
        ]
        steps = np.stack([end - found[0] for end in found[1:]], axis=2)
        A[own, f] = steps @ axes.T
        t[own, f] = found[0] - A[own, f] @ face.origin.astype(np.int64)
    return A, t


# --- conditions -------------------------------------------------------------------------------------------------------


def grown(blocks: Blocks, split: list[Index], grading: int, equal: bool, limit: int) -> TMesh:
    """T-mesh with at least the given cells split, by level."""
    d = blocks.dim
    split = [np.asarray(keys, dtype=np.int64) for keys in split]
    A, t = transitions(blocks) if equal and len(blocks.corners) > 1 else (None, None)
    for level in range(len(split) - 1, -1, -1):
        if A is not None and t is not None:
            split[level] = _mirrored(blocks, A, t, split[level], level)
        if level:
            parents = split[level] >> d
            if grading:
                parents = np.concatenate([parents, _near(split[level], level, d, grading)])
            split[level - 1] = np.union1d(split[level - 1], parents)
    cells = len(blocks.corners) + (2**d - 1) * sum(map(len, split))
    if cells > limit:
        raise InputError(f"the T-mesh would have {cells} cells, more than the limit of {limit}; ask for less detail")
    offset = np.arange(2**d)
    nodes = np.arange(len(blocks.corners), dtype=np.int64)
    found: list[tuple[Index, Index, Index]] = []
    for level, own in enumerate([*split, np.empty(0, dtype=np.int64)]):
        leaf = nodes[~np.isin(nodes, own, assume_unique=True)]
        block, place = place_of(leaf, level, d)
        found.append((block, np.full(len(leaf), level, dtype=np.int64), place << (LEVELS - level)))
        nodes = ((own << d)[:, None] + offset).ravel()
    block, levels, corner = (np.concatenate(part) for part in zip(*found))
    order = np.argsort(key_of(block, corner >> (LEVELS - DEPTH), DEPTH))
    return TMesh(blocks, block[order], levels[order], corner[order], grading)


def _near(key: Index, level: int, d: int, g: int) -> Index:
    """Parents of the cells within g cells of the given ones in the same block."""
    block, place = place_of(key, level, d)
    low, high = np.maximum(place - g, 0) >> 1, np.minimum(place + g, (1 << level) - 1) >> 1
    return _boxes(block, low, high, level - 1, g + 1)


def _around(key: Index, level: int, d: int, reach: int) -> Index:
    """Cells within some cells of the given ones in the same block, themselves included."""
    block, place = place_of(key, level, d)
    last = (1 << level) - 1
    return _boxes(block, np.maximum(place - reach, 0), np.minimum(place + reach, last), level, 2 * reach + 1)


def _boxes(block: Index, low: Index, high: Index, level: int, width: int) -> Index:
    """Cells from low to high (m, d), which are at most ``width`` in each direction."""
    found = []
    for step in np.ndindex(*(width,) * low.shape[1]):  # a fixed number of steps, whatever the number of cells
        found.append(np.unique(key_of(block, np.minimum(low + np.array(step), high), level)))
    return np.unique(np.concatenate(found))


def _mirrored(blocks: Blocks, A: Index, t: Index, key: Index, level: int) -> Index:
    """Add the mirror images of cells across shared block sides until there are no new ones."""
    d, n = blocks.dim, 1 << level
    new = key
    while len(new):
        block, place = place_of(new, level, d)
        centre = 2 * place + 1
        images = []
        for f in range(len(blocks.cell.faces)):
            axis, end = divmod_side(blocks, f)
            there = blocks.across[block, f, 0]
            own = np.flatnonzero((place[:, axis] == (n - 1) * end) & (there >= 0))
            b = block[own]
            image = np.einsum("mij,mj->mi", A[b, f], centre[own]) + 2 * n * t[b, f]
            images.append(key_of(there[own], np.clip(image, 1, 2 * n - 1) >> 1, level))
        new = np.setdiff1d(np.concatenate(images), key)
        key = np.union1d(key, new)
    return key


def _check_level(level: int) -> None:
    if not 0 <= level <= DEPTH:
        raise InputError(f"cells of level {level} are not possible; levels run from 0 to {DEPTH}")
