"""Eigenpairs: known spectra, rigid motions, both solvers, orthonormality, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array

from iga.assembly import matrix
from iga.cells import TETRAHEDRON
from iga.conditions import dirichlet
from iga.conforming import straight_domain
from iga.domain import Domain
from iga.errors import ConvergenceError, InputError
from iga.integrands import Diffusion, Elasticity, Mass, isotropic
from iga.linear.eigen import eigenpairs
from tests.meshes import box_complex
from tests.splines import cube


def system(domain: Domain) -> tuple[csr_array, csr_array, np.ndarray]:
    fixed = dirichlet(domain, {"*": 0.0})[0]
    return matrix(domain, Diffusion()), matrix(domain, Mass()), fixed


@pytest.mark.parametrize("solver", ["lanczos", "lobpcg"])
def test_spectrum_of_the_cube(solver: str) -> None:
    domain = cube((3, 3, 3), (6, 6, 6), 0.0)
    K, M, fixed = system(domain)
    modes = eigenpairs(K, M, 5, fixed, domain=domain, solver=solver)
    exact = np.pi**2 * np.array([3, 6, 6, 6, 9])
    assert modes.solver == solver
    assert np.abs(modes.values / exact - 1).max() < 1e-3
    assert (modes.values > exact).all()
    assert np.abs(modes.vectors.T @ (M @ modes.vectors) - np.eye(5)).max() < 1e-12
    assert np.abs(modes.vectors[fixed]).max() == 0
    assert modes.residuals.max() < 1e-9


def test_eigenvalues_converge_at_twice_the_degree() -> None:
    lowest = []
    for n in (3, 6, 12):
        domain = cube((2, 2, 2), (n, n, n), 0.0)
        K, M, fixed = system(domain)
        lowest.append(eigenpairs(K, M, 1, fixed, domain=domain).values[0] - 3 * np.pi**2)
    assert 3.8 < np.log2(lowest[1] / lowest[2]) < 4.3
    assert lowest[2] < 2e-3


@pytest.mark.parametrize("solver", ["lanczos", "lobpcg"])
def test_a_free_body_has_six_modes_of_zero(solver: str) -> None:
    domain = straight_domain(*box_complex(TETRAHEDRON, 2), 2)
    K, M = matrix(domain, Elasticity(isotropic(1.2, 0.8))), matrix(domain, Mass(2.0, 3))
    modes = eigenpairs(K, M, 8, domain=domain, solver=solver, tolerance=1e-7)
    assert np.abs(modes.values[:6]).max() < 1e-6 * modes.values[6]
    assert modes.values[6] > 0.1
    motion = modes.vectors[:, :6]
    fit = np.linalg.lstsq(motion, np.tile([1.0, -2, 0.5], domain.space.n), rcond=None)[0]
    assert np.abs(motion @ fit - np.tile([1.0, -2, 0.5], domain.space.n)).max() < 1e-5


def test_small_problems_and_refusals() -> None:
    K, M = diags_array(np.arange(1.0, 7)).tocsr(), diags_array(np.ones(6)).tocsr()
    modes = eigenpairs(K, M, 6, solver="lobpcg")
    assert np.abs(modes.values - np.arange(1, 7)).max() < 1e-12
    assert modes.solver == "dense"
    assert np.abs(eigenpairs(K, M, 2, np.array([0])).values - [2, 3]).max() < 1e-12
    with pytest.raises(InputError, match="7 eigenpairs of 6"):
        eigenpairs(K, M, 7)
    with pytest.raises(InputError, match="no eigenvalue solver"):
        eigenpairs(K, M, 1, solver="qr")
    with pytest.raises(InputError, match="do not fit"):
        eigenpairs(K, diags_array(np.ones(5)).tocsr(), 1)
    domain = cube((2, 2, 2), (5, 5, 5), 0.3)
    stiffness, mass, fixed = system(domain)
    with pytest.raises(ConvergenceError, match="residual"):
        eigenpairs(stiffness, mass, 3, fixed, domain=domain, solver="lobpcg", max_iterations=8)
