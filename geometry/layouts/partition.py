"""Six patches of a surface of genus 0 that lie beside each other as the sides of a cube.

Eight corners are chosen, extreme points in the diagonal directions of the surface's principal axes. A closed path
through all of them (a Hamiltonian cycle of the cube) divides the surface into two disks; two more paths divide each
into three patches. So any eight distinct vertices lead to a division with the cube's graph. Of the cube's six cycles
the one with the shortest paths is taken. The division is then made straight and even (see `layout`); of all stages of
that the one whose map has the best angles and areas is kept.

Axis letters: v vertex, t triangle, n corner of the cube.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks, cube
from geometry.layouts.boundary_map import BoundaryMap, boundary_map
from geometry.layouts.layout import (
    Layout,
    borders,
    by_labels,
    centre_corner,
    check,
    left_of,
    pieces,
    round_corners,
    straighten_border,
    with_border,
)
from geometry.simplices.mean_value import signed_areas
from geometry.simplices.paths import refined, trace
from geometry.simplices.surface import Surface, area_vectors, checked_surface, genus
from iga.cells import HEXAHEDRON
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_TRIANGLES = 3000
"""Coarser surfaces are refined first, so that there are vertices and edges enough to choose from."""
MOST_TRIANGLES = 8000
"""Larger surfaces are simplified to find the corners."""
STEP = 0.5
"""Part of the way to the middle that corners move in a round."""
LEVEL = 0.05
"""What an octree level costs when divisions are compared."""
APART = 0.05
"""Square of the least distance of two corners at the start, in half sides of the surface's box."""
REWEIGHTING = 2
"""Rounds of reweighting in the steps that move corners and borders; without any, limbs draw patches together."""


def partition(
    surface: Surface, corners: Array | None = None, labels: Index | None = None, rounds: int = 3,
    progress: Progress = QUIET,
) -> Layout:
    """Divide a surface into six patches.

    Parameters
    ----------
    surface : of genus 0.
    corners : (8, 3) points near which the cube's corners shall be, in the order of the reference cell's vertices; they
        stay there. None to let them be found.
    labels : (t,) side 0, ..., 5 of the cube for each triangle, to give the whole division by hand.
    rounds : of moving corners and borders.

    Raises
    ------
    InputError : the genus is not 0, or what was given by hand is no such division.
    """
    if genus(surface) != 0:
        raise InputError(f"a surface of genus {genus(surface)} cannot be divided as a cube's; take a polycube")
    blocks = cube()
    if labels is not None:
        return by_labels(surface, blocks, np.asarray(labels))
    surface, _ = refined(surface, LEAST_TRIANGLES)
    if corners is None:
        layout = _found(surface, blocks, rounds, progress)
    else:
        layout = _connected(surface, blocks, _nearest(surface, np.asarray(corners, dtype=float)))
        layout = _straightened(layout, False)
    layout = _straightened(layout, True)
    check(layout)
    return layout


def _straightened(layout: Layout, cut: bool) -> Layout:
    """The layout with all borders straightened, one after the other; see `straighten_border`."""
    for border in borders(layout.blocks):
        layout = straighten_border(layout, border, cut, REWEIGHTING)
    return layout


def _found(surface: Surface, blocks: Blocks, rounds: int, progress: Progress) -> Layout:
    """Best of the divisions from two choices of corners, after each round of moving them to the middle.

    Large surfaces are simplified first, and the corners carried over.
    """
    coarse = _simplified(surface)
    best: tuple[float, Layout] | None = None
    layout: Layout | None = None
    reason = ""
    for turn, k in progress.track([(turn, k) for turn in (False, True) for k in range(rounds + 1)], "patches"):
        try:
            if k == 0:
                layout = None  # should these corners not be joined, there is nothing to move in the next rounds
                layout = _connected(coarse, blocks, _extremes(coarse, turn))
            if layout is None:
                continue
            for n in range(8 if k else 0):
                layout = centre_corner(layout, n, REWEIGHTING, STEP)
            layout = _straightened(layout, False)
            cost = price(boundary_map(layout)[0])
        except InputError as error:
            reason = str(error)
            continue
        if best is None or cost < best[0]:
            best = cost, layout
    if best is None:
        raise InputError(f"the surface could not be divided by itself, give corners or labels: {reason}")
    layout = best[1]
    if coarse is surface:
        return layout
    return _straightened(_connected(surface, blocks, _nearest(surface, layout.surface.points[layout.corner])), False)


def _simplified(surface: Surface) -> Surface:
    """A surface of at most `MOST_TRIANGLES` near the given one; that one itself if it is small or resists."""
    if len(surface.triangles) <= MOST_TRIANGLES:
        return surface
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(surface.points, surface.triangles.astype(int))
    share = 1 - MOST_TRIANGLES / len(surface.triangles)
    less = mesh.decimate_pro(share, preserve_topology=True, boundary_vertex_deletion=False)
    try:
        made, _ = checked_surface(np.asarray(less.points, dtype=float), np.asarray(less.regular_faces), crossings=True)
    except InputError:
        return surface
    return made if genus(made) == genus(surface) else surface


def price(mapping: BoundaryMap) -> float:
    """How far a map is from one with right angles and even areas, in the mean over the surface.

    The angle between the lines of s counts as 1 / sin - 1, an octree level of area as `LEVEL`.
    """
    surface = mapping.surface
    space = surface.points[surface.triangles]
    plane = mapping.parameters
    area = np.linalg.norm(area_vectors(surface), axis=1)
    flat = signed_areas(plane)
    edges = np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], axis=2)
    slopes = np.stack([space[:, 1] - space[:, 0], space[:, 2] - space[:, 0]], axis=2) @ np.linalg.inv(edges)
    lengths = np.linalg.norm(slopes, axis=1)
    sine = area / flat / (lengths[:, 0] * lengths[:, 1])
    levels = np.abs(np.log2(len(mapping.blocks.boundary_sides) * area / (flat * area.sum()))) / 2
    return float(area @ (LEVEL * levels + 1.0 / np.clip(sine, 1e-6, 1.0) - 1.0) / area.sum())


def _extremes(surface: Surface, turn: bool = False) -> Index:
    """Distinct vertices (8,) that lie farthest in the diagonal directions of the box of principal axes.

    The box may be turned by an eighth about its longest axis.
    """
    areas = np.linalg.norm(area_vectors(surface), axis=1)
    middles = surface.points[surface.triangles].mean(axis=1)
    centre = areas @ middles / areas.sum()
    covariance = np.einsum("t,td,te->de", areas, middles - centre, middles - centre)
    axes = np.linalg.eigh(covariance)[1]
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    local = (surface.points - centre) @ axes
    local = 2 * (local - local.min(axis=0)) / np.ptp(local, axis=0) - 1
    if turn:
        local[:, :2] = np.stack([local[:, 0] - local[:, 1], local[:, 0] + local[:, 1]], axis=1) / np.sqrt(2)
    chosen: list[int] = []
    for direction in 2 * HEXAHEDRON.vertices - 1:
        height = local @ direction
        for v in chosen:
            # Keep away from corners that there are.
            height = np.where(((local - local[v]) ** 2).sum(axis=1) < APART, -np.inf, height)
        chosen.append(int(np.argmax(height)))
    return np.array(chosen)


def _nearest(surface: Surface, corners: Array) -> Index:
    """Vertices (8,) nearest to points given for the corners of a cube (8, 3)."""
    if corners.shape != (8, 3) or not np.isfinite(corners).all():
        raise InputError(f"corners of a cube are given as 8 points with 3 coordinates, not as {corners.shape}")
    chosen = np.array([int(np.argmin(((surface.points - x) ** 2).sum(axis=1))) for x in corners])
    if len(set(chosen.tolist())) < 8:
        raise InputError("two of the 8 corners given lie at the same vertex of the surface")
    return chosen


def cycles() -> list[tuple[int, ...]]:
    """The cube's Hamiltonian cycles, each once, from corner 0."""
    edges = {frozenset(edge) for edge in HEXAHEDRON.edges.tolist()}
    found = []
    for rest in permutations(range(1, 8)):
        if rest[0] < rest[-1] and all(frozenset(e) in edges for e in zip((0, *rest), (*rest, 0))):
            found.append((0, *rest))
    return found


def _connected(surface: Surface, blocks: Blocks, chosen: Index) -> Layout:
    """Best of the divisions along the cube's cycles."""
    best: tuple[float, Layout] | None = None
    reason = ""
    for cycle in cycles():
        try:
            length, layout = _along(surface, blocks, chosen, cycle)
        except InputError as error:
            reason = str(error)
            continue
        if best is None or length < best[0]:
            best = length, layout
    if best is None:
        raise InputError(f"the corners of the cube cannot be joined on the surface: {reason}")
    return best[1]


def _along(surface: Surface, blocks: Blocks, chosen: Index, cycle: tuple[int, ...]) -> tuple[float, Layout]:
    """Total length of the paths and the division along one cycle."""
    rows, ends = round_corners(blocks).tolist(), borders(blocks)
    step = set(zip(cycle, (*cycle[1:], cycle[0])))
    # Sides on the left of the cycle run through its edges forwards.
    left = [f for f, row in enumerate(rows) if any((row[i], row[(i + 1) % 4]) in step for i in range(4))]
    walls = np.zeros((0, 2), dtype=np.int64)
    total = 0.0
    for a, b in zip(cycle, (*cycle[1:], cycle[0])):
        # Corners that no path has reached yet are in the way as well.
        path = trace(surface, int(chosen[a]), int(chosen[b]), walls=walls, avoid=chosen)
        surface = path.surface
        walls = np.concatenate([walls, path.edges])
        total += path.length
    piece = pieces(surface, np.ones(len(surface.triangles), dtype=bool), walls)
    start = walls[0]
    side = np.where(piece == piece[left_of(surface, int(start[0]), int(start[1]))], left[0], _others(left)[0])
    layout = Layout(blocks, surface, side, chosen.copy())
    for group in (left, _others(left)):
        # The middle one of three has a border in common with both others.
        middle = next(f for f in group if all(len(set(rows[f]) & set(rows[g])) >= 2 for g in group))
        layout = replace(layout, side=np.where(layout.side == group[0], middle, layout.side))
        for a, b, f, g in ends:
            if middle not in (f, g) or not {f, g} <= set(group):
                continue
            if f == middle:
                a, b, f = b, a, g
            path = trace(layout.surface, int(chosen[a]), int(chosen[b]), layout.side == middle)
            total += path.length
            layout = with_border(layout, path, f, middle)
    check(layout)
    return total, layout


def _others(left: list[int]) -> list[int]:
    """Sides of the cube that are not among some of them."""
    return [f for f in range(6) if f not in left]
