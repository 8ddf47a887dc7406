"""Affine fits keep affine displacements, on each side of a crease: layers under curved elements do not wrinkle."""

from functools import cache

import numpy as np
import pytest

from geometry.hybrid.affine import relaxed, slopes, spread
from geometry.hybrid.creases import creases
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
    one = relaxed(v, np.ones((len(v), 2)), ways.creases, 0.5 * everywhere, 4)
    # Slopes are held back a little, values not at all: constants stay to rounding.
    np.testing.assert_allclose(one, 1.0, atol=1e-12)
    noise = np.random.default_rng(5).normal(size=(len(v), 3))
    found = relaxed(v, noise, ways.creases, 0.5 * everywhere, 4)
    fixed = np.bincount(ways.creases.along[:, 0], minlength=len(v)) > 2  # where creases meet
    np.testing.assert_array_equal(found[fixed], noise[fixed])
    assert np.linalg.norm(found[~fixed]) < 0.6 * np.linalg.norm(noise[~fixed])
    held = relaxed(v, noise, ways.creases, 0.0 * everywhere, 4)
    np.testing.assert_array_equal(held, noise)


def test_affine_maps_of_a_ball_of_vertices_are_found() -> None:
    """Slopes of an affine map on points in general position, to what the weight of flat places leaves."""
    random = np.random.default_rng(3)
    points = random.normal(size=(12, 3))
    pairs = np.array([(i, j) for i in range(12) for j in range(12) if i != j])
    A = 0.2 * random.normal(size=(3, 3))
    found = slopes(points, points @ A + 1.0, np.arange(12), pairs)
    assert np.abs(found - A).max() < 0.03 * np.abs(A).max()
    steep = slopes(points, 100.0 * points @ A, np.arange(12), pairs)
    np.testing.assert_allclose(np.linalg.norm(steep, ord=2, axis=(1, 2)), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", ["curved_box", "tetrapod"])
def test_affine_shifts_stay_nearly(name: str) -> None:
    """Also across creases, where plain means of neighbours are off by a tenth of the map."""
    shell, ways = part(name, 0.2)
    values = shell.vertices @ np.random.default_rng(4).normal(size=(3, 3))
    again = relaxed(shell.vertices, values, ways.creases, np.ones(len(values)), 1)
    assert np.abs(again - values).max() < 0.05 * np.ptp(values)


def test_sides_of_a_box() -> None:
    """Three sides at each corner, two on edges, one inside faces; the creases are the twelve edges."""
    shell, ways = part("curved_box", 0.2)
    made = ways.creases
    sides = np.bincount(made.vertex, minlength=len(shell.vertices))
    assert (sides == 3).sum() == 8
    assert set(sides.tolist()) == {1, 2, 3}
    degree = np.bincount(made.along[:, 0], minlength=len(shell.vertices))
    np.testing.assert_array_equal(degree, np.choose(sides - 1, [0, 2, 3]))
    for own, corners in zip(made.side, shell.corners):
        np.testing.assert_array_equal(made.vertex[own], corners)


def test_each_side_of_a_crease_has_its_own_slopes() -> None:
    """A shift that is affine on one face and another one on the rest, equal on their common creases."""
    shell, _ = part("curved_box", 0.2)
    made = creases(shell)
    face = np.zeros(len(shell.vertices), dtype=bool)
    for corners, own in zip(shell.corners, shell.face):
        face[corners[own == 0]] = True
    inside = face & (np.bincount(made.vertex, minlength=len(face)) == 1)
    shift = np.zeros((len(face), 1))
    shift[inside] = 1.0
    D = spread(shell, shift, made)
    for block, own in zip(shell.space.blocks, shell.face):
        assert np.abs(D[block.dofs[own != 0]]).max() < 1e-14
        assert np.abs(D[block.dofs[own == 0]]).max() > 0.2


def test_factors_reach_control_points_between_vertices() -> None:
    """Where depths are lowered to nothing, nothing moves, however much the shifts beside differ."""
    shell, ways = part("tetrapod", 0.2)
    shift = np.random.default_rng(8).normal(size=shell.vertices.shape)
    factor = np.ones(len(shift))
    low = shell.corners[0][:5]
    factor[low] = 1e-6
    D = spread(shell, factor[:, None] * shift, ways.creases, shift, factor)
    assert np.abs(D[shell.space.blocks[0].dofs[:5]]).max() < 1e-4
    plain = spread(shell, factor[:, None] * shift, ways.creases)
    assert np.abs(plain[shell.space.blocks[0].dofs[:5]]).max() > 1e-2


def test_control_points_follow_shifts() -> None:
    """Vertices move by their shifts exactly, and a translation moves all control points alike."""
    shell, ways = part("tetrapod", 0.2)
    shift = np.random.default_rng(7).normal(size=shell.vertices.shape)
    inner = moved(shell, spread(shell, shift, ways.creases))
    np.testing.assert_allclose(inner.vertices, shell.vertices + shift, atol=1e-12)
    same = spread(shell, np.broadcast_to([0.1, -0.2, 0.3], shift.shape), ways.creases)
    np.testing.assert_allclose(same, np.broadcast_to([0.1, -0.2, 0.3], same.shape), atol=1e-12)


def test_layers_of_capsules_do_not_wrinkle() -> None:
    """A scaled copy of four joined capsules turns across its edges as the skin does, which spans sixths of circles."""
    shell, ways = part("tetrapod", 0.2)
    shift = -0.75 * (shell.vertices - shell.vertices.mean(axis=0))
    smooth = turning(shell) < SMOOTH
    skin = np.rad2deg(turning(shell)[smooth].max())
    bulging = np.rad2deg(turning(moved(shell, spread(shell, shift, ways.creases)))[smooth].max())
    assert bulging < skin + 5.0
    D = traced(shell, ways, 0.75, np.array([1.0]))[0]
    assert np.rad2deg(turning(moved(shell, D))[smooth].max()) < 35.0
