"""The frame of a meccano drawn on a surface: corners and edges, and the patches between them.

The first drawing comes from `routing`. It is then evened out: the patches around a corner form a disk; laid on the unit
circle, with the neighbours of the corner at equal angles, the corner moves to the vertex nearest to the centre, and
its edges become straight there. The disk's map is one to one (mean value coordinates on a convex polygon), so every
drawing on the way is as valid as the first. Creases near the centre attract the corner (`creases`).

Axis letters: v corner, p edge, f side, t triangle, c crossing, b vertex of a border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.layouts.blocks import Blocks
from geometry.layouts.creases import Attraction, attracted
from geometry.layouts.frame import Frame
from geometry.layouts.layout import Layout
from geometry.simplices.mean_value import mean_value, signed_areas
from geometry.simplices.overlay import Curve, Curves, Overlay, across_sides, join, overlay, positions, split, spread
from geometry.simplices.paths import chord_shares
from geometry.simplices.surface import Surface
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

REWEIGHTING = 1
"""Rounds of widening what is small in the disk, so that patches are even."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """A frame drawn on a surface.

    Attributes
    ----------
    frame, surface : what is drawn on what.
    corners : (v,) vertices of the surface.
    curves : one for each edge of the frame, from its lower to its higher corner.
    """

    frame: Frame
    surface: Surface
    corners: Index
    curves: Curves


def relax(
    drawing: Drawing, sweeps: int, progress: Progress = QUIET, creases: Attraction | None = None
) -> Drawing:
    """Move every corner to the middle of the patches around it, or to a crease near it, ``sweeps`` times."""
    batches = _batches(drawing.frame)
    for _ in progress.track(range(sweeps), "patches"):
        for batch in batches:
            drawing = _centre(drawing, batch, creases)
    return drawing


def layout_of(drawing: Drawing, blocks: Blocks) -> Layout:
    """The surface cut along the edges and divided into one patch for each side of the frame.

    Raises
    ------
    InputError : the regions between the edges are not one disk for each side.
    """
    frame, curves = drawing.frame, drawing.curves
    cut = overlay(drawing.surface, curves)
    # The side of the frame on the left of each edge and on its right.
    beside = np.empty((len(frame.ends), 2), dtype=np.int64)
    rows = np.repeat(np.arange(len(frame.sides)), 4).reshape(-1, 4)
    beside[frame.side_edges[frame.side_forward], 0] = rows[frame.side_forward]
    beside[frame.side_edges[~frame.side_forward], 1] = rows[~frame.side_forward]

    t, i = np.nonzero(cut.curve >= 0)
    p = cut.curve[t, i]
    tail, head = cut.triangles[t, i], cut.triangles[t, (i + 1) % 3]
    forward = (tail == drawing.corners[frame.ends[p, 0]]) | (head == drawing.corners[frame.ends[p, 1]])
    inner = np.minimum(tail, head) >= len(drawing.surface.points)
    forward = np.where(inner, tail < head, forward)
    known = np.where(forward, beside[p, 0], beside[p, 1])

    region = _regions(cut)
    count = int(region.max()) + 1
    pairs = np.unique(np.stack((region[t], known), axis=1), axis=0)
    if count != len(frame.sides) or len(pairs) != count or len(np.unique(pairs[:, 1])) != count:
        raise InputError(
            f"the {len(frame.ends)} edges of the meccano cut the surface in {count} regions, not in one for each of "
            f"the {len(frame.sides)} sides: the meccano's topology differs from the solid's"
        )
    side = np.empty(count, dtype=np.int64)
    side[pairs[:, 0]] = pairs[:, 1]
    corner = np.full(len(blocks.places), -1, dtype=np.int64)
    corner[frame.names] = drawing.corners
    return Layout(blocks, Surface(cut.points, cut.triangles), side[region], corner)


def _regions(cut: Overlay) -> Index:
    """Number (t,) of the region between curves that holds each triangle."""
    t, i = np.nonzero(cut.curve < 0)
    links = coo_array((np.ones(len(t), dtype=np.int8), (t, cut.across[t, i] // 3)), shape=(len(cut.curve),) * 2)
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _batches(frame: Frame) -> list[Index]:
    """Corners in groups without two corners of one side."""
    colour = np.full(len(frame.places), -1)
    order = np.argsort(frame.sides.ravel(), kind="stable")
    bounds = np.searchsorted(frame.sides.ravel()[order], np.arange(len(frame.places) + 1))
    for v in range(len(colour)):
        near = colour[frame.sides[order[bounds[v] : bounds[v + 1]] // 4]]
        colour[v] = np.setdiff1d(np.arange(near.size + 1), near)[0]
    return [np.flatnonzero(colour == c) for c in range(int(colour.max()) + 1)]


def _centre(drawing: Drawing, batch: Index, creases: Attraction | None) -> Drawing:
    """Move the corners of one batch."""
    frame, curves = drawing.frame, drawing.curves
    moving = np.asarray(np.isin(frame.ends, batch).any(axis=1))
    kept = join(curve for p, curve in enumerate(split(curves)) if not moving[p])
    cut = overlay(drawing.surface, kept)
    region = _regions(cut)
    # Each corner is a vertex inside its disk.
    home = np.full(len(drawing.surface.points), -1, dtype=np.int64)
    home[cut.triangles[cut.triangles < len(home)]] = np.nonzero(cut.triangles < len(home))[0]
    order = np.argsort(region, kind="stable")
    bounds = np.searchsorted(region[order], np.arange(int(region.max()) + 2))
    corners = drawing.corners.copy()
    merged = split(curves)
    for v in batch:
        r = region[home[corners[v]]]
        made = _star(drawing, kept, cut, order[bounds[r] : bounds[r + 1]], int(v), creases)
        if made is not None:
            corners[v] = made[0]
            for p, curve in made[1].items():
                merged[p] = curve
    return Drawing(frame, drawing.surface, corners, spread(join(merged)))


def _star(
    drawing: Drawing, kept: Curves, cut: Overlay, mine: Index, v: int, creases: Attraction | None
) -> tuple[int, dict[int, Curve]] | None:
    """New vertex of corner v and new curves of its edges, in the disk of triangles ``mine``; None to leave it."""
    frame, surface = drawing.frame, drawing.surface
    cycle = frame.around[v]
    others = frame.ends[cycle].sum(axis=1) - v
    used, local = np.unique(cut.triangles[mine], return_inverse=True)
    local = local.reshape(-1, 3)
    border = cut.curve[mine] >= 0
    tails, heads = local[border], np.roll(local, -1, axis=1)[border]
    if len(np.unique(tails)) != len(tails):
        return None
    after = np.full(len(used), -1, dtype=np.int64)
    after[tails] = heads
    start = int(np.searchsorted(used, drawing.corners[others[0]]))
    loop = _chain(after, start, len(tails))
    posts = np.flatnonzero(used[loop] < len(surface.points))
    if len(posts) != 2 * len(cycle) or (used[loop[posts[::2]]] != drawing.corners[others]).any():
        return None
    angles = np.empty(len(loop))
    points = cut.points[used]
    for j, (a, b) in enumerate(zip(posts, [*posts[1:], len(loop)], strict=True)):
        share = chord_shares(points[np.append(loop, loop[0])[a : b + 1]])
        angles[a:b] = np.pi / len(cycle) * (j + share[:-1])
    places = mean_value(points, local, loop, np.stack((np.cos(angles), np.sin(angles)), axis=1), REWEIGHTING)
    if (signed_areas(places[local]) <= 0).any():
        return None

    # The corner may not be a neighbour of another corner on the surface, nor lie on the border.
    fits = used < len(surface.points)
    fits[loop] = False
    touching = surface.edges[np.isin(surface.edges, used[loop[posts]]).any(axis=1)]
    fits &= ~np.isin(used, touching)
    if not fits.any():
        return None
    inside = np.flatnonzero(fits)
    centre = int(inside[np.argmin(attracted(creases, v, used[inside], places[inside]))])
    across = across_sides(local)
    vertex = int(used[centre])
    new = {}
    for p, other in zip(cycle.tolist(), others.tolist(), strict=True):
        goal = int(np.searchsorted(used, drawing.corners[other]))
        steps, shares = _walk(places, local, across, centre, goal)
        if len(steps) == 0:
            return None
        t, i = np.divmod(steps, 3)
        edge = cut.edge[mine[t], i]
        t, i, shares, edge = t[edge >= 0], i[edge >= 0], shares[edge >= 0], edge[edge >= 0]
        here, there = cut.triangles[mine[t], i], cut.triangles[mine[t], (i + 1) % 3]
        low = positions(surface, kept, edge, here)
        at = low + shares * (positions(surface, kept, edge, there) - low)
        if frame.ends[p, 0] == v:
            new[p] = Curve(vertex, int(drawing.corners[other]), edge, at)
        else:
            new[p] = Curve(int(drawing.corners[other]), vertex, edge[::-1].copy(), at[::-1].copy())
    return vertex, new


@njit(cache=True)
def _chain(after, start, count):  # type: ignore[no-untyped-def]
    """So many vertices, each the one after the last, from ``start`` on."""
    result = np.empty(count, dtype=np.int64)
    node = start
    for b in range(count):
        result[b] = node
        node = after[node]
    return result


@njit(cache=True)
def _walk(places, triangles, across, start, goal):  # type: ignore[no-untyped-def]
    """Sides (3 triangle + side) crossed by the segment from one vertex to another, and where; nothing if it fails."""
    steps = np.empty(len(triangles), dtype=np.int64)
    shares = np.empty(len(triangles))
    d = places[goal] - places[start]
    origin = places[start]
    side = -1
    for t in range(len(triangles)):
        for i in range(3):
            if triangles[t, i] == start:
                a, b = triangles[t, (i + 1) % 3], triangles[t, (i + 2) % 3]
                u, w = places[a] - origin, places[b] - origin
                if d[0] * u[1] - d[1] * u[0] < 0.0 <= d[0] * w[1] - d[1] * w[0]:
                    side = 3 * t + (i + 1) % 3
    for count in range(len(triangles)):
        if side < 0:
            return steps[:0], shares[:0]
        t, i = side // 3, side % 3
        u, w = places[triangles[t, i]] - origin, places[triangles[t, (i + 1) % 3]] - origin
        right, left = d[0] * u[1] - d[1] * u[0], d[0] * w[1] - d[1] * w[0]
        steps[count] = side
        shares[count] = right / (right - left)
        other = across[t, i]
        if other < 0:
            return steps[:0], shares[:0]
        t, i = other // 3, other % 3
        apex = triangles[t, (i + 2) % 3]
        if apex == goal:
            return steps[: count + 1], shares[: count + 1]
        x = places[apex] - origin
        if d[0] * x[1] - d[1] * x[0] >= 0.0:
            # The apex is on the left: the segment leaves between the right corner, now i + 1, and the apex.
            side = 3 * t + (i + 1) % 3
        else:
            side = 3 * t + (i + 2) % 3
    return steps[:0], shares[:0]
