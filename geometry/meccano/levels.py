r"""Splines of one level of a hierarchy, glued across the sides of the meccano's blocks.

At level l every block carries tensor-product splines of degree p with open uniform knots on (2^l)^d cells. Functions of
index zero (or last) in a normal direction belong to the side, edge or corner of the block that they do not vanish on;
blocks that share that entity share them, by its canonical coordinates, in whatever way the blocks' axes lie.

Axis letters: m cell of the level, k block of the meccano, i spline on a cell, d dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.meccano.tmesh import Nodes
from iga.errors import InputError

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def offsets(degree: int, dim: int) -> Index:
    """Numbers ((p+1)^d, d) of the splines on a cell relative to its place, in the order of Bernstein functions."""
    return np.array(list(np.ndindex(*(degree + 1,) * dim)), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Entities:
    """Corners, edges, sides and insides of blocks, by block and code (0 free, 1 low, 2 high; direction 0 slowest).

    Attributes
    ----------
    number, copies : (k, 3^d) number of the entity, and how many blocks have it.
    order : (k, 3^d, d) directions in canonical order, pinned ones last.
    flip : (k, 3^d, d) whether each of those runs against the canonical sense.
    free : (3^d,) number of free directions.
    """

    number: Index
    copies: Index
    order: Index
    flip: Mask
    free: Index


def entities(blocks: Blocks) -> Entities:
    """Canonical coordinates: from the corner of least number, first along the edge to the lesser neighbour."""
    d, count = blocks.dim, len(blocks.corners)
    codes = np.array(list(np.ndindex(*(3,) * d)), dtype=np.int64)
    vertices = blocks.cell.vertices.astype(np.int64)
    names = np.full((count, len(codes), 2**d), -1, dtype=np.int64)
    order = np.tile(np.arange(d), (count, len(codes), 1))
    flip = np.zeros((count, len(codes), d), dtype=bool)
    for number, code in enumerate(codes):
        free, pinned = np.flatnonzero(code == 0), np.flatnonzero(code)
        own = np.flatnonzero((vertices[:, pinned] == code[pinned] - 1).all(axis=1))
        corners = blocks.corners[:, own]
        names[:, number, : len(own)] = np.sort(corners, axis=1)
        if not len(pinned) or not len(free):
            continue
        origin = vertices[own[corners.argmin(axis=1)]]
        ends = np.empty((count, len(free)), dtype=np.int64)
        for a, axis in enumerate(free.tolist()):
            end = origin.copy()
            end[:, axis] ^= 1
            place = (vertices[None] == end[:, None]).all(axis=2).argmax(axis=1)
            ends[:, a] = blocks.corners[np.arange(count), place]
        ranked = free[np.argsort(ends, axis=1)]
        order[:, number] = np.column_stack([ranked, np.tile(pinned, (count, 1))])
        flip[:, number, : len(free)] = np.take_along_axis(origin, ranked, axis=1) == 1
    _, inverse, copies = np.unique(names.reshape(-1, 2**d), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(count, len(codes))
    return Entities(inverse, copies[inverse], order, flip, (codes == 0).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Level:
    """Splines of one level on the cells of that level.

    Attributes
    ----------
    nodes : the cells.
    spline : (m, i) number of the spline among those of the level.
    inside : (m, i) whether the spline's support lies in Omega_l.
    number : (m, i) number of the active function, or -1.
    home, index : of the active functions, as in `Hierarchy`.
    """

    nodes: Nodes
    spline: Index
    inside: Mask
    number: Index
    home: Index
    index: Index


def level_of(nodes: Nodes, blocks: Blocks, glue: Entities, p: int, start: int) -> Level:
    """The splines of one level; active functions are numbered from ``start``.

    Raises
    ------
    InputError : more functions than keys can name.
    """
    local = offsets(p, blocks.dim)
    key, support = _keys(nodes, blocks, glue, p)
    _, first, inverse, found = np.unique(key.ravel(), return_index=True, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(key.shape)
    inside = found == support.ravel()[first]
    leaves = np.flatnonzero(nodes.leaf >= 0)
    touched = np.zeros(len(found), dtype=bool)
    touched[inverse[leaves].ravel()] = True
    active = np.flatnonzero(inside & touched)
    number = np.full(len(found), -1, dtype=np.int64)
    number[active] = start + np.arange(len(active))
    numbers = number[inverse]
    # Home: of all leaf cells of a function, one in which it is a middle spline.
    row, i = np.nonzero(numbers[leaves] >= 0)
    distance = np.abs(2 * local - p).sum(axis=1)
    owner = numbers[leaves[row], i] - start
    best = np.lexsort((row, distance[i], owner))
    best = best[np.flatnonzero(np.diff(owner[best], prepend=-1))]
    home = nodes.leaf[leaves[row[best]]]
    return Level(nodes, inverse, inside[inverse], numbers, home, nodes.place[leaves[row[best]]] + local[i[best]])


def _keys(nodes: Nodes, blocks: Blocks, glue: Entities, p: int) -> tuple[Index, Index]:
    """Keys of glued splines (m, i), and the number of cells in their supports (m, i)."""
    d, n, intervals = blocks.dim, (1 << nodes.level) + p, 1 << nodes.level
    if int(glue.number.max(initial=0) + 1) * n**d >= 2**63:
        raise InputError(f"splines of level {nodes.level} on {len(blocks.corners)} blocks are too many to number")
    index = nodes.place[:, None] + offsets(p, d)
    spans = np.minimum(index, intervals - 1) - np.maximum(index - p, 0) + 1
    support = spans.prod(axis=2)
    code = np.zeros(index.shape[:2], dtype=np.int64)
    for axis in range(d):
        code = 3 * code + (index[..., axis] == 0) + 2 * (index[..., axis] == n - 1)
    key = np.broadcast_to(glue.number[nodes.block, 0][:, None], code.shape).copy()
    for axis in range(d):
        key = key * n + index[..., axis]
    m, i = np.nonzero(code)
    block, code = nodes.block[m], code[m, i]
    own = index[m, i]
    pinned = glue.number[block, code]
    for axis in range(d):
        value = own[np.arange(len(own)), glue.order[block, code, axis]]
        value = np.where(glue.flip[block, code, axis], n - 1 - value, value)
        pinned = pinned * n + np.where(axis < glue.free[code], value, 0)
    key[m, i] = pinned
    support[m, i] *= glue.copies[block, code]
    return key, support


def parents_of(levels: Sequence[Level], level: int) -> Index:
    """Cells of the level above that those of a level (m,) are parts of; none for the first."""
    if not level:
        return np.empty(0, dtype=np.int64)
    nodes = levels[level].nodes
    return np.searchsorted(levels[level - 1].nodes.key, nodes.key >> nodes.place.shape[1])
