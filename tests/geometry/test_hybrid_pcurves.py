"""Curves in parameter planes that run with their edges, and triangulations beside short sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geometry.cad.brep import Brep, Curve, curve_points, surface_points
from geometry.hybrid import shapes
from geometry.hybrid.grid import followed
from geometry.hybrid.pcurves import APART, fitted_curves
from geometry.hybrid.triangulation import triangulate


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
