r"""Trimming curves of one face as monotone cubic Bezier segments, compatible in the parameter plane and in space.

A segment has control points c_k in the plane and P_k in space over the same parameter t in [0, 1]: both curves are cut
at the same t wherever the plane curve crosses a knot line or turns around in one direction, so that every segment lies
in one knot interval and is monotone or follows a parameter line. Loops keep the inside on their left.

Axis letters: s segment, k control point, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.cad.brep import Coedge, Face, curve_points, curve_tangents, surface_frame, surface_points
from geometry.hybrid.curves import bezier_points
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FLAT = 1e-10
"""Extent (of the parameter range) below which a segment follows a parameter line."""


@dataclass(frozen=True, eq=False)
class Trimming:
    """Segments of all loops, in order.

    Attributes
    ----------
    plane : (s, 4, 2) control points in the parameter plane.
    space : (s, 4, 3) control points in space.
    next : (s,) the segment that follows in the loop.
    edge : (s,) the coedge (counted through all loops) that each segment came from.
    low, high : (s,) the part of the coedge's parameter (along the loop) that it covers.
    """

    plane: Array
    space: Array
    next: Index
    edge: Index
    low: Array
    high: Array


def halves(control: Array, t: float | Array) -> tuple[Array, Array]:
    """Control points of the two parts of cubic pieces (.., 4, c) cut at t (de Casteljau)."""
    a, b, c, d = (control[..., k, :] for k in range(4))
    ab, bc, cd = a + t * (b - a), b + t * (c - b), c + t * (d - c)
    abc, bcd = ab + t * (bc - ab), bc + t * (cd - bc)
    m = abc + t * (bcd - abc)
    return np.stack([a, ab, abc, m], axis=-2), np.stack([m, bcd, cd, d], axis=-2)


def hermite(points: Callable[[Array], Array], pieces: int, slopes: Callable[[Array], Array] | None = None) -> Array:
    """Cubic Hermite pieces (m, 4, c) of a curve over [0, 1], uniform in its parameter.

    Parameters
    ----------
    slopes : derivatives of the curve; by default differences of second order.
    """
    t = np.linspace(0.0, 1.0, pieces + 1)
    x = points(t)
    if slopes is not None:
        slope = slopes(t)
    else:
        step = 1e-5
        inside = np.clip(t, step, 1.0 - step)
        a, b, c = points(inside - step), points(inside), points(inside + step)
        slope = ((c - a) * 0.5 + ((t - inside) / step)[:, None] * (a - 2.0 * b + c)) / step
    h = 1.0 / (3.0 * pieces)
    return np.stack([x[:-1], x[:-1] + h * slope[:-1], x[1:] - h * slope[1:], x[1:]], axis=1)


def trim_face(face: Face, tolerance: float | None = 1e-8, level: int = 0) -> Trimming:
    """Trimming of a face on its own: the space curves are those of its surface.

    Parameters
    ----------
    tolerance : pieces are halved until both cubics are within this of their curves, relative to the extents; None
        makes 2^level pieces of every edge instead.

    Raises
    ------
    InputError : an edge needs more than 1024 pieces.
    """
    plane, space, low, high, following = [], [], [], [], []
    edges: list[int] = []
    number = 0
    extent = float(np.linalg.norm(np.ptp(face.surface.control.reshape(-1, 3), axis=0)))
    spread = float(max(k[-1] - k[0] for k in face.surface.knots))
    for loop in face.loops:
        first = len(edges)
        for c in loop:
            uv, along = partial(_walk, c), partial(_walk_slopes, c)
            x, up = partial(_lift, face, c), partial(_lift_slopes, face, c)
            pieces = 2**level
            while True:
                a, b = hermite(uv, pieces, along), hermite(x, pieces, up)
                if tolerance is None or max(_apart(a, uv) / spread, _apart(b, x) / extent) <= tolerance:
                    break
                pieces *= 2
                if pieces > 1024:
                    raise InputError(f"{face.name}: a trimming curve needs more than 1024 cubic pieces")
            plane.append(a)
            space.append(b)
            cuts = np.linspace(0.0, 1.0, pieces + 1)
            edges += [number] * pieces
            low.append(cuts[:-1])
            high.append(cuts[1:])
            number += 1
        count = len(edges) - first
        following.append(first + np.roll(np.arange(count), -1))
    P = np.concatenate(plane)
    X = np.concatenate(space)
    after = np.concatenate(following)
    # Neighbours share their end points exactly.
    P[:, 3], X[:, 3] = P[after, 0], X[after, 0]
    made = Trimming(P, X, after, np.array(edges), np.concatenate(low), np.concatenate(high))
    return cut_at_knots(made, face.surface.knots)


def _walk(c: Coedge, t: Array) -> Array:
    """Points in the plane along the loop."""
    return curve_points(c.curve, 1.0 - t if c.reversed else t)


def _walk_slopes(c: Coedge, t: Array) -> Array:
    return -curve_tangents(c.curve, 1.0 - t) if c.reversed else curve_tangents(c.curve, t)


def _lift(face: Face, c: Coedge, t: Array) -> Array:
    """Points on the surface along the loop."""
    return surface_points(face.surface, _walk(c, t))


def _lift_slopes(face: Face, c: Coedge, t: Array) -> Array:
    _, du, dv = surface_frame(face.surface, _walk(c, t))
    d = _walk_slopes(c, t)
    return np.asarray(du * d[:, :1] + dv * d[:, 1:])


def _apart(control: Array, points: Callable[[Array], Array]) -> float:
    m = len(control)
    s = np.linspace(0.0, 1.0, 7)[1:-1]
    mine = bezier_points(control, s)
    theirs = points(((np.arange(m)[:, None] + s) / m).ravel()).reshape(mine.shape)
    return float(np.linalg.norm(mine - theirs, axis=-1).max())


def split_segments(trimming: Trimming, which: Index, at: Array) -> Trimming:
    """Cut some segments (m,), each once, at their parameters (m,)."""
    if len(which) == 0:
        return trimming
    t = at[:, None]
    pa, pb = halves(trimming.plane[which], t)
    xa, xb = halves(trimming.space[which], t)
    n = len(trimming.next)
    new = n + np.arange(len(which))
    after = np.concatenate([trimming.next, trimming.next[which]])
    after[which] = new
    plane, space = np.concatenate([trimming.plane, pb]), np.concatenate([trimming.space, xb])
    plane[which], space[which] = pa, xa
    middle = trimming.low[which] + at * (trimming.high[which] - trimming.low[which])
    low, high = np.concatenate([trimming.low, middle]), np.concatenate([trimming.high, trimming.high[which]])
    high[which] = middle
    return Trimming(plane, space, after, np.concatenate([trimming.edge, trimming.edge[which]]), low, high)


def cut_at_knots(trimming: Trimming, knots: tuple[Array, ...]) -> Trimming:
    """Cut segments at knot lines and where one coordinate turns around; snap what follows a parameter line."""
    trimming = replace(trimming, plane=trimming.plane.copy())  # snapping writes to it
    for d in range(2):
        lines = np.unique(knots[d])
        reach = FLAT * (lines[-1] - lines[0])
        while True:
            which, at = [], []
            for s, control in enumerate(trimming.plane[:, :, d]):
                t = _first_cut(control, lines, reach)
                if t is not None:
                    which.append(s)
                    at.append(t)
            if not which:
                break
            trimming = split_segments(trimming, np.array(which), np.array(at))
            # The cut lies on the knot line exactly.
            ends = trimming.plane[which, 3, d]
            nearest = lines[np.abs(ends[:, None] - lines[None]).argmin(axis=1)]
            snapped = np.where(np.abs(ends - nearest) < 100 * reach, nearest, ends)
            trimming.plane[which, 3, d] = snapped
            trimming.plane[trimming.next[which], 0, d] = snapped
        _straighten(trimming, d, lines, reach)
    return trimming


def _straighten(trimming: Trimming, d: int, lines: Array, reach: float) -> None:
    """Put segments along a parameter line on it exactly, and on the knot line if that is what it is, in place."""
    plane = trimming.plane
    for s in np.flatnonzero(np.ptp(plane[:, :, d], axis=1) <= 100 * reach).tolist():
        nearest = lines[np.abs(lines - plane[s, 0, d]).argmin()]
        plane[s, :, d] = nearest if abs(nearest - plane[s, 0, d]) <= 100 * reach else plane[s, 0, d]
        plane[trimming.next[s], 0, d] = plane[s, 3, d]
        before = int(np.flatnonzero(trimming.next == s)[0])
        plane[before, 3, d] = plane[s, 0, d]


def _first_cut(control: Array, lines: Array, reach: float) -> float | None:
    """Parameter inside (0, 1) at which a cubic coordinate must be cut, or None."""
    if np.ptp(control) <= reach:
        return None
    low, high = min(control[0], control[3]), max(control[0], control[3])
    a, b, c = np.diff(control)
    turns = _roots(np.array([a - 2.0 * b + c, 2.0 * (b - a), a]))
    for t in turns:
        if 1e-6 < t < 1.0 - 1e-6 and not low - reach <= _value(control, t) <= high + reach:
            return float(t)
    for t in turns:  # turning twice between the ends
        if 1e-6 < t < 1.0 - 1e-6 and len(turns) == 2 and abs(turns[0] - turns[1]) > 1e-6:
            return float(t)
    for line in lines[(lines > low + reach) & (lines < high - reach)]:
        return solve_monotone(control, float(line))
    return None


def _roots(coefficients: Array) -> list[float]:
    scale = np.abs(coefficients).max()
    if scale == 0.0:
        return []
    found = np.roots(np.where(np.abs(coefficients) < 1e-12 * scale, 0.0, coefficients))
    return sorted(float(r.real) for r in found if abs(r.imag) < 1e-9)


@njit(cache=True)
def _value(control: Any, t: Any) -> Any:
    s = 1.0 - t
    return s**3 * control[0] + 3 * t * s * s * control[1] + 3 * t * t * s * control[2] + t**3 * control[3]


@njit(cache=True)
def _solve(control: Any, value: Any) -> Any:
    low, high = 0.0, 1.0
    rising = control[3] > control[0]
    for _ in range(54):
        middle = 0.5 * (low + high)
        if (_value(control, middle) < value) == rising:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def solve_monotone(control: Array, value: float) -> float:
    """Parameter at which a monotone cubic coordinate takes a value, by bisection."""
    return float(_solve(np.ascontiguousarray(control), value))


@njit(cache=True)
def xi_at(curves: Any, which: Any, eta: Any) -> Any:
    """Xi of segments ``which`` (m,), monotone in eta, at given eta (m,)."""
    out = np.empty(len(which))
    for i in range(len(which)):
        c = curves[which[i]]
        out[i] = _value(c[:, 0].copy(), _solve(c[:, 1].copy(), eta[i]))
    return out


def refined(trimming: Trimming, levels: int = 1) -> Trimming:
    """Every segment halved ``levels`` times at its middle parameter."""
    for _ in range(levels):
        n = len(trimming.next)
        trimming = split_segments(trimming, np.arange(n), np.full(n, 0.5))
    return trimming
