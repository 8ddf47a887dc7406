"""Rules for triangles beside trimming curves: what they reproduce, and their order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from geometry.cad.brep import surface_points
from geometry.hybrid import shapes
from geometry.hybrid.chart import chart_steps, make_chart, parameter_bends, parameter_steps, to_chart, to_parameters
from geometry.hybrid.strip import (
    DOMAIN_POINTS,
    OTHERS,
    crossing,
    inner_rows,
    jets,
    meeting_rows,
    phi_of,
    side_rows,
    vertex_rows,
)
from geometry.hybrid.triangle import CUBIC
from geometry.knots import evaluation
from geometry.patch import Patch

Array = NDArray[np.float64]

KNOTS = np.concatenate([np.zeros(4), [0.3, 0.55, 0.8], np.ones(4)])
CURLED = np.concatenate([np.zeros(4), 0.5 + 0.001 * np.arange(6), np.ones(4)])
"""Narrow intervals, in which a surface turns within a thousandth of its length."""


def spline_through(value: object, knots: Array = KNOTS) -> Patch:
    """Bicubic spline that interpolates a function at Greville points; exact for bicubic polynomials."""
    n = len(knots) - 4
    places = np.array([knots[i + 1 : i + 4].mean() for i in range(n)])
    x, y = np.meshgrid(places, places, indexing="ij")
    rows = evaluation(knots, 3, places)
    B = np.zeros((n, n))
    B[np.arange(n)[:, None], rows.first[:, None] + np.arange(4)] = rows.values
    inverse = np.linalg.inv(B)
    z = inverse @ value(x, y) @ inverse.T  # type: ignore[operator]
    return Patch((knots, knots), np.stack([x, y, z], axis=-1))


def psi(surface: Patch, uv: Array, steps: Array) -> Array:
    """Control points (10, 3) of one triangle."""
    control = np.zeros((10, 3))
    net = surface.control.reshape(-1, 3)
    exponents = [tuple(e) for e in CUBIC.exponents.tolist()]

    def put(exponent: tuple[int, ...], rows: tuple[Array, NDArray[np.int64]]) -> None:
        assert np.allclose(rows[0].sum(axis=1), 1.0, atol=1e-12)
        control[exponents.index(exponent)] = rows[0][0] @ net[rows[1][0]]

    middle = uv.mean(axis=0)[None]
    for i in range(3):
        unit = [0, 0, 0]
        unit[i] = 3
        put((unit[0], unit[1], unit[2]), vertex_rows(surface.knots, uv[None, i], middle))
        for k, j in enumerate(OTHERS[i].tolist()):
            near = [0, 0, 0]
            near[i], near[j] = 2, 1
            put((near[0], near[1], near[2]), side_rows(surface.knots, uv[None, i], uv[None, j], steps[None, i, k]))
    inwards = phi_of(uv[None], steps[None])[0] - uv
    put((1, 1, 1), inner_rows(surface.knots, uv[None], steps[None], inwards[None]))
    return control


def straight(uv: Array) -> Array:
    """Steps of a triangle with straight sides."""
    return np.stack([(uv[OTHERS[i]] - uv[i]) / 3.0 for i in range(3)])


PLACES = np.array([(a, b, 8 - a - b) for a in range(9) for b in range(9 - a)]) / 8.0


def largest(surface: Patch, uv: Array) -> float:
    x = CUBIC.tabulate(PLACES[:, 1:], 0)[0] @ psi(surface, uv, straight(uv))
    return float(np.abs(x - surface_points(surface, PLACES @ uv)).max())


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=10, max_size=10), st.integers(0, 2**32 - 1))
def test_cubic_polynomials_are_reproduced_on_any_triangle(coefficients: list[float], seed: int) -> None:
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    surface = spline_through(lambda x, y: sum(c * x**i * y**j for c, (i, j) in zip(coefficients, powers)))
    uv = np.random.default_rng(seed).uniform(0.0, 1.0, (3, 2))
    assert largest(surface, uv) < 1e-11


def test_sides_along_parameter_lines_are_bezier_points() -> None:
    surface = spline_through(lambda x, y: np.sin(4 * x) * np.cos(3 * y))
    uv = np.array([(0.32, 0.1), (0.5, 0.1), (0.41, 0.29)])
    x = psi(surface, uv, straight(uv))
    side = np.flatnonzero(CUBIC.exponents[:, 2] == 0)
    t = np.linspace(0.0, 1.0, 7)
    values = CUBIC.tabulate(np.stack([t, 0 * t], axis=1), 0)[0]
    on = surface_points(surface, uv[0] + t[:, None] * (uv[1] - uv[0]))
    assert np.abs(values[:, side] @ x[side] - on).max() < 1e-14


def test_distance_falls_with_the_fourth_power() -> None:
    surface = spline_through(lambda x, y: np.sin(5 * x + 1) * np.cos(4 * y) + x * y**3)
    corner = np.array([0.32, 0.56])
    shape = np.array([(0.0, 0.0), (0.2, 0.03), (0.05, 0.2)])
    found = [largest(surface, corner + h * shape) for h in (1.0, 0.5, 0.25)]
    rates = np.log2(np.array(found[:-1]) / found[1:])
    assert rates.min() > 3.7
    assert found[0] < 5e-3


def meeting(surface: Patch, uv: Array) -> tuple[Array, Array]:
    """Control points (10, 3) of the cubic that meets a surface, over a straight triangle, and the rows behind them."""
    a, b = DOMAIN_POINTS.T
    rows, dofs = meeting_rows(surface.knots, (np.stack([1.0 - a - b, a, b], axis=1) @ uv)[None])
    return rows[0] @ surface.control.reshape(-1, 3)[dofs[0]], rows[0]


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=10, max_size=10), st.integers(0, 2**32 - 1))
def test_cubic_polynomials_are_met_on_any_triangle(coefficients: list[float], seed: int) -> None:
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    surface = spline_through(lambda x, y: sum(c * x**i * y**j for c, (i, j) in zip(coefficients, powers)), CURLED)
    uv = np.random.default_rng(seed).uniform(0.0, 1.0, (3, 2))
    control, rows = meeting(surface, uv)
    assert np.abs(rows.sum(axis=1) - 1.0).max() < 1e-12
    x = CUBIC.tabulate(PLACES[:, 1:], 0)[0] @ control
    assert np.abs(x - surface_points(surface, PLACES @ uv)).max() < 1e-11


def test_rows_of_wide_triangles_are_bounded_beside_narrow_intervals() -> None:
    """A triangle from a place where the surface curls, a hundred times as wide: jets there tell nothing of the rest."""
    surface = spline_through(lambda x, y: np.maximum(0.0, 0.502 - x), CURLED)
    uv = np.array([(0.5025, 0.4), (0.65, 0.45), (0.55, 0.6)])
    steps = straight(uv)[None]
    jets_rows, _ = inner_rows(surface.knots, uv[None], steps, phi_of(uv[None], steps)[:, None] - uv[None])
    control, rows = meeting(surface, uv)
    assert np.abs(jets_rows).max() > 100.0  # what they would be
    assert np.abs(rows).max() < 9.0
    x = CUBIC.tabulate(PLACES[:, 1:], 0)[0] @ control
    assert np.abs(x - surface_points(surface, PLACES @ uv)).max() < 1e-3


def test_knots_at_the_ends_of_a_step_are_not_crossed() -> None:
    knots = (KNOTS, KNOTS)
    ends = np.array([
        [(0.3, 0.1), (0.55, 0.3)], [(0.3, 0.1), (0.5500001, 0.3)], [(0.4, 0.2), (0.4, 0.4)], [(0.3, 0.31), (0.3, 0.5)]
    ])  # fmt: skip
    assert crossing(knots, ends).tolist() == [False, True, True, False]
    assert crossing(knots, ends[:, ::-1]).tolist() == [False, True, True, False]


def test_inner_step_is_the_blend_of_a_curve() -> None:
    uv = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    steps = straight(uv)
    bend = np.array([(0.02, 0.05), (0.04, -0.01)])
    steps[1, 0] += bend[0]
    steps[2, 1] += bend[1]
    assert np.allclose(phi_of(uv[None], steps[None])[0], [1 / 3, 1 / 3] + 0.25 * bend.sum(axis=0), atol=1e-15)


@pytest.mark.parametrize("towards", [0.9, 0.1])
def test_jets_are_derivatives_on_the_side_they_look_to(towards: float) -> None:
    surface = spline_through(lambda x, y: np.sin(5 * x) * np.exp(y))
    net = surface.control.reshape(-1, 3)[:, 2]
    at, h = np.array([[0.55, 0.3]]), 1e-4
    way = np.sign(towards - at)

    def value(step: tuple[float, float]) -> float:
        return float(surface_points(surface, at + h * way * np.array(step))[0, 2])

    found = jets(surface.knots, at, np.full((1, 2), towards))
    z = net[found.dofs[0]]
    first, second = found.first[0].T @ z, np.einsum("nde,n->de", found.second[0], z)
    slope = (-3 * value((0, 0)) + 4 * value((1, 0)) - value((2, 0))) / (2 * h) * way[0, 0]
    mixed = (value((1, 1)) - value((1, 0)) - value((0, 1)) + value((0, 0))) / h**2 * way.prod()
    assert abs(found.value[0] @ z - value((0, 0))) < 1e-14
    assert abs(first[0] - slope) < 1e-6
    assert abs(second[0, 1] - mixed) < 2e-2
    assert second[0, 1] == second[1, 0]


def test_derivatives_of_charts_near_a_pole() -> None:
    """First and second derivatives against differences, on half a ball, whose chart narrows."""
    pytest.importorskip("OCP")
    face = shapes.ball().faces[0]
    chart = make_chart(face)
    uv = np.array([(3.6, 0.4), (5.0, -1.1), (4.1, 1.3)])
    assert np.abs(uv - to_parameters(chart, to_chart(chart, uv))).max() < 1e-13
    q, h = to_chart(chart, uv), 1e-4
    a, b = np.array([0.3, 0.8]), np.array([-0.5, 0.4])

    def at(x: float, y: float) -> Array:
        return to_parameters(chart, q + h * (x * a + y * b))

    first = (at(1, 0) - at(-1, 0)) / (2 * h)
    mixed = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4 * h * h)
    steps = [np.repeat(x[None], 3, axis=0) for x in (a, b)]
    assert np.abs(parameter_steps(chart, q, steps[0]) - first).max() < 1e-5
    assert np.abs(parameter_bends(chart, q, *steps) - mixed).max() < 1e-4
    assert np.abs(chart_steps(chart, uv, parameter_steps(chart, q, steps[0])) - a).max() < 1e-12
