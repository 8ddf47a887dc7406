r"""Legs of a band: the sides along parameter lines with which triangles and rectangles leave a trimming curve.

Every monotone segment has a leg at its start and one at its end. Where the legs of two consecutive segments are one
(a sector of no right angle, `band`) they must be equally long: the longer one is cut. At a corner of two parameter
lines both segments are cut so that one rectangle has a side on each.

Axis letters: s segment, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.triangle import right_corner
from geometry.hybrid.trimming import FLAT, Trimming, solve_monotone
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LIKE = 1e-9
"""Relative difference of two lengths below which they are made equal by moving an end, because a cut there would leave
a segment as short as that."""


@dataclass(frozen=True, eq=False)
class Legs:
    """Leg of each segment at its start and end: directions (s, 2, 2), lengths (s, 2); ``flat`` (s,) has no triangle."""

    way: Array
    length: Array
    flat: NDArray[np.bool_]
    q0: Array


def legs_of(trimming: Trimming, lines: tuple[Array, ...], depth: float, shrink: Array, where: str) -> Legs:
    """Legs of all segments, those that follow a parameter line a share of the knot interval deep.

    Parameters
    ----------
    lines : knot lines of both directions.
    depth : wanted depth, as a share of the knot interval; ``shrink`` (s,) times that for each segment.

    Raises
    ------
    InputError : a segment has no length.
    """
    start, end = trimming.plane[:, 0], trimming.plane[:, 3]
    step = end - start
    reach = np.array([FLAT * (x[-1] - x[0]) for x in lines])
    small = np.ptp(trimming.plane, axis=1) <= 100 * reach
    flat = small.any(axis=1)
    if small.all(axis=1).any():
        u, v = start[small.all(axis=1).argmax()]
        raise InputError(f"{where}: a trimming curve has a segment without length at (u, v) = ({u:.6g}, {v:.6g})")
    sign = np.sign(step)
    q0 = right_corner(start, end)
    way = np.stack([q0 - start, q0 - end], axis=1)
    length = np.abs(way).sum(axis=2)
    way = np.sign(np.where(np.abs(way) > 10 * reach, way, 0.0))
    for s in np.flatnonzero(flat):
        d = int(np.argmax(np.abs(step[s])))
        normal = np.zeros(2)
        normal[1 - d] = sign[s, d] if d == 0 else -sign[s, d]
        way[s] = normal
        length[s] = shrink[s] * reach_of(0.5 * (start[s] + end[s]), normal, lines, depth)
    return Legs(way, length, flat, q0)


def reach_of(p: Array, way: Array, lines: tuple[Array, ...], depth: float) -> float:
    """``depth`` of the knot interval, or all there is to the next knot line, from p along a parameter direction."""
    d = int(np.argmax(np.abs(way)))
    x, forward = lines[d], way[d] > 0
    tiny = 10 * FLAT * (x[-1] - x[0])
    ahead = x[x > p[d] + tiny] if forward else x[x < p[d] - tiny]
    if len(ahead) == 0:
        return 0.0
    border = ahead[0] if forward else ahead[-1]
    i = np.searchsorted(x, 0.5 * (p[d] + border)) - 1
    return float(min(abs(border - p[d]), depth * (x[i + 1] - x[i])))


def _quarter(a: Array, b: Array) -> int:
    """Right angles from direction a counter-clockwise to b."""
    return round(float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)) / (0.5 * np.pi)) % 4


def tangent(control: Array, at_end: bool) -> Array:
    """Unit tangent of a segment away from its start, or from its end."""
    points = control[::-1] if at_end else control
    for k in (1, 2, 3):
        step = points[k] - points[0]
        if np.abs(step).max() > 1e-12 * (np.abs(control).max() + 1e-300):
            return np.asarray(step / np.linalg.norm(step))
    return np.array([1.0, 0.0])


def right_angles(first: Array, second: Array, out: Array, back: Array) -> int | None:
    """Right angles on the inside of a vertex between the legs of the segments before and after it.

    Parameters
    ----------
    first, second : directions of the leg of the segment that leaves, and of the one that arrives.
    out, back : tangents of these segments away from the vertex.

    Returns
    -------
    0 to 3, -1 where the legs have passed each other by a right angle, None where no parameter line lies between.
    """
    inside = np.arctan2(out[0] * back[1] - out[1] * back[0], out @ back) % (2 * np.pi)
    if inside < 1e-6:
        inside = 2 * np.pi

    def turn(a: Array, b: Array) -> float:
        return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))

    k = round((inside - max(turn(out, first), 0.0) - max(turn(second, back), 0.0)) / (0.5 * np.pi))
    if k == -1 or (0 <= k <= 3 and k % 4 == _quarter(first, second)):
        return k
    return None


def sector(trimming: Trimming, legs: Legs, s: int, where: str) -> int:
    """Right angles between the legs at the vertex where segment s ends, on the inside; -1 at a corner of two lines.

    Raises
    ------
    InputError : the corner is so sharp that no parameter line enters it.
    """
    t = int(trimming.next[s])
    k = right_angles(
        legs.way[t, 0], legs.way[s, 1], tangent(trimming.plane[t], False), tangent(trimming.plane[s], True)
    )
    if k is None or (k == -1 and not (legs.flat[s] and legs.flat[t])):
        p = trimming.plane[t, 0]
        raise InputError(
            f"{where}: the corner at (u, v) = ({p[0]:.6g}, {p[1]:.6g}) is so sharp that no parameter line enters it"
        )
    return k


def matched(trimming: Trimming, legs: Legs, where: str) -> tuple[Trimming, Legs, Index, Array]:
    """Segments and legs once legs that neighbours share are as long as the shorter one where that needs no cut, and
    segments to cut because their leg is still the longer one, and where.
    """
    trimming = replace(trimming, plane=trimming.plane.copy())
    legs = replace(legs, length=legs.length.copy(), q0=legs.q0.copy())
    cuts: dict[int, float] = {}
    for s, t in enumerate(trimming.next.tolist()):
        k = sector(trimming, legs, s, where)
        if k < 0:
            _square(trimming, legs, s, t, cuts)
        if k != 0:
            continue
        mine, other = legs.length[s, 1], legs.length[t, 0]
        if abs(mine - other) <= 1e-14 * max(mine, other):
            continue
        longer, place = (s, 1) if mine > other else (t, 0)
        if abs(mine - other) <= LIKE * max(mine, other) and not legs.flat[longer]:
            _snap(trimming, legs, longer, place, min(mine, other))
            continue
        if longer in cuts:
            continue
        if legs.flat[longer]:
            legs.length[longer] = min(mine, other)
            continue
        way = legs.way[longer, place]
        d = int(np.argmax(np.abs(way)))
        end = trimming.plane[longer, 3 if place else 0]
        target = end[d] + way[d] * min(mine, other)
        cuts[longer] = solve_monotone(trimming.plane[longer, :, d], float(target))
    which = np.array(sorted(cuts), dtype=np.int64)
    return trimming, legs, which, np.array([cuts[s] for s in which.tolist()])


def _snap(trimming: Trimming, legs: Legs, s: int, place: int, length: float) -> None:
    """Move the far end of segment s in place so that its leg has the length of its neighbour's exactly."""
    way = legs.way[s, place]
    d = int(np.argmax(np.abs(way)))
    target = trimming.plane[s, 3 if place else 0, d] + way[d] * length
    if place:
        trimming.plane[s, 0, d] = target
        trimming.plane[trimming.next == s, 3, d] = target
    else:
        trimming.plane[s, 3, d] = target
        trimming.plane[trimming.next[s], 0, d] = target
    legs.q0[s, d] = target
    legs.length[s, place] = length


def _square(trimming: Trimming, legs: Legs, s: int, t: int, cuts: dict[int, float]) -> None:
    """Make the last piece of s as long as the rectangle of t is deep, and the first of t as that of s, at a corner of
    two parameter lines: rectangles are made shallower in place, pieces that are too long get a place in ``cuts``.
    """
    for piece, other, at_end in ((s, t, True), (t, s, False)):
        wanted = legs.length[other, 0]
        have = float(np.abs(trimming.plane[piece, 3] - trimming.plane[piece, 0]).max())
        if have < wanted * (1.0 - LIKE):
            legs.length[other] = have
        elif have > wanted * (1.0 + LIKE) and piece not in cuts:
            d = int(np.argmax(np.abs(trimming.plane[piece, 3] - trimming.plane[piece, 0])))
            end = trimming.plane[piece, 3 if at_end else 0, d]
            way = np.sign(trimming.plane[piece, 0 if at_end else 3, d] - end)
            cuts[piece] = solve_monotone(trimming.plane[piece, :, d], float(end + way * wanted))
