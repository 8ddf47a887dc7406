"""Quadrature: each rule integrates all monomials of its stated family and degree, and no more is claimed."""

from __future__ import annotations

from itertools import product
from math import factorial

import numpy as np
import pytest

from iga.bernstein import bernstein
from iga.cells import CELLS, PYRAMID, Cell
from iga.errors import InputError
from iga.quadrature import gauss


def exact(cell: Cell, e: tuple[int, ...]) -> float:
    """Integral of x^e over a reference cell."""
    if cell.name in ("triangle", "tetrahedron"):
        return float(np.prod([factorial(k) for k in e])) / factorial(sum(e) + cell.dim)
    if cell.name == "wedge":
        return factorial(e[0]) * factorial(e[1]) / factorial(e[0] + e[1] + 2) / (e[2] + 1)
    if cell.name == "pyramid":
        a, b, c = e
        return factorial(c) * factorial(a + b + 2) / factorial(a + b + c + 3) / ((a + 1) * (b + 1))
    return float(np.prod([1 / (k + 1) for k in e]))


def family(cell: Cell, degree: int) -> list[tuple[int, ...]]:
    """Exponents that a rule of this degree is stated to integrate."""
    grid = product(range(degree + 1), repeat=cell.dim)
    if cell.name in ("triangle", "tetrahedron", "pyramid"):
        return [e for e in grid if sum(e) <= degree]
    if cell.name == "wedge":
        return [e for e in grid if e[0] + e[1] <= degree]
    return list(grid)


@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.parametrize("cell", CELLS.values(), ids=str)
def test_exact_to_the_stated_degree(cell: Cell, n: int) -> None:
    rule = gauss(cell, n)
    assert rule.degree == (2 * n - 1,) * cell.dim
    assert rule.weights.min() > 0
    for e in family(cell, 2 * n - 1):
        assert abs(rule.weights @ np.prod(rule.points**e, axis=1) - exact(cell, e)) < 1e-15 * 10
    beyond = tuple([2 * n] + [0] * (cell.dim - 1))
    assert abs(rule.weights @ np.prod(rule.points**beyond, axis=1) - exact(cell, beyond)) > 1e-14


@pytest.mark.parametrize("p", range(1, 5))
def test_pyramid_rule_is_exact_for_products_of_rational_functions(p: int) -> None:
    fine, rule = gauss(PYRAMID, 12), gauss(PYRAMID, p + 1)
    tables = [bernstein(PYRAMID, p).tabulate(r.points, 1) for r in (fine, rule)]
    masses = [t[0].T @ (r.weights[:, None] * t[0]) for t, r in zip(tables, (fine, rule))]
    assert np.abs(masses[0] - masses[1]).max() < 1e-15
    stiffness = [np.einsum("qid,q,qjd->ij", t[1], r.weights, t[1]) for t, r in zip(tables, (fine, rule))]
    assert np.abs(stiffness[0] - stiffness[1]).max() < 1e-13


def test_bad_counts_are_refused() -> None:
    with pytest.raises(InputError, match="Gauss points"):
        gauss(PYRAMID, 0)
    with pytest.raises(InputError, match="1000 x 1000 x 1000 Gauss points"):
        gauss(PYRAMID, 1000)
    with pytest.raises(InputError, match="2 numbers of Gauss points"):
        gauss(PYRAMID, (2, 2))
