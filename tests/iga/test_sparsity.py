"""Sparsity against products of incidence matrices, and the number of distinct slot tables."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from iga.assembly import matrix
from iga.conforming import straight_domain
from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import Diffusion, Elasticity, isotropic
from iga.parallel import limited, ranges, run
from iga.sparsity import find, sparsity, symmetric_product
from tests.meshes import mixed_complex
from tests.splines import cube


def incidence_pattern(domain: Domain) -> csr_array:
    A = csr_array((domain.space.n, domain.space.n))
    for block in domain.space.blocks:
        e = np.repeat(np.arange(block.elements), block.n)
        B = csr_array((np.ones(e.size), (e, block.dofs.ravel())), shape=(block.elements, domain.space.n))
        A = A + B.T @ B
    A = csr_array(A)
    A.sort_indices()
    return A


@pytest.mark.parametrize("kind", ["splines", "mixed"])
def test_pattern_is_that_of_shared_elements(kind: str) -> None:
    domain = cube((2, 3, 1), (4, 3, 5)) if kind == "splines" else straight_domain(*mixed_complex(), 3)
    expected = incidence_pattern(domain)
    for count in (1, 3):
        with limited(count):
            found = find(domain.space)
        np.testing.assert_array_equal(found.indptr, expected.indptr)
        np.testing.assert_array_equal(found.indices, expected.indices)
        for block, slots in zip(domain.space.blocks, found.slots):
            i, j = np.triu_indices(block.n)
            pair = np.sort([block.dofs[:, i], block.dofs[:, j]], axis=0)
            where = found.indptr[pair[0]] + slots.offset[slots.table]
            np.testing.assert_array_equal(found.indices[where], pair[1])


def test_regular_meshes_store_each_distinct_table_once() -> None:
    assert len(sparsity(cube((2, 2, 2), (12, 9, 10)).space).slots[0].offset) == 5**3


def test_sparsity_is_kept_with_its_space() -> None:
    domain = cube((1, 1, 1), (2, 2, 2))
    assert sparsity(domain.space) is sparsity(domain.space)


def test_ranges_cover_without_empty_parts() -> None:
    for n in (1, 2, 7):
        parts = ranges(n, 4)
        assert [i for lo, hi in parts for i in range(lo, hi)] == list(range(n))
        assert all(lo < hi for lo, hi in parts)
    assert run([lambda: 1, lambda: 2, lambda: 3]) == [1, 2, 3]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_product_from_the_upper_half(threads: int) -> None:
    domain = cube((2, 3, 1), (4, 3, 5))
    for integrand, c in ((Diffusion(), 1), (Elasticity(isotropic(0.6, 0.4)), 3)):
        K = matrix(domain, integrand)
        x = np.random.default_rng(3).normal(size=K.shape[0])
        with limited(threads):
            y = symmetric_product(sparsity(domain.space), K, c)(x)
        np.testing.assert_allclose(y, K @ x, rtol=0, atol=1e-13 * abs(K @ x).max())
    with pytest.raises(InputError, match="sparsity"):
        symmetric_product(sparsity(domain.space), matrix(domain, Diffusion()), 3)
