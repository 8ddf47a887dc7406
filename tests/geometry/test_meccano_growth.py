"""Growing solids into maps of the meccano's boundary: what starts badly ends certified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.layouts.blocks import cube, pillowed, place
from geometry.layouts.boundary_map import boundary_map, carried, on_surface
from geometry.layouts.partition import partition
from geometry.meccano.errors import Errors, errors_of, surface_samples
from geometry.meccano.fitting import greville_points, laid
from geometry.meccano.growth import _drawn_in, _evened, _lack, _marked, _stiffer, nested, solid_of
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.shapes import ball
from geometry.meccano.skin import outward, skin_of, values_at
from geometry.meccano.solid import Solid
from geometry.meccano.springs import SAMPLES
from geometry.meccano.state import Aims, State, Task, measured
from geometry.meccano.tmesh import uniform
from iga.certificate import certify
from iga.progress import QUIET
from iga.scaled_jacobian import least_of_elements


def test_a_twisted_map_is_unwound():
    """The ball's map turned about its axis, by an angle that grows along it, still leads to a good solid."""
    surface, twist = ball(12), 3.0
    mapping = boundary_map(partition(surface))[0]
    blocks = pillowed(mapping.blocks, 0.25)
    mapping = carried(mapping, blocks)

    def target(side, s):
        x, y, z = on_surface(mapping, side, s)[0].T
        cosine, sine = np.cos(twist * z), np.sin(twist * z)
        return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)

    start = hierarchy(uniform(blocks, 1, 1))
    solid, history = solid_of(start, target, surface, Aims(0.01 * surface.diagonal, 60))
    assert not len(solid.invalid)
    assert (certify(solid.domain).verdict == 1).all()
    assert history[-1]["ended"] == "within the tolerance"
    assert history[-1]["away"] < 0.01 * surface.diagonal
    assert history[-1]["missed"] < 0.01 * surface.diagonal
    assert least_of_elements(solid.domain).min() > 0.2


def test_the_picture_is_laid_onto_places_by_a_similarity():
    random = np.random.default_rng(3)
    points = random.normal(size=(20, 3))
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    there = 2.5 * points @ turn.T + np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(laid(points, np.eye(20), there), there, atol=1e-12)


def test_cells_that_are_not_certified_are_named_and_split():
    space = hierarchy(uniform(pillowed(cube()), 1, 1))
    skin = skin_of(space)
    solid = Solid(space, skin, np.zeros((space.n, 3)), np.array([40, 3]))
    fine = np.zeros(len(skin.cell))
    assert sorted(_marked(solid, Errors(fine, fine), Aims(1.0, 100)).tolist()) == [3, 40]


def test_what_is_missed_by_little_is_a_matter_of_the_closest_facet():
    """A cube on which one facet's aim lies above another: the boundary has slid away from the map."""
    space = hierarchy(uniform(pillowed(cube()), 1, 1))
    skin = skin_of(space)
    points = place(space.tmesh.blocks, *greville_points(space))
    aim = values_at(skin, SAMPLES) @ points
    by_facet = aim.reshape(len(skin.cell), -1, 3)
    above = by_facet[5] + 0.02 * outward(skin, points, SAMPLES).reshape(by_facet.shape)[5]
    by_facet[11] = above
    near, far = (
        errors_of(skin, points, aim, np.empty((0, 3)), ball(4), limit).missed for limit in (0.1, 0.01)
    )
    assert near[5] == pytest.approx(0.02)
    assert np.delete(near, 5).max() < 1e-12
    assert far[11] == pytest.approx(0.02)
    assert np.delete(far, 11).max() < 1e-12


def test_growth_says_that_cells_are_spent():
    """Of a ball that a coarse mesh cannot meet: the last steps are kept only where they bring it nearer."""
    surface = ball(8)
    mapping = boundary_map(partition(surface))[0]
    blocks = pillowed(mapping.blocks, 0.25)
    mapping = carried(mapping, blocks)
    start = hierarchy(uniform(blocks, 0, 1))
    solid, history = solid_of(
        start, lambda side, s: on_surface(mapping, side, s)[0], surface, Aims(3e-3 * surface.diagonal, 7)
    )
    sliding, fitting = history[-2:]
    assert fitting["ended"] == "cells spent"
    assert 0 < fitting["facets_off"] <= sliding["facets_off"]
    assert max(fitting["away"], fitting["missed"]) < 1.05 * max(sliding["away"], sliding["missed"])
    assert (certify(solid.domain).verdict == 1).all()


def test_fine_tolerances_are_reached_through_coarser_ones():
    np.testing.assert_allclose(nested(0.001, 1.0), [0.004, 0.002, 0.001])
    np.testing.assert_allclose(nested(0.3, 100.0), [0.3])
    np.testing.assert_allclose(nested(1.0, 100.0), [1.0])


@pytest.fixture(scope="module")
def round_solid() -> tuple[Task, State]:
    """A ball's solid on its first mesh, within a hundredth of the diagonal."""
    surface = ball(12)
    mapping = boundary_map(partition(surface))[0]
    blocks = pillowed(mapping.blocks, 0.25)
    mapping = carried(mapping, blocks)
    aims = Aims(0.01 * surface.diagonal, 60)

    def target(side, s):
        return on_surface(mapping, side, s)[0]

    solid, _ = solid_of(hierarchy(uniform(blocks, 1, 1)), target, surface, aims)
    task = Task(surface, target, aims, surface_samples(surface, 0.01)[0], QUIET)
    return task, measured(task, solid)


def test_stiffer_springs_draw_nearer_what_is_nearly_there(round_solid):
    task, state = round_solid
    swollen = measured(task, replace(state.solid, points=1.03 * state.solid.points))
    assert 1.0 < swollen.errors.worst.max() / task.aims.tolerance < 2.0
    drawn = _stiffer(task, swollen)
    assert not drawn.excess(task.aims)
    assert drawn.solid.space is state.solid.space
    assert not len(drawn.solid.invalid)


def test_dents_are_drawn_in_with_what_is_around_them(round_solid):
    task, state = round_solid
    points = state.solid.points.copy()
    top = state.solid.skin.functions[np.argmax(points[state.solid.skin.functions, 2])]
    points[top, 2] -= 0.3
    dented = measured(task, replace(state.solid, points=points))
    assert (certify(dented.solid.domain).verdict == 1).all()
    assert dented.errors.worst.max() > 2.0 * task.aims.tolerance
    drawn = _drawn_in(task, dented)
    assert not drawn.excess(task.aims)
    assert drawn.solid.space is state.solid.space
    assert (certify(drawn.solid.domain).verdict == 1).all()
    assert _drawn_in(task, state).excess(task.aims) <= state.excess(task.aims)


def test_many_poor_shapes_are_smoothed_as_a_whole(round_solid):
    """The inner block turned about an axis: its surroundings are sheared, all over the solid."""
    task, state = round_solid
    points = state.solid.points.copy()
    inner = state.solid.inner
    x, y, z = points[inner].T
    angle = 0.9 * (1.0 - np.linalg.norm(points[inner], axis=1) / np.linalg.norm(points, axis=1).max())
    cosine, sine = np.cos(angle), np.sin(angle)
    points[inner] = np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)
    sheared = measured(task, replace(state.solid, points=points))
    evened = _evened(task, sheared)
    before, after = (_lack(least_of_elements(each.solid.domain)) for each in (sheared, evened))
    assert before > 0.001
    assert after < 0.5 * before
    assert evened.excess(task.aims) <= sheared.excess(task.aims)
    assert (certify(evened.solid.domain).verdict == 1).all()
