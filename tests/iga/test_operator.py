"""Matrix-free operators against assembled matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import aslinearoperator

from iga.assembly import reference_matrix
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.domain import Domain
from iga.errors import InputError
from iga.frame import specialised
from iga.integrands import Diffusion, Elasticity, Mass, isotropic
from iga.operator import operator
from tests.iga.test_assembly import TENSOR, curved, forms, patterned, shuffled, weighted
from tests.splines import cube


def compare(domain: Domain, integrands: list | None = None, points: int | None = None) -> None:
    for integrand in integrands or forms(domain):
        K = operator(domain, integrand, points)
        R = reference_matrix(domain, integrand, points, None, integrand.components)
        x = np.random.default_rng(5).normal(size=R.shape[0])
        expected = R @ x
        np.testing.assert_allclose(K @ x, expected, rtol=0, atol=1e-12 * abs(expected).max())
        np.testing.assert_allclose(K.diagonal(), R.diagonal(), rtol=0, atol=1e-12 * R.diagonal().max())


@pytest.mark.parametrize(("cell", "p"), [(c, p) for c in (TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID) for p in (1, 2)])
def test_cells_and_degrees(cell: Cell, p: int) -> None:
    compare(curved(cell, p))


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON])
def test_rational_functions_and_dense_extraction(cell: Cell) -> None:
    domain = curved(cell, 2)
    compare(weighted(domain))
    compare(weighted(patterned(domain, extra=1)))


@pytest.mark.parametrize("p", [(1, 1, 1), (2, 3, 1), (3, 3, 3)])
def test_splines(p: tuple[int, int, int]) -> None:
    domain = cube(p, (3, 4, 2))
    compare(domain)
    compare(weighted(shuffled(domain)), points=4)


def test_kernels_compiled_for_the_sizes_agree() -> None:
    domain = cube((2, 2, 2), (3, 3, 3))
    with specialised():
        compare(domain, [Diffusion(TENSOR), Mass(), Elasticity(isotropic(1.2, 0.7))])
        compare(weighted(domain), [Diffusion(TENSOR), Mass(), Elasticity(isotropic(1.2, 0.7))])


def test_scipy_takes_operators() -> None:
    domain = cube((2, 2, 2), (2, 2, 2))
    K = operator(domain, Diffusion())
    x = np.random.default_rng(9).normal(size=domain.space.n)
    np.testing.assert_array_equal(aslinearoperator(K) @ x, K @ x)


def test_forms_that_have_no_operator_are_refused() -> None:
    domain = cube((1, 1, 1), (2, 2, 2))
    with pytest.raises(InputError, match="assemble"):
        operator(domain, lambda chunk: chunk.dx)
    with pytest.raises(InputError, match="symmetric"):
        operator(domain, Diffusion(np.array([[2.0, 1.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 1.0]])))
    with pytest.raises(InputError, match="cannot be applied"):
        operator(domain, Diffusion()) @ np.zeros(3)
