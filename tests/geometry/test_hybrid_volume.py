"""Volumes of pyramids and tetrahedra under hand-made skins."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.filling import fault, fill, signed_volumes
from geometry.hybrid.flat_corners import tangents_of, without_flat_corners
from geometry.hybrid.numbering import numbering, skin_rows, volume_rows
from geometry.hybrid.pyramids import apexes
from geometry.hybrid.refinement import bezier_of, pyramid_children, pyramid_matrices, refine
from geometry.hybrid.subdividing import subdivided
from geometry.hybrid.volume import complete, corners_of, fill_skin, skin_facets
from iga.assembly import integral, volume
from iga.bernstein import bernstein, greville
from iga.block import bezier_coefficients
from iga.cells import PYRAMID, QUADRILATERAL, TETRAHEDRON, TRIANGLE
from iga.certificate import certify
from iga.chunk import facet_chunks
from iga.conforming import Complex, boundary, straight_domain
from iga.domain import all_facets, check, counts
from iga.errors import InputError
from iga.refinement import complex_of
from iga.store import load, save
from problems.manufactured import solve_exact
from tests.geometry.hybrid_skins import SIDES, ball, bend, bezier_skin, box_mesh, jumps_of, spline_box

pytestmark = pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="no mesh generator is installed")

T, F = True, False
MIXED = (F, F, T, F, T, F)


@pytest.fixture(scope="module")
def bent():
    """A bent box with bicubic B-spline faces and faces of triangles."""
    return complete(spline_box(2, 3, MIXED, bend))


@pytest.fixture(scope="module")
def fine(bent):
    return refine(bent, 1)


def test_fill_keeps_the_surface():
    skin = ball(2, 1, (T,) * 6)
    triangles = corners_of(skin, TRIANGLE)
    points, tets = fill(skin.vertices, triangles)
    assert np.array_equal(points[: len(skin.vertices)], skin.vertices)
    assert signed_volumes(points, tets).min() > 0.0
    assert fault(skin.vertices, triangles, points, tets, signed_volumes(points, tets)) is None


def test_faults_of_fillings_are_named():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tets = np.array([[0, 1, 2, 3]])
    surface = np.array([f.vertices for f in TETRAHEDRON.faces])
    volumes = signed_volumes(points, tets)
    assert fault(points, surface, points, tets, volumes) is None
    assert "moved" in str(fault(points + 1e-15, surface, points, tets, volumes))
    assert "changed" in str(fault(points, surface[:3], points, tets, volumes))
    assert "volume" in str(fault(points, surface, points, tets, -volumes))


def test_an_open_surface_is_refused():
    skin = ball(2, 1, (T,) * 6)
    triangles = corners_of(skin, TRIANGLE)[1:]
    with pytest.raises(InputError, match="could not be filled"):
        fill(skin.vertices, triangles, limit=60.0)
    quads = corners_of(ball(2, 1), QUADRILATERAL)[1:]
    with pytest.raises(InputError, match="not closed"):
        apexes(ball(2, 1).vertices, quads, np.zeros((0, 3), dtype=np.int64))


def test_pyramids_leave_room_in_a_thin_plate():
    vertices, quads, triangles, *_ = box_mesh(3, (F,) * 6)
    thin = vertices * [1.0, 1.0, 0.03]
    tops, heights = apexes(thin, quads, triangles)
    flat = np.abs(vertices[quads][:, :, 2] - vertices[quads][:, :1, 2]).max(axis=1) == 0.0
    assert heights[flat].max() < 0.015
    assert (tops[:, 2] > 0.0).all()
    assert (tops[:, 2] < 0.03).all()


def test_a_plate_without_thickness_is_refused_by_its_face():
    skin = spline_box(3, 2)
    thin = replace(skin, points=skin.points * [1.0, 1.0, 1e-9], vertices=skin.vertices * [1.0, 1.0, 1e-9])
    names = "|".join(SIDES)
    with pytest.raises(InputError, match=rf"no pyramid fits on quadrilateral \d+ of the skin \(({names})\) near"):
        fill_skin(thin)


@pytest.mark.parametrize(("split", "degree"), [((F,) * 6, 3), (MIXED, 2), ((T,) * 6, 2)])
def test_box_is_filled_exactly(split, degree):
    domain = complete(spline_box(2, degree, split))
    check(domain)
    assert volume(domain) == pytest.approx(1.0, abs=1e-13)
    assert (certify(domain).verdict > 0).all()
    assert domain.report["not_certified"] == 0
    assert set(domain.boundaries) == set(SIDES)
    area = [integral(domain, 1.0, boundary=name) for name in SIDES]
    assert area == pytest.approx([1.0] * 6, abs=1e-12)


def test_boundary_functions_are_those_of_the_skin(bent):
    """Values on the boundary are the skin's, whatever the coefficients: the trace of the space is the skin's space."""
    skin = spline_box(2, 3, MIXED, bend)
    filled = fill_skin(skin)
    numbers = numbering(filled.mesh, skin, 3)
    rows = skin_rows(skin, numbers)
    field = np.random.default_rng(3).standard_normal((skin.space.n, 1))
    for block, own in zip(skin.space.blocks, numbers.skin):
        assert np.abs(bezier_coefficients(block, field) - (rows @ field)[own]).max() < 1e-13
    M = volume_rows(numbers.outer, rows)
    assert np.abs(M @ np.ones(M.shape[1]) - 1.0).max() < 1e-13
    assert bent.space.n == skin.space.n + int((~numbers.outer).sum())
    facets = skin_facets(filled.mesh, skin)
    assert [len(f) for f in facets] == [b.elements for b in skin.space.blocks]


def test_bent_box_conforms(bent, fine):
    kinds = {("pyramid", "tetrahedron"), ("tetrahedron", "tetrahedron")}
    facets = sum(len(f.elements) for f in all_facets(bent))
    assert jumps_of(bent) == (pytest.approx(0.0, abs=1e-12), kinds, facets)
    assert jumps_of(fine) == (pytest.approx(0.0, abs=1e-12), kinds | {("pyramid", "pyramid")}, 4 * facets)


def test_volume_by_the_divergence_theorem(bent):
    # V = int x.n / 3
    total = sum(
        float(((c.x * c.normal).sum(axis=-1) * c.dx).sum()) / 3.0 for c in facet_chunks(bent, all_facets(bent), 8)
    )
    assert volume(bent, 8) == pytest.approx(total, rel=1e-10)


@pytest.mark.parametrize(("n", "split"), [(1, (F,) * 6), (1, MIXED), (2, (T,) * 6)])
def test_coarse_balls_are_certified(n, split):
    """Straight pyramids and tetrahedra far from the curved ones, which fold at first."""
    domain = complete(ball(n, 3, split))
    assert (certify(domain).verdict > 0).all()
    assert volume(domain, 8) == pytest.approx(4.0 / 3.0 * np.pi, rel=5e-3)


def test_tetrahedra_in_the_tangent_plane_are_cut():
    """A face inside with two edges along a smooth skin at one vertex cannot be valid."""
    skin = ball(1, 3, (T,) * 6)
    triangles = corners_of(skin, TRIANGLE)
    points, tets = fill(skin.vertices, triangles)
    vertices, cut, new = without_flat_corners(points, tets, tangents_of(skin))
    assert new == len(vertices) - len(points) > 0
    assert signed_volumes(vertices, cut).min() > 0.0
    assert signed_volumes(vertices, cut).sum() == pytest.approx(signed_volumes(points, tets).sum(), rel=1e-12)
    assert without_flat_corners(vertices, cut, tangents_of(skin))[2] == 0
    assert boundary(Complex(((TETRAHEDRON, cut),)))  # still conforming: no face has more than two


@pytest.mark.parametrize(("physics", "text"), [("heat", "1+2*x-3*y+0.5*z"), ("elasticity", "x+2*y;3*z-y;x-y+z")])
def test_patch(bent, fine, physics, text):
    for domain in (bent, fine):
        answer = solve_exact(domain, physics, text, points=5)[1]
        assert answer["relative_l2_error"] < 1e-12
        assert answer["relative_h1_error"] < 1e-12


def test_subdivided_skin_is_the_same_surface():
    skin = spline_box(2, 3, MIXED, bend)
    cut = subdivided(skin)
    assert [b.elements for b in cut.space.blocks] == [4 * b.elements for b in skin.space.blocks]
    for old, new, basis in zip(skin.space.blocks, cut.space.blocks, (b.basis for b in skin.space.blocks)):
        centre = basis.tabulate(basis.cell.centre[None], 0)[0]
        where = bezier_coefficients(old, skin.points)
        children = bezier_coefficients(new, skin.points).reshape(len(where), 4, basis.n, 3)
        if basis.cell is QUADRILATERAL:  # the last corner of the first child
            assert np.abs(children[:, 0, -1] - (centre @ where)[:, 0]).max() < 1e-13
        else:
            assert np.abs(basis.tabulate(basis.cell.centre[None], 0)[0] @ children[:, 3] - centre @ where).max() < 1e-13
    domain = complete(cut)
    assert volume(domain, 8) == pytest.approx(volume(complete(skin), 8), rel=1e-12)
    assert (certify(domain).verdict > 0).all()


# --- refinement -------------------------------------------------------------------------------------------------------


def test_children_fill_the_pyramid():
    pyramids, tets = pyramid_children()
    straight = sum(
        volume_of(cell, vertices) for cell, group in ((PYRAMID, pyramids), (TETRAHEDRON, tets)) for vertices in group
    )
    assert straight == pytest.approx(PYRAMID.volume, abs=1e-15)


def volume_of(cell, vertices):
    domain = straight_domain(Complex(((cell, np.arange(len(vertices))[None]),)), vertices)
    assert certify(domain).verdict[0] > 0
    return volume(domain)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_child_at_the_apex_is_exact(degree):
    """Scaling about the apex keeps the pyramid's rational functions; elsewhere children interpolate them."""
    basis = bernstein(PYRAMID, degree)
    matrix, vertices = pyramid_matrices(degree)[0][4], pyramid_children()[0][4]
    points = np.random.default_rng(7).dirichlet(np.ones(5), 30) @ PYRAMID.vertices
    old = bernstein(PYRAMID, 1).tabulate(points, 0)[0] @ vertices
    assert np.abs(basis.tabulate(points, 0)[0] @ matrix - basis.tabulate(old, 0)[0]).max() < 1e-13
    for matrices in pyramid_matrices(degree):
        assert np.abs(matrices.sum(axis=2) - 1.0).max() < 1e-12


def test_refinement_keeps_shape_and_names(bent, fine):
    assert counts(fine) == {"pyramid": 6 * 16, "tetrahedron": 8 * counts(bent)["tetrahedron"] + 4 * 16}
    assert volume(fine, 8) == pytest.approx(volume(bent, 8), rel=1e-13)
    for name in SIDES:
        areas = [integral(domain, 1.0, 8, name) for domain in (bent, fine)]
        assert areas[1] == pytest.approx(areas[0], rel=1e-8)  # the integrand is a root
    assert (certify(fine).verdict > 0).all()
    assert 0.0 < fine.report["pyramid_deviation"] < 1e-3
    assert complex_of(fine).vertices > 0  # plain Bernstein functions


def test_refinement_after_saving(bent, fine, tmp_path):
    path = tmp_path / "bent.npz"
    save(bent, path)
    again = refine(load(path), 1)
    assert np.abs(again.points - fine.points).max() < 1e-13
    assert again.boundaries.keys() == fine.boundaries.keys()


def test_elevation_is_exact(bent):
    high = refine(bent, 0, 1)
    assert {b.basis.degree for b in high.space.blocks} == {(4,)}
    old, new = bezier_of(bent), bezier_of(high)
    for (cell, _), a, b in zip(old.mesh.parts, old.coefficients, new.coefficients):
        points = 0.9 * greville(bernstein(cell, 2))
        values = bernstein(cell, 4).tabulate(points, 0)[0] @ b - bernstein(cell, 3).tabulate(points, 0)[0] @ a
        assert np.abs(values).max() < 1e-13


def test_refinement_refuses(bent):
    with pytest.raises(InputError, match="negative"):
        refine(bent, -1)
    with pytest.raises(InputError, match="does not carry"):
        refine(replace(bent, provenance=type(bent.provenance)("hybrid")))


@pytest.mark.parametrize(("degree", "warp", "levels"), [
    (2, bend, 3),
    pytest.param(3, None, 3, marks=pytest.mark.long),
    pytest.param(3, bend, 3, marks=pytest.mark.long),
])
def test_rates(degree, warp, levels):
    """L2 rate p + 1 and H1 rate p between the last two levels, pyramids included."""
    domain = complete(bezier_skin(*box_mesh(1, MIXED)[:3], degree, warp=warp))
    errors = []
    for level in range(levels + 1):
        if level:
            domain = refine(domain)
        answer = solve_exact(domain, "heat", "sin(x)*cos(0.7*y)*exp(0.3*z)", points=degree + 2)[1]
        errors.append([answer["relative_l2_error"], answer["relative_h1_error"]])
    rates = np.log2(np.array(errors[-2]) / np.array(errors[-1]))
    assert rates[0] > degree + 1 - 0.15
    assert rates[1] > degree - 0.15
    assert errors[-1][0] < 1e-4


def test_blocks_share_functions_of_short_elements():
    """Elements with fewer functions than their block have rows of zeros; every row of Bernstein sums stays one."""
    basis = bernstein(TETRAHEDRON, 1)
    dofs = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    M = csr_array(np.array([[1.0, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]))
    made = blocks_of(basis, dofs, M)
    for block, elements in made:
        values = bezier_coefficients(block, np.arange(4.0)[:, None])
        assert np.abs(values[..., 0] - (M @ np.arange(4.0))[dofs[elements]]).max() < 1e-15


def test_pyramids_are_smooth_at_their_apexes():
    """The terms of low order about the apex are polynomials: second differences along lines into it agree from all
    sides.
    """
    domain = complete(bezier_skin(*box_mesh(1, MIXED)[:3], 3, warp=bend))
    assert domain.report["smooth_pyramids"]
    apex = PYRAMID.vertices[4]
    basis = bernstein(PYRAMID, 3)
    step = 1e-3
    random = np.random.default_rng(11).random((12, 2))
    ways = np.column_stack([random - apex[:2], np.full(12, -1.0)])  # from the apex to points of the base
    for block in domain.space.blocks:
        if block.basis.cell is PYRAMID:
            net = bezier_coefficients(block, domain.points)
            x = [basis.tabulate(apex + s * step * ways, 0)[0] @ net for s in (0.0, 1.0, 2.0)]
            first = (-1.5 * x[0] + 2.0 * x[1] - 0.5 * x[2]) / step
            second = (x[0] - 2.0 * x[1] + x[2]) / step**2
            squares = np.stack([ways[:, i] * ways[:, j] for i in range(3) for j in range(i + 1)], axis=1)
            for values, terms, off in ((first, ways, 1e-4), (second, squares, 0.02)):
                fit = np.linalg.lstsq(terms, np.moveaxis(values, 1, 0).reshape(12, -1), rcond=None)[0]
                assert np.abs(terms @ fit - np.moveaxis(values, 1, 0).reshape(12, -1)).max() < off
