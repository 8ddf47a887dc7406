"""Sizes of elements: the least over all samples, however many of them tell nothing."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.hybrid.sizing import GRADE, Sizing, size_at


@given(st.integers(1, 60), st.integers(0, 2**31 - 1), st.floats(0.0, 3.0))
@settings(max_examples=40, deadline=None)
def test_size_is_the_least_over_all_samples(count: int, seed: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    points, size = rng.random((count, 3)), 10.0 ** rng.uniform(-decades, 0.0, count)
    points[-1], size[-1] = points[0], size[0]  # edges share their ends
    x = np.concatenate([rng.random((30, 3)), points])
    wanted = (size + GRADE * np.linalg.norm(x[:, None] - points, axis=2)).min(axis=1)
    np.testing.assert_allclose(size_at(Sizing(points, size), x), wanted, rtol=1e-12)


def test_graded_samples_tell_nothing_more() -> None:
    rng = np.random.default_rng(7)
    few = Sizing(rng.random((9, 3)), 10.0 ** rng.uniform(-3.0, 0.0, 9))
    there = rng.random((200, 3))
    many = Sizing(np.concatenate([few.points, there]), np.concatenate([few.size, 1.1 * size_at(few, there)]))
    assert len(many.telling[1]) == len(few.telling[1]) <= 9
