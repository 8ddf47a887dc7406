"""Hybrid B-reps of single faces: triangles, bands, revised and trim functions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.cad.brep import Coedge, Face, fit_curve, surface_points
from geometry.hybrid import shapes
from geometry.hybrid.band import Band, make_band
from geometry.hybrid.band_errors import band_error
from geometry.hybrid.hbrep import (
    HybridFace,
    assemble_face,
    hybrid_face,
    polynomial_surface,
    refine_hybrid,
    refined_surface,
    tensor_rows,
)
from geometry.hybrid.partition import Partition
from geometry.hybrid.triangle import (
    CUBIC,
    CURVE,
    certified,
    invert_phi,
    jacobian_coefficients,
    make_phi,
    selection,
    triangle_map,
)
from geometry.hybrid.trimming import Trimming, cut_at_knots, halves, hermite, trim_face
from geometry.patch import Patch
from iga.bernstein import bernstein
from iga.block import Block, Patterns
from iga.cells import LINE, QUADRILATERAL
from iga.errors import InputError

Array = np.ndarray


def spline(seed: int = 0, n: int = 3, noise: float = 0.2) -> Patch:
    """Bicubic surface over [0, n]^2."""
    knots = np.concatenate([np.zeros(4), np.arange(1.0, n), np.full(4, float(n))])
    g = np.array([knots[i + 1 : i + 4].mean() for i in range(n + 3)])
    x, y = np.meshgrid(g, g, indexing="ij")
    random = np.random.default_rng(seed)
    return Patch((knots, knots), np.stack([x, y, noise * random.normal(size=x.shape)], axis=-1))


def circle(centre: tuple[float, float], radius: float, inner: bool = True) -> tuple[Coedge, ...]:
    way = -1 if inner else 1

    def piece(i: int) -> Coedge:
        def points(t: Array) -> Array:
            angle = 0.3 + way * 2 * np.pi * (i + t) / 3
            return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=1)

        return Coedge(-1, False, fit_curve(points, 1e-9))

    return tuple(piece(i) for i in range(3))


def worked_example() -> HybridFace:
    """Figure 3.4: a curve cuts off the corner (2, 2) of the knot interval [1, 2]^2."""
    surface = spline(7)
    plane = np.array([[(2.0, 1.3), (1.9, 1.55), (1.7, 1.8), (1.35, 2.0)]])
    space = surface_points(surface, plane[0])[None] + 0.01
    # A second, unused segment holds the end of the open curve.
    trimming = Trimming(np.concatenate([plane, plane[:, [3] * 4]]), np.concatenate([space, space[:, [3] * 4]]),
                        np.array([1, 1]), np.zeros(2, dtype=int), np.zeros(2), np.ones(2))
    q0 = np.array([[1.35, 1.3]])
    band = Band(trimming, np.array([0]), q0, np.array([True]), np.array([(1.0, 1.3), (1.35, 1.0)]),
                np.array([(1.35, 2.0), (2.0, 1.3)]), np.array([(-1, -1, -1, 1), (-1, -1, -1, 0)]), np.full((2, 4), -1))
    parts = Partition(np.array([(1.0, 1.0)]), np.array([(1.35, 1.3)]), np.array([False]))
    return assemble_face(surface, band, parts, "blend", "selection")


def functions(face: HybridFace, block: Block, e: int, at: Array) -> Array:
    """Values (q, n) of all functions at reference points of an element."""
    assert isinstance(block.extraction, Patterns)
    values = block.basis.tabulate(at, 0)[0] @ block.extraction.C[e].T
    full = np.zeros((len(at), face.space.n))
    full[:, block.dofs[e]] = values
    return full


def rectangles(face: HybridFace) -> list[tuple[Block, int, Array, Array]]:
    """Block, element, low and high corner of every rectangle."""
    found = []
    start = 0
    for block in face.space.blocks:
        if block.basis.cell is QUADRILATERAL:
            found += [(block, e, face.low[start + e], face.high[start + e]) for e in range(block.elements)]
            start += block.elements
    return found


def test_worked_example_has_all_its_properties() -> None:
    face = worked_example()
    random = np.random.default_rng(1)
    assert [b.elements for b in face.space.blocks] == [1, 2, 1]  # rest, two rectangles, triangle: four pieces
    sample = []
    for block in face.space.blocks:
        for e in range(block.elements):
            square = block.basis.cell is QUADRILATERAL
            at = random.random((60, 2)) if square else random.dirichlet(np.ones(3), 60)[:, 1:]
            N = functions(face, block, e, at)
            assert np.abs(N.sum(axis=1) - 1).max() < 1e-14
            sample.append(N)
    N = np.concatenate(sample)
    used = np.flatnonzero(np.abs(N).max(axis=0) > 0)
    assert (used < face.revised).sum() == 16
    assert (used >= face.revised).sum() == 4
    assert np.linalg.matrix_rank(N[:, used], tol=1e-10) == 20
    t = np.linspace(0, 1, 21)
    on = functions(face, face.space.blocks[2], 0, np.stack([1 - t, t], axis=1))
    assert np.abs(on[:, : face.revised]).max() < 1e-15
    B = bernstein(LINE, 3).tabulate(t[:, None], 0)[0]
    assert np.abs(on[:, face.revised : face.revised + 4] - B).max() < 1e-14


def field_of(face: HybridFace, seed: int = 5) -> Array:
    return np.random.default_rng(seed).normal(size=face.space.n)


def jumps(face: HybridFace) -> float:
    """Largest difference of a random field between elements, at points of element boundaries."""
    field = field_of(face)
    s = np.array([0.0, 0.11, 0.36, 0.62, 0.87, 1.0])
    boxes = rectangles(face)
    points, values = [], []
    for block, e, low, high in boxes:
        for d in range(2):
            for side in (0.0, 1.0):
                at = np.zeros((len(s), 2))
                at[:, d], at[:, 1 - d] = side, s
                points.append(low + at * (high - low))
                values.append(functions(face, block, e, at) @ field)
    last = face.space.blocks[-1]
    for e in range(len(face.phi)):
        for at in (np.stack([s, 0 * s], 1), np.stack([0 * s, s], 1)):
            points.append(triangle_map(face.phi[[e]], at)[0])
            values.append(functions(face, last, e, at) @ field)
    x, y = np.concatenate(points), np.concatenate(values)
    worst = 0.0
    for block, e, low, high in boxes:
        near = ((x >= low - 1e-12) & (x <= high + 1e-12)).all(axis=1)
        at = np.clip((x[near] - low) / (high - low), 0, 1)
        worst = max(worst, np.abs(functions(face, block, e, at) @ field - y[near]).max(initial=0))
    for e, (q0, phi) in enumerate(zip(face.band.q0, face.phi)):
        ends = phi[CURVE[[0, 3]]]
        for d in range(2):
            far = ends[d]
            on = (np.abs(x[:, 1 - d] - q0[1 - d]) < 1e-12) & (x[:, d] >= min(q0[d], far[d]) - 1e-12) & (
                x[:, d] <= max(q0[d], far[d]) + 1e-12)
            share = np.clip((x[on, d] - q0[d]) / (far[d] - q0[d]), 0, 1)
            at = np.zeros((len(share), 2))
            at[:, d] = share
            worst = max(worst, np.abs(functions(face, last, e, at) @ field - y[on]).max(initial=0))
    return worst


@cache
def bands() -> dict[str, HybridFace]:
    surface = spline(3, 3)
    lettered = shapes.lettered_face()
    faces = {
        "inside one interval": Face(surface, (circle((1.5, 1.5), 0.2),), False, "", "one"),
        "two in one interval": Face(surface, (circle((1.3, 1.5), 0.15), circle((1.66, 1.55), 0.17)), False, "", "two"),
        "across knot lines": Face(surface, (circle((1.6, 1.4), 0.9),), False, "", "cross"),
        "ring": Face(surface, (circle((1.5, 1.5), 1.4, False), circle((1.6, 1.4), 0.4)), False, "", "ring"),
        "square corners": lettered,
    }
    return {name: hybrid_face(face, trim_face(face, 1e-4)) for name, face in faces.items()}


AREAS = {
    "inside one interval": 9 - np.pi * 0.04, "two in one interval": 9 - np.pi * (0.0225 + 0.0289),
    "across knot lines": 9 - np.pi * 0.81, "ring": np.pi * (1.96 - 0.16),
}  # fmt: skip


@pytest.mark.parametrize("name", ["inside one interval", "two in one interval", "across knot lines", "ring",
                                  "square corners"])
def test_bands_are_conforming_tilings(name: str) -> None:
    face = bands()[name]
    assert jumps(face) < 1e-11
    assert certified(face.phi).all()
    area = np.prod(face.high - face.low, axis=1).sum()
    g, w = np.polynomial.legendre.leggauss(5)
    u, v = (0.5 * (1 + x.ravel()) for x in np.meshgrid(g, g, indexing="ij"))
    gradients = CUBIC.tabulate(np.stack([u, v * (1 - u)], axis=1), 1)[1]
    J = np.einsum("qbd,ebc->eqcd", gradients, face.phi)
    area += (np.abs(np.linalg.det(J)) @ (0.25 * np.outer(w, w).ravel() * (1 - u))).sum()
    plane = face.band.trimming.plane
    exact = 0.0
    t = 0.5 * (1 + g)
    B = bernstein(LINE, 3).tabulate(t[:, None], 1)
    x, dx = np.einsum("qk,skc->sqc", B[0], plane), np.einsum("qk,skc->sqc", B[1][..., 0], plane)
    exact = float(((x[..., 0] * dx[..., 1] - x[..., 1] * dx[..., 0]) @ (0.25 * w)).sum())
    if exact < 0:
        exact += 9.0
    assert area == pytest.approx(exact, rel=1e-10)  # no gap and no overlap
    if name in AREAS:
        assert area == pytest.approx(AREAS[name], rel=1e-3)
    for knots, d in ((face.surface.knots[0], 0), (face.surface.knots[1], 1)):
        for line in np.unique(knots):
            assert not ((face.low[:, d] < line - 1e-9) & (face.high[:, d] > line + 1e-9)).any()


def test_functions_sum_to_one_and_revised_ones_vanish_on_the_curves() -> None:
    random = np.random.default_rng(2)
    for face in bands().values():
        t = np.linspace(0, 1, 9)
        for block in face.space.blocks:
            assert isinstance(block.extraction, Patterns)
            assert np.abs(block.extraction.C.sum(axis=1) - 1).max() < 1e-12
        block = face.space.blocks[-1]
        for e in range(0, len(face.phi), 5):
            N = functions(face, block, e, np.stack([1 - t, t], axis=1))
            assert np.abs(N[:, : face.revised]).max() < 1e-15
        # Outside the band the surface is the B-spline surface, whatever the trimming curves are.
        moved = face.points.copy()
        moved[face.revised :] += random.normal(size=(face.trim, 3))
        block = face.space.blocks[0]
        assert block.n == 16
        at = random.random((4, 2))
        for e in range(0, block.elements, 7):
            uv = face.low[e] + at * (face.high[e] - face.low[e])
            x = functions(face, block, e, at) @ moved
            assert np.abs(x - surface_points(face.surface, uv)).max() < 1e-12


def test_neighbours_with_shared_curves_are_watertight() -> None:
    left = bands()["across knot lines"]
    right = assemble_face(spline(99, 3, 1.0), left.band, left.parts)
    shared = np.random.default_rng(4).normal(size=(left.trim, 3))
    t = np.linspace(0, 1, 13)
    for e in range(len(left.phi)):
        at = np.stack([1 - t, t], axis=1)
        sides = []
        for face in (left, right):
            points = np.concatenate([face.points[: face.revised], shared])
            sides.append(functions(face, face.space.blocks[-1], e, at) @ points)
        assert np.abs(sides[0] - sides[1]).max() == 0.0


def test_phi_is_the_identity_on_the_legs_and_inverts() -> None:
    random = np.random.default_rng(6)
    inner = np.sort(random.random((200, 2, 2)), axis=1)
    curve = np.zeros((200, 4, 2))
    curve[:, 0], curve[:, 3] = (1.0, 0.0), (0.0, 1.0)
    curve[:, 1] = np.stack([1 - inner[:, 0, 0] * 0.7, inner[:, 0, 1] * 0.7], axis=1)
    curve[:, 2] = np.stack([0.7 * (1 - inner[:, 1, 0]), 1 - 0.7 * (1 - inner[:, 1, 1])], axis=1)
    phi = make_phi(np.zeros((200, 2)), curve)
    s = np.linspace(0, 1, 11)
    assert triangle_map(phi, np.stack([s, 0 * s], 1)) == pytest.approx(np.tile(np.stack([s, 0 * s], 1), (200, 1, 1)))
    B = bernstein(LINE, 3).tabulate(s[:, None], 0)[0]
    assert triangle_map(phi, np.stack([1 - s, s], 1)) == pytest.approx(np.einsum("qk,tkc->tqc", B, curve), abs=1e-14)
    good = jacobian_coefficients(phi).min(axis=1) > 1e-3
    assert good.sum() > 120
    ab = random.dirichlet(np.ones(3), good.sum())[:, :2]
    points = np.einsum("qn,qnc->qc", CUBIC.tabulate(ab, 0)[0], phi[good])
    assert np.abs(invert_phi(phi[good], points) - ab).max() < 1e-12


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_certified_triangles_do_not_fold(inner: list[float]) -> None:
    a, b, c, d = inner
    curve = np.array([[(1.0, 0.0), (a, b), (c, d), (0.0, 1.0)]])
    for kind in ("blend", "straight"):
        phi = make_phi(np.zeros((1, 2)), curve, kind)
        if certified(phi)[0]:
            at = np.random.default_rng(0).dirichlet(np.ones(3), 400)[:, :2]
            J = np.einsum("qnd,nc->qcd", CUBIC.tabulate(at, 1)[1], phi[0])
            assert np.linalg.det(J).min() > -1e-8


@pytest.mark.parametrize(("phi", "psi", "order", "largest"), [
    ("blend", "selection", 2, 5e-4), ("straight", "selection", 2, 2e-4), ("straight", "twist", 3, 4e-5),
    ("blend", "correction", 3, 3e-5),
])  # fmt: skip
def test_orders_of_the_triangle_maps(phi: str, psi: str, order: int, largest: float) -> None:
    errors = []
    knots = np.repeat([0.0, 1.0], 4)
    control = spline(11, 1, 0.5).control
    surface = Patch((knots, knots), control)
    at = np.array([(i / 20, j / 20) for i in range(21) for j in range(21 - i)])
    for h in (0.25, 0.125, 0.0625):
        # An ever shorter arc about (1, 1): from pa (right, below) to pb (left, above).
        curve = hermite(lambda t, h=h: 1 + 0.8 * _directions(3.6 + h - 2 * h * t), 1)
        q0 = np.stack([curve[:, 3, 0], curve[:, 0, 1]], axis=1)
        maps = make_phi(q0, curve, phi)  # type: ignore[arg-type]
        far = np.stack([curve[:, 0, 0], curve[:, 3, 1]], axis=1)
        A, dofs = tensor_rows((knots, knots), q0, far)
        S = selection(maps, psi)  # type: ignore[arg-type]
        local = np.einsum("enb,enc->ebc", A @ S, control.reshape(-1, 3)[dofs])
        uv = triangle_map(maps, at)[0]
        apart = np.linalg.norm(triangle_map(local, at)[0] - surface_points(surface, uv), axis=1)
        inside = at.sum(axis=1) < 0.999  # the curve's own points would come from space
        blend = np.einsum("qn,nc->qc", CUBIC.tabulate(at, 0)[0][:, CURVE],
                          _curve_points(surface, curve[0]) - local[0, CURVE])
        apart = np.linalg.norm(triangle_map(local, at)[0] + blend - surface_points(surface, uv), axis=1)[inside]
        errors.append(apart.max())
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert rates.min() > order - 0.25
    assert errors[-1] < largest


def _directions(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _curve_points(surface: Patch, curve: Array) -> Array:
    """Cubic through the surface along a plane cubic, by Hermite interpolation: (4, 3)."""

    def points(t: Array) -> Array:
        B = bernstein(LINE, 3).tabulate(t[:, None], 0)[0]
        return surface_points(surface, B @ curve)

    return hermite(points, 1)[0]


def test_refinement_keeps_the_surface_and_narrows_the_band() -> None:
    hole = replace(shapes.lettered_face(), loops=shapes.lettered_face().loops[1:])
    face = hybrid_face(hole, trim_face(hole, 1e-5))
    fine, kept = refine_hybrid(face), refine_hybrid(face, keep_partition=True)
    assert (face.revised, fine.revised) == (49, 121)
    assert kept.space.n == fine.space.n
    assert len(kept.parts.low) >= len(fine.parts.low)
    errors = [band_error(f) for f in (face, fine, kept)]
    assert errors[1].area < errors[0].area
    assert errors[1].share > errors[0].share
    assert errors[2].largest == pytest.approx(errors[1].largest, rel=1e-12)
    assert jumps(fine) < 1e-11
    assert jumps(kept) < 1e-11
    uv = np.random.default_rng(8).random((50, 2))
    apart = surface_points(refined_surface(face.surface), uv) - surface_points(face.surface, uv)
    assert np.abs(apart).max() < 1e-14


def test_cylinders_become_polynomial_within_tolerance() -> None:
    brep = shapes.bracket()
    face = next(f for f in brep.faces if f.kind == "cylinder")
    made = polynomial_surface(face.surface, 1e-6)
    low, high = (np.array([k[i] for k in face.surface.knots]) for i in (0, -1))
    uv = low + (high - low) * np.random.default_rng(9).random((200, 2))
    apart = np.linalg.norm(surface_points(made, uv) - surface_points(face.surface, uv), axis=1).max()
    assert 0 < apart < 2e-6 * np.linalg.norm(np.ptp(face.surface.control.reshape(-1, 3), axis=0))
    assert made.weights is None


def test_sharp_corners_are_refused() -> None:
    surface = spline(0, 1)
    corners = np.array([(0.2, 0.2), (0.8, 0.3), (0.8, 0.5)])
    loop = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        loop.append(Coedge(-1, False, fit_curve(lambda t, a=a, b=b: a + t[:, None] * (b - a), 1e-9)))
    with pytest.raises(InputError, match="so sharp that no parameter line enters it"):
        hybrid_face(Face(surface, (tuple(loop),), False, "", "wedge"))


def test_halves_are_the_same_curve() -> None:
    control = np.random.default_rng(10).normal(size=(3, 4, 2))
    a, b = halves(control, 0.3)
    t = np.linspace(0, 1, 7)
    B = bernstein(LINE, 3).tabulate(t[:, None], 0)[0]
    whole = bernstein(LINE, 3).tabulate(np.concatenate([0.3 * t, 0.3 + 0.7 * t])[:, None], 0)[0]
    both = np.concatenate([np.einsum("qk,skc->sqc", B, x) for x in (a, b)], axis=1)
    assert both == pytest.approx(np.einsum("qk,skc->sqc", whole, control), abs=1e-14)


def test_cutting_at_knots_leaves_its_input() -> None:
    """A segment that follows a parameter line but for 1e-9 of the range is put on it, in the result alone."""
    s = np.linspace(0.0, 1.0, 4)
    plane = np.stack([np.stack([s, 0.5 + 1e-9 * s], axis=1), np.stack([s[::-1], np.full(4, 0.5)], axis=1)])
    given = Trimming(plane, np.zeros((2, 4, 3)), np.array([1, 0]), np.arange(2), np.zeros(2), np.ones(2))
    before = plane.copy()
    made = cut_at_knots(given, (np.array([0.0, 1.0]), np.array([0.0, 1.0])))
    assert np.array_equal(given.plane, before)
    assert np.ptp(made.plane[..., 1]) == 0.0


def test_segments_without_length_are_refused_by_place() -> None:
    corners = np.array([(0.2, 0.2), (0.8, 0.2), (0.8, 0.2 + 1e-13), (0.8, 0.8), (0.2, 0.8)])
    s = np.linspace(0.0, 1.0, 4)[:, None]
    plane = np.stack([a + s * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0))])
    given = Trimming(plane, np.zeros((5, 4, 3)), np.roll(np.arange(5), -1), np.arange(5), np.zeros(5), np.ones(5))
    knots = (np.repeat([0.0, 1.0], 4), np.repeat([0.0, 1.0], 4))
    with pytest.raises(InputError, match=r"lid: a trimming curve has a segment without length at .* = \(0.8, 0.2\)"):
        make_band(given, knots, where="lid")
