r"""Refinement of mixed volumes, cell by cell and face to face.

Tetrahedra, hexahedra and wedges are cut into eight as in `iga.refinement`, exactly. A pyramid becomes six pyramids and
four tetrahedra: one pyramid at each corner of the base, one at the apex, one upside down below it with its apex in the
middle of the base, and a tetrahedron at each edge of the base; quadrilaterals are cut in four, triangles in four
(L. Engvall and J. A. Evans, doi:10.1016/j.cma.2017.02.017). A pyramid's functions are rational, so on its children they
are no Bernstein functions, except on the child at the apex and on all faces. Children interpolate the old map at their
domain points:

    P_child = L^-1 B_parent(xi(domain points)) P_parent,      L = B_child(domain points).

The value on a face depends on the points of that face alone, so children fit together and to their neighbours. What is
kept exactly: the boundary, and the map and the space on all cells but pyramids. The refined space has C0 Bernstein
functions everywhere; it contains the skin's functions, which are smoother.

Axis letters: e parent, k child, n coefficient, v vertex, c component, q point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.curving import sized_shapes, unfold
from iga.bernstein import Bernstein, bernstein, elevation, greville, lagrange_to_bernstein
from iga.block import Block, bezier_coefficients
from iga.cells import CELLS, HEXAHEDRON, PYRAMID, TETRAHEDRON, Cell
from iga.certificate import SIGN_ALONE, certify
from iga.conditions import trace_functions
from iga.conforming import Complex, boundary, number
from iga.domain import Domain, Provenance, Space, grouped_facets, homogeneous
from iga.errors import InputError
from iga.refinement import children, number_entities, refine_coefficients

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Bezier:
    """A domain cell by cell: one part for each cell, coefficients with respect to its own Bernstein functions.

    Attributes
    ----------
    mesh : vertex numbers.
    degree : of all cells.
    coefficients : for each part (e, n, c), homogeneous ones if the space is rational.
    facets : names of the boundary with pairs (f, 3) of part, element and face.
    """

    mesh: Complex
    degree: int
    coefficients: tuple[Array, ...]
    facets: Mapping[str, Index]


def mesh_of(domain: Domain) -> Complex:
    """Connectivity of a hybrid volume.

    Raises
    ------
    InputError : the domain does not carry its mesh.
    """
    arrays, blocks = domain.provenance.arrays, domain.space.blocks
    if any(f"corners{k}" not in arrays for k in range(len(blocks))):
        raise InputError("the domain does not carry the mesh of a hybrid volume")
    return Complex(tuple(
        (block.basis.cell, np.asarray(arrays[f"corners{k}"], dtype=np.int64)) for k, block in enumerate(blocks)
    ))


def columns_of(domain: Domain) -> Array:
    """Points and attributes of a domain side by side (n, c), homogeneous and then weights if the space is rational."""
    attributes = [np.asarray(a).reshape(domain.space.n, -1) for a in domain.attributes.values()]
    return homogeneous(domain.space, np.column_stack([domain.points, *attributes]))


def from_columns(domain: Domain, columns: Array) -> tuple[Array, Array | None, dict[str, Array]]:
    """Points (n, 3), weights (n,) if there are any, and attributes from columns (n, c) such as `columns_of` makes."""
    weights = None
    if domain.space.weights is not None:
        weights, columns = np.ascontiguousarray(columns[:, -1]), columns[:, :-1] / columns[:, -1:]
    attributes, at = {}, 3
    for name, given in domain.attributes.items():
        shape = np.shape(given)[1:]
        size = int(np.prod(shape, dtype=int))
        attributes[name] = np.ascontiguousarray(columns[:, at : at + size]).reshape(-1, *shape)
        at += size
    return np.ascontiguousarray(columns[:, :3]), weights, attributes


def bezier_of(domain: Domain) -> Bezier:
    """Bernstein coefficients of a domain's points and attributes.

    Raises
    ------
    InputError : the domain does not carry its mesh, or cells differ in degree.
    """
    space, given = domain.space, mesh_of(domain).parts
    degrees = {p for block in space.blocks for p in block.basis.degree}
    if len(degrees) != 1:
        raise InputError(f"the cells of the domain have degrees {sorted(degrees)}, not one")
    columns = columns_of(domain)
    place = np.zeros((len(space.blocks), 2), dtype=np.int64)
    parts: list[tuple[Cell, Index]] = []
    coefficients: list[Array] = []
    for name in CELLS:
        mine = [k for k, block in enumerate(space.blocks) if block.basis.cell.name == name]
        if not mine:
            continue
        sizes = np.array([space.blocks[k].elements for k in mine])
        place[mine] = np.column_stack([np.full(len(mine), len(parts)), np.cumsum(sizes) - sizes])
        parts.append((CELLS[name], np.concatenate([given[k][1] for k in mine])))
        coefficients.append(np.concatenate([bezier_coefficients(space.blocks[k], columns) for k in mine]))
    facets = {
        name: np.concatenate([np.zeros((0, 3), dtype=np.int64), *(
            np.column_stack([
                np.full(len(f.elements), place[f.block, 0]), place[f.block, 1] + f.elements,
                np.full(len(f.elements), f.face),
            ]) for f in own
        )]) for name, own in domain.boundaries.items()
    }
    return Bezier(Complex(tuple(parts)), degrees.pop(), tuple(coefficients), facets)


# --- pyramids ---------------------------------------------------------------------------------------------------------

_BASE = PYRAMID.vertices[:4]
_MIDDLE = np.array([0.5, 0.5, 0.0])


@cache
def pyramid_children() -> tuple[Array, Array]:
    """Vertices in the parent of a pyramid's six pyramids (6, 5, 3) and four tetrahedra (4, 4, 3), all positive."""
    apex = PYRAMID.vertices[4]
    lateral = (_BASE + apex) / 2
    pyramids = [np.vstack([(corner + _BASE) / 2, lateral[k]]) for k, corner in enumerate(_BASE)]
    pyramids.append(np.vstack([lateral, apex]))
    pyramids.append(np.vstack([lateral[[0, 2, 1, 3]], _MIDDLE]))
    ring = (0, 2, 3, 1)
    tets = []
    for a, b in zip(ring, (*ring[1:], ring[0])):
        tet = np.stack([(_BASE[a] + _BASE[b]) / 2, lateral[a], lateral[b], _MIDDLE])
        if np.linalg.det(tet[1:] - tet[0]) < 0:
            tet = tet[[1, 0, 2, 3]]
        tets.append(tet)
    return np.array(pyramids), np.array(tets)


@cache
def pyramid_matrices(degree: int) -> tuple[Array, Array]:
    """Matrices (6, n, n) and (4, m, n) from a pyramid's coefficients to those of its pyramids and tetrahedra."""
    parent = bernstein(PYRAMID, degree)
    made = []
    for cell, vertices in zip((PYRAMID, TETRAHEDRON), pyramid_children()):
        child = bernstein(cell, degree)
        points = greville(child)
        inverse = lagrange_to_bernstein(child, points)
        shape = bernstein(cell, 1).tabulate(points, 0)[0]
        made.append(np.stack([inverse @ parent.tabulate(shape @ own, 0)[0] for own in vertices]))
    return made[0], made[1]


def pyramid_deviation(degree: int, coefficients: Array, samples: int = 6) -> float:
    """Largest distance between pyramids (e, n, c) and their children at points inside, in the first 3 components."""
    parent = bernstein(PYRAMID, degree)
    random = np.random.default_rng(20193)
    worst = 0.0
    for cell, vertices, matrices in zip((PYRAMID, TETRAHEDRON), pyramid_children(), pyramid_matrices(degree)):
        weights = random.dirichlet(np.ones(len(cell.vertices)), samples)
        points = weights @ cell.vertices
        shape = bernstein(cell, 1).tabulate(points, 0)[0]
        values = bernstein(cell, degree).tabulate(points, 0)[0]
        for own, matrix in zip(vertices, matrices):
            old = parent.tabulate(shape @ own, 0)[0]
            off = np.matmul(old - values @ matrix, coefficients[..., :3])
            worst = max(worst, float(np.linalg.norm(off, axis=2).max(initial=0.0)))
    return worst


# --- one level --------------------------------------------------------------------------------------------------------


def cell_children(cell: Cell) -> tuple[tuple[Cell, Array], ...]:
    """Children of a cell: cells and their vertices (k, v, d) in the parent."""
    if cell is PYRAMID:
        pyramids, tets = pyramid_children()
        return (PYRAMID, pyramids), (TETRAHEDRON, tets)
    return ((cell, children(cell)),)


def refined(old: Bezier) -> Bezier:
    """Children of all cells. Each part's children stay together, those of one parent one after the other."""
    mesh, total = old.mesh, old.mesh.vertices
    edges = [cell.edges for cell, _ in mesh.parts]
    quads = [
        np.array([f.vertices for f in cell.faces if len(f.vertices) == 4], dtype=np.int64).reshape(-1, 4)
        for cell, _ in mesh.parts
    ]
    on_edges, count = number_entities(mesh, edges)
    on_quads, faces = number_entities(mesh, quads)
    start = total + count + faces
    vertices: dict[str, list[Index]] = {}
    values: dict[str, list[Array]] = {}
    sizes: dict[str, int] = {}
    first: list[dict[str, int]] = []
    for k, (cell, own) in enumerate(mesh.parts):
        places = [cell.vertices, cell.vertices[edges[k]].mean(axis=1), cell.vertices[quads[k]].mean(axis=1)]
        numbers = [own, total + on_edges[k], total + count + on_quads[k]]
        if cell is HEXAHEDRON:
            places.append(cell.centre[None])
            numbers.append(start + np.arange(len(own))[:, None])
            start += len(own)
        joined, known = np.concatenate(places), np.concatenate(numbers, axis=1)
        made = _coefficients(bernstein(cell, old.degree), old.coefficients[k])
        first.append({})
        for (child, corners), fine in zip(cell_children(cell), made):
            nearest = np.abs(corners[:, :, None] - joined).max(axis=-1).argmin(axis=-1)
            vertices.setdefault(child.name, []).append(known[:, nearest].reshape(-1, corners.shape[1]))
            values.setdefault(child.name, []).append(fine)
            first[k][child.name] = sizes.get(child.name, 0)
            sizes[child.name] = first[k][child.name] + len(fine)
    names = [name for name in CELLS if name in vertices]
    parts = tuple((CELLS[name], np.concatenate(vertices[name])) for name in names)
    facets = {
        name: _facets(mesh, own, first, {n: k for k, n in enumerate(names)}) for name, own in old.facets.items()
    }
    return Bezier(Complex(parts), old.degree, tuple(np.concatenate(values[name]) for name in names), facets)


def _coefficients(basis: Bernstein, coefficients: Array) -> list[Array]:
    """Coefficients of the children of each kind, those of one parent together."""
    if basis.cell is not PYRAMID:
        return [refine_coefficients(basis, coefficients)]
    made = []
    for matrices in pyramid_matrices(basis.degree[0]):
        k, m, n = matrices.shape
        fine = np.matmul(matrices.reshape(k * m, n), coefficients)
        made.append(fine.reshape(len(coefficients) * k, m, coefficients.shape[2]))
    return made


@cache
def _face_children(name: str) -> tuple[tuple[tuple[str, int, int, int], ...], ...]:
    """For each face of a cell its four children: cell, number among its kind, kind's count, face."""
    result = []
    for face in CELLS[name].faces:
        normal = np.cross(face.axes[:, 0], face.axes[:, 1])
        rows = []
        for child, corners in cell_children(CELLS[name]):
            on = np.abs((corners - face.origin) @ normal) < 1e-12
            for k in range(len(corners)):
                rows += [
                    (child.name, k, len(corners), f)
                    for f, own in enumerate(child.faces) if on[k, list(own.vertices)].all()
                ]
        result.append(tuple(rows))
    return tuple(result)


def _facets(mesh: Complex, facets: Index, first: list[dict[str, int]], part: Mapping[str, int]) -> Index:
    made = [np.zeros((0, 3), dtype=np.int64)]
    for k, (cell, _) in enumerate(mesh.parts):
        for face, rows in enumerate(_face_children(cell.name)):
            own = facets[(facets[:, 0] == k) & (facets[:, 2] == face), 1]
            for name, child, count, f in rows if len(own) else ():
                numbers = first[k][name] + count * own + child
                made.append(np.column_stack([np.full(len(own), part[name]), numbers, np.full(len(own), f)]))
    return np.concatenate(made)


# --- domains ----------------------------------------------------------------------------------------------------------


def domain_of(old: Domain, fine: Bezier, report: Mapping[str, Any]) -> Domain:
    """Domain with C0 Bernstein functions; attributes and provenance are those of ``old``."""
    dofs, n = number(fine.mesh, fine.degree)
    width = fine.coefficients[0].shape[2]
    values = np.empty((n, width))
    for own, coefficients in zip(dofs, fine.coefficients):
        values[own] = coefficients
    points, weights, attributes = from_columns(old, values)
    boundaries = {name: grouped_facets(own) for name, own in fine.facets.items()}
    corners = {f"corners{k}": own for k, (_, own) in enumerate(fine.mesh.parts)}
    kept = {k: v for k, v in old.provenance.arrays.items() if not k.startswith(("corners", "tets"))}
    origin = old.provenance
    return Domain(
        Space(tuple(Block(bernstein(c, fine.degree), d) for (c, _), d in zip(fine.mesh.parts, dofs)), n, weights),
        points, boundaries, attributes,
        Provenance(origin.source, origin.input, origin.parameters, {**kept, **corners}), {**old.report, **report},
    )


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a hybrid volume; see the module docstring for what stays.

    Parameters
    ----------
    levels : how often every cell is cut.
    elevate : degrees to add, exactly.

    Raises
    ------
    InputError : the domain is no hybrid volume, or a number is negative.
    """
    if levels < 0 or elevate < 0:
        raise InputError(f"levels {levels} and elevate {elevate} must not be negative")
    now = bezier_of(domain)
    size = float(np.linalg.norm(np.ptp(domain.points, axis=0))) or 1.0
    deviation = 0.0
    for _ in range(levels):
        for (cell, _), coefficients in zip(now.mesh.parts, now.coefficients):
            if cell is PYRAMID:
                deviation = max(deviation, pyramid_deviation(now.degree, coefficients) / size)
        now = refined(now)
    if elevate:
        high = now.degree + elevate
        raised = tuple(
            elevation(bernstein(cell, now.degree), bernstein(cell, high).degree) @ own
            for (cell, _), own in zip(now.mesh.parts, now.coefficients)
        )
        now = replace(now, degree=high, coefficients=raised)
    fine = domain_of(domain, now, {
        "levels": int(domain.report.get("levels", 0)) + levels, "pyramid_deviation": deviation, "smoothness": 0,
    })
    return certified(fine)


def certified(domain: Domain) -> Domain:
    """The domain with inner control points moved where elements are not certified, and how many stay so."""
    if (certify(domain, SIGN_ALONE).verdict > 0).all():
        return replace(domain, report={**domain.report, "not_certified": 0})
    free = np.ones(domain.space.n, dtype=bool)
    free[trace_functions(domain, boundary(mesh_of(domain)))] = False
    moved = unfold(domain, free, sized_shapes(domain))
    return replace(domain, points=moved.points, report={**domain.report, "not_certified": len(moved.invalid)})
