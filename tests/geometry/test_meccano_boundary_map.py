"""The surface's division into patches, their parametrisation, and points of the surface from points of the meccano."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.layouts import partition as divisions
from geometry.layouts.blocks import cube
from geometry.layouts.boundary_map import BoundaryMap, boundary_map, on_surface
from geometry.layouts.layout import SQUARE, Layout, balance, borders, round_corners
from geometry.layouts.partition import cycles, partition
from geometry.simplices.mean_value import area_stretch, flipped, mean_value
from geometry.simplices.paths import loop_of, split_edges, straight, trace, without_chords
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface, area_vectors, checked_surface, volume
from iga.cells import HEXAHEDRON
from iga.errors import InputError


def box(n: int = 6, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[Surface, np.ndarray]:
    """Box of n x n x 2 triangles a side, and the side of each triangle."""
    grid = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    quads = grid[:, None] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    corners = np.concatenate([face.origin * n + triangles @ face.axes.T for face in HEXAHEDRON.faces])
    unique, inverse = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    surface, _ = checked_surface(unique / n * np.array(size), inverse.reshape(-1, 3))
    return surface, np.repeat(np.arange(6), len(triangles))


def sphere(n: int = 8) -> Surface:
    surface, _ = box(n)
    points = np.tan((surface.points - 0.5) * np.pi / 2)
    return Surface(points / np.linalg.norm(points, axis=1, keepdims=True), surface.triangles)


def square_mesh(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Perturbed triangulation of the unit square in the plane z = 0 and its border."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"), axis=-1).reshape(-1, 2) / n
    inner = ((grid > 0) & (grid < 1)).all(axis=1)
    grid[inner] += rng.uniform(-0.25, 0.25, (inner.sum(), 2)) / n
    i, j = np.divmod(np.arange(n * n), n)
    a = i * (n + 1) + j
    triangles = np.concatenate([np.stack([a, a + n + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + 1], 1)])
    border = [*range(0, n * (n + 1), n + 1), *range(n * (n + 1), (n + 1) ** 2 - 1)]
    border += [*range((n + 1) ** 2 - 1, n, -(n + 1)), *range(n, 0, -1)]
    return np.column_stack([grid, np.zeros(len(grid))]), triangles, np.array(border)


def check_map(mapping: BoundaryMap) -> None:
    """Laid one to one on all sides, borders the same from both sides."""
    assert len(flipped(mapping.parameters)) == 0
    edges = mapping.parameters[:, 1:] - mapping.parameters[:, :1]
    area = np.bincount(mapping.side, np.linalg.det(edges) / 2)
    np.testing.assert_allclose(area, 1.0, rtol=1e-12)
    rows = round_corners(mapping.blocks)
    rng = np.random.default_rng(3)
    t = np.concatenate([[0.0, 0.25, 0.5, 1.0], rng.integers(0, 2**20, 200) / 2**20])
    for a, b, f, g in borders(mapping.blocks):
        i, j = rows[f].tolist().index(a), rows[g].tolist().index(b)
        one = SQUARE[i] + t[:, None] * (SQUARE[(i + 1) % 4] - SQUARE[i])
        two = SQUARE[j] + (1 - t)[:, None] * (SQUARE[(j + 1) % 4] - SQUARE[j])
        here, _ = on_surface(mapping, np.full(len(t), f), one)
        there, _ = on_surface(mapping, np.full(len(t), g), two)
        assert (here == there).all()
        # Border points are limits of inner points.
        near, _ = on_surface(mapping, np.full(len(t), f), one + 1e-9 * (0.5 - one))
        assert np.abs(near - here).max() < 1e-4 * mapping.surface.diagonal


def check_division(layout: Layout, before: Surface) -> None:
    assert abs(volume(layout.surface) - volume(before)) < 1e-12 * before.diagonal**3
    shape = balance(layout)
    assert 0 < shape["smallest_patch"] <= 1 <= shape["largest_patch"]


@pytest.mark.parametrize("seed", [1, 7])
def test_mean_value_reproduces_the_plane(seed):
    points, triangles, border = square_mesh(9, seed)
    places = mean_value(points, triangles, border, points[border, :2])
    assert np.abs(places - points[:, :2]).max() < 5e-15
    stretch = area_stretch(points, triangles, places[triangles])
    np.testing.assert_allclose(stretch, 1.0, rtol=1e-11)


def test_mean_value_of_a_deep_cap():
    points, triangles, border = square_mesh(24, 5)
    x, y = points[:, :2].T
    points[:, 2] = 6 * np.exp(-40 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    spread = []
    for rounds in (0, 8):
        places = mean_value(points, triangles, border, points[border, :2], rounds)
        assert len(flipped(places[triangles])) == 0
        stretch = area_stretch(points, triangles, places[triangles])
        spread.append(stretch.max() / stretch.min())
    assert spread[1] < 0.2 * spread[0]


def test_flips_are_decided_exactly():
    e = 2.0**-52
    plane = np.array([
        [(0, 0), (1, 0), (0, 1)], [(0, 0), (0, 1), (1, 0)], [(0, 0), (1, 1), (2, 2)],
        [(0, 0), (1, 1), (1, 1 + e)], [(0, 0), (1, 1), (1 + e, 1)], [(0.1, 0.1), (0.3, 0.3), (0.7, 0.7)],
    ], dtype=float)
    assert flipped(plane).tolist() == [1, 2, 4, 5]


def test_split_edges_keep_the_surface():
    surface, _ = box(3)
    rng = np.random.default_rng(11)
    edges = np.sort(rng.choice(len(surface.edges), 60, replace=False))
    share = rng.uniform(0.1, 0.9, (60, 1))
    ends = surface.points[surface.edges[edges]]
    made, origin = split_edges(surface, edges, ends[:, 0] * (1 - share) + ends[:, 1] * share)
    again, report = checked_surface(made.points, made.triangles)
    assert report["genus"] == 0
    assert abs(volume(again) - 1) < 1e-14
    area = np.linalg.norm(area_vectors(made), axis=1)
    np.testing.assert_allclose(np.bincount(origin, area), 1 / 18, rtol=1e-12)


def test_traced_paths_do_not_touch_walls():
    surface, _ = box(2)
    corner = int(np.argmin((surface.points**2).sum(axis=1)))
    far = int(np.argmax((surface.points**2).sum(axis=1)))
    walls, inner, split = np.zeros((0, 2), dtype=np.int64), [], 0
    for _ in range(5):
        path = trace(surface, corner, far, walls=walls)
        # New vertices are in the middle of the edges that they split.
        assert (path.surface.points[len(surface.points) :] == surface.points[path.split].mean(axis=1)).all()
        assert path.length >= np.sqrt(3)
        surface, walls = path.surface, np.concatenate([walls, path.edges])
        inner.append(path.vertices[1:-1])
        split += len(path.split)
    assert split > 0
    assert len(np.unique(np.concatenate(inner))) == sum(map(len, inner))
    assert abs(volume(surface) - 1) < 1e-14


def test_straight_paths_are_straight():
    points, triangles, border = square_mesh(8, 2)
    # Closed by a cone below, so that it is a surface.
    apex = len(points)
    cone = np.stack([border, np.full(len(border), apex), np.roll(border, -1)], axis=1)
    surface, _ = checked_surface(np.concatenate([points, [[0.5, 0.5, -1]]]), np.concatenate([triangles, cone]))
    inside = np.arange(len(surface.triangles)) < len(triangles)
    path = straight(surface, inside, surface.points[:, :2], 0, 80)
    places = path.surface.points[path.vertices]
    assert (path.vertices[[0, -1]] == [0, 80]).all()
    assert np.abs(places[:, 0] - places[:, 1]).max() < 0.05
    assert (np.diff(places[:, 0] + places[:, 1]) > 0).all()
    pairs = {tuple(sorted(e)) for e in zip(path.vertices.tolist(), path.vertices[1:].tolist())}
    assert pairs <= {tuple(e) for e in path.surface.edges.tolist()}


def test_chords_are_split():
    surface, side = box(3)
    made, origin = without_chords(surface, side)
    for f in range(6):
        inside = side[origin] == f
        loop = set(loop_of(made, inside, int(made.triangles[inside].min())).tolist()) if f == 0 else None
        border = np.zeros(len(made.points), dtype=bool)
        pairs = side[origin][made.beside]
        border[made.edges[pairs[:, 0] != pairs[:, 1]]] = True
        inner = (pairs[:, 0] == f) & (pairs[:, 1] == f)
        assert not border[made.edges[inner]].all(axis=1).any()
        if loop is not None:
            assert len(loop) == 12


def test_a_cube_given_by_labels_is_mapped_as_itself():
    surface, side = box(5, (1.0, 1.0, 1.0))
    mapping, report = boundary_map(partition(surface, labels=side))
    check_map(mapping)
    rng = np.random.default_rng(5)
    f, s = rng.integers(0, 6, 3000), rng.uniform(0, 1, (3000, 2))
    points, triangle = on_surface(mapping, f, s)
    faces = HEXAHEDRON.faces
    exact = np.array([faces[k].origin + faces[k].axes @ x for k, x in zip(f, s)])
    assert np.abs(points - exact).max() < 1e-13
    assert (mapping.side[triangle] == f).all()
    np.testing.assert_allclose(report["area_stretch"], 1.0, rtol=1e-10)


def test_a_sphere_is_divided_evenly():
    surface = sphere()
    layout = partition(surface, rounds=1)
    check_division(layout, surface)
    assert balance(layout)["smallest_patch"] > 0.8
    mapping, _ = boundary_map(layout)
    check_map(mapping)


def test_corners_given_by_hand_stay():
    surface = sphere()
    corners = (2 * HEXAHEDRON.vertices - 1) / np.sqrt(3)
    layout = partition(surface, corners=corners)
    np.testing.assert_allclose(layout.surface.points[layout.corner], corners, atol=1e-12)
    assert balance(layout)["smallest_patch"] > 0.9
    check_map(boundary_map(layout)[0])


def test_divisions_given_wrongly_are_refused():
    surface, side = box(3)
    with pytest.raises(InputError, match="one of 0"):
        partition(surface, labels=side[1:])
    with pytest.raises(InputError, match="no such corner"):
        partition(surface, labels=np.array([0, 2, 1, 3, 4, 5])[side])
    with pytest.raises(InputError, match="same vertex"):
        partition(surface, corners=np.zeros((8, 3)))


@pytest.mark.parametrize("failing", [1, 2])
def test_corners_that_cannot_be_joined(failing, monkeypatch):
    """One choice of corners is left if the other fails; if both do, the message says what to give."""
    calls = []

    def connected(surface, blocks, chosen):
        calls.append(chosen)
        if len(calls) <= failing:
            raise InputError("no path leads from vertex 1 to vertex 2")
        return joined(surface, blocks, chosen)

    joined = divisions._connected
    monkeypatch.setattr(divisions, "_connected", connected)
    if failing == 1:
        layout = partition(sphere(), rounds=1)
        assert balance(layout)["smallest_patch"] > 0.5
    else:
        with pytest.raises(InputError, match="could not be divided by itself, give corners or labels: no path leads"):
            partition(sphere(), rounds=1)
    assert len(calls) == 2


def test_the_cube_has_six_cycles():
    assert len(cycles()) == 6
    assert len(borders(cube())) == 12


def test_a_box_is_divided_along_its_creases():
    surface, _ = box(5, (2.0, 1.0, 1.3))
    layout = partition(surface, rounds=0)
    normal = area_vectors(layout.surface)
    for f in range(6):
        own = normal[layout.side == f]
        assert np.linalg.norm(own.sum(axis=0)) > (1 - 1e-12) * np.linalg.norm(own, axis=1).sum()
    check_map(boundary_map(layout)[0])


def test_bounds_on_stretch_are_kept():
    surface = sphere(12)
    points = surface.points * (1 + 5 * np.exp(-40 * (1 - surface.points @ np.array([0.36, 0.48, 0.8])))[:, None])
    corners = (2 * HEXAHEDRON.vertices - 1) / np.sqrt(3)
    layout = partition(Surface(points, surface.triangles), corners=corners)
    stretch = []
    for limit in (1e9, 40.0):
        mapping, report = boundary_map(layout, limit)
        check_map(mapping)
        stretch.append(report["area_stretch"][1])
    assert stretch[0] > 100
    assert stretch[1] < 80


def check_model(path) -> None:
    surface, _ = read_surface(path, crossings=True)
    layout = partition(surface)
    check_division(layout, surface)
    mapping, report = boundary_map(layout)
    check_map(mapping)
    assert report["area_stretch"][1] < 5e4
    # The lines of s cross at an angle; on four fifths of the surface at 45 degrees or more.
    space, plane = mapping.surface.points[mapping.surface.triangles], mapping.parameters
    edges = np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], axis=2)
    slopes = np.stack([space[:, 1] - space[:, 0], space[:, 2] - space[:, 0]], axis=2) @ np.linalg.inv(edges)
    sine = np.linalg.norm(np.cross(slopes[..., 0], slopes[..., 1]), axis=1)
    sine /= np.linalg.norm(slopes, axis=1).prod(axis=1)
    area = np.linalg.norm(area_vectors(mapping.surface), axis=1)
    assert area[sine > np.sqrt(0.5)].sum() > 0.7 * area.sum()


def test_spot(data):
    check_model(data / "surface" / "spot.obj")


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["bunny_7k.off", "bunny_22k.off", "bone.off", "airplane1.off", "cow.off", "horse.off"]
)
def test_models(data, name):
    check_model(data / "surface" / name)
