"""Bernstein coefficients of det J: against exact rational arithmetic, within the stated rounding bound."""

from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np
import pytest

from iga.bernstein import bernstein, greville
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE
from iga.determinant import determinant, kernel_plan
from iga.kernels.jacobian import coefficients


def multiply(a, b):
    made = {}
    for i, x in a.items():
        for j, y in b.items():
            key = tuple(p + q for p, q in zip(i, j))
            made[key] = made.get(key, Fraction(0)) + x * y
    return made


def exact_determinant(columns):
    """Determinant of polynomials {exponent: coefficient} by expansion in the first column."""
    if len(columns) == 1:
        return columns[0][0]
    total = {}
    for row in range(len(columns)):
        minor = [[c for r, c in enumerate(column) if r != row] for column in columns[1:]]
        for key, value in multiply(columns[0][row], exact_determinant(minor)).items():
            total[key] = total.get(key, Fraction(0)) + (-1) ** row * value
    return total


def exact_coefficients(plan_of, homogeneous):
    """Bernstein coefficients of the determinant by exact arithmetic, in the form's order."""
    columns = []
    for factor in plan_of.factors:
        matrix = [[Fraction(v) for v in row] for row in factor.matrix.tolist()]
        values = [[sum(m * x for m, x in zip(row, component)) for row in matrix] for component in homogeneous]
        columns.append([
            {tuple(e): v * Fraction(s) for e, v, s in zip(factor.form.exponents.tolist(), component,
                                                         factor.form.scale.tolist())}
            for component in values
        ])
    total = exact_determinant(columns)
    shape = plan_of.form
    column = 0
    for (coordinates, degree), (_, low) in zip(
        shape.sizes, [(c, sum(f.form.sizes[g][1] for f in plan_of.factors)) for g, (c, _) in enumerate(shape.sizes)]
    ):
        for _ in range(degree - low):
            one = {}
            for v in range(coordinates):
                key = [0] * shape.exponents.shape[1]
                key[column + v] = 1
                one[tuple(key)] = Fraction(1)
            total = multiply(total, one)
        column += coordinates
    scale = Fraction(plan_of.scale)
    return [scale * total.get(tuple(e), Fraction(0)) / Fraction(s)
            for e, s in zip(shape.exponents.tolist(), shape.scale.tolist())]


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize(
    ("cell", "degree"), [(TETRAHEDRON, (2,)), (HEXAHEDRON, (1, 2, 1)), (WEDGE, (2, 1)), (PYRAMID, (2,))]
)
def test_coefficients_within_the_stated_rounding_bound(cell, degree, rational):
    """Computed coefficients differ from exact ones by less than the bound, which itself is small."""
    basis = bernstein(cell, degree)
    random = np.random.default_rng(11)
    x = greville(basis) + 0.2 * random.standard_normal((basis.n, 3)) + [3.0, -5.0, 7.0]
    P = x[None]
    if rational:
        w = random.uniform(0.5, 2.0, basis.n)
        P = np.column_stack([w, w[:, None] * x])[None]
    plan_of, plan = determinant(basis, rational), kernel_plan(basis, rational)
    numerator = np.empty((1, len(plan.used)))
    weight = np.empty((1, len(plan.used) if rational else 0))
    bounds, corner = np.empty((1, 4)), np.zeros(1, dtype=np.int64)
    slack = 4.0 * 2.0**-53 * np.abs(P[0]).max(axis=0)
    coefficients(plan, P, slack, 0, 1, True, numerator, weight, bounds, corner)
    exact = exact_coefficients(plan_of, [[Fraction(v) for v in column] for column in P[0].T.tolist()])
    error = max(abs(Fraction(v) - e) for v, e in zip(numerator[0].tolist(), exact))
    allowed = bounds[0, 2] * (weight.min() if rational else 1.0)
    assert float(error) <= allowed
    assert allowed < 1e-9


def test_multinomials_of_forms():
    shape = determinant(bernstein(TETRAHEDRON, 2), False).form
    assert shape.sizes == ((4, 3),)
    assert shape.scale.sum() == 4**3
    assert shape.scale.max() == factorial(3)
