"""Univariate splines: evaluation, insertion, elevation and extraction against each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import BSpline

from geometry.knots import (
    apply,
    bisected,
    check_knots,
    common,
    derivative,
    distinct,
    elevation,
    evaluation,
    extraction,
    insertion,
    snap,
)
from iga.bernstein import bernstein
from iga.cells import LINE
from iga.errors import InputError

KNOTS = [
    (1, [0, 0, 1, 1]),
    (1, [0, 0, 0.3, 1, 1]),
    (2, [0, 0, 0, 0.25, 0.5, 0.5, 0.8, 1, 1, 1]),
    (3, [-2, -2, -2, -2, 0.1, 1, 1, 1, 3, 3, 3, 3]),
    (5, [0] * 6 + [0.2, 0.2, 0.7] + [1] * 6),
]


@pytest.fixture(params=KNOTS, ids=lambda k: f"p{k[0]}")
def spline(request: pytest.FixtureRequest) -> tuple[np.ndarray, int, np.ndarray, np.ndarray]:
    degree, knots = request.param
    t = np.array(knots, dtype=float)
    rng = np.random.default_rng(31)
    c = rng.normal(size=(len(t) - degree - 1, 2))
    return t, degree, c, np.sort(np.concatenate([rng.uniform(t[0], t[-1], 60), t]))


def test_evaluation_and_derivative(spline: tuple) -> None:
    t, p, c, x = spline
    inside = x[(x > t[0]) & (x < t[-1]) & ~np.isin(x, t)]
    oracle = BSpline(t, c, p)
    assert np.allclose(apply(evaluation(t, p, inside), c, 0), oracle(inside), atol=1e-13)
    assert np.allclose(apply(derivative(t, p, inside), c, 0), oracle.derivative()(inside), atol=1e-11)
    assert np.allclose(evaluation(t, p, x).values.sum(axis=1), 1, atol=1e-14)
    assert (evaluation(t, p, x).values >= 0).all()


def test_insertion_keeps_the_curve(spline: tuple) -> None:
    t, p, c, x = spline
    inner = np.unique(t)[1:-1]
    room = inner[[np.count_nonzero(t == k) < p for k in inner]]
    fine = np.sort(np.concatenate([t, np.linspace(t[0], t[-1], 7)[1:-1], room]))
    finer = apply(insertion(t, p, fine), c, 0)
    assert np.abs(apply(evaluation(fine, p, x), finer, 0) - apply(evaluation(t, p, x), c, 0)).max() < 1e-13


@pytest.mark.parametrize("times", [1, 3])
def test_elevation_keeps_the_curve_and_its_continuity(spline: tuple, times: int) -> None:
    t, p, c, x = spline
    value = apply(evaluation(t, p, x), c, 0)
    q, knots = p, t
    for _ in range(times):
        knots, rows = elevation(knots, q)
        assert np.allclose(rows.values.sum(axis=1), 1, atol=1e-14)
        assert (rows.values > -1e-15).all()
        c, q = apply(rows, c, 0), q + 1
    assert np.abs(apply(evaluation(knots, q, x), c, 0) - value).max() < 1e-13
    for k in np.unique(t):
        assert np.count_nonzero(knots == k) == np.count_nonzero(t == k) + times


def test_extraction_reproduces_the_functions(spline: tuple) -> None:
    t, p, _, _ = spline
    C, first = extraction(t, p)
    ends = np.unique(t)
    s = np.linspace(0, 1, 9)
    B = bernstein(LINE, p).tabulate(s[:, None], 0)[0]
    for e, (a, b) in enumerate(pairwise(ends)):
        rows = evaluation(t, p, np.minimum(a + (b - a) * s[:-1], np.nextafter(b, a)))
        assert (rows.first == first[e]).all()
        assert np.abs(rows.values - (B @ C[e].T)[:-1]).max() < 1e-13
    assert np.abs(C.sum(axis=1) - 1).max() < 1e-14
    assert (C >= 0).all()


@pytest.mark.parametrize("intervals", [48, 49, 64])
def test_uniform_cubic_has_five_patterns(intervals: int) -> None:
    t = np.concatenate([np.zeros(4), np.arange(1, intervals) / intervals, np.ones(4)])
    C, _ = extraction(t, 3)
    kept, pattern = distinct(C)
    assert len(kept) == 5
    assert np.abs(kept[pattern] - C).max() < 1e-13


def test_bisection_is_simple_knots() -> None:
    t = bisected(np.array([0, 0, 0, 0.5, 0.5, 1, 1, 1.0]), 2)
    assert t.tolist() == [0, 0, 0, 0.125, 0.25, 0.375, 0.5, 0.5, 0.625, 0.75, 0.875, 1, 1, 1]


def test_common_knots_hold_both() -> None:
    knots, degree = common([(np.array([0, 0, 0, 0.5, 1, 1, 1.0]), 2), (np.array([0, 0, 1, 2, 3, 3.0]), 1)])
    assert degree == 2
    assert np.allclose(knots, [0, 0, 0, 1 / 3, 1 / 3, 0.5, 2 / 3, 2 / 3, 1, 1, 1])


@pytest.mark.parametrize(
    ("knots", "degree", "n", "said"),
    [
        ([0, 0, 1, 1], 2, 2, "knots, not 4"),
        ([0, 0, 1, 0.5, 1], 1, 3, "decrease"),
        ([0, 0, np.nan, 1, 1], 1, 3, "finite"),
        ([0, 0, 0.5, 0.5, 1, 1], 1, 4, "repeated 2 times"),
        ([1, 1, 1, 1], 1, 2, "no interval"),
        ([0, 1], 0, 1, "degree 0"),
    ],
)
def test_bad_knots_are_refused(knots: list[float], degree: int, n: int, said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_knots(np.array(knots, dtype=float), degree, n, "patch 3")


def test_nearly_equal_knots_become_equal() -> None:
    assert len(np.unique(snap(np.array([0, 0, 1e-13, 1, 1 + 1e-13, 2, 2.0])))) == 3
