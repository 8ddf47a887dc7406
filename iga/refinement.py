r"""Refinement of C0 Bernstein domains: every element into eight, exactly and face to face; and degree elevation.

**Tetrahedra**: Bey's red refinement. Four children sit at the vertices; the octahedron between them is cut along the
diagonal from the midpoint of edge 02 to that of edge 13. With the order of vertices below, repeated refinement produces
at most three similarity classes from any tetrahedron, so quality stays bounded; a face is cut through its midpoints
whatever the diagonal, so neighbours always fit (J. Bey, "Tetrahedral grid refinement", Computing 55, 1995, with
children turned to be positive: exchanging vertices 0 and 2 keeps the diagonal).

**Hexahedra** are halved in each direction, **wedges** are four triangles times two. A child's coefficients are values
of the parent's blossom at the child's vertices, which is de Casteljau's algorithm. All entries of the matrices are
non-negative and rows sum to one. **Pyramids** cannot be refined this way: their functions are rational, and on a part
of a pyramid they are no rational Bernstein functions of that part.

Axis letters: e parent, k child, n coefficient, v vertex, c component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, bernstein, elevation, functions_at
from iga.block import Block
from iga.cells import HEXAHEDRON, TETRAHEDRON, TRIANGLE, WEDGE, Cell
from iga.conforming import Complex, entity_keys, number
from iga.domain import Domain, Facets, Space, homogeneous
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

HIGHEST = 30
"""A degree above this is taken for a typing error."""
LARGEST = 1e9
"""Most Bernstein coefficients (elements times functions of each) of a refined domain: as points they take 24 GB."""

#: Children by the parent's vertices and midpoints, each point as the two vertices it lies between.
_RED = {
    "tetrahedron": (
        ("00", "01", "02", "03"),
        ("01", "11", "12", "13"),
        ("02", "12", "22", "23"),
        ("03", "13", "23", "33"),
        ("01", "02", "03", "13"),
        ("01", "02", "12", "13"),
        ("02", "03", "13", "23"),
        ("02", "12", "13", "23"),
    ),
    "triangle": (("00", "01", "02"), ("01", "11", "12"), ("02", "12", "22"), ("12", "02", "01")),
}


@cache
def simplex_children(cell: Cell) -> Array:
    """Barycentric coordinates (k, v, v) in a triangle or tetrahedron of its children's vertices, all positive."""
    unit = np.eye(len(cell.vertices))
    made = np.array([[(unit[int(p[0])] + unit[int(p[1])]) / 2 for p in child] for child in _RED[cell.name]])
    negative = np.linalg.det(made) < 0
    made[negative] = made[negative][:, [2, 1, 0, *range(3, len(unit))]]
    return made


@cache
def children(cell: Cell) -> Array:
    """Reference coordinates (k, v, d) in the parent of each child's vertices.

    Raises
    ------
    InputError : pyramids have no such children.
    """
    if cell is TETRAHEDRON:
        return simplex_children(cell) @ cell.vertices
    if cell is HEXAHEDRON:
        return (cell.vertices[:, None] + cell.vertices) / 2
    if cell is WEDGE:
        plane = simplex_children(TRIANGLE) @ TRIANGLE.vertices
        made = [
            [[*corner, (half + end) / 2] for corner in triangle for end in (0, 1)]
            for triangle in plane.tolist() for half in (0, 1)
        ]
        return np.array(made)
    raise InputError(f"a {cell.name} cannot be refined exactly")


@cache
def subdivision(basis: Bernstein) -> Array:
    """Matrices (k, n, n) from an element's coefficients to those of its children, in the order of `children`."""
    degree = basis.degree
    if basis.cell is TETRAHEDRON:
        return _simplex_subdivision(TETRAHEDRON, degree[0])
    if basis.cell is HEXAHEDRON:
        factors = [line_subdivision(p) for p in degree]
    elif basis.cell is WEDGE:
        factors = [_simplex_subdivision(TRIANGLE, degree[0]), line_subdivision(degree[1])]
    else:
        raise InputError(f"a {basis.cell.name} cannot be refined exactly")
    made = factors[0]
    for factor in factors[1:]:
        pairs = np.einsum("aij,bkl->abikjl", made, factor)
        made = pairs.reshape(len(made) * len(factor), made.shape[1] * factor.shape[1], -1)
    return made


@cache
def _simplex_subdivision(cell: Cell, degree: int) -> Array:
    return np.stack([blossom_matrix(cell, degree, tuple(map(tuple, c))) for c in simplex_children(cell).tolist()])


@cache
def blossom_matrix(cell: Cell, degree: int, corners: tuple[tuple[float, ...], ...]) -> Array:
    """Matrix (n, n) from a simplex's coefficients to those of the sub-simplex with barycentric ``corners``.

    Row a is the blossom at corner v taken a_v times: the coefficients of prod_v (sum_w corners[v, w] z_w)^{a_v}.
    """
    rows = np.ones((1, 1))
    size = len(cell.vertices)
    for n in range(1, degree + 1):
        low, high = bernstein(cell, n - 1).exponents, bernstein(cell, n).exponents
        place_low = {tuple(a): k for k, a in enumerate(low.tolist())}
        place = {tuple(a): k for k, a in enumerate(high.tolist())}
        unit = np.eye(size, dtype=np.int64)
        raised = np.array([[place[tuple(a)] for a in (low + unit[w]).tolist()] for w in range(size)])
        first = (high > 0).argmax(axis=1)
        before = rows[[place_low[tuple(a)] for a in (high - unit[first]).tolist()]]
        rows = np.zeros((len(high), len(high)))
        for w in range(size):
            rows[:, raised[w]] += np.array(corners)[first, w, None] * before
    return rows


@cache
def line_subdivision(degree: int) -> Array:
    """Matrices (2, n+1, n+1) from a Bezier curve's coefficients to those of its halves."""
    left = np.zeros((degree + 1, degree + 1))
    left[0, 0] = 1.0
    for i in range(1, degree + 1):
        left[i, : i + 1] = (left[i - 1, : i + 1] + np.concatenate([[0.0], left[i - 1, :i]])) / 2
    return np.stack([left, left[::-1, ::-1]])


def refine_coefficients(basis: Bernstein, coefficients: Array) -> Array:
    """Coefficients (8 e, n, c) of the children of elements (e, n, c), those of one parent together."""
    count, n, c = coefficients.shape
    if basis.cell is not HEXAHEDRON:
        matrices = subdivision(basis)
        return np.matmul(matrices.reshape(-1, n), coefficients).reshape(len(matrices) * count, n, c)
    # One direction at a time, last first; each leaves its two children in the place of one index.
    p, q, r = (d + 1 for d in basis.degree)
    first, second, third = (line_subdivision(d).reshape(2 * d + 2, d + 1) for d in basis.degree)
    grid = np.matmul(third, coefficients.reshape(count * p * q, r, c)).reshape(count * p, q, 2 * r * c)
    grid = np.matmul(second, grid).reshape(count, p, 2 * q * 2 * r * c)
    grid = np.matmul(first, grid).reshape(count, 2, p, 2, q, 2, r, c)
    return np.ascontiguousarray(grid.transpose(0, 1, 3, 5, 2, 4, 6, 7)).reshape(8 * count, n, c)


def refine_complex(mesh: Complex) -> Complex:
    """Children of all cells of a mesh (e, v) as (8 e, v).

    Old vertices keep their numbers; midpoints of edges, then centres of quadrilaterals, then of hexahedra follow.
    """
    total = mesh.vertices
    edges = [cell.edges for cell, _ in mesh.parts]
    quadrilaterals = [
        np.array([f.vertices for f in cell.faces if len(f.vertices) == 4], dtype=np.int64).reshape(-1, 4)
        for cell, _ in mesh.parts
    ]
    edge_numbers, count = number_entities(mesh, edges)
    face_numbers, faces = number_entities(mesh, quadrilaterals)
    start = total + count + faces
    parts = []
    for k, (cell, vertices) in enumerate(mesh.parts):
        places = [cell.vertices, cell.vertices[edges[k]].mean(axis=1), cell.vertices[quadrilaterals[k]].mean(axis=1)]
        numbers = [vertices, total + edge_numbers[k], total + count + face_numbers[k]]
        if cell is HEXAHEDRON:
            places.append(cell.centre[None])
            numbers.append(start + np.arange(len(vertices))[:, None])
            start += len(vertices)
        corners = children(cell)
        nearest = np.abs(corners[:, :, None] - np.concatenate(places)).max(axis=-1).argmin(axis=-1)
        parts.append((cell, np.concatenate(numbers, axis=1)[:, nearest].reshape(-1, corners.shape[1])))
    return Complex(tuple(parts))


def number_entities(mesh: Complex, entities: Sequence[Index]) -> tuple[list[Index], int]:
    """Numbers (e, k) of the edges or faces with local vertices ``entities`` (k, m) of each part, and how many."""
    corners = [v[:, local].reshape(-1, local.shape[1]) for (_, v), local in zip(mesh.parts, entities)]
    joined = np.concatenate(corners)
    if not len(joined):
        return [np.zeros((len(v), 0), dtype=np.int64) for _, v in mesh.parts], 0
    unique, inverse = np.unique(entity_keys(joined, mesh.vertices), return_inverse=True)
    cuts = np.cumsum([len(c) for c in corners])[:-1]
    pieces = np.split(np.asarray(inverse, dtype=np.int64).ravel(), cuts)
    return [p.reshape(len(v), -1) for p, (_, v) in zip(pieces, mesh.parts)], len(unique)


@cache
def face_children(cell: Cell) -> Index:
    """For each face of the parent its four children's (child, face), (faces, 4, 2)."""
    corners = children(cell)
    made = []
    for face in cell.faces:
        normal = np.cross(face.axes[:, 0], face.axes[:, 1])
        on = np.abs((corners - face.origin) @ normal) < 1e-12
        made.append(
            [(k, f) for k in range(len(corners)) for f, own in enumerate(cell.faces) if on[k, list(own.vertices)].all()]
        )
    return np.array(made, dtype=np.int64)


def refine_facets(cell: Cell, facets: Index) -> Index:
    """Children (4 f, 2) of facets (f, 2), both as (element, face)."""
    table = face_children(cell)[facets[:, 1]]
    return np.stack([8 * facets[:, :1] + table[..., 0], table[..., 1]], axis=-1).reshape(-1, 2)


# --- domains ----------------------------------------------------------------------------------------------------------


def complex_of(domain: Domain) -> Complex:
    """Straight connectivity of a C0 Bernstein domain: the functions at the vertices are the vertices.

    Raises
    ------
    InputError : the domain is not one: it has extraction, a constraint, or unequal degrees.
    """
    space = domain.space
    degrees = {p for block in space.blocks for p in block.basis.degree}
    if space.constraint is not None or len(degrees) != 1 or any(block.extraction is not None for block in space.blocks):
        raise InputError("only a C0 Bernstein domain of one degree can be refined without its source")
    bases = [block.basis for block in space.blocks]
    corners = [block.dofs[:, functions_at(basis, basis.cell.vertices)] for block, basis in zip(space.blocks, bases)]
    return Complex(tuple((basis.cell, own) for basis, own in zip(bases, corners)))


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a C0 Bernstein domain without changing its shape; spaces are nested.

    Weights, attributes and named boundaries go along.

    Parameters
    ----------
    levels : how often every element is cut into eight.
    elevate : degrees to add.

    Raises
    ------
    InputError : the domain is no C0 Bernstein domain, or has pyramids and ``levels`` is positive.
    """
    if levels < 0 or elevate < 0:
        raise InputError(f"levels {levels} and elevate {elevate} must not be negative")
    mesh, space = complex_of(domain), domain.space
    _require_room(domain, levels, elevate)
    widths = [3] + [int(np.prod(a.shape[1:], dtype=int)) for a in domain.attributes.values()]
    columns = np.column_stack([domain.points, *(a.reshape(space.n, -1) for a in domain.attributes.values())])
    columns = homogeneous(space, columns)
    bases = [bernstein(block.basis.cell, block.basis.degree) for block in space.blocks]
    coefficients = [columns[block.dofs] for block in space.blocks]
    boundaries = dict(domain.boundaries)
    for _ in range(levels):
        coefficients = [refine_coefficients(b, c) for b, c in zip(bases, coefficients)]
        mesh = refine_complex(mesh)
        boundaries = {name: _refined(facets, bases) for name, facets in boundaries.items()}
    if elevate:
        targets = [bernstein(b.cell, tuple(p + elevate for p in b.degree)) for b in bases]
        coefficients = [elevation(b, t.degree) @ c for b, t, c in zip(bases, targets, coefficients)]
        bases = targets
    dofs, n = number(mesh, bases[0].degree[0])
    values = np.empty((n, columns.shape[1]))
    for block, own in zip(dofs, coefficients):
        values[block] = own
    weights = None
    if space.weights is not None:
        weights, values = np.ascontiguousarray(values[:, -1]), values[:, :-1] / values[:, -1:]
    split = np.split(values, np.cumsum(widths)[:-1], axis=1)
    attributes = {
        name: np.ascontiguousarray(own).reshape(n, *old.shape[1:])
        for (name, old), own in zip(domain.attributes.items(), split[1:])
    }
    blocks = tuple(Block(b, d) for b, d in zip(bases, dofs))
    return replace(
        domain, space=Space(blocks, n, weights), points=np.ascontiguousarray(split[0]), boundaries=boundaries,
        attributes=attributes, report={},
    )


def _require_room(domain: Domain, levels: int, elevate: int) -> None:
    """Refuse what would end in want of memory, before it has taken all there is.

    Raises
    ------
    InputError : a degree above `HIGHEST`, or more than `LARGEST` coefficients.
    """
    coefficients = 0
    for block in domain.space.blocks:
        degree = tuple(p + elevate for p in block.basis.degree)
        if max(degree) > HIGHEST:
            raise InputError(f"elevate={elevate} gives degree {max(degree)}; {HIGHEST} is the highest")
        coefficients += len(block.dofs) * 8 ** min(levels, 30) * bernstein(block.basis.cell, degree).n
    if coefficients > LARGEST:
        raise InputError(f"levels={levels}, elevate={elevate} needs {coefficients:.0e} coefficients; take less")


def _refined(facets: tuple[Facets, ...], bases: list[Bernstein]) -> tuple[Facets, ...]:
    made: dict[tuple[int, int], list[Index]] = {}
    for f in facets:
        pairs = np.column_stack([f.elements, np.full(len(f.elements), f.face)])
        fine = refine_facets(bases[f.block].cell, pairs)
        for face in np.unique(fine[:, 1]).tolist():
            made.setdefault((f.block, int(face)), []).append(fine[fine[:, 1] == face, 0])
    return tuple(Facets(b, k, np.sort(np.concatenate(e))) for (b, k), e in sorted(made.items()))
