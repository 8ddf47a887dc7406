r"""Polygons with holes cut into triangles by ears.

Holes are joined to the outer loop by their shortest visible bridges, then the best shaped ear is cut off until three
vertices are left.

Axis letters: n vertex, t triangle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True)
def turn(p: Any, a: Any, b: Any, c: Any) -> Any:
    """Twice the signed area of triangle abc."""
    return (p[b, 0] - p[a, 0]) * (p[c, 1] - p[a, 1]) - (p[b, 1] - p[a, 1]) * (p[c, 0] - p[a, 0])


@njit(cache=True)
def _crosses(p: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Whether segments ab and cd, which share no end, meet."""
    for k in range(2):  # pieces of one straight line are apart, whatever rounding makes of their turns
        if max(p[a, k], p[b, k]) < min(p[c, k], p[d, k]) or max(p[c, k], p[d, k]) < min(p[a, k], p[b, k]):
            return False
    return (turn(p, a, b, c) > 0.0) != (turn(p, a, b, d) > 0.0) and (
        (turn(p, c, d, a) > 0.0) != (turn(p, c, d, b) > 0.0)
    )


@njit(cache=True)
def _visible(p: Any, a: Any, b: Any, starts: Any, ends: Any) -> Any:
    for i in range(len(starts)):
        c, d = starts[i], ends[i]
        if c in (a, b) or d in (a, b):
            continue
        if _crosses(p, a, b, c, d):
            return False
    return True


@njit(cache=True)
def _self_crossing(p: Any, starts: Any, ends: Any) -> Any:
    """Number of the first segment that crosses another, or -1."""
    for i in range(len(starts)):
        for j in range(i + 1, len(starts)):
            a, b, c, d = starts[i], ends[i], starts[j], ends[j]
            if a != c and a != d and b != c and b != d and _crosses(p, a, b, c, d):
                return i
    return -1


@njit(cache=True)
def _in_wedge(p: Any, before: Any, at: Any, after: Any, x: Any) -> Any:
    """Whether x is seen from a ring vertex on the inside (left of the ring)."""
    if turn(p, before, at, after) >= 0.0:
        return turn(p, before, at, x) > 0.0 and turn(p, at, after, x) > 0.0
    return turn(p, before, at, x) > 0.0 or turn(p, at, after, x) > 0.0


@njit(cache=True)
def ear_quality(p: Any, a: Any, b: Any, c: Any) -> Any:
    """4 sqrt(3) area / (sum of squared sides) in the plane."""
    s = 0.0
    for d in range(2):
        s += (p[a, d] - p[b, d]) ** 2 + (p[b, d] - p[c, d]) ** 2 + (p[c, d] - p[a, d]) ** 2
    return 2.0 * np.sqrt(3.0) * turn(p, a, b, c) / s


@njit(cache=True)
def cut_ears(p: Any, ring: Any) -> Any:
    """Triangles of a simple ring, best ear first; fewer than expected if it is not simple."""
    n = len(ring)
    left = ring.copy()
    out = np.empty((n - 2, 3), dtype=np.int64)
    made = 0
    while n > 3:
        best, chosen = -1.0, -1
        for i in range(n):
            a, b, c = left[(i - 1) % n], left[i], left[(i + 1) % n]
            if turn(p, a, b, c) <= 0.0:
                continue
            quality = ear_quality(p, a, b, c)
            if quality <= best:
                continue
            empty = True
            for j in range(n):
                v = left[j]
                if v in (a, b, c):
                    continue
                if turn(p, a, b, v) >= 0.0 and turn(p, b, c, v) >= 0.0 and turn(p, c, a, v) >= 0.0:
                    empty = False
                    break
            if empty:
                best, chosen = quality, i
        if chosen < 0:
            return out[:made]
        out[made, 0], out[made, 1], out[made, 2] = left[(chosen - 1) % n], left[chosen], left[(chosen + 1) % n]
        made += 1
        left[chosen : n - 1] = left[chosen + 1 : n].copy()
        n -= 1
    out[made, 0], out[made, 1], out[made, 2] = left[0], left[1], left[2]
    return out[: made + 1]


def bridged(p: Array, loops: list[Index], where: str) -> Index:
    """One ring of all loops, joined by shortest visible bridges."""
    starts = np.concatenate(loops)
    ends = np.concatenate([np.roll(loop, -1) for loop in loops])
    bad = _self_crossing(p, starts, ends)
    if bad >= 0:
        raise InputError(f"{where}: the polygon of its loops crosses itself at vertex {int(starts[bad])}")
    ring = loops[0]
    rest = list(loops[1:])
    while rest:
        best: tuple[float, int, int, int] | None = None
        for number, hole in enumerate(rest):
            apart = np.linalg.norm(p[ring][:, None] - p[hole][None], axis=-1)
            for flat in np.argsort(apart, axis=None):
                i, j = divmod(int(flat), len(hole))
                if best is not None and apart[i, j] >= best[0]:
                    break
                a, b = int(ring[i]), int(hole[j])
                if (
                    _in_wedge(p, ring[i - 1], a, ring[(i + 1) % len(ring)], b)
                    and _in_wedge(p, hole[j - 1], b, hole[(j + 1) % len(hole)], a)
                    and _visible(p, a, b, starts, ends)
                ):
                    best = (float(apart[i, j]), number, i, j)
                    break
        if best is None:
            raise InputError(f"{where}: an inner loop is not inside the outer one")
        _, number, i, j = best
        hole = np.roll(rest.pop(number), -j)
        starts = np.append(starts, ring[i])
        ends = np.append(ends, hole[0])
        ring = np.concatenate([ring[: i + 1], hole, hole[:1], ring[i:]])
    return ring
