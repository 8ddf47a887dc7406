r"""Meshes of faces in their charts: quadrilaterals between parameter lines, triangles from there to the edges.

The kept cells of a face's grid (`grid`) are cut out of it; what is left is bounded by the pieces of the edges and by
the outline of the cells, and is triangulated (`triangulation`). Sides that an edge and a cell share vanish from that
boundary, so a face of parameter lines alone needs no triangle.

Axis letters: n vertex, e element, k side, c corner.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face, curve_points, surface_frame
from geometry.hybrid.chart import Chart, to_chart, to_parameters
from geometry.hybrid.grid import ALONG, Grid, followed
from geometry.hybrid.pieces import Pieces
from geometry.hybrid.sizing import Sizing, size_at
from geometry.hybrid.triangulation import triangulate
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

Sides = dict[tuple[int, int], tuple[Array, Array]]
"""Directed sides by their two vertices: the directions in space in which they leave and arrive."""

SMOOTH = 2.3
"""Boundary vertices with a larger angle (radians) inside the face must not be the tip of an ear."""
_AROUND = ((0, 0), (1, 0), (1, 1), (0, 1))


@dataclass(frozen=True, eq=False)
class FaceMesh:
    """A meshed face.

    Attributes
    ----------
    chart : of the face.
    points : (n, 2) vertices in the chart, those on edges first.
    vertices : (n,) their numbers in the solid.
    triangles : (t, 3) local numbers, positively turned in the chart.
    quads : (q, 4) local numbers of the corners (low, low), (high, low), (high, high), (low, high).
    low, high : (q, 2) rectangles of the quadrilaterals in the parameter plane.
    grid : where the quadrilaterals came from, if the face has one; ``kept`` as it was carried out.
    """

    chart: Chart
    points: Array
    vertices: Index
    triangles: Index
    quads: Index
    low: Array
    high: Array
    grid: Grid | None

    @property
    def outward(self) -> Index:
        """The triangles turned so that their normals leave the solid."""
        return self.triangles[:, ::-1] if self.chart.face.reversed else self.triangles


class FaceError(InputError):
    """A face that cannot be meshed with the pieces that its edges have."""

    def __init__(self, face: int, message: str):
        super().__init__(message)
        self.face = face


@dataclass(frozen=True, eq=False)
class _Outline:
    """Loops of a face: chart points and parameters (n, 2), vertices of the solid (n,), local numbers, and sides."""

    points: Array
    uv: Array
    vertices: Index
    loops: list[Index]
    leaving: Sides


def mesh_faces(
    brep: Brep, charts: list[Chart], edges: list[Pieces], count: int, sizing: Sizing, grids: dict[int, Grid],
    where: str,
) -> list[FaceMesh]:  # fmt: skip
    """Meshes of all faces, without interior sides between vertices that are joined elsewhere.

    Raises
    ------
    FaceError : a face cannot be meshed with these pieces.
    """
    taken = {tuple(sorted(pair)) for p in edges for pair in zip(p.vertices[:-1].tolist(), p.vertices[1:].tolist())}
    meshes = []
    for f, chart in enumerate(charts):
        forced: set[tuple[int, int]] = set()
        grid = grids.get(f)
        for _ in range(6):
            made = _mesh_face(brep, f, chart, edges, count, sizing, forced, grid, f"{where}: {brep.faces[f].name}")
            pairs = interior_pairs(made)
            double = [(a, b) for (a, b), g in pairs.items() if g in taken]
            if not double:
                break
            grid = _without(made, double)
            forced |= set(double)
        taken |= set(pairs.values())
        count += len(made.points) - int((made.vertices < count).sum())
        meshes.append(made)
    return meshes


def _without(made: FaceMesh, double: list[tuple[int, int]]) -> Grid | None:
    """Grid without the cells that have a side that is taken."""
    if made.grid is None or not len(made.quads):
        return made.grid
    kept = made.grid.kept.copy()
    sides = np.sort(np.stack([made.quads, np.roll(made.quads, -1, axis=1)], axis=2), axis=2)
    wrong = {tuple(sorted(pair)) for pair in double}
    bad = [q for q, own in enumerate(sides.tolist()) if any(tuple(pair) in wrong for pair in own)]
    places = np.argwhere(kept)
    kept[tuple(places[bad].T)] = False
    return replace(made.grid, kept=kept)


def interior_pairs(made: FaceMesh) -> dict[tuple[int, int], tuple[int, int]]:
    """Interior sides by local vertices, with their vertices in the solid."""
    t, q = made.triangles, made.quads
    sides = np.concatenate([*(t[:, [k, (k + 1) % 3]] for k in range(3)), *(q[:, [k, (k + 1) % 4]] for k in range(4))])
    unique, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    inner = unique[counts == 2]
    ends = np.sort(made.vertices[inner], axis=1)
    return {(a, b): (c, d) for (a, b), (c, d) in zip(inner.tolist(), ends.tolist())}


def _outline(brep: Brep, number: int, chart: Chart, edges: list[Pieces], where: str) -> _Outline:
    points: list[Array] = []
    parameters: list[Array] = []
    names: list[Index] = []
    loops: list[Index] = []
    leaving: Sides = {}
    placed = 0
    for loop in brep.faces[number].loops:
        control: list[Array] = []
        for c in loop:
            if brep.edges[c.edge].degenerate:
                continue
            piece = edges[c.edge]
            t, v = (piece.ends[::-1], piece.vertices[::-1]) if c.reversed else (piece.ends, piece.vertices)
            uv = curve_points(c.curve, t)
            parameters.append(uv[:-1])
            points.append(to_chart(chart, uv[:-1]))
            names.append(v[:-1])
            control.append(piece.control[::-1, ::-1] if c.reversed else piece.control)
        size = sum(map(len, control))
        if size < 3:
            raise FaceError(number, f"{where}: a loop of {size} pieces")
        ring = placed + np.arange(size)
        for a, b, own in zip(ring.tolist(), np.roll(ring, -1).tolist(), np.concatenate(control)):
            leaving[a, b] = (own[1] - own[0], own[3] - own[2])
        loops.append(ring)
        placed += size
    return _Outline(np.concatenate(points), np.concatenate(parameters), np.concatenate(names), loops, leaving)


def _mesh_face(
    brep: Brep, number: int, chart: Chart, edges: list[Pieces], count: int, sizing: Sizing,
    forced: set[tuple[int, int]], grid: Grid | None, where: str,
) -> FaceMesh:  # fmt: skip
    face = brep.faces[number]
    outline = _outline(brep, number, chart, edges, where)
    placed = len(outline.points)
    nodes, extra, uv = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 2)), outline.uv
    low = high = np.zeros((0, 2))
    if grid is not None and grid.kept.any():
        grid, nodes, extra = _cells(brep, number, outline, grid)
        uv = np.concatenate([uv, extra])
        i, j = np.nonzero(grid.kept)
        low = np.stack([grid.lines[0][i], grid.lines[1][j]], axis=1)
        high = np.stack([grid.lines[0][i + 1], grid.lines[1][j + 1]], axis=1)
    points = np.concatenate([outline.points, to_chart(chart, extra)])
    sides = _cut_out(face, uv, nodes, outline.leaving)
    middle = outline.points.mean(axis=0)
    rest, triangles = points, np.zeros((0, 3), dtype=np.int64)
    made = []
    for part in _regions(points, sides):
        used = np.unique(np.concatenate(part))
        loops = [np.searchsorted(used, ring) for ring in part]
        smooth = _smooth(face, uv, part, used, sides)
        place = {v: k for k, v in enumerate(used.tolist())}
        apart = {(place[a], place[b]) for a, b in forced if a in place and b in place}
        try:
            mesh = triangulate(
                points[used], loops, smooth, lambda at: _frame(face, chart, at, middle), lambda x: size_at(sizing, x),
                apart, where
            )
        except InputError as error:
            raise FaceError(number, str(error)) from error
        names = np.concatenate([used, len(rest) + np.arange(len(mesh.vertices) - len(used))])
        rest = np.concatenate([rest, mesh.vertices[len(used) :]])
        made.append(names[mesh.triangles])
    if made:
        triangles = np.concatenate(made)
    own = np.concatenate([outline.vertices, count + np.arange(len(rest) - placed)])
    _require_outline(number, outline, triangles, nodes, where)
    return FaceMesh(chart, rest, own, triangles, nodes, low, high, grid)


def _require_outline(number: int, outline: _Outline, triangles: Index, quads: Index, where: str) -> None:
    """The sides that belong to one element are the pieces of the edges, no more and no less."""
    sides = Counter(
        (a, b) for own in (triangles, quads) for ring in own.tolist() for a, b in zip(ring, [*ring[1:], ring[0]])
    )
    open_ = {pair for pair in sides if pair[::-1] not in sides}
    if open_ != set(outline.leaving) or (sides and max(sides.values()) > 1):
        raise FaceError(number, f"{where}: its elements do not end at its edges")


def _cut_out(face: Face, uv: Array, nodes: Index, leaving: Sides) -> Sides:
    """Sides of what is left when cells (q, 4) are cut out; sides that cancel vanish."""
    left = dict(leaving)
    if not len(nodes):
        return left
    _, du, dv = surface_frame(face.surface, uv[nodes.ravel()])
    way = np.stack([du, dv], axis=1).reshape(-1, 4, 2, 3)
    for q, own in enumerate(nodes.tolist()):
        for k in range(4):
            a, b = own[k], own[(k + 1) % 4]
            if left.pop((a, b), None) is None:
                sign = -1.0 if k < 2 else 1.0
                left[b, a] = (sign * way[q, (k + 1) % 4, k % 2], sign * way[q, k, k % 2])
    return left


def _cells(brep: Brep, number: int, outline: _Outline, grid: Grid) -> tuple[Grid, Index, Array]:
    """Carry out a grid: corners (q, 4) of its cells, parameters of vertices inside the face; cells that do not fit the
    pieces of the edges are dropped.
    """
    face = brep.faces[number]
    m, n = grid.kept.shape
    name = np.full((m + 1, n + 1), -1)
    reach = [100 * ALONG * float(np.ptp(k)) for k in face.surface.knots]
    place, on = [], np.ones(len(outline.uv), dtype=bool)
    for d in range(2):
        at = np.abs(outline.uv[:, d, None] - grid.lines[d]).argmin(axis=1)
        on &= np.abs(outline.uv[:, d] - grid.lines[d][at]) <= reach[d]
        place.append(at)
    vertex = np.flatnonzero(on)
    name[place[0][vertex], place[1][vertex]] = vertex
    kept = grid.kept.copy()
    covered = _covered(face, grid, reach)
    sides = outline.leaving
    for row, column in np.argwhere(kept).tolist():
        corner = [(row + a, column + b) for a, b in _AROUND]
        for k in range(4):
            (p, q), (r, s) = corner[k], corner[(k + 1) % 4]
            on_edge = covered[k % 2][min(p, r), min(q, s)]
            if on_edge and (name[p, q], name[r, s]) not in sides:
                kept[row, column] = False
    used = np.zeros((m + 1, n + 1), dtype=bool)
    for a, b in _AROUND:
        used[a : a + m, b : b + n] |= kept
    new = np.argwhere(used & (name < 0))
    name[tuple(new.T)] = len(outline.uv) + np.arange(len(new))
    extra = np.stack([grid.lines[0][new[:, 0]], grid.lines[1][new[:, 1]]], axis=1)
    i, j = np.nonzero(kept)
    nodes = np.stack([name[i + a, j + b] for a, b in _AROUND], axis=1)
    return replace(grid, kept=kept), nodes.reshape(-1, 4), extra


def _covered(face: Face, grid: Grid, reach: list[float]) -> tuple[Mask, Mask]:
    """Grid sides along u (m, n + 1) and along v (m + 1, n) that lie on an edge, wholly or in part."""
    m, n = grid.kept.shape
    along = (np.zeros((m, n + 1), dtype=bool), np.zeros((m + 1, n), dtype=bool))
    for loop in face.loops:
        for c in loop:
            d = followed(c, face.surface)
            if d < 0:
                continue
            line = int(np.abs(grid.lines[d] - c.curve.control[:, d].mean()).argmin())
            low, high = np.sort(c.curve.control[[0, -1], 1 - d])
            x = grid.lines[1 - d]
            hit = (x[:-1] < high - reach[1 - d]) & (x[1:] > low + reach[1 - d])
            if d == 0:
                along[1][line, hit] = True
            else:
                along[0][hit, line] = True
    return along


def _regions(points: Array, sides: Sides) -> list[list[Index]]:
    """Loops of the regions on the left of directed sides, each region's outer loop first."""
    out: dict[int, list[int]] = {}
    for a, b in sides:
        out.setdefault(a, []).append(b)
    left = set(sides)
    rings = []
    while left:
        a, b = min(left)
        ring = []
        while (a, b) in left:
            left.discard((a, b))
            ring.append(a)
            a, b = b, _first(points, a, b, out[b])
        rings.append(np.array(ring))
    areas = [_area(points[ring]) for ring in rings]
    outer = [k for k, area in enumerate(areas) if area > 0.0]
    regions = {k: [rings[k]] for k in outer}
    for k, area in enumerate(areas):
        if area <= 0.0:
            home = [o for o in outer if areas[o] > -area and _holds(points[rings[o]], points[rings[k]])]
            if home:
                regions[min(home, key=lambda o: areas[o])].append(rings[k])
    return list(regions.values())


def _first(points: Array, a: int, b: int, choices: list[int]) -> int:
    """The choice met first when turning clockwise from b's side to a: the region between stays on the left."""
    if len(choices) == 1:
        return choices[0]
    back = points[a] - points[b]

    def turn(c: int) -> float:
        way = points[c] - points[b]
        angle = float(np.arctan2(back[1] * way[0] - back[0] * way[1], back @ way))
        return angle % (2.0 * np.pi)

    return min(choices, key=turn)


def _area(ring: Array) -> float:
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float(np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


def _holds(ring: Array, other: Array) -> bool:
    """Whether most sides' middles of another ring lie inside a ring; the two may touch."""
    p = 0.5 * (other + np.roll(other, -1, axis=0))
    end = np.roll(ring, -1, axis=0)
    crossed = (ring[:, 1] > p[:, 1, None]) != (end[:, 1] > p[:, 1, None])
    rise = np.where(end[:, 1] == ring[:, 1], 1.0, end[:, 1] - ring[:, 1])
    at = ring[:, 0] + (p[:, 1, None] - ring[:, 1]) / rise * (end[:, 0] - ring[:, 0])
    return bool(((crossed & (at > p[:, :1])).sum(axis=1) % 2 == 1).mean() > 0.5)


def _smooth(
    face: Face, uv: Array, part: list[Index], used: Index, sides: Sides
) -> Mask:
    """Where the angle inside the region is so large that a vertex must not be the tip of an ear."""
    _, du, dv = surface_frame(face.surface, uv[used])
    normal = np.cross(du, dv)
    flags = np.zeros(len(used), dtype=bool)
    before, at, after = (np.concatenate([np.roll(ring, step) for ring in part]) for step in (1, 0, -1))
    once = np.bincount(np.searchsorted(used, at), minlength=len(used))[np.searchsorted(used, at)] == 1
    before, at, after = before[once], at[once], after[once]
    if len(at):
        arriving = np.array([sides[pair][1] for pair in zip(before.tolist(), at.tolist())])
        leaving = np.array([sides[pair][0] for pair in zip(at.tolist(), after.tolist())])
        place = np.searchsorted(used, at)
        flags[place] = _inner_angles(arriving, leaving, normal[place]) > SMOOTH
    return flags


def _inner_angles(arriving: Array, leaving: Array, normal: Array) -> Array:
    """Angles (k,) inside a region on the left of a boundary that arrives and leaves along given directions (k, 3)."""
    size = np.linalg.norm(normal, axis=1)
    across = np.einsum("kc,kc->k", np.cross(arriving, leaving), normal) / np.where(size > 0.0, size, 1.0)
    turn = np.arctan2(across, np.einsum("kc,kc->k", arriving, leaving))
    return np.where(size > 0.0, np.pi - turn, 0.0)


def _frame(face: Face, chart: Chart, at: Array, middle: Array) -> tuple[Array, Array]:
    """Points and unit normals of chart points; at poles the normal beside them, towards a point in the middle."""
    x, du, dv = surface_frame(face.surface, to_parameters(chart, at))
    n = np.cross(du, dv)
    length = np.linalg.norm(n, axis=1)
    flat = length < 1e-6 * (np.median(length) if len(length) > 2 else 0.0)
    if flat.any():
        _, du, dv = surface_frame(face.surface, to_parameters(chart, at + 1e-4 * (middle - at)))
        n[flat] = np.cross(du, dv)[flat]
    return x, n / (np.linalg.norm(n, axis=1)[:, None] + 1e-300)
