"""The map of the meccano's boundary onto the surface (Pi_F of the paper): piecewise linear, one to one.

Each patch of a division of the surface is laid on its side by mean values. Borders carry chord length, rounded to
multiples of 2^-45, so that t on one side and 1 - t on the other are the same parameter to the last bit, and points of
a border are computed from it alone: both sides give the same point.

Axis letters: t triangle, f boundary side, q query point, b border vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.layouts.layout import SQUARE, Layout, patch_loop, round_corners
from geometry.simplices.mean_value import area_stretch, flipped, mean_value
from geometry.simplices.paths import chord_shares, without_chords
from geometry.simplices.surface import Surface
from geometry.tree import Tree, triangle_tree
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GRAIN = 2.0**-45
"""Border parameters are multiples of this."""
ROUNDS = 8
"""Most rounds of reweighting."""
OUTSIDE = 1e-7
"""Query points may lie outside all triangles of their side by this much, in barycentric coordinates."""


@dataclass(frozen=True, eq=False)
class BoundaryMap:
    """A one-to-one map from the boundary sides of a meccano to a surface.

    Attributes
    ----------
    blocks : the meccano.
    surface : the surface; borders between patches run along its edges.
    side : (t,) the boundary side, a row of ``blocks.boundary_sides``, onto which each triangle is laid.
    parameters : (t, 3, 2) side coordinates s of the triangle's corners.
    """

    blocks: Blocks
    surface: Surface
    side: Index
    parameters: Array

    @cached_property
    def tree(self) -> Tree:
        """Tree of the triangles in the space of s and side number."""
        third = np.broadcast_to(self.side[:, None, None], (len(self.side), 3, 1)).astype(float)
        return triangle_tree(np.concatenate([self.parameters, third], axis=2))

    @cached_property
    def border(self) -> tuple[Index, Array, Index, Index]:
        """Segments of the borders of all sides, in the order of side, square side and parameter.

        The square sides are s0 = 0, s0 = 1, s1 = 0, s1 = 1.

        Returns
        -------
        Offsets (4 f + 1,), parameters (b, 2) of the ends, ascending, their vertices (b, 2) and the triangles (b,).
        """
        keys, ends, vertices, owners = [], [], [], []
        for i in range(3):
            j = (i + 1) % 3
            one, two = self.parameters[:, i], self.parameters[:, j]
            for axis in (0, 1):
                for value in (0.0, 1.0):
                    rows = np.flatnonzero((one[:, axis] == value) & (two[:, axis] == value))
                    t = np.stack([one[rows, 1 - axis], two[rows, 1 - axis]], axis=1)
                    v = self.surface.triangles[rows][:, [i, j]]
                    turned = t[:, 0] > t[:, 1]
                    keys.append(4 * self.side[rows] + 2 * axis + int(value))
                    ends.append(np.where(turned[:, None], t[:, ::-1], t))
                    vertices.append(np.where(turned[:, None], v[:, ::-1], v))
                    owners.append(rows)
        key, end = np.concatenate(keys), np.concatenate(ends)
        order = np.lexsort((end[:, 0], key))
        offsets = np.searchsorted(key[order], np.arange(4 * len(self.blocks.boundary_sides) + 1))
        return offsets, end[order], np.concatenate(vertices)[order], np.concatenate(owners)[order]


def on_surface(mapping: BoundaryMap, side: Index, s: Array) -> tuple[Array, Index]:
    """Points (q, 3) of the surface at coordinates s (q, 2) of boundary sides (q,), and their triangles (q,).

    Raises
    ------
    InputError : a point lies outside its side.
    """
    side, s = np.ascontiguousarray(side, dtype=np.int64), np.ascontiguousarray(s, dtype=float)
    inside = ((s >= 0) & (s <= 1)).all(axis=1) & (side >= 0) & (side < len(mapping.blocks.boundary_sides))
    if not inside.all():
        q = int(np.argmin(inside))
        raise InputError(f"point {q} with s = {s[q].tolist()} lies on no side {side[q]} of the meccano")
    points, triangle, miss = _evaluate(
        side, s, mapping.tree, mapping.side, mapping.parameters, mapping.surface.points, mapping.surface.triangles,
        *mapping.border,
    )
    if (miss > OUTSIDE).any():
        q = int(np.argmax(miss))
        raise InputError(f"point {q} with s = {s[q].tolist()} lies in no triangle laid on side {side[q]}")
    return points, triangle


@njit(cache=True)
def _evaluate(
    side: Index, s: Array, tree: Tree, sides: Index, parameters: Array, points: Array, triangles: Index,
    offsets: Index, ends: Array, vertices: Index, owners: Index,
) -> tuple[Array, Index, Array]:
    """Points (q, 3), triangles (q,) and by how much each point misses its triangle (q,), 0 or less if it does not."""
    count = len(s)
    result, found, miss = np.empty((count, 3)), np.full(count, -1, dtype=np.int64), np.zeros(count)
    weight = np.empty(3)
    for q in range(count):
        edge = -1
        for axis in range(2):
            for value in range(2):
                if s[q, axis] == value:
                    edge, t = 2 * axis + value, s[q, 1 - axis]
        if edge >= 0:
            a, b = offsets[4 * side[q] + edge], offsets[4 * side[q] + edge + 1]
            if a == b:
                miss[q] = np.inf
                continue
            k = a + max(np.searchsorted(ends[a:b, 0], t, side="right") - 1, 0)
            low, high = 0, 1
            if vertices[k, 0] > vertices[k, 1]:
                low, high = 1, 0
            share = abs(t - ends[k, low]) / (ends[k, 1] - ends[k, 0])
            for c in range(3):
                p = points[vertices[k, low], c]
                result[q, c] = points[vertices[k, high], c] if share == 1.0 else p + share * (
                    points[vertices[k, high], c] - p
                )
            found[q] = owners[k]
            continue
        t, least = _find(side[q], s[q, 0], s[q, 1], tree, sides, parameters, weight)
        found[q], miss[q] = t, -least
        if t >= 0:
            for c in range(3):
                result[q, c] = (
                    weight[0] * points[triangles[t, 0], c]
                    + weight[1] * points[triangles[t, 1], c]
                    + weight[2] * points[triangles[t, 2], c]
                )
    return result, found, miss


@njit(cache=True)
def _find(
    side: int, x: float, y: float, tree: Tree, sides: Index, parameters: Array, weight: Array
) -> tuple[int, float]:
    """Triangle of a side around a point or nearest to it, or -1, and the point's least barycentric coordinate in it.

    All three coordinates are left in ``weight``.
    """
    best, least = -1, -np.inf
    stack = np.empty(128, dtype=np.int64)
    stack[0] = 0
    size = 1
    slack = 1e-12
    while size:
        size -= 1
        node = stack[size]
        if (
            x < tree.lower[node, 0] - slack or x > tree.upper[node, 0] + slack
            or y < tree.lower[node, 1] - slack or y > tree.upper[node, 1] + slack
            or side < tree.lower[node, 2] or side > tree.upper[node, 2]
        ):
            continue
        if tree.child[node] >= 0:
            stack[size], stack[size + 1] = tree.child[node], tree.child[node] + 1
            size += 2
            continue
        for k in range(tree.begin[node], tree.end[node]):
            t = tree.order[k]
            if sides[t] != side:
                continue
            ax, ay = parameters[t, 0]
            bx, by = parameters[t, 1]
            cx, cy = parameters[t, 2]
            one = (bx - x) * (cy - y) - (by - y) * (cx - x)
            two = (cx - x) * (ay - y) - (cy - y) * (ax - x)
            three = (ax - x) * (by - y) - (ay - y) * (bx - x)
            total = one + two + three
            if total <= 0.0:
                continue
            low = min(one, two, three) / total
            if low > least:
                best, least = t, low
                weight[0], weight[1], weight[2] = one / total, two / total, three / total
                if low >= 0.0:
                    return best, least
    return best, least


def boundary_map(
    layout: Layout, limit: float = 10000.0, progress: Progress = QUIET
) -> tuple[BoundaryMap, dict[str, Any]]:
    """Lay every patch of a division of a surface on its side of the meccano.

    Parameters
    ----------
    layout : the division, of any meccano.
    limit : area on the surface per area on the side, relative to the patch's, beyond which limbs are widened at the
        cost of angles (see `mean_value`); an octree needs half its binary logarithm of levels more there.

    Returns
    -------
    The map, on a surface whose triangles are split where edges joined two border vertices of a patch, and a report:
    ``area_stretch``, the least and largest area in space per area on the side, relative to the patch's.

    Raises
    ------
    InputError : a patch is no disk, or its parametrisation is not one to one.
    """
    surface, origin = without_chords(layout.surface, layout.side)
    layout = replace(layout, surface=surface, side=layout.side[origin])
    parameters = np.empty((len(surface.triangles), 3, 2))
    least, largest = np.inf, 0.0
    rows = round_corners(layout.blocks)
    for f in progress.track(range(len(rows)), "parametrisation of patches"):
        inside = layout.side == f
        loop, marks = patch_loop(layout, f)
        targets = _square(surface.points, loop, marks, rows[f])
        local = surface.triangles[inside]
        for rounds in (ROUNDS, 0):
            placed = mean_value(surface.points, local, loop, targets, rounds, limit)[local]
            bad = flipped(placed)
            if not len(bad):
                break
        else:
            t = int(np.flatnonzero(inside)[bad[0]])
            raise InputError(
                f"the parametrisation of patch {f} turns over triangle {t} ({len(bad)} in all): "
                "the patch is too long or narrow"
            )
        parameters[inside] = placed
        stretch = area_stretch(surface.points, local, placed)
        least, largest = min(least, float(stretch.min())), max(largest, float(stretch.max()))
    return BoundaryMap(layout.blocks, surface, layout.side, parameters), {"area_stretch": [least, largest]}


def _square(points: Array, loop: Index, marks: Index, corners: Index) -> Array:
    """Places (b, 2) of a patch's border on the unit square, the same from both sides of a border."""
    closed, ends = np.append(loop, loop[0]), np.append(marks, len(loop))
    places = np.empty((len(loop), 2))
    for i, (a, b) in enumerate(pairwise(ends)):
        forward = corners[i] < corners[(i + 1) % 4]
        # Sums run from the lower corner on, whichever side asks.
        chain = closed[a : b + 1] if forward else closed[a : b + 1][::-1]
        t = np.round(chord_shares(points[chain]) / GRAIN) * GRAIN
        if (np.diff(t) <= 0).any():
            raise InputError(f"an edge of the border from vertex {chain[0]} to vertex {chain[-1]} is too short")
        share = t if forward else 1.0 - t[::-1]
        places[a:b] = (SQUARE[i] + share[:, None] * (SQUARE[(i + 1) % 4] - SQUARE[i]))[:-1]
    return places


def carried(mapping: BoundaryMap, pillowed: Blocks) -> BoundaryMap:
    """The same map for a pillowed meccano: its boundary sides are those of the old one, with the same coordinates.

    Raises
    ------
    InputError : the numbers of boundary sides differ.
    """
    if len(pillowed.boundary_sides) != len(mapping.blocks.boundary_sides):
        raise InputError(
            f"the pillowed meccano has {len(pillowed.boundary_sides)} boundary sides, "
            f"the map {len(mapping.blocks.boundary_sides)}"
        )
    return BoundaryMap(pillowed, mapping.surface, mapping.side, mapping.parameters)
