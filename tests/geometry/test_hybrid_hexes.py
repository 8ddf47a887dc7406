"""Tetrahedra of hybrid volumes turned into hexahedra."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from geometry.hybrid.hexes import has_hexes, with_hexes, with_tets
from geometry.hybrid.layers import complete_with_layers
from geometry.hybrid.refinement import refine
from geometry.hybrid.source import refine as refine_source
from geometry.hybrid.volume import complete
from iga.assembly import volume
from iga.block import bezier_coefficients
from iga.cells import HEXAHEDRON, PYRAMID
from iga.certificate import certify
from iga.domain import Space, check, counts
from iga.locate import locate
from iga.store import load, save
from problems.manufactured import solve_exact
from tests.geometry.hybrid_skins import bend, bezier_skin, box_mesh, jumps_of, spline_box

pytestmark = pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="no mesh generator is installed")

T, F = True, False
MIXED = (F, F, T, F, T, F)


def facet_count(domain):
    return {name: sum(len(f.elements) for f in own) for name, own in domain.boundaries.items()}


@pytest.fixture(scope="module")
def layered():
    return complete_with_layers(spline_box(2, 2, MIXED, bend), 3, 0.5)


@pytest.fixture(scope="module")
def mixed(layered):
    return with_hexes(layered)


def test_same_solid_in_hexahedra(layered, mixed):
    check(mixed)
    tets = counts(layered)["tetrahedron"]
    assert counts(mixed) == {"hexahedron": 32 + 4 * tets, "wedge": 32, "pyramid": 16}
    assert volume(mixed, 8) == pytest.approx(volume(layered, 8), rel=1e-14)
    assert (certify(mixed).verdict > 0).all()
    assert facet_count(mixed) == facet_count(layered)  # the skin is that of the layers
    assert jumps_of(mixed)[0] < 1e-12


def test_functions_agree_between_pyramids_and_hexahedra(mixed):
    """On lateral faces a random field has one value, from the pyramid and from the hexahedra beside it."""
    field = np.random.default_rng(3).standard_normal((mixed.space.n, 1))
    hexes = tuple(b for b in mixed.space.blocks if b.basis.cell is HEXAHEDRON)
    inside = replace(mixed, space=Space(hexes, mixed.space.n), boundaries={})
    share = np.random.default_rng(4).dirichlet(np.ones(3), 3)
    compared = 0
    for block in mixed.space.blocks:
        if block.basis.cell is not PYRAMID:
            continue
        for face in PYRAMID.faces[1:]:
            values = block.basis.tabulate(share @ PYRAMID.vertices[list(face.vertices)], 0)[0]
            x = (values @ bezier_coefficients(block, mixed.points)).reshape(-1, 3)
            mine = (values @ bezier_coefficients(block, field)).ravel()
            found = locate(inside, x)
            for k in np.flatnonzero(found.element >= 0):
                other = hexes[found.block[k]]
                net = bezier_coefficients(other, field, found.element[k : k + 1])
                there = other.basis.tabulate(found.xi[k : k + 1], 0)[0] @ net[0]
                assert abs(float(there[0, 0]) - mine[k]) < 1e-9  # by the search for the point
                compared += 1
    assert compared > 60


def test_patch_and_better_functions(layered, mixed):
    for formula, physics in (("1+2*x-3*y+0.5*z", "heat"), ("x+2*y;3*z-y;x-y+z", "elasticity")):
        assert solve_exact(mixed, physics, formula, points=5)[1]["relative_h1_error"] < 1e-12
    exact = "sin(x)*cos(0.7*y)*exp(0.3*z)"
    old, new = (solve_exact(d, "heat", exact)[1]["relative_h1_error"] for d in (refine(layered, 0), mixed))
    assert new < old  # the space of the tetrahedra is contained


def test_back_and_refined(layered, mixed, tmp_path):
    again = with_tets(mixed)
    plain = refine(layered, 0)
    assert counts(again) == counts(layered)
    assert again.space.n == plain.space.n
    assert volume(again, 8) == pytest.approx(volume(layered, 8), rel=1e-13)
    save(mixed, tmp_path / "mixed.npz")
    fine = refine_source(load(tmp_path / "mixed.npz"), 1)
    assert has_hexes(fine)
    assert counts(fine)["hexahedron"] == 8 * 32 + 4 * counts(refine(layered, 1))["tetrahedron"]
    assert volume(fine, 8) == pytest.approx(volume(layered, 8), rel=1e-12)
    assert solve_exact(fine, "heat", "1+2*x-3*y+0.5*z", points=5)[1]["relative_h1_error"] < 1e-12


def test_all_tetrahedra_become_hexahedra():
    domain = complete(bezier_skin(*box_mesh(1, (T,) * 6)[:3], 3, warp=bend))
    made = with_hexes(domain)
    check(made)
    assert counts(made) == {"hexahedron": 4 * counts(domain)["tetrahedron"]}
    assert facet_count(made) == {name: 3 * count for name, count in facet_count(domain).items()}
    assert facet_count(with_tets(made)) == facet_count(domain)
    assert np.abs(with_tets(made).points - refine(domain, 0).points).max() < 1e-12
    fine = refine_source(made, 1)
    assert counts(fine) == {"hexahedron": 32 * counts(domain)["tetrahedron"]}
    assert volume(fine, 6) == pytest.approx(volume(domain, 6), rel=1e-12)
