"""Springs between boundaries of solids and surfaces: closest points on sheets that face the same way."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from geometry.layouts.blocks import cube, pillowed, place
from geometry.meccano.fitting import greville_points
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.shapes import ball
from geometry.meccano.skin import outward, skin_of, values_at
from geometry.meccano.springs import FACING, SAMPLES, springs_to
from geometry.meccano.tmesh import uniform
from geometry.simplices.closest import closest, closest_facing
from geometry.simplices.surface import Surface


def horned(n: int, height: float, width: float, angle: float) -> Surface:
    """A ball with two horns, an angle apart, and a notch between them."""
    sphere = ball(n)
    radius = np.ones(len(sphere.points))
    for sign in (-1.0, 1.0):
        way = np.array([np.sin(0.5 * sign * angle), 0.0, np.cos(0.5 * angle)])
        radius += height * np.exp(-((sphere.points - way) ** 2).sum(axis=1) / width**2)
    return Surface(sphere.points * radius[:, None], sphere.triangles)


def test_closest_points_face_the_way_they_should():
    surface = horned(16, 1.5, 0.3, 0.8)
    random = np.random.default_rng(5)
    queries = random.normal(size=(200, 3))
    ways = random.normal(size=(200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found, gap, triangle = closest_facing(surface.points, surface.triangles, queries, ways, FACING)
    assert (triangle >= 0).all()
    assert ((normals[triangle] * ways).sum(axis=1) >= FACING).all()
    np.testing.assert_allclose(np.linalg.norm(found - queries, axis=1), gap, atol=1e-12)
    for q in range(0, 200, 20):
        own = surface.triangles[normals @ ways[q] >= FACING]
        np.testing.assert_allclose(closest(surface.points, own, queries[q : q + 1])[1], gap[q], atol=1e-12)


def test_no_triangle_may_face_that_way():
    flat = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    down = np.array([[0.0, 0.0, -1.0]])
    found, gap, triangle = closest_facing(flat.points, flat.triangles, np.zeros((1, 3)), down, FACING)
    assert np.isnan(found).all()
    assert np.isinf(gap[0])
    assert triangle[0] == -1


def test_normals_of_facets_point_out_of_the_solid():
    skin, points = _cube()
    where = values_at(skin, SAMPLES) @ points
    normals = outward(skin, points, SAMPLES)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    axis = np.abs(where).argmax(axis=1)
    k = np.arange(len(where))
    np.testing.assert_allclose(normals[k, axis], np.sign(where[k, axis]), atol=1e-12)


def test_a_membrane_across_a_notch_is_drawn_to_its_bottom():
    """Springs of a lid above the notch pull it down; the closest points lie on the horns."""
    surface = horned(32, 1.5, 0.22, 0.6)
    skin, points = _cube()
    points = points * np.array([0.1, 0.1, 0.05]) + np.array([0.0, 0.0, 1.6])
    lid = np.flatnonzero(outward(skin, points, SAMPLES)[:, 2] > 0.9)
    centre = lid[np.abs((values_at(skin, SAMPLES) @ points)[lid, :2]).max(axis=1) < 0.03]
    assert len(centre)
    aim = closest(surface.points, surface.triangles, values_at(skin, SAMPLES) @ points)[0]
    tether = springs_to(surface, skin, 1e-3, 1.0, aim)(points)
    start = (tether.A @ points)[centre]
    _, _, beside = closest(surface.points, surface.triangles, start)
    corners = surface.points[surface.triangles[beside]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.abs(normals[:, 2]) < FACING * np.linalg.norm(normals, axis=1)).all()
    assert (tether.weights[centre] > 0.0).all()
    assert (tether.normals[centre, 2] > FACING).all()
    assert (tether.places[centre, 2] < start[:, 2] - 0.1).all()


def test_a_fold_is_not_drawn_through_the_solid():
    """The lower side of a flat box under the top of a ball faces the ball's bottom, which is far beyond."""
    surface = ball(16)
    skin, points = _cube()
    points = points * 0.05 + np.array([0.0, 0.0, 0.85])
    aim = values_at(skin, SAMPLES) @ points
    below = np.flatnonzero(outward(skin, points, SAMPLES)[:, 2] < -0.9)
    tether = springs_to(surface, skin, 1e-3, 1.0, aim)(points)
    start = (tether.A @ points)[below]
    assert len(below)
    assert (tether.places[below, 2] > start[:, 2]).all()
    # In the middle of the ball its bottom is as near as its top, and is believed.
    tether = springs_to(surface, skin, 1e-3, 1.0, aim)(points - [0.0, 0.0, 0.85])
    assert (tether.places[below, 2] < -0.4).all()


def test_where_no_sheet_faces_that_way_the_map_is_followed_with_bounded_force():
    """A box far above half a ball: no triangle faces as its lower side does."""
    whole = ball(8)
    up = whole.points[whole.triangles][:, :, 2].min(axis=1) > -1e-9
    surface = Surface(whole.points, whole.triangles[up])
    skin, points = _cube()
    points = points + np.array([0.0, 0.0, 5.0])
    aim = np.tile([0.0, 0.0, 1.0], (len(skin.cell) * len(SAMPLES), 1))
    tether = springs_to(surface, skin, 1e-3, 1.0, aim)(points)
    below = np.flatnonzero(outward(skin, points, SAMPLES)[:, 2] < -0.9)
    way = (tether.A @ points)[below] - aim[below]
    np.testing.assert_array_equal(tether.places[below], aim[below])
    np.testing.assert_array_equal(tether.normals[below], 0.0)
    force = tether.along * tether.weights[below] * np.linalg.norm(way, axis=1)
    np.testing.assert_allclose(force, 1e-3 / (0.25 * 1e-3) ** 2 / len(SAMPLES), rtol=1e-12)


def test_surface_that_no_facet_near_faces_draws_the_facet_that_the_map_puts_there():
    """A box in a ball that is inside out: none of its facets faces the ball's way, the map says which belongs where."""
    surface = ball(16)
    skin, points = _cube()
    aim = values_at(skin, SAMPLES) @ points
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    tether = springs_to(surface, skin, 0.01, 1.0, aim)(-0.1 * points)
    own = slice(len(aim), None)
    start = csr_array(tether.A[own]) @ points
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    # Each point of the surface draws the point that the map puts there, though that is on the far side.
    assert len(start)
    assert ((start * tether.places[own]).sum(axis=1) > 0.97).all()


def test_facets_that_cannot_move_have_no_springs():
    surface = ball(8)
    skin, points = _cube()
    free = np.zeros(len(points), dtype=bool)
    free[skin.functions[:1]] = True
    aim = values_at(skin, SAMPLES) @ points
    whole, part = (springs_to(surface, skin, 0.01, 1.0, aim, free=f)(points) for f in (None, free))
    moved = np.asarray(whole.A @ free.astype(float)) != 0.0
    assert 0 < len(part.weights) < len(whole.weights)
    assert (np.asarray(part.A @ free.astype(float)) != 0.0).sum() == moved.sum()


def test_where_nothing_may_be_pulled_there_are_no_springs():
    skin, points = _cube()
    aim = values_at(skin, SAMPLES) @ points
    tether = springs_to(ball(8), skin, 0.01, 1.0, aim, free=np.zeros(len(points), dtype=bool))(points)
    assert tether.A.shape == (0, len(points))
    assert tether.places.shape == tether.normals.shape == (0, 3)


def _cube():
    """A skin of the straight cube [-1, 1]^3 and its control points."""
    space = hierarchy(uniform(pillowed(cube()), 1, 1))
    block, xi = greville_points(space)
    points = place(space.tmesh.blocks, block, xi)
    low, high = points.min(axis=0), points.max(axis=0)
    return skin_of(space), 2.0 * (points - low) / (high - low) - 1.0
