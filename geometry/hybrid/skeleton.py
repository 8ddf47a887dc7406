r"""Straight skeletons of skins: whether a closed triangle mesh cuts through itself.

A pair of triangles without a common vertex must not meet; a pair with one common vertex must meet there only.

Axis letters: t triangle, n vertex.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def _volume(a: Any, b: Any, c: Any, d: Any) -> Any:
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    z0, z1, z2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return x0 * (y1 * z2 - y2 * z1) + x1 * (y2 * z0 - y0 * z2) + x2 * (y0 * z1 - y1 * z0)


@njit(cache=True)
def _pierces(p: Any, q: Any, a: Any, b: Any, c: Any) -> Any:
    """Whether segment pq goes through triangle abc."""
    u, v = _volume(a, b, c, p), _volume(a, b, c, q)
    if (u > 0.0) == (v > 0.0) or u == v:
        return False
    i, j, k = _volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)
    return (i > 0.0 and j > 0.0 and k > 0.0) or (i < 0.0 and j < 0.0 and k < 0.0)


@njit(cache=True)
def _meet(x: Any, s: Any, t: Any) -> Any:
    shared = 0
    for i in range(3):
        for j in range(3):
            shared += s[i] == t[j]
    if shared >= 2:
        return False
    for first, second in ((s, t), (t, s)):
        for k in range(3):
            p, q = first[k], first[(k + 1) % 3]
            touches = False
            for j in range(3):
                touches = touches or p == second[j] or q == second[j]
            if not touches and _pierces(x[p], x[q], x[second[0]], x[second[1]], x[second[2]]):
                return True
    return False


@njit(cache=True)
def _crossings(x: Any, triangles: Any, low: Any, high: Any, order: Any, out: Any) -> Any:
    found = 0
    n = len(order)
    for i in range(n):
        s = order[i]
        for j in range(i + 1, n):
            t = order[j]
            if low[t, 0] > high[s, 0]:
                break
            if (low[t, 1] <= high[s, 1] and low[s, 1] <= high[t, 1] and low[t, 2] <= high[s, 2]
                    and low[s, 2] <= high[t, 2] and _meet(x, triangles[s], triangles[t])):
                if found < len(out):
                    out[found, 0], out[found, 1] = s, t
                found += 1
    return found


def crossings(x: Array, triangles: Index, most: int = 1000) -> Index:
    """Pairs (k, 2) of triangles that cut through each other, at most ``most``."""
    corners = x[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    out = np.zeros((most, 2), dtype=np.int64)
    found = _crossings(x, triangles, low, high, np.argsort(low[:, 0]), out)
    return out[: min(found, most)]
