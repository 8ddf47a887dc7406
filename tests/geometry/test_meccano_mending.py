"""Holes of surfaces are filled, on request, by triangles that fold least."""

from __future__ import annotations

from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_meccano_surface import ball, torus, write

from geometry.simplices.filling import Hole, filled, holes
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface, checked_surface, genus, volume
from iga.errors import InputError


def flat(n: int, level: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A square of n x n vertices, cut into triangles that face upwards."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a = (i * n + j).reshape(n, n)
    low, right, up, far = (x.ravel() for x in (a[:-1, :-1], a[1:, :-1], a[:-1, 1:], a[1:, 1:]))
    table = np.concatenate([np.stack([low, right, far], 1), np.stack([low, far, up], 1)])
    return np.stack([i, j, np.full(n * n, level)], axis=1).astype(float), table


def closing(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles with all holes filled."""
    for hole in holes(points, triangles):
        made = filled(points, triangles, hole)
        assert made is not None
        triangles = np.concatenate([triangles, made])
    return triangles


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e5])
def test_a_flat_hole_is_filled_flat_and_exactly(scale):
    points, triangles = flat(9)
    middle = points[triangles].mean(axis=1)
    # An L, which is not convex, on one sheet; the sheet's own border is a hole too.
    gone = ((middle > (1, 1, -1)) & (middle < (6, 3, 1))).all(axis=1)
    gone |= ((middle > (1, 1, -1)) & (middle < (3, 7, 1))).all(axis=1)
    points = points * scale
    inner = min(holes(points, triangles[~gone]), key=lambda hole: len(hole.loop))
    made = filled(points, triangles[~gone], inner)
    assert made is not None
    assert len(made) == len(inner.loop) - 2
    corners = points[made] / scale
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    assert (area[:, 2] > 0).all()
    assert abs(area[:, 2].sum() - 18.0) < 1e-12


def test_half_an_octahedron_is_closed_flat():
    points, triangles = ball(0)
    keep = (triangles != 4).all(axis=1)
    closed = closing(points, triangles[keep])
    assert abs(volume(Surface(*_packed(points, closed))) - volume(Surface(points, triangles)) / 2) < 1e-12


def test_holes_that_touch_are_two():
    points, triangles = ball(3)
    vertex = int(np.argmax(np.bincount(triangles.ravel())))
    around = np.flatnonzero((triangles == vertex).any(axis=1))
    one = around[0]
    other = next(t for t in around if len(set(triangles[t]) & set(triangles[one])) == 1)
    keep = np.ones(len(triangles), dtype=bool)
    keep[[one, other]] = False
    found = holes(points, triangles[keep])
    assert sorted(sorted(hole.loop.tolist()) for hole in found) == sorted(
        sorted(triangles[t].tolist()) for t in (one, other)
    )
    whole = closing(points, triangles[keep])
    assert {tuple(sorted(t)) for t in whole.tolist()} == {tuple(sorted(t)) for t in triangles.tolist()}


@pytest.mark.parametrize("seed", range(8))
def test_holes_that_touch_twice_keep_their_sides(seed):
    """A lens in a square, tied to it at its two ends: the holes on its sides are not mixed, whatever comes first."""
    points = np.array([
        (-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0), (0, -1, 0), (2, 0, 0), (0, 1, 0), (-2, 0, 0), (-0.5, 0, 0),
        (0.5, 0, 0),
    ])
    square = [(0, 1, 4), (1, 5, 4), (1, 2, 5), (2, 6, 5), (2, 3, 6), (3, 7, 6), (3, 0, 7), (0, 4, 7)]
    triangles = np.random.default_rng(seed).permutation(np.array([*square, (4, 9, 8), (8, 9, 6)]))
    found = {frozenset(hole.loop.tolist()) for hole in holes(points, triangles)}
    assert found == {frozenset({7, 4, 8, 6}), frozenset({4, 5, 6, 9}), frozenset({0, 1, 2, 3})}


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.05, 0.1]), st.booleans())
def test_surfaces_with_triangles_missing_anywhere(seed, share, round_):
    points, triangles = ball(3) if round_ else torus(24, 16)
    rng = np.random.default_rng(seed)
    keep = rng.random(len(triangles)) > share
    keep[: len(keep) // 2] |= rng.random(len(keep) // 2) > 0.5
    closed = closing(points, triangles[keep])
    surface, report = checked_surface(points, closed, crossings=True)
    whole = Surface(points, triangles)
    assert genus(surface) == genus(whole)
    assert abs(report["volume"] / volume(whole) - 1.0) < 2.0 * share


def test_mending_says_what_it_did(tmp_path):
    points, triangles = ball(3)
    top = (points[triangles].mean(axis=1) @ (0.6, 0.0, 0.8)) > 0.8
    side = (points[triangles].mean(axis=1) @ (0.0, -1.0, 0.0)) > 0.97
    turned = triangles[~(top | side)].copy()
    turned[::3] = turned[::3, ::-1]
    path = write(tmp_path / "holes.off", np.concatenate([points, [(9, 9, 9)]]), turned)
    with pytest.raises(InputError, match="mend=true"):
        read_surface(path)
    surface, report = read_surface(path, mend=True)
    edges = sum(len(hole.loop) for hole in holes(points, triangles[~(top | side)]))
    done = report["mended"]
    assert done["filled_holes"] == 2
    assert done["edges_around_them"] == edges
    assert done["added_triangles"] == edges - 4
    assert set(done) == {"filled_holes", "edges_around_them", "added_triangles", "added_area"}
    # Flat discs of the caps' radius, nearly.
    assert abs(done["added_area"] / (np.pi * (1 - 0.8**2 + 1 - 0.97**2)) - 1.0) < 0.2
    assert 0.8 < report["volume"] / volume(Surface(points, triangles)) < 1.0
    assert len(surface.triangles) == len(turned) + edges - 4


@pytest.mark.parametrize("level", [1, 4])
def test_a_spike_through_the_surface_is_cut_off(tmp_path, level):
    """As long as it takes little of the surface with it."""
    points, triangles = ball(level)
    whole = volume(Surface(points, triangles))
    points[np.argmax(points[:, 2])] = (0, 0, -3)
    path = write(tmp_path / "spike.off", points, triangles)
    with pytest.raises(InputError, match="cross each other"):
        read_surface(path)
    if level == 1:
        with pytest.raises(InputError, match=r"cross each other .*does not intersect itself"):
            read_surface(path, mend=True)
        return
    surface, report = read_surface(path, mend=True)
    assert np.abs(surface.points).max() <= 1.0
    assert abs(report["volume"] / whole - 1.0) < 0.01
    assert report["mended"]["removed_crossing_triangles"] > 0


def test_two_balls_that_cross_are_not_one(tmp_path):
    points, triangles = ball(3)
    moved = points + np.array([1.9, 0.05, 0.03])
    path = write(tmp_path / "two.off", np.concatenate([points, moved]), np.concatenate([triangles, triangles + 258]))
    with pytest.raises(InputError, match="2 shells"):
        read_surface(path, mend=True)


def test_large_holes_stay_open(tmp_path):
    points, triangles = ball(3)
    half = points[triangles].mean(axis=1)[:, 2] < 0
    path = write(tmp_path / "half.off", points, triangles[half])
    with pytest.raises(InputError, match=r"half\.off: .*one triangle only.*by hand, mending did not do it"):
        read_surface(path, mend=True)


def test_a_hole_whose_diagonals_are_edges_is_left():
    """Filling it would give an edge to three triangles."""
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1), (0.5, 0.5, -1)], dtype=float)
    walls = np.array([(1, 0, 4), (2, 1, 4), (3, 2, 4), (0, 3, 4)])
    hole = Hole(np.array([0, 1, 2, 3]), np.array([4, 4, 4, 4]))
    made = filled(points, walls, hole)
    assert made is not None
    assert len(made) == 2
    one = filled(points, np.concatenate([walls, [(0, 2, 5)]]), hole)
    assert one is not None
    assert all(set(t) & {1, 3} == {1, 3} for t in one.tolist())
    assert filled(points, np.concatenate([walls, [(0, 2, 5), (1, 3, 5)]]), hole) is None


def test_loops_are_closed_and_simple():
    points, triangles = ball(3)
    keep = np.random.default_rng(5).random(len(triangles)) > 0.3
    border = set()
    for hole in holes(points, triangles[keep]):
        loop = hole.loop.tolist()
        assert len(set(loop)) == len(loop) >= 3
        border |= set(pairwise([*loop, loop[0]]))
    half = {(a, b) for t in triangles[keep].tolist() for a, b in pairwise([*t, t[0]])}
    assert border == {(b, a) for a, b in half if (b, a) not in half}


def _packed(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used = np.unique(triangles)
    return points[used], np.searchsorted(used, triangles)


def test_the_cow_crosses_itself_twice(data):
    path = data / "surface" / "cow.off"
    with pytest.raises(InputError, match="cross each other"):
        read_surface(path)
    _, before = read_surface(path, crossings=True)
    _, report = read_surface(path, mend=True)
    assert report["genus"] == 0
    assert abs(report["volume"] / before["volume"] - 1.0) < 0.01
    assert report["mended"] == {"removed_crossing_triangles": 232}


@pytest.mark.long
def test_the_scanned_bunny(data):
    """Five holes under the base, one of which VTK fills across the surface."""
    surface, report = read_surface(data / "surface" / "stanford_bunny_69k.obj", mend=True)
    assert report["mended"]["filled_holes"] == 5
    assert report["mended"]["edges_around_them"] == 223
    assert len(surface.triangles) == 69451 + 223 - 10
    assert report["genus"] == 0


def test_a_long_border_is_followed_in_one_pass():
    """A sheet with 40000 edges on its border: looking back along the path for each vertex would take minutes."""
    n = 20000
    x = np.arange(n + 1.0)
    points = np.concatenate([np.stack([x, 0 * x, 0 * x], axis=1), np.stack([x, 0 * x + 1, 0 * x], axis=1)])
    low, up = np.arange(n), n + 1 + np.arange(n)
    strip = np.concatenate([np.stack([low, low + 1, up + 1], axis=1), np.stack([low, up + 1, up], axis=1)])
    began = perf_counter()
    (hole,) = holes(points, strip)
    assert len(hole.loop) == 2 * n + 2
    assert perf_counter() - began < 10.0
