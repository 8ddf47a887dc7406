"""The proved distance between closures and limit against samples of both."""

from __future__ import annotations

import numpy as np
import pytest

import geometry.catmull_clark as source
from geometry.catmull_clark.closure import closure_distance
from geometry.catmull_clark.domain import CUBIC, build_domain
from geometry.catmull_clark.evaluation import evaluate
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import diagonal
from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan
from iga.assembly import volume

MESHES = {"ball": ball(), "fan 3": fan(3), "fan 5": fan(5), "cross 5": cross_of_tetrahedra(5)}


@pytest.mark.parametrize(("name", "features"), [
    ("ball", "none"),
    pytest.param("fan 5", "auto", marks=pytest.mark.long),
    pytest.param("cross 5", "none", marks=pytest.mark.long),
    pytest.param("ball", "auto", marks=pytest.mark.long),
])
def test_no_sample_is_beyond_the_bound(name: str, features: str) -> None:
    points, cells = MESHES[name]
    t = with_features(hex_mesh(points, cells).topology, points, features)
    found = closure_distance(t, points, 0)
    rng = np.random.default_rng(3)
    at = np.repeat(np.flatnonzero(~t.regular_hexes), 60)
    xi = rng.random((len(at), 3))
    xi[::3] = xi[::3] ** 4  # near the ends of cells too
    rows = bezier_rows(t)
    net = (bezier_matrix(t, rows) @ points)[rows.cells[at]]
    closure = np.einsum("pb,pbc->pc", CUBIC.tabulate(xi, 0)[0], net)
    distance = np.linalg.norm(evaluate(t, at, xi).values @ points - closure, axis=1).max() / diagonal(points)
    assert 0.3 * found.measured < distance < found.bound
    assert found.measured < found.bound < 2.05 * found.measured
    assert 0 < found.contraction < 1


@pytest.mark.parametrize(("name", "features"), [("ball", "none"), ("fan 5", "auto"), ("cross 5", "none")])
def test_every_build_reports_a_bound(name: str, features: str) -> None:
    """The bound by convex hulls holds at samples of the limit, which come near to the distance said to occur."""
    points, cells = MESHES[name]
    report = source.domain_of(hex_mesh(points, cells), Settings(interpolate="none", features=features, depth=0)).report
    t = with_features(hex_mesh(points, cells).topology, points, features)
    rng = np.random.default_rng(5)
    at = np.repeat(np.flatnonzero(~t.regular_hexes), 40)
    xi = rng.random((len(at), 3)) ** np.where(np.arange(len(at)) % 3 == 0, 4, 1)[:, None]
    rows = bezier_rows(t)
    net = (bezier_matrix(t, rows) @ points)[rows.cells[at]]
    closure = np.einsum("pb,pbc->pc", CUBIC.tabulate(xi, 0)[0], net)
    distance = np.linalg.norm(evaluate(t, at, xi).values @ points - closure, axis=1).max() / diagonal(points)
    assert 0.5 * report["closure_distance"] < distance <= report["closure_distance_bound"] < 0.5


def test_bounds_by_hulls_fall_with_the_depth() -> None:
    """Along an edge closures halve with each level, and so does the proof; it cannot be below what occurs."""
    mesh = hex_mesh(*MESHES["fan 5"])
    reports = [source.domain_of(mesh, Settings(interpolate="none", depth=depth)).report for depth in (0, 1, 2)]
    bounds = [report["closure_distance_bound"] for report in reports]
    assert all(0 < report["closure_distance"] < bound for report, bound in zip(reports, bounds))
    assert bounds[2] < 0.6 * bounds[1] < 0.4 * bounds[0]


def test_regular_meshes_have_no_closures() -> None:
    points, cells = box(3, 3, 3)
    t = with_features(hex_mesh(points, cells).topology, points, "auto")
    assert closure_distance(t, points, 1).bound == 0.0
    report = source.domain_of(hex_mesh(points, cells)).report
    assert report["closure_distance_bound"] == report["closure_distance"] == report["closed_share"] == 0.0


@pytest.mark.long
def test_the_bound_is_reported() -> None:
    report = source.domain_of(hex_mesh(*ball()), Settings(interpolate="none", features="none", bound=True)).report
    assert 0 < report["closure_distance"] <= report["closure_distance_bound"] < 0.02


@pytest.mark.long
def test_the_bound_shrinks_with_the_depth() -> None:
    points, cells = fan(3)
    t = with_features(hex_mesh(points, cells).topology, points)
    # Two levels down more cells have to be subdivided than the default allows for a bound within twice the distance.
    bounds = [closure_distance(t, points, depth, most=6000).bound for depth in (0, 1, 2)]
    assert bounds[2] < 0.75 * bounds[1] < 0.6 * bounds[0]


def test_closures_inside_change_no_volume() -> None:
    """The volume follows from the boundary, where closures and limit agree on regular and on flat faces."""
    points, cells = fan(5)
    t = with_features(hex_mesh(points, cells).topology, points)
    assert not t.regular_hexes.all()
    moved = points + 0.1 * np.sin(3.0 * points[:, [1, 2, 0]]) * (t.vertex_kind == 3)[:, None]
    volumes = [volume(build_domain(t, moved, depth), 6) for depth in (0, 1, 2)]
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-13)
