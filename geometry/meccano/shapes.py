"""Closed surface triangulations made by formula: a ball, a bumpy star and a torus, for studies and tests.

Axis letters: v vertex, t triangle, c component.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.surface import Surface

Array = NDArray[np.float64]


def ball(n: int = 24) -> Surface:
    """The unit sphere: each side of an octahedron as n^2 triangles with vertices pushed out to the sphere."""
    row = np.concatenate([np.full(n + 1 - i, i) for i in range(n + 1)])
    column = np.concatenate([np.arange(n + 1 - i) for i in range(n + 1)])
    first = np.concatenate([[0], np.cumsum(np.arange(n + 1, 0, -1))])
    i, j = row[row + column < n], column[row + column < n]
    lower = np.stack([first[i] + j, first[i + 1] + j, first[i] + j + 1], axis=1)
    i, j = row[row + column < n - 1], column[row + column < n - 1]
    upper = np.stack([first[i + 1] + j, first[i + 1] + j + 1, first[i] + j + 1], axis=1)
    patch = np.concatenate([lower, upper])
    lattice = np.stack([row, column, n - row - column], axis=1)
    signs = np.array(np.meshgrid(*[(1, -1)] * 3, indexing="ij")).reshape(3, 8).T
    corners = (signs[:, None] * lattice).reshape(-1, 3)
    places, number = np.unique(corners, axis=0, return_inverse=True)
    triangles = number.reshape(8, -1)[:, patch]
    mirrored = signs.prod(axis=1) < 0
    triangles[mirrored] = triangles[mirrored][:, :, ::-1]
    # Equal angles on the octahedron's edges keep the triangles of like size.
    spread = np.sin(0.5 * np.pi * np.abs(places) / n) * np.sign(places)
    return Surface(spread / np.linalg.norm(spread, axis=1, keepdims=True), triangles.reshape(-1, 3))


def star(n: int = 24, depth: float = 0.2) -> Surface:
    """The unit sphere with smooth bumps, radius 1 + depth sin(3 x) cos(2 y) (1 + z)."""
    sphere = ball(n)
    x, y, z = sphere.points.T
    radius = 1.0 + depth * np.sin(3.0 * x) * np.cos(2.0 * y) * (1.0 + z)
    return Surface(sphere.points * radius[:, None], sphere.triangles)


def torus(n: int = 48, m: int = 20, thickness: float = 0.4) -> Surface:
    """A torus of radii 1 and ``thickness``: 2 n m triangles."""
    u, v = (np.arange(n) * 2.0 * np.pi / n)[:, None], (np.arange(m) * 2.0 * np.pi / m)[None, :]
    ring = 1.0 + thickness * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), np.broadcast_to(thickness * np.sin(v), (n, m))], axis=-1)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = i * m + (j + 1) % m, (i + 1) % n * m + (j + 1) % m
    return Surface(points.reshape(-1, 3), np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]))


SHAPES: dict[str, Callable[[], Surface]] = {"ball": ball, "star": star, "torus": torus}
"""Surfaces by name."""
