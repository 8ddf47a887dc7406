r"""Curves in the parameter planes of faces made to fit their edges.

A coedge's curve c(t) is to be the place of the edge's point C(t) on the surface, S(c(t)) ~ C(t). Files keep that across
the curve, but along it parameters of both may run apart by far more than small elements are long, and these fold. Such
curves are fitted anew to the feet of C(t).

A curve that follows a parameter line but for a distance that does not count is put on the line, so that cells of the
face lie along it (`grid`): blends end in such curves, a few 1e-4 of the parameter range away from the surface's border.

So are curves whose ends are not the places of their edges' ends: files leave curves that follow each other some 1e-5 of
the parameter range apart, less than their tolerance in space, but a polygon through such ends crosses itself.

Axis letters: q point, d parameter direction, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, Curve, Face, curve_points, fit_curve, surface_frame, surface_points
from geometry.hybrid.fitting import project
from geometry.hybrid.grid import followed
from iga.errors import InputError

Array = NDArray[np.float64]

APART = 1e-5
"""Distance along the curve, relative to the diagonal, between points of equal parameters that is left as it is."""
NEAR = 1e-7
"""The same at the ends, where other curves begin."""
FIT, ENOUGH = 1e-8, 1e-6
"""Distances, relative to the diagonal, of a new curve from its points, the second for short pieces."""
SHARE = 0.1
"""Share of the tolerance of the skin by which curves may be moved to a parameter line."""
NEARLY = 0.02
"""Share of the parameter range within which a curve may be thought to follow a line."""
SAMPLES = 65
"""Samples at which a curve is held against its edge, or a line; its knots are more."""


def fitted_curves(brep: Brep, tolerance: float) -> Brep:
    """The solid with curves in parameter planes that run with their edges, and on parameter lines where they nearly do.

    Parameters
    ----------
    tolerance : of the skin, relative to the diagonal.
    """
    faces = []
    for face in brep.faces:
        loops = []
        for loop in face.loops:
            reach = SHARE * tolerance * brep.diagonal
            loops.append(tuple(
                c if brep.edges[c.edge].degenerate else _on_line(face, _with_edge(brep, face, c, reach), reach)
                for c in loop
            ))
        faces.append(replace(face, loops=tuple(loops)))
    return replace(brep, faces=tuple(faces))


def _with_edge(brep: Brep, face: Face, c: Coedge, reach: float) -> Coedge:
    """The coedge over the parameter of its edge, on a parameter line if the edge leaves one by no more than a reach."""
    curve = brep.edges[c.edge].curve
    breaks = np.unique(np.concatenate([curve.knots, c.curve.knots]))
    # Where they turn sharply curves have many knots, close together.
    t = np.unique(np.concatenate([np.linspace(0.0, 1.0, SAMPLES), breaks, 0.5 * (breaks[1:] + breaks[:-1])]))
    x = curve_points(curve, t)
    uv = curve_points(c.curve, t)
    s, du, dv = surface_frame(face.surface, uv)
    n = np.cross(du, dv)
    n /= np.linalg.norm(n, axis=1)[:, None] + 1e-300
    off = x - s
    along = off - np.einsum("qc,qc->q", off, n)[:, None] * n
    gap = np.linalg.norm(along, axis=1) / brep.diagonal
    if gap.max() <= APART and gap[[0, -1]].max() <= NEAR:
        return c
    feet = project(face, uv, x, 8)[0]
    scale = np.array([np.linalg.norm(a, axis=1).mean() for a in (du, dv)]) + 1e-300
    d = followed(c, face.surface)
    if d >= 0 and np.ptp(feet[:, d]) * scale[d] > reach:
        d = -1

    def places(at: Array) -> Array:
        start = curve_points(c.curve, at)
        found = project(face, start, curve_points(curve, at), 8)[0]
        if d >= 0:
            found[:, d] = feet[[0, -1], d].mean()
        return found * scale

    try:
        made = fit_curve(places, FIT * brep.diagonal, breaks=breaks, enough=ENOUGH * brep.diagonal)
    except InputError:  # no curve: stay with what the file says
        return c
    return replace(c, curve=Curve(made.knots, made.control / scale))


def _on_line(face: Face, c: Coedge, reach: float) -> Coedge:
    """The coedge on a parameter line, if it is within a distance of one."""
    if followed(c, face.surface) >= 0:
        return c
    uv = curve_points(c.curve, np.linspace(0.0, 1.0, SAMPLES))
    for d in range(2):
        t = face.surface.knots[d]
        extent = np.ptp(uv, axis=0) / np.array([np.ptp(k) for k in face.surface.knots])
        if extent[d] > NEARLY * extent[1 - d]:
            continue
        ends = np.array([t[0], t[-1]])
        at = uv.copy()
        middle = 0.5 * (uv[:, d].min() + uv[:, d].max())
        border = ends[np.abs(ends - middle).argmin()]
        at[:, d] = border if abs(border - middle) <= NEARLY * np.ptp(t) else middle
        if np.linalg.norm(surface_points(face.surface, at) - surface_points(face.surface, uv), axis=1).max() <= reach:
            control = c.curve.control.copy()
            control[:, d] = at[0, d]
            return replace(c, curve=Curve(c.curve.knots, control))
    return c
