"""Boundaries slid along surfaces before there is a solid, and solids unfolded inside them."""

from __future__ import annotations

import numpy as np

from geometry.layouts.blocks import cube, pillowed, place
from geometry.meccano.errors import surface_samples, tessellation
from geometry.meccano.fitting import fit_boundary, greville_points
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.shapes import ball
from geometry.meccano.skin import side_coordinates, skin_of, values_at
from geometry.meccano.sliding import on_sheet, shape_energy, sines, slid
from geometry.meccano.springs import SAMPLES
from geometry.meccano.starting import sheets, started
from geometry.meccano.state import Aims, Task
from geometry.meccano.tmesh import uniform
from geometry.meccano.unfolding import unfolded
from geometry.simplices.distance import distances
from iga.certificate import certify
from iga.progress import QUIET
from iga.scaled_jacobian import least_of_elements

TWIST = 2.5
"""Angle by which the map of a ball is turned, per radius along the axis."""


def test_slopes_of_the_energy_are_those_of_differences():
    random = np.random.default_rng(7)
    u, v, n = random.normal(size=(3, 40, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    a, b = random.uniform(0.5, 2.0, size=(2, 40))
    du, dv = random.normal(size=(2, 40, 3))
    _, by_u, by_v = shape_energy(u, v, a, b, n, 0.3)
    t = 1e-6
    ahead, behind = (shape_energy(u + s * du, v + s * dv, a, b, n, 0.3)[0] for s in (t, -t))
    np.testing.assert_allclose((ahead - behind) / (2.0 * t), (by_u * du + by_v * dv).sum(), rtol=1e-7)


def test_facets_turned_over_cost_infinitely_much_only_without_regularisation():
    u, v, n = np.eye(3)[:, None]
    one = np.ones(1)
    assert shape_energy(u, v, one, one, n, 0.0)[0] == 1.0 + 0.2
    assert np.isinf(shape_energy(v, u, one, one, n, 0.0)[0])
    assert np.isfinite(shape_energy(v, u, one, one, n, 0.1)[0])


def test_a_twisted_sheet_is_straightened_near_the_surface():
    surface, skin, points = _ball()
    target = _twisted(points)
    aim = target(*side_coordinates(skin, SAMPLES))
    before = sines(skin, fit_boundary(skin, points, SAMPLES, aim), surface)
    made = slid(skin, points, surface, aim, 0.01 * surface.diagonal)
    assert before.min() < 0.3
    assert sines(skin, made, surface).min() > before.min() + 0.2
    assert distances(surface, *tessellation(skin, made))["relative"] < 0.02
    inner = np.setdiff1d(np.arange(len(points)), skin.functions)
    np.testing.assert_array_equal(made[inner], points[inner])


def test_the_inside_of_a_sheet_is_unfolded():
    surface, skin, points = _ball()
    aim = _twisted(points)(*side_coordinates(skin, SAMPLES))
    solid = unfolded(skin, slid(skin, points, surface, aim, 0.01 * surface.diagonal))
    assert not len(solid.invalid)
    assert (certify(solid.domain).verdict == 1).all()
    assert least_of_elements(solid.domain).min() > 0.1


def test_sheets_are_split_where_they_are_off_until_one_is_near():
    surface, skin, points = _ball()
    task = _task(surface, points, 2e-3, 600)
    found = sheets(task, skin, points, 6)
    cells = [sheet.space.tmesh.cells for sheet in found]
    assert cells == sorted(set(cells))
    assert cells[-1] > skin.space.tmesh.cells
    near = [distances(surface, *tessellation(sheet.skin, sheet.points))["relative"] for sheet in found]
    assert near[-1] < 2.5e-3
    assert near[0] > 2.0 * near[-1]


def test_sheets_have_no_more_cells_than_are_allowed():
    surface, skin, points = _ball()
    most = 300
    cells = [sheet.space.tmesh.cells for sheet in sheets(_task(surface, points, 2e-3, most), skin, points, 6)]
    assert skin.space.tmesh.cells < max(cells) <= most


def test_a_fine_sheet_is_where_a_solid_starts():
    surface, skin, points = _ball()
    _, state, stage = started(_task(surface, points, 2e-3, 600), skin.space, 6)
    assert stage == "unfolding"
    assert state.solid.space.tmesh.cells > skin.space.tmesh.cells
    assert state.errors.worst.max() < 2.5e-3 * surface.diagonal
    assert (certify(state.solid.domain).verdict == 1).all()


def test_points_on_a_sheet_go_to_the_surface_closest_to_them():
    surface, skin, points = _ball()
    side, s = side_coordinates(skin, SAMPLES)
    x, found = values_at(skin, SAMPLES) @ points, on_sheet(skin, points, surface)(side, s)
    assert np.abs(np.linalg.norm(x, axis=1) - 1.0).max() > 0.1
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 0.03
    assert ((found * x).sum(axis=1) > 0.99 * np.linalg.norm(found, axis=1) * np.linalg.norm(x, axis=1)).all()


def _ball():
    """A ball, a skin of few facets, and control points of a cube inside it."""
    space = hierarchy(uniform(pillowed(cube()), 1, 1))
    points = place(space.tmesh.blocks, *greville_points(space))
    low, high = points.min(axis=0), points.max(axis=0)
    return ball(12), skin_of(space), 0.5 * (2.0 * (points - low) / (high - low) - 1.0)


def _task(surface, points, tolerance, cells):
    """A ball to be made within a relative tolerance."""
    aims = Aims(tolerance * surface.diagonal, cells)
    return Task(surface, _twisted(points), aims, surface_samples(surface, 0.02)[0], QUIET)


def _twisted(points):
    """A map of the cube's sides onto the ball, turned about its axis by an angle that grows along it."""
    skin = skin_of(hierarchy(uniform(pillowed(cube()), 1, 1)))
    straight = on_sheet(skin, points, ball(12))

    def target(side, s):
        x, y, z = straight(side, s).T
        cosine, sine = np.cos(TWIST * z), np.sin(TWIST * z)
        return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)

    return target
