r"""Plane charts of faces, in which they are meshed.

A chart is a map q = (x, y) of the parameters that keeps lengths roughly and has a closed inverse,

    y = s (v - v_0),      x = w(v) (u - u_m),

with s the mean of |S_v| and w(v) the mean of |S_u| along v = const, a cubic spline, or a constant where it hardly
changes. At a pole w = 0: the degenerate edge becomes one point of the chart, as it is one point in space.

Axis letters: q point, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from geometry.cad.brep import Face, curve_points, surface_frame, surface_points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NARROWS = 3.0
"""How much a chart may narrow towards a pole within an element of its parameter lines' B-splines."""
_ROWS = 17
"""Values of v at which the width is taken."""


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart of a face.

    Attributes
    ----------
    face : the face.
    swapped : the parameters are turned (u, v) -> (-v, u) first, because the pole lies at an end of u.
    centre, origin, scale : u_m, v_0 and s.
    width : w, a number or a spline in v.
    poles : values of v at which w = 0.
    """

    face: Face
    swapped: bool
    centre: float
    origin: float
    scale: float
    width: float | CubicSpline
    poles: tuple[float, ...]


def make_chart(face: Face) -> Chart:
    """Chart of a face, fitted to its trimmed region."""
    t = np.linspace(0.0, 1.0, 9)
    uv = np.concatenate([curve_points(c.curve, t) for loop in face.loops for c in loop])
    swapped = False
    poles: list[float] = []
    for loop in face.loops:
        for c in loop:
            ends = c.curve.control[[0, -1]]
            if np.ptp(surface_points(face.surface, curve_points(c.curve, t)), axis=0).max() < 1e-9 * _extent(face):
                swapped = bool(abs(ends[1, 1] - ends[0, 1]) > abs(ends[1, 0] - ends[0, 0]))
                poles.append(float(ends[0, 0] if swapped else ends[0, 1]))
    if swapped:
        uv = np.stack([-uv[:, 1], uv[:, 0]], axis=1)
    low, high = uv.min(axis=0), uv.max(axis=0)
    v = np.linspace(low[1], high[1], _ROWS)
    u = np.linspace(low[0], high[0], 5)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    _, du, dv = surface_frame(face.surface, _turned(grid) if swapped else grid)
    if swapped:
        du, dv = dv, du
    rows = np.linalg.norm(du, axis=1).reshape(5, _ROWS).mean(axis=0)
    scale = float(np.linalg.norm(dv, axis=1).mean())
    for pole in poles:
        rows[np.abs(v - pole) < 1e-9 * max(np.ptp(v), 1e-300)] = 0.0
    inner = rows[rows > 1e-6 * rows.max()]
    width: float | CubicSpline = float(rows.mean())
    if poles or inner.max() > 1.3 * inner.min():
        width = CubicSpline(v, rows)
    return Chart(face, swapped, float(u.mean()), float(low[1]), scale, width, tuple(poles))


def _extent(face: Face) -> float:
    return float(np.ptp(face.surface.control.reshape(-1, 3), axis=0).max())


def _turned(uv: Array) -> Array:
    """(v, -u) back to (u, v)."""
    return np.stack([uv[:, 1], -uv[:, 0]], axis=1)


def _widths(chart: Chart, v: Array) -> Array:
    if isinstance(chart.width, float):
        return np.full(len(v), chart.width)
    w = np.asarray(chart.width(v))
    for pole in chart.poles:
        w = np.where(np.abs(v - pole) < 1e-9 * np.ptp(chart.width.x), 0.0, w)
    return w


def to_chart(chart: Chart, uv: Array) -> Array:
    """Chart points (q, 2) of parameters (q, 2)."""
    if chart.swapped:
        uv = np.stack([-uv[:, 1], uv[:, 0]], axis=1)
    x = _widths(chart, uv[:, 1]) * (uv[:, 0] - chart.centre)
    return np.stack([x, chart.scale * (uv[:, 1] - chart.origin)], axis=1)


def to_parameters(chart: Chart, q: Array) -> Array:
    """Parameters (q, 2) of chart points (q, 2); at a pole the middle of u."""
    v = chart.origin + q[:, 1] / chart.scale
    w = _widths(chart, v)
    small = np.abs(w) < 1e-9 * (np.abs(q[:, 0]) + chart.scale * 1e-9)
    u = chart.centre + np.where(small, 0.0, q[:, 0] / np.where(small, 1.0, w))
    uv = np.stack([u, v], axis=1)
    return _turned(uv) if chart.swapped else uv


def lengths_of(chart: Chart) -> Array:
    """Mean lengths (2,) in space of unit steps of both parameters."""
    width = chart.width if isinstance(chart.width, float) else float(chart.width(chart.width.x).mean())
    return np.array([chart.scale, width] if chart.swapped else [width, chart.scale])


def widths(chart: Chart, q: Array) -> Array:
    """Values (q,) of w at chart points (q, 2)."""
    return _widths(chart, chart.origin + q[:, 1] / chart.scale)


def narrows(chart: Chart, q: Array) -> Mask:
    """Elements (e,) with corners (e, c, 2) in the chart between which it narrows too much towards a pole."""
    w = widths(chart, q.reshape(-1, 2)).reshape(q.shape[:2])
    return np.asarray(w.max(axis=1) > _NARROWS * w.min(axis=1))


def parameter_steps(chart: Chart, q: Array, step: Array) -> Array:
    """Derivative (q, 2) of the parameters along steps (q, 2) in the chart; not at poles."""
    w, slope, _ = _width_jet(chart, chart.origin + q[:, 1] / chart.scale)
    dv = step[:, 1] / chart.scale
    uv = np.stack([step[:, 0] / w - q[:, 0] * slope * dv / w**2, dv], axis=1)
    return _turned(uv) if chart.swapped else uv


def parameter_bends(chart: Chart, q: Array, first: Array, second: Array) -> Array:
    """Second derivative (q, 2) of the parameters along two steps (q, 2) in the chart; not at poles."""
    w, slope, bend = _width_jet(chart, chart.origin + q[:, 1] / chart.scale)
    dv, ev = first[:, 1] / chart.scale, second[:, 1] / chart.scale
    u = q[:, 0] * dv * ev * (2.0 * slope**2 / w**3 - bend / w**2)
    u -= (first[:, 0] * ev + second[:, 0] * dv) * slope / w**2
    uv = np.stack([u, np.zeros(len(u))], axis=1)
    return _turned(uv) if chart.swapped else uv


def chart_steps(chart: Chart, uv: Array, step: Array) -> Array:
    """Derivative (q, 2) of the chart along steps (q, 2) of the parameters."""
    if chart.swapped:
        uv, step = (np.stack([-x[:, 1], x[:, 0]], axis=1) for x in (uv, step))
    w, slope, _ = _width_jet(chart, uv[:, 1])
    x = w * step[:, 0] + slope * step[:, 1] * (uv[:, 0] - chart.centre)
    return np.stack([x, chart.scale * step[:, 1]], axis=1)


def _width_jet(chart: Chart, v: Array) -> tuple[Array, Array, Array]:
    """Values of w and its first two derivatives."""
    if isinstance(chart.width, float):
        return np.full(len(v), chart.width), np.zeros(len(v)), np.zeros(len(v))
    return _widths(chart, v), np.asarray(chart.width(v, 1)), np.asarray(chart.width(v, 2))


def chart_points(chart: Chart, q: Array) -> Array:
    """Points in space (q, 3) of chart points (q, 2)."""
    return surface_points(chart.face.surface, to_parameters(chart, q))


def line_points(face: Face, chart: Chart | None, a: Array, b: Array, s: Array) -> Array:
    """Points (m, k, 3) of straight lines from a to b (m, 2), of the chart or else of the parameter plane, at (m, k)."""
    return surface_points(face.surface, _line(chart, a, b, s)).reshape(*s.shape, 3)


def line_frames(face: Face, chart: Chart | None, a: Array, b: Array, s: Array) -> tuple[Array, Array]:
    """Points (m, k, 3) of such lines and derivatives in s; the chart has no pole on them."""
    way = np.broadcast_to((b - a)[:, None], (*s.shape, 2)).reshape(-1, 2)
    q = (a[:, None] + s[..., None] * (b - a)[:, None]).reshape(-1, 2)
    if chart is not None:
        v, slope = chart.origin + q[:, 1] / chart.scale, way[:, 1] / chart.scale
        w = _widths(chart, v)
        steeper = 0.0 if isinstance(chart.width, float) else np.asarray(chart.width(v, 1))
        u = q[:, 0] / w
        way = np.stack([(way[:, 0] - u * steeper * slope) / w, slope], axis=1)
        q = np.stack([chart.centre + u, v], axis=1)
        if chart.swapped:
            q, way = _turned(q), _turned(way)
    x, du, dv = surface_frame(face.surface, q)
    return x.reshape(*s.shape, 3), (du * way[:, :1] + dv * way[:, 1:]).reshape(*s.shape, 3)


def line_normals(face: Face, chart: Chart | None, a: Array, b: Array, s: Array) -> Array:
    """Unit normals of the surface along such lines; a little beside their ends, which may be poles."""
    _, du, dv = surface_frame(face.surface, _line(chart, a, b, np.clip(s, 1e-3, 1.0 - 1e-3)))
    n = np.cross(du, dv)
    return np.asarray(n / (np.linalg.norm(n, axis=1)[:, None] + 1e-300)).reshape(*s.shape, 3)


def _line(chart: Chart | None, a: Array, b: Array, s: Array) -> Array:
    q = (a[:, None] + s[..., None] * (b - a)[:, None]).reshape(-1, 2)
    return q if chart is None else to_parameters(chart, q)
