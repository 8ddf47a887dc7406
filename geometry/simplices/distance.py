"""Distances between a surface and another triangulation, in both directions.

Rule: each triangle is sampled at a lattice of points, its corners among them, whose spacing is at most a stated part
of the surface's diagonal, and the closest point of the other triangulation is found for each sample exactly. The
distance to a set changes by no more than one moves, so the true maximum exceeds the sampled one by no more than the
spacing.

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
    """Points (q, 3) on triangles with at most that spacing, corners included."""
    corners = points[triangles]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    parts = np.maximum(np.ceil(longest / step), 1).astype(np.int64)
    result = [points[np.unique(triangles)]]
    for n in np.unique(parts):
        i, j = (x.ravel() for x in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
        keep = (i + j <= n) & (i < n) & (j < n) & (i + j > 0)
        weights = np.stack([i, j, n - i - j], axis=1)[keep] / n
        result.append((weights @ corners[parts == n]).reshape(-1, 3))
    return np.concatenate(result)
