"""Repair: interiors that follow their boundary, boundaries that slide before they move, and how far that is."""

from __future__ import annotations

import numpy as np

import geometry.catmull_clark as source
from geometry.catmull_clark.domain import build_domain
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import diagonal, direct
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.repair import follow, invalid_cells, repair, springs, surface_distance
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import ball, box
from geometry.catmull_clark.topology import CREASE, INTERIOR, SMOOTH
from iga.certificate import quality


def _dented() -> tuple[np.ndarray, np.ndarray]:
    """A box of which two rows of vertices on top nearly meet: the interpolating surface folds between them."""
    points, cells = box(6, 6, 4)
    points = points.astype(float)
    top = points[:, 2] == 4
    points[top & (points[:, 0] == 3), 0] -= 0.92
    return points, cells


def test_a_linear_motion_of_the_boundary_is_followed_exactly() -> None:
    points, cells = box(4, 4, 4)
    t = with_features(hex_mesh(points, cells).topology, points)
    inner = t.vertex_kind == INTERIOR
    target = points @ np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [0.0, 0.0, 1.2]])
    control = np.where(inner[:, None], np.random.default_rng(3).random(points.shape), target)
    made = follow(t, points, control, np.arange(len(cells)))
    np.testing.assert_allclose(made, target, atol=1e-12)
    np.testing.assert_array_equal(made[~inner], control[~inner])


def test_interior_points_suffice_where_they_can() -> None:
    points, cells = box(4, 4, 4)
    t = with_features(hex_mesh(points, cells).topology, points)
    control = points.copy()
    control[(points == 2).all(axis=1)] += [3.5, 3.0, 0.5]
    assert len(invalid_cells(build_domain(t, control, 0)))
    made = repair(t, points, control, boundary=True)
    assert not len(made.invalid)
    assert not len(invalid_cells(build_domain(t, made.control, 0)))
    outer = t.vertex_kind < INTERIOR
    np.testing.assert_array_equal(made.control[outer], control[outer])


def test_springs_are_stiff_across_the_boundary_and_along_creases_in_two_directions() -> None:
    points, cells = box(3, 3, 3)
    t = with_features(hex_mesh(points, cells).topology, points)
    tether = springs(t, points, points, 10.0)
    outer = np.flatnonzero(t.vertex_kind < INTERIOR)
    crease = np.flatnonzero(t.vertex_kind == CREASE)
    assert len(tether.weights) == len(outer) + len(crease)
    np.testing.assert_allclose(tether.A @ points, tether.places, atol=1e-13)
    own = dict(zip(outer.tolist(), tether.normals))
    for second, v in zip(tether.normals[len(outer) :], crease.tolist()):
        direction = np.array([1.0 if 0 < x < 3 else 0.0 for x in points[v]])  # the axis that the edge runs along
        np.testing.assert_allclose([second @ direction, own[v] @ direction, second @ own[v]], 0.0, atol=1e-14)
    for v in np.flatnonzero(t.vertex_kind == SMOOTH).tolist():
        np.testing.assert_allclose(np.abs(own[v]).max(), 1.0, atol=1e-14)


def test_a_folding_boundary_slides() -> None:
    """The interpolating surface folds, so that no interior point helps; the repaired one stays in its plane."""
    points, cells = _dented()
    mesh = hex_mesh(points, cells)
    t = with_features(mesh.topology, points)
    control = direct(t, points).values
    assert len(repair(t, points, control, boundary=False).invalid)
    strict = source.domain_of(mesh, Settings(interpolate="pia", depth=0))
    assert quality(strict)["refuted"] > 0
    mended = source.domain_of(mesh, Settings(repair=True, depth=0))
    assert quality(mended)["certified"] == len(cells)
    report = mended.report
    assert report["invalid_closures"] == 0
    assert 0 < report["moved_boundary_vertices"] < (t.vertex_kind < INTERIOR).sum() / 2
    assert 1e-3 < report["interpolation_error_boundary"] < 0.1
    # The top is flat: vertices slide, the surface stays.
    assert report["boundary_distance"] < 0.1 * report["interpolation_error_boundary"]
    limit = limit_matrix(t) @ mended.points
    bottom = points[:, 2] == 0
    np.testing.assert_allclose(limit[bottom], points[bottom], atol=1e-10)


def test_distance_from_the_boundary_surface() -> None:
    """Points on the limit surface are on it, and points off it along the normal of a flat face are that far away."""
    points, cells = box(3, 3, 3)
    t = with_features(hex_mesh(points, cells).topology, points)
    rng = np.random.default_rng(5)
    place = np.column_stack([3.0 * rng.random((50, 2)), np.full(50, 3.0)])
    np.testing.assert_allclose(surface_distance(t, points, place), 0.0, atol=1e-12)
    np.testing.assert_allclose(surface_distance(t, points, place + 0.3 * np.eye(3)[2]), 0.3, atol=1e-12)
    points, cells = ball()
    t = with_features(hex_mesh(points, cells).topology, points, "none")
    on = (limit_matrix(t) @ points)[8:]
    assert surface_distance(t, points, on).max() < 1e-12 * diagonal(points)
