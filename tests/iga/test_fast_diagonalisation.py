"""Fast diagonalisation: exact where the form separates, and iterations that stay flat in size and degree."""

from __future__ import annotations

import numpy as np
import pytest

from iga.assembly import matrix
from iga.cells import HEXAHEDRON
from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import Diffusion, Elasticity, Mass, isotropic
from iga.linear.fast_diagonalisation import fast_diagonalisation, grid
from iga.linear.krylov import conjugate_gradients
from tests.iga.test_assembly import curved, shuffled, weighted
from tests.splines import cube


def interior(domain: Domain, components: int = 1) -> np.ndarray:
    shape = grid(domain.space).shape
    inside = np.zeros((*shape, components), dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    return np.flatnonzero(inside)


def iterations(domain: Domain, integrand, free: np.ndarray) -> int:
    K = matrix(domain, integrand)[free][:, free]
    f = np.random.default_rng(3).normal(size=len(free))
    M = fast_diagonalisation(domain, integrand, free)
    assert M is not None
    return conjugate_gradients(lambda x: K @ x, f, M, np.zeros(len(f)), 1e-10)[1]


@pytest.mark.parametrize("integrand", [Diffusion(np.diag([1.0, 20.0, 0.3])), Mass(2.5)])
def test_exact_on_a_box_with_any_knots(integrand) -> None:
    breaks = [np.array([0.0, 0.2, 0.3, 0.7, 1.0]), np.linspace(0, 2, 4), np.array([0.0, 0.6, 1.0])]
    domain = cube((2, 3, 1), (4, 3, 2), warp=0.0, breaks=breaks)
    free = interior(domain) if isinstance(integrand, Diffusion) else np.arange(domain.space.n)
    K = matrix(domain, integrand)[free][:, free]
    x = np.random.default_rng(5).normal(size=len(free))
    M = fast_diagonalisation(domain, integrand, free)
    np.testing.assert_allclose(M(K @ x), x, rtol=0, atol=1e-11)


def test_iterations_are_flat_in_size_and_degree() -> None:
    heat = [
        iterations(d, Diffusion(), interior(d))
        for d in (cube((p,) * 3, (n,) * 3) for p, n in ((2, 4), (2, 8), (3, 8), (4, 6)))
    ]
    assert max(heat) <= 16
    assert max(heat) - min(heat) <= 5
    d = cube((2, 2, 2), (6, 6, 6))
    assert iterations(d, Elasticity(isotropic(0.58, 0.38)), interior(d, 3)) <= 45


def test_faces_fixed_in_part_and_rational_functions() -> None:
    domain = weighted(cube((2, 2, 2), (5, 4, 4)))
    free = np.delete(np.arange(domain.space.n), np.arange(10))
    assert iterations(domain, Diffusion(), free) < 60


def test_components_are_held_each_in_their_way() -> None:
    """Rollers: component a is fixed on the two faces across direction a."""
    domain = cube((2, 2, 2), (5, 5, 5))
    shape = grid(domain.space).shape
    inside = np.ones((*shape, 3), dtype=bool)
    for a in range(3):
        face = np.moveaxis(inside[..., a], a, 0)
        face[[0, -1]] = False
    assert iterations(domain, Elasticity(isotropic(0.58, 0.38)), np.flatnonzero(inside)) <= 45


def test_spaces_without_product_structure_have_none() -> None:
    assert fast_diagonalisation(shuffled(cube((2, 2, 2), (3, 3, 3))), Diffusion()) is None
    assert fast_diagonalisation(curved(HEXAHEDRON, 2), Diffusion()) is None


def test_other_integrands_are_refused() -> None:
    with pytest.raises(InputError, match="exists for"):
        fast_diagonalisation(cube((2, 2, 2), (3, 3, 3)), lambda chunk: chunk.dx)
