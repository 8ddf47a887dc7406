r"""One rule for subdivision, limit points and Bezier points: averages of multilinear maps.

On a product mesh, Catmull-Clark refinement and the conversion to tricubic Bezier form take the trilinear map of a cell
at the points of a small lattice and average over the cells that share the lattice point. Per direction, seen from the
nearer end, the weights of (near, far) are

    refinement   (3/4, 1/4), (1/2, 1/2), (1/4, 3/4)                     positions 0, 1/2, 1 of the cell
    Bezier       (2/3, 1/3), (2/3, 1/3), (1/3, 2/3), (1/3, 2/3)         positions 0, 1/3, 2/3, 1.

Averaging over the incident *cells* is exactly the paper's rules (1)-(3) with edge averages weighted by valence, at any
valence (Xie et al. 2020, eqs. (1)-(4)): the Bezier lattice's vertex row is the limit mask
``(8 v + 12 E + 6 F + C)/27``. On the boundary the average runs over boundary faces, on a crease over the crease's
edges, and a corner stays (`topology` kinds 3, 2, 1, 0). Smooth boundary vertices with N faces need Catmull-Clark's own
weight of the vertex,

    refinement   a = 4/N:      v' = a (v + 2E + F)/4 + (1 - a) v = (F + 2E + (N-3) v)/N
    Bezier       a = 9/(N+5):  v* = a (4v + 4E + F)/9 + (1 - a) v = (N v + 4E + F)/(N+5),

the second being the limit mask of the surface; face and edge Bezier points near the vertex take the same a, so that
their averages stay the limit point (as in Loop and Schaefer's ACC surface patches).

Axis letters: e cell, l lattice point of a cell, r row (point of the refined mesh or Bezier point), v vertex.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from geometry.catmull_clark.topology import CORNER, CREASE, EDGES, FACES, INTERIOR, SMOOTH, Topology

Array = NDArray[np.float64]
Index = NDArray[np.int64]

REFINEMENT = np.array([[3, 1], [2, 2], [1, 3]]) / 4.0
BEZIER = np.array([[2, 1], [2, 1], [1, 2], [1, 2]]) / 3.0


@dataclass(frozen=True, eq=False)
class Rows:
    """Numbers of lattice points in a whole mesh.

    Attributes
    ----------
    cells : (e, L) row of each lattice point of each cell, first direction slowest.
    faces : (f, L2) row of each lattice point of each face.
    edges : (m, L1).
    kind, near : (r,) kind of each row and, where `near` >= 0, the vertex that it is nearest to.
    """

    cells: Index
    faces: Index
    edges: Index
    kind: NDArray[np.int8]
    near: Index


@cache
def _weights(kind: str, dimension: int) -> Array:
    """Multilinear weights (L, 2^d) of all lattice points."""
    line = REFINEMENT if kind == "refinement" else BEZIER
    table = np.ones((1, 1))
    for _ in range(dimension):
        table = np.asarray(np.kron(table, line), dtype=np.float64)
    return table


def refinement_rows(topology: Topology) -> Rows:
    """Points of the refined mesh, numbered vertices, edges, faces, cells."""
    t = topology
    e, v, m, f = len(t.hexes), t.vertices, len(t.edges), len(t.faces)
    cells = np.empty((e, 3, 3, 3), dtype=np.int64)
    cells[:, ::2, ::2, ::2] = t.hexes.reshape(-1, 2, 2, 2)
    cells[:, 1, 1, 1] = v + m + f + np.arange(e)
    position = np.array(list(np.ndindex(2, 2, 2))) * 2
    for k, (a, b) in enumerate(EDGES):
        i, j, l = (position[a] + position[b]) // 2
        cells[:, i, j, l] = v + t.hex_edges[:, k]
    for k, quad in enumerate(FACES):
        i, j, l = position[quad].sum(axis=0) // 4
        cells[:, i, j, l] = v + m + t.hex_faces[:, k]
    faces = np.empty((f, 3, 3), dtype=np.int64)
    faces[:, ::2, ::2] = t.faces.reshape(-1, 2, 2)
    faces[:, 0, 1], faces[:, 2, 1], faces[:, 1, 0], faces[:, 1, 2] = (v + t.face_edges).T
    faces[:, 1, 1] = v + m + np.arange(f)
    edges = np.column_stack([t.edges[:, 0], v + np.arange(m), t.edges[:, 1]])
    kind = np.concatenate([t.vertex_kind, t.edge_kind, t.face_kind, np.full(e, INTERIOR, dtype=np.int8)])
    near = np.concatenate([np.arange(v), np.full(m + f + e, -1)])
    return Rows(cells.reshape(e, 27), faces.reshape(f, 9), edges, kind, near)


def bezier_rows(topology: Topology) -> Rows:
    """Bezier points of the tricubic C0 complex: vertices, 2 per edge, 4 per face, 8 per cell."""
    t = topology
    e, v, m, f = len(t.hexes), t.vertices, len(t.edges), len(t.faces)
    start_faces, start_cells = v + 2 * m, v + 2 * m + 4 * f
    corner = np.array(list(np.ndindex(2, 2, 2)))
    cells = np.empty((e, 4, 4, 4), dtype=np.int64)
    cells[:, ::3, ::3, ::3] = t.hexes.reshape(-1, 2, 2, 2)
    for k, (a, b) in enumerate(EDGES):
        for near, far in ((a, b), (b, a)):
            i, j, l = 2 * corner[near] + corner[far]
            second = t.hexes[:, near] != t.edges[t.hex_edges[:, k], 0]
            cells[:, i, j, l] = v + 2 * t.hex_edges[:, k] + second
    for k, quad in enumerate(FACES):
        for c in range(4):
            i, j, l = (2 * corner[quad[c]] + corner[quad[3 - c]])
            place = (t.faces[t.hex_faces[:, k]] == t.hexes[:, quad[c]][:, None]).argmax(axis=1)
            cells[:, i, j, l] = start_faces + 4 * t.hex_faces[:, k] + place
    cells[:, 1:3, 1:3, 1:3] = start_cells + np.arange(8 * e).reshape(e, 2, 2, 2)
    faces = np.empty((f, 4, 4), dtype=np.int64)
    faces[:, ::3, ::3] = t.faces.reshape(-1, 2, 2)
    corner2 = np.array(list(np.ndindex(2, 2)))
    for k, (a, b) in enumerate(((0, 1), (2, 3), (0, 2), (1, 3))):
        for near, far in ((a, b), (b, a)):
            i, j = 2 * corner2[near] + corner2[far]
            second = t.faces[:, near] != t.edges[t.face_edges[:, k], 0]
            faces[:, i, j] = v + 2 * t.face_edges[:, k] + second
    faces[:, 1:3, 1:3] = start_faces + np.arange(4 * f).reshape(f, 2, 2)
    half = v + np.arange(2 * m).reshape(m, 2)
    edges = np.column_stack([t.edges[:, 0], half, t.edges[:, 1]])
    kind = np.concatenate(
        [t.vertex_kind, t.edge_kind.repeat(2), t.face_kind.repeat(4), np.full(8 * e, INTERIOR, dtype=np.int8)]
    )
    near = np.concatenate([np.arange(v), t.edges.ravel(), t.faces.ravel(), np.full(8 * e, -1)])
    return Rows(cells.reshape(e, 64), faces.reshape(f, 16), edges, kind, near)


def refinement_matrix(topology: Topology, rows: Rows | None = None) -> csr_array:
    """Subdivision as one matrix (v', v): new vertices are the rows of `refinement_rows`."""
    return _operator(topology, rows or refinement_rows(topology), "refinement")


def bezier_matrix(topology: Topology, rows: Rows | None = None, cells: Index | None = None) -> csr_array:
    """Bezier points of the tricubic complex from control points, (r, v), rows as in `bezier_rows`.

    On a cell whose vertices are all regular this is the limit volume itself. On other cells it is its closure: C0,
    linear, sums to one, interpolates the limit at vertices, and along a straight extraordinary edge it is the limit
    curve.

    Parameters
    ----------
    cells : if given, only rows of these cells are needed; the others may come out as zeros.
    """
    return _operator(topology, rows or bezier_rows(topology), "bezier", cells)


def limit_matrix(topology: Topology) -> csr_array:
    """Limit points of the vertices from control points, (v, v), valid at every level."""
    return _operator(topology, bezier_rows(topology), "bezier", only_vertices=True)


def _operator(
    topology: Topology, rows: Rows, lattice: str, wanted: Index | None = None, only_vertices: bool = False
) -> csr_array:
    n = topology.vertices if only_vertices else len(rows.kind)
    needed = np.ones(n, dtype=bool)
    if wanted is not None:
        needed[:] = False
        needed[rows.cells[wanted]] = True
    total = None
    outer = topology.boundary_faces
    crease = np.flatnonzero(topology.edge_kind == CREASE)
    for kind, members, numbers, dimension in (
        (INTERIOR, topology.hexes, rows.cells, 3),
        (SMOOTH, topology.faces[outer], rows.faces[outer], 2),
        (CREASE, topology.edges[crease], rows.edges[crease], 1),
    ):
        weights = _weights(lattice, dimension)
        part = _average(members, numbers, rows.kind[:n] == kind, needed, weights, topology.vertices)
        total = part if total is None else total + part
    corners = np.flatnonzero((topology.vertex_kind == CORNER) & needed[: topology.vertices])
    assert total is not None
    total = total + _unit_rows(corners, corners, np.ones(len(corners)), total.shape)
    return _correct(topology, rows, lattice, total.tocsr(), needed)


def _average(
    members: Index, numbers: Index, mine: NDArray[np.bool_], needed: NDArray[np.bool_], weights: Array, columns: int
) -> csr_array:
    """Mean over items of the multilinear maps at the lattice points that are rows of this kind."""
    take = np.zeros(len(mine) + 1, dtype=bool)
    take[:-1] = mine & needed
    item, point = np.nonzero(take[np.minimum(numbers, len(mine))])
    row = numbers[item, point]
    count = np.bincount(row, minlength=len(mine))
    data = weights[point] / count[row][:, None]
    entries = csr_array(
        (data.ravel(), members[item].ravel(), np.arange(0, data.size + 1, data.shape[1])), shape=(len(row), columns)
    )
    gather = csr_array((np.ones(len(row)), (row, np.arange(len(row)))), shape=(len(mine), len(row)))
    return gather @ entries


def _unit_rows(row: Index, column: Index, data: Array, shape: tuple[int, int]) -> csr_array:
    return csr_array((data, (row, column)), shape=shape)


def _correct(
    topology: Topology, rows: Rows, lattice: str, matrix: csr_array, needed: NDArray[np.bool_]
) -> csr_array:
    """Weight of the vertex at smooth boundary vertices of valence other than four."""
    n = len(needed)
    near = rows.near[:n]
    N = topology.boundary_valence
    odd = (topology.vertex_kind == SMOOTH) & (N != 4) & (N > 0)
    row = np.flatnonzero((near >= 0) & odd[near] & (rows.kind[:n] == SMOOTH) & needed)
    if not len(row):
        return matrix
    valence = N[near[row]]
    a = 4.0 / valence if lattice == "refinement" else 9.0 / (valence + 5.0)
    scale = np.ones(n)
    scale[row] = a
    return (diags_array(scale) @ matrix + _unit_rows(row, near[row], np.asarray(1.0 - a), matrix.shape)).tocsr()
