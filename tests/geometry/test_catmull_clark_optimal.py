"""The space of optimal order: partition of unity, fixed geometry, patch test, rates."""

from __future__ import annotations

import numpy as np
import pytest

import geometry.catmull_clark as source
from geometry.catmull_clark.mesh import HexMesh, hex_mesh
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import box, cross_of_tetrahedra, fan
from iga.assembly import matrix, vector, volume
from iga.block import Kronecker
from iga.chunk import chunks
from iga.conditions import dirichlet
from iga.domain import all_facets, check
from iga.integrands import Diffusion, Load
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


def test_the_core_keeps_its_splines() -> None:
    domain = source.domain_of(_mesh(box(5, 5, 5)), _settings())
    assert domain.report["core_cells"] == 27
    assert domain.report["spline_functions"] == 6**3
    kept = [block for block in domain.space.blocks if isinstance(block.extraction, Kronecker)]
    assert [block.elements for block in kept] == [27]
    assert sum(len(chunk.elements) for chunk in chunks(domain)) == 125


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


@pytest.mark.long
@pytest.mark.parametrize(("space", "l2", "h1", "cap"), [("optimal", 3.9, 2.9, 2e-5), ("catmull_clark", 2.3, 1.4, 5e-2)])
def test_rates_around_an_extraordinary_edge(space: str, l2: float, h1: float, cap: float) -> None:
    """Order 4 and 3 where the subdivision space has 2.5 and 1.5 at most."""
    domain = source.domain_of(hex_mesh(*fan(5, 2, 2)), Settings(space=space, interpolate="none"))
    found = []
    for level in range(3):
        domain = source.refine(domain) if level else domain
        found.append(_errors(domain))
    rate = np.log2(found[-2] / found[-1])
    assert rate[0] > l2
    assert rate[1] > h1
    assert found[-1][0] < cap
