"""Quadrilaterals of skins that are the CAD surface, and pyramids on them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry.cad.brep import Brep, surface_points, winding
from geometry.hybrid import read_cad, shapes
from geometry.hybrid.compatible import halved, with_cuts, with_missing
from geometry.hybrid.fitting import bezier_nets
from geometry.hybrid.grid import agree, followed, is_flat, make_grid
from geometry.hybrid.measures import count_intervals
from geometry.hybrid.pieces import cut_edges, divide_edges, least_pieces
from geometry.hybrid.settings import Settings
from geometry.hybrid.shapes import lettered_face
from geometry.hybrid.sizing import size_edges
from geometry.hybrid.skin import Skin, build_skin
from geometry.hybrid.source import domain_of
from iga.bernstein import bernstein
from iga.cells import QUADRILATERAL
from iga.certificate import certify
from iga.conditions import trace_functions
from iga.domain import counts
from problems.manufactured import solve_exact


@cache
def solid(name: str) -> Brep:
    return shapes.SHAPES[name]()


@cache
def skin_of(name: str) -> Skin:
    return build_skin(solid(name), kind="hybrid")


def test_box_of_splines_is_the_cad_surface() -> None:
    skin, brep = skin_of("curved_box"), solid("curved_box")
    assert [block.basis.cell for block in skin.space.blocks] == [QUADRILATERAL]
    assert skin.report["exact_area_share"] == pytest.approx(1.0, abs=1e-12)
    assert skin.report["volume_error"] < 1e-9  # what the kernel integrates
    # Random points of the skin lie on the surface they belong to: found again by their parameters.
    rows = skin.report["cad_faces_with_quadrilaterals"]
    assert len(rows) == 6
    assert all(row["distance_outside_band"] < 1e-14 for row in rows)
    assert all((row["interior"], row["trimmed"], row["exterior"]) == (0, 1, 0) for row in rows)
    assert sum(row["area"] for row in rows) == pytest.approx(brep.area, rel=1e-7)


@pytest.mark.long
def test_trimmed_splines_have_triangles_along_the_curves() -> None:
    skin = skin_of("curved_difference")
    report = skin.report
    cells = {block.basis.cell.name for block in skin.space.blocks}
    assert cells == {"quadrilateral", "triangle"}
    assert report["watertight_gap"] < 1e-15
    assert report["crossings"] == report["folded"] == 0
    assert report["max_distance"] < 2e-5
    assert report["volume_error"] < 1e-6
    rows = report["cad_faces_with_quadrilaterals"]
    assert all(row["distance_outside_band"] < 1e-13 for row in rows)
    assert all(0.3 < row["exact_share"] < 0.95 for row in rows)
    assert 0.7 < report["exact_area_share"] < 0.9
    # Functions on common sides are the same ones: no two functions at one place on the mesh's vertices.
    assert len(np.unique(skin.points[: skin.vertices].round(9), axis=0)) == skin.vertices


def test_holes_in_spline_faces_leave_the_cad_surface_beside_them() -> None:
    # Small cells: at the default size triangles reach the tolerance on five sixths of these faces.
    report = build_skin(solid("lettered_plate"), 0.05, kind="hybrid").report
    assert report["crossings"] == report["folded"] == 0
    assert report["watertight_gap"] < 1e-15
    rows = [row for row in report["cad_faces_with_quadrilaterals"] if row["kind"] == "bsplinesurface"]
    assert len(rows) == 2
    for row in rows:
        assert (row["interior"], row["trimmed"], row["exterior"]) == (1, 15, 0)
        assert row["quadrilaterals"] > 40
        assert row["exact_share"] > 0.2
        assert row["distance_outside_band"] < 1e-14
        assert row["band_area"] < 0.8 * row["area"]


def test_triangles_alone_on_request() -> None:
    skin = build_skin(solid("curved_box"), 0.4, 1e-3)
    assert [block.basis.cell.name for block in skin.space.blocks] == ["triangle"]
    assert skin.report["quadrilaterals"] == 0
    assert skin.report["cad_faces_with_quadrilaterals"] == []


def test_nets_are_the_surface_and_knots_are_lines() -> None:
    face = lettered_face()
    random = np.random.default_rng(11)
    low = np.array([[0.0, 0.0], [0.25, 0.5], [0.8, 0.3]])
    high = np.array([[0.25, 0.1], [0.4, 0.75], [1.0, 0.45]])
    net = bezier_nets(face, low, high)
    assert net is not None
    at = random.random((30, 2))
    x = np.einsum("qb,ebc->eqc", bernstein(QUADRILATERAL, 3).tabulate(at, 0)[0], net)
    uv = low[:, None] + at * (high - low)[:, None]
    assert np.abs(x.reshape(-1, 3) - surface_points(face.surface, uv.reshape(-1, 2))).max() < 1e-14
    counted = count_intervals(face)
    assert counted == {"interior": 1, "trimmed": 15, "exterior": 0}  # the border alone touches twelve
    assert winding(face, np.array([[0.1, 0.1], [0.35, 0.6], [0.6, 0.6], [1.2, 0.5]])).tolist() == [
        True, False, True, False
    ]


def test_edges_are_cut_where_lines_meet_them() -> None:
    brep = solid("curved_box")
    sizing, wanted = size_edges(brep, 0.2)
    ends = divide_edges(brep, sizing, wanted, least_pieces(brep), 2e-5)
    lines, ends = agree(brep, ends, sizing, dict.fromkeys(range(6), 0.2 * brep.diagonal))
    for f, face in enumerate(brep.faces):
        assert not is_flat(face.surface)
        grid = make_grid(brep, f, lines[f], sizing)
        assert grid.kept.all()
        for c in face.loops[0]:
            assert len(ends[c.edge]) in {len(x) for x in lines[f]}


@pytest.fixture(scope="module")
def volume():
    return domain_of(solid("curved_box"), Settings(size=0.4, skin="hybrid", subdivide=0), "box")


def test_pieces_beside_folds_are_halved_where_lines_cut_them() -> None:
    """Sizes do not reach edges along the lines of a face: their pieces are cut in the middle, those of others not."""
    brep = solid("curved_difference")
    sizing, wanted = size_edges(brep, 0.3)
    ends = divide_edges(brep, sizing, wanted, least_pieces(brep), 1e-3)
    edges, _ = cut_edges(brep, ends)
    along = [e for e, uses in enumerate(brep.coedges_of)
             if any(followed(brep.faces[f].loops[k][i], brep.faces[f].surface) >= 0 for f, k, i in uses)]
    others = [e for e in range(len(brep.edges)) if e not in along and not brep.edges[e].degenerate]
    rows = np.array([[*edges[e].vertices[[1, 0]], e] for e in (along[0], others[0])])
    faces = range(len(brep.faces))
    cuts = halved(brep, {along[0]: np.array([0.9])}, rows, edges, faces)
    assert cuts.keys() == {along[0]}
    assert cuts[along[0]] == pytest.approx([0.5 * edges[along[0]].ends[1], 0.9])
    _, made = agree(brep, with_cuts(ends, cuts), sizing, dict.fromkeys(faces, brep.diagonal), cuts)
    assert np.abs(with_missing(made, cuts)[along[0]] - cuts[along[0]][0]).min() < 1e-12
    assert halved(brep, {}, rows, edges, ()) == {}


def test_pyramids_stand_on_the_quadrilaterals(volume) -> None:
    assert counts(volume).keys() == {"pyramid", "tetrahedron"}
    assert (certify(volume).verdict > 0).all()
    assert volume.report["exact_area_share"] == pytest.approx(1.0, abs=1e-12)
    skin = build_skin(solid("curved_box"), 0.4, kind="hybrid")
    assert volume.report["quadrilaterals"] == skin.report["quadrilaterals"] == counts(volume)["pyramid"]
    facets = [f for own in volume.boundaries.values() for f in own]
    assert sum(len(f.elements) for f in facets) == skin.report["quadrilaterals"]
    on = np.unique(np.concatenate([trace_functions(volume, own) for own in volume.boundaries.values()]))
    assert len(on) == skin.space.n  # the volume's functions on its boundary are the skin's
    answer = solve_exact(volume, "elasticity", "x+2*y;3*z-y;x-y+z")[1]
    assert answer["relative_h1_error"] < 1e-8


@pytest.mark.parametrize(("file", "share"), [("block_through_hole.step", 0.7), ("block_torus_fillet3.step", 0.7)])
def test_rational_faces_are_met_to_the_tolerance(data: Path, file: str, share: float) -> None:
    skin = build_skin(read_cad(data / "cad" / file), kind="hybrid")
    report = skin.report
    assert report["crossings"] == report["folded"] == 0
    assert report["max_distance"] < 2e-5
    assert report["volume_error"] < 1e-6
    assert report["exact_area_share"] > share  # the planes
    rows = report["cad_faces_with_quadrilaterals"]
    assert all(row["triangles"] == 0 for row in rows)
    assert all(row["distance_outside_band"] <= row["proved_distance"] < 1e-4 for row in rows)


def test_rational_quadrilaterals_are_near_by_proof() -> None:
    from geometry.cad.brep import Face
    from geometry.hybrid.bound import FEET, distance_bound
    from geometry.hybrid.fitting import fit_quads, project
    from geometry.patch import Patch

    # A quarter of a cylinder of radius 1, cut in 1, 2, 4 pieces: cubics meet arcs to the sixth power of their length.
    r = np.sqrt(0.5)
    arc = np.array([(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    control = np.stack([np.column_stack([arc, np.full(3, z)]) for z in (0.0, 0.5)], axis=1)
    weights = np.array([1.0, r, 1.0])[:, None] * np.ones((1, 2))
    knots = (np.repeat([0.0, 1.0], 3), np.repeat([0.0, 1.0], 2))
    face = Face(Patch(knots, control, weights), (), False, "cylinder", "quarter")
    bounds = []
    for pieces in (1, 2, 4):
        half = np.pi / 4 / pieces
        turn = half + 2 * half * np.arange(pieces)
        k = 4 / 3 * np.tan(half / 2)
        a, b = turn - half, turn + half
        x = np.stack([np.cos(a), np.cos(a) - k * np.sin(a), np.cos(b) + k * np.sin(b), np.cos(b)], axis=1)
        y = np.stack([np.sin(a), np.sin(a) + k * np.cos(a), np.sin(b) - k * np.cos(b), np.sin(b)], axis=1)
        z = np.linspace(0.0, 0.5, 4)
        net = np.stack([np.repeat(x[..., None], 4, 2), np.repeat(y[..., None], 4, 2), np.tile(z, (pieces, 4, 1))], -1)
        net = net.reshape(pieces, 16, 3)
        ends = 0.5 + 0.5 * np.tan((np.linspace(0, np.pi / 2, pieces + 1) - np.pi / 4) / 2) / np.tan(np.pi / 8)
        low = np.stack([ends[:-1], np.zeros(pieces)], 1)
        high = np.stack([ends[1:], np.ones(pieces)], 1)
        at = np.stack(np.meshgrid(FEET, FEET, indexing="ij"), axis=-1).reshape(-1, 2)
        p = np.einsum("kn,enc->ekc", bernstein(QUADRILATERAL, 3).tabulate(at, 0)[0], net).reshape(-1, 3)
        feet = project(face, (low[:, None] + at * (high - low)[:, None]).reshape(-1, 2), p)[0]
        bound = distance_bound(face, low, high, net, feet.reshape(pieces, 36, 2))
        assert bound is not None
        fine = np.random.default_rng(3).random((400, 2))
        p = np.einsum("kn,enc->ekc", bernstein(QUADRILATERAL, 3).tabulate(fine, 0)[0], net)
        true = np.abs(np.hypot(p[..., 0], p[..., 1]) - 1).max()
        assert true <= bound.max() < 20 * true + 1e-12
        assert fit_quads(face, low, high, net, None).distance.max() < bound.max()
        bounds.append(float(bound.max()))
    assert bounds[0] / bounds[1] > 40
    assert bounds[2] < 1e-6


def test_a_line_through_the_end_of_an_edge_does_not_cut_it() -> None:
    """The end of a curve lies 2e-6 of the parameter range beside the line that the next edge of the loop follows."""
    brep = solid("curved_box")
    face = brep.faces[0]
    c = face.loops[0][0]
    d = 1 - followed(c, face.surface)
    control = c.curve.control.copy()
    beyond = control[0] - control[-1]
    control[0] += 2e-6 * np.ptp(face.surface.knots[d]) * beyond / np.linalg.norm(beyond)
    moved = replace(face, loops=((replace(c, curve=replace(c.curve, control=control)), *face.loops[0][1:]),))
    brep = replace(brep, faces=(moved, *brep.faces[1:]))
    sizing, wanted = size_edges(brep, 0.2)
    ends = divide_edges(brep, sizing, wanted, least_pieces(brep), 1e-5)
    _, ends = agree(brep, ends, sizing, dict.fromkeys(range(6), 0.2 * brep.diagonal))
    assert len(ends[c.edge]) > 2
    assert min(np.diff(t).min() for t in ends.values()) > 0.02
