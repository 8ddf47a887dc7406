"""Untangling: the energy's gradient, recovery of folded domains of every cell, what stays fixed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from iga import InputError
from iga.bernstein import bernstein, greville
from iga.block import Block, Patterns, dense_extraction
from iga.cells import CELLS, HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE
from iga.certificate import certify, summary
from iga.conforming import number
from iga.descent import descend
from iga.distortion import Batch, evaluate, own_shapes, sample_points, table_at, tables_at
from iga.domain import Domain, Space
from iga.scaled_jacobian import scaled_jacobian
from iga.shaping import shaping, with_samples
from iga.tether import Tether
from iga.untangling import approach, smooth, unfold, untangle
from tests.meshes import box_complex, mixed_complex
from tests.splines import cube

KINDS = [(TETRAHEDRON, (3,)), (WEDGE, (2, 3)), (PYRAMID, (2,)), (HEXAHEDRON, (2, 1, 3))]


def dense(domain):
    """The same domain with dense extraction."""
    block = domain.space.blocks[0]
    C = dense_extraction(block, np.arange(block.elements))
    made = Block(block.basis, block.dofs, Patterns(C, np.arange(block.elements)))
    return replace(domain, space=replace(domain.space, blocks=(made,)))


def rational(domain, seed=5):
    weights = np.random.default_rng(seed).uniform(0.6, 1.4, domain.space.n)
    return replace(domain, space=replace(domain.space, weights=weights))


def bernstein_domain(mesh, points, degree):
    """C0 Bernstein domain on a straight mesh."""
    dofs, n = number(mesh, degree)
    blocks, P = [], np.zeros((n, 3))
    for own, (cell, vertices) in zip(dofs, mesh.parts):
        basis = bernstein(cell, degree)
        P[own] = np.einsum("bv,evc->ebc", bernstein(cell, 1).tabulate(greville(basis), 0)[0], points[vertices])
        blocks.append(Block(basis, own))
    return Domain(Space(tuple(blocks), n), P)


def inside(points):
    """Points inside the unit cube."""
    return ~(np.isclose(points, 0.0) | np.isclose(points, 1.0)).any(axis=1)


def tied(domain, rows, weight):
    """Springs that hold some control points where they are."""
    own = np.flatnonzero(rows)
    pick = csr_array((np.ones(len(own)), (np.arange(len(own)), own)), shape=(len(own), domain.space.n))
    return Tether(pick, domain.points[own], np.zeros((len(own), 3)), np.full(len(own), weight), 1.0)


def disturbed(domain, free, size, seed):
    """Free control points moved at random."""
    points = domain.points.copy()
    points[free] += size * np.random.default_rng(seed).uniform(-1.0, 1.0, (free.sum(), 3))
    return replace(domain, points=points)


def scattered(cell, degree, seed):
    basis = bernstein(cell, degree)
    random = np.random.default_rng(seed)
    points = (greville(basis) + 0.25 * random.uniform(-1.0, 1.0, (4, basis.n, 3))).reshape(-1, 3)
    return Domain(Space((Block(basis, np.arange(len(points)).reshape(4, -1)),), len(points)), points)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("make", [
    *[lambda kind=kind: scattered(*kind, 3) for kind in KINDS], lambda: cube((3, 2, 3), (3, 2, 2)),
    lambda: dense(cube((2, 3, 2), (2, 2, 3))),
])
def test_gradient_is_the_derivative_of_the_energy(make, weighted):
    domain = rational(make()) if weighted else make()
    block, shape = domain.space.blocks[0], own_shapes(domain)[0]
    e, basis = block.elements, domain.space.blocks[0].basis
    random = np.random.default_rng(8)
    own = np.tile(basis.cell.centre, (e, 1)) + random.uniform(-0.05, 0.05, (e, 3))
    tables = [table_at(basis, sample_points(basis.cell, 3), weighted), tables_at(basis, own, weighted)]
    group = np.arange(e) % 2
    batches = [Batch(block, t, 4 if weighted else 3, np.linalg.inv(shape), np.full(e, 0.7), group) for t in tables]
    w = domain.space.weights
    values = domain.points if w is None else np.column_stack([domain.points * w[:, None], w])
    step = np.zeros_like(values)
    step[:, :3] = random.normal(size=(len(values), 3))
    delta = np.array([0.3, 0.2])
    energy, gradient, parts, least = evaluate(batches, values, delta, 2.0, 0.4)
    assert energy == pytest.approx(sum(p.sum() for p in parts), rel=1e-13)
    assert all(len(low) == e for low in least)
    slope = float((gradient * step[:, :3]).sum())
    h = 1e-6
    both = [evaluate(batches, values + s * h * step, delta, 2.0, 0.4)[0] for s in (1, -1)]
    assert (both[0] - both[1]) / (2.0 * h) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("cell", [c for c in CELLS.values() if c.dim == 3])
def test_ideal_elements_have_energy_one(cell):
    shape = own_shapes(scattered(cell, 1, 1))[0][0]
    basis = bernstein(cell, 2)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    points = 3.0 * greville(basis) @ shape.T @ turn.T
    block = Block(basis, np.arange(basis.n)[None])
    batch = Batch(
        block, table_at(basis, sample_points(cell, 4), False), 3, np.linalg.inv(shape)[None], np.ones(1),
        np.zeros(1, dtype=np.int64),
    )
    energy, gradient, _, least = evaluate([batch], points, np.zeros(1), 2.0)
    assert energy == pytest.approx(1.0, abs=1e-12)
    assert least[0][0] == pytest.approx(27.0, rel=1e-12)
    assert np.abs(gradient).max() < 1e-12
    # A folded element has infinite energy without regularisation, a finite one with it.
    mirrored = points * [1.0, 1.0, -1.0]
    assert evaluate([batch], mirrored, np.zeros(1), 2.0)[0] == np.inf
    assert np.isfinite(evaluate([batch], mirrored, np.full(1, 1e-6), 2.0)[0])


def cases():
    for cell, p in ((TETRAHEDRON, 1), (TETRAHEDRON, 3), (WEDGE, 2), (HEXAHEDRON, 2), (PYRAMID, 2)):
        yield f"{cell.name} {p}", bernstein_domain(*box_complex(cell, 3), p), 0.8 / (3 * p)
    yield "splines", cube((3, 3, 3), (4, 4, 4)), 0.3
    yield "dense splines", dense(cube((3, 3, 3), (4, 4, 4))), 0.3
    yield "rational splines", rational(cube((3, 3, 3), (4, 4, 4))), 0.3


@pytest.mark.parametrize(("name", "domain", "size"), list(cases()))
def test_disturbed_domains_recover(name, domain, size):
    free = inside(domain.points)
    given = disturbed(domain, free, size, 1)
    before = summary(certify(given, 1e9))
    assert before["refuted"] >= 3
    found = untangle(given, free)
    after = replace(given, points=found.points)
    assert summary(certify(after))["certified"] == sum(b.elements for b in domain.space.blocks)
    assert len(found.invalid) == 0
    assert found.history[0].invalid == before["refuted"] + before["undecided"]
    assert found.history[-1].invalid == 0
    # What is not free keeps its values bit by bit.
    assert (found.points[~free] == given.points[~free]).all()
    assert free[found.moved].all()
    still = np.setdiff1d(np.arange(domain.space.n), found.moved)
    assert (found.points[still] == given.points[still]).all()


def test_mixed_cells_recover():
    mesh, points = mixed_complex()
    domain = bernstein_domain(mesh, points, 2)
    outer = (np.abs(domain.points - domain.points.min(axis=0)) < 1e-9) | (
        np.abs(domain.points - domain.points.max(axis=0)) < 1e-9)
    free = ~outer.any(axis=1)
    assert free.sum() >= 5
    given = disturbed(domain, free, 0.3, 2)
    assert summary(certify(given, 1e9))["refuted"] >= 2
    found = untangle(given, free)
    assert len(found.invalid) == 0
    assert (found.points[~free] == given.points[~free]).all()


def test_solids_folded_all_over_are_unfolded_at_once():
    domain = cube((3, 3, 3), (4, 4, 4))
    inner = inside(domain.points)
    given = disturbed(domain, inner, 0.5, 1)
    assert summary(certify(given, 1e9))["refuted"] >= 32
    found = unfold(given, np.ones(domain.space.n, dtype=bool), tied(domain, ~inner, 1e4))
    assert len(found.invalid) == 0
    assert (certify(replace(given, points=found.points)).verdict == 1).all()
    assert found.history[-1].invalid == 0
    np.testing.assert_allclose(found.points[~inner], domain.points[~inner], atol=0.02)


@pytest.mark.parametrize(("yielding", "opens"), [(1.0, False), (0.1, True)])
def test_springs_that_hold_a_fold_yield(yielding, opens):
    """A corner of a cube is held inside out, and springs elsewhere are right."""
    domain = cube((2, 2, 2), (3, 3, 3))
    outer = ~inside(domain.points)
    corner = np.linalg.norm(domain.points - 1.0, axis=1).argmin()
    wanted = replace(domain, points=domain.points.copy())
    wanted.points[corner] = 0.3
    found = unfold(wanted, np.ones(domain.space.n, dtype=bool), tied(wanted, outer, 1e5), yielding=yielding)
    assert (len(found.invalid) == 0) == opens
    far = outer & (domain.points.min(axis=1) == 0.0)
    np.testing.assert_allclose(found.points[far], domain.points[far], atol=0.05)


def test_only_the_surroundings_of_folds_move():
    domain = cube((2, 2, 2), (12, 6, 6), 0.0)
    free = inside(domain.points)
    points = domain.points.copy()
    bad = np.flatnonzero(free & (domain.points[:, 0] < 0.2))[20]
    points[bad] += [0.4, 0.0, 0.0]
    found = untangle(replace(domain, points=points), free)
    assert len(found.invalid) == 0
    assert domain.points[found.moved, 0].max() < 0.9
    assert 0 < len(found.moved) < free.sum() / 2


def test_smoothing_improves_and_stays_valid():
    domain = cube((3, 3, 3), (5, 5, 5), 0.3)
    free = inside(domain.points)
    given = disturbed(domain, free, 0.08, 6)
    assert summary(certify(given))["certified"] == 125
    found = smooth(given, free)
    after = replace(given, points=found.points)
    assert summary(certify(after))["certified"] == 125
    old, new = scaled_jacobian(given), scaled_jacobian(after)
    assert new["min"] > old["min"] + 0.1
    assert new["mean"] > 0.97
    assert (found.points[~free] == given.points[~free]).all()


def test_smoothing_leaves_invalid_elements_alone():
    domain = cube((2, 2, 2), (6, 5, 5), 0.0)
    points = domain.points.copy()
    points[np.argmin(np.linalg.norm(points - [0.2, 0.5, 0.5], axis=1))] += [0.5, 0.0, 0.0]
    given = replace(domain, points=points)
    bad = np.flatnonzero(certify(given).verdict <= 0)
    assert len(bad)
    found = smooth(given, inside(domain.points), rounds=1)
    assert found.invalid[:, 1].tolist() == bad.tolist()
    kept = np.unique(domain.space.blocks[0].dofs[bad])
    assert (found.points[kept] == points[kept]).all()


def test_approach_goes_round_invalid_elements():
    """What is broken at the start stays so, near to where the way is cut short for others."""
    domain = cube((2, 2, 2), (6, 5, 5), 0.0)
    points = domain.points.copy()
    points[np.argmin(np.linalg.norm(points - [0.2, 0.5, 0.5], axis=1))] += [0.5, 0.0, 0.0]
    given = replace(domain, points=points)
    bad = np.flatnonzero(certify(given).verdict <= 0)
    wanted = points.copy()
    wanted[np.argmin(np.linalg.norm(points - [0.9, 0.5, 0.5], axis=1))] -= [0.5, 0.0, 0.0]
    assert len(np.flatnonzero(certify(replace(domain, points=wanted)).verdict <= 0)) > len(bad)
    found = approach(given, wanted - points)
    assert np.flatnonzero(certify(replace(domain, points=found.points)).verdict <= 0).tolist() == bad.tolist()
    assert len(found.moved) == 1


def test_constrained_coefficients_move_together():
    domain = cube((2, 2, 2), (4, 4, 4), 0.0)
    free = inside(domain.points)
    a, b = np.flatnonzero(free)[[40, 41]]
    # b is the mean of a and a fixed point.
    keep = np.setdiff1d(np.arange(domain.space.n), [b])
    T = np.zeros((domain.space.n, len(keep)))
    T[keep, np.arange(len(keep))] = 1.0
    T[b, np.searchsorted(keep, [a, 0])] = 0.5
    points = domain.points.copy()
    points[a] += [1.0, 0.0, 0.0]
    points = T @ points[keep]
    space = replace(domain.space, constraint=csr_array(T))
    given = replace(domain, space=space, points=points)
    assert (certify(given).verdict < 0).any()
    free[b] = True
    found = untangle(given, free)
    assert np.abs(found.points - T @ found.points[keep]).max() < 1e-14
    assert a in found.moved
    assert b in found.moved


def test_what_cannot_be_untangled_is_told():
    domain = cube((2, 2, 2), (3, 3, 3), 0.0)
    points = domain.points.copy()
    corner = np.argmin(np.linalg.norm(points, axis=1))
    points[corner] = [0.9, 0.9, 0.9]
    given = replace(domain, points=points)
    found = untangle(given, inside(domain.points), rounds=3)
    assert [0, 0] in found.invalid.tolist()
    assert found.history[-1].invalid == len(found.invalid)
    assert (certify(replace(given, points=found.points)).verdict <= 0).sum() == len(found.invalid)


def test_wrong_arrays_are_refused():
    domain = cube((2, 2, 2), (2, 2, 2))
    with pytest.raises(InputError, match="truth values"):
        untangle(domain, np.ones(3, dtype=bool))
    with pytest.raises(InputError, match="ideal shapes"):
        untangle(domain, np.ones(domain.space.n, dtype=bool), shapes=[np.zeros((2, 3, 3))])


def test_descent_finds_minima_and_respects_walls():
    def rosenbrock(x):
        a, b = x[:-1], x[1:]
        gradient = np.zeros_like(x)
        gradient[:-1] = -400.0 * a * (b - a**2) - 2.0 * (1.0 - a)
        gradient[1:] += 200.0 * (b - a**2)
        return float((100.0 * (b - a**2) ** 2 + (1.0 - a) ** 2).sum()), gradient

    found = descend(rosenbrock, np.full(10, -0.5), 500, tolerance=1e-14)
    assert np.abs(found.x - 1.0).max() < 1e-5

    def wall(x):
        if (x <= 0.0).any():
            return np.inf, np.zeros_like(x)
        return float((1.0 / x + 1e-3 * x).sum()), -1.0 / x**2 + 1e-3

    found = descend(wall, np.full(4, 0.01), 500, reach=50.0, tolerance=1e-12)
    assert found.x == pytest.approx(np.sqrt(1e3), rel=1e-3)


def test_tethered_points_slide_along_their_planes():
    domain = cube((2, 2, 2), (4, 4, 4), 0.0)
    points = domain.points.copy()
    top = np.flatnonzero(np.isclose(points[:, 2], 1.0) & inside(points * [1.0, 1.0, 0.5]))
    points[top] += 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, (len(top), 3)) * [1.0, 1.0, 0.0]
    given = replace(domain, points=points)
    free = inside(domain.points)
    free[top] = True
    A = csr_array((np.ones(len(top)), (np.arange(len(top)), top)), shape=(len(top), domain.space.n))
    normals = np.tile([0.0, 0.0, 1.0], (len(top), 1))
    tether = Tether(A, points[top], normals, np.full(len(top), 1e6))
    found = smooth(given, free, tether=tether)
    assert np.abs(found.points[top, 2] - 1.0).max() < 1e-4
    before, after = (np.abs(p[top, :2] - domain.points[top, :2]).max() for p in (points, found.points))
    assert after < 0.2 * before
    # Held along the planes as well they hardly move.
    found = smooth(given, free, tether=replace(tether, along=1.0))
    assert np.abs(found.points[top] - points[top]).max() < 1e-3


def test_springs_of_each_round_start_from_its_points():
    domain = cube((2, 2, 2), (4, 4, 4), 0.1)
    free = inside(domain.points)
    seen = []

    def springs(points):
        seen.append(points.copy())
        pull = csr_array(np.eye(domain.space.n)[free])
        return Tether(pull, points[free], np.zeros((free.sum(), 3)), np.full(free.sum(), 1e-3), 1.0)

    found = smooth(domain, free, rounds=2, iterations=3, tether=springs, repairs=0)
    assert len(seen) == 2
    assert (seen[0] == domain.points).all()
    assert (seen[1] != domain.points).any()
    assert (certify(replace(domain, points=found.points)).verdict == 1).all()


def test_steps_are_checked():
    domain = cube((2, 2, 2), (2, 2, 2))
    with pytest.raises(InputError, match=r"64 control points cannot take an array \(63, 3\) of steps"):
        approach(domain, domain.points[1:])
    steps = np.zeros_like(domain.points)
    steps[5, 1] = np.nan
    with pytest.raises(InputError, match="control point 5 is to move by"):
        approach(domain, steps)


def test_free_coefficients_take_the_steps_of_constrained_ones():
    domain = cube((2, 2, 2), (4, 4, 4), 0.0)
    inner = 86  # the mean of its neighbours 85 and 87
    T = np.delete(np.eye(domain.space.n), inner, axis=1)
    T[inner, [85, 86]] = 0.5
    free = np.delete(domain.points, inner, axis=0)
    np.testing.assert_allclose(T @ free, domain.points, atol=1e-15)
    given = replace(domain, space=replace(domain.space, constraint=csr_array(T)))
    steps = np.zeros_like(free)
    steps[[40, 85]] = [[0.01, 0.0, 0.0], [-0.02, 0.0, 0.01]]
    found = approach(given, steps)
    np.testing.assert_allclose(found.points, T @ (free + steps), atol=1e-15)


def test_collapsed_elements_have_no_ideal_of_their_own():
    domain = cube((1, 1, 1), (2, 1, 1))
    points = domain.points.copy()
    points[domain.space.blocks[0].dofs[1]] = points[domain.space.blocks[0].dofs[1, 0]]
    with pytest.raises(InputError, match=r"element 1 of block 0 is flat \(1 in all\)"):
        untangle(replace(domain, points=points), np.ones(domain.space.n, dtype=bool))


def test_sample_points_stay_off_the_apex_of_pyramids():
    """There the map has no Jacobian matrix; the point just below the apex stands for it."""
    pyramid, hexahedron = scattered(PYRAMID, 1, 1), scattered(HEXAHEDRON, 1, 1)
    blocks = (*hexahedron.space.blocks, replace(pyramid.space.blocks[0], dofs=pyramid.space.blocks[0].dofs + 32))
    domain = Domain(Space(blocks, 52), np.concatenate([hexahedron.points, pyramid.points]))
    task = shaping(domain, np.ones(52, dtype=bool), None, 3, 2.0)
    elements = np.array([0, 4, 5, 6])
    xi = np.array([[0.5, 0.5, 1.0], [0.3, 0.2, 0.4], [0.3, 0.2, 1.0], [1e-8, 0.0, 1.0 - 1e-8]])
    seen, near = with_samples(task, (elements, xi)).extras[0]
    assert (seen == elements).all()
    np.testing.assert_array_equal(near, [xi[0], xi[1], [0.0, 0.0, 1.0 - 1e-6], [1e-8, 0.0, 1.0 - 1e-6]])
    assert task.extras == ()
    assert with_samples(task, (elements[:0], xi[:0])) is task
