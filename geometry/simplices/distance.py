"""Distances between a surface and another triangulation, in both directions.

Rule: each triangle is sampled at points, its corners among them, of which one is no farther from any point of the
triangle than a stated part of the surface's diagonal, and the closest point of the other triangulation is found for
each sample exactly. The distance to a set changes by no more than one moves, so the true maximum exceeds the sampled
one by no more than the spacing.

Axis letters: v vertex, t triangle, q query point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.closest import closest
from geometry.simplices.surface import Surface

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPACING = 0.005
"""Largest spacing of samples, in diagonals of the surface."""
ROW = 0.8
"""Steps between the rows of a needle; with half a step along a row, 0.94 steps to the nearest sample."""
NEEDLE = 8
"""Parts along the longest side, over rows, of a needle: its rows have a quarter of the lattice's points or fewer."""


def distances(
    surface: Surface, boundary_points: Array, boundary_triangles: Index, spacing: float = SPACING
) -> dict[str, float]:
    """Largest distances between a surface and the triangulated boundary of a domain.

    Parameters
    ----------
    boundary_points, boundary_triangles : (v, 3) and (t, 3).
    spacing : of the samples, in diagonals of the surface.

    Returns
    -------
    ``to_input``, from the boundary to the surface, ``from_input``, from the surface to the boundary, ``relative``, the
    larger of them over the diagonal of the surface, and ``spacing`` over the diagonal.
    """
    step = spacing * surface.diagonal
    there = closest(surface.points, surface.triangles, samples(boundary_points, boundary_triangles, step))[1]
    back = closest(boundary_points, boundary_triangles, samples(surface.points, surface.triangles, step))[1]
    to_input, from_input = float(there.max()), float(back.max())
    relative = max(to_input, from_input) / surface.diagonal
    return {"to_input": to_input, "from_input": from_input, "relative": relative, "spacing": float(spacing)}


def samples(points: Array, triangles: Index, step: float) -> Array:
    """Points (q, 3) on triangles, of which the nearest to any point of a triangle is no farther than step.

    Triangles get a lattice of equal parts, and needles, where that would be many more points, rows along their longest
    side: its angles are acute, so that a row reaches at least as far as the next.
    """
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.max(axis=1)
    height = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / np.maximum(longest, 1e-300)
    parts = np.maximum(np.ceil(longest / step), 1).astype(np.int64)
    rows = np.maximum(np.ceil(height / (ROW * step)), 1).astype(np.int64)
    needles = NEEDLE * (rows + 1) < parts
    result = [points[np.unique(triangles)]]
    for n in np.unique(parts[~needles]):
        result.append((_lattice(n) @ corners[~needles & (parts == n)]).reshape(-1, 3))
    first = lengths.argmax(axis=1)
    turned = corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3]
    for n, m in np.unique(np.stack([parts, rows], axis=1)[needles], axis=0):
        result.append((_rows(n, m) @ turned[needles & (parts == n) & (rows == m)]).reshape(-1, 3))
    return np.concatenate(result)


def _lattice(n: int) -> Array:
    """Barycentric coordinates (q, 3) of a triangle's points that cut its sides into n equal parts, but its corners."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    keep = (i + j <= n) & (i < n) & (j < n) & (i + j > 0)
    return np.asarray(np.stack([i, j, n - i - j], axis=1)[keep] / n)


def _rows(n: int, m: int) -> Array:
    """Barycentric coordinates (q, 3) on m rows along a triangle's first side, of n parts each."""
    along, up = (x.ravel() for x in np.meshgrid(np.arange(n + 1) / n, np.arange(m) / m, indexing="ij"))
    return np.stack([(1.0 - along) * (1.0 - up), along * (1.0 - up), up], axis=1)
