"""Bernstein bases: partition of unity, derivatives, traces, elevation, on every cell and degree."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from iga.bernstein import bernstein, elevation, face_functions, greville, lagrange_to_bernstein
from iga.cells import CELLS, HEXAHEDRON, PYRAMID, WEDGE, Cell
from iga.errors import InputError
from iga.quadrature import gauss

CASES = [(cell, p) for cell, p in product(CELLS.values(), range(7))]
ANISOTROPIC = [(HEXAHEDRON, (1, 3, 2)), (WEDGE, (2, 4)), (CELLS["quadrilateral"], (3, 1))]


def inside(cell: Cell, count: int = 40) -> np.ndarray:
    """Random points of a cell."""
    rng = np.random.default_rng(173)
    weights = rng.dirichlet(np.ones(len(cell.vertices)), count)
    return weights @ cell.vertices


@pytest.mark.parametrize(("cell", "degree"), CASES + ANISOTROPIC)
def test_sums_to_one_and_is_not_negative(cell: Cell, degree: int) -> None:
    values, gradients, second = bernstein(cell, degree).tabulate(inside(cell), 2)
    assert np.abs(values.sum(axis=1) - 1).max() < 1e-13
    assert values.min() >= 0
    assert np.abs(gradients.sum(axis=1)).max() < 1e-11
    assert np.abs(second.sum(axis=1)).max() < 1e-9


@pytest.mark.parametrize(("cell", "degree"), [case for case in CASES if case[1] > 0] + ANISOTROPIC)
def test_greville_points_reproduce_the_identity(cell: Cell, degree: int) -> None:
    basis, points = bernstein(cell, degree), inside(cell)
    assert np.abs(basis.tabulate(points, 0)[0] @ greville(basis) - points).max() < 1e-13


@pytest.mark.parametrize(("cell", "degree"), CASES + ANISOTROPIC)
def test_derivatives_have_second_order_differences(cell: Cell, degree: int) -> None:
    basis = bernstein(cell, degree)
    points = 0.8 * inside(cell) + 0.2 * cell.centre
    errors = []
    for h in (1e-3, 5e-4):
        worst = 0.0
        for d in range(cell.dim):
            step = h * np.eye(cell.dim)[d]
            (up, gup), (down, gdown) = (basis.tabulate(points + s * step, 1) for s in (1, -1))
            _, gradients, second = basis.tabulate(points, 2)
            worst = max(worst, np.abs((up - down) / (2 * h) - gradients[..., d]).max(),
                        np.abs((gup - gdown) / (2 * h) - second[..., d]).max())
        errors.append(worst)
    assert errors[1] < 1e-9 or np.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.parametrize("cell", CELLS.values(), ids=str)
def test_degree_one_functions_are_the_vertices(cell: Cell) -> None:
    assert np.array_equal(bernstein(cell, 1).tabulate(cell.vertices, 0)[0], np.eye(len(cell.vertices)))


@pytest.mark.parametrize(("cell", "degree"), [c for c in CASES if c[0].dim > 1 and c[1] > 0] + ANISOTROPIC)
def test_traces_are_the_basis_of_the_face(cell: Cell, degree: int) -> None:
    basis = bernstein(cell, degree)
    for number, face in enumerate(cell.faces):
        trace, functions = face_functions(basis, number)
        points = inside(face.cell)
        values = basis.tabulate(face.origin + points @ face.axes.T, 0)[0]
        assert np.abs(values[:, functions] - trace.tabulate(points, 0)[0]).max() < 1e-13
        assert np.abs(np.delete(values, functions, axis=1)).max(initial=0.0) < 1e-13


@pytest.mark.parametrize(("cell", "degree"), CASES[:-7] + ANISOTROPIC)
def test_elevation_keeps_the_function(cell: Cell, degree: int) -> None:
    basis = bernstein(cell, degree)
    higher = bernstein(cell, tuple(p + 2 for p in basis.degree))
    points = inside(cell)
    raised = higher.tabulate(points, 0)[0] @ elevation(basis, higher.degree)
    assert np.abs(raised - basis.tabulate(points, 0)[0]).max() < 1e-13


def test_pyramid_dimension_and_apex() -> None:
    assert [bernstein(PYRAMID, p).n for p in range(1, 5)] == [5, 14, 30, 55]
    values = bernstein(PYRAMID, 3).tabulate(np.array([[0.0, 0.0, 1.0]]), 0)[0]
    assert values[0, -1] == 1.0
    assert values.sum() == 1.0


def test_pyramid_holds_all_polynomials() -> None:
    rng = np.random.default_rng(29)
    for p in range(1, 5):
        basis, points = bernstein(PYRAMID, p), inside(PYRAMID, 300)
        powers = [e for e in product(range(p + 1), repeat=3) if sum(e) <= p]
        monomials = np.stack([np.prod(points**e, axis=1) for e in powers], axis=1) @ rng.normal(size=(len(powers), 3))
        values = basis.tabulate(points, 0)[0]
        assert np.linalg.matrix_rank(values) == basis.n
        solution = np.linalg.lstsq(values, monomials, rcond=None)[0]
        assert np.abs(values @ solution - monomials).max() < 1e-11


@pytest.mark.parametrize(("cell", "degree"), [(c, p) for c, p in CASES if 0 < p < 5])
def test_lagrange_values_give_back_coefficients(cell: Cell, degree: int) -> None:
    basis = bernstein(cell, degree)
    nodes = greville(basis)
    coefficients = np.random.default_rng(31).normal(size=basis.n)
    values = basis.tabulate(nodes, 0)[0] @ coefficients
    assert np.abs(lagrange_to_bernstein(basis, nodes) @ values - coefficients).max() < 1e-11


def test_bad_degrees_are_refused() -> None:
    with pytest.raises(InputError, match="degree"):
        bernstein(HEXAHEDRON, (1, 2))
    with pytest.raises(InputError, match="degree"):
        bernstein(WEDGE, -1)
    with pytest.raises(InputError, match="cannot be elevated"):
        elevation(bernstein(HEXAHEDRON, 3), (3, 2, 3))


def test_quadrature_sees_the_basis() -> None:
    # All Bernstein functions of a polynomial cell have the same integral.
    for cell in CELLS.values():
        if cell is PYRAMID:
            continue
        basis, rule = bernstein(cell, 3), gauss(cell, 4)
        integrals = rule.weights @ basis.tabulate(rule.points, 0)[0]
        assert np.abs(integrals - cell.volume / basis.n).max() < 1e-15
