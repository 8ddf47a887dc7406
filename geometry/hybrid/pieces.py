r"""Edges of a solid as cubic pieces that both faces share.

Piece k of an edge covers the parameters t_k to t_k+1 and is a cubic in space near the edge's curve (`curves`). Both
faces, and every element on them, take these control points for their common side, so nothing can open there.

Axis letters: m piece, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Curve, curve_points, curve_tangents
from geometry.hybrid.curves import fit_cubics
from geometry.hybrid.sizing import SAMPLES, Sizing, divide_edge, size_at

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of one edge: parameters (m + 1,), vertices (m + 1,), control points (m, 4, 3)."""

    ends: Array
    vertices: Index
    control: Array


def least_pieces(brep: Brep) -> list[int]:
    """One piece at least; three on closed edges; two where edges share both ends."""
    seen: dict[tuple[int, ...], list[int]] = {}
    for e, edge in enumerate(brep.edges):
        if not edge.degenerate:
            seen.setdefault(tuple(sorted(edge.vertices)), []).append(e)
    least = [1] * len(brep.edges)
    for ends, edges in seen.items():
        for e in edges:
            least[e] = 3 if ends[0] == ends[1] else 2 if len(edges) > 1 else 1
    return least


def divide_edges(
    brep: Brep, sizing: Sizing, wanted: list[Array], least: list[int], tolerance: float
) -> dict[int, Array]:
    """Parameters of the ends of all edges' pieces: small enough for their sizes, and for cubics to meet the curves.

    Parameters
    ----------
    wanted : sizes along each edge (`sizing.size_edges`), at `sizing.SAMPLES` places; sizes elsewhere count as well.
    least : fewest pieces of each edge.
    tolerance : wanted distance, relative to the diagonal.
    """
    samples = np.linspace(0.0, 1.0, SAMPLES)
    found = {}
    for e, edge in enumerate(brep.edges):
        if edge.degenerate:
            continue
        h = np.minimum(wanted[e], size_at(sizing, curve_points(edge.curve, samples)))
        fewest = least[e]
        for _ in range(6):
            found[e] = divide_edge(brep, e, h, fewest)
            _, distance = _cubics(brep, e, found[e])
            # Vertices may lie off the curve by as much as the file says.
            if distance.max() <= 0.5 * tolerance * brep.diagonal + edge.tolerance:
                break
            fewest = 2 * (len(found[e]) - 1)
    return found


def cut_edges(brep: Brep, ends: Mapping[int, Array]) -> tuple[list[Pieces], int]:
    """Pieces of all edges between given parameters, and the number of vertices so far."""
    count = len(brep.vertices)
    pieces = []
    for e, edge in enumerate(brep.edges):
        if edge.degenerate:
            pieces.append(Pieces(np.array([0.0, 1.0]), np.array(edge.vertices), np.zeros((1, 4, 3))))
            continue
        m = len(ends[e]) - 1
        numbers = np.concatenate([[edge.vertices[0]], count + np.arange(m - 1), [edge.vertices[1]]])
        pieces.append(Pieces(ends[e], numbers, _cubics(brep, e, ends[e])[0]))
        count += m - 1
    return pieces, count


def _cubics(brep: Brep, edge: int, ends: Array) -> tuple[Array, Array]:
    curve, vertices = brep.edges[edge].curve, brep.edges[edge].vertices
    x = curve_points(curve, ends)
    x[0], x[-1] = brep.vertices[vertices[0]], brep.vertices[vertices[1]]
    # Differences for derivatives would leave 1e-12 of a piece, where the surface is to be met exactly.
    return fit_cubics(
        partial(_edge_points, curve, ends), x[:-1], x[1:], frames=partial(_edge_frames, curve, ends)
    )


def _edge_points(curve: Curve, ends: Array, s: Array) -> Array:
    """Points (m, k, 3) of the pieces of an edge at their own parameters (m, k)."""
    t = ends[:-1, None] + np.diff(ends)[:, None] * s
    return curve_points(curve, t.ravel()).reshape(*s.shape, 3)


def _edge_frames(curve: Curve, ends: Array, s: Array) -> tuple[Array, Array]:
    """The same points and their derivatives (m, k, 3)."""
    h = np.diff(ends)[:, None]
    t = (ends[:-1, None] + h * s).ravel()
    slope = curve_tangents(curve, t).reshape(*s.shape, 3)
    return curve_points(curve, t).reshape(slope.shape), h[..., None] * slope
