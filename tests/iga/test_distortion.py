"""Energies of distortion: by products of lines as by tables of all points, and slopes as differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iga.distortion import Batch, Lattice, evaluate, lattice_of, lattice_table
from iga.domain import Domain
from tests.splines import cube


def batch(domain: Domain, samples: int, products: bool) -> Batch:
    block = domain.space.blocks[0]
    table = lattice_of(block, samples) if products else lattice_table(block.basis, samples, False)
    assert table is not None
    rng = np.random.default_rng(4)
    inverse = np.eye(3) * 2.0 + 0.3 * rng.normal(size=(block.elements, 3, 3))
    weight = rng.random(block.elements) + 0.5
    return Batch(block, table, 3, inverse, weight, np.arange(block.elements) % 2)


@pytest.mark.parametrize(("degree", "samples"), [(1, 2), (2, 3), (3, 3), (3, 4), (4, 3)])
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_lattices_are_the_same_by_products_and_by_tables(degree: int, samples: int, size: float) -> None:
    domain = cube((degree,) * 3, (3, 2, 2), 0.2)
    values = domain.points + 0.05 * np.random.default_rng(5).normal(size=domain.points.shape)
    delta = np.array([0.2, 0.4])
    one = evaluate([batch(domain, samples, True)], values, delta, 3.0, size)
    other = evaluate([batch(domain, samples, False)], values, delta, 3.0, size)
    assert one[0] == pytest.approx(other[0], rel=1e-12)
    scale = np.abs(other[1]).max()
    np.testing.assert_allclose(one[1], other[1], atol=1e-12 * scale)
    np.testing.assert_allclose(one[2][0], other[2][0], rtol=1e-11)
    np.testing.assert_allclose(one[3][0], other[3][0], rtol=1e-11)


def test_slopes_are_differences() -> None:
    domain = cube((3, 3, 3), (2, 2, 2), 0.2)
    own, delta = [batch(domain, 3, True)], np.array([0.2, 0.0])
    values = domain.points.copy()
    _, slope, _, _ = evaluate(own, values, delta, 2.0, 0.2)
    way = np.random.default_rng(6).normal(size=values.shape)
    step = 1e-6
    ahead, behind = (evaluate(own, values + t * way, delta, 2.0, 0.2)[0] for t in (step, -step))
    assert (ahead - behind) / (2 * step) == pytest.approx(float((slope * way).sum()), rel=1e-7)


def test_folded_elements_without_regularisation_have_no_finite_energy() -> None:
    domain = cube((2, 2, 2), (2, 1, 1), 0.0)
    values = domain.points * np.array([-1.0, 1.0, 1.0])
    own = [replace(batch(domain, 3, True), inverse=np.tile(np.eye(3), (2, 1, 1)))]
    energy, slope, each, least = evaluate(own, values, np.zeros(2), 2.0)
    assert energy == np.inf
    assert (each[0] == np.inf).all()
    assert np.isfinite(slope).all()
    assert least[0].max() < 0.0


def test_only_equal_directions_are_products() -> None:
    assert isinstance(lattice_of(cube((2, 2, 2), (2, 2, 2)).space.blocks[0], 3), Lattice)
    assert lattice_of(cube((2, 2, 1), (2, 2, 2)).space.blocks[0], 3) is None
    block = cube((1, 1, 1), (1, 1, 1)).space.blocks[0]
    assert lattice_of(replace(block, extraction=None), 3) is None
