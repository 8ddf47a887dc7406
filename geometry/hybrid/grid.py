r"""Quadrilaterals between parameter lines of trimmed faces, where the skin is to be the CAD surface itself.

A face has lines u_0 < u_1 < ... and v_0 < v_1 < ...: all its knots, the lines that its edges follow, the ends of the
pieces of these edges, and more where cells would be larger than wanted. A cell between four lines is

    exterior   outside the loops
    trimmed    crossed by a trimming curve, or nearer to one than a share of its own size
    interior   kept whole: one quadrilateral

so the kept cells' outline is the rectilinear approximation of the trimming curves. Cells with a side on an edge that
follows a parameter line are kept too, if the edge has a single piece there: edges are cut where lines meet them.

Axis letters: i, j cell, c corner, d parameter direction.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, Face, curve_points, surface_frame, winding
from geometry.hybrid.poles import AROUND, Pole, poles_of, rows
from geometry.hybrid.sizing import Sizing, size_at
from geometry.patch import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ALONG = 1e-7
"""Extent (of the parameter range) below which a curve in the plane follows a parameter line."""
ON_LINE = 100.0 * ALONG
"""Distance (share of the parameter range) within which a vertex lies on a line."""
CLOSE = 0.35
"""Lines nearer to each other than this share of the wanted size are one."""
MARGIN = 0.4
"""Room between a cell and a trimming curve that crosses parameter lines, as a share of the cell."""
LARGE = 3.0
"""Cells larger than this many times the wanted size are left to triangles."""
SLENDER = 8.0
"""Largest ratio of sides."""
NARROW = 16.0
"""The same of triangles at poles."""
SKEWED = 0.25
"""Least sine of the angle between parameter lines."""
MOST = 40_000
"""Cells of a face."""
PASSES = 3
"""How often faces take over the cuts that their neighbours made on common edges."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Lines of one face and what becomes of the cells between them.

    Attributes
    ----------
    lines : u (m + 1,) and v (n + 1,).
    kept : (m, n) cells that become quadrilaterals.
    inside : (m, n) cells whose centre lies inside the loops.
    polar : (m, n) cells with a side at a pole that become triangles (`poles`).
    poles : of the face.
    """

    lines: tuple[Array, Array]
    kept: Mask
    inside: Mask
    polar: Mask
    poles: tuple[Pole, ...] = ()


def is_flat(surface: Patch) -> bool:
    """Whether all control points lie in one plane, so that triangles meet the surface as well."""
    x = surface.control.reshape(-1, 3)
    x = x - x.mean(axis=0)
    size = np.linalg.svd(x, compute_uv=False)
    return bool(size[-1] <= 1e-12 * size[0])


def followed(coedge: Coedge, surface: Patch) -> int:
    """Direction (0 or 1) whose parameter is constant along a coedge, or -1."""
    spread = np.ptp(coedge.curve.control, axis=0)
    for d in range(2):
        if spread[d] <= ALONG * np.ptp(surface.knots[d]) < spread[1 - d]:
            return d
    return -1


def face_lines(
    brep: Brep, number: int, ends: dict[int, Array], settled: set[int], sizing: Sizing, most: float,
    cuts: Mapping[int, Array] = MappingProxyType({}),
) -> tuple[Array, Array]:  # fmt: skip
    """Lines of one face.

    Parameters
    ----------
    ends : for each edge the parameters of its pieces' ends.
    settled : edges whose ends count before those of others.
    most : largest cell, in space.
    cuts : parameters at which edges are cut in any case.
    """
    face = brep.faces[number]
    t = np.linspace(0.0, 1.0, 33)
    outline = np.concatenate([curve_points(c.curve, t) for loop in face.loops for c in loop])
    box = np.stack([outline.min(axis=0), outline.max(axis=0)])
    wanted = _wanted(brep, face, box, ends, settled, cuts)
    raster = _rastered(face, box, sizing)
    target = min(float(np.median(raster.size)), most)
    same = [10 * ALONG * float(np.ptp(k)) for k in face.surface.knots]
    made = [
        _spaced(wanted.firm[d], wanted.given[d], wanted.loose[d], box[:, d], raster.speeds[d].mean(axis=1 - d), target,
                same[d]) for d in range(2)
    ]  # fmt: skip
    poles = poles_of(brep, number)
    if poles:
        d = poles[0].direction
        kept = _apart([*sorted(wanted.firm[d]), *sorted(wanted.given[d]), *box[:, d].tolist()], same[d])
        width = raster.speeds[1 - d].mean(axis=1 - d) * float(np.diff(made[1 - d]).max())
        first = _first_row(raster, brep.vertices[[pole.vertex for pole in poles]], sizing)
        made[d] = rows(kept, poles, raster.speeds[d].mean(axis=1 - d), width, raster.places[d], first, target)
    return made[0], made[1]


@dataclass(frozen=True, eq=False)
class _Wanted:
    """Values of both parameters that lines of a face are to have: ``firm`` ones in any case, ``given`` ones, where
    edges are cut by other faces or must be, before ``loose`` ones, where nothing but sizes asks for them.
    """

    firm: tuple[list[float], list[float]]
    given: tuple[list[float], list[float]]
    loose: tuple[list[float], list[float]]


def _wanted(
    brep: Brep, face: Face, box: Array, ends: dict[int, Array], settled: set[int], cuts: Mapping[int, Array]
) -> _Wanted:
    """What lines a face's knots, the box (2, 2) of its outline, and its edges want; see `face_lines`."""
    surface = face.surface
    firm: tuple[list[float], list[float]] = ([], [])
    given: tuple[list[float], list[float]] = ([], [])
    loose: tuple[list[float], list[float]] = ([], [])
    for d in range(2):
        reach = 10 * ALONG * np.ptp(surface.knots[d])
        inner = np.unique(surface.knots[d])[1:-1].tolist()  # a face may pass its surface's border by a tolerance
        firm[d].extend(k for k in inner if box[0, d] + reach < k < box[1, d] - reach)
        loose[d].extend(box[:, d].tolist())
    for loop in face.loops:
        for c in loop:
            d = followed(c, surface)
            if d < 0:
                continue
            firm[d].append(float(c.curve.control[:, d].mean()))
            if not brep.edges[c.edge].degenerate:
                if c.edge in cuts:
                    given[1 - d].extend(curve_points(c.curve, cuts[c.edge])[:, 1 - d].tolist())
                where = curve_points(c.curve, ends[c.edge])[:, 1 - d]
                (given if c.edge in settled else loose)[1 - d].extend(where.tolist())
    return _Wanted(firm, given, loose)


@dataclass(frozen=True, eq=False)
class _Raster:
    """Points of a face on a raster of its box: ``places`` (k,) of both parameters, lengths of parameter lines in space
    ``speeds`` (k, k) per unit of each, and of the points inside the loops, or of all if there are none, positions
    (q, 3) and wanted sizes (q,).
    """

    places: tuple[Array, Array]
    speeds: tuple[Array, Array]
    points: Array
    size: Array


def _rastered(face: Face, box: Array, sizing: Sizing, k: int = 13) -> _Raster:
    u, v = (np.linspace(a, b, k) for a, b in zip(*box))
    raster = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    x, du, dv = surface_frame(face.surface, raster)
    inside = winding(face, raster)
    x = x[inside] if inside.any() else x
    speeds = [np.linalg.norm(tangent, axis=1).reshape(k, k) for tangent in (du, dv)]
    return _Raster((u, v), (speeds[0], speeds[1]), x, size_at(sizing, x))


def _first_row(raster: _Raster, tips: Array, sizing: Sizing) -> float:
    """Height of the rows at poles (p, 3): a triangle there is as small as elements want to be anywhere on it."""
    first = float(size_at(sizing, tips).min())
    beside = (np.linalg.norm(raster.points[:, None] - tips, axis=2) < first).any(axis=1)
    return min(first, float(raster.size[beside].min(initial=first)))


def _apart(values: list[float], same: float) -> list[float]:
    """Values that are not the same as one before, ascending."""
    kept: list[float] = []
    for value in values:
        if min((abs(value - k) for k in kept), default=np.inf) > same:
            kept.append(value)
    return sorted(kept)


def _spaced(
    firm: list[float], given: list[float], loose: list[float], box: Array, speed: Array, target: float, same: float
) -> Array:
    """All firm values, of the others those that are not close to one before, and more where gaps are large."""
    places = np.linspace(box[0], box[1], len(speed))

    def rate(x: float) -> float:
        return float(np.interp(x, places, speed)) + 1e-300

    kept = _apart(sorted(firm), same)
    for value in [*sorted(given), *sorted(loose)]:
        if min((abs(value - k) for k in kept), default=np.inf) > max(CLOSE * target / rate(value), same):
            kept.append(value)
    kept.sort()
    made = kept[:1]
    for a, b in pairwise(kept):
        count = max(1, int(np.ceil((b - a) * rate(0.5 * (a + b)) / target - 0.35)))
        made.extend((a + (b - a) * np.arange(1, count + 1) / count).tolist()[:-1])
        made.append(b)
    return np.array(made)


def agree(
    brep: Brep, ends: dict[int, Array], sizing: Sizing, cells: Mapping[int, float],
    cuts: Mapping[int, Array] = MappingProxyType({}),
) -> tuple[dict[int, tuple[Array, Array]], dict[int, Array]]:  # fmt: skip
    """Lines of faces, and the ends of edges' pieces where the lines meet the edges that they cross.

    Face by face, the edges that an earlier face has cut count first; what a later face adds is taken over in the next
    pass.

    Parameters
    ----------
    ends : for each edge the parameters of its pieces' ends, as sizes want them.
    cells : the faces and the largest cell of each.
    cuts : parameters at which edges are cut in any case.
    """
    lines: dict[int, tuple[Array, Array]] = {}
    for _ in range(PASSES if cells else 0):
        settled: set[int] = set()
        ends = dict(ends)
        for f in _in_order(brep, list(cells)):
            made = face_lines(brep, f, ends, settled, sizing, cells[f], cuts)
            if len(made[0]) * len(made[1]) > MOST:
                continue
            lines[f] = made
            for loop in brep.faces[f].loops:
                for c in loop:
                    d = followed(c, brep.faces[f].surface)
                    if d < 0 or brep.edges[c.edge].degenerate:
                        continue
                    reach = ON_LINE * float(np.ptp(brep.faces[f].surface.knots[1 - d]))
                    t = _meeting(c, 1 - d, made[1 - d], reach).tolist()
                    if c.edge in settled:
                        old = ends[c.edge]
                        apart = CLOSE * float(np.diff(old).min())
                        t = [*old[1:-1].tolist(), *(s for s in t if np.abs(old - s).min() > apart)]
                    if t:
                        ends[c.edge] = np.array([0.0, *sorted(t), 1.0])
                        settled.add(c.edge)
    return lines, ends


def _in_order(brep: Brep, faces: list[int]) -> list[int]:
    """Faces so that each is a neighbour of one before, as far as that can be."""
    left, order = set(faces), []
    queue: deque[int] = deque()
    while left:
        f = queue.popleft() if queue else min(left)
        if f not in left:
            continue
        left.discard(f)
        order.append(f)
        queue.extend(
            g for loop in brep.faces[f].loops for c in loop for g, _, _ in brep.coedges_of[c.edge] if g in left
        )
    return order


def _meeting(c: Coedge, d: int, lines: Array, reach: float) -> Array:
    """Parameters in (0, 1) at which the coordinate d, monotone along a coedge, takes the values of lines, but of those
    that its ends are on, to within a reach.
    """
    ends = curve_points(c.curve, np.array([0.0, 1.0]))[:, d]
    low, high = min(ends), max(ends)
    room = min(reach, CLOSE * (high - low))
    value = lines[(lines > low + room) & (lines < high - room)]
    a, b = np.zeros(len(value)), np.ones(len(value))
    rising = ends[1] > ends[0]
    for _ in range(52):
        middle = 0.5 * (a + b)
        below = (curve_points(c.curve, middle)[:, d] < value) == rising
        a, b = np.where(below, middle, a), np.where(below, b, middle)
    return np.sort(0.5 * (a + b))


def make_grid(brep: Brep, number: int, lines: tuple[Array, Array], sizing: Sizing) -> Grid:
    """Decide which cells become quadrilaterals; sides on edges are looked at when the face is meshed."""
    face = brep.faces[number]
    surface = face.surface
    m, n = len(lines[0]) - 1, len(lines[1]) - 1
    middles = [0.5 * (x[1:] + x[:-1]) for x in lines]
    centre = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = winding(face, centre).reshape(m, n)
    crossed = np.zeros((m, n), dtype=bool)
    for loop in face.loops:
        for c in loop:
            if followed(c, surface) < 0:
                _mark(c, lines, crossed)
    kept = inside & ~crossed
    poles = tuple(poles_of(brep, number))
    polar, beside = _at_poles(kept, poles)
    kept &= ~beside
    chosen = np.flatnonzero(kept.ravel())
    if len(chosen):
        kept.ravel()[chosen] = _well_shaped(surface, lines, chosen, n, sizing)
    chosen = np.flatnonzero(polar.ravel())
    if len(chosen):
        polar.ravel()[chosen] = _well_shaped(surface, lines, chosen, n, sizing, True)
    for pole in poles:  # a triangle at a pole stands on a quadrilateral
        tips, cells = pole.onwards(polar), pole.onwards(kept)
        if len(tips) > 1:
            tips[0] &= cells[1]
    return Grid(lines, kept, inside, polar, poles)


def _at_poles(inner: Mask, poles: tuple[Pole, ...]) -> tuple[Mask, Mask]:
    """Cells that may become triangles at a pole, and all cells beside poles."""
    polar, beside = np.zeros_like(inner), np.zeros_like(inner)
    for pole in poles:
        row = pole.onwards(beside)[0]
        pole.onwards(polar)[0] = pole.onwards(inner)[0] & ~row  # not between two poles
        row[:] = True
    return polar, beside


def _mark(c: Coedge, lines: tuple[Array, Array], crossed: Mask) -> None:
    """Mark cells that, made larger by the margin, hold a point of a curve."""
    step = min(float(np.diff(x).min()) / (x[-1] - x[0]) for x in lines)
    t = np.linspace(0.0, 1.0, int(np.clip(4.0 / max(step, 1e-4), 64, 4000)))
    p = curve_points(c.curve, t)
    near = []
    for d in range(2):
        x = lines[d]
        room = MARGIN * np.diff(x)
        near.append((p[:, d, None] > x[:-1] - room) & (p[:, d, None] < x[1:] + room))
    crossed |= np.asarray((near[0].T.astype(np.float64) @ near[1].astype(np.float64)) > 0.0)


def _well_shaped(
    surface: Patch, lines: tuple[Array, Array], chosen: Index, n: int, sizing: Sizing, polar: bool = False
) -> Mask:
    """Which cells are neither skew nor slender nor large; of triangles at poles only sides that have a length count."""
    i, j = chosen // n, chosen % n
    corner = np.stack([np.stack([lines[0][i + a], lines[1][j + b]], axis=1) for a, b in AROUND], axis=1)  # fmt: skip
    low, high = corner[:, 0], corner[:, 2]
    spread = 1e-9 * (high - low)
    inner = np.clip(corner, (low + spread)[:, None], (high - spread)[:, None])
    x, du, dv = surface_frame(surface, inner.reshape(-1, 2))
    size = np.linalg.norm(du, axis=1) * np.linalg.norm(dv, axis=1)
    sine = np.linalg.norm(np.cross(du, dv), axis=1) / (size + 1e-300)
    x = x.reshape(-1, 4, 3)
    side = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)
    longest = side.max(axis=1)
    if polar:
        size, sine = size.reshape(-1, 4), sine.reshape(-1, 4)
        sine = np.where(size > 1e-6 * size.max(axis=1, keepdims=True), sine, 1.0)
        side = np.where(side > 1e-6 * longest[:, None], side, np.inf)
    regular = (sine.reshape(-1, 4) > SKEWED).all(axis=1)
    regular &= longest < (NARROW if polar else SLENDER) * side.min(axis=1)
    wanted = size_at(sizing, x.mean(axis=1))
    return np.asarray(regular & (longest < LARGE * wanted))


def kept_share(grid: Grid) -> float:
    """Share of the inside, in the parameter plane, that becomes quadrilaterals."""
    area = np.outer(*(np.diff(x) for x in grid.lines))
    whole = float(area[grid.inside].sum())
    return float(area[grid.kept | grid.polar].sum()) / whole if whole > 0.0 else 0.0
