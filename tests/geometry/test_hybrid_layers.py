"""Spline layers under hand-made skins: hexahedra and wedges over pyramids and tetrahedra."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from geometry.hybrid.fairing import fair_displacement, second_differences
from geometry.hybrid.field import field_under, paths, skeleton
from geometry.hybrid.layers import complete_with_layers, moved, traced, valid_layers
from geometry.hybrid.refinement import refine
from geometry.hybrid.ways import directions, touching_balls, ways_of
from geometry.simplices.closest import closest
from iga.assembly import integral, volume
from iga.bernstein import bernstein, functions_at, greville
from iga.block import bezier_coefficients
from iga.cells import QUADRILATERAL, TRIANGLE
from iga.certificate import certify
from iga.domain import check, counts
from iga.errors import InputError
from problems.manufactured import solve_exact
from tests.geometry.hybrid_skins import SIDES, ball, bend, bezier_skin, box_mesh, jumps_of, spline_box

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
    kinds = {("hexahedron", "hexahedron"), ("hexahedron", "wedge"), ("wedge", "wedge"), ("hexahedron", "pyramid"),
             ("tetrahedron", "wedge"), ("pyramid", "tetrahedron"), ("tetrahedron", "tetrahedron")}
    assert jumps_of(layered) == (pytest.approx(0.0, abs=1e-12), kinds, 32)
    assert (certify(layered).verdict > 0).all()
    assert layered.report["layers"] == 3


def test_patch_and_refinement(layered):
    fine = refine(layered)
    assert volume(fine, 6) == pytest.approx(volume(layered, 6), rel=1e-12)
    assert jumps_of(fine)[0] < 1e-12
    assert (certify(fine).verdict > 0).all()
    for domain in (layered, fine):
        answer = solve_exact(domain, "heat", "1+2*x-3*y+0.5*z")[1]
        assert answer["relative_h1_error"] < 1e-12


def test_layers_of_a_box_are_an_offset():
    shell = bezier_skin(*box_mesh(2, MIXED)[:3], 2)
    w = directions(shell)
    corners = np.abs(shell.vertices - 0.5).min(axis=1) == 0.5
    assert np.abs(np.abs(w[corners]) - 1.0).max() < 0.005  # by the ridge
    inner = moved(shell, traced(shell, ways_of(shell, None), 0.5, np.array([1.0]))[0])
    assert inner.vertices.min() > 0.05
    assert inner.vertices.max() < 0.95
    domain = complete_with_layers(shell, 2, 0.5)
    assert domain.report["elements_across"] == 1
    assert volume(domain) == pytest.approx(1.0, abs=1e-13)
    assert [integral(domain, 1.0, boundary=name) for name in domain.boundaries] == pytest.approx([6.0], abs=1e-12)


def test_way_to_the_mid_structure_of_a_plate():
    """Between parallel planes a unit apart the ball that touches both has radius 1/2, from an edge as well."""
    far = np.stack(np.meshgrid(np.linspace(-2, 2, 41), np.linspace(-2, 2, 41), [1.0]), axis=-1).reshape(-1, 3)
    found = touching_balls(np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]]), far)
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


def tube(n=6, high=3.0):
    """A prism of n sides about the z axis, of radius one."""
    angle = 2.0 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    levels = np.linspace(0.0, high, 5)
    vertices = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in levels] + [[[0, 0, 0], [0, 0, high]]])
    triangles = []
    for j in range(4):
        for k in range(n):
            a, b, c, d = n * j + k, n * j + (k + 1) % n, n * (j + 1) + k, n * (j + 1) + (k + 1) % n
            triangles += [[a, b, d], [a, d, c]]
    bottom, top = 5 * n, 5 * n + 1
    for k in range(n):
        triangles += [[bottom, (k + 1) % n, k], [top, 4 * n + k, 4 * n + (k + 1) % n]]
    return bezier_skin(vertices, np.zeros((0, 4), dtype=np.int64), np.array(triangles), 3)


@pytest.fixture(scope="module")
def field():
    return field_under(tube())


def test_field_rises_from_the_skin_to_the_mid_structure(field):
    """In a prism of three times its radius the mid-structure is near the axis, away from the ends."""
    shell = tube()
    away = closest(shell.vertices, skeleton(shell), np.array([[0.0, 0.0, 1.5], [0.2, 0.0, 0.1]]))[1]
    assert away == pytest.approx([np.cos(np.pi / 6), 0.1], rel=1e-12)
    middle = field.points[field.middle]
    assert np.hypot(middle[:, 0], middle[:, 1]).max() < 0.45
    assert np.abs(middle[:, 2] - 1.5).max() < 1.4
    assert field.harmonic.min() >= 0.0
    assert field.harmonic.max() == 1.0
    places, lengths = paths(field, np.arange(30), -directions_out(shell)[:30], 9)
    side = np.flatnonzero(np.abs(shell.vertices[:30, 2] - 1.5) < 0.5)
    ends = places[side, -1]
    assert np.hypot(ends[:, 0], ends[:, 1]).max() < 0.4
    assert 0.5 < lengths[side].min() < lengths[side].max() < 1.5


def directions_out(shell):
    w = directions(shell)
    return -w / np.linalg.norm(w, axis=1, keepdims=True)


def test_mid_structure_given_by_hand():
    shell = tube()
    field = field_under(shell, middle=np.array([[0.3, 0.0, 1.5]]))
    chosen = field.points[field.middle]
    assert np.linalg.norm(chosen - [0.3, 0.0, 1.5], axis=1).max() < 0.5
    ways = ways_of(shell, field)
    ends = ways.places[12:18, -1]  # the ring in the middle
    assert np.linalg.norm(ends - chosen.mean(axis=0), axis=1).max() < 0.6


def test_traced_layers_go_deep_and_are_certified(field):
    shell = tube()
    D, scale, left = valid_layers(shell, ways_of(shell, field), 0.75, 3)
    assert left == 0
    assert D[-1] == pytest.approx(0.0)
    assert scale.min() > 0.3
    made = complete_with_layers(shell, 3, 0.75)
    assert made.report["paths"] == "blended"
    assert made.report["omega"] == 0.75
    assert made.report["mid_structure"] > 0
    assert (certify(made).verdict > 0).all()
    assert volume(made, 5) == pytest.approx(3.0 * 1.5 * np.sqrt(3.0), rel=1e-12)
    straight = complete_with_layers(shell, 3, 0.5, way="straight")
    assert straight.report["paths"] == "straight"
    assert (certify(straight).verdict > 0).all()


def test_boundary_names(layered):
    assert set(layered.boundaries) == set(SIDES)
    facets = [sum(len(f.elements) for f in own) for own in layered.boundaries.values()]
    assert facets == [4, 4, 8, 4, 8, 4]


def test_displacements_of_splines_are_smooth():
    """Through the shifts of the vertices, exact for affine ones; with less bending than a piecewise linear one."""
    skin = spline_box(3, 3, warp=bend)
    random = np.random.default_rng(5)
    matrix, at = random.standard_normal((3, 3)), skin.vertices
    found = fair_displacement(skin, at @ matrix)
    moved_to = bezier_corners(skin, found)
    assert np.abs(moved_to - at @ matrix).max() < 0.02 * np.abs(at @ matrix).max()
    wave = np.sin(3.0 * at[:, :1]) * np.ones(3)
    assert np.abs(bezier_corners(skin, fair_displacement(skin, wave)) - wave).max() < 0.05


def bezier_corners(skin, coefficients):
    """Values of a field at the vertices."""
    result = np.zeros((len(skin.vertices), coefficients.shape[1]))
    for block, corners in zip(skin.space.blocks, skin.corners):
        own = functions_at(block.basis, block.basis.cell.vertices)
        result[corners] = bezier_coefficients(block, coefficients)[:, own]
    return result


def test_second_differences_vanish_on_linear_functions_alone():
    for cell in (QUADRILATERAL, TRIANGLE):
        basis = bernstein(cell, 3)
        D = second_differences(basis)
        points = greville(basis)
        assert np.abs(D @ points).max() < 1e-14
        assert np.abs(D.sum(axis=1)).max() < 1e-14
        assert np.linalg.matrix_rank(D) == basis.n - 3
