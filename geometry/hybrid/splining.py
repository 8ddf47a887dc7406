r"""Solids whose faces are bicubic polynomial splines: what revised B-splines and shared curves need.

Curves in space that neighbouring faces share carry no weights, so neither do the faces: a rational surface, or one of a
higher degree, is replaced within a share of the tolerance, with a bound of the distance that is proved where the degree
allows (`bound`). Arcs become cubics of the sixth order with a parameter of their own, and the curves in the parameter
plane of the face are carried over to it (`arcs`). Others are the CAD surface, elevated.

Axis letters: f face, e element, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, Face, curve_points, fit_curve, surface_points
from geometry.hybrid.arcs import Map, arcs_as_cubics
from geometry.hybrid.bound import FEET, distance_bound
from geometry.hybrid.compatible import crossings
from geometry.hybrid.fitting import project
from geometry.hybrid.grid import ALONG
from geometry.hybrid.hbrep import polynomial_surface, tensor_rows
from geometry.knots import apply, insertion
from geometry.patch import Patch
from iga.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHARE, LEAST = 0.5, 0.05
"""Share of what a face's gaps leave of the tolerance that replacing its surface may use; least share of the whole."""

FIT, ENOUGH = 1e-10, 1e-8
"""Distance of carried curves from their places, relative to the parameters, the second for short pieces."""
NARROW = 0.02
"""Share of the distance between lines within which a line makes no knot beside another."""


@dataclass(frozen=True, eq=False)
class Splined:
    """A solid whose faces are bicubic splines where they can be.

    Attributes
    ----------
    brep : the solid with replaced surfaces; curves in space as they were.
    apart : (f,) bound of the distance between a face and the CAD surface, 0 where it is the CAD surface.
    proved : (f,) the bound is proved, not sampled.
    without : faces that are no splines, and why.
    """

    brep: Brep
    apart: Array
    proved: Mask
    without: dict[int, str]


def splined(brep: Brep, tolerance: float, gaps: Array | None = None) -> Splined:
    """Replace surfaces by bicubic polynomial splines.

    Parameters
    ----------
    tolerance : of the skin, relative to the diagonal of the solid.
    gaps : (e,) distances of edges from their faces, in space: elements beside them are that far off already.
    """
    faces, apart, proved, without = [], np.zeros(len(brep.faces)), np.ones(len(brep.faces), dtype=bool), {}
    for f, face in enumerate(brep.faces):
        extent = float(np.linalg.norm(np.ptp(face.surface.control.reshape(-1, 3), axis=0)))
        exact = face.surface.weights is None and max(face.surface.degree) <= 3
        gap = 0.0 if gaps is None else max(gaps[c.edge] for loop in face.loops for c in loop)
        reach = max(SHARE * (tolerance * brep.diagonal - gap), LEAST * tolerance * brep.diagonal)
        arcs = None if exact else arcs_as_cubics(face.surface, reach)
        if arcs is not None:
            made, there, back = arcs
            new = _carried(replace(face, surface=made), there, back)
        else:
            back = _same
            try:
                new = replace(face, surface=polynomial_surface(face.surface, reach / extent))
            except InputError as error:
                without[f] = str(error)
                new = face
        if not exact and f not in without:
            apart[f], proved[f] = _apart(face, new, back)
        faces.append(new)
    return Splined(replace(brep, faces=tuple(faces)), apart, proved, without)


def _same(uv: Array) -> Array:
    return uv


def _carried(face: Face, there: Map, back: Map) -> Face:
    """A face with curves in its parameter plane mapped ``there``, where its surface has its parameters already."""
    extent = max(float(np.ptp(x)) for x in face.surface.knots)
    lines = [back(np.stack([np.unique(x)] * 2, axis=1))[:, d] for d, x in enumerate(face.surface.knots)]

    def moved(c: Coedge) -> Coedge:
        # Between knots the map is smooth.
        cuts = crossings(c, (lines[0], lines[1]))
        breaks = np.unique(np.concatenate([np.unique(c.curve.knots), cuts]))
        breaks = breaks[np.append(True, np.diff(breaks) > 1e-9)]
        breaks[-1] = 1.0
        curve = fit_curve(
            lambda t: there(curve_points(c.curve, t)), FIT * extent, breaks=breaks, enough=ENOUGH * extent
        )
        return replace(c, curve=curve)

    return replace(face, loops=tuple(tuple(moved(c) for c in loop) for loop in face.loops))


def _apart(face: Face, new: Face, back: Map) -> tuple[float, bool]:
    """Bound of the distance of a new face, inside the box of its loops, to the surface of the old one, whose parameters
    are ``back`` from the new ones.
    """
    t = np.linspace(0.0, 1.0, 33)
    made = new.surface
    outline = np.concatenate([curve_points(c.curve, t) for loop in new.loops for c in loop])
    box = outline.min(axis=0), outline.max(axis=0)
    lines = []
    for d in range(2):
        x = np.unique(np.concatenate([face.surface.knots[d], made.knots[d]]))
        x = x[(x > box[0][d]) & (x < box[1][d])]
        x = np.concatenate([[box[0][d]], x, [box[1][d]]])
        lines.append(np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])])))  # halves, of which the bound is near
    low = np.stack(np.meshgrid(*(x[:-1] for x in lines), indexing="ij"), axis=-1).reshape(-1, 2)
    high = np.stack(np.meshgrid(*(x[1:] for x in lines), indexing="ij"), axis=-1).reshape(-1, 2)
    large = ((high - low) > 1e-9 * np.ptp(outline, axis=0)).all(axis=1)
    low, high = low[large], high[large]
    A, dofs = tensor_rows(made.knots, low, high)
    net = np.einsum("enb,enc->ebc", A, made.control.reshape(-1, 3)[dofs])
    at = np.stack(np.meshgrid(FEET, FEET, indexing="ij"), axis=-1).reshape(-1, 2)
    uv = (low[:, None] + at * (high - low)[:, None]).reshape(-1, 2)
    x = surface_points(made, uv)
    feet, gap, _ = project(face, back(uv), x)
    found = distance_bound(face, back(low), back(high), net, feet.reshape(len(low), -1, 2))
    return (float(np.abs(gap).max()), False) if found is None else (float(found.max()), True)


def on_lines(surface: Patch, lines: tuple[Array, Array]) -> Patch:
    """The same bicubic surface with a simple knot at each line that is no knot yet, nor close to one: in an interval
    that is much smaller than the elements B-splines grow beyond all bounds.
    """
    control, knots = surface.control, []
    for d in range(2):
        t = surface.knots[d]
        reach = 10 * ALONG * float(np.ptp(t))
        gap = np.diff(lines[d])
        room = np.maximum(reach, NARROW * np.minimum(np.append(gap, np.inf), np.append(np.inf, gap)))
        new = [x for x, r in zip(lines[d].tolist(), room) if np.abs(t - x).min() > r and t[0] < x < t[-1]]
        fine = np.sort(np.concatenate([t, new]))
        control = apply(insertion(t, 3, fine), control, d)
        knots.append(fine)
    return Patch((knots[0], knots[1]), control)
