"""A surface divided into patches, one per boundary side of a meccano, and ways to make the division better.

Patches are disks with four corners; borders run along edges of the surface and follow each other as the meccano's do.

Better means straight and even: the patches around a corner (on both sides of a border) are laid together on a regular
polygon (a rectangle) by mean values, and the corner moves to its middle (the border to its middle line). Every step
keeps the division a division, however bad it was before
[A. Khodakovsky, N. Litke, P. Schroeder, Globally smooth parameterizations with low distortion, SIGGRAPH 2003].

Axis letters: t triangle, f boundary side, n corner of the meccano, b vertex of a border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.layouts.blocks import Blocks
from geometry.simplices.mean_value import mean_value
from geometry.simplices.paths import Path, chord_shares, loop_of, straight, trace, without_chords
from geometry.simplices.surface import CLEAN, Surface, area_vectors, edge_rows, sharp
from iga.cells import QUADRILATERAL
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ROUND = (0, 2, 3, 1)
"""Corners of a side in the order of its orientation, as vertices of the quadrilateral."""
SQUARE = QUADRILATERAL.vertices[list(ROUND)]
"""Their places."""
FOLLOWED = 0.8
"""A border that follows creases for this part of its length is left there."""
NEAR = 0.3
"""How near the middle, in radii of the polygon, a corner of the surface attracts a corner of the patches."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A division of a surface.

    Attributes
    ----------
    blocks : the meccano.
    surface : the surface; borders run along its edges.
    side : (t,) the boundary side, a row of ``blocks.boundary_sides``, that each triangle belongs to.
    corner : (n,) vertex at each corner of the meccano; -1 at inner corners.
    """

    blocks: Blocks
    surface: Surface
    side: Index
    corner: Index


def round_corners(blocks: Blocks) -> Index:
    """Corners (f, 4) of the boundary sides in the order of their orientation, from the one with s = (0, 0)."""
    faces = np.array([np.array(face.vertices)[list(ROUND)] for face in blocks.cell.faces])
    block, side = blocks.boundary_sides.T
    return blocks.corners[block[:, None], faces[side]]


def borders(blocks: Blocks) -> list[tuple[int, int, int, int]]:
    """Corners a < b and sides f, g of each border: f runs through it from a to b, g from b to a."""
    found: dict[tuple[int, int], int] = {}
    for f, corners in enumerate(round_corners(blocks).tolist()):
        for i in range(4):
            found[corners[i], corners[(i + 1) % 4]] = f
    return [(a, b, f, found[b, a]) for (a, b), f in sorted(found.items()) if a < b]


def patch_loop(layout: Layout, f: int) -> tuple[Index, Index]:
    """Border vertices (b,) of a patch from its first corner on, and where in that list its corners are (4,).

    Raises
    ------
    InputError : the patch is no disk, or its corners do not follow each other as the meccano's.
    """
    vertices = layout.corner[round_corners(layout.blocks)[f]]
    loop = loop_of(layout.surface, layout.side == f, int(vertices[0]))
    return loop, _marks(loop, vertices, f)


def _marks(loop: Index, vertices: Index, f: int) -> Index:
    """Places (m,) of vertices in the loop (b,) of patch f, ascending."""
    place = {int(v): i for i, v in enumerate(loop)}
    marks = np.array([place.get(int(v), -1) for v in vertices])
    if (marks < 0).any() or (np.diff(marks) <= 0).any():
        raise InputError(f"patch {f} of the surface does not have the corners of its side in their order")
    return marks


def polygon(points: Array, loop: Index, marks: Index, corners: Array) -> Array:
    """Places (b, 2) of border vertices on a polygon, by chord length between the marked ones.

    Parameters
    ----------
    loop, marks : (b,) vertices and the increasing positions in it, the first being 0, of the polygon's corners.
    corners : (m, 2) the polygon.
    """
    closed, ends = np.append(loop, loop[0]), np.append(marks, len(loop))
    places = np.empty((len(loop), 2))
    for i, (a, b) in enumerate(pairwise(ends)):
        share = chord_shares(points[closed[a : b + 1]])[:-1, None]
        places[a:b] = corners[i] * (1 - share) + corners[(i + 1) % len(corners)] * share
    return places


def check(layout: Layout) -> None:
    """Raise if patches are no disks, or do not lie beside each other as the sides of the meccano.

    Raises
    ------
    InputError : one of these does not hold.
    """
    surface = layout.surface
    for f in range(len(layout.blocks.boundary_sides)):
        inside = layout.side == f
        patch_loop(layout, f)
        vertices = len(np.unique(surface.triangles[inside]))
        edges = len(np.unique(surface.edge_of[inside]))
        if vertices - edges + inside.sum() != 1 or pieces(surface, inside, None).max() > 0:
            raise InputError(f"patch {f} of the surface is no disk")
    beside = {(f, g) for _, _, f, g in borders(layout.blocks)}
    pairs = layout.side[surface.beside]
    for f, g in np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0).tolist():
        if (f, g) not in beside and (g, f) not in beside:
            raise InputError(f"patches {f} and {g} of the surface meet, but not their sides of the meccano")


def by_labels(surface: Surface, blocks: Blocks, labels: Index) -> Layout:
    """A division given by hand: corners are where three or more patches meet.

    Parameters
    ----------
    labels : (t,) side of the meccano for each triangle.

    Raises
    ------
    InputError : the patches do not lie beside each other as the sides of the meccano.
    """
    rows = round_corners(blocks)
    whole = labels.shape == (len(surface.triangles),) and labels.dtype.kind in "iu"
    if not whole or not np.isin(labels, range(len(rows))).all():
        count = len(surface.triangles)
        raise InputError(f"labels must be one of 0, ..., {len(rows) - 1} for each of the {count} triangles")
    pairs = np.unique(np.stack([surface.triangles.ravel(), np.repeat(labels, 3)], axis=1), axis=0)
    around = {frozenset(np.flatnonzero((rows == n).any(axis=1)).tolist()): n for n in np.unique(rows).tolist()}
    if len(around) < len(np.unique(rows)):
        raise InputError("two corners of the meccano lie between the same sides: labels do not tell them apart")
    corner = np.full(blocks.corners.max() + 1, -1, dtype=np.int64)
    for v in np.flatnonzero(np.bincount(pairs[:, 0]) > 2).tolist():
        meeting = frozenset(pairs[pairs[:, 0] == v, 1].tolist())
        if meeting not in around or corner[around[meeting]] >= 0:
            raise InputError(f"patches {sorted(meeting)} meet at vertex {v}, which is no such corner of the meccano")
        corner[around[meeting]] = v
    missing = np.setdiff1d(rows, np.flatnonzero(corner >= 0))
    if len(missing):
        raise InputError(f"no vertex is corner {missing[0]} of the meccano: three patches must meet at each")
    layout = Layout(blocks, surface, labels.astype(np.int64), corner)
    check(layout)
    return layout


def pieces(surface: Surface, inside: Mask, walls: Index | None) -> Index:
    """Component (t,) of each triangle of a region (t,) cut by walls, edges given as vertices (w, 2); -1 outside."""
    joined = np.asarray(inside[surface.beside].all(axis=1))
    if walls is not None:
        joined[edge_rows(surface, walls)] = False
    rows = np.full(len(inside), -1, dtype=np.int64)
    rows[inside] = np.arange(inside.sum())
    a, b = rows[surface.beside[joined]].T
    count = int(inside.sum())
    label = connected_components(coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count)), False)[1]
    result = np.full(len(inside), -1, dtype=np.int64)
    result[inside] = label
    return result


def left_of(surface: Surface, a: int, b: int) -> int:
    """The triangle through which the edge from vertex a to vertex b runs."""
    return int(surface.beside[edge_rows(surface, np.array([[a, b]]))[0], 0 if a < b else 1])


def with_border(layout: Layout, path: Path, f: int, g: int) -> Layout:
    """The layout with another border between two patches: f on the left of the path, g on its right."""
    side = layout.side[path.origin]
    region = (side == f) | (side == g)
    piece = pieces(path.surface, region, path.edges)
    left = piece[left_of(path.surface, int(path.vertices[0]), int(path.vertices[1]))]
    side = np.where(region, np.where(piece == left, f, g), side)
    return replace(layout, surface=path.surface, side=side)


def _split_chords(layout: Layout, region: Mask) -> tuple[Layout, Mask]:
    """The layout and a region (t,) of it, without inner edges that join two vertices of the region's border."""
    surface, origin = without_chords(layout.surface, region.astype(np.int64))
    return replace(layout, surface=surface, side=layout.side[origin]), region[origin]


def straighten_border(
    layout: Layout, border: tuple[int, int, int, int], cut: bool, rounds: int = 0, clean: float = CLEAN
) -> Layout:
    """Let a border follow the middle line of its two patches, or a crease near it.

    Parameters
    ----------
    border : an entry of `borders`.
    cut : run straight through triangles, unless most of the border follows creases; otherwise along edges that there
        are, nearly straight.
    rounds : of reweighting, see `mean_value`.
    clean : what is a crease, see `surface.sharp`.
    """
    a, b, f, g = border
    if f == g:
        return layout
    region = (layout.side == f) | (layout.side == g)
    layout, region = _split_chords(layout, region)
    rows = round_corners(layout.blocks)
    own, other = rows[f].tolist(), rows[g].tolist()
    i, j = own.index(a), other.index(b)
    names = [a, other[(j + 2) % 4], other[(j + 3) % 4], b, own[(i + 2) % 4], own[(i + 3) % 4]]
    if len(set(names)) < 6:
        return layout
    loop = loop_of(layout.surface, region, int(layout.corner[a]))
    marks = _marks(loop, layout.corner[names], f)
    corners = np.array([(0, 0), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1)], dtype=float)
    targets = polygon(layout.surface.points, loop, marks, corners)
    places = mean_value(layout.surface.points, layout.surface.triangles[region], loop, targets, rounds)
    start, end = int(layout.corner[a]), int(layout.corner[b])
    path = trace(layout.surface, start, end, region, places=places, creases=True, clean=clean)
    if cut and _share_of_creases(path, clean) < FOLLOWED:
        path = straight(layout.surface, region, places, start, end)
    return with_border(layout, path, f, g)


def _share_of_creases(path: Path, clean: float) -> float:
    """Part of a path's length that runs along creases."""
    surface, ends = path.surface, path.edges
    length = np.linalg.norm(surface.points[ends[:, 1]] - surface.points[ends[:, 0]], axis=1)
    return float(length[sharp(surface, clean)[edge_rows(surface, ends)]].sum() / length.sum())


def centre_corner(layout: Layout, n: int, rounds: int = 0, step: float = 1.0) -> Layout:
    """Move a corner towards the middle of the patches around it, by a part of the way, and lead its borders there.

    Borders follow edges that there are.
    """
    rows = round_corners(layout.blocks)
    ring = _ring(rows, n)
    names = [int(rows[g][(i + k) % 4]) for g, i in ring for k in (1, 2)]
    if len(ring) < (rows == n).any(axis=1).sum() or len(set(names)) < len(names):
        return layout
    patches, spokes = [g for g, _ in ring], names[::2]
    layout, region = _split_chords(layout, np.isin(layout.side, patches))
    loop = loop_of(layout.surface, region, int(layout.corner[names[0]]))
    marks = _marks(loop, layout.corner[names], patches[0])
    angle = 2 * np.pi * np.arange(len(names)) / len(names)
    targets = polygon(layout.surface.points, loop, marks, np.stack([np.cos(angle), np.sin(angle)], axis=1))
    places = mean_value(layout.surface.points, layout.surface.triangles[region], loop, targets, rounds)
    inner = np.setdiff1d(layout.surface.triangles[region], loop)
    centre = _nearest(layout.surface, inner, places, (1 - step) * places[layout.corner[n]])
    surface, side = layout.surface, layout.side
    walls = np.zeros((0, 2), dtype=np.int64)
    for spoke in spokes:
        path = trace(surface, centre, int(layout.corner[spoke]), region, walls, places)
        places = np.concatenate([places, places[path.split].mean(axis=1)])
        surface, side, region = path.surface, side[path.origin], region[path.origin]
        walls = np.concatenate([walls, path.edges])
    piece = pieces(surface, region, walls)
    # The patch of a spoke lies to its left; spokes begin at the centre and nothing else does.
    for g, (a, b) in zip(patches, walls[walls[:, 0] == centre].tolist(), strict=True):
        side[piece == piece[left_of(surface, a, b)]] = g
    corner = layout.corner.copy()
    corner[n] = centre
    return replace(layout, surface=surface, side=side, corner=corner)


def _ring(rows: Index, n: int) -> list[tuple[int, int]]:
    """Patches around corner n in the order of the orientation, each with the place of the corner among its own (f, 4).

    The next one begins where this one ends. Fewer than there are if the corner has several rings.
    """
    around = {int(f): rows[f].tolist().index(n) for f in np.flatnonzero((rows == n).any(axis=1))}
    by_start = {int(rows[g][(i + 1) % 4]): g for g, i in around.items()}
    ring: list[int] = []
    following = next(iter(around))
    while following not in ring:
        ring.append(following)
        following = by_start.get(int(rows[following][(around[following] + 3) % 4]), ring[0])
    return [(g, around[g]) for g in ring]


def _nearest(surface: Surface, vertices: Index, places: Array, goal: Array) -> int:
    """The vertex with its place (v, 2) nearest to the goal, or a corner of the surface near it: three creases meet."""
    distance = ((places[vertices] - goal) ** 2).sum(axis=1)
    creases = np.bincount(surface.edges[sharp(surface)].ravel(), minlength=len(places))[vertices]
    return int(vertices[np.argmin(np.where((creases > 2) & (distance < NEAR**2), distance - NEAR**2, distance))])


def balance(layout: Layout) -> dict[str, float]:
    """How even the patches are: smallest and largest share of the mean area, longest over shortest border."""
    areas = np.linalg.norm(area_vectors(layout.surface), axis=1)
    share = np.bincount(layout.side, areas) / areas.sum()
    lengths = []
    for f in range(len(share)):
        loop, marks = patch_loop(layout, f)
        step = np.linalg.norm(np.diff(layout.surface.points[np.append(loop, loop[0])], axis=0), axis=1)
        lengths += [part.sum() for part in np.split(step, marks[1:])]
    return {
        "smallest_patch": float(share.min() * len(share)), "largest_patch": float(share.max() * len(share)),
        "border_ratio": float(max(lengths) / min(lengths)),
    }
