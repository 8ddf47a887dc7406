"""Certificates enclose: against exact verdicts, dense samples, and maps with known determinants."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iga import InputError
from iga.bernstein import bernstein, greville, lagrange_to_bernstein
from iga.block import Block, Kronecker, Patterns, bezier_coefficients
from iga.cells import HEXAHEDRON, PYRAMID, QUADRILATERAL, TETRAHEDRON, WEDGE
from iga.certificate import certify, quality, summary, worst
from iga.chunk import Chunk
from iga.domain import Domain, Space
from tests.meshes import discontinuous

CASES = [
    (TETRAHEDRON, (1,)), (TETRAHEDRON, (3,)), (HEXAHEDRON, (1, 1, 1)), (HEXAHEDRON, (2, 1, 3)), (WEDGE, (2, 1)),
    (WEDGE, (1, 2)), (PYRAMID, (1,)), (PYRAMID, (2,)), (PYRAMID, (3,)),
]


def scattered(cell, degree, elements, noise, seed, spread=None):
    """Elements near the identity, control points moved at random, weights in 1 +- spread."""
    basis = bernstein(cell, degree)
    random = np.random.default_rng(seed)
    points = greville(basis) + noise * random.uniform(-1.0, 1.0, (elements, basis.n, 3))
    weights = None if spread is None else random.uniform(1.0 - spread, 1.0 + spread, elements * basis.n)
    return discontinuous(basis, points, weights)


def mapped(function, degree, weights=None, cell=HEXAHEDRON):
    """One element that interpolates a function of the reference coordinates (exact for polynomials of the degree)."""
    basis = bernstein(cell, degree)
    nodes = greville(basis)
    if cell is PYRAMID:
        nodes = nodes * (1.0 - 1e-9) + 1e-9 * cell.centre
    return discontinuous(basis, (lagrange_to_bernstein(basis, nodes) @ function(nodes))[None], weights)


def lattice(cell, n, random=None):
    """Points of a cell, vertices included (the pyramid's apex by points close to it)."""
    line = np.linspace(0.0, 1.0, n)
    points = np.array(list(product(line, line, line)))
    if cell is TETRAHEDRON:
        return points[points.sum(axis=1) <= 1.0 + 1e-12]
    if cell is WEDGE:
        return points[points[:, 0] + points[:, 1] <= 1.0 + 1e-12]
    if cell is PYRAMID:
        c = np.minimum(points[:, 2], 1.0 - 1e-7)
        return np.column_stack([points[:, 0] * (1 - c), points[:, 1] * (1 - c), c])
    return points


def determinants(domain, elements, points):
    """Det J by the formula, (e, q)."""
    return np.linalg.det(Chunk(domain, 0, np.asarray(elements), points, np.ones(len(points))).J)


@pytest.mark.parametrize(("cell", "degree"), CASES)
def test_identity_has_determinant_one(cell, degree):
    domain = scattered(cell, degree, 3, 0.0, 3)
    made = certify(domain)
    assert (made.verdict == 1).all()
    assert np.abs(made.lower - 1.0).max() < 1e-11
    assert np.abs(made.upper - 1.0).max() < 1e-11
    assert (made.lower <= 1.0).all()
    assert (made.upper >= 1.0).all()


@pytest.mark.parametrize("spread", [None, 0.4])
@pytest.mark.parametrize("noise", [0.07, 0.3])
@pytest.mark.parametrize(("cell", "degree"), CASES)
def test_random_elements_against_samples(cell, degree, noise, spread):
    domain = scattered(cell, degree, 30, noise, 7, spread)
    made = certify(domain, tolerance=0.02)
    sampled = determinants(domain, np.arange(30), lattice(cell, 13)).min(axis=1)
    rounding = 1e-6 if cell is PYRAMID else 1e-10
    assert (sampled >= made.lower - rounding).all()
    assert (sampled[made.verdict == 1] > 0.0).all()
    assert (made.verdict != 0).all()
    assert (made.lower <= made.upper).all()
    # The smallest determinant of the domain is known to the relative gap asked for.
    lower, upper = made.lower.min(), made.upper.min()
    assert upper - lower <= 0.02 * abs(upper) + 1e-9
    assert sampled.min() >= lower - rounding
    witnesses = made.witnesses
    assert sorted(witnesses.element) == np.flatnonzero(made.verdict == -1).tolist()
    for element, xi, det, x in zip(witnesses.element, witnesses.xi, witnesses.det, witnesses.x):
        if cell is PYRAMID and xi[2] > 1.0 - 1e-12:
            continue
        chunk = Chunk(domain, 0, np.array([element]), xi[None], np.ones(1))
        assert np.linalg.det(chunk.J)[0, 0] < 0.0
        assert np.linalg.det(chunk.J)[0, 0] <= det + 1e-12
        assert np.abs(chunk.x[0, 0] - x).max() < 1e-12


@given(
    st.lists(st.integers(-6, 6), min_size=24, max_size=24),
    st.integers(1, 10**6),
)
@settings(max_examples=60, deadline=None)
def test_verdicts_of_trilinear_hexes_are_exact(moves, seed):
    """Integer control points: det J of certified elements is positive at random rational points, exactly."""
    points = 8 * HEXAHEDRON.vertices + np.array(moves).reshape(8, 3)
    made = certify(discontinuous(bernstein(HEXAHEDRON, 1), points[None]))
    random = np.random.default_rng(seed)
    samples = [tuple(Fraction(int(v), 16) for v in row) for row in random.integers(0, 17, (25, 3))]
    samples += [tuple(map(Fraction, corner)) for corner in product((0, 1), repeat=3)]
    samples += [tuple(map(Fraction, xi)) for xi in made.witnesses.xi.tolist()]
    values = []
    for xi in samples:
        columns = []
        for d in range(3):
            column = [Fraction(0)] * 3
            for v, corner in enumerate(HEXAHEDRON.vertices.astype(int).tolist()):
                slope = Fraction(1 if corner[d] else -1)
                for o in range(3):
                    if o != d:
                        slope *= xi[o] if corner[o] else 1 - xi[o]
                column = [c + slope * int(p) for c, p in zip(column, points[v])]
            columns.append(column)
        a, b, c = columns
        values.append(a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                      + a[2] * (b[0] * c[1] - b[1] * c[0]))
    assert min(values) >= Fraction(float(made.lower[0]))
    if made.verdict[0] == 1:
        assert min(values) > 0
    if made.verdict[0] == -1:
        assert values[-1] < 0
        assert values[-1] <= Fraction(float(made.upper[0]))
    else:
        assert min(values) >= 0 or made.verdict[0] == 0


@given(st.integers(1, 10**6), st.sampled_from(CASES), st.floats(0.01, 0.6), st.booleans())
@settings(max_examples=60, deadline=None)
def test_enclosure_holds_for_random_elements(seed, case, noise, rational):
    cell, degree = case
    domain = scattered(cell, degree, 1, noise, seed, 0.5 if rational else None)
    made = certify(domain, max_depth=3)
    sampled = determinants(domain, [0], lattice(cell, 6)).min()
    assert made.lower[0] <= sampled + (1e-5 if cell is PYRAMID else 1e-9)
    assert made.lower[0] <= made.upper[0]


# Known maps ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bend", "verdict"), [(0.3, 1), (-0.45, 1), (-0.5 + 1e-9, 1), (-0.5 - 1e-9, -1), (-0.7, -1)])
def test_quadratic_stretch(bend, verdict):
    """x = r + b r^2: det J = 1 + 2 b r."""
    made = certify(mapped(lambda xi: np.column_stack([xi[:, 0] + bend * xi[:, 0] ** 2, xi[:, 1:]]), (2, 1, 1)))
    least = min(1.0, 1.0 + 2.0 * bend)
    assert made.verdict[0] == verdict
    assert made.lower[0] <= least <= made.upper[0]
    assert made.upper[0] - made.lower[0] < 1e-12
    if verdict < 0:
        assert made.witnesses.xi[0, 0] == 1.0


@pytest.mark.parametrize("root", [0.5, 1.0 / 3.0])
@pytest.mark.parametrize("margin", [1e-6, -1e-6])
def test_folded_by_a_hair_inside(root, margin):
    """det J = (r - root)^2 + margin: the sign is decided at an inner point, also where no bisection hits the root."""

    def function(xi):
        r = xi[:, 0]
        return np.column_stack([r**3 / 3 - root * r**2 + (root**2 + margin) * r, xi[:, 1:]])

    made = certify(mapped(function, (3, 1, 1)), max_depth=14)
    assert made.verdict[0] == np.sign(margin)
    assert made.lower[0] <= margin <= made.upper[0]
    if margin < 0:
        xi = made.witnesses.xi[0]
        assert (xi[0] - root) ** 2 + margin < 0
        assert made.witnesses.det[0] == pytest.approx((xi[0] - root) ** 2 + margin, abs=1e-12)


def test_touching_zero_inside_is_undecided():
    made = certify(mapped(lambda xi: np.column_stack([xi[:, 0] ** 3 / 3 - xi[:, 0] ** 2 / 2 + xi[:, 0] / 4, xi[:, 1:]]),
                          (3, 1, 1)))
    assert made.verdict[0] == 0
    assert abs(made.lower[0]) < 1e-13
    assert abs(made.upper[0]) < 1e-13


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_collapsed_hexes_are_undecided_with_bound_zero(degree):
    """A tetrahedron as one hex, u = r, v = (1-r) s, w = (1-r)(1-s) t: det J = 0 on the collapsed faces."""
    random = np.random.default_rng(13)
    tet = bernstein(TETRAHEDRON, degree)
    hexahedron = bernstein(HEXAHEDRON, degree)
    control = greville(tet) + (0.0 if degree == 1 else 0.05) * random.standard_normal((20, tet.n, 3)) + [0.3, 0.7, 0.1]
    nodes = greville(hexahedron)
    r, s, t = nodes.T
    inside = np.column_stack([r, (1 - r) * s, (1 - r) * (1 - s) * t])
    M = lagrange_to_bernstein(hexahedron, nodes) @ tet.tabulate(inside, 0)[0]
    made = certify(discontinuous(hexahedron, np.einsum("hb,ebc->ehc", M, control)))
    assert (made.verdict == 0).all()
    assert np.abs(made.lower).max() < 1e-12
    assert np.abs(made.upper).max() < 1e-12
    assert made.degenerate.all()
    assert summary(made)["degenerate"] == 20
    assert summary(made)["undecided"] == 0
    # The tetrahedra themselves are valid.
    assert (certify(discontinuous(tet, control)).verdict == 1).all()


def test_pyramid_folded_at_the_apex_only():
    """An apex pulled below the last layer turns the pyramid over near the apex and nowhere else."""
    basis = bernstein(PYRAMID, 2)
    points = greville(basis).copy()
    points[-1] = [0.0, 0.0, 0.45]
    domain = discontinuous(basis, points[None])
    made = certify(domain)
    below = lattice(PYRAMID, 21)
    assert determinants(domain, [0], below[below[:, 2] < 0.9]).min() > 0.0
    assert made.verdict[0] == -1
    assert made.witnesses.xi[0].tolist() == [0.0, 0.0, 1.0]
    assert made.lower[0] == pytest.approx(-0.1, abs=1e-12)
    points[-1, 2] = 0.55
    assert certify(discontinuous(basis, points[None])).verdict[0] == 1


def test_apex_limits_are_enclosed():
    """Near the apex det J depends on the direction; the bounds hold for all of them."""
    domain = scattered(PYRAMID, (3,), 40, 0.1, 17)
    made = certify(domain, tolerance=0.01)
    random = np.random.default_rng(19)
    ab = random.uniform(0.0, 1.0, (200, 2))
    for gap in (1e-2, 1e-4, 1e-6):
        points = np.column_stack([ab * gap, np.full(200, 1.0 - gap)])
        assert (determinants(domain, np.arange(40), points).min(axis=1) >= made.lower - 1e-7).all()


# Extraction, blocks, options -----------------------------------------------------------------------------------------


def spline_domain(kind):
    """Eight quadratic elements of the C1 spline on [0, 1] with knot 1/2 per direction, x shifted by a smooth bump."""
    left = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.5]])
    right = np.array([[0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    factor = np.stack([left, right])
    pattern = np.array(list(product((0, 1), repeat=3)))
    grid = np.arange(64).reshape(4, 4, 4)
    dofs = np.stack([grid[i : i + 3, j : j + 3, k : k + 3].ravel() for i, j, k in pattern])
    nodes = np.array([0.0, 0.25, 0.75, 1.0])
    points = np.array(list(product(nodes, nodes, nodes)))
    points += 0.08 * np.random.default_rng(23).standard_normal(points.shape)
    extraction = Kronecker((factor, factor, factor), pattern)
    if kind == "patterns":
        dense = np.stack([np.kron(np.kron(factor[i], factor[j]), factor[k]) for i, j, k in pattern])
        extraction = Patterns(dense, np.arange(8))
    return Domain(Space((Block(bernstein(HEXAHEDRON, 2), dofs, extraction),), 64), points)


@pytest.mark.parametrize("kind", ["kronecker", "patterns"])
def test_extraction_is_folded_in(kind):
    domain = spline_domain(kind)
    block = domain.space.blocks[0]
    bezier = discontinuous(block.basis, bezier_coefficients(block, domain.points))
    a, b = certify(domain), certify(bezier)
    assert (a.verdict == b.verdict).all()
    assert np.abs(a.upper - b.upper).max() < 1e-12
    sampled = determinants(domain, np.arange(8), lattice(HEXAHEDRON, 9)).min(axis=1)
    assert (sampled >= a.lower - 1e-13).all()


def test_blocks_of_all_cells_and_the_order_of_elements():
    domains = [scattered(cell, degree, 5, 0.02, 29) for cell, degree in CASES]
    blocks, points, start = [], [], 0
    for d in domains:
        blocks.append(Block(d.space.blocks[0].basis, d.space.blocks[0].dofs + start))
        points.append(d.points)
        start += len(d.points)
    domain = Domain(Space(tuple(blocks), start), np.concatenate(points))
    made = certify(domain)
    assert made.offsets.tolist() == list(range(0, 5 * len(CASES) + 1, 5))
    lone = np.concatenate([certify(d, max_depth=0).upper for d in domains])
    assert (made.upper <= lone + 1e-15).all()
    answer = quality(domain)
    assert set(answer) == {
        "certified", "refuted", "undecided", "degenerate", "min_det_lower", "min_det_upper", "folds", "scaled_jacobian",
    }
    assert set(answer["scaled_jacobian"]) == {
        "min", "mean", "share_below_half", "cells_negative_gauss", "cells_negative_centre",
    }
    assert answer["certified"] == 5 * len(CASES)
    first = worst(made, 3)
    assert [row["lower"] for row in first] == np.sort(made.lower)[:3].tolist()
    assert first[0]["block"] * 5 + first[0]["element"] == made.lower.argmin()


def test_equal_weights_are_no_weights():
    plain = scattered(HEXAHEDRON, (2, 2, 2), 6, 0.05, 31)
    same = Domain(Space(plain.space.blocks, plain.space.n, np.full(plain.space.n, 2.5)), plain.points)
    assert (certify(plain).lower == certify(same).lower).all()


def test_far_from_the_origin():
    """The bounds know that coordinates of size 1e6 leave 1e-10 of a unit element."""
    domain = scattered(HEXAHEDRON, (2, 2, 2), 6, 0.05, 37)
    far = Domain(domain.space, domain.points + 1e6)
    a, b = certify(domain), certify(far)
    assert (a.verdict == b.verdict).all()
    assert 1e-9 < np.abs(a.lower - b.lower).max() < 1e-5
    assert (b.lower <= a.upper).all()


def test_flipped_elements_are_refuted_everywhere():
    domain = scattered(TETRAHEDRON, (2,), 4, 0.01, 41)
    flipped = Domain(domain.space, domain.points * [1.0, 1.0, -1.0])
    made = certify(flipped)
    assert (made.verdict == -1).all()
    assert len(made.witnesses.det) == 4
    assert summary(made)["refuted"] == 4


def test_no_elements():
    empty = Domain(Space((Block(bernstein(HEXAHEDRON, 1), np.empty((0, 8), dtype=np.int64)),), 0), np.empty((0, 3)))
    answer = quality(empty)
    assert answer["certified"] == 0
    assert answer["min_det_lower"] is None


def test_not_finite_is_undecided():
    domain = scattered(HEXAHEDRON, (1, 1, 1), 3, 0.0, 43)
    points = domain.points.copy()
    points[9] = np.nan
    made = certify(Domain(domain.space, points))
    assert made.verdict[1] == 0
    assert made.lower[1] == -np.inf
    assert not made.degenerate.any()


def test_bad_requests():
    domain = scattered(HEXAHEDRON, (1, 1, 1), 1, 0.0, 47)
    for options in ({"tolerance": 0.0}, {"max_depth": -1}, {"budget": 0}):
        with pytest.raises(InputError, match="certify needs"):
            certify(domain, **options)
    flat = bernstein(QUADRILATERAL, 1)
    surface = Domain(Space((Block(flat, np.arange(4)[None]),), 4), np.zeros((4, 3)))
    with pytest.raises(InputError, match="quadrilateral"):
        certify(surface)


# Scaled Jacobian -----------------------------------------------------------------------------------------------------
