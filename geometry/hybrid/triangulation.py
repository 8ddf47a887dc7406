r"""Well-shaped triangulations of a trimmed region of a plane chart.

The boundary is given: its vertices and segments stay. Ears are cut off the polygon (holes joined to it by bridges),
then interior edges are split where they are longer than a wanted size in space, or than the sides of the boundary
nearby allow, flipped and their vertices moved so that the shape in space improves:

    quality of a triangle = 4 sqrt(3) area / (sum of squared sides) in space, 1 if equilateral,

negative where the triangle is turned over in the chart, and a hundredth where two of its sides follow the boundary
through a vertex at which the boundary is smooth: curved elements degenerate there.

Axis letters: n vertex, t triangle, k its edge from corner k to corner k + 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.hybrid.ears import bridged, cut_ears, ear_quality
from geometry.hybrid.sizing import size_beside
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPLIT = 1.35
"""Edges longer than this many times the wanted size are split."""
TURN = 0.75
"""Largest angle (radians) between the normals at the ends of an interior edge."""
PASSES = 40
THIN = 1e-7
"""Quality in the chart below which a triangle counts as turned over, however small it is."""
BESIDE = 1e-3
"""Share of an edge from a pole at which its normal is taken."""
SHARE = 0.5
"""Share of the longest boundary side at a vertex up to which edges from there may be longer than wanted: the boundary
stays, and beside a long side of it small triangles would be slivers.
"""
LOOSE = 1.6
"""How much better the quality in space may be than that in the chart before the latter counts."""


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Vertices (n, 2) in the chart, the given ones first, and triangles (t, 3), positively turned."""

    vertices: Array
    triangles: Index


@njit(cache=True)
def _neighbours(triangles: Any) -> Any:
    n = len(triangles)
    adjacent = np.full((n, 3), -1, dtype=np.int64)
    top = triangles.max() + 1
    keys = np.empty(3 * n, dtype=np.int64)
    for t in range(n):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            keys[3 * t + k] = min(a, b) * top + max(a, b)
    order = np.argsort(keys)
    i = 0
    while i < 3 * n - 1:
        a, b = order[i], order[i + 1]
        if keys[a] == keys[b]:
            adjacent[a // 3, a % 3] = b // 3
            adjacent[b // 3, b % 3] = a // 3
            i += 2
        else:
            i += 1
    return adjacent


@njit(cache=True)
def _quality(q: Any, x: Any, a: Any, b: Any, c: Any, ab: Any, bc: Any, ca: Any, smooth: Any) -> Any:
    """Quality of triangle abc; ab, bc, ca say which sides are boundary."""
    plane = ear_quality(q, a, b, c)
    if not plane > THIN:
        return -1.0
    e0, e1, f0, f1, g0, g1 = (x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[c, 0] - x[a, 0], x[c, 1] - x[a, 1],
                              x[b, 2] - x[a, 2], x[c, 2] - x[a, 2])
    n0, n1, n2 = e1 * g1 - g0 * f1, g0 * f0 - e0 * g1, e0 * f1 - e1 * f0
    area = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    s = e0 * e0 + e1 * e1 + g0 * g0 + f0 * f0 + f1 * f1 + g1 * g1
    s += (f0 - e0) ** 2 + (f1 - e1) ** 2 + (g1 - g0) ** 2
    value = 2.0 * np.sqrt(3.0) * area / (s + 1e-300)
    # Corners far apart on a surface that curls may look well placed in space.
    value = min(value, LOOSE * plane)
    if (ab and bc and smooth[b]) or (bc and ca and smooth[c]) or (ca and ab and smooth[a]):
        value *= 0.01
    return value


@njit(cache=True)
def _triangle_quality(q: Any, x: Any, triangles: Any, adjacent: Any, smooth: Any, t: Any) -> Any:
    a, b, c = triangles[t]
    return _quality(q, x, a, b, c, adjacent[t, 0] < 0, adjacent[t, 1] < 0, adjacent[t, 2] < 0, smooth)


@njit(cache=True)
def _find(row: Any, value: Any) -> Any:
    for k in range(3):
        if row[k] == value:
            return k
    return -1


@njit(cache=True)
def _relink(adjacent: Any, t: Any, old: Any, new: Any) -> None:
    if t >= 0:
        adjacent[t, _find(adjacent[t], old)] = new


@njit(cache=True)
def _flip(q: Any, x: Any, triangles: Any, adjacent: Any, smooth: Any) -> Any:
    """Flip edges while the worse of their two triangles improves; number of flips."""
    quality = np.empty(len(triangles))
    for t in range(len(triangles)):
        quality[t] = _triangle_quality(q, x, triangles, adjacent, smooth, t)
    fresh = np.ones(len(triangles), dtype=np.bool_)  # changed since their edges were looked at
    total = 0
    for _ in range(60):
        flips = 0
        seen, fresh = fresh, np.zeros(len(triangles), dtype=np.bool_)
        for t in range(len(triangles)):
            for k in range(3):
                s = adjacent[t, k]
                if s < t or not (seen[t] or seen[s] or fresh[t] or fresh[s]):
                    continue
                j = _find(adjacent[s], t)
                a, b, c = triangles[t, k], triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
                d = triangles[s, (j + 2) % 3]
                if triangles[s, j] != b:
                    continue
                bc, ca = adjacent[t, (k + 1) % 3], adjacent[t, (k + 2) % 3]
                ad, db = adjacent[s, (j + 1) % 3], adjacent[s, (j + 2) % 3]
                if (bc >= 0 and bc == db) or (ca >= 0 and ca == ad):
                    continue  # would make two triangles with the same corners
                old = min(quality[t], quality[s])
                least = old + 1e-4 * abs(old) + 1e-12
                one = _quality(q, x, c, a, d, ca < 0, ad < 0, False, smooth)
                if one <= least:
                    continue
                two = _quality(q, x, d, b, c, db < 0, bc < 0, False, smooth)
                if two > least:
                    triangles[t, 0], triangles[t, 1], triangles[t, 2] = c, a, d
                    triangles[s, 0], triangles[s, 1], triangles[s, 2] = d, b, c
                    adjacent[t, 0], adjacent[t, 1], adjacent[t, 2] = ca, ad, s
                    adjacent[s, 0], adjacent[s, 1], adjacent[s, 2] = db, bc, t
                    _relink(adjacent, ad, s, t)
                    _relink(adjacent, bc, t, s)
                    quality[t], quality[s] = one, two
                    fresh[t] = fresh[s] = True
                    for near in (ad, bc):
                        if near >= 0:
                            fresh[near] = True
                    flips += 1
                    break
        total += flips
        if flips == 0:
            break
    return total


@njit(cache=True)
def _split(q: Any, triangles: Any, adjacent: Any, marked: Any, n: Any, count: Any) -> Any:
    """Halve marked interior edges (t, k) in order, each triangle at most once; new numbers (n, count)."""
    touched = np.zeros(len(triangles), dtype=np.bool_)
    for i in range(len(marked)):
        t, k = marked[i]
        s = adjacent[t, k]
        if s < 0 or touched[t] or touched[s]:
            continue
        j = _find(adjacent[s], t)
        a, b, c = triangles[t, k], triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        d = triangles[s, (j + 2) % 3]
        bc, ca = adjacent[t, (k + 1) % 3], adjacent[t, (k + 2) % 3]
        ad, db = adjacent[s, (j + 1) % 3], adjacent[s, (j + 2) % 3]
        m, u, v = n, count, count + 1
        q[m] = 0.5 * (q[a] + q[b])
        triangles[t, 0], triangles[t, 1], triangles[t, 2] = c, a, m
        triangles[u, 0], triangles[u, 1], triangles[u, 2] = b, c, m
        triangles[s, 0], triangles[s, 1], triangles[s, 2] = d, b, m
        triangles[v, 0], triangles[v, 1], triangles[v, 2] = a, d, m
        adjacent[t, 0], adjacent[t, 1], adjacent[t, 2] = ca, v, u
        adjacent[u, 0], adjacent[u, 1], adjacent[u, 2] = bc, t, s
        adjacent[s, 0], adjacent[s, 1], adjacent[s, 2] = db, u, v
        adjacent[v, 0], adjacent[v, 1], adjacent[v, 2] = ad, s, t
        _relink(adjacent, bc, t, u)
        _relink(adjacent, ad, s, v)
        touched[t] = touched[s] = touched[u] = touched[v] = True
        n += 1
        count += 2
    return n, count


@njit(cache=True)
def _move(
    q: Any, x: Any, q_new: Any, x_new: Any, triangles: Any, adjacent: Any, smooth: Any, fixed: Any,
    first: Any, around: Any,
) -> Any:  # fmt: skip
    """Take proposed places of interior vertices where the worst triangle around improves."""
    moved = 0
    for v in range(fixed, len(q)):
        old = new = 1.0
        for i in range(first[v], first[v + 1]):
            old = min(old, _triangle_quality(q, x, triangles, adjacent, smooth, around[i]))
        kept_q, kept_x = q[v].copy(), x[v].copy()
        q[v], x[v] = q_new[v], x_new[v]
        for i in range(first[v], first[v + 1]):
            new = min(new, _triangle_quality(q, x, triangles, adjacent, smooth, around[i]))
        if new > old:
            moved += 1
        else:
            q[v], x[v] = kept_q, kept_x
    return moved


def triangulate(
    boundary: Array,
    loops: list[Index],
    smooth: NDArray[np.bool_],
    frame: Callable[[Array], tuple[Array, Array]],
    size: Callable[[Array], Array],
    barred: set[tuple[int, int]],
    where: str,
) -> Triangulation:
    """Triangulate a region bounded by polygons.

    Parameters
    ----------
    boundary : (n, 2) vertices of the polygons in the chart.
    loops : their vertex numbers, the outer loop first, the inside on the left.
    smooth : (n,) whether the boundary is smooth at a vertex.
    frame : points and unit normals in space (q, 3) of chart points (q, 2), zero normals at poles.
    size : wanted length of edges (q,) at points in space (q, 3).
    barred : pairs of boundary vertices that no interior edge may join.
    where : name for messages.

    Raises
    ------
    InputError : the polygons cross, or an inner loop lies outside the outer one.
    """
    fixed = len(boundary)
    ring = bridged(boundary, loops, where)
    triangles = cut_ears(boundary, ring)
    if len(triangles) != len(ring) - 2:
        raise InputError(f"{where}: the polygon of its loops cannot be triangulated")
    adjacent = _neighbours(triangles)
    q = boundary.copy()
    x, normal = frame(q)
    _flip(q, x, triangles, adjacent, smooth)
    ends, longest = x, _longest_sides(x, loops)
    room = SHARE * longest

    def least(at: Array) -> Array:
        return np.minimum(size(at), size_beside(ends, longest, at))

    for round_ in range(PASSES):
        marked = _marked(q, x, normal, triangles, adjacent, smooth, frame, least, room, barred)
        if len(marked) == 0:
            break
        q, triangles, adjacent = _grown(q, triangles, adjacent, marked)
        more, more_normal = frame(q[len(x) :])
        x, normal = np.concatenate([x, more]), np.concatenate([normal, more_normal])
        smooth = np.concatenate([smooth, np.zeros(len(more), dtype=bool)])
        room = np.concatenate([room, np.zeros(len(more))])
        _flip(q, x, triangles, adjacent, smooth)
        for _ in range(3 if round_ < PASSES - 1 else 10):
            x, normal = _smoothed(q, x, normal, triangles, adjacent, smooth, fixed, frame)
            _flip(q, x, triangles, adjacent, smooth)
    for _ in range(8):
        x, normal = _smoothed(q, x, normal, triangles, adjacent, smooth, fixed, frame)
        if not _flip(q, x, triangles, adjacent, smooth):
            break
    return Triangulation(q, triangles)


def _marked(
    q: Array, x: Array, normal: Array, triangles: Index, adjacent: Index, smooth: NDArray[np.bool_],
    frame: Callable[[Array], tuple[Array, Array]], size: Callable[[Array], Array], room: Array,
    barred: set[tuple[int, int]],
) -> Index:  # fmt: skip
    """Interior edges (m, 2) to split, the worst first."""
    t, k = np.nonzero(adjacent > np.arange(len(triangles))[:, None])
    a, b = triangles[t, k], triangles[t, (k + 1) % 3]
    length = np.linalg.norm(x[a] - x[b], axis=1)
    ratio = length / np.maximum(size(0.5 * (x[a] + x[b])), np.maximum(room[a], room[b]))
    bend = np.arccos(np.clip(np.einsum("ec,ec->e", *_normals_at_ends(q, normal, a, b, frame)), -1.0, 1.0))
    score = np.maximum(ratio / SPLIT, bend / TURN)
    # Ears at smooth boundary vertices: split the side across.
    edge = adjacent < 0
    for corner in range(3):
        before = edge[:, (corner + 2) % 3] & edge[:, corner] & smooth[triangles[:, corner]]
        for tri in np.flatnonzero(before):
            other = (corner + 1) % 3
            s = adjacent[tri, other]
            if s >= 0:
                score[((t == tri) & (k == other)) | ((t == s) & (adjacent[t, k] == tri))] = np.inf
    if barred:
        for i, pair in enumerate(zip(a.tolist(), b.tolist())):
            if (min(pair), max(pair)) in barred:
                score[i] = np.inf
    chosen = np.flatnonzero(score > 1.0)
    order = chosen[np.argsort(-score[chosen] * 1e3 - length[chosen] / length.max(initial=1e-300), kind="stable")]
    return np.stack([t[order], k[order]], axis=1)


def _longest_sides(x: Array, loops: list[Index]) -> Array:
    """Length (n,) in space of the longer boundary side at each vertex."""
    longest = np.zeros(len(x))
    for ring in loops:
        after = np.roll(ring, -1)
        length = np.linalg.norm(x[after] - x[ring], axis=1)
        np.maximum.at(longest, ring, length)
        np.maximum.at(longest, after, length)
    return longest


def _normals_at_ends(
    q: Array, normal: Array, a: Index, b: Index, frame: Callable[[Array], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Unit normals at the ends of edges, at a pole the one that the surface has along the edge."""
    found = []
    for here, there in ((a, b), (b, a)):
        own = normal[here]
        pole = np.flatnonzero(~own.any(axis=1))
        if len(pole):
            own[pole] = frame(q[here[pole]] + BESIDE * (q[there[pole]] - q[here[pole]]))[1]
        found.append(own)
    return found[0], found[1]


def _grown(q: Array, triangles: Index, adjacent: Index, marked: Index) -> tuple[Array, Index, Index]:
    n, count = len(q), len(triangles)
    q = np.concatenate([q, np.zeros((len(marked), 2))])
    more = np.zeros((2 * len(marked), 3), dtype=np.int64)
    triangles, adjacent = np.concatenate([triangles, more]), np.concatenate([adjacent, more - 1])
    n, count = _split(q, triangles, adjacent, marked, n, count)
    return q[:n], np.ascontiguousarray(triangles[:count]), np.ascontiguousarray(adjacent[:count])


def _smoothed(
    q: Array, x: Array, normal: Array, triangles: Index, adjacent: Index, smooth: NDArray[np.bool_], fixed: int,
    frame: Callable[[Array], tuple[Array, Array]],
) -> tuple[Array, Array]:  # fmt: skip
    """Move interior vertices towards the mean of the centroids around them, weighted by area in space."""
    if len(q) == fixed:
        return x, normal
    corners = x[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total, weight = np.zeros_like(q), np.zeros(len(q))
    for c in range(3):
        np.add.at(total, triangles[:, c], area[:, None] * q[triangles].mean(axis=1))
        np.add.at(weight, triangles[:, c], area)
    proposed = q.copy()
    around = fixed + np.flatnonzero(weight[fixed:] > 0.0)
    proposed[around] = total[around] / weight[around, None]
    x_new = x.copy()
    x_new[fixed:], normal_new = frame(proposed[fixed:])
    order = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[order], np.arange(len(q) + 1))
    before = q.copy()
    _move(q, x, proposed, x_new, triangles, adjacent, smooth, fixed, first, order // 3)
    taken = np.flatnonzero((q[fixed:] != before[fixed:]).any(axis=1))
    normal = normal.copy()
    normal[fixed + taken] = normal_new[taken]
    return x, normal
