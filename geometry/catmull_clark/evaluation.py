r"""Exact values and derivatives of the limit functions at any point of any cell.

A point of an irregular cell is followed into its child, level by level, until the cell that holds it is regular; there
the functions are tricubic. Level k multiplies derivatives by 2^k. A point at parameter distance d from the
extraordinary edge or vertex needs about log2(1/d) levels. Points on it stay irregular for ever: after ``depth`` levels
their value is that of the closure, which is the limit itself at vertices and on straight extraordinary edges, and
elsewhere off by terms of the order of the cell's size at that level; derivatives have no limit there in general.

Axis letters: p point, v vertex, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from geometry.catmull_clark.domain import CUBIC
from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows
from geometry.catmull_clark.neighbourhood import neighbourhoods
from geometry.catmull_clark.pieces import local_topology, refine_locally
from geometry.catmull_clark.topology import Topology
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_BATCH = 256


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Functions at points, one row for each point.

    Attributes
    ----------
    values : (p, v) sparse.
    gradients : three of them, derivatives along the cell's reference directions.
    second : six of them, along 00, 11, 22, 12, 02, 01.
    level : (p,) subdivisions until the point lay in a regular cell; -1 where it never did.
    """

    values: csr_array
    gradients: tuple[csr_array, ...]
    second: tuple[csr_array, ...]
    level: Index


_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def evaluate(topology: Topology, cells: Index, xi: Array, depth: int = 24) -> Evaluation:
    """Functions of the limit volume at points of cells.

    Parameters
    ----------
    cells : (p,) cell of each point.
    xi : (p, 3) reference coordinates in [0, 1], in the cell's own numbering.
    depth : most levels.

    Raises
    ------
    InputError : a point lies outside its cell.
    """
    cells, xi = np.asarray(cells, dtype=np.int64), np.asarray(xi, dtype=float)
    bad = np.flatnonzero(~((xi >= 0.0) & (xi <= 1.0)).all(axis=1))
    if len(bad):
        raise InputError(f"point {bad[0]} {tuple(xi[bad[0]].tolist())} lies outside the reference cell")
    shape = (len(cells), topology.vertices)
    tables: list[list[tuple[Array, Array, Array]]] = [[] for _ in range(10)]
    level = np.full(len(cells), -1, dtype=np.int64)
    for start in range(0, len(cells), _BATCH):
        _batch(topology, cells, xi, np.arange(start, min(start + _BATCH, len(cells))), depth, tables, level)
    made = []
    for entries in tables:
        row, column, data = (np.concatenate(part) for part in zip(*entries))
        made.append(csr_array((data, (row, column)), shape=shape))
    return Evaluation(made[0], tuple(made[1:4]), tuple(made[4:]), level)


def _batch(
    topology: Topology, cells: Index, xi: Array, points: Index, depth: int,
    tables: list[list[tuple[Array, Array, Array]]], level: Index,
) -> None:
    part = neighbourhoods(topology, cells[points])
    part = replace(part, rotation=np.zeros(len(points), dtype=np.int64))  # stay in the mesh's own numbering
    local, cell = local_topology(topology, part)
    matrix = csr_array(eye_array(local.vertices))
    eta = xi[points].copy()
    for k in range(depth + 1):
        regular = local.regular_hexes[cell]
        done = regular | (k == depth)
        if done.any():
            rows = bezier_rows(local)
            take = np.flatnonzero(done)
            coefficients = bezier_matrix(local, rows, cell[take])[rows.cells[cell[take]].ravel()] @ matrix
            level[points[take[regular[take]]]] = k
            B, dB, ddB = CUBIC.tabulate(eta[take], 2)
            scale = 2.0**k
            weights = [B, *(scale * dB[..., d] for d in range(3)), *(scale**2 * ddB[..., a, b] for a, b in _PAIRS)]
            for entries, w in zip(tables, weights):
                n = len(take)
                sparse = csr_array((w.ravel(), np.arange(64 * n), np.arange(0, 64 * n + 1, 64)), shape=(n, 64 * n))
                found = (sparse @ coefficients).tocoo()
                row, column = found.coords
                entries.append((points[take[row]], part.vertex[column], found.data))
        if done.all():
            return
        points, eta, cell = points[~done], eta[~done], cell[~done]
        step = (eta >= 0.5).astype(np.int64)
        local, matrix, children = refine_locally(local, matrix, cell)
        cell = children.reshape(-1, 8)[np.arange(len(points)), step @ np.array([4, 2, 1])]
        eta = 2.0 * eta - step
