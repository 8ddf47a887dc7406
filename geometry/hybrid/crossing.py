"""Triangles that cut each other: an edge of one passes through the other, apart from common vertices.

Candidates have overlapping boxes, found by a sweep along x. Triangles of one plane that overlap are not found unless an
edge pierces; meshes with such overlaps do not pass later checks.

Axis letters: v vertex, t triangle, c component, k pair.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def crossing_pairs(points: Array, triangles: Index, owner: Index | None = None, group: Index | None = None) -> Index:
    """Pairs of triangles that cut each other.

    Parameters
    ----------
    points : (v, 3)
    triangles : (t, 3)
    owner : (t,) triangles of equal owner >= 0 are not tested against each other; all are if not given.
    group : (t,) pairs with a triangle of group 0 are tested, others are not; all are if not given.

    Returns
    -------
    (k, 2) numbers of triangles.
    """
    corner = points[triangles]
    low, high = corner.min(axis=1), corner.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    owner = np.full(len(triangles), -1) if owner is None else owner
    group = np.zeros(len(triangles), dtype=np.int64) if group is None else group
    found = _sweep(points, triangles, owner, group, low, high, order)
    return np.asarray(found, dtype=np.int64).reshape(-1, 2)


@numba.njit(cache=True)
def _pierces(points, p, q, triangle):  # type: ignore[no-untyped-def]
    """Whether the segment from point p to q passes through the triangle."""
    for k in range(3):
        if triangle[k] == p or triangle[k] == q:
            return False
    a, b, c = points[triangle[0]], points[triangle[1]], points[triangle[2]]
    e, f, d, s = b - a, c - a, points[q] - points[p], points[p] - a
    hx = d[1] * f[2] - d[2] * f[1]
    hy = d[2] * f[0] - d[0] * f[2]
    hz = d[0] * f[1] - d[1] * f[0]
    det = e[0] * hx + e[1] * hy + e[2] * hz
    size = np.sqrt((e * e).sum() * (f * f).sum() * (d * d).sum())
    if abs(det) <= 1e-12 * size:
        return False
    u = (s[0] * hx + s[1] * hy + s[2] * hz) / det
    if u < 0.0 or u > 1.0:
        return False
    gx = s[1] * e[2] - s[2] * e[1]
    gy = s[2] * e[0] - s[0] * e[2]
    gz = s[0] * e[1] - s[1] * e[0]
    v = (d[0] * gx + d[1] * gy + d[2] * gz) / det
    if v < 0.0 or u + v > 1.0:
        return False
    t = (f[0] * gx + f[1] * gy + f[2] * gz) / det
    return 0.0 <= t <= 1.0


@numba.njit(cache=True)
def _cut(points, s, t):  # type: ignore[no-untyped-def]
    for k in range(3):  # noqa: SIM110
        if _pierces(points, s[k], s[(k + 1) % 3], t) or _pierces(points, t[k], t[(k + 1) % 3], s):
            return True
    return False


@numba.njit(cache=True)
def _sweep(points, triangles, owner, group, low, high, order):  # type: ignore[no-untyped-def]
    found = [0]
    found.pop()
    n = len(order)
    for a in range(n):
        i = order[a]
        for b in range(a + 1, n):
            j = order[b]
            if low[j, 0] > high[i, 0]:
                break
            if group[i] != 0 and group[j] != 0:
                continue
            if owner[i] >= 0 and owner[i] == owner[j]:
                continue
            if low[j, 1] > high[i, 1] or low[i, 1] > high[j, 1] or low[j, 2] > high[i, 2] or low[i, 2] > high[j, 2]:
                continue
            if _cut(points, triangles[i], triangles[j]):
                found.append(i)
                found.append(j)
    return np.array(found)
