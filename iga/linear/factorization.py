r"""Direct solution: factor a sparse matrix once, solve for many right-hand sides.

Symmetric matrices are factored as P^T K P = L D L^T (rslab), all others, and whatever that cannot do, as L U (SuperLU).
Every solution is refined, x += K^-1 (f - K x), and then judged by its normwise backward error

    eta = |f - K x| / (|K| |x| + |f|)        (maximum norms; Rigal and Gaches 1967, doi:10.1145/321386.321416),

which is near the unit round-off for a stable factorization however ill conditioned K is. A matrix is called singular
when the condition number of diag(K)^-1/2 K diag(K)^-1/2, estimated by one solve with a random right-hand side, exceeds
1e14.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from iga.errors import ConvergenceError, InputError
from iga.linear.products import product
from iga.parallel import threads

try:
    import rslab
except ImportError:  # wheels exist for the common platforms only
    rslab = None  # type: ignore[assignment]

Array = NDArray[np.float64]

ACCEPTED = 1e-11
"""Backward error above which a factorization is rejected."""
SINGULAR = 1e14
"""Estimated condition number of the scaled matrix above which it is called singular."""


@dataclass(frozen=True)
class Estimate:
    """Predicted cost of a factorization: stored entries, floating point operations, peak memory in bytes."""

    entries: int
    operations: float
    memory: float


@dataclass(frozen=True, eq=False)
class Factor:
    """A factored matrix; call it with a right-hand side (n,) or several (n, k).

    Attributes
    ----------
    matrix : the matrix K, (n, n).
    name : which factorization.
    entries : stored entries of the factor.
    negative : number of negative eigenvalues, -1 where unknown.
    fast : solution without refinement or judgement, for preconditioners.
    norm : maximum norm of K.
    """

    matrix: csr_array
    name: str
    entries: int
    negative: int
    fast: Callable[[Array], Array]
    norm: float

    def __call__(self, f: Array) -> Array:
        """Solve K x = f with refinement.

        Raises
        ------
        ConvergenceError : the backward error stays above 1e-11.
        """
        f = np.asarray(f, dtype=float)
        if f.shape[0] != self.matrix.shape[0]:
            raise InputError(f"a right-hand side of length {f.shape[0]} does not fit {self.matrix.shape[0]} unknowns")
        if not np.isfinite(f).all():
            raise InputError(f"entry {np.argwhere(~np.isfinite(f))[0][0]} of the right-hand side is not finite")
        x = self.fast(f)
        error = np.inf
        for _ in range(4):
            r = f - product(self.matrix, x)
            scale = self.norm * np.abs(x).max(initial=0.0) + np.abs(f).max(initial=0.0)
            now = np.abs(r).max(initial=0.0) / scale if scale else 0.0
            if not now < 0.5 * error:  # no longer improving (or not a number)
                break
            error, best = now, x
            if error < 1e-16:
                break
            x = best + self.fast(r)
        if not error <= ACCEPTED:
            raise ConvergenceError(f"the {self.name} factorization is not accurate: backward error {error:.1e}")
        return best


def estimate(K: csr_array) -> Estimate | None:
    """Cost of factoring a symmetric matrix, from its pattern alone; None if it cannot be told."""
    if rslab is None:
        return None
    analysis = rslab.analyze(csc_array(K), path="ldlt", threads=threads())
    cost = analysis.estimate_memory()
    return Estimate(int(cost["factor_nnz"]), float(cost["factor_flops"]), float(cost["transient_peak_bytes"]))


def is_symmetric(K: csr_array) -> bool:
    """Whether x . K y = y . K x for random x and y, to rounding."""
    x, y = np.random.default_rng(20181).standard_normal((2, K.shape[0]))
    Ky, Kx = product(K, y), product(K, x)
    scale = np.linalg.norm(x) * np.linalg.norm(Ky) + np.linalg.norm(y) * np.linalg.norm(Kx)
    return bool(abs(x @ Ky - y @ Kx) <= 1e-12 * scale)


def factorize(K: Any, symmetric: bool | None = None) -> Factor:
    """Factor a square sparse matrix.

    Parameters
    ----------
    K : (n, n) sparse matrix.
    symmetric : whether K is symmetric; found out if not given.

    Raises
    ------
    InputError : K is not square, has an entry that is not finite, or is singular.
    ConvergenceError : no factorization reaches a small backward error.
    """
    K = checked(K)
    symmetric = is_symmetric(K) if symmetric is None else symmetric
    attempts = ([_ldlt] if symmetric and rslab is not None else []) + [_lu]
    failure: Exception = ConvergenceError("no factorization")
    d = np.abs(K.diagonal())
    d = np.sqrt(np.where(d > 0, d, np.abs(K.data).max(initial=1.0)))
    f = np.random.default_rng(20183).choice([-1.0, 1.0], K.shape[0]) * d
    norm = float(np.add.reduceat(np.abs(K.data), K.indptr[:-1]).max()) if K.nnz else 0.0
    for attempt in attempts:
        try:
            solve, name, entries, negative = attempt(K, symmetric)
            factor = Factor(K, name, entries, negative, solve, norm)
            x = solve(f)
            growth = np.linalg.norm(x * d) / np.linalg.norm(f / d)
            if not growth <= SINGULAR:
                at = int(np.argmax(np.where(np.isfinite(x), np.abs(x * d), np.inf)))
                raise InputError(f"the matrix is singular (condition above {SINGULAR:.0e}): unknown {at} is not held")
            factor(f)
        except (RuntimeError, ArithmeticError, MemoryError) as error:
            failure = error
            if "deficient" in str(error):
                break
        else:
            return factor
    if "singular" in str(failure) or "deficient" in str(failure):
        raise InputError("the matrix is singular: something is not held, or two unknowns are one") from failure
    raise ConvergenceError(f"the matrix cannot be factored: {failure}") from failure


def checked(K: Any) -> csr_array:
    """K as a square CSR matrix with sorted, unique, finite entries.

    Raises
    ------
    InputError : it is not square, or an entry is not finite, or a row is empty.
    """
    made = csr_array(K, dtype=float)
    if made.shape[0] != made.shape[1]:
        raise InputError(f"a matrix of shape {made.shape} is not square")
    if not made.has_canonical_format:
        made = made.copy() if made is K else made
        made.sum_duplicates()
    bad = np.flatnonzero(~np.isfinite(made.data))
    if len(bad):
        row = int(np.searchsorted(made.indptr, bad[0], side="right")) - 1
        raise InputError(f"the matrix entry ({row}, {made.indices[bad[0]]}) is not finite")
    empty = np.flatnonzero(np.diff(made.indptr) == 0)
    if len(empty):
        raise InputError(f"row {empty[0]} of the matrix is empty: nothing acts on unknown {empty[0]}")
    return made


def _ldlt(K: csr_array, symmetric: bool) -> tuple[Callable[[Array], Array], str, int, int]:
    factor = rslab.ldlt(csc_array(K), threads=threads())

    def solve(f: Array) -> Array:
        return factor.solve(np.ascontiguousarray(f)) if f.ndim == 1 else factor.solve_many(np.ascontiguousarray(f))

    return solve, "LDLt", int(factor.factor_nnz), int(factor.inertia[1])


def _lu(K: csr_array, symmetric: bool) -> tuple[Callable[[Array], Array], str, int, int]:
    options = {"SymmetricMode": True} if symmetric else {}
    factor = splu(
        csc_array(K), permc_spec="MMD_AT_PLUS_A" if symmetric else "COLAMD",
        diag_pivot_thresh=1e-3 if symmetric else 1.0, options=options,
    )
    return factor.solve, "LU", int(factor.nnz), -1
