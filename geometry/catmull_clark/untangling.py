r"""Moving control points until every cell is valid, with the certificate in the loop.

On the tricubic closures of all cells near a fold the energy is a regularised mean ratio (Escobar et al. 2003),

    sum_cells mean_q eta^2,     eta = |S|^2 / (3 h(sigma)^(2/3)),     S = J diag(1/l_1, 1/l_2, 1/l_3),
    sigma = det S,   h(sigma) = (sigma + (sigma^2 + 4 delta^2)^(1/2))/2,

with l_d the mean edge lengths of the cell in the input mesh, so that flat cells may stay flat, plus a spring to the
control points as given. delta makes it finite on folded cells: the smallest value with h >= EPSILON at the worst point,
recomputed each round. Rounds of L-BFGS alternate with the certificate (Bernstein coefficients of det J) of the cells
concerned; cells that are not certified, and their surroundings, are what the next round moves.

Axis letters: e cell, q sample point, b Bernstein function, c component, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse import csr_array

from geometry.catmull_clark.domain import CUBIC
from geometry.catmull_clark.lattice import Rows, bezier_matrix, bezier_rows
from geometry.catmull_clark.mean_ratio import lowest, mean_ratio, tables
from geometry.catmull_clark.topology import CREASE, EDGES, INTERIOR, Topology, incidence
from iga.block import Block
from iga.cells import HEXAHEDRON
from iga.certificate import certify
from iga.domain import Domain, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EPSILON = 0.05
_COARSE = tables(np.array([0.0, 0.5, 1.0]))
_FINE = tables(np.array([0.0, 0.17, 0.5, 0.83, 1.0]))
_AXIS_EDGES = [
    [k for k, (a, b) in enumerate(EDGES) if HEXAHEDRON.vertices[b, d] != HEXAHEDRON.vertices[a, d]] for d in range(3)
]


@dataclass(frozen=True, eq=False)
class Closures:
    """Tricubic closures of a mesh: ``matrix`` (r, v) gives Bezier points, ``rows`` says whose they are."""

    topology: Topology
    rows: Rows
    matrix: csr_array
    lengths: Array


def closures(topology: Topology, points: Array) -> Closures:
    """Closures of all cells; ``points`` (v, 3) of the input mesh set the lengths of the ideal cells."""
    rows = bezier_rows(topology)
    ends = points[topology.edges]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    lengths = np.stack([length[topology.hex_edges[:, k]].mean(axis=1) for k in _AXIS_EDGES], axis=1)
    floor = 1e-3 * lengths.max(axis=1, keepdims=True)
    return Closures(topology, rows, bezier_matrix(topology, rows), np.maximum(lengths, floor))


def invalid_cells(made: Closures, control: Array, cells: Index | None = None, depth: int = 5) -> Index:
    """Cells (of those given) whose closure is not certified."""
    cells = np.arange(len(made.topology.hexes)) if cells is None else cells
    if not len(cells):
        return cells
    used, dofs = np.unique(made.rows.cells[cells], return_inverse=True)
    block = Block(CUBIC, dofs.reshape(-1, 64))
    domain = Domain(Space((block,), len(used)), made.matrix[used] @ control)
    return cells[certify(domain, tolerance=1e9, max_depth=depth).verdict <= 0]


@dataclass(frozen=True, eq=False)
class Untangled:
    """Control points (v, 3) after untangling, the cells still invalid, and the vertices that were moved."""

    control: Array
    invalid: Index
    moved: Index


def untangle(
    made: Closures,
    control: Array,
    invalid: Index,
    boundary: bool = False,
    rounds: int = 8,
    spring: float = 1e-2,
    reach: int = 1,
) -> Untangled:
    """Move control points near invalid cells until the closures of all cells are certified.

    Parameters
    ----------
    control : (v, 3) control points.
    invalid : cells to start from, as `invalid_cells` finds them.
    boundary : whether smooth and crease boundary points may move too (corners never do).
    rounds : most rounds of optimisation; three without progress end it.
    spring : weight of the spring to the given points.
    reach : rings of cells around the invalid ones whose points may move; grows every second round.
    """
    t = made.topology
    lowest = CREASE if boundary else INTERIOR
    control = control.copy()
    start = control.copy()
    around = incidence(t.hexes, t.vertices)
    concerned = np.zeros(len(t.hexes), dtype=bool)
    best, since = len(invalid), 0
    for step in range(rounds):
        if not len(invalid) or since == 3:
            break
        concerned[invalid] = True
        ring = concerned.copy()
        for _ in range(reach + step // 2):
            ring = _grow(around, ring)
        free = np.zeros(t.vertices, dtype=bool)
        free[t.hexes[ring]] = True
        free &= t.vertex_kind >= lowest
        if not free.any():
            break
        cells = np.flatnonzero(_grow(around, around @ free > 0))
        weight = spring * 0.3**step
        control = _minimise(made, control, start, np.flatnonzero(free), cells, weight, _FINE if step % 2 else _COARSE)
        invalid = invalid_cells(made, control, cells)
        since = 0 if len(invalid) < best else since + 1
        best = min(best, len(invalid))
    return Untangled(control, invalid, np.flatnonzero((control != start).any(axis=1)))


def _grow(around: csr_array, cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells that share a vertex with some of the cells given."""
    touched = around.T @ cells > 0
    return np.asarray(around @ touched > 0)


def _minimise(
    made: Closures, control: Array, start: Array, free: Index, cells: Index, spring: float,
    samples: tuple[Array, Array],
) -> Array:
    used, index = np.unique(made.rows.cells[cells], return_inverse=True)
    index = np.ascontiguousarray(index.reshape(-1, 64))
    matrix = made.matrix[used]
    columns = matrix[:, free].tocsr()
    rows = columns.T.tocsr()
    base = matrix @ control
    inverse = np.ascontiguousarray(1.0 / made.lengths[cells])
    size = np.full(made.topology.vertices, np.inf)
    np.minimum.at(size, made.topology.hexes[cells].ravel(), np.repeat(made.lengths[cells].min(axis=1), 8))
    stiff = spring / size[free][:, None] ** 2
    origin = control[free]

    def energy(x: Array) -> tuple[float, Array]:
        move = x.reshape(-1, 3)
        slope = np.zeros_like(base)
        value = mean_ratio(base + columns @ move, index, inverse, delta, *samples, slope)
        pull = origin + move - start[free]
        return value + float((stiff * pull**2).sum()), (rows @ slope + 2.0 * stiff * pull).ravel()

    move = np.zeros(3 * len(free))
    worst = float(lowest(base, index, inverse, *samples).min())
    delta = float(np.sqrt(EPSILON * (EPSILON - worst))) if worst < EPSILON else 0.0
    done = minimize(energy, move, jac=True, method="L-BFGS-B", options={"maxiter": 60, "maxcor": 12, "ftol": 1e-7})
    result = control.copy()
    result[free] += done.x.reshape(-1, 3)
    return result
