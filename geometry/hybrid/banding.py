r"""The band of a face of a solid: right triangles at its trimming curves and rectangles in the corners between them.

A monotone piece of a trimming curve from p to r has its right-angle corner at q0 inside the face, with legs along the
parameter lines; at a vertex of the curve the legs of its two pieces span 0, 1, 2 or 3 right angles, and as many
rectangles lie between them (`band`, NOTES 3.1). Here elements must meet edge to edge, because cells stand on them. So
an element is left out where it is not sound, and general triangles take its place (`facemesh`, `strip`):

    flat      (no triangle) the piece follows a parameter line: cells of the grid lie along it
    turning   the piece turns around in a direction, because it could not be cut there
    folded    phi is not certified
    slender   a leg is much shorter than the other: the curve nearly follows a parameter line
    tangent   the curve leaves along a leg, where it turns around: the triangle would have no angle there
    pole      the chart narrows too much within it: at a pole there are other triangles (`poles`)
    meeting   another element, or another curve, lies within, or ends on one of its straight sides

Cells of the grid that a triangle needs give way to it; rectangles give way to cells.

Axis letters: s segment, e element, d parameter direction, k sample or node.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.chart import Chart, lengths_of, narrows, to_chart
from geometry.hybrid.curves import cubic_functions
from geometry.hybrid.legs import reach_of, right_angles, tangent
from geometry.hybrid.triangle import certified, make_phi, right_corner, triangle_map

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SLENDER = 0.1
"""Least height of a triangle over its longest side: about the ratio of its legs."""
THIN = 0.2
"""Least ratio of the sides of a rectangle."""
TANGENT = 0.15
"""Least sine of the angle between the curve and a leg where they meet."""
BESIDE = 0.03
"""Distance of a corner from a piece of the outline, over the piece's length, below which it is next to it."""
ON = 0.02
"""Share of a side within which a point counts as on it, or at its end."""
DEPTH = 0.6
"""Share of the way to the next line that a rectangle between two others may take."""
NEAR = 1e-7
"""Distance, relative to the face, below which two points are one."""
AT_END = 1e-3
"""Share of a side by which it may reach over another and yet not cross it: neighbours share their ends."""
STRAIGHT = 1e-7
"""Extent, relative to the face, below which a piece follows a parameter line."""
_ON_PIECE = cubic_functions(np.linspace(0.0, 1.0, 9))
_PROBES = np.array([(i / 7, j / 7) for i in range(8) for j in range(8 - i)])
_PROBES = (1.0 - 6e-3) * _PROBES + 2e-3
_SQUARE = np.stack(np.meshgrid(*[np.linspace(2e-3, 1.0 - 2e-3, 6)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Banding:
    """Right triangles and rectangles of a face.

    Attributes
    ----------
    segment, corner : (t,) piece of the outline, and (t, 2) right-angle corner of each triangle.
    low, high : (r, 2) rectangles.
    crowded : (c,) cells of the grid that give way.
    without : why other pieces have no triangle, and how many.
    """

    segment: Index
    corner: Array
    low: Array
    high: Array
    crowded: Mask
    without: dict[str, int]


@dataclass(frozen=True, eq=False)
class _Element:
    """A candidate: its polygon (k, 2), straight sides (m, 2, 2), points inside, kind ("cell", "triangle", ...)."""

    kind: str
    number: int
    polygon: Array
    sides: Array
    inside: Array


def band_elements(
    plane: Array, following: Index, lines: tuple[Array, Array], cells: Array, chart: Chart
) -> Banding:
    """Elements of the band of a face.

    Parameters
    ----------
    plane : (s, 4, 2) cubic pieces of the outline in the parameter plane, the inside on their left.
    following : (s,) the piece that follows each.
    lines : knots of the face in both directions; no rectangle crosses them.
    cells : (c, 2, 2) lowest and highest corners of the grid's cells.
    chart : of the face, to see shapes.
    """
    plane = _straightened(plane)
    corner = right_corner(plane[:, 0], plane[:, 3])
    slender = _slender(chart, plane, corner)
    polar = _narrowing(chart, np.stack([plane[:, 0], plane[:, 3], corner], axis=1))
    scale = lengths_of(chart)
    plane, cells, lines = plane * scale, cells * scale, (lines[0] * scale[0], lines[1] * scale[1])
    start, end = plane[:, 0], plane[:, 3]
    step = end - start
    flat = (np.ptp(plane, axis=1) == 0.0).any(axis=1)
    rising = (step[:, 0] * step[:, 1] > 0)[:, None]
    q0 = corner * scale
    curve = np.where(rising[..., None], plane[:, ::-1], plane)  # from pa, along xi from q0, to pb
    phi = make_phi(q0, curve)
    state = np.full(len(plane), "", dtype=object)
    state[~_monotone(plane)] = "turning"
    state[(state == "") & ~_certified(phi, ~flat)] = "folded"
    state[(state == "") & polar] = "pole"
    state[(state == "") & slender] = "slender"
    state[(state == "") & _touching(plane, q0)] = "tangent"
    state[flat] = "flat"
    triangles = [
        _Element("triangle", s, np.concatenate([_curve(plane[s]), q0[None, s]]),
                 np.array([(start[s], q0[s]), (q0[s], end[s])]), triangle_map(phi[None, s], _PROBES)[0])
        for s in np.flatnonzero(state == "").tolist()
    ]  # fmt: skip
    rectangles = [
        _rectangle("rectangle", n, *box)
        for n, box in enumerate(_between(plane, following, q0, state == "", lines))
        if not _narrowing(chart, np.stack(box)[None] / scale).any()
    ]
    boxes = [_rectangle("cell", n, *box) for n, box in enumerate(cells)]
    left = _sound([*triangles, *boxes, *rectangles], plane)
    kept = {(e.kind, e.number) for e in left}
    segment = np.array([e.number for e in left if e.kind == "triangle"], dtype=np.int64)
    for e in triangles:
        if ("triangle", e.number) not in kept:
            state[e.number] = "meeting"
    found = [np.stack([e.polygon.min(axis=0), e.polygon.max(axis=0)]) for e in left if e.kind == "rectangle"]
    rows = np.array(found).reshape(-1, 2, 2) / scale
    crowded = np.array([("cell", n) not in kept for n in range(len(cells))], dtype=bool)
    counted = Counter(str(why) for why in state.tolist() if why)
    return Banding(segment, corner[segment], rows[:, 0], rows[:, 1], crowded, dict(counted))


def _straightened(plane: Array) -> Array:
    """Pieces whose extent in a direction is rounding lie on a parameter line."""
    plane = plane.copy()
    extent = np.ptp(plane.reshape(-1, 2), axis=0)
    thin = np.ptp(plane, axis=1) <= STRAIGHT * extent
    for d in range(2):
        plane[thin[:, d], :, d] = plane[thin[:, d], :1, d]
    return plane


def _slender(chart: Chart, plane: Array, corner: Array) -> Mask:
    """Triangles (s,) that are slender, or turned over, with straight sides in the chart."""
    a, b, c = (to_chart(chart, x) for x in (plane[:, 0], plane[:, 3], corner))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return np.asarray(area < SLENDER * ((b - a) ** 2).sum(axis=1))


def _narrowing(chart: Chart, corners: Array) -> Mask:
    """Elements (e,) with corners (e, c, 2) in the parameter plane between which the chart narrows towards a pole."""
    return narrows(chart, to_chart(chart, corners.reshape(-1, 2)).reshape(corners.shape))


def _touching(plane: Array, q0: Array) -> Mask:
    """Triangles (s,) with next to no angle between the curve and a leg at an end of the curve."""
    result = np.zeros(len(plane), dtype=bool)
    for at, (k, j) in ((plane[:, 0], (0, 1)), (plane[:, 3], (3, 2))):
        way, leg = plane[:, j] - plane[:, k], q0 - at
        size = np.linalg.norm(way, axis=1) * np.linalg.norm(leg, axis=1) + 1e-300
        result |= np.abs(way[:, 0] * leg[:, 1] - way[:, 1] * leg[:, 0]) < TANGENT * size
    return result


def _curve(control: Array) -> Array:
    """Points (9, 2) on a piece."""
    return np.asarray(_ON_PIECE @ control)


def _monotone(plane: Array) -> Mask:
    """Pieces that turn around in no direction, but for a share that does not show."""
    t = np.linspace(0.0, 1.0, 33)
    B = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
    slope = np.einsum("kj,sjc->skc", B, np.diff(plane, axis=1)) * np.sign(plane[:, 3] - plane[:, 0])[:, None]
    return np.asarray((slope.min(axis=1) >= -1e-3 * np.abs(slope).max(axis=1)).all(axis=1))


def _certified(phi: Array, which: Mask) -> Mask:
    result = np.zeros(len(phi), dtype=bool)
    if which.any():
        result[which] = certified(phi[which])
    return result


def _rectangle(kind: str, number: int, low: Array, high: Array) -> _Element:
    ring = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    sides = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    return _Element(kind, number, ring, sides, low + _SQUARE * (high - low))


def _between(
    plane: Array, following: Index, q0: Array, good: Mask, lines: tuple[Array, Array]
) -> list[tuple[Array, Array]]:
    """Rectangles between the legs of triangles at their common vertices."""
    found = []
    for s, t in enumerate(following.tolist()):
        if not (good[s] and good[t]):  # so neither ends at a pole, where the next begins elsewhere in the plane
            continue
        p = plane[t, 0]
        second, first = q0[s] - plane[s, 3], q0[t] - p
        ways = [np.sign(np.where(np.abs(w) == np.abs(w).max(), w, 0.0)) for w in (first, second)]
        k = right_angles(ways[0], ways[1], tangent(plane[t], False), tangent(plane[s], True))
        if k is None or k <= 0:
            continue
        depth = max(np.abs(first).max(), np.abs(second).max())
        spokes, way = [ways[0] * np.abs(first).max()], ways[0]
        for _ in range(k - 1):
            way = np.array([-way[1], way[0]])
            spokes.append(way * min(DEPTH * reach_of(p, way, lines, 1.0), depth))
        spokes.append(ways[1] * np.abs(second).max())
        for a, b in pairwise(spokes):
            corners = np.array([p, p + a + b])
            low, high = corners.min(axis=0), corners.max(axis=0)
            room = 1e-6 * (high - low)
            if (high - low).min() > THIN * (high - low).max() and not any(
                ((x > low[d] + room[d]) & (x < high[d] - room[d])).any() for d, x in enumerate(lines)
            ):
                found.append((low, high))
    return found


def _sound(elements: list[_Element], plane: Array) -> list[_Element]:
    """Elements without those that meet others or the outline otherwise than edge to edge."""
    rank = {"triangle": 0, "cell": 1, "rectangle": 2}
    bends, outline = np.stack([_curve(c) for c in plane]), plane[:, 0]
    curves = bends[:, 1:-1]
    pieces = np.stack([bends[:, :-1], bends[:, 1:]], axis=2).reshape(-1, 2, 2)
    alive = {  # the grid keeps its cells away from the curves
        n for n, e in enumerate(elements) if e.kind == "cell" or not _on_outline(e, curves, pieces, outline)
    }
    boxes = np.array([(e.polygon.min(axis=0), e.polygon.max(axis=0)) for e in elements]).reshape(-1, 2, 2)
    size = np.prod(boxes[:, 1] - boxes[:, 0], axis=1)
    band = np.array([n for n, e in enumerate(elements) if e.kind != "cell"], dtype=np.int64)
    for a in range(len(elements)):
        # Cells of one grid do not overlap, and there may be many: they are held against the band alone.
        before = band[band < a] if elements[a].kind == "cell" else np.arange(a)
        near = (boxes[before, 0] < boxes[a, 1]).all(axis=1) & (boxes[before, 1] > boxes[a, 0]).all(axis=1)
        for b in before[near].tolist():
            if a not in alive or b not in alive:
                continue
            if (
                _cross(elements[a].sides, elements[b].sides)
                or _holds(elements[a].polygon, elements[b].inside).any()
                or _holds(elements[b].polygon, elements[a].inside).any()
            ):
                alive.discard(max(a, b, key=lambda n: (rank[elements[n].kind], size[n])))
    while True:
        corners = {n: _corners(elements[n]) for n in sorted(alive)}
        nodes = np.concatenate([outline, *corners.values()])
        same = NEAR * float(np.linalg.norm(np.ptp(nodes, axis=0)))
        wrong = {n for n in alive if elements[n].kind != "cell" and _ends_on(elements[n].sides, nodes, same)}
        if not wrong:  # cells meet edge to edge among themselves, so these corners are left out; they give way last
            nodes = np.concatenate([outline, *(x for n, x in corners.items() if elements[n].kind != "cell")])
            wrong = {n for n in alive if elements[n].kind == "cell" and _ends_on(elements[n].sides, nodes, same)}
        if not wrong:
            return [elements[n] for n in sorted(alive)]
        last = max(rank[elements[n].kind] for n in wrong)
        alive -= {n for n in wrong if rank[elements[n].kind] == last}


def _on_outline(element: _Element, curves: Array, pieces: Array, outline: Array) -> bool:
    """Whether the outline runs through an element, or next to its corners inside the face.

    Parameters
    ----------
    curves, pieces, outline : points (s, k, 2) on the pieces of the outline, short straight pieces (m, 2, 2) of them,
        and their vertices.
    """
    others = np.delete(curves, element.number, axis=0) if element.kind == "triangle" else curves
    return (
        bool(_holds(element.polygon, others.reshape(-1, 2)).any())
        or _cross(element.sides, pieces)
        or _beside(pieces, outline, element)
    )


def _corners(element: _Element) -> Array:
    return element.polygon[[0, -2, -1]] if element.kind == "triangle" else element.polygon


def _beside(pieces: Array, outline: Array, element: _Element) -> bool:
    """Whether a corner inside the face is next to the outline, of which short straight pieces (m, 2, 2) are given."""
    corners = _corners(element)
    size = ON * float(np.linalg.norm(np.ptp(element.polygon, axis=0)))
    inner = corners[np.linalg.norm(corners[:, None] - outline, axis=2).min(axis=1) > 1e-6 * size]
    way = pieces[:, 1] - pieces[:, 0]
    # A triangle between the corner and a whole piece, which bends, would be flat.
    reach = np.maximum(size, BESIDE * (len(pieces) // len(outline)) * np.linalg.norm(way, axis=1))
    off = inner[:, None] - pieces[:, 0]
    along = np.clip(np.einsum("kmc,mc->km", off, way) / (np.einsum("mc,mc->m", way, way) + 1e-300), 0.0, 1.0)
    return bool((np.linalg.norm(off - along[..., None] * way, axis=2) < reach).any())


def _ends_on(sides: Array, nodes: Array, same: float) -> bool:
    """Whether a node lies on one of the straight sides (m, 2, 2), or next to it, but not at its ends, which nodes are
    that are no further than ``same`` from them; those that nearly are must lie along the side to count.
    """
    way = sides[:, 1] - sides[:, 0]
    length = np.linalg.norm(way, axis=1)
    off = nodes[None] - sides[:, None, 0]
    along = np.einsum("mkc,mc->mk", off, way) / length[:, None] ** 2
    away = np.abs(off[..., 0] * way[:, None, 1] - off[..., 1] * way[:, None, 0]) / length[:, None] ** 2
    end = np.minimum(along, 1.0 - along)
    apart = end * length[:, None] > same
    return bool((apart & (end > 0.0) & (away < ON * np.where(end > ON, 1.0, end))).any())


def _cross(first: Array, second: Array) -> bool:
    """Whether a straight piece of the first (k, 2, 2) crosses one of the second (m, 2, 2) between their ends."""
    low, high = first.min(axis=(0, 1)), first.max(axis=(0, 1))
    second = second[(second.min(axis=1) < high).all(axis=1) & (second.max(axis=1) > low).all(axis=1)]

    def apart(a: Array, b: Array) -> Mask:
        """Pieces (k, m) whose ends lie on both sides of the lines of others, by more than a share of a length."""
        way, off = a[:, None, 1] - a[:, None, 0], b - a[:, None, None, 0]
        side = way[..., None, 0] * off[..., 1] - way[..., None, 1] * off[..., 0]
        room = AT_END * np.linalg.norm(b[:, 1] - b[:, 0], axis=1) * np.linalg.norm(way, axis=2)
        return np.asarray((side.min(axis=2) < -room) & (side.max(axis=2) > room))

    return bool((apart(first, second) & apart(second, first).T).any())


def _holds(polygon: Array, points: Array) -> Mask:
    """Points (k,) inside a polygon, a little away from its sides."""
    middle = polygon.mean(axis=0)
    start = middle + 0.998 * (polygon - middle)
    end = np.roll(start, -1, axis=0)
    crossed = (start[:, 1] > points[:, 1, None]) != (end[:, 1] > points[:, 1, None])
    rise = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    at = start[:, 0] + (points[:, 1, None] - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return np.asarray((crossed & (at > points[:, :1])).sum(axis=1) % 2 == 1)
