r"""The band along the trimming curves of a face: curvilinear triangles and rectangles that touch the curve.

Every monotone segment has a triangle on its inside, with legs along the parameter lines; a segment that follows a
parameter line has a rectangle of the wanted depth. Around each vertex p of the curve the legs of its two segments span
a multiple of a right angle on the inside, and that sector is filled so that every edge leaving p is a full common edge
of two elements (the rule that makes the functions continuous, NOTES 3.1):

     0   both segments share the leg: the longer one is cut, so that they share all of it
   -90   a corner of two parameter lines: both are cut so that one rectangle has a side on each
    90   one rectangle, the product of the two legs
   180   two rectangles with a common edge of the wanted depth between them
   270   three rectangles

Segments are cut until no two elements of the band overlap, none leaves its knot interval, and phi of every triangle is
certified. What remains of the knot intervals is cut into rectangles (`partition`).

Axis letters: s segment, t triangle, r rectangle, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.curves import bezier_points
from geometry.hybrid.legs import Legs, legs_of, matched, reach_of, sector
from geometry.hybrid.triangle import certified, make_phi, triangle_map
from geometry.hybrid.trimming import Trimming, split_segments, xi_at
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 400
"""A round cuts each segment once at most, and a cut may make a neighbour's leg the longer one, along whole loops."""
MOST = 20_000
"""Segments above which curves are taken to meet: halving never separates those."""
@dataclass(frozen=True, eq=False)
class Band:
    """Band of one face.

    Attributes
    ----------
    trimming : its segments, cut as the band needs them.
    segment : (t,) the segment of each triangle; triangles of segments that follow a parameter line do not exist.
    q0 : (t, 2) right-angle corners.
    forward : (t,) the segment runs from pa to pb (pa lies along xi from q0).
    low, high : (r, 2) corners of the rectangles.
    touching : (r, 4) segments whose start lies at corner (low, low), (low, high), (high, low), (high, high), or -1.
    along : (r, 4) segment that is the side xi = low, xi = high, eta = low, eta = high, or -1.
    """

    trimming: Trimming
    segment: Index
    q0: Array
    forward: NDArray[np.bool_]
    low: Array
    high: Array
    touching: Index
    along: Index


def make_band(trimming: Trimming, knots: tuple[Array, Array], depth: float = 0.25, where: str = "face") -> Band:
    """Band of a face along its trimming curves.

    Parameters
    ----------
    trimming : segments cut at knots (`trimming.cut_at_knots`).
    knots : knot vectors of the surface.
    depth : wanted depth of rectangles where the curve does not give one, as a share of the knot interval.

    Raises
    ------
    InputError : a corner of the face is so sharp that no parameter line enters it, or curves meet.
    """
    lines = tuple(np.unique(k) for k in knots)
    shrink = np.ones(0)
    for _ in range(ROUNDS):
        shrink = np.concatenate([shrink, np.ones(len(trimming.next) - len(shrink))])
        trimming, legs, which, at = matched(trimming, legs_of(trimming, lines, depth, shrink, where), where)
        if len(which):
            trimming, shrink = _cut(trimming, which, at, shrink)
            continue
        band = _fill(trimming, legs, lines, depth, shrink, where)
        phi = make_phi(band.q0, oriented(band))
        bad = band.segment[~certified(phi)]
        if len(bad) == 0:
            bad, flat = _overlapping(band, phi, legs)
            shrink[flat] *= 0.5
            if len(bad) == 0 and len(flat) == 0:
                return band
        bad = np.unique(bad)
        trimming, shrink = _cut(trimming, bad, np.full(len(bad), 0.5), shrink)
        if len(trimming.next) > MOST:
            break
    raise InputError(f"{where}: its trimming curves meet, or are so close that no band fits between them")


def _cut(trimming: Trimming, which: Index, at: Array, shrink: Array) -> tuple[Trimming, Array]:
    return split_segments(trimming, which, at), np.concatenate([shrink, shrink[which]])


def oriented(band: Band) -> Array:
    """Control points (t, 4, 2) of the segments from pa to pb."""
    curve = band.trimming.plane[band.segment]
    return np.where(band.forward[:, None, None], curve, curve[:, ::-1])


def _fill(
    trimming: Trimming, legs: Legs, lines: tuple[Array, ...], depth: float, shrink: Array, where: str
) -> Band:
    """Triangles, rectangles along flat segments, and rectangles around the vertices."""
    curved = np.flatnonzero(~legs.flat)
    along_xi = np.abs(legs.way[curved, 0, 0]) > 0  # the leg at the segment's start runs along xi: it starts at pa
    rectangles: list[tuple[Array, Array, Index, Index]] = []

    def add(p: Array, x: Array, y: Array, starts: list[int], sides: tuple[int, ...] = ()) -> None:
        corners = np.array([p, p + x, p + y, p + x + y])
        low, high = corners.min(axis=0), corners.max(axis=0)
        touch, along = np.full(4, -1), np.full(4, -1)
        for t in starts:
            at = trimming.plane[t, 0]
            touch[2 * int(at[0] > 0.5 * (low[0] + high[0])) + int(at[1] > 0.5 * (low[1] + high[1]))] = t
        for side in sides:
            middle = 0.5 * (trimming.plane[side, 0] + trimming.plane[side, 3])
            d = int(np.argmin(np.abs(trimming.plane[side, 3] - trimming.plane[side, 0])))
            along[2 * d + int(middle[d] > 0.5 * (low[d] + high[d]))] = side
        rectangles.append((low, high, touch, along))

    squares = {s: int(trimming.next[s]) for s in np.flatnonzero(legs.flat).tolist()
               if sector(trimming, legs, s, where) < 0}
    for s in np.flatnonzero(legs.flat).tolist():
        if s in squares.values():
            continue
        start, end = trimming.plane[s, 0], trimming.plane[s, 3]
        t = int(trimming.next[s])
        if s in squares:
            add(start, end - start, trimming.plane[t, 3] - trimming.plane[t, 0], [s, t, int(trimming.next[t])], (s, t))
        else:
            add(start, end - start, legs.way[s, 0] * legs.length[s, 0], [s, t], (s,))
    for s, t in enumerate(trimming.next.tolist()):
        k = sector(trimming, legs, s, where)
        if k <= 0:
            continue
        p = trimming.plane[t, 0]
        spokes = [legs.way[t, 0] * legs.length[t, 0]]
        way = legs.way[t, 0]
        for _ in range(k - 1):
            way = np.array([-way[1], way[0]])
            # No deeper than the legs are long: a narrow band, and no slivers.
            deep = min(reach_of(p, way, lines, depth), max(legs.length[s, 1], legs.length[t, 0]))
            spokes.append(way * deep * min(shrink[s], shrink[t]))
        spokes.append(legs.way[s, 1] * legs.length[s, 1])
        for a, b in pairwise(spokes):
            add(p, a, b, [t])
    low, high, touch, along = (np.array([r[i] for r in rectangles]) for i in range(4))
    return Band(
        trimming, curved, legs.q0[curved], along_xi, low.reshape(-1, 2), high.reshape(-1, 2),
        touch.reshape(-1, 4).astype(np.int64), along.reshape(-1, 4).astype(np.int64),
    )  # fmt: skip


_PROBES = np.array([(i / 8, j / 8) for i in range(9) for j in range(9 - i)])
_PROBES = (1.0 - 3e-4) * _PROBES + 1e-4
"""Points of a triangle, off its sides by 1e-4 of it so that common corners and sides do not count."""


def _overlapping(band: Band, phi: Array, legs: Legs) -> tuple[Index, Index]:
    """Segments to cut and flat segments to make shallower, because elements of the band overlap."""
    n = len(band.segment)
    inside = triangle_map(phi, _PROBES)
    boxes = np.concatenate([
        np.stack([phi.min(axis=1), phi.max(axis=1)], axis=1), np.stack([band.low, band.high], axis=1)
    ])
    tiny = 1e-9 * np.ptp(boxes.reshape(-1, 2), axis=0)
    owners: list[list[int]] = [[int(s)] for s in band.segment]
    for touch, along in zip(band.touching, band.along):
        starts = [int(t) for t in touch if t >= 0]
        owners.append([int(a) for a in along if a >= 0] or [
            *starts, *(int(s) for t in starts for s in np.flatnonzero(band.trimming.next == t))
        ])
    order = np.argsort(boxes[:, 0, 0])
    bad: set[int] = set()
    for i, a in enumerate(order.tolist()):
        for b in order[i + 1 :].tolist():
            if boxes[b, 0, 0] >= boxes[a, 1, 0] - tiny[0]:
                break
            if boxes[b, 0, 1] >= boxes[a, 1, 1] - tiny[1] or boxes[a, 0, 1] >= boxes[b, 1, 1] - tiny[1]:
                continue
            if _meet(band, boxes, n, a, b, inside):
                sizes = [float(np.ptp(boxes[e], axis=0).max()) for e in (a, b)]
                for e in (a, b):
                    if sizes[0 if e == a else 1] >= 0.5 * max(sizes):
                        bad |= set(owners[e])
    bad |= _behind(band, boxes[:n])
    found = np.array(sorted(bad), dtype=np.int64)
    return found[~legs.flat[found]] if len(found) else found, found[legs.flat[found]] if len(found) else found


def _meet(band: Band, boxes: Array, n: int, a: int, b: int, inside: Array) -> bool:
    """Whether two elements whose boxes overlap do so themselves; exact but for two triangles, which are probed."""
    if a >= n and b >= n:
        return True
    if a < n and b < n:
        return _holds(band, boxes, a, inside[b]) or _holds(band, boxes, b, inside[a])
    triangle = a if a < n else b
    # A triangle holds with any point the box from there to q0: its point nearest to q0 decides for a rectangle.
    low, high = np.maximum(boxes[a, 0], boxes[b, 0]), np.minimum(boxes[a, 1], boxes[b, 1])
    nearest = np.clip(band.q0[triangle], low, high)
    nearest = nearest + 1e-6 * (0.5 * (low + high) - nearest)
    return _holds(band, boxes, triangle, nearest[None])


def _behind(band: Band, boxes: Array) -> set[int]:
    """Segments of triangles whose box holds a part of another curve: what lies behind must not be met."""
    curves = bezier_points(band.trimming.plane, np.linspace(0.0, 1.0, 9))
    bad: set[int] = set()
    for segment, (low, high) in zip(band.segment.tolist(), boxes):
        tiny = 1e-7 * (high - low)
        hit = ((curves > low + tiny) & (curves < high - tiny)).all(axis=2).any(axis=1)
        hit[[segment, band.trimming.next[segment]]] = False
        hit[band.trimming.next == segment] = False
        if hit.any():
            bad.add(segment)
    return bad


def _holds(band: Band, boxes: Array, element: int, points: Array) -> bool:
    """Whether a triangle holds one of the points inside."""
    low, high = boxes[element]
    tiny = 1e-9 * (high - low)
    within = ((points > low + tiny) & (points < high - tiny)).all(axis=1)
    if not within.any():
        return False
    segment, q0 = int(band.segment[element]), band.q0[element]
    p = points[within]
    xi = xi_at(band.trimming.plane, np.full(len(p), segment), np.ascontiguousarray(p[:, 1]))
    return bool(((p[:, 0] - q0[0]) * (xi - p[:, 0]) > 1e-9 * (high[0] - low[0]) ** 2).any())
