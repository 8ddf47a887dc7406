r"""Domains of Bezier tet meshes, as they stand or converted to hexahedra.

    convert = "none"   C0 Bezier tetrahedra, extraction the identity
    convert = "hex4"   four hexahedra for each tetrahedron (Theorem 3), conforming, with their own C0 space
    convert = "hex1"   one degenerate hexahedron for each tetrahedron (Theorem 1)

A degenerate hexahedron carries the functions of its tetrahedron: with P = M T the tetrahedral function i is the
combination sum_b M[b, i] B_b of hexahedral Bernstein functions, so the extraction C = M^T makes the space *equal* to
the tetrahedral one, glued exactly as that is. (All (n+1)^3 Bernstein functions would not do: they have no common value
where the hexahedron collapses, so their gradients are unbounded there.)

Axis letters: e element, n function, b Bernstein function, f facet, c component.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.tet_to_hex import (
    degenerate_matrix,
    degenerate_to_tet_points,
    hex_matrices,
    hex_to_tet_points,
    tets_to_hexes,
)
from geometry.tet_to_hex_mesh import DEGENERATE_FACES, hex_facets, hex_vertices
from geometry.tets.boundary import split_by_angle
from geometry.tets.mesh import TetMesh
from iga.bernstein import bernstein, elevation
from iga.block import Block, Patterns
from iga.cells import HEXAHEDRON, TETRAHEDRON, Cell
from iga.conforming import Complex, number
from iga.domain import Domain, Facets, Provenance, Space
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Name of the source, as domains carry it.
SOURCE = "tets"
CONVERSIONS = ("none", "hex4", "hex1")
#: Elements whose coefficients are made at a time.
_CHUNK = 20_000


def domain_of(
    mesh: TetMesh,
    convert: str = "none",
    degree: int | None = None,
    angle: float | None = None,
    source: str = "",
    tags: bool = True,
) -> Domain:
    """Domain of a mesh of Bezier tetrahedra; see `build` for the parameters.

    Raises
    ------
    InputError : the degree is lower than the mesh's, or neighbours do not agree on a shared curved face.
    """
    check_convert(convert)
    target = mesh.degree if degree is None else degree
    if target < mesh.degree:
        raise InputError(f"degree {target} is lower than the mesh's degree {mesh.degree}; degrees can only be raised")
    boundaries = dict(mesh.boundaries)
    if angle is not None:
        boundaries = split_by_angle(mesh, angle)
    coefficients = raised(TETRAHEDRON, mesh.degree, target, mesh.coefficients)
    parameters: dict[str, Any] = {"convert": convert, "degree": target, "tags": tags}
    if angle is not None:
        parameters["angle"] = angle
    report = dict(mesh.report)
    if convert != "none":
        report["conversion_residual"] = conversion_residual(coefficients, target, convert)
    if convert == "hex4":
        cells, vertices = HEXAHEDRON, hex_vertices(mesh.vertices)
        boundaries = {key: hex_facets(facets) for key, facets in boundaries.items()}
    else:
        cells, vertices = TETRAHEDRON, mesh.vertices
    space = space_of(cells, vertices, target, convert)
    points = points_of(space, coefficients, convert == "hex4")
    _check_gap(space, points, coefficients, convert == "hex4")
    provenance = Provenance(SOURCE, source, parameters)
    return Domain(space, points, facets_from(boundaries, convert), provenance=provenance, report=report)


def conversion_residual(coefficients: Array, degree: int, convert: str, seed: int = 20183) -> float:
    """Largest distance between tetrahedra and their hexahedra over random points, relative to the size of the mesh.

    Parameters
    ----------
    coefficients : (e, C, 3); at most 2000 tetrahedra are compared, each at 32 points per hexahedron.
    """
    random = np.random.default_rng(seed)
    sample = coefficients[np.unique(np.linspace(0, len(coefficients) - 1, 2000).astype(np.int64))]
    points = random.random((32, 3))
    if convert == "hex1":
        matrices, targets = degenerate_matrix(degree)[None], degenerate_to_tet_points(points)[None]
    else:
        matrices, targets = hex_matrices(degree), hex_to_tet_points(points)
    values = bernstein(HEXAHEDRON, degree).tabulate(points, 0)[0]
    worst = 0.0
    for matrix, target in zip(matrices, targets):
        exact = bernstein(TETRAHEDRON, degree).tabulate(target, 0)[0] @ sample
        worst = max(worst, float(np.linalg.norm(values @ (matrix @ sample) - exact, axis=2).max()))
    return worst / _size(coefficients)


def space_of(cell: Cell, vertices: Index, degree: int, convert: str) -> Space:
    """C0 Bernstein space on the mesh; degenerate hexahedra carry the functions of their tetrahedra."""
    (dofs,), n = number(Complex(((cell, vertices),)), degree)
    return Space((_degenerate(dofs, degree) if convert == "hex1" else Block(bernstein(cell, degree), dofs),), n)


def _degenerate(dofs: Index, degree: int) -> Block:
    C = np.ascontiguousarray(degenerate_matrix(degree).T)[None]
    return Block(bernstein(HEXAHEDRON, degree), dofs, Patterns(C, np.zeros(len(dofs), dtype=np.int64)))


def as_tets(domain: Domain) -> Domain:
    """Return the tetrahedra that a domain of degenerate hexahedra was made from."""
    block = domain.space.blocks[0]
    own = Block(bernstein(TETRAHEDRON, block.basis.degree[0]), block.dofs)
    boundaries = {key: pairs_from(facets, "hex1") for key, facets in domain.boundaries.items()}
    return replace(domain, space=Space((own,), domain.space.n), boundaries=facets_from(boundaries, "none"))


def as_degenerate_hexes(domain: Domain) -> Domain:
    """Return a domain of tetrahedra as degenerate hexahedra."""
    block = domain.space.blocks[0]
    own = _degenerate(block.dofs, block.basis.degree[0])
    boundaries = {key: pairs_from(facets, "none") for key, facets in domain.boundaries.items()}
    return replace(domain, space=Space((own,), domain.space.n), boundaries=facets_from(boundaries, "hex1"))


def _local(coefficients: Array, elements: int, to_hexes: bool) -> Iterator[tuple[slice, Array]]:
    """Element coefficients chunk by chunk, those of tetrahedra turned into hexahedra on the way."""
    step = 4 if to_hexes else 1
    for start in range(0, elements // step, _CHUNK):
        part = coefficients[start : start + _CHUNK]
        values = tets_to_hexes(part) if to_hexes else part
        yield slice(step * start, step * (start + len(part))), values.reshape(step * len(part), -1, part.shape[2])


def points_of(space: Space, coefficients: Array, to_hexes: bool = False) -> Array:
    """Control points (n, c) from the coefficients of elements."""
    points = np.empty((space.n, coefficients.shape[2]))
    dofs = space.blocks[0].dofs
    for rows, values in _local(coefficients, len(dofs), to_hexes):
        points[dofs[rows]] = values
    return points


def _check_gap(space: Space, points: Array, coefficients: Array, to_hexes: bool) -> None:
    """Neighbours must agree on the coefficients they share."""
    dofs = space.blocks[0].dofs
    size = _size(coefficients)
    for rows, values in _local(coefficients, len(dofs), to_hexes):
        gap = np.abs(points[dofs[rows]] - values).max(axis=(1, 2))
        if gap.max() > 1e-9 * size:
            element = rows.start + int(gap.argmax())
            raise InputError(
                f"tetrahedron {element // 4 if to_hexes else element} and a neighbour disagree on a shared curved face "
                f"by {gap.max():.2g}; the mesh does not fit together"
            )


def facets_from(boundaries: Mapping[str, Index], convert: str) -> dict[str, tuple[Facets, ...]]:
    """Named facets from pairs (f, 2) of element and face."""
    made = {}
    for key, pairs in boundaries.items():
        faces = DEGENERATE_FACES[pairs[:, 1]] if convert == "hex1" else pairs[:, 1]
        made[key] = tuple(Facets(0, int(k), np.sort(pairs[faces == k, 0])) for k in np.unique(faces))
    return made


def pairs_from(facets: tuple[Facets, ...], convert: str) -> Index:
    """Pairs (f, 2) of element and face from facets; faces of degenerate hexahedra become those of tetrahedra."""
    back = {int(k): i for i, k in enumerate(DEGENERATE_FACES)}
    parts = [np.zeros((0, 2), dtype=np.int64)]
    for f in facets:
        face = back[f.face] if convert == "hex1" else f.face
        parts.append(np.column_stack([f.elements, np.full(len(f.elements), face)]))
    return np.concatenate(parts)


def raised(cell: Cell, low: int, high: int, coefficients: Array) -> Array:
    """Coefficients in a higher degree."""
    if low == high:
        return coefficients
    basis = bernstein(cell, low)
    return np.matmul(elevation(basis, bernstein(cell, high).degree), coefficients)


def _size(coefficients: Array) -> float:
    """Diagonal of the bounding box."""
    low, high = coefficients.min(axis=(0, 1)), coefficients.max(axis=(0, 1))
    return float(np.linalg.norm(high - low)) or 1.0


def check_convert(convert: str) -> None:
    """Refuse a conversion that does not exist."""
    if convert not in CONVERSIONS:
        raise InputError(f"convert {convert!r} is unknown; there are: {', '.join(CONVERSIONS)}")
