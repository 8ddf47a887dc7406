r"""Refinement of Bezier tetrahedra and hexahedra into eight, exactly and face to face.

**Tetrahedra**: Bey's red refinement. Four children sit at the vertices; the octahedron between them is cut along the
diagonal from the midpoint of edge 02 to that of edge 13. With the order of vertices below, repeated refinement produces
at most three similarity classes from any tetrahedron, so quality stays bounded; a face is cut through its midpoints
whatever the diagonal, so neighbours always fit. A child's Bezier coefficients are values of the parent's blossom at the
child's vertices (J. Bey, "Tetrahedral grid refinement", Computing 55, 1995, with children turned to be positive:
exchanging vertices 0 and 2 keeps the diagonal).

**Hexahedra**: de Casteljau at 1/2 in each direction.

Axis letters: e parent, k child, n coefficient, v vertex, c component.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, TETRAHEDRON, Cell
from iga.conforming import entity_keys

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Children by the parent's vertices and midpoints, each point as the two vertices it lies between.
_RED = (
    ("00", "01", "02", "03"),
    ("01", "11", "12", "13"),
    ("02", "12", "22", "23"),
    ("03", "13", "23", "33"),
    ("01", "02", "03", "13"),
    ("01", "02", "12", "13"),
    ("02", "03", "13", "23"),
    ("02", "12", "13", "23"),
)


@cache
def tet_children() -> Array:
    """Barycentric coordinates (8, 4, 4) in the parent of each child's vertices, all children positive."""
    unit = np.eye(4)
    made = np.array([[(unit[int(p[0])] + unit[int(p[1])]) / 2 for p in child] for child in _RED])
    negative = np.linalg.det(made) < 0
    made[negative] = made[negative][:, [2, 1, 0, 3]]
    return made


@cache
def hex_children() -> Array:
    """Reference coordinates (8, 8, 3) in the parent of each child's vertices; child (i, j, k) is 4 i + 2 j + k."""
    return (HEXAHEDRON.vertices[:, None] + HEXAHEDRON.vertices) / 2


@cache
def blossom_matrix(degree: int, corners: tuple[tuple[float, ...], ...]) -> Array:
    """Matrix (C, C) from a tetrahedron's coefficients to those of the sub-tetrahedron with barycentric ``corners``.

    Row a is the blossom at corner v taken a_v times: the coefficients of prod_v (sum_w corners[v, w] z_w)^{a_v}.
    """
    rows = np.ones((1, 1))
    for n in range(1, degree + 1):
        low = bernstein(TETRAHEDRON, n - 1).exponents
        high = bernstein(TETRAHEDRON, n).exponents
        place_low = {tuple(a): k for k, a in enumerate(low.tolist())}
        place = {tuple(a): k for k, a in enumerate(high.tolist())}
        unit = np.eye(4, dtype=np.int64)
        raised = np.array([[place[tuple(a)] for a in (low + unit[w]).tolist()] for w in range(4)])
        first = (high > 0).argmax(axis=1)
        before = rows[[place_low[tuple(a)] for a in (high - unit[first]).tolist()]]
        rows = np.zeros((len(high), len(high)))
        for w in range(4):
            rows[:, raised[w]] += np.array(corners)[first, w, None] * before
    return rows


@cache
def tet_subdivision(degree: int) -> Array:
    """Matrices (8, C, C) from a tetrahedron's coefficients to those of its children."""
    return np.stack([blossom_matrix(degree, tuple(map(tuple, child))) for child in tet_children().tolist()])


def line_subdivision(degree: int) -> Array:
    """Matrices (2, n+1, n+1) from a Bezier curve's coefficients to those of its halves."""
    left = np.zeros((degree + 1, degree + 1))
    left[0, 0] = 1.0
    for i in range(1, degree + 1):
        left[i, : i + 1] = (left[i - 1, : i + 1] + np.concatenate([[0.0], left[i - 1, :i]])) / 2
    return np.stack([left, left[::-1, ::-1]])


def refine_tets(coefficients: Array) -> Array:
    """Coefficients (8 e, C, c) of the children of Bezier tetrahedra (e, C, c), those of one parent together."""
    count, n, c = coefficients.shape
    degree = 0
    while (degree + 1) * (degree + 2) * (degree + 3) // 6 < n:
        degree += 1
    return np.matmul(tet_subdivision(degree).reshape(-1, n), coefficients).reshape(8 * count, n, c)


def refine_hexes(coefficients: Array) -> Array:
    """Coefficients (8 e, (n+1)^3, c) of the children of Bezier hexahedra (e, (n+1)^3, c)."""
    count, n, c = coefficients.shape
    m = round(n ** (1 / 3))
    halves = line_subdivision(m - 1).reshape(2 * m, m)
    # One direction at a time, last first; each leaves its two children in the place of one index.
    grid = np.matmul(halves, coefficients.reshape(count * m * m, m, c)).reshape(count * m, m, 2 * m * c)
    grid = np.matmul(halves, grid).reshape(count, m, 2 * m * 2 * m * c)
    grid = np.matmul(halves, grid).reshape(count, 2, m, 2, m, 2, m, c)
    return np.ascontiguousarray(grid.transpose(0, 1, 3, 5, 2, 4, 6, 7)).reshape(8 * count, n, c)


def refine_vertices(cell: Cell, vertices: Index) -> Index:
    """Vertex numbers of the children of tetrahedra (e, 4) or hexahedra (e, 8): (8 e, 4) or (8 e, 8).

    Old vertices keep their numbers; midpoints of edges, then centres of faces, then of cells follow.
    """
    simplex = cell is TETRAHEDRON
    children = tet_children() @ TETRAHEDRON.vertices if simplex else hex_children()
    total = int(vertices.max()) + 1
    edge_numbers, edges = _number_entities(vertices, cell.edges, total)
    places = [cell.vertices, cell.vertices[cell.edges].mean(axis=1)]
    numbers = [vertices, total + edge_numbers]
    total += edges
    if not simplex:
        corners = np.array([face.vertices for face in cell.faces])
        face_numbers, faces = _number_entities(vertices, corners, total)
        places += [cell.vertices[corners].mean(axis=1), cell.centre[None]]
        numbers += [total + face_numbers, total + faces + np.arange(len(vertices))[:, None]]
    where = np.concatenate(places)
    table = np.concatenate(numbers, axis=1)
    distance = np.abs(children[:, :, None] - where).max(axis=-1)
    return table[:, distance.argmin(axis=-1)].reshape(-1, children.shape[1])


def _number_entities(vertices: Index, entities: Index, total: int) -> tuple[Index, int]:
    """Number (e, k) of each edge or face with local vertices ``entities`` (k, m), and how many there are."""
    keys = entity_keys(vertices[:, entities].reshape(-1, entities.shape[1]), total)
    unique, inverse = np.unique(keys, return_inverse=True)
    return np.asarray(inverse, dtype=np.int64).reshape(len(vertices), -1), len(unique)


@cache
def face_children(cell: Cell) -> Index:
    """For each face of the parent its four children's (child, face), (faces, 4, 2)."""
    children = tet_children() @ TETRAHEDRON.vertices if cell is TETRAHEDRON else hex_children()
    made = []
    for face in cell.faces:
        normal = np.cross(face.axes[:, 0], face.axes[:, 1])
        on = np.abs((children - face.origin) @ normal) < 1e-12
        made.append(
            [(k, f) for k in range(8) for f, own in enumerate(cell.faces) if on[k, list(own.vertices)].all()]
        )
    return np.array(made, dtype=np.int64)


def refine_facets(cell: Cell, facets: Index) -> Index:
    """Children (4 f, 2) of facets (f, 2), both as (element, face)."""
    table = face_children(cell)[facets[:, 1]]
    return np.stack([8 * facets[:, :1] + table[..., 0], table[..., 1]], axis=-1).reshape(-1, 2)
