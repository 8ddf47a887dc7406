r"""T-splines at points of the meccano, and control points that interpolate there (equation (11) of the paper).

    S(t_a) = sum_b P_b R_b(t_a) = images of the anchors t_a

is solved by a sparse LU, whose success also shows that the blending functions are independent. Derivatives of S follow
from those of the sums A = sum B_a P_a and W = sum B_a by the quotient rule, S_d = (A_d - S W_d) / W.

Points are given in the enclosing cube [0, 1]^d.

Axis letters: a, n anchor (function), d direction, q point, c component.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.t_spline import TSpline
from geometry.meccano.tmesh import cells_of
from iga.errors import ConvergenceError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_FULL = 1 << LEVELS


def cells_around(own: TSpline, x: Array) -> Index:
    """Leaf cells (q,) of the meccano that hold points x (q, d); on faces any cell that touches the point.

    Raises
    ------
    InputError : a point lies outside the meccano.
    """
    d = own.tmesh.dim
    at = np.asarray(x, dtype=float).reshape(-1, d) * _FULL
    cells = np.full(len(at), -1, dtype=np.int64)
    for offset in np.ndindex(*(2,) * d):
        probe = np.clip(np.where(np.array(offset), np.ceil(at) - 1, np.floor(at)).astype(np.int64), 0, _FULL - 1)
        found = cells_of(own.tmesh, np.zeros(len(at), dtype=np.int64), probe)
        cells = np.where((cells < 0) & (own.owner[found] >= 0), found, cells)
    if (cells < 0).any():
        raise InputError(f"point {int(np.flatnonzero(cells < 0)[0])} lies outside the meccano")
    return cells


def blending(own: TSpline, x: Array) -> csr_array:
    """Values B_a, before the quotient, at points x (q, d): (q, n).

    Raises
    ------
    InputError : a point lies outside the meccano.
    """
    d = own.tmesh.dim
    cells = cells_around(own, x)
    x = np.asarray(x, dtype=float).reshape(-1, d) * _FULL
    count = (own.start[1:] - own.start[:-1])[cells]
    point = np.repeat(np.arange(len(x)), count)
    place = np.arange(len(point)) - np.repeat(np.cumsum(count) - count, count)
    function = own.acting[own.start[cells[point]] + place]
    values = np.ones(len(point))
    for axis in range(d):
        values *= _b_splines(own.knots[function, axis].astype(np.float64), x[point, axis])
    made = coo_array((values, (point, function)), shape=(len(x), own.space.n)).tocsr()
    made.eliminate_zeros()
    return made


def collocation(own: TSpline, x: Array) -> csr_array:
    """Values of the rational functions R_a at points x (q, d): (q, n)."""
    B = blending(own, x)
    return csr_array(diags_array(1.0 / B.sum(axis=1)) @ B)


def points_and_slopes(own: TSpline, control: Array, x: Array) -> tuple[Array, Array]:
    """S (q, c) and its derivatives (q, c, d) at points x (q, d), for control points (n, c)."""
    x = np.ascontiguousarray(x, dtype=float).reshape(-1, own.tmesh.dim)
    return _evaluate(
        x, cells_around(own, x), own.start, own.acting, own.knots / _FULL, np.ascontiguousarray(control, dtype=float)
    )


def interpolate(own: TSpline, images: Array) -> tuple[Array, dict[str, float]]:
    """Control points (n, c) with S(t_a) = images (n, c) for all anchors.

    Returns
    -------
    Control points, and ``residual`` (relative to the largest image) and ``condition`` (in the 2-norm).

    Raises
    ------
    ConvergenceError : the matrix is singular, or the residual is above 1e-10.
    """
    A = collocation(own, own.anchors / _FULL)
    try:
        factors = splu(A.tocsc())
    except RuntimeError as error:
        raise ConvergenceError(f"the T-spline blending functions are not independent ({error})") from None
    points = factors.solve(np.ascontiguousarray(images, dtype=float))
    residual = float(np.abs(A @ points - images).max() / max(np.abs(images).max(), np.finfo(float).tiny))
    if not residual < 1e-10:
        raise ConvergenceError(f"interpolation at the anchors left a relative residual of {residual:.1e}")
    return points, {"residual": residual, "condition": _condition(A, factors)}


def _condition(A: csr_array, factors: object) -> float:
    """Condition number in the 2-norm: exact for few functions, to a few digits by Lanczos for many."""
    n = A.shape[0]
    if n <= 300:
        return float(np.linalg.cond(A.toarray()))
    solve = factors.solve  # type: ignore[attr-defined]
    start = np.random.default_rng(11).standard_normal(n)
    square = LinearOperator((n, n), matvec=lambda v: A.T @ (A @ v))
    inverse = LinearOperator((n, n), matvec=lambda v: solve(solve(np.ravel(v), "T")))
    largest, least = (
        float(eigsh(op, 1, v0=start, tol=1e-3, return_eigenvectors=False)[0]) for op in (square, inverse)
    )
    return float(np.sqrt(largest * least))


@njit(cache=True)
def _b_spline(knots, x, N):  # type: ignore[no-untyped-def]
    """Value and derivative of the cubic B-spline with knots (5,), 3 (N_0 / (k3 - k0) - N_1 / (k4 - k1)); N is room."""
    for j in range(4):
        N[j] = 1.0 if knots[j] <= x < knots[j + 1] else 0.0
    for p in range(1, 3):
        for j in range(4 - p):
            N[j] = (x - knots[j]) / (knots[j + p] - knots[j]) * N[j] + (
                (knots[j + p + 1] - x) / (knots[j + p + 1] - knots[j + 1]) * N[j + 1]
            )
    low, high = N[0] / (knots[3] - knots[0]), N[1] / (knots[4] - knots[1])
    return (x - knots[0]) * low + (knots[4] - x) * high, 3.0 * (low - high)


@njit(cache=True)
def _b_splines(knots, x):  # type: ignore[no-untyped-def]
    """Values (m,) of cubic B-splines with knots (m, 5)."""
    N, values = np.empty(4), np.empty(len(x))
    for m in range(len(x)):
        values[m] = _b_spline(knots[m], x[m], N)[0]
    return values


@njit(cache=True)
def _evaluate(x, cells, start, acting, knots, control):  # type: ignore[no-untyped-def]
    count, d = x.shape
    c = control.shape[1]
    S, slopes = np.zeros((count, c)), np.zeros((count, c, d))
    N, value, slope = np.empty(4), np.empty(d), np.empty(d)
    W_d, product = np.empty(d), np.empty(d)
    for q in range(count):
        W = 0.0
        W_d[:] = 0.0
        for m in range(start[cells[q]], start[cells[q] + 1]):
            n = acting[m]
            B = 1.0
            for axis in range(d):
                value[axis], slope[axis] = _b_spline(knots[n, axis], x[q, axis], N)
                B *= value[axis]
            for axis in range(d):
                product[axis] = slope[axis]
                for other in range(d):
                    if other != axis:
                        product[axis] *= value[other]
            W += B
            for i in range(c):
                S[q, i] += B * control[n, i]
            for axis in range(d):
                W_d[axis] += product[axis]
                for i in range(c):
                    slopes[q, i, axis] += product[axis] * control[n, i]
        for i in range(c):
            S[q, i] /= W
            for axis in range(d):
                slopes[q, i, axis] = (slopes[q, i, axis] - S[q, i] * W_d[axis]) / W
    return S, slopes
