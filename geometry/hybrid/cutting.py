r"""Elements that are cut out of a face before the rest is triangulated: cells between parameter lines, and a band.

The kept cells of a face's grid (`grid`) become quadrilaterals, or triangles at poles (`poles`), where they fit the
pieces of the edges. For an HB-rep right triangles and rectangles along the trimming curves (`banding`) are cut out as
well, and cells in their way are not.

Axis letters: n vertex, q quadrilateral, t triangle, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.cad.brep import Brep, Face
from geometry.hybrid.banding import NEAR, Banding, band_elements
from geometry.hybrid.chart import Chart, lengths_of
from geometry.hybrid.grid import ON_LINE, Grid, followed
from geometry.hybrid.outline import Outline
from geometry.hybrid.poles import AROUND, PolarCells

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cut:
    """Elements that are cut out of a face.

    Attributes
    ----------
    grid : as it was carried out.
    nodes : (q, 4) vertices of its cells, and of the band's rectangles after them.
    extra : (k, 2) parameters of vertices inside the face, numbered after those of the outline.
    polar : triangles at poles.
    corners : (t, 3) vertices of the band's right triangles.
    band : the band.
    """

    grid: Grid | None = None
    nodes: Index = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int64))
    extra: Array = field(default_factory=lambda: np.zeros((0, 2)))
    polar: PolarCells | None = None
    corners: Index = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    band: Banding | None = None


def with_band(brep: Brep, number: int, chart: Chart, outline: Outline, cut: Cut) -> Cut:
    """Right triangles and rectangles along the curves of a face, and its cells without those in the way of these."""
    assert cut.grid is not None
    following = np.concatenate([np.roll(ring, -1) for ring in outline.loops])
    boxes = np.concatenate([outline.uv, cut.extra])[cut.nodes[:, [0, 2]]]
    if cut.polar is not None:
        boxes = np.concatenate([boxes, np.stack([cut.polar.low, cut.polar.high], axis=1)])
    band = band_elements(outline.plane, following, cut.grid.lines, boxes, chart)
    if band.crowded.any():
        cut = cut_cells(brep, number, outline, without_cells(cut.grid, boxes[band.crowded].mean(axis=1)))
    ring = np.stack([np.stack([(band.low, band.high)[a][:, 0], (band.low, band.high)[b][:, 1]], axis=1)
                     for a, b in AROUND], axis=1)
    new = np.concatenate([band.corner, ring.reshape(-1, 2)])
    names, uv = joined(np.concatenate([outline.uv, cut.extra]), new, lengths_of(chart))
    t = len(band.segment)
    corners = np.column_stack([band.segment, following[band.segment], names[:t]])
    nodes = np.concatenate([cut.nodes, names[t:].reshape(-1, 4)])
    return replace(cut, nodes=nodes, extra=uv[len(outline.uv) :], corners=corners, band=band)


def without_cells(grid: Grid, centres: Array) -> Grid:
    """Grid without the cells around points of the parameter plane."""
    at = tuple(np.searchsorted(x, centres[:, d]) - 1 for d, x in enumerate(grid.lines))
    kept, polar = grid.kept.copy(), grid.polar.copy()
    kept[at] = polar[at] = False
    return replace(grid, kept=kept, polar=polar)


def cut_cells(brep: Brep, number: int, outline: Outline, grid: Grid) -> Cut:
    """Cells of the grid of a face; those that do not fit the pieces of the edges are dropped."""
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
    return Cut(replace(grid, kept=kept, polar=polar), nodes.reshape(-1, 4), extra, _polar_cells(grid, polar, name))


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


def rectangles(cut: Cut) -> tuple[Array, Array]:
    """Lowest and highest corners (q, 2) of the quadrilaterals: the cells that are kept, and a band's rectangles."""
    grid, band = cut.grid, cut.band
    if grid is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    i, j = np.nonzero(grid.kept)
    low = np.stack([grid.lines[0][i], grid.lines[1][j]], axis=1)
    high = np.stack([grid.lines[0][i + 1], grid.lines[1][j + 1]], axis=1)
    return (low, high) if band is None else (np.concatenate([low, band.low]), np.concatenate([high, band.high]))


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
