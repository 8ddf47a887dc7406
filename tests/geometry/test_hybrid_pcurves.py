"""Curves in parameter planes that run with their edges, and triangulations beside short sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.cad.brep import Brep, Curve, curve_points, surface_frame, surface_points
from geometry.hybrid import shapes
from geometry.hybrid.fitting import project
from geometry.hybrid.grid import followed
from geometry.hybrid.meeting import edge_distances, met
from geometry.hybrid.pcurves import APART, fitted_curves
from geometry.hybrid.skin import build_skin
from geometry.hybrid.triangulation import triangulate
from geometry.patch import Patch


def with_curve(brep: Brep, f: int, k: int, curve: Curve) -> Brep:
    """The solid with another curve of coedge k of the first loop of face f."""
    face = brep.faces[f]
    loop = [replace(c, curve=curve) if i == k else c for i, c in enumerate(face.loops[0])]
    faces = list(brep.faces)
    faces[f] = replace(face, loops=(tuple(loop), *face.loops[1:]))
    return replace(brep, faces=tuple(faces))


def apart(brep: Brep, f: int, k: int) -> float:
    """Distance between points of a coedge's curve and of its edge at equal parameters, in diagonals."""
    c = brep.faces[f].loops[0][k]
    t = np.linspace(0.0, 1.0, 41)
    off = surface_points(brep.faces[f].surface, curve_points(c.curve, t)) - curve_points(brep.edges[c.edge].curve, t)
    return float(np.linalg.norm(off, axis=1).max() / brep.diagonal)


def hurried(curve: Curve, share: float) -> Curve:
    """A curve with the same ends whose inner control points have gone ahead along it."""
    control = curve.control.copy()
    control[1:-1] += share * (control[-1] - control[0])
    return replace(curve, control=control)


def straight_coedge(brep: Brep) -> tuple[int, int]:
    """A coedge with a straight curve on a parameter line."""
    for f, face in enumerate(brep.faces):
        for k, c in enumerate(face.loops[0]):
            if followed(c, face.surface) >= 0 and len(c.curve.control) == 10:
                return f, k
    raise AssertionError("no such curve")


def test_a_curve_runs_with_its_edge() -> None:
    brep = shapes.SHAPES["curved_difference"]()
    f, k = straight_coedge(brep)
    bent = with_curve(brep, f, k, hurried(brep.faces[f].loops[0][k].curve, 0.01))
    assert apart(brep, f, k) < APART < 10 * APART < apart(bent, f, k)
    cured = fitted_curves(bent, 2e-5)
    assert apart(cured, f, k) < 1e-7
    # The ends stay where loops join, and a second pass has nothing left to do.
    ends = np.array([0.0, 1.0])
    before, after = (curve_points(b.faces[f].loops[0][k].curve, ends) for b in (bent, cured))
    assert np.abs(after - before).max() < 1e-9 * np.abs(before).max()
    again = fitted_curves(cured, 2e-5)
    assert again.faces[f].loops[0][k] is cured.faces[f].loops[0][k]


def test_a_curve_beside_a_parameter_line_is_put_on_it() -> None:
    """If it is near enough, or so far from its edge, which lies on the line, that it is fitted to that anew."""
    brep = shapes.SHAPES["curved_difference"]()
    f, k = straight_coedge(brep)
    face = brep.faces[f]
    coedge = face.loops[0][k]
    d = followed(coedge, face.surface)
    for off, caught in ((1e-6, True), (1e-5, False), (1e-3, True)):
        control = coedge.curve.control.copy()
        control[1:-1, d] += off * np.ptp(face.surface.knots[d])
        beside = with_curve(brep, f, k, replace(coedge.curve, control=control))
        assert followed(beside.faces[f].loops[0][k], face.surface) < 0
        assert (followed(fitted_curves(beside, 2e-5).faces[f].loops[0][k], face.surface) == d) == caught


def test_no_triangle_is_doubled_beside_sides_of_very_different_lengths() -> None:
    """A needle whose tip is cut off by a side 1e-4 long, with long sides beside it."""
    boundary = np.array([(0, -0.05), (0.5, -0.03), (1.0, -5e-5), (1.0, 5e-5), (0.4, 0.03), (0, 0.05)])

    def flat(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.column_stack([q, 0 * q[:, 0]]), np.tile([0.0, 0.0, 1.0], (len(q), 1))

    made = triangulate(
        boundary, [np.arange(6)], np.zeros(6, dtype=bool), flat, lambda x: np.full(len(x), 0.04), set(), "needle"
    )
    p = made.vertices[made.triangles]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    ends = boundary[(np.arange(6) + 1) % 6]
    assert area.min() > 0
    assert abs(area.sum() - 0.5 * np.sum(boundary[:, 0] * ends[:, 1] - boundary[:, 1] * ends[:, 0])) < 1e-15
    sides = made.triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2)
    assert len(np.unique(sides, axis=0)) == len(sides)
    # The short side does not fill the needle with elements of its length.
    assert len(made.triangles) < 500


def beside_its_vertices(brep: Brep, number: int, share: float) -> Brep:
    """The solid with an edge between two faces that touch, the first of them plane, moved along that by a share of the
    diagonal: it stays on both faces, but its vertices, and the other edges there, do not move.
    """
    t = np.array([0.0, 1.0])
    faces, curves = list(brep.faces), []
    (f, k, j), (g, m, n) = brep.coedges_of[number]
    plane, touching = brep.faces[f].loops[k][j].curve, brep.faces[g].loops[m][n].curve
    d = followed(brep.faces[f].loops[k][j], brep.faces[f].surface)
    size = np.linalg.norm(surface_frame(brep.faces[f].surface, curve_points(plane, t))[1 + d], axis=1)[0]
    curves.append(plane.control + share * brep.diagonal / size * np.eye(2)[d])
    x = surface_points(brep.faces[f].surface, curve_points(Curve(plane.knots, curves[0]), t))
    foot = project(brep.faces[g], curve_points(touching, t), x)[0]
    curves.append(touching.control + (foot - curve_points(touching, t)).mean(axis=0))
    for (at, a, b), control in zip(brep.coedges_of[number], curves):
        loops = [list(loop) for loop in faces[at].loops]
        loops[a][b] = replace(loops[a][b], curve=Curve(loops[a][b].curve.knots, control))
        faces[at] = replace(faces[at], loops=tuple(tuple(loop) for loop in loops))
    edge = brep.edges[number]
    away = x.mean(axis=0) - curve_points(edge.curve, t).mean(axis=0)
    edges = list(brep.edges)
    edges[number] = replace(edge, curve=Curve(edge.curve.knots, edge.curve.control + away), tolerance=share)
    return replace(brep, faces=tuple(faces), edges=tuple(edges))


@pytest.mark.parametrize("share", [2e-5, -2e-5])
def test_edges_end_at_their_vertices(share: float) -> None:
    """Blends end beside their vertices by 2e-5 of the diagonal: curves must follow each other, or loops cross."""
    whole = shapes.SHAPES["bracket"]()
    number = next(
        e for e, uses in enumerate(whole.coedges_of)
        if [whole.faces[f].kind for f, _, _ in uses] == ["plane", "cylinder"]
        and [len(loop) for loop in whole.faces[uses[0][0]].loops] == [4]
    )
    brep = beside_its_vertices(whole, number, share)
    edge = brep.edges[number]
    ends = np.array([0.0, 1.0])
    apart = np.linalg.norm(curve_points(edge.curve, ends) - brep.vertices[list(edge.vertices)], axis=1)
    assert (np.abs(apart / brep.diagonal - 2e-5) < 1e-7).all()
    off = edge_distances(brep)
    assert off[number] < 1e-6 * brep.diagonal
    cured = fitted_curves(met(brep, off), 2e-5)
    for face in cured.faces:
        for loop in face.loops:
            at = [curve_points(c.curve, ends)[::-1 if c.reversed else 1] for c in loop]
            extent = np.array([np.ptp(k) for k in face.surface.knots])
            gaps = [np.abs(a[1] - b[0]) / extent for a, b in zip(at, [*at[1:], at[0]])]
            assert max(gap.max() for gap in gaps) < 1e-7
    made = curve_points(cured.edges[number].curve, ends)
    assert np.linalg.norm(made - brep.vertices[list(edge.vertices)], axis=1).max() < 1e-7 * brep.diagonal
    for skin in (build_skin(brep, 0.2, 1e-4, kind="hb-rep"), build_skin(brep, 0.2, 1e-4, kind="hybrid")):
        assert skin.report["crossings"] == skin.report["folded"] == 0
        assert not skin.report["cad_faces_without_quadrilaterals"]


def test_a_face_may_pass_the_border_of_its_surface() -> None:
    """A plane that ends 4e-5 of its width before an edge: no line of the grid lies there, a sliver from the edge's."""
    brep = shapes.SHAPES["bracket"]()
    f = next(f for f, face in enumerate(brep.faces) if face.kind == "plane" and len(face.loops[0]) == 4)
    surface = brep.faces[f].surface
    ends = [np.array([k[0], k[-1]]) for k in surface.knots]
    ends[0][0] += 4e-5 * np.ptp(ends[0])
    corners = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
    short = Patch((np.repeat(ends[0], 2), np.repeat(ends[1], 2)), surface_points(surface, corners).reshape(2, 2, 3))
    faces = list(brep.faces)
    faces[f] = replace(faces[f], surface=short)
    whole, skin = (build_skin(b, 0.2, 1e-3, kind="hb-rep") for b in (brep, replace(brep, faces=tuple(faces))))
    assert skin.report["elements"] == whole.report["elements"]
    assert skin.report["min_quality"] == pytest.approx(whole.report["min_quality"], rel=1e-3)
    assert skin.report["volume"] == pytest.approx(whole.report["volume"], rel=1e-9)
