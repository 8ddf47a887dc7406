r"""Cubic Bezier pieces of curves in space.

A piece is x_0, x_0 + a d_0, x_1 - b d_1, x_1 with the curve's own end points and tangents; a and b are chosen so that
the distance to the curve (not the difference at equal parameters) is least. For plane arcs it falls with the sixth
power of their length, where the cubic with a = b = 1/3 reaches the fourth only.

Axis letters: m piece, k sample, c component.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CurvePoints = Callable[[Array], Array]
"""Points (m, k, c) of all pieces at local parameters (m, k) in [0, 1]."""
CurveFrames = Callable[[Array], tuple[Array, Array]]
"""Points and derivatives, each (m, k, c)."""

_SAMPLES = 9
"""Samples inside a piece at which its distance is measured."""
_STEP = 1e-4
"""Step of differences: of second order they are off by 1e-8 of the third derivative, and by 1e-12 from rounding."""
_ALONG = 0.03
"""Weight of the distance along a surface beside that along its normal, which alone leaves pieces in planes open."""


def tangents(points: CurvePoints, s: Array) -> Array:
    """Derivatives (m, k, c) by differences of second order that stay in [0, 1]."""
    inside = np.clip(s, _STEP, 1.0 - _STEP)
    a, b, c = points(inside - _STEP), points(inside), points(inside + _STEP)
    # Derivative at s of the parabola through the three points.
    t = ((s - inside) / _STEP)[..., None]
    return ((c - a) * 0.5 + t * (a - 2.0 * b + c)) / _STEP


def bezier_points(control: Array, t: Array) -> Array:
    """Points (m, k, c) of cubic pieces (m, 4, c) at parameters (k,)."""
    return np.einsum("kj,mjc->mkc", cubic_functions(t), control)


def cubic_functions(t: Array) -> Array:
    """Cubic Bernstein functions (k, 4) at parameters (k,)."""
    return np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)


def fit_cubics(
    points: CurvePoints, start: Array, end: Array, normals: CurvePoints | None = None, rounds: int = 4,
    frames: CurveFrames | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Cubic pieces nearest to curves.

    Parameters
    ----------
    points : the curves.
    start, end : (m, 3) where pieces begin and end.
    normals : unit normals of the surface that the curves lie on, where it only matters that pieces lie on it too; the
        distance then is the one along the normal.
    frames : points and derivatives at once, where derivatives are known.

    Returns
    -------
    (m, 4, 3) control points, and (m,) the largest distance of samples of a piece from its curve.
    """
    m = len(start)
    both = frames or (lambda s: (points(s), tangents(points, s)))
    t = np.linspace(0.0, 1.0, _SAMPLES + 2)[1:-1]
    ends = both(np.repeat([[0.0, 1.0]], m, axis=0))[1]
    d0, d1 = ends[:, 0], ends[:, 1]
    lengths = np.full((m, 2), 1.0 / 3.0)
    table = cubic_functions(t)
    s = np.repeat(t[None], m, axis=0)
    size = np.einsum("mc,mc->m", end - start, end - start) + 1e-300
    distance = np.zeros(m)
    control = np.zeros((m, 4, start.shape[1]))
    for turn in range(rounds + 1):
        control = np.stack([start, start + lengths[:, :1] * d0, end - lengths[:, 1:] * d1, end], axis=1)
        b = bezier_points(control, t)
        for _ in range(2):
            x, dx = both(s)
            square = np.einsum("mkc,mkc->mk", dx, dx) + 1e-300
            s = np.clip(s + np.einsum("mkc,mkc->mk", b - x, dx) / square, 0.0, 1.0)
        x, dx = both(s)
        unit = dx / np.sqrt(np.einsum("mkc,mkc->mk", dx, dx) + 1e-300)[..., None]
        n = None if normals is None else normals(s)
        r = _across(x - b, unit, n)
        distance = np.sqrt(np.einsum("mkc,mkc->mk", r, r)).max(axis=1)
        if turn == rounds:
            break
        g0, g1 = table[None, :, 1, None] * d0[:, None], -table[None, :, 2, None] * d1[:, None]
        g0, g1 = _across(g0, unit, n), _across(g1, unit, n)
        a00, a01, a11 = (np.einsum("mkc,mkc->m", p, q) for p, q in ((g0, g0), (g0, g1), (g1, g1)))
        r0, r1 = (np.einsum("mkc,mkc->m", p, r) for p in (g0, g1))
        damp = 1e-8 * size  # a straight piece has no say about its lengths: leave them
        a00, a11 = a00 + damp, a11 + damp
        det = a00 * a11 - a01 * a01
        step = np.stack([(a11 * r0 - a01 * r1) / det, (a00 * r1 - a01 * r0) / det], axis=1)
        lengths = np.clip(lengths + np.clip(step, -0.05, 0.05), 0.2, 0.6)
    return (control, distance) if normals is None else _lifted(control, both, normals, s, t)


def _lifted(control: Array, both: CurveFrames, normals: CurvePoints, s: Array, t: Array) -> tuple[Array, Array]:
    """Pieces whose two inner control points are moved along the normals of the surface, by least squares over the
    distances at samples (k,) with feet (m, k): tangents at the ends need not be the curve's, because elements meet with
    C0 only, and a piece across knot lines of the surface comes several times nearer.
    """
    table = cubic_functions(t)
    n = normals(np.concatenate([s, np.repeat([[1.0 / 3.0, 2.0 / 3.0]], len(s), axis=0)], axis=1))
    n, inner = n[:, :-2], n[:, -2:]
    for turn in range(3):
        b = bezier_points(control, t)
        x, dx = both(s)
        s = np.clip(s + np.einsum("mkc,mkc->mk", b - x, dx) / (np.einsum("mkc,mkc->mk", dx, dx) + 1e-300), 0.0, 1.0)
        r = np.einsum("mkc,mkc->mk", both(s)[0] - b, n)
        if turn == 2:
            break
        rows = table[None, :, 1:3] * np.einsum("mkc,mjc->mkj", n, inner)
        A = np.einsum("mki,mkj->mij", rows, rows) + 1e-6 * np.eye(2)
        move = np.linalg.solve(A, np.einsum("mki,mk->mi", rows, r)[..., None])
        control[:, 1:3] += move * inner
    return control, np.abs(r).max(axis=1)


def _across(r: Array, unit: Array, normal: Array | None) -> Array:
    """Part of r (m, k, 3) across the curve, or along the normal with a little of the rest."""
    if normal is None:
        return np.asarray(r - np.einsum("mkc,mkc->mk", r, unit)[..., None] * unit)
    side = np.cross(normal, unit)
    return np.asarray(np.einsum("mkc,mkc->mk", r, normal)[..., None] * normal
                      + _ALONG * np.einsum("mkc,mkc->mk", r, side)[..., None] * side)
