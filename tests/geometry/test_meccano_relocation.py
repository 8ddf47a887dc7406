"""Untangling and smoothing."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.layouts.blocks import cube, pillowed, polycube
from geometry.meccano.bisection import BisectedMesh, coloured, kuhn, picture, refine, refine_all
from geometry.simplices.kernels_relocation import energy_gradient, positive, shapes
from geometry.simplices.relocation import ideal_gradients, quality, relocate, relocate_globally
from iga.errors import InputError


def _straight(mesh: BisectedMesh) -> tuple[np.ndarray, np.ndarray]:
    ideal = picture(mesh)
    nodes = np.zeros((len(mesh.ends), mesh.blocks.dim))
    nodes[mesh.tets.ravel()] = ideal.reshape(-1, mesh.blocks.dim)
    return nodes, ideal_gradients(ideal)


def _sphere(mesh: BisectedMesh, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boundary nodes on the unit sphere, inner nodes anywhere."""
    nodes, gradients = _straight(mesh)
    free = ~mesh.on_boundary
    nodes = 2.0 * nodes - 1.0
    nodes[~free] /= np.linalg.norm(nodes[~free], axis=1, keepdims=True)
    nodes[free] = np.random.default_rng(seed).uniform(-0.9, 0.9, (free.sum(), 3))
    return nodes, gradients, free


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("power", [1.0, 2.0, 3.5])
def test_gradient_is_that_of_the_energy(dim: int, power: float) -> None:
    mesh = refine_all(kuhn(cube(dim)), dim)
    nodes, gradients = _straight(mesh)
    rng = np.random.default_rng(5)
    nodes += 0.2 * rng.standard_normal(nodes.shape)
    assert quality(mesh.tets, gradients, nodes).inverted
    direction = rng.standard_normal(nodes.shape)
    slope = (energy_gradient(mesh.tets, gradients, nodes, power, 0.3)[1] * direction).sum()
    errors = []
    for h in (1e-3, 1e-4):
        ends = [energy_gradient(mesh.tets, gradients, nodes + t * direction, power, 0.3)[0] for t in (h, -h)]
        errors.append(abs((ends[0] - ends[1]) / (2 * h) - slope) / abs(slope))
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.2)


def test_modified_determinant_does_not_cancel() -> None:
    assert positive(-1.0, 1e-9) == pytest.approx(1e-18, rel=1e-12)
    assert positive(0.0, 0.25) == pytest.approx(0.25, rel=1e-15)
    assert positive(2.0, 0.0) == 2.0
    assert positive(-2.0, 0.0) == 0.0
    for least in (-5.0, -1e-3, 0.0, 5e-4):  # the rule for delta gives h(least) = epsilon
        epsilon = 1e-3
        assert positive(least, np.sqrt(epsilon * (epsilon - least))) == pytest.approx(epsilon, rel=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_untangling_a_ball(seed: int) -> None:
    mesh = refine_all(kuhn(cube()), 6)
    nodes, gradients, free = _sphere(mesh, seed)
    assert (len(mesh.tets), len(nodes), free.sum()) == (384, 125, 27)
    assert quality(mesh.tets, gradients, nodes).inverted > 80
    made = relocate(mesh.tets, gradients, nodes, free, sweeps=30, tolerance=1e-3)
    assert not made.inverted[15:].any()
    assert made.quality.least == pytest.approx(0.743, abs=1e-3)
    assert made.quality.mean == pytest.approx(0.896, abs=1e-3)
    np.testing.assert_array_equal(made.nodes[~free], nodes[~free])
    whole = relocate_globally(mesh.tets, gradients, nodes, free)
    assert whole.inverted[-1] == 0
    assert whole.quality.least == pytest.approx(made.quality.least, abs=1e-3)


@pytest.mark.parametrize(("power", "centre"), [(1.0, 0.4030), (2.0, 0.3791)])
def test_centre_of_the_deformed_square(power: float, centre: float) -> None:
    mesh = refine_all(kuhn(cube(2)), 2)
    nodes, gradients = _straight(mesh)
    nodes[3] = 0.65
    free = np.arange(len(nodes)) == 4
    for method in (relocate, relocate_globally):
        made = method(mesh.tets, gradients, nodes, free, power=power)
        np.testing.assert_allclose(made.nodes[4], centre, atol=5e-5)


ELL = polycube(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)]))


@pytest.mark.parametrize("blocks", [cube(2), pillowed(cube(2)), pillowed(cube()), pillowed(ELL)])
def test_the_picture_is_its_own_optimum(blocks) -> None:  # type: ignore[no-untyped-def]
    mesh = coloured(blocks)
    rng = np.random.default_rng(4)
    for _ in range(4):
        mesh, _ = refine(mesh, rng.random(len(mesh.tets)) < 0.3)
    nodes, gradients = _straight(mesh)
    np.testing.assert_allclose(shapes(mesh.tets, gradients, nodes)[1], 1.0, atol=1e-12)
    turn = np.linalg.qr(rng.standard_normal((blocks.dim, blocks.dim)))[0]
    turn[0] *= np.linalg.det(turn)
    moved = 3.0 * nodes @ turn.T + 1.0
    free = ~mesh.on_boundary
    tangled = moved.copy()
    tangled[free] += rng.normal(0.0, 0.05, (free.sum(), blocks.dim))
    made = relocate(mesh.tets, gradients, tangled, free, sweeps=100, tolerance=1e-5)
    assert made.quality.least > 0.999
    np.testing.assert_allclose(made.nodes, moved, atol=1e-2)


def test_nodes_that_are_no_numbers_count_as_inverted() -> None:
    mesh = refine_all(kuhn(cube(2)), 2)
    nodes, gradients = _straight(mesh)
    assert quality(mesh.tets, gradients, nodes).inverted == 0
    nodes[4] = np.nan
    around = (mesh.tets == 4).any(axis=1).sum()
    assert quality(mesh.tets, gradients, nodes).inverted == around > 0


def test_flat_ideals_are_refused() -> None:
    with pytest.raises(InputError, match="element 1 is flat"):
        ideal_gradients(np.array([[(0, 0), (1, 0), (0, 1)], [(0, 0), (1, 0), (2, 0)]], dtype=float))
