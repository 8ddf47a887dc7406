r"""Tet meshes made by formula: a cube of Kuhn tetrahedra and a curved ball, for demonstrations, studies and tests.

The cube is cut into n^3 cells of six tetrahedra along their space diagonals. The ball starts from the eight tetrahedra
of an octahedron (centre and one face each), refined and mapped by

    x -> x (1 - w + w |x|_1 / |x|_2),    w = |x|_1^2,

which takes the octahedron's surface to the unit sphere, is close to the identity at the centre and smooth inside each
octant. Each Bezier tetrahedron interpolates the map at its lattice points.

Axis letters: e tetrahedron, n coefficient, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from geometry.tets.mesh import FACES, TetMesh, checked_mesh
from geometry.tets.reader import nodes_to_bernstein
from iga.bernstein import bernstein, elevation, greville
from iga.cells import TETRAHEDRON
from iga.conforming import Complex
from iga.errors import InputError
from iga.refinement import refine_coefficients, refine_complex

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def cube(n: int = 2, degree: int = 1) -> TetMesh:
    """Unit cube of 6 n^3 tetrahedra with the boundaries x0, x1, y0, y1, z0, z1."""
    if n < 1:
        raise InputError(f"a cube needs at least one cell a side, not {n}")
    grid = np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    unit = np.eye(3, dtype=np.int64)
    paths = np.array([np.concatenate([np.zeros((1, 3), dtype=np.int64), np.cumsum(unit[list(p)], axis=0)])
                      for p in permutations(range(3))])
    lattice = (grid + paths).reshape(-1, 4, 3)
    vertices = (lattice[..., 0] * (n + 1) + lattice[..., 1]) * (n + 1) + lattice[..., 2]
    faces, corners = vertices[:, FACES].reshape(-1, 3), lattice[:, FACES].reshape(-1, 3, 3)
    groups = {
        f"{axis}{side}": faces[(corners[:, :, c] == side * n).all(axis=1)]
        for c, axis in enumerate("xyz")
        for side in (0, 1)
    }
    mesh = checked_mesh(vertices, lattice / n, groups)
    return _raised(mesh, degree)


def ball(levels: int = 1, degree: int = 2) -> TetMesh:
    """Unit ball of 8^(levels+1) curved tetrahedra with the boundary "sphere"."""
    axes = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    signs = np.array([[1 + 3 * bool(code & 1), 2 + 3 * bool(code & 2), 3 + 3 * bool(code & 4)] for code in range(8)])
    vertices = np.concatenate([np.zeros((8, 1), dtype=np.int64), signs], axis=1)
    # Positive before refining, so that the surface is face 0 of its tetrahedra at every level.
    mirrored = np.linalg.det(axes[vertices[:, 1:]]) < 0
    vertices[mirrored] = vertices[mirrored][:, [0, 1, 3, 2]]
    coefficients = axes[vertices]
    for _ in range(levels):
        coefficients = refine_coefficients(bernstein(TETRAHEDRON, 1), coefficients)
        ((_, vertices),) = refine_complex(Complex(((TETRAHEDRON, vertices),))).parts
    corners = coefficients[:, FACES].reshape(-1, 3, 3)
    outside = (np.abs(np.abs(corners).sum(axis=2) - 1) < 1e-12).all(axis=1)
    groups = {"sphere": vertices[:, FACES].reshape(-1, 3)[outside]}
    return mapped(checked_mesh(vertices, coefficients, groups), _round, degree)


def _round(x: Array) -> Array:
    one, two = np.abs(x).sum(axis=-1), np.linalg.norm(x, axis=-1)
    w = one**2
    return x * (1 - w + w * one / np.where(two > 0, two, 1.0))[..., None]


def mapped(mesh: TetMesh, function: Callable[[Array], Array], degree: int | None = None) -> TetMesh:
    """Mesh whose tetrahedra interpolate ``function`` (points (..., 3) to points (..., 3)) at their lattice points."""
    target = _raised(mesh, mesh.degree if degree is None else degree)
    basis = bernstein(TETRAHEDRON, target.degree)
    nodes = np.matmul(basis.tabulate(greville(basis), 0)[0], target.coefficients)
    moved = np.matmul(nodes_to_bernstein(target.degree), np.asarray(function(nodes), dtype=float))
    return TetMesh(mesh.vertices, moved, mesh.boundaries, mesh.report)


def _raised(mesh: TetMesh, degree: int) -> TetMesh:
    if degree < mesh.degree:
        raise InputError(f"degree {degree} is lower than {mesh.degree}")
    matrix = elevation(bernstein(TETRAHEDRON, mesh.degree), (degree,))
    return TetMesh(mesh.vertices, np.matmul(matrix, mesh.coefficients), mesh.boundaries, mesh.report)
