"""Compiled parts of `relocation`, for d = 2 and 3; formulas there.

For one free node y = x - x_0 of one simplex, S(y) = S + y g^T, so that

    |S(y)|^2 = a + 2 b.y + c |y|^2,  b = S g,  c = |g|^2,      sigma(y) = sigma + n.y,  n = cof(S) g,

and a visit needs only these numbers. With L = ln eta and r = (sigma^2 + 4 delta^2)^(1/2),

    grad L = 2 (b + c y) / |S|^2 - (2/d) n / r,
    Hess L = 2 c I / |S|^2 - 4 (b + c y)(b + c y)^T / |S|^4 + (2/d) sigma n n^T / r^3,
    Hess eta^p = eta^p (p^2 grad L grad L^T + p Hess L).

In the plane the third component is left out by making its row of the Hessian the unit one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# mypy: disallow-untyped-defs = False


@njit(cache=True)
def incidence(simplices, count):
    """Start (n + 1,) and entries simplex * (d + 1) + v of the simplices at each node."""
    m, size = simplices.shape
    start = np.zeros(count + 1, dtype=np.int64)
    for t in range(m):
        for v in range(size):
            start[simplices[t, v] + 1] += 1
    for n in range(count):
        start[n + 1] += start[n]
    fill = start[:-1].copy()
    around = np.empty(m * size, dtype=np.int64)
    for t in range(m):
        for v in range(size):
            n = simplices[t, v]
            around[fill[n]] = t * size + v
            fill[n] += 1
    return start, around


@njit(cache=True)
def _map(simplices, gradients, nodes, t, S):
    """S (d, d) of simplex t; returns its determinant."""
    d = nodes.shape[1]
    for i in range(d):
        for j in range(d):
            S[i, j] = 0.0
    for v in range(1, d + 1):
        for i in range(d):
            x = nodes[simplices[t, v], i] - nodes[simplices[t, 0], i]
            for j in range(d):
                S[i, j] += x * gradients[t, v, j]
    return _det(S)


@njit(cache=True)
def _det(S):
    if S.shape[0] == 2:
        return S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    return (
        S[0, 0] * (S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1])
        - S[0, 1] * (S[1, 0] * S[2, 2] - S[1, 2] * S[2, 0])
        + S[0, 2] * (S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0])
    )


@njit(cache=True)
def _cofactors(S, C):
    if S.shape[0] == 2:
        C[0, 0], C[0, 1], C[1, 0], C[1, 1] = S[1, 1], -S[1, 0], -S[0, 1], S[0, 0]
    else:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for p in range(3):
                q, r = (p + 1) % 3, (p + 2) % 3
                C[i, p] = S[j, q] * S[k, r] - S[j, r] * S[k, q]


@njit(cache=True)
def _root(h, d):
    """h^(2/d)."""
    return h if d == 2 else np.cbrt(h * h)


@njit(cache=True)
def positive(sigma, delta):
    """h(sigma); for sigma < 0 by the quotient, as the sum cancels there."""
    r = np.sqrt(sigma * sigma + 4.0 * delta * delta)
    if sigma >= 0.0:
        return 0.5 * (sigma + r)
    return 2.0 * delta * delta / (r - sigma)


@njit(cache=True)
def shapes(simplices, gradients, nodes):
    """Sigma (m,) and mean ratio (m,) of all simplices."""
    d = nodes.shape[1]
    S = np.empty((d, d))
    sigma, ratio = np.empty(len(simplices)), np.zeros(len(simplices))
    for t in range(len(simplices)):
        sigma[t] = _map(simplices, gradients, nodes, t, S)
        if sigma[t] > 0.0:
            square = 0.0
            for i in range(d):
                for j in range(d):
                    square += S[i, j] * S[i, j]
            ratio[t] = d * _root(sigma[t], d) / square
    return sigma, ratio


@njit(cache=True)
def energy_gradient(simplices, gradients, nodes, power, delta):
    """Sum of eta^p over all simplices and its gradient (n, d); infinite where delta = 0 and a simplex is inverted."""
    d = nodes.shape[1]
    S, C = np.empty((d, d)), np.empty((d, d))
    gradient = np.zeros(nodes.shape)
    total = 0.0
    for t in range(len(simplices)):
        sigma = _map(simplices, gradients, nodes, t, S)
        h = positive(sigma, delta)
        if h <= 0.0:
            return np.inf, gradient
        square = 0.0
        for i in range(d):
            for j in range(d):
                square += S[i, j] * S[i, j]
        value = (square / (d * _root(h, d))) ** power
        total += value
        _cofactors(S, C)
        inverse = 1.0 / np.sqrt(sigma * sigma + 4.0 * delta * delta)
        for i in range(d):
            for v in range(d + 1):
                slope = 0.0
                for j in range(d):
                    slope += (2.0 * S[i, j] / square - 2.0 / d * C[i, j] * inverse) * gradients[t, v, j]
                gradient[simplices[t, v], i] += power * value * slope
    return total, gradient


@njit(cache=True)
def _value(data, count, y, power, delta, d):
    """Sum of eta^p around a node moved by y."""
    total = 0.0
    for k in range(count):
        sigma = data[k, 5] + data[k, 6] * y[0] + data[k, 7] * y[1] + data[k, 8] * y[2]
        square = (
            data[k, 0]
            + 2.0 * (data[k, 1] * y[0] + data[k, 2] * y[1] + data[k, 3] * y[2])
            + data[k, 4] * (y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
        )
        h = positive(sigma, delta)
        if h <= 0.0:
            return np.inf
        eta = square / (d * _root(h, d))
        total += eta * eta if power == 2.0 else eta**power
    return total


@njit(cache=True)
def _derivatives(data, count, y, power, delta, d, slope, H):
    """Gradient (3,) and Hessian (3, 3) of `_value`, which is returned."""
    total = 0.0
    for i in range(3):
        slope[i] = 0.0
        for j in range(3):
            H[i, j] = 0.0
    first = np.empty(3)
    half = np.empty(3)
    for k in range(count):
        sigma = data[k, 5] + data[k, 6] * y[0] + data[k, 7] * y[1] + data[k, 8] * y[2]
        square = data[k, 0]
        for i in range(3):
            square += 2.0 * data[k, 1 + i] * y[i] + data[k, 4] * y[i] * y[i]
            half[i] = data[k, 1 + i] + data[k, 4] * y[i]
        h = positive(sigma, delta)
        if h <= 0.0:
            return np.inf
        eta = square / (d * _root(h, d))
        value = eta * eta if power == 2.0 else eta**power
        total += value
        inverse = 1.0 / np.sqrt(sigma * sigma + 4.0 * delta * delta)
        turn = 2.0 / d * sigma * inverse**3
        for i in range(3):
            first[i] = 2.0 * half[i] / square - 2.0 / d * data[k, 6 + i] * inverse
            slope[i] += power * value * first[i]
        for i in range(3):
            for j in range(i + 1):
                second = turn * data[k, 6 + i] * data[k, 6 + j] - 4.0 * half[i] * half[j] / (square * square)
                if i == j:
                    second += 2.0 * data[k, 4] / square
                H[i, j] += value * power * (power * first[i] * first[j] + second)
    H[0, 1], H[0, 2], H[1, 2] = H[1, 0], H[2, 0], H[2, 1]
    return total


@njit(cache=True)
def _descent(H, slope, step):
    """Step (3,) = -(H + shift I)^-1 slope, with the smallest shift tried that makes the matrix positive."""
    size = abs(H[0, 0]) + abs(H[1, 1]) + abs(H[2, 2])
    shift = 0.0
    for _ in range(12):
        a = H[0, 0] + shift
        if a > 1e-10 * size:
            l10, l20 = H[1, 0] / a, H[2, 0] / a
            b = H[1, 1] + shift - l10 * H[1, 0]
            if b > 1e-10 * size:
                m21 = H[2, 1] - l20 * H[1, 0]
                l21 = m21 / b
                c = H[2, 2] + shift - l20 * H[2, 0] - l21 * m21
                if c > 1e-10 * size:
                    u = -slope[0]
                    v = -slope[1] - l10 * u
                    w = -slope[2] - l20 * u - l21 * v
                    step[2] = w / c
                    step[1] = v / b - l21 * step[2]
                    step[0] = u / a - l10 * step[1] - l20 * step[2]
                    return True
        shift = max(4.0 * shift, 1e-2 * size)
    return False


@njit(cache=True)
def sweep(nodes, simplices, gradients, start, around, order, power, epsilon, newton):
    """Visit the nodes of ``order`` once, moving them in place; returns the largest move relative to the edges."""
    d = nodes.shape[1]
    most = 0
    for n in order:
        most = max(most, start[n + 1] - start[n])
    data = np.zeros((most, 9))
    S, C, H = np.empty((d, d)), np.empty((d, d)), np.empty((3, 3))
    y, slope, step, trial = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    largest = 0.0
    for n in order:
        count = start[n + 1] - start[n]
        least, mean, length = np.inf, 0.0, 0.0
        for k in range(count):
            t, v = divmod(around[start[n] + k], d + 1)
            sigma = _map(simplices, gradients, nodes, t, S)
            _cofactors(S, C)
            least = min(least, sigma)
            mean += abs(sigma) / count
            data[k, 0] = data[k, 4] = 0.0
            data[k, 5] = sigma
            for i in range(d):
                b, normal = 0.0, 0.0
                for j in range(d):
                    g = gradients[t, v, j]
                    data[k, 0] += S[i, j] * S[i, j]
                    b += S[i, j] * g
                    normal += C[i, j] * g
                data[k, 1 + i], data[k, 6 + i] = b, normal
                data[k, 4] += gradients[t, v, i] ** 2
            for w in range(d + 1):
                square = 0.0
                for i in range(d):
                    square += (nodes[simplices[t, w], i] - nodes[n, i]) ** 2
                length += np.sqrt(square) / (d * count)
        floor = epsilon * mean
        delta = np.sqrt(floor * (floor - least)) if least < floor else 0.0
        for i in range(3):
            y[i] = 0.0
        for _ in range(newton):
            value = _derivatives(data, count, y, power, delta, d, slope, H)
            if d == 2:
                slope[2] = H[2, 0] = H[2, 1] = 0.0
                H[2, 2] = H[0, 0] + H[1, 1]
            if not np.isfinite(value) or not _descent(H, slope, step):
                break
            size = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
            factor = 1.0 if size < 2.0 * length else 2.0 * length / size
            rate = slope[0] * step[0] + slope[1] * step[1] + slope[2] * step[2]
            done = False
            for _ in range(12):
                for i in range(3):
                    trial[i] = y[i] + factor * step[i]
                if _value(data, count, trial, power, delta, d) <= value + 1e-4 * factor * rate:
                    done = True
                    break
                factor *= 0.4
            if not done:
                break
            for i in range(3):
                y[i] = trial[i]
            if factor * size < 1e-3 * length:
                break
        move = 0.0
        for i in range(d):
            nodes[n, i] += y[i]
            move += y[i] * y[i]
        if length > 0.0:
            largest = max(largest, np.sqrt(move) / length)
    return largest
