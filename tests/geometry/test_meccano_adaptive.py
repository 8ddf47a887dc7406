"""Marking and adaptive refinement of hierarchical splines: fewer functions for the same error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from geometry.layouts.blocks import cube
from geometry.meccano.adaptive import adapt, by_cell, doerfler
from geometry.meccano.collocation import quasi_interpolation, refine
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.tmesh import refined, uniform
from geometry.meccano.traces import boundaries
from iga.domain import Domain
from iga.errors import InputError
from problems import heat
from problems.estimator import indicators
from problems.manufactured import heat as exact_heat
from tests.geometry.meccano_shapes import seven


@settings(max_examples=60, deadline=None)
@given(arrays(float, st.integers(1, 40), elements=st.floats(0, 1e3)), st.floats(0.01, 1.0))
def test_doerfler_marks_the_fewest(values: np.ndarray, share: float) -> None:
    marked = doerfler(values, share)
    total = (values**2).sum()
    if total == 0:
        assert not len(marked)
        return
    assert (values[marked] ** 2).sum() >= share * total * (1 - 1e-12)
    assert (np.diff(marked) > 0).all()
    largest = np.sort(values**2)[::-1]
    assert largest[: len(marked) - 1].sum() < share * total * (1 + 1e-12)


def test_bad_marks_are_refused() -> None:
    with pytest.raises(InputError, match="share"):
        doerfler(np.ones(3), 0.0)
    with pytest.raises(InputError, match="indicator 1"):
        doerfler(np.array([1.0, np.nan]))


def test_marked_cells_gain_functions() -> None:
    """A split cell alone adds no spline in the middle of a block; with its neighbours it does."""
    own = hierarchy(uniform(cube(), 3, 3))
    middle = int(np.flatnonzero((own.tmesh.corner >> 17 == 4).all(axis=1))[0])
    alone = hierarchy(refined(own.tmesh, np.array([middle])))
    together = hierarchy(refined(own.tmesh, np.array([middle]), reach=1))
    assert alone.space.n == own.space.n
    assert together.space.n == own.space.n + 27  # supports of four fine cells in six, and none of four coarse in three


def test_cells_and_elements_correspond() -> None:
    own = hierarchy(refined(uniform(seven(3, 2), 1, 3), np.array([2]), reach=1))
    start = np.concatenate([[0], np.cumsum([b.elements for b in own.space.blocks])])
    values = np.empty(start[-1])
    for cell, (block, element) in enumerate(own.element.tolist()):
        values[start[block] + element] = cell
    assert by_cell(own, values).tolist() == list(range(own.tmesh.cells))


def layer(own: Hierarchy, points: np.ndarray, estimate: bool) -> tuple[float, np.ndarray]:
    """Energy error, and indicators if asked for, of a solution with a sharp layer along an edge."""
    known = exact_heat("exp(-20*(x+y))")
    domain = Domain(own.space, points, boundaries(own))
    problem = heat.Heat(1.0, known.source, {"*": known.u})
    solution = heat.solve(problem, domain).compared(known.u)
    assert solution.norms is not None
    return solution.norms.h1, indicators(problem, domain, solution.coefficients) if estimate else np.empty(0)


@pytest.mark.long
def test_adaptive_refinement_needs_a_third_of_the_functions() -> None:
    own = hierarchy(uniform(cube(), 2, 3))
    _, x, L = quasi_interpolation(own)
    points = L @ (x + 0.03 * np.sin(np.pi * x[:, [1, 2, 0]]) * np.sin(np.pi * x))
    even, control = own, points
    for _ in range(2):
        even, T = refine(even)
        control = T @ control
    target, _ = layer(even, control, False)
    for step in range(4):
        error, found = layer(own, points, step < 3)
        if error <= target:
            break
        assert 1 < np.linalg.norm(found) / error < 40
        own, T = adapt(own, found, 0.7)
        points = T @ points
    assert error <= target
    assert own.space.n < even.space.n / 3
