"""Stiffness and conductivity: formulas, and refusals that name what is wrong and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from iga.errors import InputError
from iga.field import attribute
from problems import elasticity, heat
from problems.formula import from_array, parse
from problems.material import checked, isotropic, lame, tensor
from tests.problems.shapes import box


@given(st.floats(1e-3, 1e6), st.floats(-0.99, 0.499))
def test_isotropic_inverts_hookes_law(E: float, nu: float) -> None:
    compliance = np.zeros((6, 6))
    compliance[:3, :3] = -nu / E
    compliance[range(3), range(3)] = 1 / E
    compliance[range(3, 6), range(3, 6)] = 2 * (1 + nu) / E
    np.testing.assert_allclose(isotropic(E, nu) @ compliance, np.eye(6), atol=1e-11)
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    np.testing.assert_allclose(lame(lam, mu), isotropic(E, nu), rtol=1e-12)


def test_formula_and_field_agree_with_numbers() -> None:
    domain = replace(box((2, 1, 1), 1), attributes={})
    domain = replace(domain, attributes={"E": 1 + domain.points[:, 0]})
    x = np.array([[0.25, 0.5, 0.5]])
    np.testing.assert_allclose(isotropic(parse("1+x"), 0.3)(x)[0], isotropic(1.25, 0.3), rtol=1e-14)
    np.testing.assert_allclose(isotropic(2.0, parse("0.4*x"))(x)[0], isotropic(2.0, 0.1), rtol=1e-14)
    np.testing.assert_allclose(lame(parse("x"), 2.0)(x)[0], lame(0.25, 2.0), rtol=1e-14)
    field = isotropic(attribute(domain, "E"), 0.3)
    np.testing.assert_allclose(field.coefficients[0].reshape(6, 6), isotropic(1 + domain.points[0, 0], 0.3))
    both = lame(attribute(domain, "E"), attribute(domain, "E"))
    np.testing.assert_allclose(both.coefficients[-1].reshape(6, 6), lame(2.0, 2.0))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: isotropic(1.0, 0.5), "nu = 0.5 is incompressible"),
        (lambda: isotropic(1.0, 0.7), r"nu = 0.7 is outside \(-1, 0.5\)"),
        (lambda: isotropic(1.0, -1.0), "nu = -1 is outside"),
        (lambda: isotropic(0.0, 0.3), "E = 0 must be positive"),
        (lambda: isotropic(-2.0, 0.3), "E = -2 must be positive"),
        (lambda: isotropic(float("nan"), 0.3), "E = nan is not finite"),
        (lambda: lame(1.0, 0.0), "mu = 0 must be positive"),
        (lambda: lame(-1.0, 1.0), r"3 lambda \+ 2 mu = -1 must be positive"),
        (lambda: tensor(np.ones((3, 3)), 3, "conductivity"), "conductivity must be positive definite"),
        (lambda: tensor([[2, 1, 0], [0, 2, 0], [0, 0, 2]], 3, "conductivity"), r"not symmetric: entry \(1, 2\)"),
        (lambda: tensor(np.eye(5), 6, "stiffness"), r"stiffness has shape \(5, 5\), expected \(6, 6\)"),
        (lambda: tensor([["a"]], 6, "stiffness"), "stiffness must be 6 rows"),
        (lambda: tensor(np.diag([1, 1, np.inf]), 3, "conductivity"), "not finite"),
    ],
)
def test_refusals(make, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_varying_coefficients_are_checked_where_they_are_used() -> None:
    domain = box((2, 2, 2), 1)
    for k, words in [
        (-1.0, "conductivity = -1 must be positive"),
        (parse("x - 0.2"), r"conductivity must be positive, it is -0.\d+ at \(0.1"),
        (from_array(np.diag([1, 1, parse("y-0.2").expressions[0]]), "k"), "smallest eigenvalue"),
        (lambda x: -np.ones(x.shape[:-1]), "must be positive"),
    ]:
        with pytest.raises(InputError, match=words):
            heat.solve(heat.Heat(k, temperature={"*": 0.0}), domain)


SCALARS: list = [np.eye(3), from_array(np.diag([1, 1, parse("1 + x").expressions[0]]), "k"), lambda x: x, "tensor"]


@pytest.mark.parametrize("value", SCALARS, ids=["array", "formula", "function", "attribute"])
def test_capacity_density_and_exchange_are_single_numbers(value) -> None:
    domain = box((2, 2, 2), 1)
    domain = replace(domain, attributes={"tensor": np.tile(np.eye(3).ravel(), (domain.space.n, 1))})
    value = attribute(domain, "tensor") if isinstance(value, str) else value
    held = {"x0": (0.0, 0.0, 0.0)}
    for name, solve in [
        ("capacity", lambda: heat.modes(heat.Heat(temperature={"x0": 0.0}, capacity=value), domain, 1)),
        ("convection coefficient on 'x1'", lambda: heat.solve(
            heat.Heat(convection={"x1": heat.Convection(value)}), domain)),
        ("density", lambda: elasticity.modes(elasticity.Elasticity(displacement=held, density=value), domain, 1)),
        ("support stiffness on 'x0'", lambda: elasticity.solve(
            elasticity.Elasticity(support={"x0": elasticity.Support(value)}), domain)),
    ]:
        with pytest.raises(InputError, match=f"^{name} .*expected one number"):
            solve()


def test_field_with_a_negative_coefficient_is_judged_by_its_values() -> None:
    domain = box((2, 1, 1), 2)
    values = np.ones(domain.space.n)
    values[np.abs(domain.points[:, 0] - 0.25) < 1e-12] = -0.5  # the quadratic 1, -0.5, 1 stays positive
    harmless = replace(domain, attributes={"k": values})
    checked(attribute(harmless, "k"), "conductivity", 3, harmless)
    values = values - 0.6
    harmful = replace(domain, attributes={"k": values})
    with pytest.raises(InputError, match=r"conductivity must be positive, it is -.* at \("):
        checked(attribute(harmful, "k"), "conductivity", 3, harmful)
