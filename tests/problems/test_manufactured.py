"""Data from an exact solution: against derivatives worked out by hand and by differences."""

from __future__ import annotations

import numpy as np
import pytest

from iga.errors import InputError
from iga.integrands import VOIGT
from problems import manufactured
from problems.formula import Formula, from_array, parse, parse_vector
from problems.manufactured import solve_exact
from problems.material import isotropic
from tests.problems.shapes import bent_box

POINTS = np.random.default_rng(73).uniform(0.2, 0.9, (9, 3))
x, y, z = POINTS.T


def divergence(flux: Formula, t: float = 0.0) -> np.ndarray:
    """Divergence over the last axis by fourth-order differences."""
    h, total = 1e-3, 0.0
    for j, step in enumerate(h * np.eye(3)):
        values = [flux(POINTS + s * step, t)[..., j] for s in (-2, -1, 1, 2)]
        total = total + (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
    return total


def test_heat_source_by_hand() -> None:
    known = manufactured.heat("x**2*y + z", parse("1 + x"))
    np.testing.assert_allclose(known.source(POINTS), -(2 * x * y + (1 + x) * 2 * y))
    np.testing.assert_allclose(known.flux(POINTS), ((1 + x) * np.stack([2 * x * y, x**2, 1 + 0 * x])).T)
    np.testing.assert_allclose(known.through((0, -1, 0))(POINTS), -(1 + x) * x**2)


@pytest.mark.parametrize("u", ["sin(x)*exp(y)*z**2", "atan2(y, x) + x**0.5", "exp(-t)*cosh(x*y)"])
def test_heat_with_tensors_and_time(u: str) -> None:
    one, half = parse("1 + y*z").expressions[0], parse("0.5*x").expressions[0]
    k = from_array(np.array([[one, half, 0], [half, 2, 0], [0, 0, one]]), "k")
    known = manufactured.heat(u, k, capacity=parse("2 + x"))
    rate = (2 + x) * known.u.rate()(POINTS, 0.3)
    np.testing.assert_allclose(known.source(POINTS, 0.3), rate - divergence(known.flux, 0.3), rtol=1e-7, atol=1e-7)


def test_elastic_force_by_hand() -> None:
    known = manufactured.elasticity("x**2; 0; 0", isotropic(1.0, 0.25))
    C = isotropic(1.0, 0.25)
    np.testing.assert_allclose(known.source(POINTS), np.tile([-2 * C[0, 0], 0, 0], (9, 1)), atol=1e-14)
    np.testing.assert_allclose(known.flux(POINTS)[:, 1, 1], C[1, 0] * 2 * x)


def test_elastic_force_of_a_varying_anisotropic_material() -> None:
    rng = np.random.default_rng(79)
    root = rng.standard_normal((6, 6))
    constant = root @ root.T
    scale = parse("1 + x*y")
    C = from_array(constant.astype(object) * scale.expressions[0], "C")
    known = manufactured.elasticity("sin(x)*y; x*z**2; exp(y)", C)
    np.testing.assert_allclose(known.source(POINTS), -divergence(known.flux), rtol=1e-6, atol=1e-6)
    G = known.u.gradient()(POINTS)
    strain = np.stack([G[:, i, j] if i == j else G[:, i, j] + G[:, j, i] for i, j in VOIGT], axis=-1)
    stress = scale(POINTS)[:, None] * (strain @ constant)
    np.testing.assert_allclose(np.stack([known.flux(POINTS)[:, i, j] for i, j in VOIGT], -1), stress, rtol=1e-10)


def test_uniform_expansion_is_free_of_stress() -> None:
    strain = manufactured.isotropic_strain(1e-3, parse("20"))
    known = manufactured.elasticity("0.02*x; 0.02*y; 0.02*z", isotropic(7.0, 0.3), strain)
    assert np.abs(known.flux(POINTS)).max() < 1e-14


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="2 given, one formula expected"):
        manufactured.heat("x; y")
    with pytest.raises(InputError, match="three formulas"):
        manufactured.elasticity(parse("x"), isotropic(1.0, 0.3))
    with pytest.raises(InputError, match="a temperature is one formula"):
        manufactured.heat(parse_vector("x;y;z"))
    with pytest.raises(InputError, match="numbers or formulas"):
        manufactured.heat("x", lambda points: points[..., 0])


@pytest.mark.parametrize(
    ("physics", "text", "points", "tolerance"),
    [("heat", "1+2*x-3*y+0.5*z", None, 1e-12), ("elasticity", "x+2*y;3*z-y;x-y+z", 5, 1e-12)],
)
def test_solve_exact_passes_the_patch_test(physics: str, text: str, points: int | None, tolerance: float) -> None:
    solution, answer = solve_exact(bent_box(2, 2), physics, text, points=points)
    assert answer["relative_h1_error"] < tolerance
    assert answer["relative_l2_error"] < tolerance
    keys = ["problem", "functions", "unknowns", "assemble_s", "solve_s", "iterations", "residual"]
    keys += ["l2_error", "h1_error", "energy", "extrema"]
    assert all(answer[key] is not None for key in keys)
    assert solution.norms is not None


def test_solve_exact_refuses() -> None:
    domain = bent_box(1, 1)
    with pytest.raises(InputError, match="'magnetism' is unknown; there are: heat, elasticity"):
        solve_exact(domain, "magnetism", "x")
    with pytest.raises(InputError, match="unknown name 't'"):
        solve_exact(domain, "heat", "x*t")
