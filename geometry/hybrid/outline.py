r"""Loops of a face as pieces of edges, and the loops of what elements leave of it.

Axis letters: n vertex, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face, curve_points, curve_tangents, surface_frame
from geometry.hybrid.chart import Chart, to_chart
from geometry.hybrid.pieces import Pieces
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

Sides = dict[tuple[int, int], tuple[Array, Array]]
"""Directed sides by their two vertices: the directions in space in which they leave and arrive."""


class FaceError(InputError):
    """A face that cannot be meshed with the pieces that its edges have."""

    def __init__(self, face: int, message: str):
        super().__init__(message)
        self.face = face


@dataclass(frozen=True, eq=False)
class Outline:
    """Loops of a face: chart points and parameters (n, 2), cubic pieces (n, 4, 2) in the parameter plane, vertices of
    the solid (n,), local numbers, and sides.
    """

    points: Array
    uv: Array
    plane: Array
    vertices: Index
    loops: list[Index]
    leaving: Sides


def outline_of(brep: Brep, number: int, chart: Chart, edges: list[Pieces], where: str) -> Outline:
    """Outline of a face with given pieces of its edges.

    Raises
    ------
    FaceError : a loop has fewer than three pieces.
    """
    points: list[Array] = []
    parameters: list[Array] = []
    curves: list[Array] = []
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
            third, slope = np.diff(t)[:, None] / 3.0, curve_tangents(c.curve, t)
            curves.append(np.stack([uv[:-1], uv[:-1] + third * slope[:-1], uv[1:] - third * slope[1:], uv[1:]], axis=1))
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
    plane = np.concatenate(curves)
    return Outline(np.concatenate(points), np.concatenate(parameters), plane, np.concatenate(names), loops, leaving)


def cut_out(face: Face, rings: list[list[int]], places: Array, leaving: Sides) -> Sides:
    """Sides of what is left when elements are cut out whose sides are pieces of edges or parameter lines.

    Parameters
    ----------
    rings : vertices around each element.
    places : (k, 2) parameters of these, ring after ring; of a triangle at a pole those of its cell, so that its ring
        has the vertex at the pole twice.
    """
    left = dict(leaving)
    if not rings:
        return left
    _, du, dv = surface_frame(face.surface, places)
    first = 0
    for ring in rings:
        size = len(ring)
        for k, (a, b) in enumerate(zip(ring, [*ring[1:], ring[0]])):
            i, j = first + k, first + (k + 1) % size
            if a != b and left.pop((a, b), None) is None:
                way = places[i] - places[j]
                d = int(np.abs(way).argmax())
                sign, along = np.sign(way[d]), (du, dv)[d]
                left[b, a] = (sign * along[j], sign * along[i])
        first += size
    return left


def regions(points: Array, sides: Sides) -> list[list[Index]]:
    """Loops of the regions on the left of directed sides, each region's outer loop first.

    Raises
    ------
    InputError : the sides do not close.
    """
    out: dict[int, list[int]] = {}
    for a, b in sides:
        out.setdefault(a, []).append(b)
    left = set(sides)
    rings = []
    while left:
        a, b = begin = min(left)
        ring = []
        while (a, b) in left:
            left.discard((a, b))
            ring.append(a)
            a, b = b, _first(points, a, b, out.get(b, [a]))
        if (a, b) != begin:
            raise InputError("its elements overlap, or leave a gap")
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
