"""The interpolating four-point scheme against tricubic Lagrange interpolation and its own symmetries."""

from __future__ import annotations

import numpy as np
import pytest

import geometry.catmull_clark as source
from geometry.catmull_clark.butterfly import butterfly, ring_weights
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan, tetrahedron
from geometry.catmull_clark.subdivision import subdivide
from iga.domain import check

MESHES = {"box": box(3, 3, 4), "ball": ball(), "fan 3": fan(3), "fan 5": fan(5), "cross 5": cross_of_tetrahedra(5),
          "tetrahedron": tetrahedron()}


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", MESHES)
def test_vertices_stay_and_linear_data_on_the_mesh_line_up(name: str, features: str) -> None:
    points, cells = MESHES[name]
    t = with_features(hex_mesh(points, cells).topology, points, features)
    fine, S = butterfly(t)
    assert abs(S[: t.vertices] - np.eye(t.vertices)).max() == 0
    np.testing.assert_allclose(S.sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_array_equal(fine.hexes, subdivide(t)[0].hexes)
    again = butterfly(fine)[1] @ (S @ points)
    np.testing.assert_array_equal(again[: t.vertices], points)


def test_regular_points_are_tricubic_lagrange() -> None:
    """Inside a box every new point is the tensor product of (-1, 9, 9, -1)/16."""
    points, cells = box(5, 5, 5)
    t = hex_mesh(points, cells).topology
    S = butterfly(t)[1]
    line = {0.5: {-1: -1 / 16, 0: 9 / 16, 1: 9 / 16, 2: -1 / 16}, 0.0: {0: 1.0}}
    new = 0.5 * np.rint(2.0 * (subdivide(t)[1] @ points))
    inside = np.flatnonzero(((new > 1) & (new < 4)).all(axis=1))
    assert len(inside) == 5**3
    for row in inside:
        expected = np.zeros((6, 6, 6))
        low, part = np.floor(new[row]).astype(int), new[row] % 1.0
        for i, a in line[part[0]].items():
            for j, b in line[part[1]].items():
                for k, c in line[part[2]].items():
                    expected[low[0] + i, low[1] + j, low[2] + k] = a * b * c
        np.testing.assert_allclose(S[[row]].toarray()[0], expected.ravel(), atol=1e-15)


@pytest.mark.parametrize("features", ["auto", "none"])
def test_polynomials_of_a_box_are_reproduced(features: str) -> None:
    """Cubics where lines go on, quadratics at sharp ends, everywhere."""
    points, cells = box(4, 4, 4)
    t = with_features(hex_mesh(points, cells).topology, points, features)
    S = butterfly(t)[1]
    new = S @ points
    if features == "auto":
        np.testing.assert_allclose(new, 0.5 * np.rint(2.0 * new), atol=1e-14)
        quadratic = lambda x: x[:, 0] ** 2 - x[:, 1] * x[:, 2] + x[:, 2] ** 2  # noqa: E731
        np.testing.assert_allclose(S @ quadratic(points), quadratic(new), atol=1e-13)
    inner = ((new > 0.9) & (new < 3.1)).all(axis=1)
    cubic = lambda x: x[:, 0] ** 3 * x[:, 1] ** 2 * x[:, 2]  # noqa: E731
    np.testing.assert_allclose((S @ cubic(points))[inner], cubic(new)[inner], atol=1e-11)


@pytest.mark.parametrize("m", [3, 4, 5, 6, 7, 8])
def test_rings_reflect_quadratics(m: int) -> None:
    beside = np.zeros((1, m, m), dtype=bool)
    k = np.arange(m)
    beside[0, k, (k + 1) % m] = beside[0, (k + 1) % m, k] = True
    w = ring_weights(beside)[0]
    angle = 2 * np.pi * k / m
    x, y = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(w @ np.ones(m), 1.0, atol=1e-14)
    np.testing.assert_allclose(w @ np.column_stack([x, y]), -np.column_stack([x, y]), atol=1e-14)
    if m >= 5:
        np.testing.assert_allclose(w @ (x * y), x * y, atol=1e-14)
    if m == 4:
        np.testing.assert_allclose(w, np.roll(np.eye(4), 2, axis=1), atol=1e-15)


@pytest.mark.parametrize("m", [3, 5, 6])
def test_prisms_are_products(m: int) -> None:
    """Around a straight extraordinary edge the rule is (plane) x (four-point rule along it); the plane stays flat."""
    points, cells = fan(m, layers=5)
    t = with_features(hex_mesh(points, cells).topology, points, "auto")
    S = butterfly(t)[1]
    new = S @ points
    np.testing.assert_allclose(new[:, 2], 0.5 * np.rint(2.0 * new[:, 2]), atol=1e-14)
    line = np.flatnonzero(np.abs(new - [0.0, 0.0, 2.5]).max(axis=1) < 1e-12)
    assert len(line) == 1
    row = S[line].toarray()[0]
    layers = np.array([row[points[:, 2] == z].sum() for z in range(6)])
    np.testing.assert_allclose(layers, np.array([0, -1, 9, 9, -1, 0]) / 16, atol=1e-15)


def test_levels_converge() -> None:
    """Distances between neighbours shrink geometrically: the points of the levels close up to a continuous volume."""
    for points, cells in (ball(), cross_of_tetrahedra(5)):
        t = with_features(hex_mesh(points, cells).topology, points, "none")
        x, longest = points, []
        for _ in range(3):
            t, S = butterfly(t)
            x = S @ x
            longest.append(np.linalg.norm(np.diff(x[t.edges], axis=1), axis=2).max())
        assert longest[2] < 0.75 * longest[1] < 0.6 * longest[0]


def test_a_domain_passes_through_the_vertices() -> None:
    points, cells = cross_of_tetrahedra(5)
    domain = source.domain_of(hex_mesh(points, cells, {"k": points[:, 0]}), Settings(interpolate="butterfly"))
    check(domain)
    assert domain.report["interpolation_error"] < 1e-13
    assert domain.report["cells"] == 8 * len(cells)
