"""Pairs of triangles in space that cross each other.

Two triangles cross if an edge of one goes from one side of the other's plane to the other side through the closed
triangle. Signs are those of volumes of tetrahedra with a bound on their rounding error; a volume within the bound
counts as zero and as no crossing, so that what only touches (or is smaller than rounding) is let pass. Neighbours at
an edge cross if they are folded flat onto one another.

Axis letters: v vertex, t triangle, k pair.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.tree import Tree, triangle_tree

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDING, COORDINATE = 1e-14, 5.0
"""Relative error of a volume, and in these units that of a coordinate: points on a plane face are off by 18 eps."""


def crossing_pairs(points: Array, triangles: Index, owner: Index | None = None, group: Index | None = None) -> Index:
    """Pairs of triangles that cross each other.

    Parameters
    ----------
    points : (v, 3)
    triangles : (t, 3)
    owner : (t,) triangles of equal owner >= 0 are not tested against each other; all are if not given.
    group : (t,) pairs with a triangle of group 0 are tested, others are not; all are if not given.

    Returns
    -------
    (k, 2) numbers of triangles, the smaller first, in ascending order.
    """
    owner = np.full(len(triangles), -1) if owner is None else owner
    group = np.zeros(len(triangles), dtype=np.int64) if group is None else group
    found = _crossings(points, triangles, owner, group, triangle_tree(points[triangles]))
    pairs = np.asarray(found, dtype=np.int64).reshape(-1, 2)
    return pairs[np.lexsort(pairs.T[::-1])]


@njit(cache=True)
def _volume_sign(a: Array, b: Array, c: Array, d: Array) -> int:
    """Sign of det(b - a, c - a, d - a); 0 within the rounding of the points and of the computation."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    det = bx * (cy * dz - cz * dy) - by * (cx * dz - cz * dx) + bz * (cx * dy - cy * dx)
    size = (
        abs(bx) * (abs(cy * dz) + abs(cz * dy))
        + abs(by) * (abs(cx * dz) + abs(cz * dx))
        + abs(bz) * (abs(cx * dy) + abs(cy * dx))
    )
    # Coordinates come from splines, right to some tens of units in their last place; so are sides, however short.
    m = 0.0
    for k in range(3):
        m = max(m, abs(a[k]), abs(b[k]), abs(c[k]), abs(d[k]))
    B, C, D = abs(bx) + abs(by) + abs(bz), abs(cx) + abs(cy) + abs(cz), abs(dx) + abs(dy) + abs(dz)
    size += COORDINATE * m * (B * C + C * D + D * B)
    if abs(det) <= ROUNDING * size:
        return 0
    return 1 if det > 0 else -1


@njit(cache=True)
def _pierces(p: Array, q: Array, a: Array, b: Array, c: Array) -> bool:
    """Whether the segment pq goes through the triangle abc from one side to the other."""
    if _volume_sign(a, b, c, p) * _volume_sign(a, b, c, q) >= 0:
        return False
    one, two, three = _volume_sign(p, q, a, b), _volume_sign(p, q, b, c), _volume_sign(p, q, c, a)
    if (one == 0) + (two == 0) + (three == 0) >= 2:  # through a vertex, or in the plane but for rounding
        return False
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
def _crossings(points: Array, triangles: Index, owner: Index, group: Index, tree: Tree) -> Index:
    found = [0]
    found.pop()
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
                if t <= s or (group[s] != 0 and group[t] != 0) or (owner[s] >= 0 and owner[s] == owner[t]):
                    continue
                if _cross(points, triangles[s], triangles[t]):
                    found.append(s)
                    found.append(t)
    return np.array(found)
