r"""Regularised mean ratio of tricubic cells and its gradient, compiled.

For one cell with Bezier points b (64, 3) and lengths l, at a product grid of q^3 sample points,

    J = sum_b grad B_b b,   S = J diag(1/l),   eta = |S|^2 / (3 h(det S)^(2/3)),   energy = mean_q eta^2,
    d(eta^2) = 2 eta^2 (2 S : dS / |S|^2 - (2/3) d(det S) / (det S^2 + 4 delta^2)^(1/2)),

by contracting one direction at a time. For det S < 0 the printed form of h cancels; the quotient is used instead.

Axis letters: e cell, b Bezier point, q sample point, c component, d reference dimension.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from iga.bernstein import bernstein
from iga.cells import LINE

Array = NDArray[np.float64]


def tables(samples: Array) -> tuple[Array, Array]:
    """Values and derivatives (q, 4) of the univariate cubics at sample coordinates (q,)."""
    values, slopes = bernstein(LINE, 3).tabulate(samples[:, None], 1)
    return np.ascontiguousarray(values), np.ascontiguousarray(slopes[..., 0])


@njit(cache=True, fastmath=False)
def _slopes(b: Array, V: Array, G: Array, J: Array) -> None:
    """J (q^3, 3, 3) of one cell from b (4, 4, 4, 3)."""
    q = V.shape[0]
    last = np.zeros((2, 4, 4, q))
    middle = np.zeros((3, 4, q, q))
    for c in range(3):
        for i in range(4):
            for j in range(4):
                for r in range(q):
                    v, g = 0.0, 0.0
                    for k in range(4):
                        v += V[r, k] * b[i, j, k, c]
                        g += G[r, k] * b[i, j, k, c]
                    last[0, i, j, r], last[1, i, j, r] = v, g
        for i in range(4):
            for s in range(q):
                for r in range(q):
                    vv, vg, gv = 0.0, 0.0, 0.0
                    for j in range(4):
                        vv += V[s, j] * last[0, i, j, r]
                        vg += V[s, j] * last[1, i, j, r]
                        gv += G[s, j] * last[0, i, j, r]
                    middle[0, i, s, r], middle[1, i, s, r], middle[2, i, s, r] = vv, gv, vg
        for t in range(q):
            for s in range(q):
                for r in range(q):
                    x, y, z = 0.0, 0.0, 0.0
                    for i in range(4):
                        x += G[t, i] * middle[0, i, s, r]
                        y += V[t, i] * middle[1, i, s, r]
                        z += V[t, i] * middle[2, i, s, r]
                    at = (t * q + s) * q + r
                    J[at, c, 0], J[at, c, 1], J[at, c, 2] = x, y, z


@njit(cache=True, fastmath=False)
def _back(D: Array, V: Array, G: Array, out: Array) -> None:
    """Transpose of `_slopes`: from D (q^3, 3, 3) to out (4, 4, 4, 3)."""
    q = V.shape[0]
    middle = np.zeros((3, 4, q, q))
    last = np.zeros((2, 4, 4, q))
    for c in range(3):
        for i in range(4):
            for s in range(q):
                for r in range(q):
                    x, y, z = 0.0, 0.0, 0.0
                    for t in range(q):
                        at = (t * q + s) * q + r
                        x += G[t, i] * D[at, c, 0]
                        y += V[t, i] * D[at, c, 1]
                        z += V[t, i] * D[at, c, 2]
                    middle[0, i, s, r], middle[1, i, s, r], middle[2, i, s, r] = x, y, z
        for i in range(4):
            for j in range(4):
                for r in range(q):
                    v, g = 0.0, 0.0
                    for s in range(q):
                        v += V[s, j] * middle[0, i, s, r] + G[s, j] * middle[1, i, s, r]
                        g += V[s, j] * middle[2, i, s, r]
                    last[0, i, j, r], last[1, i, j, r] = v, g
        for i in range(4):
            for j in range(4):
                for k in range(4):
                    total = 0.0
                    for r in range(q):
                        total += V[r, k] * last[0, i, j, r] + G[r, k] * last[1, i, j, r]
                    out[i, j, k, c] = total


@njit(cache=True, fastmath=False)
def lowest(points: Array, index: NDArray[np.int64], inverse: Array, V: Array, G: Array) -> Array:
    """Smallest det S over the sample points of each cell, (e,); arguments as in `mean_ratio`."""
    q = V.shape[0]
    J = np.zeros((q * q * q, 3, 3))
    b = np.zeros((4, 4, 4, 3))
    flat = b.reshape(64, 3)
    result = np.empty(len(index))
    for e in range(len(index)):
        for n in range(64):
            for c in range(3):
                flat[n, c] = points[index[e, n], c]
        _slopes(b, V, G, J)
        least = np.inf
        for p in range(len(J)):
            S = J[p]
            det = (
                S[0, 0] * (S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1])
                - S[0, 1] * (S[1, 0] * S[2, 2] - S[1, 2] * S[2, 0])
                + S[0, 2] * (S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0])
            )
            least = min(least, det)
        result[e] = least * inverse[e, 0] * inverse[e, 1] * inverse[e, 2]
    return result


@njit(cache=True, fastmath=False)
def mean_ratio(
    points: Array, index: NDArray[np.int64], inverse: Array, delta: float, V: Array, G: Array, gradient: Array
) -> float:
    """Energy of all cells; its gradient is added to ``gradient``.

    Parameters
    ----------
    points : (r, 3) Bezier points; index : (e, 64) those of each cell.
    inverse : (e, 3) inverse lengths.
    delta : regularisation; with 0 a folded cell gives infinity.
    V, G : from `tables`.
    gradient : (r, 3)
    """
    q = V.shape[0]
    count = q * q * q
    J = np.zeros((count, 3, 3))
    D = np.zeros((count, 3, 3))
    b = np.zeros((4, 4, 4, 3))
    out = np.zeros((4, 4, 4, 3))
    flat, back = b.reshape(64, 3), out.reshape(64, 3)
    S = np.zeros((3, 3))
    C = np.zeros((3, 3))
    total = 0.0
    for e in range(len(index)):
        for n in range(64):
            for c in range(3):
                flat[n, c] = points[index[e, n], c]
        _slopes(b, V, G, J)
        for p in range(count):
            square = 0.0
            for c in range(3):
                for d in range(3):
                    S[c, d] = J[p, c, d] * inverse[e, d]
                    square += S[c, d] * S[c, d]
            for c in range(3):
                c1, c2 = (c + 1) % 3, (c + 2) % 3
                for d in range(3):
                    d1, d2 = (d + 1) % 3, (d + 2) % 3
                    C[c, d] = S[c1, d1] * S[c2, d2] - S[c1, d2] * S[c2, d1]
            sigma = S[0, 0] * C[0, 0] + S[0, 1] * C[0, 1] + S[0, 2] * C[0, 2]
            root = np.sqrt(sigma * sigma + 4.0 * delta * delta)
            if sigma > 0.0:
                h = 0.5 * (sigma + root)
            elif delta > 0.0:
                h = 2.0 * delta * delta / (root - sigma)
            else:
                return np.inf
            eta = square / (3.0 * h ** (2.0 / 3.0))
            total += eta * eta / count
            factor = 2.0 * eta * eta / count
            for c in range(3):
                for d in range(3):
                    D[p, c, d] = factor * (2.0 * S[c, d] / square - (2.0 / 3.0) * C[c, d] / root) * inverse[e, d]
        _back(D, V, G, out)
        for n in range(64):
            for c in range(3):
                gradient[index[e, n], c] += back[n, c]
    return total
