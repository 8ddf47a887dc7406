r"""C0 Bernstein spaces on conforming meshes of any mix of cells, numbered by topology.

Neighbouring cells share the functions of the vertices, edges and faces they share. Each cell's basis restricts to the
same Bernstein basis on a shared entity (triangular on triangles, tensor on quadrilaterals, the rational pyramid
included), so a function is known by its entity and its exponents with respect to the entity's vertices. An entity's own
frame comes from global vertex numbers: an edge runs from its smaller vertex to the larger, a triangle's vertices are
sorted, a quadrilateral starts at its smallest vertex and its first axis goes to the smaller neighbour.

Axis letters: e element, v vertex of the cell, f facet, n function.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, bernstein, elevation, face_functions, functions_at
from iga.block import Block
from iga.cells import TRIANGLE, Cell
from iga.domain import Domain, Facets, Provenance, Space
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Complex:
    """Straight connectivity of a conforming mesh.

    Attributes
    ----------
    parts : for each block its cell and vertex numbers (e, v), in the cell's own vertex order.
    """

    parts: tuple[tuple[Cell, Index], ...]

    @property
    def vertices(self) -> int:
        """One more than the largest vertex number."""
        return 1 + max((int(v.max()) for _, v in self.parts if v.size), default=-1)


def entity_keys(corners: Index, vertices: int) -> Index:
    """Integer keys (m,) of edges or faces given by vertex numbers (m, 2..4): equal, within one call, if and only if
    the sets are equal.

    The three smallest vertices identify a quadrilateral of a conforming mesh.
    """
    ordered = np.sort(corners, axis=1)
    key = ordered[:, 0] * vertices + ordered[:, 1]
    if corners.shape[1] == 2:
        return key
    pairs = np.unique(key, return_inverse=True)[1]
    return np.asarray(pairs, dtype=np.int64) * vertices + ordered[:, 2]


def number(mesh: Complex, degree: int) -> tuple[list[Index], int]:
    """Number the functions of the C0 Bernstein space of one degree in all directions.

    Returns
    -------
    For each part the functions of its elements (e, n), and the total number of functions. Vertices in use come first,
    in the order of their numbers, then functions of edges, triangles, quadrilaterals and interiors.
    """
    if degree < 1:
        raise InputError(f"a C0 space needs degree 1 at least, not {degree}")
    bases = [bernstein(cell, degree) for cell, _ in mesh.parts]
    dofs = [np.full((len(vertices), basis.n), -1, dtype=np.int64) for basis, (_, vertices) in zip(bases, mesh.parts)]
    total = mesh.vertices
    used = np.zeros(total, dtype=bool)
    for _, vertices in mesh.parts:
        used[vertices] = True
    renumber = np.cumsum(used) - 1
    start = int(used.sum())
    for block, basis, (cell, vertices) in zip(dofs, bases, mesh.parts):
        corner = functions_at(basis, cell.vertices)
        block[:, corner] = renumber[vertices]
    start = _number_edges(mesh, bases, dofs, degree, start, total)
    for size in (3, 4):
        start = _number_faces(mesh, bases, dofs, degree, start, total, size)
    for block in dofs:
        free = np.flatnonzero((block[:1] < 0).any(axis=0))
        count = len(block) * len(free)
        block[:, free] = start + np.arange(count).reshape(len(block), len(free))
        start += count
    return dofs, start


def _number_edges(
    mesh: Complex, bases: list[Bernstein], dofs: list[Index], degree: int, start: int, total: int
) -> int:
    if degree < 2:
        return start
    corners = [vertices[:, cell.edges].reshape(-1, 2) for cell, vertices in mesh.parts]
    keys, inverse = np.unique(entity_keys(np.concatenate(corners), total), return_inverse=True)
    t = (np.arange(1, degree) / degree)[:, None]
    at = 0
    for block, basis, (cell, vertices), ends in zip(dofs, bases, mesh.parts, corners):
        edge = inverse[at : at + len(ends)].reshape(len(vertices), -1)
        backward = (ends[:, 0] > ends[:, 1]).reshape(len(vertices), -1)
        at += len(ends)
        for k, (a, b) in enumerate(cell.edges):
            functions = functions_at(basis, cell.vertices[a] + t * (cell.vertices[b] - cell.vertices[a]))
            step = np.arange(degree - 1)
            order = np.where(backward[:, k, None], step[::-1], step)
            block[:, functions] = start + edge[:, k, None] * (degree - 1) + order
    return start + len(keys) * (degree - 1)


def _number_faces(
    mesh: Complex, bases: list[Bernstein], dofs: list[Index], degree: int, start: int, total: int, size: int
) -> int:
    places, tables = _face_orders(degree, size)
    inner = tables.shape[1]
    found = [
        (p, k, vertices[:, face.vertices])
        for p, (cell, vertices) in enumerate(mesh.parts)
        for k, face in enumerate(cell.faces)
        if len(face.vertices) == size
    ]
    if not found or not inner:
        return start
    corners = np.concatenate([f[2] for f in found])
    keys, inverse = np.unique(entity_keys(corners, total), return_inverse=True)
    orientation = _orientation(corners)
    at = 0
    for p, k, own in found:
        functions = face_functions(bases[p], k)[1][places]
        rows = slice(at, at + len(own))
        at += len(own)
        dofs[p][:, functions] = start + inverse[rows, None] * inner + tables[orientation[rows]]
    return start + len(keys) * inner


def _face_orders(degree: int, size: int) -> tuple[Index, Index]:
    """Interior functions of the face basis, and for each orientation their numbers in the entity's own frame."""
    if size == 3:
        exponents = bernstein(TRIANGLE, degree).exponents
        places = np.flatnonzero((exponents > 0).all(axis=1))
        inner = exponents[places]
        index = {tuple(e): r for r, e in enumerate(inner.tolist())}
        orders = [[index[tuple(e[list(order)])] for e in inner] for order in permutations(range(3))]
        return places, np.array(orders, dtype=np.int64).reshape(6, len(places))
    m = degree - 1
    i, j = (g.ravel() for g in np.meshgrid(np.arange(1, degree), np.arange(1, degree), indexing="ij"))
    places = i * (degree + 1) + j
    rows = []
    for code in range(8):
        flip_i, flip_j, swap = code >> 2 & 1, code >> 1 & 1, code & 1
        a, b = (degree - i if flip_i else i), (degree - j if flip_j else j)
        first, second = (b, a) if swap else (a, b)
        rows.append((first - 1) * m + second - 1)
    return places, np.array(rows, dtype=np.int64)


def _orientation(corners: Index) -> Index:
    """Orientation number of each face relative to the frame of its entity, (m,)."""
    if corners.shape[1] == 3:
        order = np.argsort(corners, axis=1)
        codes = np.array([list(p) for p in permutations(range(3))]) @ np.array([9, 3, 1])
        lookup = np.zeros(27, dtype=np.int64)
        lookup[codes] = np.arange(6)
        return lookup[order @ np.array([9, 3, 1])]
    origin = corners.argmin(axis=1)  # corner (i, j) is number 2 i + j
    rows = np.arange(len(corners))
    along_i = corners[rows, origin ^ 2]
    along_j = corners[rows, origin ^ 1]
    return (origin >> 1) * 4 + (origin & 1) * 2 + (along_j < along_i)


def boundary(mesh: Complex) -> tuple[Facets, ...]:
    """Facets that belong to one cell only.

    Raises
    ------
    InputError : a face has more than two cells; it is named by its vertices.
    """
    total = mesh.vertices
    result: list[Facets] = []
    for size in (3, 4):
        found = [
            (p, k, vertices[:, face.vertices])
            for p, (cell, vertices) in enumerate(mesh.parts)
            for k, face in enumerate(cell.faces)
            if len(face.vertices) == size
        ]
        if not found:
            continue
        corners = np.concatenate([f[2] for f in found])
        inverse, count = np.unique(entity_keys(corners, total), return_inverse=True, return_counts=True)[1:]
        many = np.flatnonzero(count[inverse] > 2)
        if len(many):
            vertices = ", ".join(str(v) for v in sorted(corners[many[0]].tolist()))
            cells = count[inverse[many[0]]]
            raise InputError(f"the face with vertices {vertices} belongs to {cells} cells (non-manifold)")
        at = 0
        for p, k, own in found:
            single = np.flatnonzero(count[inverse[at : at + len(own)]] == 1)
            at += len(own)
            if len(single):
                result.append(Facets(p, k, single))
    return tuple(sorted(result, key=lambda f: (f.block, f.face)))


def bezier_domain(
    mesh: Complex,
    degree: int,
    coefficients: Sequence[Array],
    boundaries: dict[str, tuple[Facets, ...]] | None = None,
    provenance: Provenance | None = None,
) -> Domain:
    """Domain with the C0 Bernstein space of a mesh from each element's Bernstein coefficients.

    Parameters
    ----------
    coefficients : for each part (e, n, 3); cells must agree on shared entities (one of the values is kept).
    boundaries : by default all boundary facets under the name "boundary".
    """
    dofs, n = number(mesh, degree)
    points = np.empty((n, 3))
    for block, values in zip(dofs, coefficients):
        points[block] = values
    blocks = tuple(Block(bernstein(cell, degree), d) for (cell, _), d in zip(mesh.parts, dofs))
    named = {"boundary": boundary(mesh)} if boundaries is None else boundaries
    return Domain(Space(blocks, n), points, named, provenance=provenance or Provenance())


def straight_domain(mesh: Complex, vertices: Array, degree: int = 1) -> Domain:
    """Straight-sided domain: each cell's degree-one map through its vertices (v, 3), written in a higher degree."""
    coefficients = []
    for cell, corners in mesh.parts:
        raise_ = elevation(bernstein(cell, 1), bernstein(cell, degree).degree)
        coefficients.append(raise_ @ vertices[corners])
    return bezier_domain(mesh, degree, coefficients)
