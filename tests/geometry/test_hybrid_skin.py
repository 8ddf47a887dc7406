"""Watertight skins of trimmed solids."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry.cad.brep import Brep, curve_points, surface_points
from geometry.cad.integrals import integrals_of
from geometry.hybrid import read_cad, shapes
from geometry.hybrid.chart import line_frames, line_points, make_chart, to_chart, to_parameters
from geometry.hybrid.curves import bezier_points, fit_cubics
from geometry.hybrid.ears import bridged
from geometry.hybrid.sizing import normal_curvature
from geometry.hybrid.skin import Skin, build_skin
from geometry.hybrid.triangulation import triangulate
from geometry.simplices.crossing import crossing_pairs
from iga.bernstein import bernstein
from iga.cells import TRIANGLE
from iga.errors import InputError


@cache
def solid(name: str) -> Brep:
    return shapes.SHAPES[name]()


@cache
def skin_of(name: str) -> Skin:
    return build_skin(solid(name))


def test_arcs_are_met_to_the_sixth_power() -> None:
    errors = []
    for angle in (np.pi / 2, np.pi / 4, np.pi / 8):
        def arc(s: np.ndarray, angle: float = angle) -> np.ndarray:
            return np.stack([np.cos(angle * s), np.sin(angle * s), 0 * s], axis=-1)

        ends = arc(np.array([[0.0], [1.0]]))[:, :, :]
        control, distance = fit_cubics(arc, ends[0], ends[1])
        radius = np.linalg.norm(bezier_points(control, np.linspace(0, 1, 101)), axis=-1)
        errors.append(np.abs(radius - 1).max())
        assert distance[0] == pytest.approx(errors[-1], rel=0.2)
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (np.abs(rates - 6) < 0.15).all()
    assert errors[0] < 3e-4


def test_line_frames_are_derivatives() -> None:
    random = np.random.default_rng(4)
    for face in solid("bracket").faces + solid("curved_difference").faces:
        chart = make_chart(face)
        a, b = (to_chart(chart, curve_points(face.loops[0][0].curve, random.random(5))) for _ in range(2))
        b = b + 0.05 * np.ptp(a, axis=0).max()
        s = 0.2 + 0.6 * random.random((5, 3))
        x, dx = line_frames(face, chart, a, b, s)
        assert x == pytest.approx(line_points(face, chart, a, b, s), abs=1e-12 * np.abs(x).max())
        step = 1e-5
        far = [line_points(face, chart, a, b, s + sign * step) for sign in (1.0, -1.0)]
        assert dx == pytest.approx((far[0] - far[1]) / (2.0 * step), abs=1e-7 * np.abs(x).max())


def test_poles_are_not_taken_for_sharp_bends() -> None:
    cap = next(face for face in solid("tetrapod").faces if face.kind == "sphere")
    ends = [k[i] for k in cap.surface.knots for i in (0, -1)]
    corners = np.array([(u, v) for u in ends[:2] for v in ends[2:]])
    assert normal_curvature(cap.surface, corners) == pytest.approx(2.0, rel=1e-3)
    assert skin_of("tetrapod").space.elements < 900


@pytest.mark.parametrize("name", ["bracket", "curved_difference"])
def test_charts_invert(name: str) -> None:
    random = np.random.default_rng(3)
    for face in solid(name).faces:
        chart = make_chart(face)
        low, high = (np.array([k[i] for k in face.surface.knots]) for i in (0, -1))
        uv = low + (high - low) * random.random((40, 2))
        assert to_parameters(chart, to_chart(chart, uv)) == pytest.approx(uv, abs=1e-10 * np.abs(uv).max())


def test_square_with_a_hole_is_triangulated() -> None:
    outer = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    angle = -2 * np.pi * np.arange(8) / 8
    hole = 0.5 + 0.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    boundary = np.concatenate([outer, hole])
    smooth = np.array([False] * 4 + [True] * 8)

    def flat(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.column_stack([q, 0 * q[:, 0]]), np.tile([0.0, 0.0, 1.0], (len(q), 1))

    made = triangulate(
        boundary, [np.arange(4), 4 + np.arange(8)], smooth, flat, lambda x: np.full(len(x), 0.2), set(), "square"
    )
    assert (made.vertices[:12] == boundary).all()
    p = made.vertices[made.triangles]
    area = 0.5 * ((p[:, 1, 0] - p[:, 0, 0]) * (p[:, 2, 1] - p[:, 0, 1])
                  - (p[:, 1, 1] - p[:, 0, 1]) * (p[:, 2, 0] - p[:, 0, 0]))
    assert area.min() > 0
    assert area.sum() == pytest.approx(1 - 8 * 0.5 * 0.04 * np.sin(np.pi / 4), rel=1e-12)
    alone = triangulate(outer[:3], [np.arange(3)], smooth[:3], flat, lambda x: np.ones(len(x)), set(), "triangle")
    assert sorted(alone.triangles[0].tolist()) == [0, 1, 2]
    crossed = outer[[0, 2, 1, 3]]
    with pytest.raises(InputError, match="crosses itself"):
        triangulate(crossed, [np.arange(4)], smooth[:4], flat, lambda x: np.ones(len(x)), set(), "bow tie")


def test_polygons_with_vertices_on_a_straight_side_do_not_cross_themselves() -> None:
    """On a slanted line vertices lie to one side or the other by rounding, and pieces that are apart do not meet."""
    side = np.linspace(0.0, 1.0, 30)[:, None] * np.array([1.0, 1.0 / 3.0]) * 53.7
    tip = np.array([(10.0, 40.0)])
    x = np.concatenate([side, tip])
    ring = bridged(x, [np.arange(len(x))], "a triangle")
    assert np.array_equal(ring, np.arange(len(x)))


def test_crossing_triangles_are_found() -> None:
    x = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.2, 0.2, -1), (0.3, 0.2, 1), (0.2, 0.3, 1), (2, 2, 2.0)])
    assert crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)])).tolist() == [[0, 1]]
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (4, 5, 6)]))) == 0
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (0, 4, 5)]))) == 0


def test_triangles_beside_each_other_in_a_plane_do_not_cross() -> None:
    """Sides along an axis, coordinates that differ in their last places: every volume is rounding."""
    x = np.array([
        (12.519612409583223, 0.0, 6.666666666666714), (15.636300238439262, 0.0, 6.666666666666714),
        (14.077956324011694, 3.418710189269282, 10.000000000000071),
        (18.75298806729891, 0.0, 6.666666666666715), (21.869675896155336, 0.0, 6.666666666666715),
        (20.31133198172747, 3.41871018926938, 10.000000000000073),
    ])  # fmt: skip
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)]))) == 0


def test_points_that_are_off_their_plane_by_more_than_rounding_do_not_cross() -> None:
    """Two triangles of an HB-rep in the plane x = -150, apart by 2.6, their points off it by 1e-10: of the volumes that
    say on which side of each other their edges pass all but one are rounding.
    """
    x = np.array([
        (-150.00000000008561, -22.615077339096491, 4.1850045278162753),
        (-149.99999999997127, -22.059013582078492, 6.5066436998675723),
        (-149.99999999990797, -22.059013582078485, 4.1850045278162753),
        (-150.0000000002602, -23.000225685032017, -6.2675338611503989e-03),
        (-149.99999999990797, -22.615077339096477, 1.5533537482765682),
        (-149.99999999990803, -20.999995972834540, -5.9894280452713942e-06),
    ])
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)]))) == 0
    x[3:, 1] -= x[3, 1] - x[0, 1]
    x[3:, 2] += 4.5
    x[3, 0] -= 1.0
    x[4, 0] += 1.0
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)]))) == 1


def test_points_that_were_evaluated_lie_in_their_plane() -> None:
    """Two triangles of a part in its plane x = 31, apart from each other, off it by tens of units in the last place."""
    place = [(11.91827262, 18.20330184), (12.420542, 13.0280519), (15.29820451, 17.19501957),
             (6.87088512, 22.02176058), (5.91359187, 17.0008656), (10.14037149, 21.41589828)]  # fmt: skip
    found = np.array([-3.552713678800501e-15, 1.2434497875801753e-13, -3.552713678800501e-15,
                      3.552713678800501e-15, -4.263256414560601e-14, 0.0])  # fmt: skip
    random = np.random.default_rng(8)
    for off in [found, *random.choice(found, (2000, 6))]:
        x = np.column_stack([31.0 + off, place])
        assert len(crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)]))) == 0


def test_thin_crossings_are_found() -> None:
    """A triangle whose tip is a billionth of its size beyond another."""
    x = np.array([(31, 0, 0), (31, 5, 0), (31, 0, 5), (31 - 1e-8, 1, 1), (36, 1, 1), (36, 2, 1)])
    assert len(crossing_pairs(x, np.array([(0, 1, 2), (3, 4, 5)]))) == 1


@pytest.mark.parametrize("name", ["bracket", "curved_difference"])
def test_skins_are_watertight_and_near(name: str) -> None:
    skin, brep = skin_of(name), solid(name)
    areas = integrals_of(brep).area
    plane = np.array([face.kind == "plane" for face in brep.faces])
    share = areas[plane].sum() / areas.sum()
    assert (share > 0.7) == (name == "bracket")
    report = skin.report
    assert report["watertight_gap"] < 1e-12
    assert report["crossings"] == 0
    assert report["folded"] == 0
    assert report["max_distance"] < 2e-5
    assert report["volume_error"] < 2e-6
    assert report["exact_area_share"] > share - 2e-5  # outlines of plane faces are met to the tolerance
    assert report["min_quality"] > 0.3
    (block,) = skin.space.blocks
    triangles = block.dofs[:, [0, 6, 9]]
    assert triangles.max() == skin.vertices - 1
    sides = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    ways = set(map(tuple, sides.tolist()))
    assert len(ways) == len(sides)
    assert all((b, a) in ways for a, b in ways)  # closed and oriented
    assert set(skin.faces[0].tolist()) == set(range(len(brep.faces)))


def test_skin_lies_on_planes_and_vertices_on_surfaces() -> None:
    skin, brep = skin_of("bracket"), solid("bracket")
    block = skin.space.blocks[0]
    inner = bernstein(TRIANGLE, 3).tabulate(np.random.default_rng(7).dirichlet(np.ones(3), 20)[:, 1:], 0)[0]
    for f, face in enumerate(brep.faces):
        x = np.einsum("kn,enc->ekc", inner, skin.points[block.dofs[skin.faces[0] == f]]).reshape(-1, 3)
        if face.kind == "plane":
            corner = surface_points(face.surface, np.array([[k[0] for k in face.surface.knots]]))
            c = face.surface.control
            n = np.cross(c[1, 0] - c[0, 0], c[0, 1] - c[0, 0])
            assert np.abs((x - corner) @ n / np.linalg.norm(n)).max() < 1e-8 * brep.diagonal


@pytest.mark.parametrize(("file", "most"), [("block_through_hole.step", 250), ("block_torus_fillet3.step", 300)])
def test_real_parts_have_skins(data: Path, file: str, most: int) -> None:
    skin = build_skin(read_cad(data / "cad" / file))
    assert skin.report["crossings"] == skin.report["folded"] == 0
    assert skin.report["max_distance"] < 2e-5
    assert skin.report["volume_error"] < 1e-6
    assert skin.report["elements"] <= most


def test_unknown_kinds_and_sizes_are_refused() -> None:
    for wrong, message in (({"kind": "quads"}, "a skin is one of triangles, hybrid, hb-rep, not 'quads'"),
                           ({"size": 0.0}, "size must lie in"), ({"tolerance": 1.0}, "tolerance in")):
        with pytest.raises(InputError, match=message):
            build_skin(solid("curved_box"), **wrong)  # type: ignore[arg-type]
