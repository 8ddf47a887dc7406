"""Closed triangulations made by formula or from boxes, for tests."""

from __future__ import annotations

import numpy as np

from geometry.layouts.blocks import Blocks, polycube
from geometry.layouts.layout import round_corners
from geometry.simplices.surface import Surface


def torus(major: int = 36, minor: int = 18, radius: float = 0.4) -> Surface:
    """A torus around the third axis, triangles along rows of quadrilaterals."""
    u, v = np.meshgrid(2 * np.pi * np.arange(major) / major, 2 * np.pi * np.arange(minor) / minor, indexing="ij")
    ring = 1 + radius * np.cos(v)
    points = np.stack((ring * np.cos(u), ring * np.sin(u), radius * np.sin(v)), axis=-1).reshape(-1, 3)
    a = np.arange(major * minor).reshape(major, minor)
    b, c = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    d = np.roll(b, -1, axis=1)
    return Surface(points, np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))]))


def box(low: np.ndarray, high: np.ndarray) -> Surface:
    unit = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Surface(low + unit * (high - low), np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def boundary_of(blocks: Blocks, n: int) -> tuple[Surface, np.ndarray]:
    """The boundary of a meccano at its corners' places, n x n squares a side, and the side of each triangle."""
    corners = blocks.places[round_corners(blocks)]
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1).reshape(-1, 4)
    points = np.einsum("qa,fac->fqc", weights, corners).reshape(-1, 3)
    i = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :n].ravel()
    squares = np.stack([i, i + n + 1, i + n + 2, i + 1], axis=1)
    triangles = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    every = (triangles + (n + 1) ** 2 * np.arange(len(corners))[:, None, None]).reshape(-1, 3)
    distinct, number = np.unique(points.round(9), axis=0, return_inverse=True)
    return Surface(distinct, number.ravel()[every]), np.repeat(np.arange(len(corners)), len(triangles))


def body(cells: list[tuple[int, int, int]], *planes: list[float]) -> Surface:
    """The boundary of voxels of a grid with planes anywhere."""
    blocks = polycube(np.array(cells))
    places = np.stack([np.array(line)[blocks.places[:, d].astype(int)] for d, line in enumerate(planes)], axis=1)
    return boundary_of(Blocks(blocks.corners, places), 2)[0]
