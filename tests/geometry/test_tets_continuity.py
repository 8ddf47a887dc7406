"""Proposition 5: C1 tetrahedra become G1 hexahedra, and no more than that."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.tets.continuity import c1_pair, face_continuity
from iga.bernstein import bernstein
from iga.cells import TETRAHEDRON
from iga.errors import InputError

POINTS = np.random.default_rng(71).random((200, 2))


@pytest.mark.parametrize("degree", range(1, 7))
def test_c1_pairs_become_g1(degree):
    first, second, apex = c1_pair(degree, seed=90 + degree, components=5)
    found = face_continuity(first, second, apex, POINTS)
    assert found.trace < 1e-14
    assert found.g1 < 1e-13
    assert found.c1 > 1e-2


def test_the_pair_is_c1_on_the_tetrahedra():
    first, second, apex = c1_pair(4, seed=101)
    basis = bernstein(TETRAHEDRON, 4)
    on_face = np.random.default_rng(5).dirichlet([1, 1, 1], 50)
    point = np.column_stack([on_face[:, 1:], np.zeros(50)])
    values, slopes = basis.tabulate(point, 1)
    # d/dxi_3 of the second runs from vertex 0 to the apex, in the first's coordinates (w1, w2, w3).
    direction = apex[1:]
    assert np.abs(values @ first - values @ second).max() < 1e-14
    one = np.einsum("qbd,bc,d->qc", slopes, first, direction)
    two = np.einsum("qb,bc->qc", slopes[:, :, 2], second)
    assert np.abs(one - two).max() < 1e-13


@pytest.mark.parametrize("degree", [2, 3])
def test_c0_pairs_do_not(degree):
    first, second, apex = c1_pair(degree, seed=7)
    exponents = bernstein(TETRAHEDRON, degree).exponents
    second[exponents[:, 3] == 1] += 0.1
    found = face_continuity(first, second, apex, POINTS)
    assert found.trace < 1e-14
    assert found.g1 > 1e-3


def test_an_apex_on_the_wrong_side_is_refused():
    first, second, _ = c1_pair(2, seed=9)
    with pytest.raises(InputError, match="side of the first"):
        face_continuity(first, second, np.array([0.1, 0.1, 0.1, 0.7]), POINTS)
