"""Tet domains under the assembly: patch tests on curved meshes, and three ways of writing the same space."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.tet_to_hex import tets_to_hexes
from geometry.tets.domain import domain_of
from geometry.tets.shapes import ball, cube, mapped
from geometry.tets.source import refine
from iga.assembly import matrix
from iga.conditions import trace_functions
from iga.domain import Domain, all_facets
from iga.integrands import Diffusion, Elasticity, Mass, isotropic

SLOPE = np.array([2.0, -3.0, 0.5])


def bend(x: np.ndarray) -> np.ndarray:
    return x + 0.05 * np.sin(2 * x[..., [1, 2, 0]])


def inside(domain: Domain) -> np.ndarray:
    """Functions that vanish on the boundary."""
    free = np.ones(domain.space.n, dtype=bool)
    free[trace_functions(domain, all_facets(domain))] = False
    return free


def on_hexes(u: np.ndarray, tets: Domain, hexes: Domain) -> np.ndarray:
    """Coefficients of a field of the tets in the space of their four hexahedra."""
    v = np.empty(hexes.space.n)
    local = tets_to_hexes(u[tets.space.blocks[0].dofs][..., None])
    dofs = hexes.space.blocks[0].dofs
    v[dofs] = local.reshape(dofs.shape)
    return v


@pytest.mark.parametrize("convert", ["none", "hex4", "hex1"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_patch_on_curved_meshes(convert, degree):
    domain = domain_of(mapped(cube(2 if degree < 3 else 1), bend, degree), convert)
    if not inside(domain).any():
        domain = refine(domain)
    free = inside(domain)
    assert free.any()
    points = (3 * degree) // 2 + 1
    K = matrix(domain, Diffusion(), points=points)
    scale = abs(K).max()
    assert np.abs((K @ (domain.points @ SLOPE))[free]).max() < 1e-12 * scale
    if degree < 3:
        K = matrix(domain, Elasticity(isotropic(1.3, 0.7)), points=points)
        u = domain.points @ np.array([[1.0, 2, 0], [0.5, -1, 3], [1, -1, 1]])
        assert np.abs((K @ u.ravel()).reshape(-1, 3)[free]).max() < 1e-12 * abs(K).max()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_degenerate_hexes_carry_the_space_of_the_tets(degree):
    """Same functions, so the same matrices: masses exactly on curved meshes, stiffness exactly on straight ones."""
    curved, straight = ball(1, degree), cube(2, degree)
    n = (5 * degree) // 2 + 1
    tets, hexes = domain_of(curved), domain_of(curved, "hex1")
    one, two = matrix(tets, Mass(), points=n), matrix(hexes, Mass(), points=n)
    assert abs(one - two).max() < 1e-12 * abs(one).max()
    one, two = (matrix(domain_of(straight, c), Diffusion(), points=degree + 2) for c in ("none", "hex1"))
    assert abs(one - two).max() < 1e-12 * abs(one).max()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_hexes_contain_the_functions_of_their_tets(degree):
    """A field on the tets, written in the four hexahedra, has the same mass and energy."""
    random = np.random.default_rng(5 + degree)
    tets, hexes = domain_of(ball(1, degree)), domain_of(ball(1, degree), "hex4")
    u = random.standard_normal(tets.space.n)
    v = on_hexes(u, tets, hexes)
    n = (5 * degree) // 2 + 2
    assert v @ matrix(hexes, Mass(), points=n) @ v == pytest.approx(u @ matrix(tets, Mass(), points=n) @ u, rel=1e-12)
    tets, hexes = domain_of(cube(1, degree)), domain_of(cube(1, degree), "hex4")
    u = random.standard_normal(tets.space.n)
    v = on_hexes(u, tets, hexes)
    # On the hexahedra grad u is a polynomial of the straight tetrahedron taken at phi, so the energy is one too.
    exact = u @ matrix(tets, Diffusion(), points=degree + 1) @ u
    assert v @ matrix(hexes, Diffusion(), points=degree + 2) @ v == pytest.approx(exact, rel=1e-11)
