"""Meccanos of several blocks, turned every which way, and smooth maps of them, for tests."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from geometry.layouts.blocks import Blocks, place
from iga.cells import HEXAHEDRON, QUADRILATERAL


def complex_of(cells: np.ndarray, places: np.ndarray, turned: int | None = None) -> Blocks:
    """Blocks from corners (k, 2^d), each with its axes turned at random if a seed is given, right-handed."""
    if turned is None:
        return Blocks(cells, places)
    rng = np.random.default_rng(turned)
    d = places.shape[1]
    vertices = (HEXAHEDRON if d == 3 else QUADRILATERAL).vertices.astype(int)
    made = []
    for corners in cells:
        while True:
            axes = np.eye(d, dtype=int)[list(list(permutations(range(d)))[rng.integers(2 if d == 2 else 6)])]
            axes *= rng.choice([-1, 1], d)[:, None]
            if np.linalg.det(axes) > 0:
                break
        moved = (vertices * 2 - 1) @ axes
        made.append(corners[((moved[:, None] + 1) // 2 == vertices[None]).all(axis=2).argmax(axis=1)])
    return Blocks(np.array(made), places)


def polycube(voxels: list[tuple[int, ...]], turned: int | None = None) -> Blocks:
    """Unit cubes with lowest corners at integer places."""
    lowest = np.array(voxels)
    vertices = (HEXAHEDRON if lowest.shape[1] == 3 else QUADRILATERAL).vertices.astype(int)
    corners = lowest[:, None] + vertices
    places, number = np.unique(corners.reshape(-1, lowest.shape[1]), axis=0, return_inverse=True)
    return complex_of(number.reshape(corners.shape[:2]), places.astype(float), turned)


def ring(turned: int | None = None) -> Blocks:
    """Eight cubes around a hole."""
    return polycube([(i, j, 0) for i in range(3) for j in range(3) if (i, j) != (1, 1)], turned)


def seven(dim: int = 3, turned: int | None = None) -> Blocks:
    """A block in the middle and one on each of its sides; edges of valence three inside."""
    cell = HEXAHEDRON if dim == 3 else QUADRILATERAL
    n = 2**dim
    places = np.concatenate([(cell.vertices - 0.5) * 0.6, (cell.vertices - 0.5) * 2.0])
    blocks = [np.arange(n)]
    for face in cell.faces:
        inner = np.array(face.vertices)
        # Local coordinates s of the face, then outwards.
        corner = np.empty(n, dtype=int)
        for v, vertex in enumerate(cell.vertices.astype(int)):
            at = (face.origin + face.axes @ vertex[:-1]).astype(int)
            found = int((cell.vertices.astype(int) == at).all(axis=1).argmax())
            assert found in inner
            corner[v] = found + n * vertex[-1]
        blocks.append(corner)
    return complex_of(np.array(blocks), places, turned)


def ball(blocks: Blocks, block: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """Map of `seven` onto the unit ball, smooth in each block and continuous: the middle stays a cube."""
    x = place(blocks, block, xi)
    r = np.abs(x).max(axis=1, keepdims=True)
    t = (r - 0.3) / 0.7
    u = x / np.maximum(r, 0.3)
    return np.where(t > 0, (1 - t) * 0.3 * u + t * u / np.linalg.norm(u, axis=1, keepdims=True).clip(0.3), x)
