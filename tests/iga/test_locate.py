"""Points found where they were made, on every cell, curved and rational; points outside told so."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iga import InputError
from iga.bernstein import bernstein, greville
from iga.block import Block, bezier_coefficients
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE
from iga.chunk import Chunk
from iga.conforming import straight_domain
from iga.domain import Domain, Space
from iga.locate import locate, tree
from tests.meshes import box_complex, mixed_complex

CELLS = [HEXAHEDRON, TETRAHEDRON, WEDGE, PYRAMID]


def inside(cell, count, random, margin=0.0):
    """Random points of a reference cell, not closer to its faces than the margin."""
    xi = margin + (1.0 - 2.0 * margin) * random.uniform(0.0, 1.0, (count, 3))
    if cell is TETRAHEDRON:
        return margin + (1.0 - 4.0 * margin) * random.dirichlet(np.ones(4), count)[:, :3]
    if cell is WEDGE:
        xi[:, :2] = margin + (1.0 - 3.0 * margin) * random.dirichlet(np.ones(3), count)[:, :2]
    if cell is PYRAMID:
        xi[:, :2] *= 1.0 - xi[:, 2:]
    return xi


def image(domain, block, element, xi):
    """x(xi) of one reference point for each element, (p, 3)."""
    made = np.full((len(xi), 3), np.nan)
    for number in np.unique(block[block >= 0]):
        rows = np.flatnonzero(block == number)
        b = domain.space.blocks[number]
        B = b.basis.tabulate(xi[rows], 0)[0]
        weights = np.ones(domain.space.n) if domain.space.weights is None else domain.space.weights
        values = np.column_stack([weights[:, None] * domain.points, weights])
        x = np.einsum("pb,pbc->pc", B, bezier_coefficients(b, values, element[rows]))
        made[rows] = x[:, :3] / x[:, 3:]
    return made


def curved(cell, n, degree, bend=0.05, spread=None, seed=3):
    """Unit cube in cells of a degree, control points moved by a smooth map (and weights by a smooth function)."""
    mesh, vertices = box_complex(cell, n)
    domain = straight_domain(mesh, vertices, degree)
    x, y, z = domain.points.T
    wave = np.column_stack([np.sin(3 * y + z), np.cos(2 * x - z), np.sin(x + 4 * y)])
    weights = None if spread is None else 1.0 + spread * np.sin(4 * x + 3 * y - 2 * z)
    space = Space(domain.space.blocks, domain.space.n, weights)
    return Domain(space, domain.points + bend * wave)


@pytest.mark.parametrize("spread", [None, 0.3])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cell", CELLS)
def test_round_trip(cell, degree, spread):
    domain = curved(cell, 3, degree, spread=spread)
    random = np.random.default_rng(5)
    elements = domain.space.blocks[0].elements
    element = random.integers(0, elements, 400)
    xi = inside(cell, 400, random, 0.01)
    block = np.zeros(400, dtype=np.int64)
    x = image(domain, block, element, xi)
    found = locate(domain, x)
    assert (found.block == 0).all()
    assert (found.element == element).all()
    assert np.abs(found.xi - xi).max() < 1e-9
    assert np.abs(image(domain, found.block, found.element, found.xi) - x).max() < 1e-12
    assert found.distance.max() < 1e-12


@pytest.mark.parametrize("cell", CELLS)
def test_vertices_edges_and_faces_have_an_owner(cell):
    domain = curved(cell, 2, 2)
    line = np.linspace(0.0, 1.0, 5)
    xi = np.array(list(product(line, line, line)))
    if cell is TETRAHEDRON:
        xi = xi[xi.sum(axis=1) <= 1.0]
    if cell is WEDGE:
        xi = xi[xi[:, :2].sum(axis=1) <= 1.0]
    if cell is PYRAMID:
        xi = np.column_stack([xi[:, :2] * (1 - xi[:, 2:]), xi[:, 2]])
    elements = np.arange(domain.space.blocks[0].elements)
    x = Chunk(domain, 0, elements, xi, np.ones(len(xi))).x.reshape(-1, 3)
    found = locate(domain, x)
    assert (found.element >= 0).all()
    assert np.abs(image(domain, found.block, found.element, found.xi) - x).max() < 1e-9


def test_mixed_cells():
    mesh, vertices = mixed_complex()
    domain = straight_domain(mesh, vertices, 2)
    random = np.random.default_rng(7)
    for number, block in enumerate(domain.space.blocks):
        xi = inside(block.basis.cell, 50, random, 0.01)
        element = random.integers(0, block.elements, 50)
        x = image(domain, np.full(50, number), element, xi)
        found = locate(domain, x)
        assert (found.block == number).all()
        assert (found.element == element).all()
        assert np.abs(found.xi - xi).max() < 1e-9


@pytest.mark.parametrize("cell", CELLS)
def test_outside_is_told_and_nearest_is_near(cell):
    mesh, vertices = box_complex(cell, 2)
    domain = straight_domain(mesh, vertices, 2)
    random = np.random.default_rng(11)
    x = random.uniform(-0.4, 1.4, (300, 3))
    out = (x < -1e-6).any(axis=1) | (x > 1.0 + 1e-6).any(axis=1)
    found = locate(domain, x)
    assert (found.element[out] == -1).all()
    assert np.isnan(found.xi[out]).all()
    assert np.isinf(found.distance[out]).all()
    assert (found.element[~out] >= 0).all()
    near = locate(domain, x, nearest=True)
    assert (near.element >= 0).all()
    exact = np.linalg.norm(x - np.clip(x, 0.0, 1.0), axis=1)
    assert np.abs(near.distance - exact).max() < 1e-9
    assert np.abs(image(domain, near.block, near.element, near.xi) - np.clip(x, 0.0, 1.0)).max() < 1e-6


def shell(n):
    """Quarter of a cylindrical shell, radii 1 and 2, one rational element."""
    w = np.array([1.0, np.sqrt(0.5), 1.0])
    arc = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points = np.array([[*(rho * arc[j]), z] for rho in (1.0, 2.0) for j in range(3) for z in (0.0, 1.0)])
    weights = np.array([w[j] for _ in range(2) for j in range(3) for _ in range(2)])
    block = Block(bernstein(HEXAHEDRON, (1, 2, 1)), np.arange(n)[None])
    return Domain(Space((block,), n, weights), points)


def test_rational_shell_in_closed_form():
    domain = shell(12)
    random = np.random.default_rng(13)
    x = random.uniform([-0.2, -0.2, -0.2], [2.2, 2.2, 1.2], (2000, 3))
    radius = np.hypot(x[:, 0], x[:, 1])
    inside_ = (radius >= 1) & (radius <= 2) & (x >= 0).all(axis=1) & (x[:, 2] <= 1)
    found = locate(domain, x)
    assert ((found.element == 0) == inside_).all()
    assert np.abs(found.xi[inside_, 0] - (radius[inside_] - 1.0)).max() < 1e-12
    assert np.abs(found.xi[inside_, 2] - x[inside_, 2]).max() < 1e-12
    near = locate(domain, x, nearest=True)
    first = (x >= 0).all(axis=1) & (x[:, 2] <= 1) & ~inside_
    assert np.abs(near.distance[first] - np.maximum(1 - radius[first], radius[first] - 2)).max() < 1e-9


@given(st.integers(1, 10**6), st.sampled_from(CELLS), st.integers(1, 3), st.floats(0.0, 0.12), st.booleans())
@settings(max_examples=40, deadline=None)
def test_points_of_random_elements_are_found(seed, cell, degree, noise, rational):
    """One element with control points at random about the identity: every one of its points is found."""
    basis = bernstein(cell, degree)
    random = np.random.default_rng(seed)
    points = greville(basis) + noise / degree * random.uniform(-1.0, 1.0, (basis.n, 3))
    weights = random.uniform(0.6, 1.6, basis.n) if rational else None
    domain = Domain(Space((Block(basis, np.arange(basis.n)[None]),), basis.n, weights), points)
    zero = np.zeros(20, dtype=np.int64)
    x = image(domain, zero, zero, inside(cell, 20, random))
    found = locate(domain, x)
    assert (found.element == 0).all()
    assert np.abs(image(domain, found.block, found.element, found.xi) - x).max() < 1e-9


def test_collapsed_hexahedron():
    """Points of a tetrahedron given as one hexahedron, also close to the collapsed faces."""
    basis = bernstein(HEXAHEDRON, 1)
    r, s, t = HEXAHEDRON.vertices.T
    points = np.column_stack([r, (1 - r) * s, (1 - r) * (1 - s) * t])
    domain = Domain(Space((Block(basis, np.arange(8)[None]),), 8), points)
    x = inside(TETRAHEDRON, 300, np.random.default_rng(17))
    x = np.vstack([x, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, 0.7, 0.0]]])
    found = locate(domain, x)
    assert (found.element == 0).all()
    assert np.abs(image(domain, found.block, found.element, found.xi) - x).max() < 1e-9


def test_tree_is_reused_and_far_from_the_origin():
    domain = curved(HEXAHEDRON, 3, 2)
    far = Domain(domain.space, domain.points + np.array([1e4, -2e4, 3e4]))
    random = np.random.default_rng(19)
    xi = inside(HEXAHEDRON, 100, random, 0.02)
    element = random.integers(0, 27, 100)
    x = image(far, np.zeros(100, dtype=np.int64), element, xi)
    boxes = tree(far)
    found = locate(far, x, boxes=boxes)
    assert (found.element == element).all()
    assert np.abs(found.xi - xi).max() < 1e-9
    again = locate(far, x[::-1].copy(), boxes=boxes)
    assert (again.element == found.element[::-1]).all()


def test_no_points_and_no_elements():
    domain = curved(HEXAHEDRON, 1, 1)
    assert len(locate(domain, np.empty((0, 3))).element) == 0
    empty = Domain(Space((Block(bernstein(HEXAHEDRON, 1), np.empty((0, 8), dtype=np.int64)),), 0), np.empty((0, 3)))
    assert (locate(empty, np.zeros((2, 3)), nearest=True).element == -1).all()


def test_bad_requests():
    domain = curved(HEXAHEDRON, 1, 1)
    with pytest.raises(InputError, match="shape"):
        locate(domain, np.zeros(3))
    with pytest.raises(InputError, match="point 1 "):
        locate(domain, np.array([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]]))
    with pytest.raises(InputError, match="tolerance"):
        locate(domain, np.zeros((1, 3)), tolerance=-1.0)
    weights = np.ones(8)
    weights[3] = -0.1
    bad = Domain(Space(domain.space.blocks, 8, weights), domain.points)
    with pytest.raises(InputError, match="weight"):
        locate(bad, np.zeros((1, 3)))
