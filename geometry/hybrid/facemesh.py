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
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face, surface_frame
from geometry.hybrid.banding import Banding
from geometry.hybrid.chart import Chart, to_chart, to_parameters, widths
from geometry.hybrid.cutting import Cut, cut_cells, rectangles, with_band, without_cells
from geometry.hybrid.grid import Grid
from geometry.hybrid.outline import FaceError, Outline, Sides, cut_out, outline_of, regions
from geometry.hybrid.pieces import Pieces
from geometry.hybrid.poles import PolarCells, corners_of
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
        barred: set[tuple[int, int]] = set()
        grid = grids.get(f)
        name = f"{where}: {brep.faces[f].name}"
        for _ in range(TRIES):
            made = _mesh_face(brep, f, chart, edges, count, sizing, barred, grid, name, f in banded)
            pairs = interior_pairs(made)
            double = [(a, b) for (a, b), g in pairs.items() if g in taken]
            if not double:
                break
            grid = _without(made, double)
            barred |= set(double)
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
    return without_cells(made.grid, centres)


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
    barred: set[tuple[int, int]], grid: Grid | None, where: str, banded: bool,
) -> FaceMesh:  # fmt: skip
    """Mesh of a face with new vertices numbered from ``count`` on, and no side between ``barred`` pairs of vertices."""
    face = brep.faces[number]
    outline = outline_of(brep, number, chart, edges, where)
    cut = Cut()
    if grid is not None:
        cut = cut_cells(brep, number, outline, grid)
        cut = with_band(brep, number, chart, outline, cut) if banded else cut
    uv = np.concatenate([outline.uv, cut.extra])
    sides = _sides_left(face, outline, cut, uv)
    points = np.concatenate([outline.points, to_chart(chart, cut.extra)])
    points, filled = _filled(number, face, chart, points, uv, sides, sizing, barred, where)
    polar = np.zeros((0, 3), dtype=np.int64) if cut.polar is None else cut.polar.corners
    triangles = np.concatenate([cut.corners, polar, *filled])
    own = np.concatenate([outline.vertices, count + np.arange(len(points) - len(outline.points))])
    _require_outline(number, outline, triangles, cut.nodes, where)
    low, high = rectangles(cut)
    legs = np.concatenate([cut.corners[:, 1:], cut.corners[:, [2, 0]], *(polar[:, [k, (k + 1) % 3]] for k in range(3))])
    return FaceMesh(chart, points, own, triangles, cut.nodes, low, high, cut.grid, cut.band, legs, cut.polar)


def _sides_left(face: Face, outline: Outline, cut: Cut, uv: Array) -> Sides:
    """Sides of what is left of a face when elements are cut out; ``uv`` (n, 2) parameters of the vertices."""
    rings, places = [*cut.corners.tolist(), *cut.nodes.tolist()], [uv[cut.corners.ravel()], uv[cut.nodes.ravel()]]
    if cut.polar is not None:
        rings += cut.polar.corners[:, [0, 0, 1, 2]].tolist()
        places.append(corners_of(cut.polar).reshape(-1, 2))
    return cut_out(face, rings, np.concatenate(places), outline.leaving)


def _filled(
    number: int, face: Face, chart: Chart, points: Array, uv: Array, sides: Sides, sizing: Sizing,
    barred: set[tuple[int, int]], where: str,
) -> tuple[Array, list[Index]]:  # fmt: skip
    """Vertices in the chart, the given ones (n, 2) first, and triangles (t, 3) of each region between sides.

    Raises
    ------
    FaceError : the sides do not close, or a region cannot be triangulated.
    """
    try:
        parts = regions(points, sides)
    except InputError as error:
        raise FaceError(number, f"{where}: {error}") from error
    made: list[Index] = []
    rest = points
    try:
        for part in parts:
            used = np.unique(np.concatenate(part))
            loops = [np.searchsorted(used, ring) for ring in part]
            place = {v: k for k, v in enumerate(used.tolist())}
            apart = {(place[a], place[b]) for a, b in barred if a in place and b in place}
            mesh = triangulate(
                points[used], loops, _smooth(face, uv, part, used, sides), lambda at: _frame(face, chart, at),
                lambda x: size_at(sizing, x), apart, where,
            )
            names = np.concatenate([used, len(rest) + np.arange(len(mesh.vertices) - len(used))])
            rest = np.concatenate([rest, mesh.vertices[len(used) :]])
            made.append(names[mesh.triangles])
    except InputError as error:
        raise FaceError(number, str(error)) from error
    return rest, made


def _require_outline(number: int, outline: Outline, triangles: Index, quads: Index, where: str) -> None:
    """The sides that belong to one element are the pieces of the edges, no more and no less."""
    sides = Counter(
        (a, b) for own in (triangles, quads) for ring in own.tolist() for a, b in zip(ring, [*ring[1:], ring[0]])
    )
    open_ = {pair for pair in sides if pair[::-1] not in sides}
    if open_ != set(outline.leaving) or (sides and max(sides.values()) > 1):
        raise FaceError(number, f"{where}: its elements do not end at its edges")


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
