"""Benchmarks: exact fields satisfy their equations, and solutions converge to them at the expected rates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from geometry.nurbs.source import build
from iga.chunk import facet_chunks
from iga.domain import Domain
from iga.integrands import VOIGT
from problems import benchmarks
from problems.benchmarks import Benchmark
from tests.problems.shapes import box, cylinder_sector, fichera, sphere_octant

POINTS = np.random.default_rng(89).uniform(0.3, 1.9, (17, 3))


def voigt(tensor: np.ndarray) -> np.ndarray:
    return np.stack([tensor[..., i, j] for i, j in VOIGT], axis=-1)


@pytest.mark.parametrize(
    "case",
    [
        benchmarks.hollow_sphere_heat(),
        benchmarks.hollow_sphere_heat(exchange=2.0, temperatures=(3.0, 1.0)),
        benchmarks.thick_sphere(pressures=(2.0, 0.5), radii=(0.7, 1.9), nu=0.45),
        benchmarks.thick_cylinder(pressures=(2.0, 0.5), radii=(0.7, 1.9), E=7.0),
        benchmarks.plate_with_hole(radius=0.6, tension=3.0, nu=0.1),
        benchmarks.cantilever(load=2.0, nu=0.2),
        benchmarks.heated_sphere(rise=30.0, expansion=1e-3),
    ],
)
def test_exact_solutions_are_in_equilibrium(case: Benchmark) -> None:
    scale = np.abs(case.exact.flux.gradient()(POINTS)).max()
    assert np.abs(case.exact.source(POINTS)).max() < 1e-12 * scale


def test_stresses_at_the_surfaces() -> None:
    p, q, a, b = 2.0, 0.5, 0.7, 1.9
    for make, dimensions in ((benchmarks.thick_sphere, 3), (benchmarks.thick_cylinder, 2)):
        stress = make(pressures=(p, q), radii=(a, b)).exact.flux
        for radius, pressure in ((a, p), (b, q)):
            n = np.zeros((5, 3))
            n[:, :dimensions] = np.random.default_rng(97).uniform(0.1, 1, (5, dimensions))
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            traction = np.einsum("qij,qj->qi", stress(radius * n), n)
            np.testing.assert_allclose(traction, -pressure * n, rtol=1e-12, atol=1e-13)
    # free surfaces
    angle = np.linspace(0.1, 1.5, 5)
    n = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    plate = benchmarks.plate_with_hole(radius=0.6, tension=3.0)
    assert np.abs(np.einsum("qij,qj->qi", plate.exact.flux(0.6 * n), n)).max() < 1e-13
    assert plate.exact.flux(np.array([0.0, 0.6, 0.0]))[0, 0] == pytest.approx(9.0)  # concentration factor 3
    np.testing.assert_allclose(plate.exact.flux(1e6 * n)[:, 0, 0], 3.0, rtol=1e-9)
    sphere = benchmarks.heated_sphere()
    for radius in (1.0, 2.0):
        assert np.abs(np.einsum("qij,qj->qi", sphere.exact.flux(radius * n), n)).max() < 1e-14
    beam = benchmarks.cantilever(load=2.0, height=1.0)
    x = np.stack([np.linspace(0, 4, 5), np.ones(5), np.zeros(5)], axis=-1)
    assert np.abs(beam.exact.flux(x)[:, :, 1]).max() < 1e-12


def test_tip_of_the_cantilever() -> None:
    """Slender in the plane, so that shear counts for little: P L^3/(3 E' I)."""
    length, height, E, nu = 20.0, 0.5, 100.0, 0.3
    case = benchmarks.cantilever(length=length, height=height, middle=0.25, load=1e-3, E=E, nu=nu)
    beam = 1e-3 * length**3 / (3 * E / (1 - nu**2) * height**3 / 12)
    assert case.exact.u(np.array([length, 0.25, 0.0]))[1] == pytest.approx(-beam, rel=2e-3)


def nurbs(shape: str, **parameters: float) -> Callable[[int], Domain]:
    return lambda level: build(shape, refine=level, **parameters)


# benchmark, domain of a level, levels, rates of the last step, caps on the last relative errors
RATES = {
    "hollow sphere, heat": (
        benchmarks.hollow_sphere_heat(), nurbs("hollow_sphere_octant", degree=2), (0, 1, 2), (2.85, 1.85), (9e-4, 9e-3),
    ),
    "hollow sphere, convection": (
        benchmarks.hollow_sphere_heat(exchange=2.0, temperatures=(3.0, 1.0)), lambda n: sphere_octant(2**n, 2),
        (0, 1, 2), (2.85, 1.85), (4e-4, 1e-2),
    ),
    "thick sphere": (
        benchmarks.thick_sphere(), nurbs("hollow_sphere_octant", degree=2), (0, 1, 2), (2.85, 1.85), (1.1e-3, 1.7e-2),
    ),
    "thick cylinder": (
        benchmarks.thick_cylinder(planes=("end", "start")), nurbs("thick_ring", degree=2), (1, 2, 3), (2.9, 1.9),
        (3e-5, 1.7e-3),
    ),
    "thick cylinder, Bezier": (
        benchmarks.thick_cylinder(), lambda n: cylinder_sector(2**n, 2), (0, 1, 2), (2.9, 1.9), (2.5e-4, 7e-3),
    ),
    "plate with a hole": (
        benchmarks.plate_with_hole(), nurbs("plate_with_hole", size=2.0, degree=2), (1, 2, 3), (2.9, 1.9),
        (2.5e-4, 7e-3),
    ),
    "cantilever": (
        benchmarks.cantilever(height=0.5, middle=0.25), lambda n: box((2**n, 2 ** (n - 1), 1), 2, (4.0, 0.5, 0.2)),
        (1, 2, 3), (2.9, 1.95), (3.5e-4, 2e-3),
    ),
    "heated sphere": (
        benchmarks.heated_sphere(), nurbs("hollow_sphere_octant", degree=2), (0, 1, 2), (2.85, 1.85), (1.2e-3, 2.2e-2),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RATES)
def test_rates(name: str) -> None:
    case, make, levels, (l2_rate, h1_rate), (l2_cap, h1_cap) = RATES[name]
    errors = [case.solve(make(level)).norms for level in levels]
    assert np.log2(errors[-2].l2 / errors[-1].l2) > l2_rate
    assert np.log2(errors[-2].h1 / errors[-1].h1) > h1_rate
    assert errors[-1].relative_l2 < l2_cap
    assert errors[-1].relative_h1 < h1_cap


def test_cubic_cantilever_is_exact() -> None:
    case = benchmarks.cantilever(height=0.5, middle=0.25)
    solution = case.solve(box((2, 1, 1), 3, (4.0, 0.5, 0.2)))
    assert solution.norms.relative_h1 < 1e-11
    error, size = solution.error_of("stress", lambda x: voigt(case.exact.flux(x)))
    assert error < 1e-10 * size
    np.testing.assert_allclose(solution.reactions["x0"], [0, 1.0 * 0.2, 0], atol=1e-10)


def test_fichera_corner_converges_with_two_thirds() -> None:
    case = benchmarks.fichera_corner()
    x = POINTS * np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(case.problem.source(x), case.exact.source(x), atol=1e-12)
    errors = [case.solve(fichera(n, 3)).norms for n in (1, 2, 4)]
    rates = np.log2([errors[0].h1 / errors[1].h1, errors[1].h1 / errors[2].h1])
    np.testing.assert_allclose(rates, case.h1_rate, atol=0.05)
    assert errors[2].relative_h1 < 1e-2
    assert np.log2(errors[1].l2 / errors[2].l2) > 4 / 3


def test_stress_concentration_at_the_hole() -> None:
    case = benchmarks.plate_with_hole()
    solution = case.solve(build("plate_with_hole", size=2.0, degree=3, refine=2))
    stress = solution.quantity("stress")
    largest = max(float(stress.evaluate(chunk)[..., 0].max()) for chunk in facet_chunks(solution.domain, "hole"))
    assert largest == pytest.approx(3.0, rel=0.02)
