"""Bands on the faces of solids: compatible cuts, right triangles and rectangles, and what takes their place."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from geometry.cad.brep import Brep, Coedge, Curve, curve_points, curve_tangents, surface_points
from geometry.hybrid import shapes
from geometry.hybrid.banding import band_elements
from geometry.hybrid.chart import make_chart, to_parameters
from geometry.hybrid.compatible import compatible_cuts, crossings, line_cuts, with_cuts, with_missing
from geometry.hybrid.cutting import joined
from geometry.hybrid.facemesh import mesh_faces
from geometry.hybrid.grid import followed
from geometry.hybrid.measures import beside_edges
from geometry.hybrid.outline import FaceError, regions
from geometry.hybrid.pieces import Pieces, cut_edges, divide_edges, least_pieces
from geometry.hybrid.sealing import Sealed
from geometry.hybrid.sizing import size_edges
from geometry.hybrid.skin import Skin, build_skin
from geometry.hybrid.splining import on_lines, splined
from geometry.patch import Patch
from iga.errors import InputError

Array = NDArray[np.float64]


@cache
def built(name: str = "bracket") -> tuple[Skin, Sealed]:
    """An HB-rep with what went into it."""
    skin = build_skin(shapes.SHAPES[name](), 0.2, 1e-3, kind="hb-rep")
    assert skin.sealed is not None
    return skin, skin.sealed


@cache
def solid(name: str) -> Brep:
    return splined(shapes.SHAPES[name](), 1e-3).brep


@pytest.mark.parametrize(("name", "least"), [("bracket", 4), ("curved_difference", 1)])
def test_pieces_lie_in_one_knot_interval_and_are_monotone_on_both_sides(name: str, least: int) -> None:
    brep = solid(name)
    plain = {e: np.linspace(0.0, 1.0, 6) for e, edge in enumerate(brep.edges) if not edge.degenerate}
    cuts = compatible_cuts(brep)
    assert len(cuts) >= least
    ends = with_missing(with_cuts(plain, cuts), cuts)
    for e, t in ends.items():
        assert np.diff(t).min() > 1e-6
        inner = t[:-1, None] + np.diff(t)[:, None] * np.linspace(0.02, 0.98, 9)
        for f, k, i in brep.coedges_of[e]:
            face = brep.faces[f]
            c = face.loops[k][i]
            p = curve_points(c.curve, inner.ravel()).reshape(*inner.shape, 2)
            along = followed(c, face.surface)
            for d in range(2):
                if d == along:
                    continue
                x = np.unique(face.surface.knots[d])
                interval = np.searchsorted(x, p[..., d])
                assert (interval == interval[:, :1]).all()
                if along < 0:
                    slope = curve_tangents(c.curve, inner.ravel()).reshape(p.shape)[..., d]
                    small = 1e-6 * np.abs(slope).max()
                    assert ((slope > -small).all(axis=1) | (slope < small).all(axis=1)).all()


def test_curves_that_leave_the_surface_by_a_tolerance_cross_no_knot_there() -> None:
    """The border of a surface is no knot line: a cut where a curve passes it would leave a piece as short as that."""
    surface = Patch((np.array([0, 0, 0.5, 1, 1.0]), np.array([0, 0, 1, 1.0])), np.zeros((3, 2, 3)))
    curve = Curve(np.array([0, 0, 1, 1.0]), np.array([(-1e-5, 0.2), (1.0 + 1e-5, 0.7)]))
    coedge = Coedge(0, False, curve)
    assert len(crossings(coedge, surface.knots)) == 3
    assert np.allclose(crossings(coedge, surface.knots, inner=True), [0.5])


def test_other_ends_give_way_to_cuts() -> None:
    ends = {0: np.linspace(0.0, 1.0, 5)}
    made = with_cuts(ends, {0: np.array([0.27, 0.6])})[0]
    assert np.allclose(made, [0.0, 0.27, 0.5, 0.6, 0.75, 1.0])
    assert np.array_equal(with_missing({0: made}, {0: np.array([0.27, 0.3])})[0], np.sort([*made, 0.3]))


def test_lines_cut_edges_that_follow_no_parameter_line() -> None:
    brep = solid("curved_difference")
    ends = {e: np.linspace(0.0, 1.0, 4) for e in range(len(brep.edges))}
    lines = {f: tuple(np.linspace(x[0], x[-1], 6) for x in face.surface.knots) for f, face in enumerate(brep.faces)}
    made = line_cuts(brep, ends, {}, lines)  # type: ignore[arg-type]
    more = [e for e in ends if len(made[e]) > len(ends[e])]
    assert more
    for e in ends:
        uses = [(f, brep.faces[f].loops[k][i]) for f, k, i in brep.coedges_of[e]]
        if any(followed(c, brep.faces[f].surface) >= 0 for f, c in uses):
            assert np.array_equal(made[e], ends[e])
        assert np.diff(made[e]).min() > 0.05


def test_bands_have_right_angles_on_parameter_lines() -> None:
    """Every right triangle has a side on a trimming curve, two on parameter lines, and its corner inside the face."""
    skin, sealed = built()
    right = rectangles = 0
    for mesh in sealed.meshes:
        if mesh.band is None:
            continue
        t, r = len(mesh.band.segment), len(mesh.band.low)
        right += t
        rectangles += r
        assert np.array_equal(mesh.low[len(mesh.low) - r :], mesh.band.low)
        assert len(mesh.legs) == 2 * t
        uv = to_parameters(mesh.chart, mesh.points)
        apart = np.abs(uv[mesh.legs[:, 0]] - uv[mesh.legs[:, 1]]) / np.ptp(uv, axis=0)
        assert (apart.min(axis=1) < 1e-9).all()
        assert (apart.max(axis=1) > 1e-4).all()
    assert right > 40
    assert rectangles > 5
    rows = [row for row in skin.report["cad_faces_with_quadrilaterals"] if "right_triangles" in row]
    assert sum(row["right_triangles"] for row in rows) == right
    assert all(0.0 <= row["omega_banded"] < 1.0 for row in rows)
    pieces = [row["right_triangles"] + sum(row["without_right_triangle"].values()) for row in rows]
    assert sum(pieces) == sum(2 for _ in sealed.made.curves)
    assert not skin.report["cad_faces_without_band"]


def disc(radius: float = 0.3, pieces: int = 8) -> tuple[Array, NDArray[np.int64]]:
    """Outline of the unit square with a round hole, cubic pieces, the inside on the left."""
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], dtype=float)
    s = np.linspace(0.0, 1.0, 4)[:, None]
    straight = [a + s * (b - a) for a, b in pairwise(square)]
    angle = np.linspace(0.0, -2.0 * np.pi, pieces + 1)
    p = 0.5 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    way = radius * np.stack([np.sin(angle), -np.cos(angle)], axis=1) * (2.0 * np.pi / pieces) / 3.0
    hole = [np.stack([p[k], p[k] + way[k], p[k + 1] - way[k + 1], p[k + 1]]) for k in range(pieces)]
    following = np.concatenate([np.roll(np.arange(4), -1), 4 + np.roll(np.arange(pieces), -1)])
    return np.stack([*straight, *hole]), following


def test_elements_of_a_round_hole() -> None:
    """Four of eight pieces turn away from their extremum along a leg; the others have triangles with rectangles."""
    chart = make_chart(solid("curved_box").faces[0])
    plane, following = disc(pieces=16)
    lines = (np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    found = band_elements(plane, following, lines, np.zeros((0, 2, 2)), chart)
    assert found.without == {"flat": 4, "tangent": 8}
    assert len(found.segment) == 8
    assert len(found.low) == 4  # between the two triangles of each quarter
    for s, corner in zip(found.segment, found.corner):
        ends = plane[s, [0, 3]]
        assert corner[0] in ends[:, 0]
        assert corner[1] in ends[:, 1]
        assert np.linalg.norm(corner - 0.5) > 0.3
    # A line through a rectangle, or a cell on it, leaves it out.
    blocked = (np.sort([0.0, 1.0, found.low[0, 0] * 0.5 + found.high[0, 0] * 0.5]), lines[1])
    assert len(band_elements(plane, following, blocked, np.zeros((0, 2, 2)), chart).low) < 4
    cell = np.array([(found.low[0] - 0.01, found.high[0] + 0.01)])
    crowded = band_elements(plane, following, lines, cell, chart)
    assert crowded.crowded.all() or len(crowded.low) < 4


def test_curves_that_come_close_leave_triangles_out() -> None:
    chart = make_chart(solid("curved_box").faces[0])
    plane, following = disc(radius=0.49, pieces=24)
    lines = (np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    found = band_elements(plane, following, lines, np.zeros((0, 2, 2)), chart)
    assert found.without == {"flat": 4, "tangent": 8, "meeting": 8}
    assert len(found.low) == 4
    for low, high in zip(found.low, found.high):
        assert (low >= -1e-12).all()
        assert (high <= 1.0 + 1e-12).all()
        corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
        assert (np.linalg.norm(corners - 0.5, axis=1) > 0.49 - 1e-9).all()


def test_gaps_count_for_the_elements_at_their_edge() -> None:
    made = built()[1].made
    off = np.zeros(1 + int(made.curves[:, 2].max()))
    off[made.curves[3, 2]] = 0.25
    found = beside_edges(made, off)
    at = set(made.curves[made.curves[:, 2] == made.curves[3, 2], :2].ravel().tolist())
    touching = [bool(at & set(own)) for part in made.parts for own in part.corners.tolist()]
    assert np.array_equal(found, np.where(touching, 0.25, 0.0))


def circle(radius: float, centre: float, pieces: int, turn: float) -> Array:
    """Cubic pieces (k, 4, 2) of a circle around (centre, centre), turn = 1 counter-clockwise and -1 clockwise."""
    angle = turn * np.linspace(0.0, 2.0 * np.pi, pieces + 1)
    p = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    way = turn * radius * np.stack([-np.sin(angle), np.cos(angle)], axis=1) * (2.0 * np.pi / pieces) / 3.0
    return np.stack([p[:-1], p[:-1] + way[:-1], p[1:] - way[1:], p[1:]], axis=1)


def inside(ring: Array, points: Array) -> NDArray[np.bool_]:
    """Points (k,) inside a polygon, by the angle that it takes around them."""
    off = ring - points[:, None]
    after = np.roll(off, -1, axis=1)
    cross = off[..., 0] * after[..., 1] - off[..., 1] * after[..., 0]
    return np.abs(np.arctan2(cross, (off * after).sum(axis=-1)).sum(axis=1)) > np.pi


@pytest.mark.parametrize("pieces", [(20, 16), (16, 8), (12, 20), (24, 9)])
@pytest.mark.parametrize("centre", [0.5, 0.51, 0.487])
def test_elements_between_nearly_concentric_curves_keep_off_both(pieces: tuple[int, int], centre: float) -> None:
    """Two circles nearer to each other than elements are large, and all in one knot interval: nothing crosses them."""
    chart = make_chart(solid("curved_box").faces[0])
    plane = np.concatenate([circle(0.45, 0.5, pieces[0], 1.0), circle(0.38, centre, pieces[1], -1.0)])
    following = np.concatenate([np.roll(np.arange(pieces[0]), -1), pieces[0] + np.roll(np.arange(pieces[1]), -1)])
    lines = (np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    found = band_elements(plane, following, lines, np.zeros((0, 2, 2)), chart)
    t = np.linspace(0.0, 1.0, 60)[:, None, None]
    x = (1 - t) ** 3 * plane[:, 0] + 3 * t * (1 - t) ** 2 * plane[:, 1]
    x = x + 3 * t**2 * (1 - t) * plane[:, 2] + t**3 * plane[:, 3]
    rings, own = [], []
    for low, high in zip(found.low, found.high):
        rings.append(np.array([low, (high[0], low[1]), high, (low[0], high[1])]))
        own.append(-1)
    for s, corner in zip(found.segment, found.corner):
        rings.append(np.concatenate([x[:, s], corner[None]]))
        own.append(int(s))
    assert rings
    outer, inner = x[:, : pieces[0]].swapaxes(0, 1).reshape(-1, 2), x[:, pieces[0] :].swapaxes(0, 1).reshape(-1, 2)
    for ring, segment in zip(rings, own):
        middle = ring.mean(axis=0)
        small = middle + 0.99 * (ring - middle)
        others = np.delete(x, segment, axis=1) if segment >= 0 else x
        assert not inside(small, others.reshape(-1, 2)).any()
        corners = small[[0, 1, 2, 3]] if segment < 0 else small[-1:]
        assert inside(outer, corners).all()
        assert not inside(inner, corners).any()


def test_points_that_are_near_become_one() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.0)])
    names, everything = joined(points, np.array([(1.0, 1e-12), (0.5, 0.5), (0.5, 0.5 + 1e-12)]), np.ones(2))
    assert names.tolist() == [1, 2, 2]
    assert len(everything) == 3


def straight(points: list[tuple[float, float]]) -> tuple[Array, NDArray[np.int64]]:
    """Outline of a polygon."""
    a = np.array(points, dtype=float)
    step = np.roll(a, -1, axis=0) - a
    s = np.linspace(0.0, 1.0, 4)[None, :, None]
    return a[:, None] + s * step[:, None], np.roll(np.arange(len(a)), -1)


def test_corners_on_the_outline_must_be_its_vertices() -> None:
    """At a sharp corner a leg runs along the edge: it must end where a piece ends."""
    chart = make_chart(solid("curved_box").faces[0])
    lines = (np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    none = np.zeros((0, 2, 2))
    whole = band_elements(*straight([(0, 0), (1, 0), (0, 1)]), lines, none, chart)
    assert whole.corner.tolist() == [[0.0, 0.0]]
    assert whole.without == {"flat": 2}
    halves = band_elements(*straight([(0, 0), (1, 0), (0.5, 0.5), (0, 1)]), lines, none, chart)
    assert halves.without == {"flat": 2, "meeting": 2}
    cut = band_elements(*straight([(0, 0), (0.5, 0), (1, 0), (0.5, 0.5), (0, 1), (0, 0.5)]), lines, none, chart)
    assert sorted(cut.corner.tolist()) == [[0.0, 0.5], [0.5, 0.0]]
    assert np.allclose(np.stack([cut.low, cut.high]), [[[0.0, 0.0]], [[0.5, 0.5]]])


@pytest.mark.parametrize(("higher", "kept"), [(0.0, 2), (1e-9, 2), (1e-5, 1), (1e-3, 1), (0.1, 1)])
def test_legs_from_one_vertex_end_in_one_point(higher: float, kept: int) -> None:
    """In a notch both triangles have a leg straight up; ends that nearly meet would leave a sliver beside it."""
    chart = make_chart(solid("curved_box").faces[0])
    lines = (np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    outline = [(0, 0), (0.2, 0.6), (0.5, 0.3), (0.8, 0.6 + higher), (1, 0), (1, 1), (0, 1)]
    found = band_elements(*straight(outline), lines, np.zeros((0, 2, 2)), chart)
    assert int((np.abs(found.corner[:, 0] - 0.5) < 1e-12).sum()) == kept


def test_a_face_whose_sides_others_have_is_refused_by_name() -> None:
    """An edge of the solid that joins every two vertices: no side inside the first face can be its own."""
    brep = solid("curved_box")
    sizing, wanted = size_edges(brep, 0.6)
    edges, count = cut_edges(brep, divide_edges(brep, sizing, wanted, least_pieces(brep), 1e-2))
    charts = [make_chart(face) for face in brep.faces]
    assert len(mesh_faces(brep, charts, edges, count, sizing, {}, "box")) == 6
    pairs = np.stack(np.triu_indices(count + 300, 1), axis=1).ravel()
    everywhere = Pieces(np.zeros(len(pairs)), pairs, np.zeros((0, 4, 3)))
    with pytest.raises(FaceError, match="box: face_0: sides of its elements are sides") as caught:
        mesh_faces(brep, charts, [*edges, everywhere], count, sizing, {}, "box")
    assert caught.value.face == 0


def test_sides_that_do_not_close_are_refused() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    none = (np.zeros(3), np.zeros(3))
    around = {(0, 1): none, (1, 2): none, (2, 0): none}
    assert [ring.tolist() for ring in regions(points, around)[0]] == [[0, 1, 2]]
    del around[2, 0]
    with pytest.raises(InputError, match="overlap"):
        regions(points, around)


def test_no_knot_lies_next_to_another() -> None:
    surface = solid("curved_box").faces[0].surface
    u, v = surface.knots
    lines = u[0] + np.array([0.0, 0.4, 0.7, 0.999]) * (u[-1] - u[0])
    made = on_lines(surface, (lines, np.unique(v)))
    assert np.allclose(np.unique(made.knots[0]), np.unique(np.concatenate([u, lines[1:3]])))
    uv = np.random.default_rng(3).uniform(0.0, 1.0, (20, 2)) * [np.ptp(u), np.ptp(v)] + [u[0], v[0]]
    assert np.abs(surface_points(made, uv) - surface_points(surface, uv)).max() < 1e-13
