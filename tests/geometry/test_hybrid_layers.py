"""Spline layers under hand-made skins: hexahedra and wedges over pyramids and tetrahedra."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from geometry.hybrid.layers import _meet, complete_with_layers, directions, inner_shell
from geometry.hybrid.refinement import refine
from iga.assembly import integral, volume
from iga.certificate import certify
from iga.domain import check, counts
from iga.errors import InputError
from problems.manufactured import solve_exact
from tests.geometry.hybrid_skins import SIDES, ball, bend, bezier_skin, box_mesh, spline_box
from tests.geometry.test_hybrid_volume import jumps

pytestmark = pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="no mesh generator is installed")

T, F = True, False
MIXED = (F, F, T, F, T, F)


@pytest.fixture(scope="module")
def layered():
    """Four layers: two elements across, joined by quadratic splines with one continuous derivative."""
    return complete_with_layers(spline_box(2, 2, MIXED, bend), 3, 0.5)


def test_all_four_cells_conform(layered):
    check(layered)
    assert counts(layered) == {
        "hexahedron": 2 * 16, "wedge": 2 * 16, "pyramid": 16, "tetrahedron": counts(layered)["tetrahedron"],
    }
    worst, kinds, outside = jumps(layered)
    assert worst < 1e-12
    wanted = {("hexahedron", "hexahedron"), ("hexahedron", "wedge"), ("wedge", "wedge"), ("hexahedron", "pyramid"),
              ("tetrahedron", "wedge"), ("pyramid", "tetrahedron"), ("tetrahedron", "tetrahedron")}
    assert set(kinds) == wanted
    assert outside == 32
    assert (certify(layered).verdict > 0).all()
    assert layered.report["layers"] == 3


def test_patch_and_refinement(layered):
    fine = refine(layered)
    assert volume(fine, 6) == pytest.approx(volume(layered, 6), rel=1e-12)
    assert jumps(fine)[0] < 1e-12
    assert (certify(fine).verdict > 0).all()
    for domain in (layered, fine):
        answer = solve_exact(domain, "heat", "1+2*x-3*y+0.5*z")[1]
        assert answer["relative_h1_error"] < 1e-12


def test_layers_of_a_box_are_an_offset():
    shell = bezier_skin(*box_mesh(2, MIXED)[:3], 2)
    w = directions(shell)
    corners = np.abs(shell.vertices - 0.5).min(axis=1) == 0.5
    assert np.abs(np.abs(w[corners]) - 1.0).max() < 0.005  # by the ridge
    inner, shift = inner_shell(shell, 0.5)
    assert inner.vertices.min() > 0.05
    assert inner.vertices.max() < 0.95
    assert np.abs(inner.points - shell.points - shift).max() < 1e-15
    domain = complete_with_layers(shell, 2, 0.5)
    assert domain.report["elements_across"] == 1
    assert volume(domain) == pytest.approx(1.0, abs=1e-13)
    assert [integral(domain, 1.0, boundary=name) for name in domain.boundaries] == pytest.approx([6.0], abs=1e-12)


def test_way_to_the_mid_structure_of_a_plate():
    """Between parallel planes a unit apart the ball that touches both has radius 1/2, from an edge as well."""
    far = np.stack(np.meshgrid(np.linspace(-2, 2, 41), np.linspace(-2, 2, 41), [1.0]), axis=-1).reshape(-1, 3)
    found = _meet(np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]]), far)
    assert found == pytest.approx([0.5, 0.5], abs=1e-3)


def test_layers_are_dropped_where_they_cannot_be(monkeypatch):
    import geometry.hybrid.layers as module

    def no(*_):
        raise InputError("no room")

    monkeypatch.setattr(module, "fill_skin", no)
    domain = complete_with_layers(ball(2, 2, (T,) * 6), 2, 0.5)
    assert counts(domain).keys() == {"tetrahedron"}
    assert "no room" in domain.report["layers_dropped"]
    with pytest.raises(InputError, match="at least 2 layers"):
        complete_with_layers(ball(2, 2, (T,) * 6), 1, 0.5)


def test_boundary_names(layered):
    assert set(layered.boundaries) == set(SIDES)
    facets = [sum(len(f.elements) for f in own) for own in layered.boundaries.values()]
    assert facets == [4, 4, 8, 4, 8, 4]
