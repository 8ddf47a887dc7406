"""Small hexahedral meshes by name: boxes, balls of seven blocks, fans around an edge, tetrahedra in four.

Each function returns points (v, 3) and cells (e, 8) in the order of `iga.cells.HEXAHEDRON`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from iga.cells import HEXAHEDRON, TETRAHEDRON

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mesh = tuple[Array, Index]


def box(*n: int) -> Mesh:
    """Points and cells of a box of n1 x n2 x n3 unit cubes."""
    points = np.stack(np.meshgrid(*[np.arange(k + 1) for k in n], indexing="ij"), axis=-1).reshape(-1, 3)
    lower = np.stack(np.meshgrid(*[np.arange(k) for k in n], indexing="ij"), axis=-1).reshape(-1, 1, 3)
    strides = np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    return points.astype(float), (lower + HEXAHEDRON.vertices.astype(int)) @ strides


def ball() -> Mesh:
    """Seven blocks: a cube of half width 1/2 and six around it, out to half width 1."""
    corners = HEXAHEDRON.vertices - 0.5
    points = np.concatenate([corners, 2.0 * corners])
    cells = [np.arange(8)]
    for face in HEXAHEDRON.faces:
        quad = np.array(face.vertices)
        cells.append(np.concatenate([quad, quad + 8]))
    return points, np.array(cells)


def round_ball(n: int = 2) -> Mesh:
    """The seven-block ball with n cells a side of each block, its boundary vertices on the unit sphere.

    Lines of the faces run at equal angles; the cube inside has the half width 1/2 over the root of three.
    """
    s = np.linspace(-1.0, 1.0, n + 1)
    u, v, t = np.meshgrid(s, s, np.linspace(0.0, 1.0, n + 1), indexing="ij")
    half = 0.5 / np.sqrt(3.0)
    outside = np.stack([np.tan(np.pi / 4 * u), np.tan(np.pi / 4 * v), np.ones_like(u)], axis=-1)
    outside /= np.linalg.norm(outside, axis=-1, keepdims=True)
    inside = half * np.stack([u, v, np.ones_like(u)], axis=-1)
    top = inside + t[..., None] * (outside - inside)
    blocks = [half * np.stack(np.meshgrid(s, s, s, indexing="ij"), axis=-1)]
    for axis in range(3):
        blocks.append(np.roll(top, axis + 1, axis=-1))
        blocks.append(np.roll(top * [-1.0, 1.0, -1.0], axis + 1, axis=-1))  # half a turn about the second axis
    own = box(n, n, n)[1]
    corners = np.concatenate([b.reshape(-1, 3)[own] for b in blocks])
    _, first, number = np.unique(
        np.round(corners.reshape(-1, 3), 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    return corners.reshape(-1, 3)[first], number.reshape(-1, 8)


def fan(m: int, layers: int = 3, rings: int = 2, seed: int = 7, noise: float = 0.0) -> Mesh:
    """Prism around an edge line of valence m: m sectors of rings x rings quadrilaterals, extruded in layers."""
    numbers: dict[tuple[float, float], int] = {}
    plane: list[Array] = []

    def vertex(p: Array) -> int:
        key = (round(float(p[0]), 9) + 0.0, round(float(p[1]), 9) + 0.0)
        if key not in numbers:
            numbers[key] = len(plane)
            plane.append(p)
        return numbers[key]

    quads = []
    for k in range(m):
        a, b = (np.array([np.cos(t), np.sin(t)]) for t in (2 * np.pi * k / m, 2 * np.pi * (k + 1) / m))
        grid = [[vertex(i * a + j * b) for j in range(rings + 1)] for i in range(rings + 1)]
        quads += [
            [grid[i][j], grid[i][j + 1], grid[i + 1][j], grid[i + 1][j + 1]]
            for i in range(rings) for j in range(rings)
        ]
    flat = np.array(plane)
    n = len(flat)
    points = np.concatenate([np.column_stack([flat, np.full(n, float(z))]) for z in range(layers + 1)])
    base = np.array(quads)
    cells = np.concatenate([
        np.stack([base + z * n, base + (z + 1) * n], axis=2).reshape(-1, 8) for z in range(layers)
    ])
    points += noise * np.random.default_rng(seed).standard_normal(points.shape)
    return points, cells


def tetrahedron() -> Mesh:
    """One tetrahedron cut into four hexahedra."""
    return split_tetrahedra(TETRAHEDRON.vertices, np.array([[0, 1, 2, 3]]))


def split_tetrahedra(vertices: Array, tetrahedra: Array) -> Mesh:
    """Four hexahedra per tetrahedron, by vertices, edge midpoints, face centroids and the body centroid."""
    numbers: dict[frozenset[int], int] = {}
    points: list[Array] = []

    def at(*members: int) -> int:
        key = frozenset(members)
        if key not in numbers:
            numbers[key] = len(points)
            points.append(vertices[list(members)].mean(axis=0))
        return numbers[key]

    cells = []
    for tet in tetrahedra.tolist():
        for k, (p, q, o) in enumerate(((2, 1, 3), (0, 2, 3), (1, 0, 3), (0, 1, 2))):
            m, p, q, o = (tet[i] for i in (k, p, q, o))
            cells.append([at(m), at(m, o), at(m, q), at(m, q, o), at(m, p), at(m, p, o), at(m, p, q), at(*tet)])
    return np.array(points), np.array(cells)


def cross_of_tetrahedra(n: int) -> Mesh:
    """N tetrahedra around a common edge, each cut in four: interior vertices with mixed valences."""
    turn = 2 * np.pi * np.arange(n) / n
    rim = np.column_stack([np.cos(turn), np.sin(turn), 0.2 * np.cos(3 * turn)])
    vertices = np.concatenate([[[0, 0, -1], [0, 0, 1.0]], rim])
    tets = np.array([[0, 1, 2 + k, 2 + (k + 1) % n] for k in range(n)])
    return split_tetrahedra(vertices, tets)


def ring_of_tetrahedra() -> Mesh:
    """Five tetrahedra around an edge, each cut in four."""
    return cross_of_tetrahedra(5)


SHAPES: dict[str, Callable[[], Mesh]] = {
    "box": lambda: box(3, 3, 3), "ball": ball, "round_ball": round_ball,
    "tetrahedron": tetrahedron, "ring": ring_of_tetrahedra,
    **{f"fan_{m}": partial(fan, m) for m in (3, 5, 6, 8)},
}
"""Meshes that `source.build` knows by name."""
