r"""Compiled evaluation of spline curves and NURBS surfaces: values and first derivatives.

On the knot interval of x the functions of degree p follow from those of degree p - 1 (Cox and de Boor),

    N_i = (x - t_i) / (t_i+p - t_i) N'_i + (t_i+p+1 - x) / (t_i+p+1 - t_i+1) N'_i+1,
    dN_i/dx = p N'_i / (t_i+p - t_i) - p N'_i+1 / (t_i+p+1 - t_i+1).

Outside the knots the polynomial of the nearest interval goes on.

Axis letters: q point, n control point, c component.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def _functions(knots: Any, p: Any, x: Any, values: Any, slopes: Any) -> Any:
    """Values and derivatives of the p + 1 functions at x; number of the first."""
    n = len(knots) - p - 1
    low, high = p, n
    while high - low > 1:
        middle = (low + high) // 2
        if x >= knots[middle]:
            low = middle
        else:
            high = middle
    while knots[low + 1] <= knots[low]:  # the interval found has length zero at a repeated end
        low -= 1
    values[0] = 1.0
    for k in range(1, p + 1):
        if k == p:
            for j in range(p + 1):
                slopes[j] = 0.0
            for j in range(p):
                s = p * values[j] / (knots[low + 1 + j] - knots[low + 1 - p + j])
                slopes[j] -= s
                slopes[j + 1] += s
        carry = 0.0
        for j in range(k):
            left, right = knots[low + 1 - k + j], knots[low + 1 + j]
            share = values[j] / (right - left)
            values[j] = carry + (right - x) * share
            carry = (x - left) * share
        values[k] = carry
    return low - p


@njit(cache=True)
def curve_values(knots: Any, control: Any, t: Any, slope: Any) -> Any:
    """Points (q, c) of a spline curve, or its derivatives if ``slope``."""
    p = len(knots) - len(control) - 1
    values, slopes = np.zeros(p + 1), np.zeros(p + 1)
    out = np.zeros((len(t), control.shape[1]))
    for q in range(len(t)):
        first = _functions(knots, p, t[q], values, slopes)
        for i in range(p + 1):
            w = slopes[i] if slope else values[i]
            for c in range(control.shape[1]):
                out[q, c] += w * control[first + i, c]
    return out


@njit(cache=True)
def surface_values(ku: Any, kv: Any, control: Any, weights: Any, uv: Any) -> Any:
    """Points and both derivatives (q, 3, 3) of a NURBS surface: [:, 0] is S, [:, 1] S_u, [:, 2] S_v."""
    pu, pv = len(ku) - control.shape[0] - 1, len(kv) - control.shape[1] - 1
    a, da, b, db = np.zeros(pu + 1), np.zeros(pu + 1), np.zeros(pv + 1), np.zeros(pv + 1)
    out = np.zeros((len(uv), 3, 3))
    h = np.zeros((3, 4))
    for q in range(len(uv)):
        i0 = _functions(ku, pu, uv[q, 0], a, da)
        j0 = _functions(kv, pv, uv[q, 1], b, db)
        h[:] = 0.0
        for i in range(pu + 1):
            for j in range(pv + 1):
                w = weights[i0 + i, j0 + j]
                f, fu, fv = w * a[i] * b[j], w * da[i] * b[j], w * a[i] * db[j]
                h[0, 3] += f
                h[1, 3] += fu
                h[2, 3] += fv
                for c in range(3):
                    x = control[i0 + i, j0 + j, c]
                    h[0, c] += f * x
                    h[1, c] += fu * x
                    h[2, c] += fv * x
        for c in range(3):
            x = h[0, c] / h[0, 3]
            out[q, 0, c] = x
            out[q, 1, c] = (h[1, c] - x * h[1, 3]) / h[0, 3]
            out[q, 2, c] = (h[2, c] - x * h[2, 3]) / h[0, 3]
    return out
