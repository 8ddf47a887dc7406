"""A surface cut along curves that do not cross.

A curve runs from a vertex of the surface to another one and is known by the edges it crosses (at least one), in order,
and where. Inside a triangle curves are straight, so whether they
meet is decided by the order of the crossings along edges alone. The overlay is the surface with all crossings as
new vertices and all curves as chains of edges.

A triangle with n vertices and crossings on its border becomes n - 2 triangles, however its curves run: the chords cut
it into convex polygons, and each polygon is cut into the triangles whose smallest angle is greatest.

Axis letters: v vertex, t triangle, e edge, p curve, c crossing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.simplices.surface import Surface

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Curve(NamedTuple):
    """A curve from vertex ``start`` to vertex ``end``: the edges (c,) that it crosses, and where ``at`` (c,)."""

    start: int
    end: int
    edge: Index
    at: Array


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves on a surface, in one table.

    Attributes
    ----------
    ends : (p, 2) vertices where a curve starts and ends.
    start : (p + 1,) first crossing of each curve.
    edge : (c,) the edges crossed, in order along each curve.
    at : (c,) where on the edge, from 0 at its lower vertex to 1.
    """

    ends: Index
    start: Index
    edge: Index
    at: Array


@dataclass(frozen=True, eq=False)
class Overlay:
    """A surface cut along curves.

    Attributes
    ----------
    points : (v, 3) the surface's vertices, then the crossings.
    triangles : (t, 3) vertex numbers.
    parent : (t,) triangle of the surface that holds each triangle.
    curve : (t, 3) curve along the side from corner i to corner i + 1, or -1.
    edge : (t, 3) edge of the surface on which the side lies, or -1.
    across : (t, 3) triangle on the other side times 3 plus the number of the side there.
    """

    points: Array
    triangles: Index
    parent: Index
    curve: Index
    edge: Index
    across: Index


def across_sides(triangles: Index) -> Index:
    """Side (t, 3) met across each side of a triangulation, as 3 (triangle) + side; -1 on a border."""
    low = np.minimum(triangles, np.roll(triangles, -1, axis=1)).astype(np.int64)
    high = np.maximum(triangles, np.roll(triangles, -1, axis=1)).astype(np.int64)
    key = (low * (int(triangles.max(initial=0)) + 1) + high).ravel()
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    result = np.full(len(key), -1, dtype=np.int64)
    result[order[pair]], result[order[pair + 1]] = order[pair + 1], order[pair]
    return result.reshape(-1, 3)


def join(curves: Iterable[Curve]) -> Curves:
    """The table of some curves."""
    curves = list(curves)
    return Curves(
        np.array([(curve.start, curve.end) for curve in curves], dtype=np.int64).reshape(-1, 2),
        np.cumsum([0, *(len(curve.edge) for curve in curves)], dtype=np.int64),
        np.concatenate([np.zeros(0, dtype=np.int64), *(curve.edge for curve in curves)]),
        np.concatenate([np.zeros(0), *(curve.at for curve in curves)]),
    )


def split(curves: Curves) -> list[Curve]:
    """The curves of a table one by one."""
    edges, ats = np.split(curves.edge, curves.start[1:-1]), np.split(curves.at, curves.start[1:-1])
    return [Curve(a, b, edge, at) for (a, b), edge, at in zip(curves.ends.tolist(), edges, ats, strict=False)]


def positions(surface: Surface, curves: Curves, edge: Index, node: Index) -> Array:
    """Where (n,) on edges of the surface, from 0 at the lower vertex to 1, nodes of the overlay lie."""
    result = (node == surface.edges[edge, 1]).astype(float)
    inner = node >= len(surface.points)
    result[inner] = curves.at[node[inner] - len(surface.points)]
    return result


def spread(curves: Curves, least: float = 0.08) -> Curves:
    """The same curves with crossings of an edge apart from one another and from its ends, in the same order.

    A gap is at least ``least``, or half an equal share where many curves cross the edge.
    """
    order = np.lexsort((curves.at, curves.edge))
    at = curves.at.copy()
    at[order] = _spread(curves.edge[order], curves.at[order], least)
    return Curves(curves.ends, curves.start, curves.edge, at)


def overlay(surface: Surface, curves: Curves) -> Overlay:
    """The surface cut along the curves."""
    vertices, crossings = len(surface.points), len(curves.edge)
    a, b = surface.points[surface.edges[curves.edge, 0]], surface.points[surface.edges[curves.edge, 1]]
    points = np.concatenate((surface.points, a + curves.at[:, None] * (b - a)))

    # Nodes along each curve: first vertex, crossings, last vertex; a chord joins each to the next.
    count = len(curves.ends)
    owner = np.repeat(np.arange(count), np.diff(curves.start))
    crossing = np.arange(crossings)
    first = np.ones(crossings, dtype=bool)
    first[1:] = owner[1:] != owner[:-1]
    last = np.roll(first, -1)
    inner = crossing[~last]
    chords = np.concatenate((
        np.stack((curves.ends[owner[first], 0], vertices + crossing[first], owner[first]), axis=1),
        np.stack((vertices + inner, vertices + inner + 1, owner[inner]), axis=1),
        np.stack((vertices + crossing[last], curves.ends[owner[last], 1], owner[last]), axis=1),
    ))
    at_end = np.concatenate((
        _opposite(surface, curves.edge[first], curves.ends[owner[first], 0]),
        _shared(surface, curves.edge[inner], curves.edge[inner + 1]),
        _opposite(surface, curves.edge[last], curves.ends[owner[last], 1]),
    ))
    order = np.argsort(at_end, kind="stable")
    chord_start = np.searchsorted(at_end[order], np.arange(len(surface.triangles) + 1))

    by_edge = np.lexsort((curves.at, curves.edge))
    edge_start = np.searchsorted(curves.edge[by_edge], np.arange(len(surface.edges) + 1))
    forward = surface.edges[surface.edge_of, 0] == surface.triangles
    triangles, parent, curve, edge = _cut(
        points, surface.triangles, surface.edge_of, forward, edge_start, by_edge + vertices,
        chord_start, chords[order],
    )
    return Overlay(points, triangles, parent, curve, edge, across_sides(triangles))


def _opposite(surface: Surface, edge: Index, vertex: Index) -> Index:
    """The triangle of each edge whose third corner is the vertex."""
    sides = surface.beside[edge]
    holds = (surface.triangles[sides] == vertex[:, None, None]).any(axis=2)
    if not (holds.sum(axis=1) == 1).all():
        raise ValueError("a curve does not start inside a triangle of its first vertex")
    return np.where(holds[:, 0], sides[:, 0], sides[:, 1])


def _shared(surface: Surface, one: Index, other: Index) -> Index:
    """The triangle that two edges share."""
    same = surface.beside[one][:, :, None] == surface.beside[other][:, None, :]
    if not (same.sum(axis=(1, 2)) == 1).all():
        raise ValueError("a curve goes from an edge to one that shares no triangle with it")
    return np.where(same[:, 0].any(axis=1), surface.beside[one][:, 0], surface.beside[one][:, 1])


@njit(cache=True)
def _spread(edge, at, least):  # type: ignore[no-untyped-def]
    result = at.copy()
    begin = 0
    while begin < len(edge):
        end = begin
        while end < len(edge) and edge[end] == edge[begin]:
            end += 1
        gap = min(least, 0.5 / (end - begin + 1))
        floor = 0.0
        for c in range(begin, end):
            floor += gap
            result[c] = max(result[c], floor)
            floor = result[c]
        roof = 1.0
        for c in range(end - 1, begin - 1, -1):
            roof -= gap
            result[c] = min(result[c], roof)
            roof = result[c]
        begin = end
    return result


@njit(cache=True)
def _cut(points, triangles, sides, forward, edge_start, on_edge, chord_start, chords):  # type: ignore[no-untyped-def]
    total, widest = 0, 3
    for t in range(len(triangles)):
        n = 3
        for i in range(3):
            n += edge_start[sides[t, i] + 1] - edge_start[sides[t, i]]
        total += n - 2
        widest = max(widest, n)
    out = np.empty((total, 3), dtype=np.int64)
    parent = np.empty(total, dtype=np.int64)
    curve = np.full((total, 3), -1, dtype=np.int64)
    edge = np.full((total, 3), -1, dtype=np.int64)
    ring = np.empty(widest, dtype=np.int64)
    ring_side = np.empty(widest, dtype=np.int64)
    polygons = np.empty((widest, widest), dtype=np.int64)
    sizes = np.empty(widest, dtype=np.int64)
    worst = np.empty((widest, widest))
    apex = np.empty((widest, widest), dtype=np.int64)
    stack = np.empty((2 * widest + 2, 2), dtype=np.int64)
    done = 0
    for t in range(len(triangles)):
        n = 0
        for i in range(3):
            ring[n], ring_side[n] = triangles[t, i], i
            n += 1
            low, high = edge_start[sides[t, i]], edge_start[sides[t, i] + 1]
            for c in range(low, high):
                ring[n] = on_edge[c] if forward[t, i] else on_edge[low + high - 1 - c]
                ring_side[n] = i
                n += 1
        # Polygons hold positions in the ring; a chord splits the one that has both its ends.
        count = 1
        sizes[0] = n
        for r in range(n):
            polygons[0, r] = r
        for c in range(chord_start[t], chord_start[t + 1]):
            found = False
            for q in range(count):
                u, v = -1, -1
                for r in range(sizes[q]):
                    if ring[polygons[q, r]] == chords[c, 0]:
                        u = r
                    if ring[polygons[q, r]] == chords[c, 1]:
                        v = r
                if u < 0 or v < 0:
                    continue
                u, v = min(u, v), max(u, v)
                m = 0
                for r in range(u, v + 1):
                    polygons[count, m] = polygons[q, r]
                    m += 1
                sizes[count] = m
                m = u + 1
                for r in range(v, sizes[q]):
                    polygons[q, m] = polygons[q, r]
                    m += 1
                sizes[q] = m
                count += 1
                found = True
                break
            if not found:
                raise ValueError("two curves cross")
        for q in range(count):
            m = sizes[q]
            _triangulate(points, ring, ring_side, polygons[q], m, worst, apex)
            top = 1
            stack[0] = 0, m - 1
            while top > 0:
                top -= 1
                a, b = stack[top]
                if b - a < 2:
                    continue
                c = apex[a, b]
                out[done] = ring[polygons[q, a]], ring[polygons[q, c]], ring[polygons[q, b]]
                parent[done] = t
                corner = (polygons[q, a], polygons[q, c], polygons[q, b])
                for i in range(3):
                    r, s = corner[i], corner[(i + 1) % 3]
                    if (r + 1) % n == s:
                        edge[done, i] = sides[t, ring_side[r]]
                    else:
                        for h in range(chord_start[t], chord_start[t + 1]):
                            if (chords[h, 0] == ring[r] and chords[h, 1] == ring[s]) or (
                                chords[h, 1] == ring[r] and chords[h, 0] == ring[s]
                            ):
                                curve[done, i] = chords[h, 2]
                done += 1
                stack[top] = a, c
                stack[top + 1] = c, b
                top += 2
    return out, parent, curve, edge


@njit(cache=True)
def _triangulate(points, ring, ring_side, polygon, m, worst, apex):  # type: ignore[no-untyped-def]
    """For each chain a..b of the polygon the apex c of the triangle on its chord, for the greatest smallest angle."""
    for a in range(m - 1):
        worst[a, a + 1] = np.inf
    for width in range(2, m):
        for a in range(m - width):
            b = a + width
            worst[a, b] = -np.inf
            apex[a, b] = a + 1
            for c in range(a + 1, b):
                value = min(worst[a, c], worst[c, b])
                if value > worst[a, b]:
                    sine = -1.0
                    if not _in_line(ring_side, polygon[a], polygon[c], polygon[b]):
                        sine = _least_sine(points[ring[polygon[a]]], points[ring[polygon[c]]], points[ring[polygon[b]]])
                    if min(value, sine) > worst[a, b]:
                        worst[a, b] = min(value, sine)
                        apex[a, b] = c


@njit(cache=True)
def _in_line(ring_side, r, s, t):  # type: ignore[no-untyped-def]
    """Whether three ring positions lie on one side of the triangle; a corner lies on the side before it, too."""
    for side in range(3):
        inside = 0
        for position in (r, s, t):
            starts = position == 0 or ring_side[position - 1] != ring_side[position]
            on = ring_side[position] == side or (starts and (ring_side[position] + 2) % 3 == side)
            inside += on
        if inside == 3:
            return True
    return False


@njit(cache=True)
def _least_sine(a, b, c):  # type: ignore[no-untyped-def]
    """Sine of the smallest angle of a triangle: twice the area over the product of the two longest sides."""
    u, v, w = b - a, c - b, a - c
    x = u[1] * v[2] - u[2] * v[1]
    y = u[2] * v[0] - u[0] * v[2]
    z = u[0] * v[1] - u[1] * v[0]
    lengths = np.array([np.sqrt((u * u).sum()), np.sqrt((v * v).sum()), np.sqrt((w * w).sum())])
    product = lengths[0] * lengths[1] * lengths[2] / min(lengths[0], min(lengths[1], lengths[2]))
    return np.sqrt(x * x + y * y + z * z) / max(product, 1e-300)
