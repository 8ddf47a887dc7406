r"""Exact values and derivatives of the limit functions at any point of any cell.

A point of an irregular cell is followed into its child, level by level, until the cell that holds it is regular; there
the functions are tricubic. Level k multiplies derivatives by 2^k. A point at parameter distance d from the
extraordinary edge or vertex needs about log2(1/d) levels: the first few are taken one by one (rings), all further ones
at once by powers of the local subdivision matrix (`powers`), so that no distance is too small and no tolerance is
needed. On an extraordinary edge or vertex itself the values are those of the limit masks; derivatives across it do not
exist in general and are not a number, derivatives along a straight product edge are exact.

Axis letters: p point, v vertex, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows
from geometry.catmull_clark.neighbourhood import neighbourhoods
from geometry.catmull_clark.pieces import local_topology, refine_locally
from geometry.catmull_clark.powers import ORDERS, RINGS, Node, nodes_of, rows_at, tables
from geometry.catmull_clark.topology import Topology
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = 3
"""Levels taken one by one before powers are used: then a cell has one irregular edge, or one irregular vertex."""
_BATCH = 256
"""Cells at a time."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Functions at points, one row for each point.

    Attributes
    ----------
    values : (p, v) sparse.
    gradients : three of them, derivatives along the cell's reference directions.
    second : six of them, along 00, 11, 22, 12, 02, 01.
    level : (p,) subdivisions until the point lay in a regular cell; -1 on extraordinary edges and vertices.
    way : (p,) `powers.RINGS`, `powers.EIGEN` or `powers.SQUARED`.
    """

    values: csr_array
    gradients: tuple[csr_array, ...]
    second: tuple[csr_array, ...]
    level: Index
    way: Index


def evaluate(topology: Topology, cells: Index, xi: Array, steps: int = STEPS) -> Evaluation:
    """Functions of the limit volume at points of cells.

    Parameters
    ----------
    cells : (p,) cell of each point.
    xi : (p, 3) reference coordinates in [0, 1], in the cell's own numbering.
    steps : levels taken one by one before powers are used.

    Raises
    ------
    InputError : a point lies outside its cell.
    """
    cells, xi = np.asarray(cells, dtype=np.int64), np.asarray(xi, dtype=float)
    bad = np.flatnonzero(~((xi >= 0.0) & (xi <= 1.0)).all(axis=1))
    if len(bad):
        raise InputError(f"point {bad[0]} {tuple(xi[bad[0]].tolist())} lies outside the reference cell")
    made = _Made([[] for _ in ORDERS], np.full(len(cells), -1), np.full(len(cells), RINGS), {})
    for start in range(0, len(cells), _BATCH):
        _batch(topology, cells, xi, np.arange(start, min(start + _BATCH, len(cells))), steps, made)
    found = []
    for entries in made.entries:
        row, column, data = (np.concatenate(part) for part in zip(*entries))
        found.append(csr_array((data, (row, column)), shape=(len(cells), topology.vertices)))
    return Evaluation(found[0], tuple(found[1:4]), tuple(found[4:]), made.level, made.way)


@dataclass(frozen=True, eq=False)
class _Made:
    """Entries (point, vertex, value) of each table, levels and ways (p,), classes met."""

    entries: list[list[tuple[Index, Index, Array]]]
    level: Index
    way: Index
    nodes: dict[int, Node]


def _batch(topology: Topology, cells: Index, xi: Array, points: Index, steps: int, made: _Made) -> None:
    part = neighbourhoods(topology, cells[points], turn=False)
    local, cell = local_topology(topology, part)
    matrix = csr_array(eye_array(local.vertices))
    eta = xi[points].copy()
    for k in range(steps + 1):
        regular = local.regular_hexes[cell]
        if regular.any():
            rows, take = bezier_rows(local), np.flatnonzero(regular)
            coefficients = bezier_matrix(local, rows, cell[take])[rows.cells[cell[take]].ravel()] @ matrix
            made.level[points[take]] = k
            n = len(take)
            for entries, w, order in zip(made.entries, tables(eta[take]), ORDERS.sum(axis=1).tolist()):
                data = (2.0 ** (k * order) * w).ravel()
                sparse = csr_array((data, np.arange(64 * n), np.arange(0, 64 * n + 1, 64)), shape=(n, 64 * n))
                found = (sparse @ coefficients).tocoo()
                row, column = found.coords
                entries.append((points[take[row]], part.vertex[column], found.data))
        if regular.all():
            return
        points, eta, cell = points[~regular], eta[~regular], cell[~regular]
        if k == steps:
            break
        bit = (eta >= 0.5).astype(np.int64)
        local, matrix, children = refine_locally(local, matrix, cell)
        cell = children.reshape(-1, 8)[np.arange(len(points)), bit @ np.array([4, 2, 1])]
        eta = 2.0 * eta - bit
    last = neighbourhoods(local, cell, turn=False)
    nodes = nodes_of(local, last, made.nodes)
    for name in np.unique(last.signature).tolist():
        mine = np.flatnonzero(last.signature == name)
        T, level, made.way[points[mine]] = rows_at(nodes[mine[0]], eta[mine])
        made.level[points[mine]] = np.where(level < 0, -1, level + steps)
        for k, one in enumerate(mine.tolist()):
            own = matrix[last.vertex[last.start[one] : last.start[one + 1]]]
            column = np.unique(own.indices)
            values = T[:, k] @ own[:, column].toarray()
            for entries, row, order in zip(made.entries, values, ORDERS.sum(axis=1).tolist()):
                at = np.full(len(column), points[one])
                entries.append((at, part.vertex[column], 2.0 ** (steps * order) * row))
