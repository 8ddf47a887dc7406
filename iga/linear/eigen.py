r"""Lowest eigenpairs of K u = lambda M u: modes of vibration and of decay.

Fixed unknowns are left out. Problems of a few unknowns are solved by dense matrices; small and medium ones by Lanczos
iteration on (K - s M)^-1 M with a factored matrix, where the shift s is slightly negative, so that K may be singular (a
body that is not held has its rigid motions as modes of eigenvalue zero). Where the factorization would be too large,
LOBPCG (Knyazev 2001, doi:10.1137/S1064827500366124) runs with the preconditioner of `iga.linear.solvers`. Every pair is
judged by its residual

    |K u - lambda M u| <= tol | |K| |u| + |lambda| |M| |u| |,

and with a factorization the number of eigenvalues below the last is counted from the signs of the pivots of
K - mu M = L D L^T (Sylvester), so that none is missed.

Axis letters: n unknown, m mode.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array, eye_array, kron
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, lobpcg

from iga.domain import Domain
from iga.errors import ConvergenceError, InputError
from iga.linear.factorization import Factor, checked, factorize
from iga.linear.products import absolute_product, product
from iga.linear.solvers import preconditioner_for, prefer_direct, submatrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DENSE = 40
"""Unknowns up to which eigenpairs are found by dense matrices: the iterations need more than they look for."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Lowest eigenpairs.

    Attributes
    ----------
    values : (m,) ascending eigenvalues.
    vectors : (N, m) modes, orthonormal in M, zero at fixed unknowns.
    residuals : (m,) relative residuals.
    solver : "dense", "lanczos" or "lobpcg".
    """

    values: Array
    vectors: Array
    residuals: Array
    solver: str


def eigenpairs(
    K: Any,
    M: Any,
    count: int = 6,
    fixed: Index | None = None,
    *,
    domain: Domain | None = None,
    constraint: csr_array | None = None,
    solver: str = "auto",
    tolerance: float = 1e-9,
    max_iterations: int = 400,
) -> Modes:
    """Lowest eigenpairs of K u = lambda M u.

    Parameters
    ----------
    K, M : (N, N) sparse and symmetric; M positive definite, K positive semidefinite.
    count : number of pairs m.
    fixed : (k,) unknowns held at zero; numbers of free coefficients with a constraint.
    domain : where the unknowns live; needed for a good preconditioner, and for its constraint.
    constraint : (n, n_free) matrix T, applied to each component.
    solver : "lanczos", "lobpcg" or "auto"; where few unknowns are free, the matrices are dense whatever it says.
    tolerance : relative residual to reach.

    Raises
    ------
    InputError : sizes do not match, or more pairs are asked for than there are unknowns.
    ConvergenceError : a residual is above the tolerance, or an eigenvalue was missed.
    """
    if solver not in ("auto", "lanczos", "lobpcg"):
        raise InputError(f"there is no eigenvalue solver {solver!r}; there are: auto, lanczos, lobpcg")
    if K.shape != M.shape:
        raise InputError(f"matrices of shapes {K.shape} and {M.shape} do not fit")
    if constraint is None and domain is not None:
        constraint = domain.space.constraint
    T = None
    if constraint is not None:
        T = csr_array(kron(constraint, eye_array(K.shape[0] // constraint.shape[0]), format="csr"))
        K, M = T.T @ K @ T, T.T @ M @ T
    K, M = checked(K), checked(M)
    held = np.zeros(K.shape[0], dtype=bool)
    if fixed is not None:
        held[np.asarray(fixed, dtype=np.int64)] = True
    free = np.flatnonzero(~held)
    if not 1 <= count <= len(free):
        raise InputError(f"{count} eigenpairs of {len(free)} free unknowns cannot be found")
    A, B = submatrix(K, free), submatrix(M, free)
    # A Rayleigh quotient of each unknown's own function bounds the lowest eigenvalue from above.
    shift = -1e-3 * float((A.diagonal() / B.diagonal()).min()) / len(free) ** (2 / 3)
    if len(free) <= max(3 * count, DENSE):
        X = eigh(A.toarray(), B.toarray(), subset_by_index=(0, count - 1))[1]
        name = "dense"
    elif solver == "lanczos" or (solver == "auto" and prefer_direct(A)):
        found, X = _lanczos(A, B, count, shift, max_iterations)
        _require_all(A, B, found, shift)
        name = "lanczos"
    else:
        precondition = preconditioner_for(csr_array(A - shift * B), held, domain, constraint)
        X = _lobpcg(A, B, count, precondition, tolerance, max_iterations)
        name = "lobpcg"
    values, X = _orthonormal(A, B, X)
    residuals = _residuals(A, B, values, X)
    worst = int(np.argmax(residuals))
    if not residuals[worst] <= tolerance:
        raise ConvergenceError(f"eigenpair {worst} has relative residual {residuals[worst]:.1e}, not {tolerance:.1e}")
    full = np.zeros((K.shape[0], count))
    full[free] = X
    return Modes(values, full if T is None else T @ full, residuals, name)


def _orthonormal(A: csr_array, B: csr_array, X: Array) -> tuple[Array, Array]:
    """Eigenpairs in the span of X (n, m), orthonormal in B to rounding, also within clusters."""
    inner = np.linalg.cholesky(X.T @ (B @ X))
    Q = np.linalg.solve(inner, X.T).T
    values, turn = np.linalg.eigh(Q.T @ (A @ Q))
    return np.asarray(values, dtype=np.float64), np.asarray(Q @ turn, dtype=np.float64)


def _lanczos(A: csr_array, B: csr_array, count: int, shift: float, most: int) -> tuple[Array, Array]:
    factor = factorize(csr_array(A - shift * B), symmetric=True)
    inverse = LinearOperator(A.shape, matvec=lambda f: factor.fast(np.ascontiguousarray(f.ravel())), dtype=float)
    mass = LinearOperator(A.shape, matvec=lambda x: product(B, x.ravel()), dtype=float)
    stiffness = LinearOperator(A.shape, matvec=lambda x: product(A, x.ravel()), dtype=float)
    start = np.random.default_rng(20189).standard_normal(A.shape[0])
    steps = min(A.shape[0] - 1, max(2 * count + 8, 24))
    try:
        values, X = eigsh(stiffness, count, mass, sigma=shift, OPinv=inverse, v0=start, ncv=steps, maxiter=most)
    except ArpackNoConvergence as error:
        raise ConvergenceError(f"Lanczos iteration found {len(error.eigenvalues)} of {count} eigenpairs") from error
    order = np.argsort(values)
    return values[order], X[:, order]


def _lobpcg(
    A: csr_array, B: csr_array, count: int, precondition: Any, tolerance: float, most: int
) -> Array:
    """Vectors (n, count) by LOBPCG with a few guard vectors, which speed up the last wanted ones."""
    block = min(count + max(2, count // 3), A.shape[0] // 5)
    X = np.random.default_rng(20191).standard_normal((A.shape[0], block))

    def columns(R: Array) -> Array:
        return np.stack([precondition(np.ascontiguousarray(r)) for r in R.T], axis=1)

    M = LinearOperator(A.shape, matvec=lambda r: precondition(np.ascontiguousarray(r.ravel())), matmat=columns,
                       dtype=float)
    spent, best = 0, np.inf
    goal = None
    while spent < most:
        steps = min(max(most // 8, 5), most - spent)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # residuals are judged below
            values, X = lobpcg(A, X, B, M, tol=goal, maxiter=steps, largest=False)
        spent += steps
        order = np.argsort(values)
        values, X = values[order], X[:, order]
        relative = _residuals(A, B, values[:count], X[:, :count])
        if relative.max() <= 0.5 * tolerance or (spent > most // 2 and relative.max() > 0.9 * best):
            break
        best = min(best, float(relative.max()))
        # Its own tolerance is on |K x - lambda M x| of modes of unit length in M.
        goal = 0.3 * tolerance * float(np.linalg.norm(absolute_product(A, np.ascontiguousarray(X[:, 0]))))
    return X[:, :count]


def _residuals(A: csr_array, B: csr_array, values: Array, X: Array) -> Array:
    """Relative residual of each pair, (m,)."""
    found = np.empty(len(values))
    for m, value in enumerate(values):
        x = np.ascontiguousarray(X[:, m])
        r = product(A, x) - value * product(B, x)
        scale = np.linalg.norm(absolute_product(A, x) + abs(value) * absolute_product(B, x))
        found[m] = np.linalg.norm(r) / scale
    return found


def _require_all(A: csr_array, B: csr_array, values: Array, shift: float) -> None:
    """Count the eigenvalues below the last found one and compare."""
    below = values[-1] - 1e-6 * max(abs(values[-1]), abs(shift))
    try:
        factor: Factor = factorize(csr_array(A - below * B), symmetric=True)
    except (InputError, ConvergenceError):
        return  # hit an eigenvalue: the residuals must do
    found = int((values < below).sum())
    if factor.negative >= 0 and factor.negative != found:
        raise ConvergenceError(f"{factor.negative} eigenvalues lie below {below:.6g} but only {found} were found")
