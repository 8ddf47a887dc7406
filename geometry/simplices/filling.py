r"""Fill holes of a surface triangulation with triangles on the vertices that are there (Liepa, Filling holes in meshes,
Symposium on Geometry Processing, 2003, section 2).

A hole is a loop of vertices. Of all ways to cut its polygon into triangles the one is taken whose sharpest dihedral
angle, with the triangles around the hole too, is smallest, and of those that of least area:

    W(i, k) = min over i < m < k of W(i, m) + W(m, k) + (angle, area)(i, m, k),

where angles add by their maximum and areas by their sum. That ends for curled holes too, where cutting ears in a plane
does not. Sides that are edges of the surface already would belong to more than two triangles and are left out.

Where holes touch at a vertex, a loop goes on along the edge that is next around the vertex, so loops are simple.

Axis letters: v vertex, t triangle, k edge of the border; i, m, j places on a loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.simplices.surface import doubled_normals, half_edges

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Hole:
    """A hole.

    Attributes
    ----------
    loop : (i,) vertices around it, in the order of triangles that fill it.
    beyond : (i,) third vertex of the surface's triangle at the edge from each of them to the next.
    """

    loop: Index
    beyond: Index


def holes(points: Array, triangles: Index) -> list[Hole]:
    """Holes of triangles that are oriented alike; edges of the border that close no loop are left out."""
    start, end, beyond = _border(triangles)
    normals = np.zeros_like(points)
    np.add.at(normals, triangles.ravel(), np.repeat(doubled_normals(points[triangles]), 3, axis=0))
    leaving: dict[int, list[int]] = {}
    for edge, vertex in enumerate(start.tolist()):
        leaving.setdefault(vertex, []).append(edge)
    found: list[Hole] = []
    for first, vertex in enumerate(start.tolist()):
        if first not in leaving[vertex]:
            continue
        leaving[vertex].remove(first)
        path, met = [first], {vertex: 0}
        while path:
            here = int(end[path[-1]])
            if here in met:
                # A vertex that the path has met before closes a loop; the path goes on without it.
                loop = np.array(path[met[here] :])
                found.append(Hole(start[loop], beyond[loop]))
                del path[met[here] :]
                for left in start[loop].tolist():
                    del met[left]
                continue
            ways = leaving.get(here)
            if not ways:
                break
            onward = _next_around(points, normals[here], here, int(start[path[-1]]), end[ways])
            met[here] = len(path)
            path.append(ways.pop(onward))
    return found


def filled(points: Array, triangles: Index, hole: Hole) -> Index | None:
    """Triangles (t, 3) that close a hole; None where all ways give an edge to more than two triangles.

    Parameters
    ----------
    triangles : (t, 3) those of the surface, or at least those with two vertices on the hole.
    """
    n = len(hole.loop)
    if n < 3:
        return None
    ends = half_edges(triangles)
    near = np.isin(ends, hole.loop).all(axis=1)
    place = np.full(len(points), -1, dtype=np.int64)
    place[hole.loop] = np.arange(n)
    taken = np.zeros((n, n), dtype=np.bool_)
    taken[tuple(place[ends[near]].T)] = True
    taken |= taken.T
    i = np.arange(n)
    taken[i, (i + 1) % n] = taken[(i + 1) % n, i] = False
    split = _best(np.ascontiguousarray(points[hole.loop]), np.ascontiguousarray(points[hole.beyond]), taken)
    if split[0, n - 1] < 0:
        return None
    made, stack = [], [(0, n - 1)]
    while stack:
        a, b = stack.pop()
        if b - a > 1:
            m = int(split[a, b])
            made.append((a, m, b))
            stack += [(a, m), (m, b)]
    return np.asarray(hole.loop[np.array(made)])


def _border(triangles: Index) -> tuple[Index, Index, Index]:
    """Start and end (k,) of edges with one triangle, against its direction, and its third vertex."""
    half = half_edges(triangles)
    inverse, count = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True)[1:]
    single = count[inverse.ravel()] == 1
    return half[single, 1], half[single, 0], triangles[:, [2, 0, 1]].ravel()[single]


def _next_around(points: Array, normal: Array, here: int, before: int, ends: Index) -> int:
    """Which of the edges from a vertex to ``ends`` comes first when turning from the edge to ``before``.

    The hole lies to the left of its loop, seen from outside, so the turn is clockwise.
    """
    if len(ends) == 1:
        return 0
    x = points[before] - points[here]
    y = np.cross(x, normal)
    ways = points[ends] - points[here]
    # Both axes are perpendicular to the normal and equally long.
    x = np.cross(normal, y) / max(float(np.linalg.norm(normal)), 1e-300)
    return int(np.argmin(np.arctan2(ways @ y, ways @ x) % (2 * np.pi)))


@njit(cache=True)
def _unit_normal(a: Array, b: Array, c: Array) -> tuple[Array, float]:
    """Unit normal and area of a triangle; the normal is zero if the area is."""
    normal = np.cross(b - a, c - a)
    length = np.sqrt((normal**2).sum())
    if length > 0.0:
        normal /= length
    return normal, length / 2.0


@njit(cache=True)
def _best(loop: Array, beyond: Array, taken: Mask) -> Index:
    """Place m (i, j) of the third corner at each side i j of the best triangulation of the loop's part from i to j."""
    n = len(loop)
    split = np.full((n, n), -1, dtype=np.int64)
    # One minus the cosine of the sharpest angle, area, and normal of the triangle at the side i j.
    sharp, area, normals = np.full((n, n), np.inf), np.full((n, n), np.inf), np.zeros((n, n, 3))
    for i in range(n - 1):
        sharp[i, i + 1], area[i, i + 1] = 0.0, 0.0
        normals[i, i + 1] = _unit_normal(loop[i + 1], loop[i], beyond[i])[0]
    last = _unit_normal(loop[0], loop[n - 1], beyond[n - 1])[0]
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            if taken[i, j]:
                continue
            for m in range(i + 1, j):
                if not (np.isfinite(area[i, m]) and np.isfinite(area[m, j])):
                    continue
                normal, size = _unit_normal(loop[i], loop[m], loop[j])
                if size == 0.0:
                    continue
                worst = max(sharp[i, m], sharp[m, j])
                worst = max(worst, 1.0 - (normal * normals[i, m]).sum(), 1.0 - (normal * normals[m, j]).sum())
                if span == n - 1:
                    worst = max(worst, 1.0 - (normal * last).sum())
                whole = area[i, m] + area[m, j] + size
                # Angles that differ by rounding are one.
                better = worst < sharp[i, j] - 1e-9 or (worst < sharp[i, j] + 1e-9 and whole < area[i, j])
                if better:
                    sharp[i, j], area[i, j], split[i, j], normals[i, j] = worst, whole, m, normal
    return split
