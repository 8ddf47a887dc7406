"""Domains from tet meshes: spaces, boundaries, conversion, refinement."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.tet_to_hex import hex_to_tet_points
from geometry.tets.domain import domain_of
from geometry.tets.mesh import TetMesh, checked_mesh
from geometry.tets.shapes import ball, cube, mapped
from geometry.tets.source import build, reads, refine
from iga.bernstein import bernstein, face_functions
from iga.block import bezier_coefficients
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.domain import Domain, check
from iga.errors import InputError
from iga.quadrature import gauss
from iga.refinement import (
    blossom_matrix,
    children,
    face_children,
    line_subdivision,
    refine_coefficients,
    simplex_children,
    subdivision,
)

CONVERSIONS = ["none", "hex4", "hex1"]


def bend(x: np.ndarray) -> np.ndarray:
    return x + 0.08 * np.sin(2 * x[..., [1, 2, 0]]) * np.cos(x[..., [2, 0, 1]])


def volume(domain: Domain) -> float:
    block = domain.space.blocks[0]
    n = block.basis.degree[0]
    rule = gauss(block.basis.cell, (3 * n) // 2 + 2)
    slopes = block.basis.tabulate(rule.points)[1]
    J = np.einsum("qbd,ebc->eqcd", slopes, bezier_coefficients(block, domain.points), optimize=True)
    return float((np.linalg.det(J) @ rule.weights).sum())


def closing(domain: Domain) -> tuple[float, np.ndarray]:
    """Divergence theorem on the named boundaries: volume, and the integral of the normal."""
    block = domain.space.blocks[0]
    coefficients = bezier_coefficients(block, domain.points)
    total, normal = 0.0, np.zeros(3)
    for facets in domain.boundaries.values():
        for f in facets:
            trace, functions = face_functions(block.basis, f.face)
            rule = gauss(trace.cell, (3 * trace.degree[0]) // 2 + 2)
            values, slopes = trace.tabulate(rule.points)
            face = coefficients[f.elements][:, functions]
            x = np.einsum("qb,ebc->eqc", values, face)
            t = np.einsum("qbd,ebc->eqdc", slopes, face)
            area = np.cross(t[:, :, 0], t[:, :, 1])
            total += float(np.einsum("eqc,eqc,q->", x, area, rule.weights)) / 3
            normal += np.einsum("eqc,q->c", area, rule.weights)
    return total, normal


def evaluate(domain: Domain, points: np.ndarray) -> np.ndarray:
    block = domain.space.blocks[0]
    return np.einsum("qb,ebc->eqc", block.basis.tabulate(points, 0)[0], bezier_coefficients(block, domain.points))


@pytest.mark.parametrize("convert", CONVERSIONS)
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_domains_are_closed_and_keep_the_volume(convert, degree):
    mesh = mapped(cube(2), bend, degree)
    exact = volume(domain_of(mesh))
    domain = domain_of(mesh, convert)
    check(domain)
    assert set(domain.boundaries) == {"x0", "x1", "y0", "y1", "z0", "z1"}
    assert volume(domain) == pytest.approx(exact, rel=1e-13)
    by_boundary, normal = closing(domain)
    assert by_boundary == pytest.approx(exact, rel=1e-12)
    assert np.abs(normal).max() < 1e-13
    facets = sum(len(f.elements) for b in domain.boundaries.values() for f in b)
    assert facets == 48 * (3 if convert == "hex4" else 1)
    if convert != "none":
        assert domain.report["conversion_residual"] < 1e-14


def test_number_of_functions():
    mesh = cube(2)  # 27 vertices, 98 edges, 120 faces, 48 tetrahedra
    for p, expected in ((1, 27), (2, 125), (3, 343), (4, 729)):
        assert domain_of(mesh, degree=p).space.n == expected
        assert domain_of(mesh, "hex1", degree=p).space.n == expected
    for p in (1, 2, 3):
        # The hexahedral complex: vertices + edges + faces + bodies, then its own entities.
        vertices, hexes, quads = 27 + 98 + 120 + 48, 4 * 48, 3 * 120 + 6 * 48
        edges = 2 * 98 + 3 * 120 + 4 * 48
        count = vertices + edges * (p - 1) + quads * (p - 1) ** 2 + hexes * (p - 1) ** 3
        assert domain_of(mesh, "hex4", degree=p).space.n == count


def test_hexes_evaluate_as_their_tetrahedra():
    mesh = ball(0, 4)
    points = np.random.default_rng(13).random((100, 3))
    tets = bernstein(TETRAHEDRON, 4)
    hexes = evaluate(domain_of(mesh, "hex4"), points).reshape(-1, 4, 100, 3)
    for m, where in enumerate(hex_to_tet_points(points)):
        exact = np.einsum("qb,ebc->eqc", tets.tabulate(where, 0)[0], mesh.coefficients)
        assert np.abs(hexes[:, m] - exact).max() < 5e-15


def test_shared_control_points_agree_to_the_last_digits():
    """Numbering by topology never averages: what the last hexahedron wrote, its neighbours would have written too."""
    from geometry.tet_to_hex import tets_to_hexes

    mesh = mapped(ball(1, 3), bend)
    domain = domain_of(mesh, "hex4")
    written = domain.points[domain.space.blocks[0].dofs]
    own = tets_to_hexes(mesh.coefficients).reshape(written.shape)
    assert np.abs(written - own).max() <= 1e-15 * np.abs(own).max()


@pytest.mark.parametrize("convert", CONVERSIONS)
def test_refinement_changes_nothing_but_the_space(convert):
    mesh = mapped(cube(1), bend, 3)
    domain = domain_of(mesh, convert)
    exact = volume(domain)
    for levels, elevate in ((1, 0), (0, 2), (2, 1)):
        finer = refine(domain, levels, elevate)
        check(finer)
        assert volume(finer) == pytest.approx(exact, rel=1e-12)
        by_boundary, _ = closing(finer)
        assert by_boundary == pytest.approx(exact, rel=1e-12)
        assert set(finer.boundaries) == set(domain.boundaries)
        assert finer.space.blocks[0].elements == domain.space.blocks[0].elements * 8**levels
        assert finer.provenance.parameters["degree"] == 3 + elevate
    assert refine(domain).space.n == (7**3 if convert != "hex4" else refine(domain).space.n)
    again = refine(refine(domain), 1, 1)
    assert again.space.n == refine(domain, 2, 1).space.n
    assert np.allclose(np.sort(again.points, axis=0), np.sort(refine(domain, 2, 1).points, axis=0), atol=1e-14)


def test_subdivision_matrices_are_convex_and_dyadic():
    for n in range(1, 7):
        for matrix in subdivision(bernstein(TETRAHEDRON, n)):
            assert matrix.min() >= 0
            assert np.array_equal(matrix.sum(axis=1), np.ones(len(matrix)))
            assert np.array_equal(matrix * 2.0**n, np.rint(matrix * 2.0**n))
        for matrix in line_subdivision(n):
            assert np.array_equal(matrix.sum(axis=1), np.ones(n + 1))
    identity = blossom_matrix(TETRAHEDRON, 3, tuple(map(tuple, np.eye(4).tolist())))
    assert np.array_equal(identity, np.eye(20))


def test_children_fill_their_parent():
    assert np.allclose(np.linalg.det(simplex_children(TETRAHEDRON)), 1 / 8)
    assert children(HEXAHEDRON).min() == 0
    for cell in (TETRAHEDRON, HEXAHEDRON):
        table = face_children(cell)
        assert table.shape == (len(cell.faces), 4, 2)
        assert all(len(set(row[:, 0].tolist())) == 4 for row in table)


def shape(coefficients: np.ndarray) -> np.ndarray:
    """Six edge lengths of each tetrahedron over the cube root of its volume, sorted."""
    edges = np.linalg.norm(
        coefficients[:, TETRAHEDRON.edges[:, 1]] - coefficients[:, TETRAHEDRON.edges[:, 0]], axis=2
    )
    volumes = np.linalg.det(coefficients[:, 1:] - coefficients[:, :1])
    assert (volumes > 0).all()
    return np.sort(edges / np.cbrt(volumes)[:, None], axis=1)


@pytest.mark.parametrize("seed", [3, 5, 7, 9])
def test_red_refinement_makes_at_most_three_shapes(seed):
    tet = np.random.default_rng(seed).standard_normal((1, 4, 3))
    if np.linalg.det(tet[0, 1:] - tet[0, 0]) < 0:
        tet = tet[:, [0, 3, 2, 1]]
    shapes = []
    for _ in range(4):
        tet = refine_coefficients(bernstein(TETRAHEDRON, 1), tet)
        shapes.append(shape(tet))
    assert len(np.unique(np.round(np.concatenate(shapes), 9), axis=0)) <= 3


def test_refinement_keeps_fields_given_with_the_geometry():
    domain = domain_of(mapped(cube(1), bend, 2))
    field = domain.points @ np.array([1.0, 2.0, 3.0])
    pair = np.column_stack([field, field**2])
    from dataclasses import replace

    finer = refine(replace(domain, attributes={"k": field, "pair": pair}), 1, 1)
    assert finer.attributes["k"].shape == (finer.space.n,)
    assert np.abs(finer.attributes["k"] - finer.points @ np.array([1.0, 2.0, 3.0])).max() < 1e-14
    assert finer.attributes["pair"].shape == (finer.space.n, 2)


def test_smooth_parts_by_angle():
    domain = domain_of(TetMesh(*_plain(cube(2))), angle=30)
    assert sorted(domain.boundaries) == [f"boundary_{k}" for k in range(6)]
    assert all(sum(len(f.elements) for f in b) == 8 for b in domain.boundaries.values())
    assert list(domain_of(ball(0, 4), angle=30).boundaries) == ["sphere_0"]
    # The facets of the straight octahedron meet at 70.5 degrees.
    assert len(domain_of(ball(0, 1), angle=70).boundaries) == 8
    assert len(domain_of(ball(0, 1), angle=71).boundaries) == 1
    with pytest.raises(InputError, match="angle"):
        domain_of(cube(1), angle=0)


def _plain(mesh: TetMesh) -> tuple:
    merged = np.concatenate(list(mesh.boundaries.values()))
    return mesh.vertices, mesh.coefficients, {"boundary": merged}, {}


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"convert": "hex8"}, "hex8"),
        ({"degree": 1}, "lower"),
        ({"degree": "two"}, "degree"),
        ({"degree": 0}, "degree"),
        ({"angle": "flat"}, "angle"),
        ({"tags": "maybe"}, "tags"),
        ({"converting": "hex4"}, "converting"),
    ],
)
def test_parameters_are_checked(parameters, word, data):
    with pytest.raises(InputError, match=word):
        build(data / "tet" / "sphere_P2.msh", **parameters)


def test_shapes_by_name():
    assert build("cube", n=1, degree=3).space.n == 64
    solid = build("ball", n="1", degree="4", convert="hex4")
    assert volume(refine(solid)) == pytest.approx(4 / 3 * np.pi, rel=1e-3)
    assert list(solid.boundaries) == ["sphere"]
    assert reads("ball")
    with pytest.raises(InputError, match="'n'"):
        build("cube.msh", n=2)


def test_other_domains_are_not_refined():
    from dataclasses import replace

    from iga.domain import Provenance

    domain = domain_of(cube(1))
    with pytest.raises(InputError, match="nurbs"):
        refine(replace(domain, provenance=Provenance("nurbs")))
    with pytest.raises(InputError, match="negative"):
        refine(domain, -1)


def test_tetrahedra_that_do_not_fit_together_are_refused():
    mesh = ball(0, 2)
    coefficients = mesh.coefficients.copy()
    exponents = bernstein(TETRAHEDRON, 2).exponents
    coefficients[3, (exponents == 1).sum(axis=1) == 2] += 0.01
    for convert in CONVERSIONS:
        with pytest.raises(InputError, match="disagree on a shared curved face"):
            domain_of(TetMesh(mesh.vertices, coefficients, mesh.boundaries), convert)


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("sphere_P2.msh", 4.11457), ("sphere_P4.msh", 4.18886), ("sphere_fine_P3.msh", 0.523629),
        ("escher_P2.vtk", 6.38686), ("bunny.mesh", 27526.9), ("spot.mesh", 0.71679), ("torus.msh", 0.0726544),
        ("unit_cell.msh", 0.104),
    ],
)
def test_real_meshes(file, expected, data):
    for convert in CONVERSIONS:
        domain = build(data / "tet" / file, convert=convert)
        assert volume(domain) == pytest.approx(expected, rel=3e-6)
        if convert != "none":
            assert domain.report["conversion_residual"] < 1e-14
        if file.startswith("sphere"):
            assert closing(domain)[0] == pytest.approx(volume(domain), rel=1e-12)


def test_a_solid_that_touches_itself_along_an_edge_is_reported():
    """Two tetrahedra with one edge in common: four boundary triangles meet there."""
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], dtype=float)
    vertices = np.array([[0, 2, 3, 1], [0, 4, 5, 1]])
    mesh = checked_mesh(vertices, points[vertices])
    assert mesh.report["non_manifold_edges"] == "1, the first between vertices 0 and 1"
    assert "non_manifold_edges" not in cube(2).report
