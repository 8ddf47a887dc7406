"""Pairs of triangles of a surface that cross each other.

Two triangles cross if an edge of one goes from one side of the other's plane to the other side through the closed
triangle. Signs are those of volumes of tetrahedra with a bound on their rounding error; a volume within the bound
counts as zero and as no crossing, so that what only touches (or is smaller than rounding) is let pass. Neighbours at
an edge cross if they are folded flat onto one another.

Axis letters: t triangle.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.tree import Tree, triangle_tree

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def first_crossing(points: Array, triangles: Index) -> tuple[int, int, int] | None:
    """Two triangles that cross each other and the number of such pairs; None if there are none."""
    corners = points[triangles]
    one, two, count = _crossings(points, triangles, triangle_tree(corners))
    return (int(one), int(two), int(count)) if count else None


@njit(cache=True)
def _volume_sign(a: Array, b: Array, c: Array, d: Array) -> int:
    """Sign of det(b - a, c - a, d - a); 0 within rounding."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    det = bx * (cy * dz - cz * dy) - by * (cx * dz - cz * dx) + bz * (cx * dy - cy * dx)
    size = (
        abs(bx) * (abs(cy * dz) + abs(cz * dy))
        + abs(by) * (abs(cx * dz) + abs(cz * dx))
        + abs(bz) * (abs(cx * dy) + abs(cy * dx))
    )
    if abs(det) <= 1e-14 * size:
        return 0
    return 1 if det > 0 else -1


@njit(cache=True)
def _pierces(p: Array, q: Array, a: Array, b: Array, c: Array) -> bool:
    """Whether the segment pq goes through the triangle abc from one side to the other."""
    if _volume_sign(a, b, c, p) * _volume_sign(a, b, c, q) >= 0:
        return False
    one, two, three = _volume_sign(p, q, a, b), _volume_sign(p, q, b, c), _volume_sign(p, q, c, a)
    return (one >= 0 and two >= 0 and three >= 0) or (one <= 0 and two <= 0 and three <= 0)


@njit(cache=True)
def _cross(points: Array, s: Index, t: Index) -> bool:
    """Whether two triangles, given by vertices, cross."""
    shared = 0
    for i in range(3):
        for j in range(3):
            shared += s[i] == t[j]
    if shared == 3:
        return True
    if shared == 2:
        return _folded(points, s, t)
    for one, two in ((s, t), (t, s)):
        for i in range(3):
            u, v = one[i], one[(i + 1) % 3]
            if (u == two).any() or (v == two).any():
                continue
            if _pierces(points[u], points[v], points[two[0]], points[two[1]], points[two[2]]):
                return True
    return False


@njit(cache=True)
def _folded(points: Array, s: Index, t: Index) -> bool:
    """Whether two triangles at a common edge lie in one plane on the same side of the edge."""
    for i in range(3):
        if not (s[i] == t).any():
            break
    for j in range(3):
        if not (t[j] == s).any():
            break
    a, b = points[s[(i + 1) % 3]], points[s[(i + 2) % 3]]
    p, q = points[s[i]], points[t[j]]
    if _volume_sign(a, b, p, q) != 0:
        return False
    return np.dot(np.cross(b - a, p - a), np.cross(b - a, q - a)) > 0


@njit(cache=True)
def _crossings(points: Array, triangles: Index, tree: Tree) -> tuple[int, int, int]:
    count, first, second = 0, -1, -1
    stack = np.empty(128, dtype=np.int64)
    for s in range(len(triangles)):
        lo, hi = np.empty(3), np.empty(3)
        for d in range(3):
            x, y, z = points[triangles[s, 0], d], points[triangles[s, 1], d], points[triangles[s, 2], d]
            lo[d], hi[d] = min(x, y, z), max(x, y, z)
        stack[0] = 0
        size = 1
        while size:
            size -= 1
            node = stack[size]
            apart = False
            for d in range(3):
                apart = apart or tree.lower[node, d] > hi[d] or tree.upper[node, d] < lo[d]
            if apart:
                continue
            if tree.child[node] >= 0:
                stack[size], stack[size + 1] = tree.child[node], tree.child[node] + 1
                size += 2
                continue
            for k in range(tree.begin[node], tree.end[node]):
                t = tree.order[k]
                if t > s and _cross(points, triangles[s], triangles[t]):
                    if count == 0:
                        first, second = s, t
                    count += 1
    return first, second, count
