"""Certificates of rational elements: shells of cylinders and spheres, whose determinants are known in closed form."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON
from iga.certificate import certify
from iga.chunk import Chunk
from tests.meshes import discontinuous


def lattice(n):
    """Points of a hexahedron, n along each edge."""
    line = np.linspace(0.0, 1.0, n)
    return np.array(list(product(line, line, line)))


def test_cylinder_shell_is_exact():
    """Quarter of a cylinder, radii 1 to 2, as rational quadratic: det J = rho dtheta/ds, checked in closed form."""
    w = np.array([1.0, np.sqrt(0.5), 1.0])
    arc = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points = np.array([[*(rho * arc[j]), z] for rho in (1.0, 2.0) for j in range(3) for z in (0.0, 1.0)])
    weights = np.array([w[j] for _ in (1.0, 2.0) for j in range(3) for _ in (0.0, 1.0)])
    domain = discontinuous(bernstein(HEXAHEDRON, (1, 2, 1)), points[None], weights)
    made = certify(domain, tolerance=1e-6, max_depth=14)
    s = np.linspace(0.0, 1.0, 2001)
    below = (1 - s) ** 2 + 2 * w[1] * s * (1 - s) + s**2
    x = ((1 - s) ** 2 + 2 * w[1] * s * (1 - s)) / below
    y = (s**2 + 2 * w[1] * s * (1 - s)) / below
    speed = np.gradient(np.arctan2(y, x), s, edge_order=2)
    assert made.verdict[0] == 1
    assert made.upper[0] == pytest.approx(speed.min(), rel=1e-5)
    assert made.upper[0] - made.lower[0] <= 1e-6 * made.upper[0]


def octant_shell(inner=1.0, outer=2.0):
    """Octant of a spherical shell: biquadratic rational surface of revolution times a line, degenerate at the pole."""
    w = np.array([1.0, np.sqrt(0.5), 1.0])
    arc = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points, weights = [], []
    for i, j, rho in product(range(3), range(3), (inner, outer)):
        points.append([rho * arc[j, 0] * arc[i, 0], rho * arc[j, 0] * arc[i, 1], rho * arc[j, 1]])
        weights.append(w[i] * w[j])
    return discontinuous(bernstein(HEXAHEDRON, (2, 2, 1)), np.array(points)[None], np.array(weights))


def test_sphere_octant():
    domain = octant_shell()
    made = certify(domain)
    points = lattice(9)
    chunk = Chunk(domain, 0, np.array([0]), points, np.ones(len(points)))
    radius = np.linalg.norm(chunk.x[0], axis=1)
    assert np.abs(radius - 1.0 - points[:, 2]).max() < 1e-14
    # The pole edge collapses: the minimum is zero, touched and not passed.
    assert made.verdict[0] == 0
    assert abs(made.lower[0]) < 1e-10
    assert abs(made.upper[0]) < 1e-10


def test_sphere_patch_away_from_the_pole():
    """The octant cut at half of its second direction: certified, with the determinant rho^2 |n_u x n_v|."""
    domain = octant_shell()
    H = np.column_stack([domain.space.weights, domain.space.weights[:, None] * domain.points]).reshape(3, 3, 2, 4)
    a, b, c = H[:, 0], H[:, 1], H[:, 2]
    half = np.stack([a, (a + b) / 2, (a + 2 * b + c) / 4], axis=1).reshape(-1, 4)
    cut = discontinuous(bernstein(HEXAHEDRON, (2, 2, 1)), (half[:, 1:] / half[:, :1])[None], half[:, 0].copy())
    made = certify(cut, tolerance=1e-4, max_depth=12)
    points = lattice(17)
    chunk = Chunk(cut, 0, np.array([0]), points, np.ones(len(points)))
    n = chunk.x[0] / np.linalg.norm(chunk.x[0], axis=1, keepdims=True)
    area = np.einsum("qc,qc->q", np.cross(chunk.J[0, :, :, 0], chunk.J[0, :, :, 1]), n)
    assert made.verdict[0] == 1
    assert area.min() >= made.lower[0] - 1e-12
    assert made.upper[0] - made.lower[0] <= 1e-4 * made.upper[0]
    assert area.min() <= made.upper[0] * 1.01
