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
from geometry.catmull_clark.topology import CREASE, EDGES, INTERIOR, Topology, incidence
from iga.block import Block
from iga.cells import HEXAHEDRON
from iga.certificate import certify
from iga.domain import Domain, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EPSILON = 0.05
_SAMPLES = np.stack(np.meshgrid(*[np.array([0.0, 0.28, 0.72, 1.0])] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
_SLOPES = np.ascontiguousarray(CUBIC.tabulate(_SAMPLES, 1)[1].transpose(1, 0, 2).reshape(64, -1))
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
    rounds : most rounds of optimisation.
    spring : weight of the spring to the given points.
    reach : rings of cells around the invalid ones whose points may move; grows every second round.
    """
    t = made.topology
    lowest = CREASE if boundary else INTERIOR
    control = control.copy()
    start = control.copy()
    around = incidence(t.hexes, t.vertices)
    concerned = np.zeros(len(t.hexes), dtype=bool)
    for step in range(rounds):
        if not len(invalid):
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
        control = _minimise(made, control, start, np.flatnonzero(free), cells, weight)
        invalid = invalid_cells(made, control, cells)
    return Untangled(control, invalid, np.flatnonzero((control != start).any(axis=1)))


def _grow(around: csr_array, cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells that share a vertex with some of the cells given."""
    touched = around.T @ cells > 0
    return np.asarray(around @ touched > 0)


def _minimise(
    made: Closures, control: Array, start: Array, free: Index, cells: Index, spring: float
) -> Array:
    used, index = np.unique(made.rows.cells[cells], return_inverse=True)
    index = index.reshape(-1, 64)
    matrix = made.matrix[used]
    columns = matrix[:, free].tocsr()
    gather = csr_array(
        (np.ones(index.size), (index.ravel(), np.arange(index.size))), shape=(len(used), index.size)
    )
    base = matrix @ control
    lengths = made.lengths[cells]
    size = np.full(made.topology.vertices, np.inf)
    np.minimum.at(size, made.topology.hexes[cells].ravel(), np.repeat(lengths.min(axis=1), 8))
    stiff = spring / size[free][:, None] ** 2
    origin = control[free]

    def energy(x: Array) -> tuple[float, Array]:
        move = x.reshape(-1, 3)
        b = (base + columns @ move)[index]
        value, slope = _mean_ratio(b, lengths, delta)
        g = columns.T @ (gather @ slope.reshape(-1, 3))
        pull = origin + move - start[free]
        return value + float((stiff * pull**2).sum()), (g + 2.0 * stiff * pull).ravel()

    move = np.zeros(3 * len(free))
    lowest = _determinants((base + columns @ move.reshape(-1, 3))[index], lengths)[2].min()
    delta = float(np.sqrt(EPSILON * (EPSILON - lowest))) if lowest < EPSILON else 0.0
    done = minimize(energy, move, jac=True, method="L-BFGS-B", options={"maxiter": 60, "maxcor": 12, "ftol": 1e-7})
    result = control.copy()
    result[free] += done.x.reshape(-1, 3)
    return result


def _determinants(b: Array, lengths: Array) -> tuple[Array, Array, Array]:
    """S (e, q, 3c, 3d), its cofactors and determinants (e, q) at the sample points."""
    J = (b.transpose(0, 2, 1) @ _SLOPES).reshape(len(b), 3, -1, 3).transpose(0, 2, 1, 3)
    S = J / lengths[:, None, None, :]
    columns = [S[..., d] for d in range(3)]
    cofactors = np.stack([_cross(columns[1], columns[2]), _cross(columns[2], columns[0]),
                          _cross(columns[0], columns[1])], axis=-1)
    return S, cofactors, (S[..., 0] * cofactors[..., 0]).sum(axis=-1)


def _cross(a: Array, b: Array) -> Array:
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def _mean_ratio(b: Array, lengths: Array, delta: float) -> tuple[float, Array]:
    """Energy and its gradient with respect to Bezier points (e, 64, 3)."""
    S, cofactors, sigma = _determinants(b, lengths)
    root = np.sqrt(sigma**2 + 4.0 * delta**2)
    if delta == 0.0 and (sigma <= 0.0).any():
        return np.inf, np.zeros_like(b)
    # For sigma < 0 the printed form of h cancels.
    h = np.where(sigma > 0.0, 0.5 * (sigma + root), 2.0 * delta**2 / np.maximum(root - sigma, 1e-300))
    square = (S**2).sum(axis=(2, 3))
    eta = square / (3.0 * h ** (2.0 / 3.0))
    q = sigma.shape[1]
    # d(eta^2) = 2 eta^2 (2 S : dS / |S|^2 - (2/3) dsigma / root)
    factor = 2.0 * eta**2 / q
    dS = factor[..., None, None] * (2.0 * S / square[..., None, None] - (2.0 / 3.0) * cofactors / root[..., None, None])
    dJ = dS / lengths[:, None, None, :]
    slope = dJ.transpose(0, 2, 1, 3).reshape(len(b), 3, -1) @ _SLOPES.T
    return float((eta**2).sum() / q), slope.transpose(0, 2, 1)

