"""Jumps of random functions across every inner facet of mixed volumes, from both sides."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

import geometry
from geometry.hybrid.layers import complete_with_layers
from geometry.hybrid.refinement import mesh_of, refine
from iga.block import Block
from iga.conformity import jumps, worst_jump
from iga.domain import Domain, Space, all_facets, counts
from iga.errors import InputError
from tests.geometry.hybrid_skins import bend, spline_box

pytestmark = pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="no mesh generator is installed")

MIXED = (False, False, True, False, True, False)
LIMIT = 1e-12


@pytest.fixture(scope="module")
def layered() -> Domain:
    """Hexahedra, wedges, pyramids and tetrahedra."""
    return complete_with_layers(spline_box(2, 2, MIXED, bend), 3, 0.5)


def pairs(domain: Domain) -> dict[tuple[str, str, int], int]:
    return {(*jump.cells, jump.vertices): jump.facets for jump in jumps(domain, mesh_of(domain))}


@pytest.mark.parametrize("level", [0, 1])
def test_all_kinds_of_facets_conform(layered: Domain, level: int) -> None:
    domain = refine(layered) if level else layered
    assert worst_jump(domain, mesh_of(domain), samples=6) < LIMIT
    kinds = {
        ("hexahedron", "hexahedron", 4), ("hexahedron", "wedge", 4), ("wedge", "wedge", 4),
        ("hexahedron", "pyramid", 4), ("tetrahedron", "wedge", 3), ("pyramid", "tetrahedron", 3),
        ("tetrahedron", "tetrahedron", 3), ("wedge", "wedge", 3),
    }  # fmt: skip
    refined = {("pyramid", "pyramid", 3), ("pyramid", "pyramid", 4)} if level else set()
    assert kinds <= set(pairs(domain)) <= kinds | refined


def test_every_facet_is_compared(layered: Domain) -> None:
    sides = {"hexahedron": 6, "wedge": 5, "pyramid": 5, "tetrahedron": 4}
    total = sum(sides[cell] * count for cell, count in counts(layered).items())
    outside = sum(len(f.elements) for f in all_facets(layered))
    assert 2 * sum(jump.facets for jump in jumps(layered, mesh_of(layered))) + outside == total


@pytest.mark.parametrize("cell", ["hexahedron", "wedge", "pyramid"])
def test_a_wrong_number_shows(layered: Domain, cell: str) -> None:
    """Two functions of one element exchanged: the field jumps there."""
    blocks: list[Block] = []
    done = False
    for block in layered.space.blocks:
        if block.basis.cell.name == cell and not done:
            dofs = block.dofs.copy()
            dofs[0, [0, 1]] = dofs[0, [1, 0]]
            block, done = replace(block, dofs=dofs), True
        blocks.append(block)
    wrong = replace(layered, space=Space(tuple(blocks), layered.space.n))
    assert worst_jump(wrong, mesh_of(wrong)) > 1e-3


def test_cad_parts_conform() -> None:
    """Pyramids on quadrilaterals of the CAD surface; wedges under trimmed faces."""
    part = geometry.build("curved_difference", "hybrid", skin="hybrid", size=0.5, tolerance=1e-3, subdivide=0)
    found = pairs(part)
    assert found["pyramid", "tetrahedron", 3] == 4 * counts(part)["pyramid"]
    assert worst_jump(part, mesh_of(part)) < LIMIT
    part = geometry.build("curved_box", "hybrid", layers=3, size=0.6, tolerance=1e-3)
    assert pairs(part)["wedge", "wedge", 4] > 0
    assert worst_jump(part, mesh_of(part)) < LIMIT


def test_a_domain_without_its_mesh_is_refused() -> None:
    with pytest.raises(InputError, match="mesh of a hybrid volume"):
        mesh_of(geometry.build("cube", "tets"))


def test_the_mesh_of_another_domain_is_refused(layered: Domain) -> None:
    with pytest.raises(InputError, match="does not have the elements"):
        jumps(geometry.build("cube", "tets"), mesh_of(layered))


def test_seeds_give_the_same_numbers(layered: Domain) -> None:
    assert jumps(layered, mesh_of(layered), seed=3) == jumps(layered, mesh_of(layered), seed=3)
    assert np.isfinite([jump.field for jump in jumps(layered, mesh_of(layered))]).all()
