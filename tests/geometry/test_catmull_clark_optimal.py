"""The space of optimal order: partition of unity, fixed geometry, patch test, rates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

import geometry.catmull_clark as source
from geometry.catmull_clark.mesh import HexMesh, hex_mesh
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import box, cross_of_tetrahedra, fan
from iga.assembly import matrix, vector, volume
from iga.block import Kronecker
from iga.conditions import dirichlet
from iga.domain import all_facets, check
from iga.integrands import Diffusion, Load, Mass
from iga.linear.solvers import solve
from iga.norms import errors
from iga.store import load, save


def _mesh(made: tuple[np.ndarray, np.ndarray]) -> HexMesh:
    points, cells = made
    return hex_mesh(points, cells, {"heat": points @ [1.0, 2.0, -1.0]})


def _settings(features: str = "auto", interpolate: str = "none") -> Settings:
    return Settings(space="optimal", interpolate=interpolate, features=features)


@pytest.mark.parametrize("features", ["auto", "none"])
@pytest.mark.parametrize("made", [box(3, 4, 3), fan(5), cross_of_tetrahedra(5)])
def test_structure(made: tuple[np.ndarray, np.ndarray], features: str, tmp_path) -> None:
    domain = source.domain_of(_mesh(made), _settings(features))
    check(domain)
    save(domain, tmp_path / "domain.npz")
    finer = source.refine(load(tmp_path / "domain.npz"))
    check(finer)
    assert abs(volume(finer, 6) / volume(domain, 6) - 1) < 1e-13  # the map stays
    assert sorted(finer.boundaries) == sorted(domain.boundaries)
    for some in (domain, finer):
        x = some.points
        np.testing.assert_allclose(some.attributes["heat"], x @ [1.0, 2.0, -1.0], atol=1e-12)
        K = matrix(some, Diffusion(1.0), points=5)
        np.testing.assert_allclose(K @ np.ones(some.space.n), 0.0, atol=1e-11)
        outer = np.zeros(some.space.n, dtype=bool)
        for f in all_facets(some):
            outer[some.space.blocks[f.block].dofs[f.elements]] = True
        np.testing.assert_allclose((K @ x)[~outer], 0.0, atol=1e-11)


@pytest.mark.parametrize("n", [(5, 5, 5), (1, 2, 3), (4, 3, 1)])
def test_a_box_has_the_open_tensor_product_splines(n: tuple[int, int, int]) -> None:
    """Values, gradients and stiffness equal to those of the spline space with fourfold end knots."""
    domain = source.domain_of(_mesh(box(*n)), _settings())
    assert domain.report["core_cells"] == np.prod(n)
    assert domain.report["free_functions"] == 0
    assert domain.space.n == np.prod([k + 3 for k in n])
    assert all(isinstance(block.extraction, Kronecker) for block in domain.space.blocks)
    # The Greville points are the control points: the map is the identity.
    greville = [np.array([0.0, 1.0 / 3.0, *range(1, k), k - 1.0 / 3.0, float(k)]) for k in n]
    greville = [g if k > 1 else np.arange(4) / 3.0 for g, k in zip(greville, n)]
    grid = np.stack(np.meshgrid(*greville, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.lexsort(np.round(domain.points, 9).T[::-1])
    np.testing.assert_allclose(domain.points[order], grid, atol=1e-13)
    factors = []
    for k in n:
        knots = np.concatenate([[0.0] * 3, np.arange(k + 1), [float(k)] * 3])
        x, w = np.polynomial.legendre.leggauss(4)
        x = (np.arange(k)[:, None] + 0.5 * (x + 1.0)).ravel()
        w = np.tile(0.5 * w, k)
        B = BSpline(knots, np.eye(k + 3), 3)
        factors.append(((B(x).T * w) @ B(x), (B(x, 1).T * w) @ B(x, 1)))
    (M0, K0), (M1, K1), (M2, K2) = factors
    expected = np.kron(np.kron(K0, M1), M2) + np.kron(np.kron(M0, K1), M2) + np.kron(np.kron(M0, M1), K2)
    K = matrix(domain, Diffusion(1.0), points=4).toarray()[np.ix_(order, order)]
    np.testing.assert_allclose(K, expected, atol=1e-13)


def test_cubics_are_in_the_space_up_to_the_boundary() -> None:
    domain = source.domain_of(_mesh(box(4, 3, 3)), _settings())
    exact = lambda x: x[..., 0] ** 3 - 2.0 * x[..., 1] ** 2 * x[..., 2]  # noqa: E731
    M, f = matrix(domain, Mass(1.0), points=5), vector(domain, Load(exact), points=5)
    u = np.asarray(solve(M, f)[0])
    assert errors(domain, u, exact).relative_l2 < 1e-10


def test_few_functions_are_free() -> None:
    """Only the zone around the extraordinary edge of a prism; the rest has two functions per boundary vertex."""
    domain = source.domain_of(_mesh(fan(5, 4, 4)), _settings())
    assert domain.report["core_cells"] > 0.5 * domain.report["cells"]
    assert domain.space.n < 27 * domain.report["cells"] / 2


def test_the_two_spaces_share_the_volume() -> None:
    mesh = _mesh(fan(3))
    one = source.domain_of(mesh, Settings(depth=0, interpolate="pia"))
    two = source.domain_of(mesh, _settings(interpolate="pia"))
    assert abs(volume(one, 6) / volume(two, 6) - 1) < 1e-13


def _exact(x: np.ndarray) -> np.ndarray:
    return np.sin(1.1 * x[..., 0] + 0.3) * np.cos(0.9 * x[..., 1]) * np.exp(0.3 * x[..., 2])


def _gradient(x: np.ndarray) -> np.ndarray:
    a, b, c = 1.1 * x[..., 0] + 0.3, 0.9 * x[..., 1], np.exp(0.3 * x[..., 2])
    return np.stack(
        [1.1 * np.cos(a) * np.cos(b) * c, -0.9 * np.sin(a) * np.sin(b) * c, 0.3 * np.sin(a) * np.cos(b) * c], axis=-1
    )


def _errors(domain) -> np.ndarray:
    K = matrix(domain, Diffusion(1.0))
    f = vector(domain, Load(lambda x: (1.1**2 + 0.9**2 - 0.3**2) * _exact(x)))
    fixed = dirichlet(domain, {"*": _exact})
    u = np.asarray(solve(K, f, fixed=fixed)[0])
    found = errors(domain, u, _exact, _gradient)
    return np.array([found.relative_l2, found.relative_h1])


@pytest.mark.parametrize(("valence", "cap"), [(3, 1.0e-5), (5, 7e-6), (6, 1.3e-5), (8, 1.9e-5)])
def test_optimal_rates_at_every_valence(valence: int, cap: float) -> None:
    """Order 4 and 3 where all cells touch the extraordinary edge."""
    found = _errors_of_levels(fan(valence, 1, 1), "optimal")
    rate = np.log2(found[-2] / found[-1])
    assert 3.9 < rate[0] < 4.2
    assert 2.9 < rate[1] < 3.2
    assert found[-1][0] < cap


def test_optimal_rates_with_splines_around_the_zone() -> None:
    """Splines fill the rest of a wider prism, faster than order 4 while they take over; one cap for the result."""
    found = _errors_of_levels(fan(5, 1, 3), "optimal")
    rate = np.log2(found[-2] / found[-1])
    assert rate[0] > 3.9
    assert rate[1] > 2.9
    assert found[-1][0] < 2e-5


def _errors_of_levels(made: tuple[np.ndarray, np.ndarray], space: str) -> list[np.ndarray]:
    domain = source.domain_of(hex_mesh(*made), Settings(space=space, interpolate="none"))
    found = []
    for level in range(3):
        domain = source.refine(domain) if level else domain
        found.append(_errors(domain))
    return found


@pytest.mark.long
@pytest.mark.parametrize(("space", "l2", "h1", "cap"), [("optimal", 3.9, 2.9, 2e-5), ("catmull_clark", 2.3, 1.4, 5e-2)])
def test_rates_around_an_extraordinary_edge(space: str, l2: float, h1: float, cap: float) -> None:
    """Order 4 and 3 where the subdivision space has 2.5 and 1.5 at most."""
    found = _errors_of_levels(fan(5, 2, 2), space)
    rate = np.log2(found[-2] / found[-1])
    assert rate[0] > l2
    assert rate[1] > h1
    assert found[-1][0] < cap
