"""Solving: both solvers against each other and the patch test, iteration counts over p and h, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import block_diag, csr_array
from scipy.sparse.linalg import LinearOperator

from iga.assembly import matrix, vector
from iga.bernstein import bernstein
from iga.block import Block
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conditions import dirichlet, trace_functions
from iga.conforming import Complex, straight_domain
from iga.domain import Domain, Facets, Space
from iga.errors import ConvergenceError, InputError
from iga.integrands import Diffusion, Elasticity, Load, Mass, isotropic
from iga.linear import factorization
from iga.linear.aggregates import aggregated, aggregates
from iga.linear.coarse_space import linear_prolongation, rigid_motions
from iga.linear.factorization import factorize
from iga.linear.solvers import solve
from iga.norms import errors
from tests.meshes import bend, box_complex, mixed_complex
from tests.splines import cube

A = np.array([[1.0, 0.3, 0.2], [-0.4, 0.9, 0.1], [0.2, -0.6, 0.7]])
STEEL = isotropic(1.2, 0.8)


def spline_cube(n: int, p: int, warp: float = 0.0) -> Domain:
    return cube((p, p, p), (n, n, n), warp)


def bent(cell: Cell, degree: int, n: int) -> Domain:
    mesh, points = box_complex(cell, n)
    flat = straight_domain(mesh, points, degree)
    return Domain(flat.space, bend(flat.points), flat.boundaries)


def relative_h1(domain: Domain, u: np.ndarray) -> float:
    if len(u) == domain.space.n:
        return errors(domain, u, lambda x: x @ A[0] + 2, lambda x: np.broadcast_to(A[0], x.shape)).relative_h1
    exact = lambda x: x @ A.T + 2  # noqa: E731
    return errors(domain, u.reshape(-1, 3), exact, lambda x: np.broadcast_to(A, (*x.shape, 3))).relative_h1


def patch(domain: Domain, elastic: bool, solver: str, points: int | None) -> tuple[float, int]:
    """Relative H1 error for a linear exact solution, and iterations."""
    K = matrix(domain, Elasticity(STEEL) if elastic else Diffusion(1.3), points)
    data = (lambda x: x @ A.T + 2) if elastic else (lambda x: x @ A[0] + 2)
    fixed = dirichlet(domain, dict.fromkeys(domain.boundaries, data), 3 if elastic else 1, points)
    u, log = solve(K, np.zeros(K.shape[0]), fixed, domain=domain, solver=solver)
    assert log.residual < 1e-12
    return relative_h1(domain, u), log.iterations


@pytest.mark.parametrize("solver", ["direct", "cg"])
@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize(("cell", "degree"), [(c, p) for c in (TETRAHEDRON, HEXAHEDRON, WEDGE) for p in (1, 2, 3, 4)])
def test_patch_test_on_curved_cells(cell: Cell, degree: int, elastic: bool, solver: str) -> None:
    domain = bent(cell, degree, 2 if degree < 3 else 1)
    error, _ = patch(domain, elastic, solver, (3 * degree) // 2 + 1)
    assert error < 1e-11


@pytest.mark.parametrize("solver", ["direct", "cg"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_patch_test_on_mixed_cells_and_pyramids(degree: int, solver: str) -> None:
    mesh, points = mixed_complex()
    assert patch(straight_domain(mesh, points, degree), True, solver, degree + 2)[0] < 1e-11
    mesh, points = box_complex(PYRAMID, 2)
    assert patch(straight_domain(mesh, points, degree), False, solver, degree + 2)[0] < 1e-11


@pytest.mark.parametrize("solver", ["direct", "cg"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_patch_test_on_splines(degree: int, solver: str) -> None:
    assert patch(spline_cube(4, degree), False, solver, None)[0] < 1e-11


# Iterations to 1e-10 with one face held and a load inside, for degrees 1 to 4: measured counts plus a quarter.
CAPS = {
    (TETRAHEDRON, False): (28, 38, 40, 42),
    (HEXAHEDRON, False): (16, 34, 34, 38),
    (WEDGE, False): (20, 34, 36, 38),
    (PYRAMID, False): (20, 38, 42, 46),
    (TETRAHEDRON, True): (28, 58, 63, 65),
    (HEXAHEDRON, True): (22, 40, 42, 46),
}


@pytest.mark.parametrize(("cell", "elastic"), CAPS)
def test_iterations_are_flat_in_size_and_degree(cell: Cell, elastic: bool) -> None:
    for degree, sizes in enumerate([(4, 8), (2, 4), (2, 3), (1, 2)], start=1):
        for n in sizes:
            domain = bent(cell, degree, n)
            left = np.flatnonzero(straight_domain(*box_complex(cell, n), degree).points[:, 0] == 0)
            u, iterations = loaded(domain, left, elastic, "cg")
            assert iterations <= CAPS[cell, elastic][degree - 1], (degree, n)
        direct, _ = loaded(domain, left, elastic, "direct")
        assert np.abs(u - direct).max() < 1e-8 * np.abs(direct).max()


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_iterations_on_splines(degree: int) -> None:
    for n in (4, 8 if degree < 4 else 6):
        domain = spline_cube(n, degree, 0.3)
        left = trace_functions(domain, domain.boundaries["x0"])
        assert loaded(domain, left, False, "cg")[1] <= {2: 40, 3: 55, 4: 80}[degree]


def test_coarse_space_of_splines_is_small_and_holds_the_modes() -> None:
    """Every unknown is in one aggregate; rigid motions lie in the coarse space; it has few functions."""
    domain = spline_cube(8, 3, 0.3)
    dofs = np.concatenate([block.dofs for block in domain.space.blocks])
    label, count = aggregates(domain.space.n, [dofs])
    assert label.min() == 0
    assert label.max() == count - 1 < domain.space.n / 20
    modes = rigid_motions(domain.points)
    P = aggregated(modes, [(dofs[:, :, None] * 3 + np.arange(3)).reshape(len(dofs), -1)])
    assert P.shape == (3 * domain.space.n, 6 * count)
    np.testing.assert_allclose((P.T @ P).toarray(), np.eye(6 * count), atol=1e-9)
    np.testing.assert_allclose(P @ (P.T @ modes), modes, atol=1e-9)


def test_sums_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boundary matrices do not depend on how many terms are summed at a time."""
    domain = spline_cube(3, 2, 0.3)
    whole = matrix(domain, Mass(), boundary="*").toarray()
    monkeypatch.setattr("iga.assembly._TERMS", 1000)
    np.testing.assert_allclose(matrix(domain, Mass(), boundary="*").toarray(), whole, atol=1e-15)


def loaded(domain: Domain, left: np.ndarray, elastic: bool, solver: str) -> tuple[np.ndarray, int]:
    """Displacement or temperature under a constant load with some functions held, and iterations."""
    c = 3 if elastic else 1
    K = matrix(domain, Elasticity(STEEL) if elastic else Diffusion())
    f = vector(domain, Load(np.array([1.0, 2, -1]), 3) if elastic else Load(1.0))
    fixed = (left[:, None] * c + np.arange(c)).ravel()
    u, log = solve(K, f, (fixed, np.zeros(len(fixed))), domain=domain, solver=solver, tolerance=1e-10)
    return u, log.iterations


def test_prolongation_reproduces_linear_functions() -> None:
    mesh, points = mixed_complex()
    for degree in (2, 3, 4):
        domain = straight_domain(mesh, points, degree)
        W = linear_prolongation(domain.space)
        assert W is not None
        assert W.shape == (domain.space.n, len(points))
        assert np.abs(np.asarray(W.sum(axis=1)).ravel() - 1).max() < 1e-14
        vertices = np.linalg.lstsq(W.toarray(), domain.points, rcond=None)[0]
        assert np.abs(W @ vertices - domain.points).max() < 1e-12
    assert linear_prolongation(straight_domain(mesh, points, 1).space) is None


def test_prolongation_of_splines_keeps_constants_and_ends() -> None:
    domain = spline_cube(4, 3)
    W = linear_prolongation(domain.space)
    assert W is not None
    assert W.shape == (7**3, 5**3)
    assert np.abs(np.asarray(W.sum(axis=1)).ravel() - 1).max() < 1e-13
    assert W.data.min() > 0
    assert np.diff(W.indptr)[[0, -1]].tolist() == [1, 1]


def hanging() -> tuple[Domain, csr_array]:
    """One box beside eight, glued by a constraint: nodes of the small ones hang on the face of the large one."""
    mesh, points = box_complex(HEXAHEDRON, 2)
    small = mesh.parts[0][1]
    large, corners = box_complex(HEXAHEDRON, 1)
    both = Complex(((HEXAHEDRON, large.parts[0][1]), (HEXAHEDRON, small + 8)))
    place = np.vstack([corners, points + np.array([1, 0, 0])])
    dofs = (both.parts[0][1], both.parts[1][1])
    T = np.eye(len(place))
    slaves = np.flatnonzero((np.arange(len(place)) >= 8) & (np.abs(place[:, 0] - 1) < 1e-12))
    for s in slaves:
        T[s] = 0
        for m in range(4, 8):
            T[s, m] = np.prod(1 - np.abs(place[s, 1:] - place[m, 1:]))
    T = np.delete(T, slaves, axis=1)
    blocks = tuple(Block(bernstein(HEXAHEDRON, 1), d) for d in dofs)
    last = {2: [0, 1, 4, 5], 3: [2, 3, 6, 7], 4: [0, 2, 4, 6], 5: [1, 3, 5, 7], 1: [4, 5, 6, 7]}
    outside = (Facets(0, 0, np.array([0])), *(Facets(0, k, np.array([0])) for k in range(2, 6)),
               *(Facets(1, k, np.array(e)) for k, e in last.items()))
    return Domain(Space(blocks, len(place), constraint=csr_array(T)), place, {"outside": outside}), csr_array(T)


@pytest.mark.parametrize("solver", ["direct", "cg"])
@pytest.mark.parametrize("elastic", [False, True])
def test_hanging_nodes_pass_the_patch_test(elastic: bool, solver: str) -> None:
    domain, T = hanging()
    error, _ = patch(domain, elastic, solver, None)
    assert error < 1e-11
    K, f = matrix(domain, Diffusion()), vector(domain, Load(1.0))
    fixed = dirichlet(domain, {"outside": 0.0})
    u, log = solve(K, f, fixed, domain=domain)
    assert log.unknowns == T.shape[1] - len(fixed[0])
    free = np.setdiff1d(np.arange(T.shape[1]), fixed[0])
    assert np.abs((T.T @ (f - K @ u))[free]).max() < 1e-14


def test_operators_and_given_preconditioners() -> None:
    domain = spline_cube(5, 2)
    K, f = matrix(domain, Diffusion()), vector(domain, Load(1.0))
    fixed = dirichlet(domain, {"x0": 0.0, "x1": 1.0})
    u, log = solve(K, f, fixed, domain=domain, solver="direct")
    assert log.solver == "direct"
    operator = LinearOperator(K.shape, matvec=lambda x: K @ x, dtype=float)
    v, log = solve(operator, f, fixed)
    assert log.preconditioner == "none"
    assert np.abs(u - v).max() < 1e-11
    inverse = 1 / np.delete(K.diagonal(), fixed[0])
    w, log = solve(K, f, fixed, preconditioner=lambda r: inverse * r)
    assert (log.solver, log.preconditioner) == ("cg", "given")
    assert np.abs(u - w).max() < 1e-11
    again, log = solve(K, f, fixed, solver="cg", start=u)
    assert log.iterations <= 2
    assert np.abs(u - again).max() < 1e-11
    with pytest.raises(InputError, match="assembled"):
        solve(operator, f, fixed, solver="direct")


def test_large_system_goes_to_conjugate_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("iga.linear.solvers.SMALL", 10)
    monkeypatch.setattr("iga.linear.solvers.DIRECT_OPERATIONS", 1e4)
    domain = bent(HEXAHEDRON, 1, 9)
    K, f = matrix(domain, Diffusion()), vector(domain, Load(1.0))
    u, log = solve(K, f, dirichlet(domain, {"boundary": 0.0}), domain=domain)
    assert (log.solver, log.preconditioner) == ("cg", "smoothed aggregation")
    monkeypatch.setattr("iga.linear.solvers.DIRECT_OPERATIONS", 1e12)
    v, log = solve(K, f, dirichlet(domain, {"boundary": 0.0}), domain=domain)
    assert log.solver == "direct"
    assert np.abs(u - v).max() < 1e-11


def test_no_convergence_is_an_error() -> None:
    domain = bent(TETRAHEDRON, 3, 2)
    K, f = matrix(domain, Diffusion()), vector(domain, Load(1.0))
    fixed = dirichlet(domain, {"boundary": 0.0})
    with pytest.raises(ConvergenceError, match="after 3 iterations"):
        solve(K, f, fixed, domain=domain, solver="cg", max_iterations=3)
    with pytest.raises(ConvergenceError, match="not positive definite"):
        solve(K, f, fixed, solver="cg", preconditioner=lambda r: -r)
    seen: list[int] = []
    _, log = solve(K, f, fixed, domain=domain, solver="cg", progress=lambda i, r: seen.append(i))
    assert seen == list(range(1, log.iterations + 1))


def test_round_off_is_not_mistaken_for_failure() -> None:
    # Coefficients over fourteen orders of magnitude: no residual of 1e-13 |f| exists in double precision.
    domain = spline_cube(6, 2)
    K = matrix(domain, Diffusion(lambda x: 10.0 ** (14 * (x[..., 0] > 0.5))))
    fixed = dirichlet(domain, {"x0": 0.0, "y0": 1.0})
    for solver in ("direct", "cg"):
        u, log = solve(K, vector(domain, Load(1.0)), fixed, domain=domain, solver=solver)
        assert np.isfinite(u).all()
        assert log.residual < 1e-6


@pytest.mark.parametrize("pair", [[[2.0]], [[2.0, -1.0], [-1.0, 2.0]]])
def test_unknowns_that_are_hardly_coupled_are_solved(pair: list[list[float]]) -> None:
    """Nothing is left to aggregate: the next coarser matrix would be zero."""
    K = csr_array(block_diag([np.array(pair)] * 400))
    f = np.random.default_rng(61).normal(size=K.shape[0])
    u, log = solve(K, f, solver="cg")
    assert log.preconditioner == "smoothed aggregation"
    assert np.abs(K @ u - f).max() < 1e-11


def test_bad_input_is_named() -> None:
    domain = bent(HEXAHEDRON, 1, 2)
    K = matrix(domain, Diffusion())
    f = np.ones(27)
    with pytest.raises(InputError, match="no solver 'magic'"):
        solve(K, f, solver="magic")
    with pytest.raises(InputError, match="do not fit"):
        solve(K, f[1:])
    with pytest.raises(InputError, match="entry 3 of the right-hand side"):
        solve(K, np.where(np.arange(27) == 3, np.nan, f))
    with pytest.raises(InputError, match="entry 0 of the fixed"):
        solve(K, f, (np.array([1]), np.array([np.inf])))
    for unknown in (-1, 27):
        with pytest.raises(InputError, match=rf"fixed unknown {unknown} lies outside 0\.\.26"):
            solve(K, f, (np.array([3, unknown]), np.zeros(2)))
    bad = K.copy()
    bad.data[4] = np.nan
    with pytest.raises(InputError, match=rf"matrix entry \(0, {bad.indices[4]}\)"):
        solve(bad, f)
    with pytest.raises(InputError, match="row 2 of the matrix is empty"):
        factorize(csr_array(np.diag([1.0, 1, 0, 1])))


@pytest.mark.parametrize("solver", ["direct", "cg"])
def test_a_floating_body_names_its_motions(solver: str) -> None:
    domain = straight_domain(*box_complex(HEXAHEDRON, 2))
    K = matrix(domain, Elasticity(STEEL))
    f = np.zeros(K.shape[0])
    with pytest.raises(InputError, match=r"translation along x, .*rotation about z"):
        solve(K, f, domain=domain, solver=solver)
    # Only the normal displacement of the face z = 0 is held: it slides along x and y and turns about z.
    low = np.flatnonzero(domain.points[:, 2] == 0) * 3 + 2
    with pytest.raises(InputError) as caught:
        solve(K, f, (low, np.zeros(len(low))), domain=domain, solver=solver)
    assert str(caught.value).count("translation along x, translation along y, rotation about z") == 1
    with pytest.raises(InputError, match="level is free"):
        solve(matrix(domain, Diffusion()), np.ones(27), domain=domain, solver=solver)


def test_a_loose_part_is_named() -> None:
    mesh, points = box_complex(HEXAHEDRON, 1)
    two = Complex(((HEXAHEDRON, np.vstack([mesh.parts[0][1], mesh.parts[0][1] + 8])),))
    domain = straight_domain(two, np.vstack([points, points + np.array([3, 0, 0])]))
    K = matrix(domain, Diffusion())
    with pytest.raises(InputError, match="part 1 of 2"):
        solve(K, np.ones(16), (np.arange(4), np.zeros(4)), domain=domain)


@pytest.mark.parametrize("present", [True, False])
def test_factors_serve_many_right_hand_sides(present: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not present:
        monkeypatch.setattr(factorization, "rslab", None)
    rng = np.random.default_rng(41)
    n = 60
    sparse = csr_array(np.where(rng.random((n, n)) < 0.1, rng.normal(size=(n, n)), 0.0))
    K = sparse @ sparse.T + csr_array(np.eye(n))
    factor = factorize(K)
    assert factor.name == ("LDLt" if present else "LU")
    F = rng.normal(size=(n, 5))
    assert np.abs(K @ factor(F) - F).max() < 1e-12
    assert np.abs(factor(F)[:, 2] - factor(F[:, 2])).max() < 1e-12
    unsymmetric = factorize(sparse + 3 * csr_array(np.eye(n)))
    assert unsymmetric.name == "LU"
    assert np.abs((sparse @ unsymmetric(F[:, 0]) + 3 * unsymmetric(F[:, 0])) - F[:, 0]).max() < 1e-11
    with pytest.raises(InputError, match="singular"):
        factorize(csr_array(np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])))
    with pytest.raises(InputError, match="length 3"):
        factor(np.ones(3))
