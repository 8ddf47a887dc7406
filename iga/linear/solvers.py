r"""Solution of K u = f with fixed unknowns and constraints: sparse direct or preconditioned conjugate gradients.

With the constraint u = T z of a space the system is T^T K T z = T^T f; fixed entries of z move to the right-hand side.
For conjugate gradients (`iga.linear.krylov`) the rest must be symmetric positive definite, so the body must be held
(`iga.linear.supports`).

Unknown ``i*c + a`` is component a of function i. Axis letters: n unknown, k fixed unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, issparse, kron
from scipy.sparse.csgraph import reverse_cuthill_mckee

from iga.domain import Domain
from iga.errors import InputError
from iga.linear.factorization import checked, estimate, factorize
from iga.linear.krylov import Progress, conjugate_gradients
from iga.linear.layout import Layout, coarse_space, layout_of
from iga.linear.preconditioners import Preconditioner, aggregation, two_level
from iga.linear.products import absolute_product, product
from iga.linear.supports import require_held

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DIRECT_OPERATIONS = 5e10
"""Operations of a factorization up to which ``solver="auto"`` prefers it (about 2 s on two free cores)."""
DIRECT_MEMORY = 3e9
"""Bytes of a factorization up to which ``solver="auto"`` takes it."""
DIRECT_ENTRIES = 60_000_000
"""Matrix entries up to which ``solver="auto"`` asks for the cost of a factorization at all."""
SMALL = 6000
"""Unknowns up to which a factorization needs no question."""


@dataclass(frozen=True)
class SolveLog:
    """How a system was solved.

    Attributes
    ----------
    solver : "direct" or "cg".
    preconditioner : its name, or the factorization's.
    unknowns : unknowns that were solved for.
    iterations : of conjugate gradients, or 1 with the direct solver.
    residual : |f - K u| / |f| over these unknowns, computed from the result; f includes what fixed unknowns contribute.
    setup_s, solve_s : seconds for factorization or preconditioner, and for the solution.
    """

    solver: str
    preconditioner: str
    unknowns: int
    iterations: int
    residual: float
    setup_s: float
    solve_s: float


def solve(
    K: Any,
    f: Array,
    fixed: tuple[Index, Array] | None = None,
    *,
    domain: Domain | None = None,
    constraint: csr_array | None = None,
    solver: str = "auto",
    tolerance: float = 1e-13,
    preconditioner: Callable[[Array], Array] | None = None,
    start: Array | None = None,
    max_iterations: int | None = None,
    progress: Progress | None = None,
) -> tuple[Array, SolveLog]:
    """Solve K u = f.

    Parameters
    ----------
    K : (N, N) sparse, symmetric positive definite once unknowns are fixed (the direct solver also takes others); or any
        operator with ``shape`` and ``@``, which needs ``solver="cg"``.
    f : (N,)
    fixed : numbers (k,) and values (k,) of fixed unknowns. With a constraint they are numbers of free coefficients.
    domain : where the unknowns live. It gives the iterative solver its coarse space and rigid motions, and errors their
        names; its constraint is used if none is given.
    constraint : (n, n_free) matrix T, applied to each component.
    solver : "direct", "cg", or "auto": direct up to about 5e10 operations and 3 GB, predicted from the pattern.
    tolerance : relative residual to reach.
    preconditioner : correction for a residual over the unknowns that are not fixed, in ascending order.
    start : (N,) first guess for conjugate gradients (free coefficients with a constraint).
    max_iterations : of conjugate gradients, 2000 by default.
    progress : called with the iteration and the relative residual.

    Returns
    -------
    u : (N,), fixed values included.
    log : what it took.

    Raises
    ------
    InputError : sizes do not match, something is not finite, or the body is not held (missing motions are named).
    ConvergenceError : the tolerance is not reached; there is no result.
    """
    if solver not in ("auto", "direct", "cg"):
        raise InputError(f"there is no solver {solver!r}; there are: auto, direct, cg")
    f = np.asarray(f, dtype=float)
    if len(K.shape) != 2 or K.shape[0] != K.shape[1] or f.shape != (K.shape[0],):
        raise InputError(f"a matrix {K.shape} and a right-hand side {f.shape} do not fit")
    _require_finite(f, "right-hand side")
    if constraint is None and domain is not None:
        constraint = domain.space.constraint
    T = None
    if constraint is not None:
        components = K.shape[0] // constraint.shape[0]
        T = csr_array(kron(constraint, eye_array(components), format="csr"))
        if T.shape[0] != K.shape[0]:
            raise InputError(f"a constraint {constraint.shape} does not fit {K.shape[0]} unknowns")
        f = T.T @ f
        K = csr_array(T.T @ csr_array(K @ T)) if issparse(K) else _Constrained(K, T)
    held, values = _fixed(fixed, K.shape[0])
    if not issparse(K):
        if solver == "direct":
            raise InputError("the direct solver needs an assembled matrix")
        z, log = _solve_operator(K, f, held, values, tolerance, preconditioner, start, max_iterations, progress)
    else:
        layout = layout_of(domain, constraint, K.shape[0])
        task = _Task(checked(K), f, held, values, layout, tolerance, preconditioner, start, max_iterations, progress)
        z, log = _solve_matrix(task, solver)
    return (z if T is None else T @ z), log


@dataclass(frozen=True, eq=False)
class _Task:
    """An assembled system."""

    K: csr_array
    f: Array
    held: NDArray[np.bool_]
    values: Array
    layout: Layout
    tolerance: float
    preconditioner: Callable[[Array], Array] | None
    start: Array | None
    max_iterations: int | None
    progress: Progress | None


@dataclass(frozen=True, eq=False)
class _Constrained:
    """T^T K T without its entries."""

    K: Any
    T: csr_array

    @property
    def shape(self) -> tuple[int, int]:
        return self.T.shape[1], self.T.shape[1]

    def __matmul__(self, z: Array) -> Array:
        return np.asarray(self.T.T @ (self.K @ (self.T @ z)))


def _fixed(fixed: tuple[Index, Array] | None, n: int) -> tuple[NDArray[np.bool_], Array]:
    held, values = np.zeros(n, dtype=bool), np.zeros(n)
    if fixed is None:
        return held, values
    unknowns, data = np.asarray(fixed[0], dtype=np.int64), np.asarray(fixed[1], dtype=float)
    if unknowns.ndim != 1 or np.broadcast_shapes(unknowns.shape, data.shape) != unknowns.shape:
        raise InputError(f"{unknowns.shape} fixed unknowns do not fit {data.shape} values")
    outside = unknowns[(unknowns < 0) | (unknowns >= n)]
    if len(outside):
        raise InputError(f"fixed unknown {outside[0]} lies outside 0..{n - 1}")
    _require_finite(data, "fixed values")
    held[unknowns], values[unknowns] = True, data
    return held, values


def _require_finite(values: Array, name: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(f"entry {bad[0]} of the {name} is not finite")


def _solve_matrix(task: _Task, solver: str) -> tuple[Array, SolveLog]:
    K, held, values = task.K, task.held, task.values
    began = time.perf_counter()
    f = task.f - product(K, values)
    free = np.flatnonzero(~held)
    if not len(free):
        return values, SolveLog("direct", "none", 0, 0, 0.0, 0.0, 0.0)
    require_held(K, held, task.layout.modes(K.shape[0]), task.layout.components)
    direct = solver == "direct"
    inner = None
    if solver != "cg":
        inner = submatrix(K, free)
        direct = direct or (task.preconditioner is None and prefer_direct(inner))
    if direct:
        assert inner is not None
        factor = factorize(inner)
        ready = time.perf_counter()
        u = values.copy()
        u[free] = factor(f[free])
        residual = _relative(f[free] - product(inner, u[free]), f[free])
        log = SolveLog("direct", factor.name, len(free), 1, residual, ready - began, time.perf_counter() - ready)
        return u, log
    return _solve_cg(task, f, free, inner, began)


def _solve_cg(task: _Task, f: Array, free: Index, inner: csr_array | None, began: float) -> tuple[Array, SolveLog]:
    K, held, layout = task.K, task.held, task.layout
    c = layout.components
    M: Callable[[Array], Array]
    W = layout.prolongation() if task.preconditioner is None else None
    if task.preconditioner is not None or W is not None or c != 3:
        keep, block = free, 1
        if inner is None:
            inner = submatrix(K, free)
    else:
        # Keep whole nodes, so that their 3x3 blocks survive; their fixed unknowns become rows of the identity.
        nodes = np.flatnonzero((~held).reshape(-1, 3).any(axis=1))
        keep, block = (nodes[:, None] * 3 + np.arange(3)).ravel(), 3
        inner = submatrix(K, keep)
        _clear(inner, held[keep])
    name = "given"
    if task.preconditioner is not None:
        M = task.preconditioner
    else:
        modes = layout.modes(K.shape[0])
        modes[held] = 0.0
        if W is not None:
            M = two_level(inner, coarse_space(layout, W, held, modes), layout.elements(held))
        else:
            order = _ordering(inner, block)
            keep = keep[order]
            inner = submatrix(inner, order)
            M = aggregation(inner, modes[keep], block)
        name = M.name
    g = np.where(held[keep], 0.0, f[keep])
    u = np.zeros(len(keep)) if task.start is None else np.where(held[keep], 0.0, np.asarray(task.start)[keep])
    ready = time.perf_counter()
    u, iterations, residual = conjugate_gradients(
        lambda x: product(inner, x), g, M, u, task.tolerance, task.max_iterations, task.progress,
        lambda x: absolute_product(inner, x),
    )
    solution = task.values.copy()
    solution[keep] = np.where(held[keep], solution[keep], u)
    log = SolveLog("cg", name, len(free), iterations, residual, ready - began, time.perf_counter() - ready)
    return solution, log


def preconditioner_for(
    K: csr_array, held: NDArray[np.bool_], domain: Domain | None = None, constraint: csr_array | None = None
) -> Preconditioner:
    """Preconditioner of a matrix on the unknowns that are not held.

    Parameters
    ----------
    K : (k, k) matrix on the free unknowns, in ascending order, sorted.
    held : (N,) which of all unknowns are held.
    domain, constraint : where the unknowns live, as for `solve`.
    """
    layout = layout_of(domain, constraint, len(held))
    modes = layout.modes(len(held))
    W = layout.prolongation()
    if W is None:
        return aggregation(K, modes[~held])
    return two_level(K, coarse_space(layout, W, held, modes), layout.elements(held))


def _solve_operator(
    K: Any, f: Array, held: NDArray[np.bool_], values: Array, tolerance: float,
    preconditioner: Callable[[Array], Array] | None, start: Array | None, max_iterations: int | None,
    progress: Progress | None,
) -> tuple[Array, SolveLog]:
    """Conjugate gradients with an operator that is only known by its products."""
    began = time.perf_counter()
    free = np.flatnonzero(~held)
    g = (f - K @ values)[free] if held.any() else f
    full = np.zeros(K.shape[0])

    def apply(x: Array) -> Array:
        full[free] = x
        return np.asarray(K @ full)[free]

    name, M = getattr(preconditioner, "name", "given"), preconditioner
    if M is None:
        name, M = "none", lambda r: r.copy()
        if hasattr(K, "diagonal"):
            inverse = 1.0 / K.diagonal()[free]
            name, M = "Jacobi", lambda r: inverse * r
    u = np.zeros(len(free)) if start is None else np.asarray(start, dtype=float)[free]
    ready = time.perf_counter()
    u, iterations, residual = conjugate_gradients(apply, g, M, u, tolerance, max_iterations, progress)
    solution = values.copy()
    solution[free] = u
    log = SolveLog("cg", name, len(free), iterations, residual, ready - began, time.perf_counter() - ready)
    return solution, log


def _relative(part: Array, whole: Array) -> float:
    """Length of a part over the length of the whole, or the former if the latter is zero."""
    length = float(np.linalg.norm(whole))
    return float(np.linalg.norm(part)) / (length or 1.0)


def prefer_direct(K: csr_array) -> bool:
    """Whether a factorization is predicted to be affordable in time and memory."""
    if K.shape[0] <= SMALL:
        return True
    if K.nnz > DIRECT_ENTRIES:
        return False
    cost = estimate(K)
    return cost is not None and cost.operations <= DIRECT_OPERATIONS and cost.memory <= DIRECT_MEMORY


def submatrix(K: csr_array, keep: Index) -> csr_array:
    """Rows and columns ``keep`` of a matrix, sorted."""
    if len(keep) == K.shape[0] and (keep == np.arange(len(keep))).all():
        return K
    made = csr_array(K[keep][:, keep])
    made.sort_indices()
    return made


def _clear(K: csr_array, held: NDArray[np.bool_]) -> None:
    """Turn rows and columns of held unknowns into those of the identity, in place."""
    if not held.any():
        return
    rows = np.repeat(np.arange(K.shape[0]), np.diff(K.indptr))
    drop = held[rows] | held[K.indices]
    K.data[drop] = (rows[drop] == K.indices[drop]).astype(float)


def _ordering(K: csr_array, block: int) -> Index:
    """Order of unknowns that keeps neighbours together (reverse Cuthill-McKee on nodes)."""
    if block == 1:
        return np.asarray(reverse_cuthill_mckee(K, symmetric_mode=True), dtype=np.int64)
    nodes = csr_array(K[::block][:, ::block])
    order = np.asarray(reverse_cuthill_mckee(nodes, symmetric_mode=True), dtype=np.int64)
    return (order[:, None] * block + np.arange(block)).ravel()
