"""Truncated hierarchical splines: a partition of unity, glued C0, smooth inside, nested, of optimal order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from geometry.layouts.blocks import Blocks, cube, place
from geometry.meccano.collocation import collocation, prolongation, quasi_interpolation, refine
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.splines import bezier_table, refinement_table
from geometry.meccano.tmesh import refined, transitions, uniform
from geometry.meccano.traces import boundaries, functions_on
from iga.bernstein import bernstein
from iga.block import Kronecker, bezier_coefficients, dense_extraction
from iga.cells import LINE
from iga.certificate import certify
from iga.domain import Domain, check
from iga.errors import InputError
from iga.norms import errors
from problems.manufactured import solve_exact
from tests.geometry.meccano_shapes import ball, polycube, ring, seven


def local(blocks: Blocks, degree: int, seed: int, rounds: int = 2, level: int = 1, graded: bool = True) -> Hierarchy:
    """Space on a mesh refined around random cells of random blocks."""
    rng = np.random.default_rng(seed)
    tmesh = uniform(blocks, level, degree if graded else 0)
    for _ in range(rounds):
        mark = int(rng.integers(tmesh.cells))
        near = np.abs(tmesh.corner - tmesh.corner[mark]).max(axis=1) <= 2 * tmesh.size[mark]
        tmesh = refined(tmesh, near & (tmesh.block == tmesh.block[mark]))
    return hierarchy(tmesh, degree)


CASES = [
    (cube(2), 3, 4), (cube(3), 3, 4), (seven(2, 5), 1, 1), (seven(2, 5), 4, 1), (seven(2), 2, 2), (seven(3, 5), 3, 1),
    (seven(3, 6), 2, 9), (ring(7), 1, 3), (ring(7), 3, 3),
    (polycube([(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1)], 3), 3, 4),
]


@pytest.fixture(scope="module", params=range(len(CASES)), ids=lambda k: f"{len(CASES[k][0].corners)}x{CASES[k][1]}")
def space(request: pytest.FixtureRequest) -> Hierarchy:
    return local(*CASES[request.param])


def points_of(own: Hierarchy, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, len(own.tmesh.blocks.corners), count), rng.random((count, own.tmesh.dim))


@pytest.mark.parametrize("p", [1, 2, 3, 4])
def test_tables_are_those_of_open_uniform_knots(p: int) -> None:
    B = bernstein(LINE, p)
    x = np.array([0.13, 0.57, 0.91])
    for level in (0, 1, 2, 4):
        n = 2**level
        knots = np.concatenate([np.zeros(p), np.linspace(0, 1, n + 1), np.ones(p)])
        fine = np.concatenate([np.zeros(p), np.linspace(0, 1, 2 * n + 1), np.ones(p)])
        for c in range(n):
            left, right = min(c, p - 1), min(n - 1 - c, p - 1)
            N = BSpline.design_matrix((c + x) / n, knots, p).toarray()[:, c : c + p + 1]
            assert np.abs(B.tabulate(x[:, None], 0)[0] @ bezier_table(p)[left, right].T - N).max() < 1e-13
            for half in (0, 1):
                N = BSpline.design_matrix((c + (half + x) / 2) / n, knots, p).toarray()[:, c : c + p + 1]
                M = BSpline.design_matrix((2 * c + half + x) / 2 / n, fine, p).toarray()
                first = 2 * c + half
                assert np.abs(M[:, first : first + p + 1] @ refinement_table(p)[left, right, half].T - N).max() < 1e-13


def test_functions_are_a_convex_partition_of_unity(space: Hierarchy) -> None:
    for block in space.space.blocks:
        C = dense_extraction(block, slice(None))
        assert C is not None
        assert C.min() >= 0
        assert np.abs(C.sum(axis=1) - 1.0).max() < 1e-13
        assert (C.max(axis=2) > 0).all()
        ordered = np.sort(block.dofs, axis=1)
        assert (np.diff(ordered, axis=1) > 0).all()
    assert space.tmesh.level.max() > space.tmesh.level.min()
    assert sum(b.elements for b in space.space.blocks) == space.tmesh.cells


def test_functions_are_what_they_expand_to_on_every_cell(space: Hierarchy) -> None:
    values = np.random.default_rng(2).normal(size=(space.n, 3))
    coefficients = space.expansion @ values
    plain = bezier_coefficients(space.cells, coefficients)
    for number, block in enumerate(space.space.blocks):
        mine = np.flatnonzero(space.element[:, 0] == number)
        assert np.abs(bezier_coefficients(block, values)[space.element[mine, 1]] - plain[mine]).max() < 1e-13
    assert (coefficients[space.own] == values).all()
    assert np.abs(space.expansion.sum(axis=1) - 1.0).max() < 1e-13


def test_admissible_meshes_keep_few_functions_on_an_element(space: Hierarchy) -> None:
    d, p = space.tmesh.dim, space.degree
    for block in space.space.blocks:
        assert block.n < 2 * (p + 1) ** d
        for e in range(0, block.elements, 7):
            assert np.ptp(space.level[block.dofs[e]]) <= 1


def test_no_points_have_no_rows(space: Hierarchy) -> None:
    assert collocation(space, np.empty(0, dtype=np.int64), np.empty((0, space.tmesh.dim))).shape == (0, space.n)


def test_functions_are_continuous_across_sides(space: Hierarchy) -> None:
    blocks = space.tmesh.blocks
    A, t = transitions(blocks)
    s = np.random.default_rng(3).random((15, blocks.dim - 1))
    for block, side in np.argwhere(blocks.across[:, :, 0] >= 0).tolist():
        face = blocks.cell.faces[side]
        xi = face.origin + s @ face.axes.T
        here = collocation(space, np.full(15, block), xi)
        there = collocation(space, np.full(15, blocks.across[block, side, 0]), xi @ A[block, side].T + t[block, side])
        assert abs(here - there).max() < 1e-13


def test_functions_are_smooth_inside_blocks(space: Hierarchy) -> None:
    """On the faces of leaf cells inside a block all derivatives up to p - 1 agree from both sides."""
    tmesh, p, d = space.tmesh, space.degree, space.tmesh.dim
    rng = np.random.default_rng(8)
    cells = rng.integers(0, tmesh.cells, 40)
    axis = rng.integers(0, d, 40)
    low = tmesh.corner[cells] / 2.0**20
    xi = low + rng.random((40, d)) * (tmesh.size[cells] / 2.0**20)[:, None]
    xi[np.arange(40), axis] = low[np.arange(40), axis]
    keep = xi[np.arange(40), axis] > 0
    xi, axis, block = xi[keep], axis[keep], tmesh.block[cells[keep]]
    before = xi.copy()
    before[np.arange(len(xi)), axis] -= 2.0**-50  # in the cell before; values change by 1e-15 of the derivative
    for a in range(d):
        mine = axis == a
        for order in range(min(p, 3)):
            derivative = tuple(order if k == a else 0 for k in range(d))
            jump = collocation(space, block[mine], xi[mine], derivative) - collocation(
                space, block[mine], before[mine], derivative
            )
            scale = 4.0 ** ((order + 1) * tmesh.level.max())
            assert abs(jump).max() < 1e-13 * scale


def test_quasi_interpolation_is_a_projection(space: Hierarchy) -> None:
    block, xi, L = quasi_interpolation(space)
    near = abs(L @ collocation(space, block, xi) - np.eye(space.space.n)).max()
    assert near < (1e-12 if space.degree < 4 else 1e-11)
    coefficients = L @ place(space.tmesh.blocks, block, xi)
    b, x = points_of(space, 200, 1)
    if space.degree >= space.tmesh.dim or not len(space.tmesh.blocks.corners) > 1:
        found = collocation(space, b, x) @ coefficients
        assert np.abs(found - place(space.tmesh.blocks, b, x)).max() < 1e-12


def test_spaces_are_nested(space: Hierarchy) -> None:
    rng = np.random.default_rng(17)
    b, x = points_of(space, 150, 2)
    coarse = collocation(space, b, x)
    for cells in (None, rng.integers(0, space.tmesh.cells, 3)):
        if cells is None and space.tmesh.cells > 600:
            continue
        finer, T = refine(space, cells)
        assert abs(collocation(finer, b, x) @ T - coarse).max() < 1e-13
        assert T.min() >= 0
        assert np.abs(T.sum(axis=1) - 1.0).max() < 1e-12
    with pytest.raises(InputError, match="not nested"):
        prolongation(refine(space)[0] if space.tmesh.cells <= 600 else finer, space)


def test_traces(space: Hierarchy) -> None:
    blocks = space.tmesh.blocks
    on = functions_on(space)
    rng = np.random.default_rng(4)
    seen = np.zeros(space.space.n, dtype=bool)
    for block, side in blocks.boundary_sides.tolist():
        face = blocks.cell.faces[side]
        xi = face.origin + rng.random((1500, blocks.dim - 1)) @ face.axes.T
        own = np.unique(collocation(space, np.full(1500, block), xi).indices)
        seen[own] = True
        assert np.isin(own, functions_on(space, np.array([[block, side]]))).all()
    assert np.isin(np.flatnonzero(seen), on).all()
    assert len(on) - seen.sum() <= 0.02 * len(on)  # all but those whose traces are tiny where no point fell


def test_without_refinement_it_is_the_tensor_product_space() -> None:
    own = hierarchy(uniform(cube(), 2), 3)
    assert own.space.n == 7**3
    assert len(own.space.blocks) == 1
    assert isinstance(own.space.blocks[0].extraction, Kronecker)
    glued = hierarchy(uniform(ring(3), 1), 3)
    # Eight blocks of 5^3 functions; 8 shared sides of 25.
    assert glued.space.n == 8 * 125 - 8 * 25
    seven_blocks = hierarchy(uniform(seven(3, 2), 0), 3)
    # Open pieces: 7 blocks, 6 + 12 + 6 sides, 12 + 12 + 8 edges, 16 corners, with 8, 4, 2 and 1 functions.
    assert seven_blocks.space.n == 7 * 8 + 24 * 4 + 32 * 2 + 16


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), st.booleans())
def test_any_mesh_gives_a_basis(seed: int, degree: int, graded: bool) -> None:
    own = local(seven(2, seed), degree, seed, 3, graded=graded)
    for block in own.space.blocks:
        C = dense_extraction(block, slice(None))
        assert C is not None
        assert C.min() >= 0
        assert np.abs(C.sum(axis=1) - 1.0).max() < 1e-13
    block, xi, L = quasi_interpolation(own)
    assert abs(L @ collocation(own, block, xi) - np.eye(own.space.n)).max() < 1e-11  # hence independent


def test_refining_keeps_the_solid() -> None:
    blocks = seven(3, 3)
    own = local(blocks, 3, 5, rounds=1)
    block, xi, L = quasi_interpolation(own)
    points = L @ ball(blocks, block, xi)
    domain = Domain(own.space, points, boundaries(own))
    check(domain)
    assert (certify(domain).verdict == 1).all()
    finer, T = refine(own, np.array([5, 60]))
    b, x = points_of(own, 300, 6)
    assert np.abs(collocation(finer, b, x) @ (T @ points) - collocation(own, b, x) @ points).max() < 1e-13


def start(level: int) -> tuple[Hierarchy, np.ndarray]:
    """A ball of seven patches, locally refined, and its control points."""
    blocks = seven(3, 3)
    tmesh = uniform(blocks, level, 3)
    centre = place(blocks, tmesh.block, (tmesh.corner + tmesh.size[:, None] / 2) / 2.0**20)
    own = hierarchy(refined(tmesh, centre @ [1.0, 0.9, 0.8] > 1.0))
    assert own.tmesh.level.max() == level + 1 > own.tmesh.level.min()
    block, xi, L = quasi_interpolation(own)
    return own, L @ ball(blocks, block, xi)


def rates(levels: int) -> list[tuple[float, float]]:
    own, points = start(1)
    found = []
    for level in range(levels):
        if level:
            own, T = refine(own)
            points = T @ points
        domain = Domain(own.space, points, boundaries(own))
        solution = solve_exact(domain, "heat", "sin(x+y/2)*exp(z/2)")[0]
        assert solution.norms is not None
        found.append((solution.norms.l2, solution.norms.h1))
    return found


def test_heat_converges_at_the_optimal_rate() -> None:
    coarse, fine = rates(2)
    assert fine[0] < 2e-3
    assert fine[1] < 2e-2
    assert np.log2(coarse[0] / fine[0]) > 2.0
    assert np.log2(coarse[1] / fine[1]) > 1.8


def test_linear_temperature_is_exact() -> None:
    own, points = start(1)
    domain = Domain(own.space, points, boundaries(own))
    solution = solve_exact(domain, "heat", "1+x-2*y+3*z")[0]
    assert solution.norms is not None
    assert solution.norms.h1 < 1e-10
    exact = errors(domain, points, lambda x: x)
    assert exact.l2 < 1e-13


def test_approximation_has_the_optimal_order() -> None:
    """Thirty-two times finer than a locally refined start, in the plane and the maximum norm.

    Errors are largest near the sides of blocks, so mean squares fall faster than in theory for a long time.
    """
    blocks = seven(2, 3)
    own = local(blocks, 3, 5, rounds=1, level=1)
    x = np.random.default_rng(29).random((4000, 2))
    block = np.arange(4000) % len(blocks.corners)

    def function(block: np.ndarray, xi: np.ndarray) -> np.ndarray:
        x, y = place(blocks, block, xi).T
        return np.sin(3 * x + y) * np.exp(y)

    step = np.array([1e-5, 0.0])
    slope = (function(block, x + step) - function(block, x - step)) / 2e-5
    found = []
    for level in range(6):
        if level:
            own = hierarchy(refined(own.tmesh))
        where, xi, L = quasi_interpolation(own)
        c = L @ function(where, xi)
        found.append([
            np.abs(collocation(own, block, x) @ c - function(block, x)).max(),
            np.abs(collocation(own, block, x, (1, 0)) @ c - slope).max(),
        ])
    assert own.tmesh.level.max() > own.tmesh.level.min()
    rate = np.log2(np.array(found)[:-1] / np.array(found)[1:])
    assert rate[-1] == pytest.approx([4, 3], abs=0.1)
    assert (rate[-3:] > [3.9, 2.9]).all()
    assert found[-1][0] < 1e-7


@pytest.mark.long
def test_rates_of_four_levels() -> None:
    """The last rates measured are 4.45 and 3.31: still above theory on meshes that three dimensions allow."""
    found = np.array(rates(4))
    slope = np.log2(found[:-1] / found[1:])
    assert slope[-1, 0] > 3.8
    assert slope[-1, 1] > 2.8
    assert found[-1, 0] < 2e-6
