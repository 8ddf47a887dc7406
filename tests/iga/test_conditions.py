"""Dirichlet data by projection and by Nitsche: exactness, joints, components, rates, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from iga.assembly import matrix, vector
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.certificate import certify
from iga.conditions import dirichlet, trace_functions
from iga.conforming import straight_domain
from iga.domain import Domain, Facets, facets_of
from iga.errors import InputError
from iga.field import Field
from iga.integrands import Diffusion, Elasticity, Load, isotropic
from iga.linear.solvers import solve
from iga.nitsche import nitsche
from iga.norms import errors
from tests.meshes import bend, box_complex, mixed_complex
from tests.splines import cube

CELLS3 = [TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID]
A = np.array([[1.0, 0.3, 0.2], [-0.4, 0.9, 0.1], [0.2, -0.6, 0.7]])
STEEL = isotropic(1.2, 0.8)


def spline_cube(n: int, p: int, warp: float = 0.0) -> Domain:
    return cube((p, p, p), (n, n, n), warp)


def bent(cell: Cell, degree: int, n: int = 2) -> Domain:
    mesh, points = box_complex(cell, n)
    flat = straight_domain(mesh, points, degree)
    return Domain(flat.space, bend(flat.points), flat.boundaries)


@pytest.mark.parametrize(("cell", "degree"), [(c, p) for c in CELLS3 for p in (1, 2, 3)])
def test_fields_of_the_space_are_reproduced(cell: Cell, degree: int) -> None:
    domain = bent(cell, degree)
    u = np.random.default_rng(51).normal(size=(domain.space.n, 2))
    unknowns, values = dirichlet(domain, {"boundary": Field(domain.space, u)}, 2)
    assert (np.diff(unknowns) > 0).all()
    assert np.abs(values - u.ravel()[unknowns]).max() < 1e-12 * 10**degree
    linear, values = dirichlet(domain, {"boundary": lambda x: x @ A[0] + 2})
    assert np.abs(values - (domain.points @ A[0] + 2)[linear]).max() < 1e-12
    # All functions but those inside: the boundary ones are those whose control points bound the flat box.
    mesh, points = box_complex(cell, 2)
    flat = straight_domain(mesh, points, degree).points
    outside = np.flatnonzero(((flat < 1e-9) | (flat > 1 - 1e-9)).any(axis=1))
    assert linear.tolist() == outside.tolist()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_only_functions_with_a_trace_are_fixed_on_splines(degree: int) -> None:
    domain = spline_cube(4, degree)
    unknowns, values = dirichlet(domain, {"y1": lambda x: np.sin(x[..., 0])})
    assert unknowns.tolist() == np.flatnonzero(domain.points[:, 1] == 1).tolist()
    exact = lambda x: x[..., 0] ** degree  # noqa: E731
    unknowns, values = dirichlet(domain, {"*": exact})
    assert len(unknowns) == len(trace_functions(domain, facets_of(domain, "*")))
    u = np.zeros(domain.space.n)
    u[unknowns] = values
    K = matrix(domain, Diffusion())
    f = vector(domain, Load(lambda x: -degree * (degree - 1) * x[..., 0] ** max(degree - 2, 0)))
    solution, _ = solve(K, f, (unknowns, values), domain=domain)
    assert errors(domain, solution, exact).relative_l2 < 1e-12


def test_components_joints_and_overlaps() -> None:
    domain = spline_cube(3, 2)
    unknowns, values = dirichlet(domain, {"x0": (0.0, None, 3.0), "x1": (None, 2.0, lambda x: x[..., 1])}, 3)
    at = {axis: np.flatnonzero(domain.points[:, 0] == side) for axis, side in (("x0", 0), ("x1", 1))}
    wanted = np.sort(np.concatenate([at["x0"] * 3, at["x0"] * 3 + 2, at["x1"] * 3 + 1, at["x1"] * 3 + 2]))
    assert unknowns.tolist() == wanted.tolist()
    found = dict(zip(unknowns.tolist(), values.tolist()))
    assert all(abs(found[3 * i + 2] - domain.points[i, 1]) < 1e-12 for i in at["x1"])
    assert all(abs(found[3 * i + 1] - 2) < 1e-12 for i in at["x1"])
    # Later entries hold where boundaries overlap: the pattern first, then the exception.
    unknowns, values = dirichlet(domain, {"*": 0.0, "x1": 1.0})
    inner = np.isin(unknowns, at["x1"]) & (np.abs(domain.points[unknowns, 1:] - 0.5).max(axis=1) < 0.3)
    assert values[inner].min() > 0.6
    values = dirichlet(domain, {"x1": 1.0, "*": 0.0})[1]
    assert np.abs(values).max() < 1e-15
    # Compatible data on both sides of an edge are met exactly by one joint projection.
    unknowns, values = dirichlet(domain, {"x0": lambda x: x[..., 1], "y1": lambda x: 1 + x[..., 0]})
    assert np.abs(values - (domain.points[:, 1] + domain.points[:, 0])[unknowns]).max() < 1e-12


def test_constant_vectors_and_nothing() -> None:
    domain = spline_cube(2, 1)
    vector3 = np.array([1.0, 2, 3])
    for value in (vector3, lambda x: vector3):
        assert np.abs(dirichlet(domain, {"x0": value}, 3)[1].reshape(-1, 3) - vector3).max() < 1e-13
    assert len(dirichlet(domain, {}, 3)[0]) == 0
    assert len(dirichlet(domain, {"x0": (None, None, None)}, 3)[0]) == 0


def test_collapsed_facets_take_the_value_at_their_point() -> None:
    mesh, points = box_complex(HEXAHEDRON, 1)
    domain = straight_domain(mesh, points, 2)
    P = domain.points.copy()
    P[P[:, 0] == 1] = [1, 0.5, 0.5]
    collapsed = Domain(domain.space, P, {"tip": (Facets(0, 1, np.array([0])),), "side": (Facets(0, 4, np.array([0])),)})
    unknowns, values = dirichlet(collapsed, {"tip": lambda x: x @ A[0], "side": lambda x: x @ A[0]})
    assert np.abs(values - (P @ A[0])[unknowns]).max() < 1e-12


def test_bad_data_is_named() -> None:
    domain = spline_cube(2, 1)
    with pytest.raises(InputError, match="no boundary is called 'bore'; there are: x0, x1, y0"):
        dirichlet(domain, {"bore": 0.0})
    empty = Domain(domain.space, domain.points, {"none": (Facets(0, 0, np.zeros(0, dtype=np.int64)),)})
    with pytest.raises(InputError, match="has no facets"):
        dirichlet(empty, {"none": 0.0})
    with pytest.raises(InputError, match="'x0': 2 values for 3 components"):
        dirichlet(domain, {"x0": (0.0, None)}, 3)
    with pytest.raises(InputError, match="'x0': a value of shape"):
        dirichlet(domain, {"x0": np.zeros(2)}, 3)
    with pytest.raises(InputError, match="'x0': the function returns"):
        dirichlet(domain, {"x0": lambda x: np.zeros((*x.shape, 5))}, 3)
    with pytest.raises(InputError, match="not finite"):
        dirichlet(domain, {"x0": lambda x: x[..., 0] * np.nan})
    with pytest.raises(InputError, match="'x0': a weak condition needs a value"):
        nitsche(domain, {"x0": (0.0, None, 0.0)}, Elasticity(STEEL))
    with pytest.raises(InputError, match="vector problem"):
        nitsche(domain, {"x0": 0.0}, Diffusion(), normal=True)


@pytest.mark.parametrize(("cell", "degree"), [(c, p) for c in (TETRAHEDRON, HEXAHEDRON, WEDGE) for p in (1, 2, 3)])
def test_nitsche_passes_the_patch_test(cell: Cell, degree: int) -> None:
    domain = bent(cell, degree, 1 if degree == 3 else 2)
    points = (3 * degree) // 2 + 1
    k = np.array([[2.0, 0.3, 0], [0.3, 1, 0.1], [0, 0.1, 3]])
    for physics, exact, slope in (
        (Diffusion(k), lambda x: x @ A[0] + 2, A[0]), (Elasticity(STEEL), lambda x: x @ A.T + 2, A),
    ):
        N, f = nitsche(domain, {"boundary": exact}, physics, points=points)
        u, _ = solve(matrix(domain, physics, points) + N, f, domain=domain)
        u = u.reshape(-1, 3) if physics.components == 3 else u
        error = errors(domain, u, exact, lambda x, s=slope: np.broadcast_to(s, (*x.shape[:-1], *s.shape)))
        assert error.relative_h1 < 1e-11


def test_nitsche_on_mixed_cells_and_splines() -> None:
    exact = lambda x: x @ A[0] + 2  # noqa: E731
    for domain in (straight_domain(*mixed_complex(), 2), spline_cube(3, 3)):
        N, f = nitsche(domain, dict.fromkeys(domain.boundaries, exact), Diffusion(), points=4)
        u, _ = solve(matrix(domain, Diffusion(), 4) + N, f, domain=domain)
        assert errors(domain, u, exact, lambda x: np.broadcast_to(A[0], x.shape)).relative_h1 < 1e-11


def test_nitsche_takes_conductivities_of_every_kind() -> None:
    """2 everywhere, as a number, a tensor, a function, a function of tensors and a field, is one conductivity."""
    domain = bent(HEXAHEDRON, 2)
    expected = nitsche(domain, {"boundary": 1.0}, Diffusion(2.0))
    for k in (
        2.0 * np.eye(3), lambda x: np.full(x.shape[:-1], 2.0), Field(domain.space, np.full(domain.space.n, 2.0)),
        lambda x: np.broadcast_to(2.0 * np.eye(3), (*x.shape, 3)),
        Field(domain.space, np.tile(2.0 * np.eye(3).ravel(), (domain.space.n, 1))),
    ):
        for found, wanted in zip(nitsche(domain, {"boundary": 1.0}, Diffusion(k)), expected):
            assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_nitsche_where_boundaries_overlap() -> None:
    """Each facet counts once, with the later entry."""
    single = spline_cube(2, 2, 0.1)
    everywhere = facets_of(single, "*")
    double = Domain(single.space, single.points, {**single.boundaries, "all": everywhere})
    exact = lambda x: x @ A[0] + 2  # noqa: E731
    names = dict.fromkeys(single.boundaries, exact)
    expected = nitsche(single, names, Diffusion())
    for data in ({"all": 7.0, **names}, {"x0": 7.0, "all": exact}):
        found = nitsche(double, data, Diffusion())
        assert np.abs((found[0] - expected[0]).toarray()).max() < 1e-12
        assert np.abs(found[1] - expected[1]).max() < 1e-12


def test_nitsche_on_folded_elements() -> None:
    """Linear fields pass where det J changes its sign inside an element at the boundary."""
    domain = spline_cube(2, 2)
    points = domain.points.copy()
    corner = int(np.argmax(points.sum(axis=1)))
    points[corner] -= 0.7
    folded = Domain(domain.space, points, domain.boundaries)
    exact = lambda x: x @ A[0] + 2  # noqa: E731
    N, f = nitsche(folded, {"*": exact}, Diffusion(), points=5)
    u, _ = solve(matrix(folded, Diffusion(), 5) + N, f, solver="direct")
    assert certify(folded).verdict.min() == -1
    assert np.abs(u - exact(points)).max() < 1e-9


def test_normal_condition_lets_a_body_slide() -> None:
    # A quarter-like block between two symmetry planes, pulled: eps = diag(-nu, -nu, 1) without any shear.
    domain = spline_cube(2, 2)
    E, nu = 2.0, 0.3
    D = isotropic(E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu))
    K = matrix(domain, Elasticity(D))
    f = vector(domain, Load(np.array([0, 0, E]), 3), boundary="z1")
    N, g = nitsche(domain, {"[xyz]0": 0.0}, Elasticity(D), normal=True)
    u, _ = solve(K + N, f + g, domain=domain)
    assert np.abs(u.reshape(-1, 3) - domain.points * [-nu, -nu, 1]).max() < 1e-12
    # The same on a curved face: a rigid rotation about its axis costs nothing and nothing else is free.
    K2, g2 = nitsche(domain, {"x1": 0.25}, Elasticity(D), normal=True)
    N0, g0 = nitsche(domain, {"x0": 0.0, "y0": 0.0, "z0": 0.0}, Elasticity(D), normal=True)
    u, _ = solve(K + N0 + K2, g0 + g2, domain=domain)
    assert np.abs(u.reshape(-1, 3) - domain.points * [0.25, -0.25 * nu, -0.25 * nu]).max() < 1e-12


@pytest.mark.parametrize("weak", [False, True])
@pytest.mark.parametrize(("cell", "degree"), [(TETRAHEDRON, 2), (HEXAHEDRON, 2), (WEDGE, 1)])
def test_rates_with_curved_boundaries(cell: Cell, degree: int, weak: bool) -> None:
    exact = lambda x: np.sin(2 * x[..., 0]) * np.cos(x[..., 1]) * np.exp(0.5 * x[..., 2])  # noqa: E731
    found = []
    for n in (2, 4, 8):
        domain = bent(cell, degree, n)
        K = matrix(domain, Diffusion())
        f = vector(domain, Load(lambda x: 4.75 * exact(x)))
        if weak:
            N, g = nitsche(domain, {"boundary": exact}, Diffusion())
            u, _ = solve(K + N, f + g, domain=domain)
        else:
            u, _ = solve(K, f, dirichlet(domain, {"boundary": exact}), domain=domain)
        found.append(errors(domain, u, exact).relative_l2)
    rate = np.log2(found[1] / found[2])
    assert degree + 0.8 < rate < degree + 1.3, found
    assert found[2] < {1: 5e-3, 2: 2e-4}[degree]
