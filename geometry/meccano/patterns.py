r"""Elements of truncated hierarchical splines, each with the functions that act on it, for assembly.

On a cell of level l all functions are combinations M of the (p+1)^d splines of level l there. From a cell to its half,

    M <- [ M R with the columns of inside functions set to zero ; one unit row for each active function ],

and at a leaf C = M E with R, E Kronecker products of the tables in `splines`. Cells that see only functions of their
own level are stored as Kronecker factors; the others share dense patterns, found by what M depends on.

Leaf cell c of the T-mesh becomes element ``element[c, 1]`` of block ``element[c, 0]`` of the space, with the reference
coordinates of the cell, xi = (corner + size * local), so its faces are numbered as the sides of its block. Block 0
holds the cells with factors, the others follow by number of functions; cells ascend in each.

Axis letters: c leaf cell, m cell of one level, i spline on a cell, r row, d dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.distinct import distinct
from geometry.meccano.levels import Level, parents_of
from geometry.meccano.splines import bezier_table, refinement_table, window
from geometry.meccano.tmesh import TMesh
from iga.bernstein import LocalBasis, bernstein
from iga.block import Block, Kronecker, Patterns
from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_BATCH = 256


@dataclass(frozen=True, eq=False)
class _States:
    """Distinct matrices M of the split cells of a level, rows of one after those of the other.

    Attributes
    ----------
    of : (m,) number of each cell's matrix; -1 at leaves.
    start : (states + 1,) rows of matrix s are start[s]:start[s + 1].
    rows : (r, i).
    level, local : (r,) level of each row's function, and its number among the splines on the ancestor of that level.
    """

    of: Index
    start: Index
    rows: Array
    level: Index
    local: Index


@dataclass(frozen=True, eq=False)
class _Leaves:
    """Leaf cells of a level and their dense patterns, rows ragged as in `_States`; -1 is a cell with factors."""

    node: Index
    pattern: Index
    start: Index
    rows: Array
    level: Index
    local: Index


def elements_of(tmesh: TMesh, levels: Sequence[Level], p: int, count: int) -> tuple[Space, Index]:
    """The space of ``count`` functions on elements, and (c, 2) block and element of each leaf cell."""
    basis = bernstein(tmesh.blocks.cell, p)
    parents: list[Index] = []
    states: _States | None = None
    leaves: list[_Leaves] = []
    for l, own in enumerate(levels):
        above = parents_of(levels, l)
        parents.append(above)
        states, found = _descend(own, states, above, p)
        leaves.append(found)
    element = np.empty((tmesh.cells, 2), dtype=np.int64)
    blocks = [_regular(levels, leaves, p, element, tmesh)]
    if not blocks[0].elements:
        blocks = []
    for size in np.unique(np.concatenate([np.diff(own.start) for own in leaves])).tolist():
        blocks.append(_irregular(levels, leaves, parents, size, len(blocks), element, basis))
    return Space(tuple(blocks), count), element


def _descend(own: Level, above: _States | None, parent: Index, p: int) -> tuple[_States, _Leaves]:
    """Matrices of one level from those of the level above."""
    nodes = own.nodes
    full = own.inside.all(axis=1)
    active = own.number >= 0
    leaf = nodes.leaf >= 0
    before = above.of[parent] if above is not None else np.full(len(nodes.key), -1, dtype=np.int64)
    left, right = window(nodes.place >> 1, max(nodes.level - 1, 0), p)
    kind = ((left * p + right) * 2 + (nodes.place & 1)).astype(np.uint8)
    # Where all splines are inside, nothing comes from above.
    before = np.where(full, -1, before)
    kind[full] = 0
    signs = np.column_stack([
        before.astype(np.int32).view(np.uint8).reshape(-1, 4), kind, np.packbits(own.inside, axis=1),
        np.packbits(active, axis=1),
    ])
    of, first = _distinct(signs, ~leaf)
    made = _States(of, *_matrices(own, above, before, first, p, at_leaf=False))
    pattern, first = _distinct(signs, leaf & ~full)
    where = np.flatnonzero(leaf)
    return made, _Leaves(where, pattern[where], *_matrices(own, above, before, first, p, at_leaf=True))


def _distinct(rows: NDArray[np.uint8], chosen: Mask) -> tuple[Index, Index]:
    """Number of each chosen row among the distinct ones (-1 elsewhere), and the first place of each."""
    number = np.full(len(rows), -1, dtype=np.int64)
    where = np.flatnonzero(chosen)
    first, number[where] = distinct(rows[where])
    return number, where[first]


def _matrices(
    own: Level, above: _States | None, before: Index, cells: Index, p: int, at_leaf: bool
) -> tuple[Index, Array, Index, Index]:
    """Matrices M of cells, or C = M E at leaves: start, rows, level and local as in `_States`."""
    nodes = own.nodes
    d, size = nodes.place.shape[1], (p + 1) ** nodes.place.shape[1]
    counts, rows, levels, locals_ = [np.zeros(1, dtype=np.int64)], [], [], []
    for begin in range(0, len(cells), _BATCH):
        some = cells[begin : begin + _BATCH]
        inside, active, place = own.inside[some], own.number[some] >= 0, nodes.place[some]
        s, i = np.nonzero(active)
        lines = [np.eye(size)[i]] if not at_leaf else []
        E = bezier_table(p)[window(place, nodes.level, p)] if at_leaf else None  # (m, d, p+1, p+1)
        if E is not None:
            whole = E[:, 0]
            for axis in range(1, d):
                whole = np.einsum("mij,mkl->mikjl", whole, E[:, axis]).reshape(len(some), whole.shape[1] * (p + 1), -1)
            lines = [whole[s, i]]
        owner, level, local = [s], [np.full(len(s), nodes.level)], [i]
        up = before[some]
        lower = np.flatnonzero(up >= 0)
        if above is not None and len(lower):
            first, length = above.start[up[lower]], np.diff(above.start)[up[lower]]
            r = np.arange(int(length.max()))
            there = r < length[:, None]
            source = np.where(there, first[:, None] + r, 0)
            M = np.where(there[..., None], above.rows[source], 0.0)
            left, right = window(place[lower] >> 1, nodes.level - 1, p)
            R = refinement_table(p)[left, right, place[lower] & 1]
            M = _along_axes(M, R) * ~inside[lower][:, None]
            s, r = np.nonzero(M.any(axis=2))
            if E is not None:
                M = _along_axes(M, E[lower])
            lines.insert(0, M[s, r])
            owner.insert(0, lower[s])
            level.insert(0, above.level[source[s, r]])
            local.insert(0, above.local[source[s, r]])
        owners = np.concatenate(owner)
        order = np.argsort(owners, kind="stable")
        counts.append(np.bincount(owners, minlength=len(some)))
        rows.append(np.concatenate(lines)[order])
        levels.append(np.concatenate(level)[order])
        locals_.append(np.concatenate(local)[order])
    start = np.cumsum(np.concatenate(counts))
    if not rows:
        return start, np.empty((0, size)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return start, np.concatenate(rows), np.concatenate(levels), np.concatenate(locals_)


def _along_axes(M: Array, factors: Array) -> Array:
    """Rows M (m, r, i) times the Kronecker product of factors (m, d, p+1, p+1)."""
    m, r, size = M.shape
    n = factors.shape[2]
    grid = M
    for axis in range(factors.shape[1] - 1, -1, -1):
        grid = grid.reshape(m, r, -1, n) @ factors[:, axis, None]
        grid = np.moveaxis(grid, -1, 2)  # the next axis comes last; after all, the order is the first one again
    return np.ascontiguousarray(grid).reshape(m, r, size)


def _regular(levels: Sequence[Level], leaves: list[_Leaves], p: int, element: Index, tmesh: TMesh) -> Block:
    """Block 0: cells whose functions are the tensor-product splines of their own level."""
    d = tmesh.dim
    cells, dofs, kinds = [], [], []
    for own, found in zip(levels, leaves):
        node = found.node[found.pattern < 0]
        cells.append(own.nodes.leaf[node])
        dofs.append(own.number[node])
        left, right = window(own.nodes.place[node], own.nodes.level, p)
        kinds.append(left * p + right)
    cell = np.concatenate(cells)
    order = np.argsort(cell)
    element[cell[order]] = np.column_stack([np.zeros(len(cell), dtype=np.int64), np.arange(len(cell))])
    E = bezier_table(p).reshape(p * p, p + 1, p + 1)
    extraction = Kronecker((E,) * d, np.ascontiguousarray(np.concatenate(kinds)[order]))
    return Block(bernstein(tmesh.blocks.cell, p), np.concatenate(dofs)[order], extraction)


def _irregular(
    levels: Sequence[Level], leaves: list[_Leaves], parents: list[Index], size: int, number: int, element: Index,
    basis: LocalBasis,
) -> Block:
    """Block of the cells with dense patterns on which ``size`` functions act."""
    cells, dofs, patterns, operators, known = [], [], [], [], 0
    for l, (own, found) in enumerate(zip(levels, leaves)):
        chosen = np.flatnonzero(np.diff(found.start) == size)
        if not len(chosen):
            continue
        new = np.full(len(found.start), -1, dtype=np.int64)
        new[chosen] = known + np.arange(len(chosen))
        row = found.start[chosen][:, None] + np.arange(size)
        operators.append(found.rows[row])
        mine = np.flatnonzero(new[found.pattern] >= 0)  # pattern -1 reads the last entry, which is never chosen
        node = found.node[mine]
        which = new[found.pattern[mine]]
        line = row[which - known]
        level, local = found.level[line], found.local[line]
        dof = np.empty((len(mine), size), dtype=np.int64)
        at = node
        for k in range(l, -1, -1):
            e, r = np.nonzero(level == k)
            dof[e, r] = levels[k].number[at[e], local[e, r]]
            at = parents[k][at] if k else at
        cells.append(own.nodes.leaf[node])
        dofs.append(dof)
        patterns.append(which)
        known += len(chosen)
    cell = np.concatenate(cells)
    order = np.argsort(cell)
    element[cell[order], 0] = number
    element[cell[order], 1] = np.arange(len(cell))
    C = np.concatenate(operators)
    shown, kind = distinct(C.reshape(len(C), -1))  # levels that look alike share patterns
    return Block(basis, np.concatenate(dofs)[order], Patterns(C[shown], kind[np.concatenate(patterns)[order]]))
