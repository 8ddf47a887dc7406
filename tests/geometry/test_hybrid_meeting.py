"""Edges that lie off their faces are moved to where these meet; sides are free; skins reach their tolerance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.cad.brep import Curve
from geometry.cad.reading import read_cad
from geometry.hybrid.curves import fit_cubics
from geometry.hybrid.meeting import closing_moves, edge_distances, met
from geometry.hybrid.shapes import SHAPES
from geometry.hybrid.skin import build_skin


def test_displaced_edge_returns_to_both_faces() -> None:
    """An edge pushed off both faces by 1e-5 of the diagonal lies on both again, where the faces cross."""
    brep = SHAPES["bracket"]()
    number = next(e for e, edge in enumerate(brep.edges) if not edge.degenerate)
    edge = brep.edges[number]
    push = 1e-5 * brep.diagonal * np.array([0.6, -0.5, 0.4])
    edges = list(brep.edges)
    edges[number] = replace(edge, curve=Curve(edge.curve.knots, edge.curve.control + push))
    pushed = replace(brep, edges=tuple(edges))
    off = edge_distances(pushed)
    assert 1e-6 < off[number] / brep.diagonal < 2e-5
    again = met(pushed, off)
    assert edge_distances(again)[number] < 2e-8 * brep.diagonal
    assert np.abs(again.vertices - brep.vertices).max() < 1e-12 * brep.diagonal
    others = [e for e in range(len(edges)) if e != number]
    assert all(again.edges[e] is pushed.edges[e] for e in others)


def test_step_closes_crossing_faces_and_halves_touching_ones() -> None:
    """Both distances vanish where normals differ; where they agree the point ends half way between the faces."""
    crossing = np.array([[[1.0, 0.0, 0.0]], [[0.6, 0.8, 0.0]]])
    d, x = np.array([[0.3], [-0.2]]), np.zeros((1, 3))
    for _ in range(6):
        x = x + closing_moves(d - np.einsum("fqc,qc->fq", crossing, x), crossing)
    assert np.abs(np.einsum("fqc,qc->fq", crossing, x) - d).max() < 1e-7
    touching = np.array([[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]])
    d, x = np.array([[1.0], [0.0]]), np.zeros((1, 3))
    for _ in range(6):
        x = x + closing_moves(d - np.einsum("fqc,qc->fq", touching, x), touching)
    np.testing.assert_allclose(x, [[0.0, 0.0, 0.5]], atol=1e-9)


def test_sides_across_a_knot_come_nearer_without_tangents() -> None:
    """On a C2 surface z = |x|^3 a piece across x = 0 is several times nearer when only its ends are given."""

    def points(s: np.ndarray) -> np.ndarray:
        x = -0.4 + s
        return np.stack([x, 0.0 * x, np.abs(x) ** 3], axis=-1)

    def normals(s: np.ndarray) -> np.ndarray:
        x = -0.4 + s
        n = np.stack([-3.0 * x * np.abs(x), 0.0 * x, np.ones_like(x)], axis=-1)
        return n / np.linalg.norm(n, axis=-1)[..., None]

    ends = points(np.array([[0.0, 1.0]]))
    _, bound_ = fit_cubics(points, ends[:, 0], ends[:, 1])
    control, free = fit_cubics(points, ends[:, 0], ends[:, 1], normals)
    assert free[0] < 0.4 * bound_[0]
    np.testing.assert_allclose(control[:, [0, 3]], ends, atol=1e-14)


def test_sides_on_cubics_are_exact() -> None:
    """A cubic curve on its surface stays itself."""

    def points(s: np.ndarray) -> np.ndarray:
        return np.stack([s, 0.5 * s, s**3 - s**2], axis=-1)

    def frames(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return points(s), np.stack([np.ones_like(s), 0.5 * np.ones_like(s), 3.0 * s**2 - 2.0 * s], axis=-1)

    def normals(s: np.ndarray) -> np.ndarray:
        n = np.stack([-(3.0 * s**2 - 2.0 * s), 0.0 * s, np.ones_like(s)], axis=-1)
        return n / np.linalg.norm(n, axis=-1)[..., None]

    ends = points(np.array([[0.0, 1.0]]))
    _, distance = fit_cubics(points, ends[:, 0], ends[:, 1], normals, frames=frames)
    assert distance[0] < 1e-12


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_skin_reaches_its_tolerance(tolerance: float) -> None:
    """Elements are made smaller until the measured distance holds."""
    skin = build_skin(SHAPES["curved_box"](), 0.6, tolerance)
    assert skin.report["max_distance"] <= tolerance
    assert skin.report["crossings"] == skin.report["folded"] == 0


def test_edges_of_a_file_meet_its_faces(data: Path) -> None:
    """Edges 1.1e-5 of the diagonal off in the file are 1.6e-7 off as they are used."""
    brep = read_cad(data / "cad" / "sliced_cylinder.step", None)
    skin = build_skin(brep, 0.2, 2e-5)
    assert skin.report["edge_distance_in_file"] > 1e-5
    assert skin.report["edge_distance"] < 1e-6
    assert skin.report["max_distance"] < 2e-5


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "solid"), [("wrenchnut.stp", 0), ("mainbody_back.stp", None), ("wing_fuselage.step", 0)]
)
def test_skins_of_files_reach_the_tolerance(data: Path, name: str, solid: int | None) -> None:
    """Parts whose edges lie up to 2.6e-5 of the diagonal off their faces, and surfaces with many knots."""
    skin = build_skin(read_cad(data / "cad" / name, solid), 0.2, 2e-5)
    assert skin.report["max_distance"] <= 2e-5


@pytest.mark.long
@pytest.mark.parametrize("kind", ["hybrid", "hb-rep"])
@pytest.mark.parametrize("name", ["angled.step", "featuretype.step", "pump_carter.stp"])
def test_quadrilaterals_need_no_plain_triangles_instead(data: Path, name: str, kind: str) -> None:
    """Parts that once fell back to triangles everywhere, because faces of their quadrilaterals crossed."""
    report = build_skin(read_cad(data / "cad" / name, None), kind=kind).report
    assert report["crossings"] == report["folded"] == 0
    assert report["quadrilaterals"] > 500
    assert report["max_distance"] <= 2e-5


@pytest.mark.long
@pytest.mark.parametrize(("name", "solid"), [("wrenchnut.stp", 0), ("mainbody_back.stp", None)])
def test_gaps_of_a_file_leave_no_folds(data: Path, name: str, solid: int | None) -> None:
    """Faces of the second touch each other up to 2.5e-5 of the diagonal apart, and half of that stays on each."""
    report = build_skin(read_cad(data / "cad" / name, solid), kind="hb-rep").report
    assert report["crossings"] == report["folded"] == 0
    assert not report["cad_faces_without_band"]
    assert report["max_distance"] <= 2e-5
    assert report["elements"] < 14_000


@pytest.mark.long
def test_a_leading_edge_keeps_its_splines(data: Path) -> None:
    """The wing's faces curl within a thousandth of their length, where triangles are wider than knot intervals."""
    report = build_skin(read_cad(data / "cad" / "wing_fuselage.step", 0), kind="hb-rep").report
    assert report["crossings"] == report["folded"] == 0
    assert not report["cad_faces_without_band"]
    assert report["max_distance"] <= 2e-5
    assert report["hb_rep"]["unity_error"] < 1e-12
