r"""Distortion of elements at sample points, and the slopes of its sum, compiled.

With J (c, d) the derivatives of a map at a point, T the Jacobian matrix of the ideal element there and S = J T^-1,

    eta = |S|^2 / (3 h(sigma)^(2/3)),    sigma = det S,    h(sigma) = (sigma + (sigma^2 + 4 delta^2)^(1/2)) / 2,
    d(eta^p) = p eta^p (2 S : dS / |S|^2 - (2/3) dsigma / (sigma^2 + 4 delta^2)^(1/2))

and, with a factor, a term that keeps elements from shrinking to nothing while delta is positive,

    g = (1 + sigma^2) / (2 h),    dg = (sigma / h - g / (sigma^2 + 4 delta^2)^(1/2)) dsigma

(mean ratio: Knupp 2001; h: Escobar, Rodriguez, Montenegro, Montero, Gonzalez-Yuste 2003, doi:10.1016/S0045-7825(03)
00299-8). eta is 1 for the ideal shape in any size and rotation. For sigma < 0 the printed form of h cancels; the
quotient 2 delta^2 / ((sigma^2 + 4 delta^2)^(1/2) - sigma) is used instead. The second term is 1 for the ideal size
(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov 2021, doi:10.1145/3450626.3459847).

Products with the tables of the sample points are left to BLAS: a chunk of elements has its Bernstein coefficients in
``net`` (e, c, b), and its values and derivatives at the points are net @ table, (e, c, s, q).

Axis letters: e element, n function on the element, b Bernstein function, c component, d reference dimension, q point,
s channel (the derivatives, for rational maps the value before them), k pattern.
"""

from __future__ import annotations

import numba
import numpy as np

from iga.kernels.options import OPTIONS


@numba.njit(**OPTIONS)
def collect(values, dofs, net):
    """net[e, :, b] = values[dofs[e, b]]: no extraction."""
    for e in range(len(dofs)):
        for b in range(dofs.shape[1]):
            i = dofs[e, b]
            for c in range(values.shape[1]):
                net[e, c, b] = values[i, c]


@numba.njit(**OPTIONS)
def scatter(slope, dofs, gradient):
    """Transpose of `collect`, for the components that ``gradient`` has; adds."""
    for e in range(len(dofs)):
        for b in range(dofs.shape[1]):
            i = dofs[e, b]
            for c in range(gradient.shape[1]):
                gradient[i, c] += slope[e, c, b]


@numba.njit(**OPTIONS)
def collect_patterns(values, dofs, C, pattern, net):
    """net[e] = values[dofs[e]]^T C with C (k, n, b) and pattern (e,).

    The three coordinates go together, so that each pattern is read once: nearly every element may have its own.
    """
    for e in range(len(dofs)):
        k = pattern[e]
        net[e, :, :] = 0.0
        x, y, z = net[e, 0], net[e, 1], net[e, 2]
        for n in range(C.shape[1]):
            i, row = dofs[e, n], C[k, n]
            p, q, r = values[i, 0], values[i, 1], values[i, 2]
            for b in range(C.shape[2]):
                x[b] += p * row[b]
                y[b] += q * row[b]
                z[b] += r * row[b]
            for c in range(3, values.shape[1]):
                for b in range(C.shape[2]):
                    net[e, c, b] += values[i, c] * row[b]


@numba.njit(**OPTIONS)
def scatter_patterns(slope, dofs, C, pattern, gradient):
    """Transpose of `collect_patterns`, for three coordinates; adds."""
    for e in range(len(dofs)):
        k = pattern[e]
        x, y, z = slope[e, 0], slope[e, 1], slope[e, 2]
        for n in range(C.shape[1]):
            i, row = dofs[e, n], C[k, n]
            p, q, r = 0.0, 0.0, 0.0
            for b in range(C.shape[2]):
                p += x[b] * row[b]
                q += y[b] * row[b]
                r += z[b] * row[b]
            gradient[i, 0] += p
            gradient[i, 1] += q
            gradient[i, 2] += r


@numba.njit(**OPTIONS)
def collect_products(values, dofs, F0, F1, F2, pattern, net):
    """net[e] for extraction by factors F0 (k, n0, b0), F1, F2 and pattern (e, 3)."""
    n0, b0, n1, b1, n2, b2 = F0.shape[1], F0.shape[2], F1.shape[1], F1.shape[2], F2.shape[1], F2.shape[2]
    last = np.empty((n0 * n1, b2))
    middle = np.empty((n0, b1 * b2))
    for e in range(len(dofs)):
        A, B, C = F0[pattern[e, 0]], F1[pattern[e, 1]], F2[pattern[e, 2]]
        for c in range(values.shape[1]):
            last[:] = 0.0
            for i in range(n0 * n1):
                for j in range(n2):
                    v = values[dofs[e, i * n2 + j], c]
                    for b in range(b2):
                        last[i, b] += v * C[j, b]
            middle[:] = 0.0
            for i in range(n0):
                for j in range(n1):
                    for a in range(b1):
                        v = B[j, a]
                        for b in range(b2):
                            middle[i, a * b2 + b] += v * last[i * n1 + j, b]
            row = net[e, c]
            row[:] = 0.0
            for i in range(n0):
                for a in range(b0):
                    v = A[i, a]
                    for b in range(b1 * b2):
                        row[a * b1 * b2 + b] += v * middle[i, b]


@numba.njit(**OPTIONS)
def scatter_products(slope, dofs, F0, F1, F2, pattern, gradient):
    """Transpose of `collect_products`; adds."""
    n0, b0, n1, b1, n2, b2 = F0.shape[1], F0.shape[2], F1.shape[1], F1.shape[2], F2.shape[1], F2.shape[2]
    last = np.empty((n0 * n1, b2))
    middle = np.empty((n0, b1 * b2))
    for e in range(len(dofs)):
        A, B, C = F0[pattern[e, 0]], F1[pattern[e, 1]], F2[pattern[e, 2]]
        for c in range(gradient.shape[1]):
            row = slope[e, c]
            middle[:] = 0.0
            for i in range(n0):
                for a in range(b0):
                    v = A[i, a]
                    for b in range(b1 * b2):
                        middle[i, b] += v * row[a * b1 * b2 + b]
            last[:] = 0.0
            for i in range(n0):
                for j in range(n1):
                    for a in range(b1):
                        v = B[j, a]
                        for b in range(b2):
                            last[i * n1 + j, b] += v * middle[i, a * b2 + b]
            for i in range(n0 * n1):
                for j in range(n2):
                    total = 0.0
                    for b in range(b2):
                        total += last[i, b] * C[j, b]
                    gradient[dofs[e, i * n2 + j], c] += total


@numba.njit(**OPTIONS)
def divide(J):
    """Derivatives of x = X / W in place, in channels 1..3 of J (e, 4, 4, q) of (X, W); W and its slopes stay."""
    for e in range(len(J)):
        for q in range(J.shape[3]):
            v = 1.0 / J[e, 3, 0, q]
            for c in range(3):
                x = J[e, c, 0, q] * v
                for d in range(1, 4):
                    J[e, c, d, q] = (J[e, c, d, q] - x * J[e, 3, d, q]) * v


@numba.njit(**OPTIONS)
def undivide(J, D):
    """Transpose of `divide` with respect to X, in place in D (e, 4, 4, q): slopes by the derivatives become by X.

    With g_d = (X_d - x W_d) / W, x = X / W: X_d gets D_d / W, and X gets - sum_d D_d W_d / W^2.
    """
    for e in range(len(J)):
        for q in range(J.shape[3]):
            v = 1.0 / J[e, 3, 0, q]
            for c in range(3):
                back = 0.0
                for d in range(1, 4):
                    D[e, c, d, q] *= v
                    back -= D[e, c, d, q] * J[e, 3, d, q] * v
                D[e, c, 0, q] = back
            for d in range(4):
                D[e, 3, d, q] = 0.0


@numba.njit(**OPTIONS)
def distortion(J, first, inverse, delta, power, size, weight, D, energy, least):
    """Distortion of a chunk, its slopes, and the smallest det S.

    Parameters
    ----------
    J : (e, c, s, q); the derivatives are channels ``first`` to ``first`` + 2.
    inverse : (e, 3, 3) T^-1 of the ideal elements.
    delta : (e,) regularisation; where it is 0 an element with det S <= 0 has infinite energy.
    power : p.
    size : factor of g.
    weight : (e,) weight of the mean over the points.
    D : shape of J, result: derivatives of the weighted sum by J.
    energy : (e,) result: weight * mean_q (eta^p + size g).
    least : (e,) result: smallest det S.
    """
    count = J.shape[3]
    S = np.empty((3, 3))
    C = np.empty((3, 3))
    for e in range(len(J)):
        T = inverse[e]
        total, low = 0.0, np.inf
        w = weight[e] / count
        for q in range(count):
            square = 0.0
            for c in range(3):
                x, y, z = J[e, c, first, q], J[e, c, first + 1, q], J[e, c, first + 2, q]
                for d in range(3):
                    S[c, d] = x * T[0, d] + y * T[1, d] + z * T[2, d]
                    square += S[c, d] * S[c, d]
            for c in range(3):
                c1, c2 = (c + 1) % 3, (c + 2) % 3
                for d in range(3):
                    d1, d2 = (d + 1) % 3, (d + 2) % 3
                    C[c, d] = S[c1, d1] * S[c2, d2] - S[c1, d2] * S[c2, d1]
            sigma = S[0, 0] * C[0, 0] + S[0, 1] * C[0, 1] + S[0, 2] * C[0, 2]
            low = min(low, sigma)
            root = np.sqrt(sigma * sigma + 4.0 * delta[e] * delta[e])
            if sigma > 0.0:
                h = 0.5 * (sigma + root)
            else:
                h = 2.0 * delta[e] * delta[e] / (root - sigma)
            if not h > 0.0:
                total = np.inf
                for c in range(3):
                    for d in range(3):
                        D[e, c, first + d, q] = 0.0
                continue
            term = w * np.exp(power / 3.0 * np.log(square * square * square / (27.0 * h * h)))
            grown = 0.5 * w * size * (1.0 + sigma * sigma) / h
            total += term + grown
            s, k = 2.0 * power * term / square, (2.0 / 3.0) * power * term / root
            k -= w * size * sigma / h - grown / root
            for c in range(3):
                for d in range(3):
                    D[e, c, first + d, q] = (
                        T[d, 0] * (s * S[c, 0] - k * C[c, 0])
                        + T[d, 1] * (s * S[c, 1] - k * C[c, 1])
                        + T[d, 2] * (s * S[c, 2] - k * C[c, 2])
                    )
        energy[e] = total
        least[e] = low
