r"""Where the edges of a solid are cut so that the curves of both faces and the one in space are compatible.

An edge has a curve c_f(t) in the parameter plane of each of its faces f, and one in space, over the same t. It is cut,
for all three, where for either face

    a coordinate of c_f takes the value of a knot of the face
    a coordinate of c_f turns around, c_f' = 0

so that every piece lies in one knot interval and is monotone on both sides (Song and Cohen 2019, Section 3). Cuts that
sizes and tolerances ask for give way to these.

Axis letters: d parameter direction, k sample.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, curve_points, curve_tangents
from geometry.hybrid.grid import ALONG, CLOSE, followed
from geometry.hybrid.pieces import Pieces
from geometry.patch import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAMPLES = 257
"""Samples of a curve between which it crosses a line, or turns around, once at most; its knots are more."""
SAME = 1e-6
"""Parameters that differ by less are one."""
NEAR = 0.1
"""Share of a piece within which a point where a curve turns around is not cut beside another cut."""


def compatible_cuts(brep: Brep) -> dict[int, Array]:
    """Parameters inside (0, 1) where edges must be cut, for those that have any."""
    found = {}
    for e, edge in enumerate(brep.edges):
        if edge.degenerate:
            continue
        crossed: list[float] = []
        turned: list[float] = []
        for f, k, i in brep.coedges_of[e]:
            face = brep.faces[f]
            coedge = face.loops[k][i]
            crossed += crossings(coedge, face.surface.knots, inner=True)
            turned += turns(coedge, face.surface)
        kept: list[float] = []
        room = NEAR / (1 + len(crossed) + len(turned))
        for own, apart in ((crossed, SAME), (turned, room)):
            for t in sorted(own):
                if min(abs(t - other) for other in (*kept, 0.0, 1.0)) > apart:
                    kept.append(t)
        if kept:
            found[e] = np.array(sorted(kept))
    return found


def with_cuts(ends: dict[int, Array], cuts: dict[int, Array]) -> dict[int, Array]:
    """Ends of pieces with the cuts that must be; ends that are close to one of these give way."""
    made = dict(ends)
    for e, firm in cuts.items():
        t = ends[e]
        h = np.diff(t)
        free = t[1:-1]
        room = CLOSE * np.minimum(h[:-1], h[1:])
        keep = np.abs(free[:, None] - firm).min(axis=1) > room if len(free) else np.zeros(0, dtype=bool)
        made[e] = np.sort(np.concatenate([[0.0, 1.0], free[keep], firm]))
    return made


def line_cuts(
    brep: Brep, ends: dict[int, Array], cuts: dict[int, Array], lines: Mapping[int, tuple[Array, Array]]
) -> dict[int, Array]:
    """Ends with cuts where edges that follow no parameter line cross lines of their faces, unless close to other cuts.

    Lines that are no knots of the CAD surface are knots of the refined splines, so they cut the curves as well; where
    two would leave a small piece between them, one does not: the surface is smooth there.
    """
    made = dict(ends)
    for e, edge in enumerate(brep.edges):
        uses = [(f, brep.faces[f].loops[k][i]) for f, k, i in brep.coedges_of[e]]
        if edge.degenerate or any(followed(c, brep.faces[f].surface) >= 0 for f, c in uses):
            continue
        own = sorted(t for f, c in uses if f in lines for t in crossings(c, lines[f]))
        t, kept = ends[e], cuts.get(e, np.zeros(0)).tolist()
        for s in own:
            k = int(np.clip(np.searchsorted(t, s) - 1, 0, len(t) - 2))
            if min(abs(s - other) for other in (*kept, 0.0, 1.0)) > CLOSE * (t[k + 1] - t[k]):
                kept.append(s)
        if kept:
            made |= with_cuts({e: t}, {e: np.array(sorted(kept))})
    return made


def with_missing(ends: dict[int, Array], cuts: dict[int, Array]) -> dict[int, Array]:
    """Ends of pieces with the cuts that they lack."""
    made = dict(ends)
    for e, firm in cuts.items():
        made[e] = np.sort(np.concatenate([ends[e], firm[np.abs(firm[:, None] - ends[e]).min(axis=1) > SAME]]))
    return made


def halved(
    brep: Brep, cuts: dict[int, Array], pieces: Index, edges: list[Pieces], faces: Collection[int]
) -> dict[int, Array]:
    """Cuts with the middles of pieces that only the lines of faces would cut: sizes do not reach these.

    Parameters
    ----------
    pieces : (k, 3) two vertices and the edge of each.
    faces : those that have lines.
    """
    made = dict(cuts)
    for a, b, e in pieces.tolist():
        uses = [(brep.faces[f].loops[i][j], brep.faces[f].surface) for f, i, j in brep.coedges_of[e] if f in faces]
        if any(followed(c, surface) >= 0 for c, surface in uses):
            ring = edges[e].vertices
            k = int(np.flatnonzero(np.isin(ring[:-1], (a, b)) & np.isin(ring[1:], (a, b)))[0])
            middle = 0.5 * (edges[e].ends[k] + edges[e].ends[k + 1])
            made[e] = np.unique(np.append(made.get(e, np.zeros(0)), middle))
    return made


def crossings(c: Coedge, lines: tuple[Array, ...], inner: bool = False) -> list[float]:
    """Parameters at which the curve of a coedge crosses lines, in both directions.

    ``inner`` leaves out the first line and the last: those of a surface are its border, which curves pass by as much as
    the file's tolerances allow, and no knots of its functions there.
    """
    t = _samples(c)
    p = curve_points(c.curve, t)
    found: list[float] = []
    for d in range(2):
        x = np.unique(lines[d])
        reach = 10 * ALONG * (x[-1] - x[0])
        x = x[1:-1] if inner else x
        for line in x[(x > p[:, d].min() + reach) & (x < p[:, d].max() - reach)].tolist():
            found += _zeros(t, p[:, d] - line, partial(_offset, c, d, line))
    return found


def turns(c: Coedge, surface: Patch) -> list[float]:
    """Parameters at which a coordinate of the curve of a coedge turns around."""
    if followed(c, surface) >= 0:
        return []
    t = _samples(c)
    slope = curve_tangents(c.curve, t)
    scale = np.abs(slope).max(axis=0)
    found: list[float] = []
    for d in range(2):
        if scale[d] > SAME * np.ptp(surface.knots[d]):
            own = np.where(np.abs(slope[:, d]) > SAME * scale[d], slope[:, d], 0.0)
            found += _zeros(t, own, partial(_slope, c, d))
    return found


def _offset(c: Coedge, d: int, line: float, t: Array) -> Array:
    return curve_points(c.curve, t)[:, d] - line


def _slope(c: Coedge, d: int, t: Array) -> Array:
    return curve_tangents(c.curve, t)[:, d]


def _samples(c: Coedge) -> Array:
    return np.unique(np.concatenate([np.linspace(0.0, 1.0, SAMPLES), c.curve.knots]))


def _zeros(t: Array, value: Array, of: Callable[[Array], Array]) -> list[float]:
    """Places in (0, 1) where a function changes sign, from its values at samples, by bisection."""
    sign = np.sign(value)
    some = np.flatnonzero(sign)
    first = some[:-1][sign[some[:-1]] * sign[some[1:]] < 0]
    after = some[1:][sign[some[:-1]] * sign[some[1:]] < 0]
    if not len(first):
        return []
    low, high, rising = t[first], t[after], sign[after] > 0
    for _ in range(54):
        middle = 0.5 * (low + high)
        below = (of(middle) < 0.0) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return [s for s in (0.5 * (low + high)).tolist() if SAME < s < 1.0 - SAME]
