"""Rational arcs as cubics: errors of the sixth order, smooth joints, equal areas, parameters there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from geometry.cad.brep import surface_frame, surface_points
from geometry.hybrid.arcs import Arcs, arcs_as_cubics, arcs_of, arm, cubics_of, from_cubic, radial_error, to_cubic
from geometry.hybrid.conics import in_quadratics
from geometry.patch import Patch

Array = NDArray[np.float64]


def circle(angle: float, arcs: int, shift: float = 1.0) -> tuple[Array, Array, Array]:
    """Knots, control points (i, 2) and weights of an arc of the unit circle; ``shift`` moves the parameter in it."""
    half = 0.5 * angle / arcs
    turn = half * np.arange(2 * arcs + 1)
    size = np.where(np.arange(2 * arcs + 1) % 2 == 1, 1.0 / np.cos(half), 1.0)
    weights = np.where(np.arange(2 * arcs + 1) % 2 == 1, np.cos(half), 1.0) * shift ** np.arange(2 * arcs + 1)
    breaks = angle * np.arange(arcs + 1) / arcs
    knots = np.sort(np.concatenate([breaks[:1], np.repeat(breaks, 2), breaks[-1:]]))
    return knots, size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1), weights


def sphere(arcs: int = 2) -> Patch:
    """Half a unit sphere between its poles, weights that are products."""
    u, p, a = circle(np.pi, arcs)
    v, q, b = circle(np.pi, 2)
    control = np.stack(np.broadcast_arrays(q[None, :, 1] * p[:, None, 0], q[None, :, 1] * p[:, None, 1],
                                           -q[None, :, 0]), axis=-1)
    return Patch((u, v), np.ascontiguousarray(control), np.outer(a, b))


def cylinder(arcs: int = 2, shift: float = 1.0) -> Patch:
    """Half a cylinder of radius and height one."""
    u, p, a = circle(np.pi, arcs, shift)
    control = np.stack([np.append(p, np.full((len(p), 1), z), axis=1) for z in (0.0, 1.0)], axis=1)
    return Patch((u, np.array([0.0, 0.0, 1.0, 1.0])), control, np.stack([a, a], axis=1))


def test_errors_fall_with_the_sixth_power() -> None:
    theta = np.pi / np.array([2.0, 4.0, 8.0])
    error = radial_error(theta)
    assert error[0] < 3e-4
    assert (np.abs(np.log2(error[:-1] / error[1:]) - 6.0) < 0.05).all()


@given(st.floats(0.05, 2.5))
@settings(deadline=None)
def test_cubics_enclose_the_area_of_their_arcs(theta: float) -> None:
    L = float(arm(np.array(theta)))
    p = np.array([(1, 0), (1, L), (np.cos(theta) + L * np.sin(theta), np.sin(theta) - L * np.cos(theta)),
                  (np.cos(theta), np.sin(theta))])  # fmt: skip
    t, w = np.polynomial.legendre.leggauss(6)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    B = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    D = 3.0 * np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
    x, d = B @ p, D @ np.diff(p, axis=0)
    assert 0.5 * w @ (x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0]) == pytest.approx(0.5 * theta, rel=1e-12)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("surface", [sphere(), cylinder(), cylinder(3), cylinder(2, 1.1)])
def test_points_in_one_direction_from_the_centre_are_within_the_tolerance(surface: Patch, tolerance: float) -> None:
    found = arcs_as_cubics(surface, tolerance)
    assert found is not None
    made, there, back = found
    assert made.weights is None
    assert made.degree == (3, 3)
    low, high = ([x[k] for x in surface.knots] for k in (0, -1))
    uv = np.random.default_rng(7).uniform(low, high, (500, 2))
    x = surface_points(made, there(uv))
    assert np.linalg.norm(x - surface_points(surface, uv), axis=1).max() <= tolerance
    assert np.abs(back(there(uv)) - uv).max() < 1e-13
    ends = np.array([low, high])
    assert np.abs(there(ends) - ends).max() < 1e-14


def test_arcs_that_are_smooth_join_with_c1_and_others_do_not() -> None:
    found = arcs_as_cubics(cylinder(2), 1e-5)
    assert found is not None
    made = found[0]
    repeats = np.unique(made.knots[0], return_counts=True)[1]
    assert (repeats[1:-1] == 2).all()
    inner = np.unique(made.knots[0])[1:-1]
    for side in (-1e-9, 1e-9):
        _, du, _ = surface_frame(made, np.stack([inner + side, np.full(len(inner), 0.3)], axis=1))
        _, other, _ = surface_frame(made, np.stack([inner - side, np.full(len(inner), 0.3)], axis=1))
        assert np.abs(du - other).max() < 1e-7
    # A leaf: two arcs that meet in a corner.
    knots, p, w = circle(2.0, 2)
    p = p.copy()
    p[3:] = p[2] + (p[1::-1] - p[2]) * [1.0, -1.0]
    assert (np.unique(cubics_of(Arcs(np.unique(knots), np.full(2, 0.5), np.ones(2), 2), p)[0],
                      return_counts=True)[1] == [4, 2, 3, 2, 4]).all()  # fmt: skip
    assert arcs_of(knots, w) is not None


def test_parameters_of_arcs_with_unequal_outer_weights() -> None:
    """The same circle with its parameter shifted has the same cubics: only the map of the parameters differs."""
    even, other = (arcs_as_cubics(cylinder(2, shift), 1e-5) for shift in (1.0, 1.2))
    assert even is not None
    assert other is not None
    np.testing.assert_allclose(even[0].control, other[0].control, atol=1e-14)
    arcs = arcs_of(*circle(np.pi, 2, 1.2)[::2])
    assert arcs is not None
    u = np.linspace(0.0, np.pi, 41)
    assert np.abs(from_cubic(arcs, to_cubic(arcs, u)) - u).max() < 1e-13
    assert (np.diff(to_cubic(arcs, u)) > 0.0).all()


@pytest.mark.parametrize("angle", [1.0, np.pi, 1.2 * np.pi])
def test_cubic_arcs_are_lowered_and_halved(angle: float) -> None:
    """Half a turn and more as one piece, raised to degree three: the same points at the same parameters."""
    w = np.array([1.0, np.cos(0.5 * angle), 1.0])
    # w_1 P_1, finite for half a turn too.
    H = np.array([(np.cos(0.5 * angle), -np.sin(0.5 * angle), 1.0), (1.0, 0.0, w[1]),
                  (np.cos(0.5 * angle), np.sin(0.5 * angle), 1.0)])  # fmt: skip
    raised = np.array([H[0], (H[0] + 2.0 * H[1]) / 3.0, (2.0 * H[1] + H[2]) / 3.0, H[2]])
    control = np.stack([np.append(raised[:, :2] / raised[:, 2:], np.full((4, 1), z), axis=1) for z in (0.0, 1.0)])
    flat = np.array([0.0, 0.0, 1.0, 1.0])
    surface = Patch((flat, np.repeat([2.0, 5.0], 4)), control, np.tile(raised[:, 2], (2, 1)))
    lowered = in_quadratics(surface)
    assert lowered.degree == (1, 2)
    assert len(np.unique(lowered.knots[1])) == (2 if angle < 3.0 else 3)
    uv = np.random.default_rng(5).uniform((0.0, 2.0), (1.0, 5.0), (100, 2))
    assert np.abs(surface_points(lowered, uv) - surface_points(surface, uv)).max() < 1e-13
    found = arcs_as_cubics(surface, 1e-6)
    assert found is not None
    made, there, _ = found
    assert np.linalg.norm(surface_points(made, there(uv)) - surface_points(surface, uv), axis=1).max() <= 1e-6


def test_cubics_that_are_no_conics_are_left_alone() -> None:
    surface = sphere()
    assert in_quadratics(surface).degree == (2, 2)
    rng = np.random.default_rng(11)
    knots = np.repeat([0.0, 1.0], 4), np.repeat([0.0, 1.0], 2)
    other = Patch(knots, rng.random((4, 2, 3)), 1.0 + rng.random((4, 2)))
    assert in_quadratics(other).degree == (3, 1)
    assert arcs_as_cubics(other, 1e-3) is None


def test_other_surfaces_are_left_alone() -> None:
    surface = sphere()
    assert surface.weights is not None
    uneven = surface.weights.copy()
    uneven[1, 1] *= 1.01
    assert arcs_as_cubics(Patch(surface.knots, surface.control, uneven), 1e-5) is None
    assert arcs_as_cubics(Patch(surface.knots, surface.control), 1e-5) is None
    hyperbolic = cylinder()
    assert hyperbolic.weights is not None
    assert arcs_as_cubics(Patch(hyperbolic.knots, hyperbolic.control, 1.0 / hyperbolic.weights), 1e-5) is None
