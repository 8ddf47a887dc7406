"""Edges of a frame drawn on a surface one after the other, as short curves that do not cross.

A curve is searched (Dijkstra) over the triangles of the overlay with all earlier curves, from the triangles between the
curve before and the curve after it around its first corner to those around its last corner. So the cyclic order around
every corner is the frame's, and that is all a layout needs (`frame`). The length of a step is multiplied by

    1 + (d / r)^2 + 4 max(0, -n . m);

d is the distance to the curve's guide, r the frame's mean edge, n the normal of the triangle and m of the guide. It
leads the curve around the right side of a handle. Where earlier curves shut a curve off, it crosses them at a price;
those that it crosses are taken away and drawn anew.

Axis letters: v vertex, t triangle, p edge of the frame, q point of a guide.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.layouts.frame import Frame
from geometry.simplices.overlay import Curve, Curves, Overlay, join, overlay, positions, split, spread
from geometry.simplices.surface import Surface
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 400
"""Rounds in which edges are drawn and taken away again; real models take some tens."""
CROSSING = 30.0
"""Price of crossing a curve, in mean edges of the frame."""


@dataclass(frozen=True, eq=False)
class Guides:
    """Where the edges should run, roughly.

    Attributes
    ----------
    points : (p, q, 3) points along each edge.
    normals : (p, q, 3) the surface's normals there.
    """

    points: Array
    normals: Array


def route(surface: Surface, frame: Frame, corners: Index, guides: Guides, progress: Progress = QUIET) -> Curves:
    """Curves for all edges of the frame; curve p runs from the lower corner of edge p to the higher one.

    Parameters
    ----------
    corners : (v,) vertices of the surface, no two of them the same or neighbours.

    Raises
    ------
    InputError : some edges shut one another off again and again.
    """
    length = np.linalg.norm(np.diff(guides.points, axis=1), axis=2).sum(axis=1)
    size = float(length.mean())
    waiting = np.argsort(length, kind="stable").tolist()
    drawn: dict[int, Curve] = {}
    dear = np.full(len(frame.ends), CROSSING * size)
    for _ in progress.track(range(ROUNDS), "edges"):
        made, later, removed = _round(surface, frame, corners, guides, size, drawn, waiting, dear)
        drawn |= made
        for name in removed:
            del drawn[name]
            dear[name] *= 2
        waiting = [*later, *removed]
        drawn = dict(zip(drawn, split(spread(join(drawn.values()))), strict=True))
        if not waiting:
            return join(drawn[p] for p in range(len(frame.ends)))
    raise InputError(
        f"{len(waiting)} of the {len(frame.ends)} edges of the meccano find no way on the surface; take finer voxels"
    )


def _round(
    surface: Surface, frame: Frame, corners: Index, guides: Guides, size: float, drawn: dict[int, Curve],
    waiting: list[int], dear: Array,
) -> tuple[dict[int, Curve], list[int], set[int]]:
    """New curves of edges that stay out of each other's way, edges that wait on, and drawn ones that are in the way.

    If the first edge has to cross others, these are all that comes of the round: it is searched again in the next one,
    when the way is free.

    Parameters
    ----------
    size : the frame's mean edge.
    drawn : curves of the edges drawn so far.
    waiting : the other edges, in the order in which they are tried.
    dear : (p,) price of crossing each edge.
    """
    names, curves = list(drawn), join(drawn.values())
    cut = overlay(surface, curves)
    around = _around(cut, frame, names, corners)
    # Curves of one round stay out of each other's triangles and corners, so that none is in another's way.
    taken = np.zeros(len(surface.triangles), dtype=bool)
    busy: set[int] = set()
    made: dict[int, Curve] = {}
    later: list[int] = []
    for position, p in enumerate(waiting):
        ends = frame.ends[p].tolist()
        if busy.intersection(ends):
            later.append(p)
            continue
        sides = _search(
            cut.points, cut.triangles, cut.across, cut.curve, around.sector(p, 0), around.sector(p, 1),
            guides.points[p], guides.normals[p], size, dear[names],
        )
        crossed = {names[c] for c in cut.curve.ravel()[sides].tolist() if c >= 0}
        way = np.append(cut.parent[sides // 3], cut.parent[cut.across.ravel()[sides] // 3])
        if (crossed and position > 0) or taken[way].any():
            later.append(p)
            continue
        if crossed:
            return {}, waiting, crossed
        t, i = np.divmod(sides, 3)
        edge = cut.edge[t, i]
        t, i, edge = t[edge >= 0], i[edge >= 0], edge[edge >= 0]
        low = positions(surface, curves, edge, cut.triangles[t, i])
        high = positions(surface, curves, edge, cut.triangles[t, (i + 1) % 3])
        made[p] = Curve(int(corners[ends[0]]), int(corners[ends[1]]), edge, (low + high) / 2)
        taken[way] = True
        busy.update(ends)
    return made, later, set()


@dataclass(frozen=True, eq=False)
class _Around:
    """Triangles of an overlay around the corners of a frame.

    Attributes
    ----------
    cut, frame : the overlay with the edges of the frame drawn so far.
    place : which curve of the overlay each drawn edge is.
    touching : for each corner the triangle corners at it, as 3 (triangle) + corner.
    """

    cut: Overlay
    frame: Frame
    place: dict[int, int]
    touching: list[Index]

    def sector(self, p: int, end: int) -> Index:
        """Triangles around an end of edge p between the drawn edges before and after it in the cyclic order."""
        v = int(self.frame.ends[p, end])
        t, i = np.divmod(self.touching[v], 3)
        cycle = self.frame.around[v].tolist()
        begin = cycle.index(p)
        before = next((cycle[begin - j] for j in range(1, len(cycle)) if cycle[begin - j] in self.place), None)
        if before is None:
            return t
        # The side that leaves the corner belongs to the triangle counter-clockwise of it.
        first = int(np.flatnonzero(self.cut.curve[t, i] == self.place[before])[0])
        side = 3 * int(t[first]) + int(i[first])
        result = [side // 3]
        while True:
            back = side - 1 if side % 3 else side + 2
            if self.cut.curve.ravel()[back] >= 0:
                return np.array(result, dtype=np.int64)
            side = int(self.cut.across.ravel()[back])
            result.append(side // 3)


def _around(cut: Overlay, frame: Frame, names: list[int], corners: Index) -> _Around:
    """Triangles around the corners, vertices (v,); ``names`` are the edges along the curves of the overlay."""
    order = np.argsort(cut.triangles.ravel(), kind="stable")
    first = np.searchsorted(cut.triangles.ravel()[order], corners)
    last = np.searchsorted(cut.triangles.ravel()[order], corners, "right")
    touching = [order[a:b] for a, b in zip(first, last, strict=True)]
    return _Around(cut, frame, {name: position for position, name in enumerate(names)}, touching)


@njit(cache=True)
def _search(points, triangles, across, curve, sources, targets, guide, normals, size, price):  # type: ignore[no-untyped-def]
    """Sides crossed by the cheapest way over triangles from one of the sources to one of the targets."""
    count = len(triangles)
    cost = np.full(count, np.inf)
    came = np.full(count, -1, dtype=np.int64)
    factor = np.full(count, -1.0)
    centre = np.empty((count, 3))
    goal = np.zeros(count, dtype=np.bool_)
    for t in targets:
        goal[t] = True
    queue = [(0.0, np.int64(0))]
    queue.pop()
    for t in sources:
        cost[t] = 0.0
        heapq.heappush(queue, (0.0, np.int64(t)))
    last = np.int64(-1)
    while len(queue) > 0:
        value, t = heapq.heappop(queue)
        if value > cost[t]:
            continue
        if goal[t]:
            last = t
            break
        if factor[t] < 0.0:
            _weigh(points, triangles[t], guide, normals, size, factor, centre, t)
        for i in range(3):
            other = across[t, i] // 3
            if factor[other] < 0.0:
                _weigh(points, triangles[other], guide, normals, size, factor, centre, other)
            step = np.sqrt(((centre[t] - centre[other]) ** 2).sum()) * 0.5 * (factor[t] + factor[other])
            if curve[t, i] >= 0:
                step += price[curve[t, i]]
            if value + step < cost[other]:
                cost[other] = value + step
                came[other] = 3 * t + i
                heapq.heappush(queue, (cost[other], np.int64(other)))
    if last < 0:
        raise ValueError("the surface is not connected")
    number = 0
    t = last
    while came[t] >= 0:
        number += 1
        t = came[t] // 3
    result = np.empty(number, dtype=np.int64)
    t = last
    while came[t] >= 0:
        number -= 1
        result[number] = came[t]
        t = came[t] // 3
    return result


@njit(cache=True)
def _weigh(points, corners, guide, normals, size, factor, centre, t):  # type: ignore[no-untyped-def]
    """Centre of triangle t and the factor by which steps in it are longer (see the module), into the tables."""
    a, b, c = points[corners[0]], points[corners[1]], points[corners[2]]
    middle = (a + b + c) / 3.0
    u, v = b - a, c - a
    x = u[1] * v[2] - u[2] * v[1]
    y = u[2] * v[0] - u[0] * v[2]
    z = u[0] * v[1] - u[1] * v[0]
    best, where = np.inf, 0
    for q in range(len(guide)):
        d = ((guide[q] - middle) ** 2).sum()
        if d < best:
            best, where = d, q
    length = np.sqrt(x * x + y * y + z * z)
    turn = 0.0
    if length > 0.0:
        turn = (x * normals[where, 0] + y * normals[where, 1] + z * normals[where, 2]) / length
    centre[t] = middle
    factor[t] = 1.0 + best / size**2 + 4.0 * max(0.0, -turn)
