"""Triangles at the poles of faces: spheres, cones, and a bicubic surface with a collapsed side."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("OCP")

from geometry.cad.brep import Brep, surface_points
from geometry.cad.reading import brep_of
from geometry.hybrid import shapes
from geometry.hybrid.poles import Pole, inner_row, net_points, poles_of, rows, triangle_map
from geometry.hybrid.settings import Settings
from geometry.hybrid.skin import Skin, build_skin
from geometry.hybrid.source import domain_of
from geometry.hybrid.triangle import CUBIC, INNER
from iga.bernstein import bernstein
from iga.block import bezier_coefficients
from iga.cells import QUADRILATERAL, TRIANGLE
from iga.certificate import certify
from iga.domain import check
from problems import solve_exact


def _common(angle: float, height: float, centre: float = 0.0) -> Brep:
    """What of the unit ball lies above a plane, turned about an axis through (0, 0, ``centre``) that is none of the
    sphere's, from a height above which ``centre`` is.
    """
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Common
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeSphere
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf

    turn = gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, centre), gp_Dir(1.0, 0.3, 0.0)), angle)
    box = BRepPrimAPI_MakeBox(gp_Pnt(-3, -3, height), gp_Pnt(3, 3, 3)).Shape()
    turned = BRepBuilderAPI_Transform(box, turn, True).Shape()
    made: Any = BRepAlgoAPI_Common(BRepPrimAPI_MakeSphere(1.0).Shape(), turned).Shape()
    return shapes.united(made, "cap")


def cone() -> Brep:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCone

    return brep_of(BRepPrimAPI_MakeCone(1.0, 0.0, 1.5).Shape(), "cone")


def bud() -> Brep:
    """A bicubic surface with a collapsed side above a corner of a plane, three planes around: no weights anywhere."""
    from OCP.BRepBuilderAPI import (
        BRepBuilderAPI_MakeEdge,
        BRepBuilderAPI_MakeFace,
        BRepBuilderAPI_MakeSolid,
        BRepBuilderAPI_MakeWire,
        BRepBuilderAPI_Sewing,
    )
    from OCP.BRepLib import BRepLib
    from OCP.collections import Array1_gp_Pnt, Array2_gp_Pnt
    from OCP.Geom import Geom_BezierCurve, Geom_BezierSurface
    from OCP.gp import gp_Pnt
    from OCP.TopoDS import TopoDS

    radius, z = np.array([0.0, 0.5, 0.9, 1.1]), np.array([1.0, 1.0, 0.7, 0.0])
    around = np.array([(1.0, 0.0), (1.0, 0.6), (0.6, 1.0), (0.0, 1.0)])
    grid = np.empty((4, 4, 3))
    grid[..., :2] = radius[None, :, None] * around[:, None]
    grid[..., 2] = z
    grid[1:3, 2:, 2] += np.array([[0.05, 0.0], [-0.03, 0.0]])

    def point(p: Any) -> Any:
        return gp_Pnt(*map(float, p))

    def edge(control: Any) -> Any:
        points = Array1_gp_Pnt(1, len(control))
        for k, p in enumerate(control):
            points.SetValue(k + 1, point(p))
        return BRepBuilderAPI_MakeEdge(Geom_BezierCurve(points)).Edge()

    poles = Array2_gp_Pnt(1, 4, 1, 4)
    for i in range(4):
        for j in range(4):
            poles.SetValue(i + 1, j + 1, point(grid[i, j]))
    base, top = np.zeros(3), grid[0, 0]
    a, b = grid[0, 3], grid[3, 3]
    sewing = BRepBuilderAPI_Sewing(1e-7)
    sewing.Add(BRepBuilderAPI_MakeFace(Geom_BezierSurface(poles), 1e-7).Face())
    rings = ([grid[0], (a, base), (base, top)], [grid[3], (b, base), (base, top)], [grid[:, 3], (b, base), (base, a)])
    for ring in rings:
        wire = BRepBuilderAPI_MakeWire()
        for control in ring:
            wire.Add(edge(control))
        sewing.Add(BRepBuilderAPI_MakeFace(wire.Wire(), True).Face())
    sewing.Perform()
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(sewing.SewedShape())).Solid()
    BRepLib.OrientClosedSolid_s(solid)
    return brep_of(solid, "bud")


@cache
def skin_of(name: str) -> tuple[Brep, Skin]:
    brep = {"cone": cone, "bud": bud, "hemisphere": lambda: _common(0.0, 0.0)}[name]()
    return brep, build_skin(brep, 0.2, 2e-5, kind="hb-rep")


def test_poles_are_found() -> None:
    counts = {"cone": [1, 1, 0], "hemisphere": [1, 1, 0], "bud": [1, 0, 0, 0]}
    for name, wanted in counts.items():
        brep = skin_of(name)[0]
        found = [poles_of(brep, f) for f in range(len(brep.faces))]
        assert sorted(map(len, found)) == sorted(wanted)
        for face, own in zip(brep.faces, found):
            for pole in own:
                knots = face.surface.knots
                uv = np.random.default_rng(2).uniform([k[0] for k in knots], [k[-1] for k in knots], (5, 2))
                uv[:, pole.direction] = knots[pole.direction][-1 if pole.upper else 0]
                x = surface_points(face.surface, uv)
                assert np.abs(x - brep.vertices[pole.vertex]).max() < 1e-12 * brep.diagonal


@pytest.mark.parametrize("side", range(4))
def test_sides_of_triangles_at_poles_are_those_of_cells(side: int) -> None:
    random = np.random.default_rng(side)
    net = random.normal(size=(3, 16, 3))
    at = net_points(side)
    net[:, at[:, 0]] = net[:, at[:1, 0]]
    control = np.einsum("nb,enc->ebc", triangle_map(side), net)
    s = np.linspace(0.0, 1.0, 7)
    # Triangle: pole (0, 0), ahead (1, 0), after (0, 1); the cell in coordinates s along and t away from the pole.
    cell = np.swapaxes(net[:, at], 1, 2).reshape(3, 16, 3)  # xi = t, eta = s
    for triangle, square in (((s, 0 * s), (s, 0 * s)), ((0 * s, s), (s, 0 * s + 1)), ((1 - s, s), (0 * s + 1, s))):
        x = np.einsum("kb,ebc->ekc", bernstein(TRIANGLE, 3).tabulate(np.stack(triangle, axis=1), 0)[0], control)
        y = np.einsum("kb,ebc->ekc", bernstein(QUADRILATERAL, 3).tabulate(np.stack(square, axis=1), 0)[0], cell)
        assert np.abs(x - y).max() < 1e-14


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_inner_points_are_combinations_that_do_not_use_the_pole(seed: int, side: int) -> None:
    random = np.random.default_rng(seed)
    net, wanted = random.normal(size=(4, 16, 3)), random.normal(size=(4, 3))
    row = inner_row(net, side, wanted)
    assert np.abs(row.sum(axis=1) - 1.0).max() < 1e-13
    assert np.abs(np.einsum("en,enc->ec", row, net) - wanted).max() < 1e-12
    assert not row[:, net_points(side)[:, 0]].any()
    kept = np.einsum("n,enc->ec", triangle_map(side)[:, INNER], net)
    assert np.abs(inner_row(net, side, kept) - triangle_map(side)[:, INNER]).max() < 1e-13


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-4, 0.6), st.floats(0.05, 0.5), st.booleans())
def test_rows_grow_with_the_distance_from_the_pole(first: float, apart: float, upper: bool) -> None:
    """On a disc: meridians ``apart`` (radians); every row but the first is at most about four times as high as wide."""
    places = np.linspace(0.0, 1.0, 13)
    width = apart * (1.0 - places if upper else places)
    made = rows([0.0, 0.5, 1.0], [Pole(1, upper, 0)], np.ones(13), width, places, first, 1.0)
    assert {0.0, 0.5, 1.0} <= set(made.tolist())
    assert (np.diff(made) > 0.0).all()
    distance = np.sort(1.0 - made if upper else made)
    assert distance[1] == pytest.approx(first if first < 0.35 else 0.5)
    height = np.diff(distance)[1:]
    most = min(4.0 * apart, 0.7)
    assert (height < 1.4 * most * distance[2:]).all()
    assert (height > 0.2 * np.minimum(most * distance[1:-1], 0.5)).all()


def test_a_bicubic_face_with_a_pole_is_the_cad_surface_outside_its_tip() -> None:
    brep, skin = skin_of("bud")
    report = skin.report
    assert report["folded"] == report["crossings"] == 0
    assert report["watertight_gap"] < 1e-15
    assert report["max_distance"] < 2e-5
    assert report["hb_rep"]["own"] == 0
    assert report["hb_rep"]["unity_error"] < 1e-12
    assert report["volume_error"] < 1e-6
    row = next(row for row in report["cad_faces_with_quadrilaterals"] if row["kind"] != "plane")
    assert row["triangles"] == row["polar"] > 0
    # Cells at the borders have sides fitted to the edges, to 1e-11 of the diagonal here: some within 1e-12, some not.
    polar, band = row["polar_area"] / row["area"], row["band_area"] / row["area"]
    assert 1.0 - band - 1e-12 < row["exact_share"] <= 1.0 - polar
    assert row["exact_share"] > 0.5
    assert row["polar_area"] < 0.06 * row["area"]
    assert row["distance_outside_band"] < 1e-14
    # Sides of the triangles at the pole lie on the surface as well: meridians are parameter lines.
    face = next(f for f, own in enumerate(brep.faces) if own.kind != "plane")
    pole = brep.vertices[poles_of(brep, face)[0].vertex]
    met = 0
    for block, owner in zip(skin.space.blocks, skin.faces):
        if block.basis is not CUBIC:
            continue
        control = bezier_coefficients(block, skin.points)[owner == face]
        corner = control[:, [int(np.flatnonzero(CUBIC.exponents[:, k] == 3)[0]) for k in range(3)]]
        assert (np.abs(corner - pole).max(axis=2).min(axis=1) < 1e-14).all()
        met += len(control)
    assert met == row["polar"]


def test_half_a_ball_and_a_cone_need_no_functions_but_splines() -> None:
    for name, volume in (("hemisphere", 2.0 * np.pi / 3.0), ("cone", 0.5 * np.pi)):
        _, skin = skin_of(name)
        report = skin.report
        assert report["folded"] == report["crossings"] == 0
        assert report["watertight_gap"] < 1e-15
        assert report["max_distance"] < 2e-5
        assert abs(report["volume"] / volume - 1.0) < 5e-5
        told = report["hb_rep"]
        assert told["own"] == 0
        assert told["unity_error"] < 1e-12
        assert told["on_curves"] == 0.0
        assert told["condition"] < 1e3
        for row in report["cad_faces_with_quadrilaterals"]:
            if row["kind"] != "plane":
                assert row["triangles"] == row["polar"]
                assert row["polar_area"] < 0.15 * row["area"]
                assert row["distance_outside_band"] < 2e-5


@settings(max_examples=4, deadline=None, derandomize=True)
@given(st.floats(0.0, 3.0), st.floats(-0.7, 0.7))
def test_cuts_of_a_ball_are_closed_wherever_they_lie(angle: float, height: float) -> None:
    """The plane passes the poles, above and below, or meets one of them."""
    skin = build_skin(_common(angle, height), 0.3, 5e-4, kind="hb-rep")
    report = skin.report
    assert report["folded"] == report["crossings"] == 0
    assert report["watertight_gap"] < 1e-15
    assert report["max_distance"] < 5e-4
    assert report["hb_rep"]["unity_error"] < 1e-12
    h = 1.0 - height
    assert report["volume"] == pytest.approx(np.pi * h**2 * (3.0 - h) / 3.0, rel=3e-3)


def test_faces_with_poles_have_bands_along_curves() -> None:
    """A plane beside the poles, and one through a pole: right triangles along its curve, but none at the pole."""
    for brep, distance in ((_common(0.5, 0.3), 0.3), (_common(0.5, 1.0, 1.0), np.cos(0.5))):
        report = build_skin(brep, 0.2, 1e-4, kind="hb-rep").report
        assert report["folded"] == report["crossings"] == 0
        assert report["watertight_gap"] < 1e-15
        assert report["max_distance"] < 1e-4
        assert report["volume"] == pytest.approx(np.pi * (1 - distance) ** 2 * (2 + distance) / 3, rel=3e-4)
        assert report["hb_rep"]["unity_error"] < 1e-12
        assert not report["cad_faces_without_band"]
        rows = [row for row in report["cad_faces_with_quadrilaterals"] if row["kind"] == "sphere"]
        assert sum(row["right_triangles"] for row in rows) > 12
        assert all(0.0 <= row["omega_banded"] < 0.15 for row in rows)


def test_rational_faces_keep_few_elements_at_poles() -> None:
    """Skins without splines: cells of the rational surface itself, down to the apex of a cone and a curve's end."""
    for brep, volume, most in ((cone(), 0.5 * np.pi, 150), (_common(0.5, 0.3), np.pi * 0.49 * 2.3 / 3.0, 200)):
        report = build_skin(brep, kind="hybrid").report
        assert report["folded"] == report["crossings"] == 0
        assert report["watertight_gap"] < 1e-15
        assert report["max_distance"] < 2e-5
        assert report["volume"] == pytest.approx(volume, rel=1e-5)
        assert report["elements"] < most
        assert sum(row.get("polar", 0) for row in report["cad_faces_with_quadrilaterals"]) >= 8


def test_volume_of_half_a_ball_is_certified() -> None:
    domain = domain_of(_common(0.0, 0.0), Settings(skin="hb-rep", size=0.3, tolerance=3e-4, subdivide=0), "hemisphere")
    check(domain)
    assert domain.report["skin"] == "hb-rep"
    assert (certify(domain, 1e9).verdict == 1).all()
    assert domain.report["volume_error"] < 1e-3
    assert solve_exact(domain, "heat", "x+2*y-z")[1]["relative_h1_error"] < 1e-8
