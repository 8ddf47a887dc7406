r"""Poles: where a border of a face's parameter rectangle is one point in space (spheres, apexes of cones).

A knot interval at a pole has a side without length, and det J = 0 there whatever stands on it, so it cannot be a
quadrilateral. It becomes a triangle with its vertex at the pole. With the interval's Bezier net b_st, t = 0 at the pole
(so b_s0 = b) and t = 3 at the row of intervals that follows, the triangle has the control points

    row 0   b                              row 2   b_02, m, b_32
    row 1   b_01, b_31                     row 3   b_03, b_13, b_23, b_33

Its sides are those of the interval: meridians, and the parallel that it shares with the next quadrilateral, are the
surface itself. At the pole its two tangents are those of the meridians, so det J > 0 there. No triangle of degree three
is the surface: in polar coordinates about the pole the interval's rows 1 and 2 would have to be of degree one and two.
So m alone is free, and is fitted to the surface:

    m = sum_st a_st b_st,     a nearest to (b_12 + b_22) 3/4 - (b_02 + b_32) 1/4 (row 2 brought to degree two),

with sum a = 1, a_s0 = 0 and m the fitted point. Everything is a combination of the face's B-splines; those of the
collapsed row vanish outside the pole, whose vertex has one function, shared by all faces there.

Near the pole intervals are as narrow as meridians are close. Rows between parallels grow with the distance from the
pole (`rows`), so that ratios of sides stay alike down to an apex, where no smooth triangle fits: the error there is a
share of its size, not a power.

Axis letters: e element, s along the parallel, t from the pole, n B-spline, b Bernstein function, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep
from geometry.hybrid.triangle import CUBIC, INNER

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STRETCH = 4.0
"""Height of a row of cells over the distance of the meridians there, beyond the first row."""
AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Corners of a cell, counter-clockwise."""
GROWTH = 0.7
"""Most height of such a row over its distance from the pole."""
WHOLE = 0.7
"""Share of the first knot interval from which on it is the first row."""
TINY = 1e-9
"""Share of the parameter range within which a degenerate edge lies on a border of it."""
REVERSED = np.array([
    int(np.flatnonzero((CUBIC.exponents == own[::-1]).all(axis=1))[0]) for own in CUBIC.exponents
])
"""Bernstein functions of a triangle whose corners are taken in reverse."""


@dataclass(frozen=True)
class Pole:
    """A pole of a face: the direction d that is constant on its line, whether the line is at the upper end, and its
    vertex of the solid.
    """

    direction: int
    upper: bool
    vertex: int

    @property
    def side(self) -> int:
        """Side of a cell, from corner to corner in `AROUND`, that the pole takes."""
        return (3, 1)[self.upper] if self.direction == 0 else (0, 2)[self.upper]

    def onwards(self, cells: NDArray[Any]) -> NDArray[Any]:
        """View of an array (m, n) over a grid's cells, or its vertices, by rows from the pole onwards."""
        return np.moveaxis(cells, self.direction, 0)[:: -1 if self.upper else 1]


@dataclass(frozen=True, eq=False)
class PolarCells:
    """Cells at the poles of a face: low and high corners (k, 2) in the parameter plane, the side (k,) at the pole, and
    vertices (k, 3) of the triangles: pole, ahead, after.
    """

    low: Array
    high: Array
    side: Index
    corners: Index


def corners_of(cells: PolarCells) -> Array:
    """Corners (k, 4, 2) in the parameter plane, those at the pole first: behind ``after``, then before ``ahead``."""
    box = np.stack([cells.low, cells.high], axis=1)
    around = np.array(AROUND)[(cells.side[:, None] + np.arange(4)) % 4]
    return np.take_along_axis(box, around, axis=1)


def poles_of(brep: Brep, number: int) -> list[Pole]:
    """Poles of a face that are borders of its parameter rectangle, each once."""
    face = brep.faces[number]
    found: list[Pole] = []
    for loop in face.loops:
        for c in loop:
            if not brep.edges[c.edge].degenerate:
                continue
            spread = np.ptp(c.curve.control, axis=0)
            d = int(spread.argmin())
            knots = face.surface.knots[d]
            at = float(c.curve.control[:, d].mean())
            for upper in (False, True):
                pole = Pole(d, upper, brep.edges[c.edge].vertices[0])
                border = knots[-1] if upper else knots[0]
                if abs(at - border) <= TINY * np.ptp(knots) and spread[d] <= TINY * np.ptp(knots) < spread[1 - d]:
                    found += [] if pole in found else [pole]
    return found


def rows(
    kept: list[float], poles: list[Pole], speed: Array, width: Array, places: Array, first: float, most: float
) -> Array:
    """Parallels between given ones, closer near poles, where meridians are.

    Parameters
    ----------
    kept : values that must be, ascending, the ends among them.
    speed, width : (k,) lengths in space of a unit step along meridians, and between meridians, at ``places`` (k,).
    first : largest height of the row at a pole, in space.
    most : largest height of a row.
    """
    t = np.linspace(kept[0], kept[-1], 241)
    lines, tips = list(kept), []
    for pole in poles:
        p, after = kept[:: -1 if pole.upper else 1][:2]
        share = first / (abs(after - p) * float(np.interp(p, places, speed)))
        tip = p + share * (after - p) if share < WHOLE else after
        tips.append(sorted((p, tip)))
        lines += [] if tip == after else [tip]
        # Heights change as fast as the distance from the pole.
        t = np.append(t, p + (kept[0 if pole.upper else -1] - p) * np.geomspace(1e-6, 1.0, 241))
    t = np.unique(np.clip(np.append(t, lines), kept[0], kept[-1]))
    speeds = np.interp(t, places, speed)
    away = np.min([np.abs(t - kept[-1 if pole.upper else 0]) for pole in poles], axis=0) * speeds
    height = np.minimum(STRETCH * np.interp(t, places, width), GROWTH * away)
    rate = speeds / np.minimum(height + 1e-9 * most, most)
    measure = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    made = [np.array(kept[:1])]
    for a, b in pairwise(sorted(lines)):
        low, high = np.interp([a, b], t, measure)
        count = 1 if [a, b] in tips else max(1, int(np.ceil(high - low - 0.35)))
        made.append(np.interp(low + (high - low) * np.arange(1, count + 1) / count, measure, t))
        made[-1][-1] = b
    return np.concatenate(made)


def net_points(side: int) -> Index:
    """Places (4, 4), by s and t, in the Bezier net (16,) of a cell whose side is a pole."""
    before, ahead, after = (np.array(AROUND[(side + k) % 4]) for k in (1, 2, 3))
    s, t = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    at = 3 * before + s[..., None] * (after - ahead) + t[..., None] * (ahead - before)
    return np.asarray(4 * at[..., 0] + at[..., 1])


def triangle_map(side: int) -> Array:
    """Matrix (16, 10) from a cell's Bezier net to the triangle's control points, corners: pole, ahead, after.

    The inner point is that of row 2 brought to degree two.
    """
    at = net_points(side)
    F = np.zeros((16, 10))
    for b, (_, ahead, after) in enumerate(CUBIC.exponents.tolist()):
        t = ahead + after
        if b == INNER:
            F[at[:, 2], b] = (-0.25, 0.75, 0.75, -0.25)
        else:
            F[at[0 if after == 0 else 3 if ahead == 0 else after, t], b] = 1.0
    return F


def inner_row(net: Array, side: int, wanted: Array) -> Array:
    """Coefficients (e, 16) of wanted points (e, 3) over the points of Bezier nets (e, 16, 3); they sum to one.

    Those nearest to the inner column of `triangle_map` among those that do not use the pole.
    """
    at = net_points(side)
    start = triangle_map(side)[:, INNER]
    used = np.sort(at[:, 1:].ravel())
    points = net[:, used]
    extent = np.linalg.norm(np.ptp(points, axis=1), axis=1)[:, None]
    G = np.swapaxes(points - points.mean(axis=1, keepdims=True), 1, 2) / extent[..., None]
    off = (wanted - np.einsum("n,enc->ec", start, net)) / extent
    result = np.repeat(start[None], len(net), axis=0)
    move = np.einsum("enc,ec->en", np.linalg.pinv(G, rcond=1e-7), off)
    result[:, used] += move - move.mean(axis=1, keepdims=True)  # zero but for rounding
    return result
