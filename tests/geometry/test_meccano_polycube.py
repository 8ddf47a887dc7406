"""Polycubes with a solid's topology, and its surface divided as their boundary."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from geometry.layouts.blocks import polycube
from geometry.layouts.boundary_map import on_surface
from geometry.layouts.creases import attraction
from geometry.layouts.frame import frame_of
from geometry.layouts.layout import borders, check, round_corners
from geometry.layouts.partition import partition, price
from geometry.layouts.polycube import REACH, SLENDER, polycube_layout, polycube_map, slender_map
from geometry.layouts.topology import topology
from geometry.layouts.voxels import Voxels, cuboids, place, voxelise
from geometry.meccano import source
from geometry.meccano.settings import parse
from geometry.meccano.shapes import ball
from geometry.meccano.source import map_of
from geometry.simplices.mean_value import flipped
from geometry.simplices.overlay import Curve, join, overlay, split, spread
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface, area_vectors, euler_characteristic, genus, sharp, volume
from iga.cells import HEXAHEDRON
from iga.errors import InputError
from iga.progress import QUIET
from tests.surfaces import body, boundary_of, torus

RING = np.array([[[0, 0, 0], [3, 1, 1]], [[0, 2, 0], [3, 3, 1]], [[0, 0, 0], [1, 3, 1]], [[2, 0, 0], [3, 3, 1]]])


def sphere(levels: int = 3) -> Surface:
    """The octahedron, each triangle cut in four so many times."""
    surface = Surface(
        np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float),
        np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]),
    )
    for _ in range(levels):
        middle = surface.points[surface.edges].sum(axis=1)
        a, b, c = surface.triangles.T
        p, q, r = (len(surface.points) + surface.edge_of).T
        cut = ((a, p, r), (p, b, q), (r, q, c), (p, q, r))
        points = np.concatenate((surface.points, middle))
        surface = Surface(
            points / np.linalg.norm(points, axis=1)[:, None], np.concatenate([np.stack(t, axis=1) for t in cut])
        )
    return surface


def test_overlay_keeps_the_surface() -> None:
    surface = torus(8, 6)
    # Two curves leave vertex 0 through the same edge and part in the next triangle.
    edge = {tuple(ends): k for k, ends in enumerate(surface.edges.tolist())}
    one = Curve(0, 13, np.array([edge[6, 7]]), np.array([0.3]))
    two = Curve(0, 14, np.array([edge[6, 7], edge[7, 13]]), np.array([0.6, 0.4]))
    curves = join([one, two])
    cut = overlay(surface, spread(curves))
    assert len(cut.triangles) == len(surface.triangles) + 2 * len(curves.edge)
    made = Surface(cut.points, cut.triangles)
    assert euler_characteristic(made) == euler_characteristic(surface)
    areas = np.linalg.norm(area_vectors(made), axis=1)
    assert abs(areas.sum() / np.linalg.norm(area_vectors(surface), axis=1).sum() - 1) < 1e-12
    assert areas.min() > 1e-4 * areas.mean()
    # A curve is a chain of as many sides as it has crossings, and one more; each belongs to two triangles.
    assert np.bincount(cut.curve[cut.curve >= 0]).tolist() == [2 * (len(c.edge) + 1) for c in split(curves)]
    with pytest.raises(ValueError, match="cross"):
        overlay(surface, join([one, Curve(6, 1, np.array([edge[0, 7]]), np.array([0.5]))]))


@pytest.fixture(scope="module")
def ring_layout():
    return polycube_layout(torus(), sweeps=4)


def test_a_torus_becomes_a_ring_of_eight_voxels(ring_layout) -> None:
    layout, report = ring_layout
    assert report["voxels"] == 8
    assert report["boundary_sides"] == 32
    assert frame_of(layout.blocks).genus == 1


def test_patches_are_disks_beside_each_other_as_the_sides(ring_layout) -> None:
    layout, _ = ring_layout
    check(layout)
    assert genus(layout.surface) == 1
    # Around a corner the borders follow each other as in the meccano: every corner of a patch is one of its side.
    rows = round_corners(layout.blocks)
    for f in range(len(rows)):
        corners = np.intersect1d(layout.corner, layout.surface.triangles[layout.side == f])
        assert set(corners) == set(layout.corner[rows[f]])
    assert len(borders(layout.blocks)) == 2 * len(rows)
    assert abs(volume(layout.surface) / volume(torus()) - 1) < 1e-12


def test_patches_of_a_torus_are_even(ring_layout) -> None:
    _, report = ring_layout
    # Outside and inside of this torus differ in length by 1.4 / 0.6; corners of the ring take two sides.
    assert report["smallest_patch"] > 0.35
    assert report["largest_patch"] < 2.2
    assert report["border_ratio"] < 5


def test_the_map_is_one_to_one_and_continuous() -> None:
    mapping, report = polycube_map(torus(24, 12), cuboids(torus(), RING), sweeps=1)
    assert report["smallest_patch"] > 0.1
    assert len(flipped(mapping.parameters)) == 0
    plane = mapping.parameters
    u, v = plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]
    areas = np.bincount(mapping.side, (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2)
    assert np.abs(areas - 1).max() < 1e-12
    # Both sides of every edge give the same points of the surface.
    rows = round_corners(mapping.blocks).tolist()
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    t = np.linspace(0, 1, 7)[:, None]
    for a, b, f, g in borders(mapping.blocks):
        points = []
        for side in (f, g):
            start, end = square[rows[side].index(a)], square[rows[side].index(b)]
            points.append(on_surface(mapping, np.full(7, side), start + t * (end - start))[0])
        assert np.abs(points[0] - points[1]).max() < 1e-12


def test_a_cube_and_cuboids_may_be_given() -> None:
    surface = sphere()
    layout, report = polycube_layout(surface, cuboids(surface, np.array([[[0, 0, 0], [1, 1, 1]]])), sweeps=3)
    check(layout)
    # The sphere and the cube have the same symmetry.
    assert report["smallest_patch"] > 0.8
    corner = cuboids(surface, np.array([[[0, 0, 0], [2, 1, 1]], [[0, 1, 0], [1, 2, 1]]]))
    layout, _ = polycube_layout(surface, corner, sweeps=1)
    check(layout)
    assert len(layout.blocks.corners) == 3


def test_other_topology_is_refused() -> None:
    surface = torus(12, 8)
    with pytest.raises(InputError, match="genus 0, but the surface has genus 1"):
        cuboids(surface, np.array([[[0, 0, 0], [2, 2, 1]]]))
    with pytest.raises(InputError, match="2 parts"):
        cuboids(surface, np.array([[[0, 0, 0], [1, 1, 1]], [[2, 0, 0], [3, 1, 1]]]))
    with pytest.raises(InputError, match="touch themselves"):
        cuboids(surface, np.array([[[0, 0, 0], [1, 1, 1]], [[1, 1, 0], [2, 2, 1]], [[0, 0, 1], [2, 2, 2]]]))
    with pytest.raises(InputError, match="cuboid 0 from"):
        cuboids(surface, np.array([[[0, 0, 0], [0, 1, 1]]]))
    with pytest.raises(InputError, match=r"cuboid 1 has corners .*1\.5.* no whole numbers"):
        cuboids(surface, np.array([[[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [1, 1.5, 1]]]))
    with pytest.raises(InputError, match=r"cuboid 0 has corners .*nan"):
        cuboids(surface, np.array([[[0, 0, 0], [np.nan, 1, 1]]]))
    with pytest.raises(InputError, match=r"cuboids span 1e\+18 unit cubes, more than 1e\+07"):
        cuboids(surface, np.array([[[0, 0, 0], [10**6, 10**6, 10**6]]]))
    with pytest.raises(InputError, match="genus 0, but the surface has genus 1"):
        polycube_layout(surface, cuboids(sphere(1), np.array([[[0, 0, 0], [1, 1, 1]]])))
    with pytest.raises(InputError, match="no set of voxels has the surface's genus 1"):
        voxelise(surface, 2)


@pytest.mark.parametrize(
    ("name", "handles"),
    [
        ("bob_small.ply", 1),
        pytest.param("kitten.off", 1, marks=pytest.mark.long),
        pytest.param("eight.off", 2, marks=pytest.mark.long),
        pytest.param("fertility.off", 4, marks=pytest.mark.long),
    ],
)
def test_real_models(data: Path, name: str, handles: int) -> None:
    surface, _ = read_surface(data / "surface" / name)
    layout, report = polycube_layout(surface)
    check(layout)
    assert genus(layout.surface) == handles
    assert frame_of(layout.blocks).genus == handles
    assert report["smallest_patch"] > 0.1


def inside_of(voxels: Voxels) -> np.ndarray:
    """Which voxels of the grid belong to the set."""
    inside = np.zeros([len(line) - 1 for line in voxels.planes], dtype=bool)
    inside[tuple(voxels.cells.T)] = True
    return inside


LEGS = [(i, j, 1) for i in range(3) for j in range(3)] + [(i, j, 0) for i in (0, 2) for j in (0, 2)]
WINGS = [(i, 1, k) for i in range(3) for k in range(3)] + [(1, j, 1) for j in (0, 2)]


@pytest.mark.parametrize("surface", [
    body(LEGS, [0, 0.5, 3.5, 4], [0, 0.5, 1.5, 2], [0, 2.5, 4]),
    body(WINGS, [0, 1, 2, 4], [0, 2, 2.6, 4.6], [0, 0.25, 0.4, 0.65]),
], ids=["legs", "wings"])
def test_thin_limbs_are_left_out_or_followed(surface: Surface) -> None:
    slender = voxelise(surface, fullness=SLENDER, reach=REACH)
    voxels = slender.voxels
    assert voxelise(surface).reach > 1.0
    assert slender.reach <= REACH
    # The same by another way: distances from points of the surface to the nearest voxel, in space.
    middles = place(voxels, voxels.cells) + 0.5 * voxels.size * voxels.rotation.sum(axis=0)
    away = np.abs((surface.points[:, None] - middles) @ voxels.rotation.T).max(axis=2).min(axis=1)
    assert abs(away.max() / voxels.size - 0.5 - slender.reach) < 1e-9
    assert frame_of(polycube(voxels.cells)).genus == 0
    # Of the finer ones beside it, none that fits worse is taken.
    finer = voxelise(surface, fullness=SLENDER, reach=REACH, beyond=1.0)
    assert finer.mismatch <= slender.mismatch
    assert 0.0 <= finer.resolution - slender.resolution <= 1.0
    # What the report says is so.
    assert slender.report()["boundary_sides"] == topology(inside_of(voxels)).faces
    assert slender.report()["voxels"] == len(voxels.cells)


@pytest.mark.long
def test_a_polycube_that_follows_limbs_has_the_better_map() -> None:
    surface = body(LEGS, [0, 0.5, 3.5, 4], [0, 0.5, 1.5, 2], [0, 2.5, 4])
    mapping, _ = slender_map(surface, 10.0)
    plain, _ = polycube_map(surface, limit=10.0)
    assert len(flipped(mapping.parameters)) == 0
    assert price(mapping) < price(plain)
    finer, report = slender_map(surface, 10.0, resolution=8.0)
    assert report["resolution"] == 8.0
    assert len(flipped(finer.parameters)) == 0
    assert price(finer) < price(plain)


def test_borders_of_a_polycube_follow_creases() -> None:
    surface = body([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [0, 1.1, 2], [0, 0.9, 2], [0, 1.0])
    layout, _ = polycube_layout(surface, sweeps=4)
    check(layout)
    cut = layout.surface
    creases = cut.edges[sharp(cut)]
    length = np.linalg.norm(cut.points[creases[:, 1]] - cut.points[creases[:, 0]], axis=1)
    across = layout.side[cut.beside[sharp(cut)]]
    assert abs(length.sum() / (8 + 8 + 6) - 1) < 1e-9
    assert length[across[:, 0] == across[:, 1]].sum() < 1e-9
    # A surface without creases has nothing that attracts.
    assert attraction(torus(), frame_of(layout.blocks)) is None


def test_a_polycube_and_its_surface_map_may_be_given() -> None:
    blocks = polycube(cuboids(torus(), RING).cells)
    surface, labels = boundary_of(blocks, 3)
    assert genus(surface) == 1
    settings = parse({"cuboids": "; ".join(",".join(map(str, box.ravel())) for box in RING), "labels": labels.tolist()})
    mapping, _ = map_of(surface, settings, QUIET)
    # Every side is laid on its own patch, as straight as that is.
    side = np.repeat(np.arange(len(labels) // 18), 5)
    s = np.tile(np.random.default_rng(3).random((5, 2)), (len(labels) // 18, 1))
    expected = np.einsum("qa,qac->qc", np.stack(
        [(1 - s[:, 0]) * (1 - s[:, 1]), s[:, 0] * (1 - s[:, 1]), s[:, 0] * s[:, 1], (1 - s[:, 0]) * s[:, 1]], axis=-1
    ), mapping.blocks.places[round_corners(mapping.blocks)[side]])
    assert np.abs(on_surface(mapping, side, s)[0] - expected).max() < 1e-9
    with pytest.raises(InputError, match="no such corner"):
        polycube_map(surface, cuboids(surface, RING), labels=np.roll(labels, 18))
    with pytest.raises(InputError, match="one of 0"):
        polycube_map(surface, cuboids(surface, RING), labels=labels[1:])


@pytest.mark.parametrize(("texts", "message"), [
    ({"corners": "1,2; 3,4"}, "corners must be auto or rows of 3 entries"),
    ({"cuboids": "0,0,0,1,1"}, "rows of 6 entries"),
    ({"labels": "nowhere.txt"}, "labels must be auto or a file"),
    ({"labels": [1, -2]}, "whole numbers from 0 on, not .1, -2"),
    ({"corners": "1,2,3", "cuboids": "0,0,0,1,1,1"}, "corners are those of a cube"),
    ({"corners": "1,2,3", "meccano": "polycube"}, "corners are those of a cube"),
])
def test_what_is_given_by_hand_is_checked(texts: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(texts)


def test_corners_may_be_given_as_a_text() -> None:
    corners = (2 * HEXAHEDRON.vertices - 1) / np.sqrt(3)
    text = "; ".join(",".join(map(repr, row)) for row in corners.tolist())
    surface = sphere()
    mapping, _ = map_of(surface, parse({"corners": text}), QUIET)
    found = on_surface(mapping, np.arange(6), np.zeros((6, 2)))[0]
    layout = partition(surface, corners)
    nearest = layout.surface.points[layout.corner]
    assert np.abs(nearest - corners).max() < 0.05
    assert np.abs(found - nearest[round_corners(mapping.blocks)[:, 0]]).max() < 1e-12


def test_a_dear_cube_is_compared_with_a_polycube(monkeypatch):
    """The maps are stubs with known prices: only the choice is tested."""
    prices = {"cube": 0.5, "polycube": 0.2, "finer": 0.55}
    monkeypatch.setattr(source, "partition", lambda *a, **k: None)
    monkeypatch.setattr(source, "boundary_map", lambda *a, **k: (_stub("cube"), {}))
    monkeypatch.setattr(source, "polycube_map", lambda *a, **k: (_stub("polycube"), {}))
    monkeypatch.setattr(source, "slender_map", lambda *a, **k: (_stub("finer" if len(a) > 3 else "slender"), {}))
    monkeypatch.setattr(source, "price", lambda mapping: prices[mapping.kind])
    surface = ball(4)
    prices["slender"] = 0.1
    assert map_of(surface, parse({}), QUIET)[1] == {"meccano": "polycube", "price": 0.1}
    prices["slender"] = 0.7
    assert map_of(surface, parse({}), QUIET)[1] == {"meccano": "polycube", "price": 0.2}
    prices["polycube"] = 0.6
    assert map_of(surface, parse({}), QUIET)[1] == {"meccano": "cube", "price": 0.5}
    prices["finer"] = 0.4
    assert map_of(surface, parse({}), QUIET)[1] == {"meccano": "polycube", "price": 0.4}
    prices["finer"] = 0.8
    prices |= {"cube": 0.9 * source.DEAR, "polycube": 0.0}
    assert map_of(surface, parse({}), QUIET)[1]["meccano"] == "cube"

    def refuse(*arguments, **named):
        raise InputError("no room")

    monkeypatch.setattr(source, "partition", refuse)
    assert map_of(surface, parse({}), QUIET)[1]["meccano"] == "polycube"
    monkeypatch.setattr(source, "polycube_map", refuse)
    assert map_of(surface, parse({}), QUIET)[1] == {"meccano": "polycube", "price": 0.7}
    monkeypatch.setattr(source, "slender_map", refuse)
    with pytest.raises(InputError, match="neither on a cube"):
        map_of(surface, parse({}), QUIET)


def _stub(kind: str) -> SimpleNamespace:
    return SimpleNamespace(kind=kind, blocks=SimpleNamespace(corners=[0] if kind == "cube" else [0, 1]))
