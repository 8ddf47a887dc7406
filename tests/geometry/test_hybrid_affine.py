"""Affine fits keep affine displacements, so that layers under curved elements do not wrinkle."""

from functools import cache

import numpy as np
import pytest

from geometry.hybrid.affine import relaxed, slopes, spread
from geometry.hybrid.layers import moved, traced
from geometry.hybrid.shapes import SHAPES
from geometry.hybrid.shell import Shell, shell_of
from geometry.hybrid.skin import build_skin
from geometry.hybrid.ways import Ways, ways_of
from studies.hybrid_volume import SMOOTH, turning


@cache
def part(name: str, size: float) -> tuple[Shell, Ways]:
    shell = shell_of(build_skin(SHAPES[name](), size, 1e-3))
    return shell, ways_of(shell, None)


@pytest.mark.parametrize("name", ["curved_box", "tetrapod"])
def test_constants_stay_and_noise_falls(name: str) -> None:
    shell, ways = part(name, 0.2)
    v = shell.vertices
    everywhere = np.ones(len(v))
    one = relaxed(v, np.ones((len(v), 2)), ways.edges, 0.5 * everywhere, 4)
    # Slopes are held back a little, values not at all: constants stay to rounding.
    np.testing.assert_allclose(one, 1.0, atol=1e-12)
    noise = np.random.default_rng(5).normal(size=(len(v), 3))
    found = relaxed(v, noise, ways.edges, 0.5 * everywhere, 4)
    assert np.linalg.norm(found) < 0.5 * np.linalg.norm(noise)
    held = relaxed(v, noise, ways.edges, 0.0 * everywhere, 4)
    np.testing.assert_array_equal(held, noise)


def test_affine_maps_of_a_ball_of_vertices_are_found() -> None:
    """Slopes of an affine map on points in general position, to what the weight of flat places leaves."""
    random = np.random.default_rng(3)
    points = random.normal(size=(12, 3))
    edges = np.array([(i, j) for i in range(12) for j in range(i)])
    A = random.normal(size=(3, 3))
    found = slopes(points, points @ A + 1.0, edges)
    assert np.abs(found - A).max() < 0.03 * np.abs(A).max()
    values = points @ A + 1.0
    # Means of neighbours with equal weights are off by the size of the map.
    again = relaxed(points, values, edges, np.ones(12), 1)
    assert np.abs(again - values).max() < 0.25 * np.ptp(values)


def test_control_points_follow_shifts() -> None:
    """Vertices move by their shifts exactly, and a translation moves all control points alike."""
    shell, ways = part("tetrapod", 0.2)
    shift = np.random.default_rng(7).normal(size=shell.vertices.shape)
    inner = moved(shell, spread(shell, shift, ways.edges))
    np.testing.assert_allclose(inner.vertices, shell.vertices + shift, atol=1e-12)
    same = spread(shell, np.broadcast_to([0.1, -0.2, 0.3], shift.shape), ways.edges)
    np.testing.assert_allclose(same, np.broadcast_to([0.1, -0.2, 0.3], same.shape), atol=1e-12)


def test_layers_of_capsules_do_not_wrinkle() -> None:
    """A scaled copy of four joined capsules turns across its edges as the skin does, which spans sixths of circles."""
    shell, ways = part("tetrapod", 0.2)
    shift = -0.75 * (shell.vertices - shell.vertices.mean(axis=0))
    smooth = turning(shell) < SMOOTH
    skin = np.rad2deg(turning(shell)[smooth].max())
    bulging = np.rad2deg(turning(moved(shell, spread(shell, shift, ways.edges)))[smooth].max())
    assert bulging < skin + 5.0
    D = traced(shell, ways, 0.75, np.array([1.0]))[0]
    assert np.rad2deg(turning(moved(shell, D))[smooth].max()) < 35.0
