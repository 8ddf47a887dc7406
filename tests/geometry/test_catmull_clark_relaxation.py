"""Interpolating less where the boundary folds, and interiors that follow their boundary."""

from __future__ import annotations

import numpy as np

import geometry.catmull_clark as source
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import direct
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.relaxation import folded_boundary, follow, relax
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import box
from geometry.catmull_clark.untangling import closures
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
    inner = t.vertex_kind == 3
    target = points @ np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [0.0, 0.0, 1.2]])
    control = np.where(inner[:, None], np.random.default_rng(3).random(points.shape), target)
    made = follow(t, points, control, np.arange(len(cells)))
    np.testing.assert_allclose(made, target, atol=1e-12)
    np.testing.assert_array_equal(made[~inner], control[~inner])


def test_folds_of_the_boundary_are_found_and_relaxed() -> None:
    points, cells = _dented()
    t = with_features(hex_mesh(points, cells).topology, points)
    control = direct(t, points).values
    made = closures(t, points)
    assert not len(folded_boundary(t, made.rows, made.matrix, points))
    assert len(folded_boundary(t, made.rows, made.matrix, control))
    relaxed = relax(t, made.rows, made.matrix, points, control)
    assert not len(folded_boundary(t, made.rows, made.matrix, relaxed))
    away = (t.vertex_kind < 3) & (points[:, 2] == 0)
    np.testing.assert_array_equal(relaxed[away], control[away])  # only where it must


def test_repair_uses_both() -> None:
    points, cells = _dented()
    mesh = hex_mesh(points, cells)
    strict = source.domain_of(mesh, Settings(interpolate="pia", depth=0))
    assert quality(strict)["refuted"] > 0
    mended = source.domain_of(mesh, Settings(repair=True, depth=0))
    assert quality(mended)["certified"] == len(cells)
    assert mended.report["invalid_closures"] == 0
