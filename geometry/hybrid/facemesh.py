r"""Meshes of faces in their charts: quadrilaterals between parameter lines, triangles from there to the edges.

The kept cells of a face's grid (`grid`) are cut out of it; what is left is bounded by the pieces of the edges and by
the outline of the cells, and is triangulated (`triangulation`). Sides that an edge and a cell share vanish from that
boundary, so a face of parameter lines alone needs no triangle. For an HB-rep the right triangles and rectangles along
the trimming curves (`banding`) are cut out too, and general triangles lie between those and the cells.

Axis letters: n vertex, e element, k side, c corner.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.cad.brep import Brep, Face, surface_frame
from geometry.hybrid.banding import NEAR, Banding, band_elements
from geometry.hybrid.chart import Chart, lengths_of, to_chart, to_parameters, widths
from geometry.hybrid.grid import ON_LINE, Grid, followed
from geometry.hybrid.outline import FaceError, Outline, Sides, cut_out, outline_of, regions
from geometry.hybrid.pieces import Pieces
from geometry.hybrid.poles import AROUND, PolarCells, corners_of
from geometry.hybrid.sizing import Sizing, size_at
from geometry.hybrid.triangulation import triangulate
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

TRIES = 6
"""How often a face is meshed without sides that others have: new vertices make new sides, rarely such ones again."""
SMOOTH = 2.3
"""Boundary vertices with a larger angle (radians) inside the face must not be the tip of an ear."""


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
    band : the right triangles, which come first, and the rectangles, which come last, if the face has a band.
    legs : (l, 2) local numbers of the ends of sides of triangles that follow parameter lines.
    polar : cells at poles, whose triangles follow the right triangles.
    """

    chart: Chart
    points: Array
    vertices: Index
    triangles: Index
    quads: Index
    low: Array
    high: Array
    grid: Grid | None
    band: Banding | None = None
    legs: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    polar: PolarCells | None = None

    @property
    def first_polar(self) -> int:
        """Number of the first triangle at a pole."""
        return 0 if self.band is None else len(self.band.segment)

    @property
    def outward(self) -> Index:
        """The triangles turned so that their normals leave the solid."""
        return self.triangles[:, ::-1] if self.chart.face.reversed else self.triangles


def mesh_faces(
    brep: Brep, charts: list[Chart], edges: list[Pieces], count: int, sizing: Sizing, grids: dict[int, Grid],
    where: str, banded: Collection[int] = (),
) -> list[FaceMesh]:  # fmt: skip
    """Meshes of all faces, without interior sides between vertices that are joined elsewhere.

    Parameters
    ----------
    banded : faces that get right triangles and rectangles along their trimming curves.

    Raises
    ------
    FaceError : a face cannot be meshed with these pieces.
    """
    taken = {tuple(sorted(pair)) for p in edges for pair in zip(p.vertices[:-1].tolist(), p.vertices[1:].tolist())}
    meshes = []
    for f, chart in enumerate(charts):
        forced: set[tuple[int, int]] = set()
        grid = grids.get(f)
        name = f"{where}: {brep.faces[f].name}"
        for _ in range(TRIES):
            made = _mesh_face(brep, f, chart, edges, count, sizing, forced, grid, name, f in banded)
            pairs = interior_pairs(made)
            double = [(a, b) for (a, b), g in pairs.items() if g in taken]
            if not double:
                break
            grid = _without(made, double)
            forced |= set(double)
        else:
            raise FaceError(f, f"{name}: sides of its elements are sides of elements on other faces as well")
        taken |= set(pairs.values())
        count += len(made.points) - int((made.vertices < count).sum())
        meshes.append(made)
    return meshes


def _without(made: FaceMesh, double: list[tuple[int, int]]) -> Grid | None:
    """Grid without the cells that have a side that is taken."""
    if made.grid is None:
        return None
    wrong = {tuple(sorted(pair)) for pair in double}

    def have_it(rings: Index) -> Mask:
        sides = np.sort(np.stack([rings, np.roll(rings, -1, axis=1)], axis=2), axis=2)
        return np.array([any(tuple(pair) in wrong for pair in own) for own in sides.tolist()], dtype=bool)

    count = int(made.grid.kept.sum())  # rectangles of a band come after the cells
    bad = have_it(made.quads[:count])
    centres = 0.5 * (made.low[:count] + made.high[:count])[bad]
    if made.polar is not None:
        tips = 0.5 * (made.polar.low + made.polar.high)
        centres = np.concatenate([centres, tips[have_it(made.polar.corners)]])
    return _without_cells(made.grid, centres)


def interior_pairs(made: FaceMesh) -> dict[tuple[int, int], tuple[int, int]]:
    """Interior sides by local vertices, with their vertices in the solid."""
    t, q = made.triangles, made.quads
    sides = np.concatenate([*(t[:, [k, (k + 1) % 3]] for k in range(3)), *(q[:, [k, (k + 1) % 4]] for k in range(4))])
    unique, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    inner = unique[counts == 2]
    ends = np.sort(made.vertices[inner], axis=1)
    return {(a, b): (c, d) for (a, b), (c, d) in zip(inner.tolist(), ends.tolist())}


def _mesh_face(
    brep: Brep, number: int, chart: Chart, edges: list[Pieces], count: int, sizing: Sizing,
    forced: set[tuple[int, int]], grid: Grid | None, where: str, banded: bool,
) -> FaceMesh:  # fmt: skip
    face = brep.faces[number]
    outline = outline_of(brep, number, chart, edges, where)
    placed = len(outline.points)
    corners, band = np.zeros((0, 3), dtype=np.int64), None
    nodes, extra, polar = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 2)), None
    if grid is not None:
        cells = _cells(brep, number, outline, grid)
        if banded:
            cells, corners, band = _banded(brep, number, chart, outline, cells)
        grid, nodes, extra, polar = cells.grid, cells.nodes, cells.extra, cells.polar
    uv = np.concatenate([outline.uv, extra])
    low, high = _rectangles(grid, band)
    points = np.concatenate([outline.points, to_chart(chart, extra)])
    rings, places = [*corners.tolist(), *nodes.tolist()], uv[np.concatenate([corners.ravel(), nodes.ravel()])]
    if polar is not None:
        rings += polar.corners[:, [0, 0, 1, 2]].tolist()
        places = np.concatenate([places, corners_of(polar).reshape(-1, 2)])
    sides = cut_out(face, rings, places, outline.leaving)
    rest, made = points, [corners] if polar is None else [corners, polar.corners]
    try:
        parts = regions(points, sides)
    except InputError as error:
        raise FaceError(number, f"{where}: {error}") from error
    for part in parts:
        used = np.unique(np.concatenate(part))
        loops = [np.searchsorted(used, ring) for ring in part]
        smooth = _smooth(face, uv, part, used, sides)
        place = {v: k for k, v in enumerate(used.tolist())}
        apart = {(place[a], place[b]) for a, b in forced if a in place and b in place}
        try:
            mesh = triangulate(
                points[used], loops, smooth, lambda at: _frame(face, chart, at), lambda x: size_at(sizing, x),
                apart, where
            )
        except InputError as error:
            raise FaceError(number, str(error)) from error
        names = np.concatenate([used, len(rest) + np.arange(len(mesh.vertices) - len(used))])
        rest = np.concatenate([rest, mesh.vertices[len(used) :]])
        made.append(names[mesh.triangles])
    triangles = np.concatenate(made)
    own = np.concatenate([outline.vertices, count + np.arange(len(rest) - placed)])
    _require_outline(number, outline, triangles, nodes, where)
    legs = [corners[:, 1:], corners[:, [2, 0]]]
    if polar is not None:
        legs += [polar.corners[:, [k, (k + 1) % 3]] for k in range(3)]
    return FaceMesh(chart, rest, own, triangles, nodes, low, high, grid, band, np.concatenate(legs), polar)


def _require_outline(number: int, outline: Outline, triangles: Index, quads: Index, where: str) -> None:
    """The sides that belong to one element are the pieces of the edges, no more and no less."""
    sides = Counter(
        (a, b) for own in (triangles, quads) for ring in own.tolist() for a, b in zip(ring, [*ring[1:], ring[0]])
    )
    open_ = {pair for pair in sides if pair[::-1] not in sides}
    if open_ != set(outline.leaving) or (sides and max(sides.values()) > 1):
        raise FaceError(number, f"{where}: its elements do not end at its edges")


def _rectangles(grid: Grid | None, band: Banding | None) -> tuple[Array, Array]:
    """Lowest and highest corners of the cells that are kept, and of the rectangles of a band."""
    if grid is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    i, j = np.nonzero(grid.kept)
    low = np.stack([grid.lines[0][i], grid.lines[1][j]], axis=1)
    high = np.stack([grid.lines[0][i + 1], grid.lines[1][j + 1]], axis=1)
    return (low, high) if band is None else (np.concatenate([low, band.low]), np.concatenate([high, band.high]))


@dataclass(frozen=True, eq=False)
class _Cells:
    """A grid carried out: corners (q, 4) of its cells, parameters of vertices inside the face, triangles at poles."""

    grid: Grid
    nodes: Index
    extra: Array
    polar: PolarCells | None


def _banded(
    brep: Brep, number: int, chart: Chart, outline: Outline, cells: _Cells
) -> tuple[_Cells, Index, Banding | None]:
    """Cells once there are right triangles (t, 3) and rectangles along the curves; rectangles come last."""
    grid, nodes, extra = cells.grid, cells.nodes, cells.extra
    following = np.concatenate([np.roll(ring, -1) for ring in outline.loops])
    uv = np.concatenate([outline.uv, extra])
    boxes = uv[nodes[:, [0, 2]]]
    if cells.polar is not None:
        boxes = np.concatenate([boxes, np.stack([cells.polar.low, cells.polar.high], axis=1)])
    band = band_elements(outline.plane, following, grid.lines, boxes, chart)
    if band.crowded.any():
        cells = _cells(brep, number, outline, _without_cells(grid, boxes[band.crowded].mean(axis=1)))
        nodes, extra = cells.nodes, cells.extra
        uv = np.concatenate([outline.uv, extra])
    ring = np.stack([np.stack([(band.low, band.high)[a][:, 0], (band.low, band.high)[b][:, 1]], axis=1)
                     for a, b in AROUND], axis=1)
    new = np.concatenate([band.corner, ring.reshape(-1, 2)])
    names, uv = joined(uv, new, lengths_of(chart))
    t = len(band.segment)
    corners = np.column_stack([band.segment, following[band.segment], names[:t]])
    nodes = np.concatenate([nodes, names[t:].reshape(-1, 4)])
    return replace(cells, nodes=nodes, extra=uv[len(outline.uv) :]), corners, band


def _without_cells(grid: Grid, centres: Array) -> Grid:
    """Grid without the cells around points of the parameter plane."""
    at = tuple(np.searchsorted(x, centres[:, d]) - 1 for d, x in enumerate(grid.lines))
    kept, polar = grid.kept.copy(), grid.polar.copy()
    kept[at] = polar[at] = False
    return replace(grid, kept=kept, polar=polar)


def _cells(brep: Brep, number: int, outline: Outline, grid: Grid) -> _Cells:
    """Carry out a grid; cells that do not fit the pieces of the edges are dropped."""
    face = brep.faces[number]
    m, n = grid.kept.shape
    name = np.full((m + 1, n + 1), -1)
    reach = [ON_LINE * float(np.ptp(k)) for k in face.surface.knots]
    place, on = [], np.ones(len(outline.uv), dtype=bool)
    for d in range(2):
        at = np.abs(outline.uv[:, d, None] - grid.lines[d]).argmin(axis=1)
        on &= np.abs(outline.uv[:, d] - grid.lines[d][at]) <= reach[d]
        place.append(at)
    vertex = np.flatnonzero(on)
    name[place[0][vertex], place[1][vertex]] = vertex
    kept, polar = grid.kept.copy(), grid.polar.copy()
    for pole in grid.poles:
        at = np.flatnonzero(outline.vertices == pole.vertex)
        if len(at) == 1:
            pole.onwards(name)[0] = at[0]
        else:  # the loops pass it several times
            pole.onwards(polar)[0] = False
    covered = _covered(face, grid, reach)
    sides = outline.leaving
    for row, column in np.argwhere(kept | polar).tolist():
        corner = [(row + a, column + b) for a, b in AROUND]
        for k in range(4):
            (p, q), (r, s) = corner[k], corner[(k + 1) % 4]
            if name[p, q] == name[r, s] >= 0:
                continue  # the side at a pole
            on_edge = covered[k % 2][min(p, r), min(q, s)]
            if on_edge and (name[p, q], name[r, s]) not in sides:
                kept[row, column] = polar[row, column] = False
    used = np.zeros((m + 1, n + 1), dtype=bool)
    for a, b in AROUND:
        used[a : a + m, b : b + n] |= kept | polar
    new = np.argwhere(used & (name < 0))
    name[tuple(new.T)] = len(outline.uv) + np.arange(len(new))
    extra = np.stack([grid.lines[0][new[:, 0]], grid.lines[1][new[:, 1]]], axis=1)
    i, j = np.nonzero(kept)
    nodes = np.stack([name[i + a, j + b] for a, b in AROUND], axis=1)
    return _Cells(replace(grid, kept=kept, polar=polar), nodes.reshape(-1, 4), extra, _polar_cells(grid, polar, name))


def _polar_cells(grid: Grid, polar: Mask, name: Index) -> PolarCells | None:
    """Triangles at poles, from the numbers of the grid's vertices."""
    parts = []
    for pole in grid.poles:
        mine = np.zeros_like(polar)
        pole.onwards(mine)[0] = pole.onwards(polar)[0]
        i, j = np.nonzero(mine)
        low = np.stack([grid.lines[0][i], grid.lines[1][j]], axis=1)
        high = np.stack([grid.lines[0][i + 1], grid.lines[1][j + 1]], axis=1)
        around = [AROUND[(pole.side + k) % 4] for k in (0, 2, 3)]
        corners = np.stack([name[i + a, j + b] for a, b in around], axis=1)
        parts.append((low, high, np.full(len(i), pole.side), corners))
    return PolarCells(*map(np.concatenate, zip(*parts))) if polar.any() else None


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


def _frame(face: Face, chart: Chart, at: Array) -> tuple[Array, Array]:
    """Points and unit normals of chart points; zero at poles, where there may be many."""
    x, du, dv = surface_frame(face.surface, to_parameters(chart, at))
    n = np.cross(du, dv)
    length = np.linalg.norm(n, axis=1)
    if chart.poles:
        n[widths(chart, at) == 0.0] = 0.0
    return x, n / (length[:, None] + 1e-300)


def joined(points: Array, new: Array, scale: Array) -> tuple[Index, Array]:
    """Numbers (k,) of new points (k, 2) among points (n, 2), and all points, those that are near to one before once.

    ``scale``: lengths (2,) of unit steps.
    """
    everything = np.concatenate([points, new])
    reach = NEAR * float(np.linalg.norm(np.ptp(everything * scale, axis=0)))
    pairs = cKDTree(everything * scale).query_pairs(reach, output_type="ndarray")
    first = np.arange(len(everything))
    for a, b in sorted(map(sorted, pairs.tolist()), key=lambda pair: pair[0]):
        if b >= len(points):
            first[b] = min(first[b], first[a])
    own = np.unique(first)
    return np.searchsorted(own, first[len(points) :]), everything[own]
