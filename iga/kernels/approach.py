r"""Compiled kernel of point location: the point of an element's Bezier map that is nearest to a given one.

Minimises |X(xi) / w(xi) - p|^2 / 2 in barycentric coordinates (`iga.kernels.inversion`), under the bounds lambda >= 0:
damped Newton on the coordinates that are free, and an active set of those that are held at zero.

Axis letters: m target in an element, u distinct element, b Bernstein function, v barycentric coordinate, d direction.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from iga.kernels.inversion import ITERATIONS, STILL, evaluate, recentre
from iga.kernels.options import PLAIN

ATTEMPTS = 30
"""Most dampings of one step, each four times the one before."""
DAMPING, LEAST_DAMPING = 1e-6, 1e-12
"""Damping at the start and after a release, and the least there is, in the trace of the second derivatives."""
DIFFERENCE = 1e-6
"""Step of the differences of slopes, in barycentric coordinates."""
PULL = 1e-13
"""Slope, in distances, from which on a coordinate is released: less is rounding."""
INSIDE = 0.2
"""How far the search starts from the nearest control point's place towards the centre."""


@njit(**PLAIN)
def _reference(bary, origin, reference):
    """Largest barycentric coordinate of each simplex factor, for each of its coordinates."""
    for v in range(len(origin)):
        if origin[v] == v:
            best = v
            for i in range(v, len(origin)):
                if origin[i] == v and bary[i] > bary[best]:
                    best = i
            for i in range(v, len(origin)):
                if origin[i] == v:
                    reference[i] = best


@njit(**PLAIN)
def _gradient(P, W, target, exponents, scale, bary, powers, prefix, F, slopes, G, weights, gradient):
    """Slopes (v,) of half the squared distance by barycentric coordinates; returns the distance."""
    w = evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
    evaluate(W, target, exponents, scale, bary, powers, prefix, G, weights)
    square = 0.0
    for c in range(3):
        G[c] = F[c] / w
        square += G[c] * G[c]
    for v in range(len(gradient)):
        # Derivatives of F / w: (F_v - (F / w) w_v) / w.
        gradient[v] = 0.0
        for c in range(3):
            gradient[v] += G[c] * (slopes[v, c] - G[c] * weights[v, 0]) / w
    return np.sqrt(square)


@njit(**PLAIN)
def _descend(H, damping, right, step):
    """Solve (H + damping) step = right by Cholesky; False where that matrix is not positive definite."""
    a = H[0, 0] + damping
    if not a > 0.0:
        return False
    l10, l20 = H[1, 0] / a, H[2, 0] / a
    b = H[1, 1] + damping - l10 * H[1, 0]
    if not b > 1e-14 * (abs(H[1, 1]) + damping):
        return False
    c21 = H[2, 1] - l20 * H[1, 0]
    l21 = c21 / b
    c = H[2, 2] + damping - l20 * H[2, 0] - l21 * c21
    if not c > 1e-14 * (abs(H[2, 2]) + damping):
        return False
    y1 = right[1] - l10 * right[0]
    y2 = right[2] - l20 * right[0] - l21 * y1
    step[2] = y2 / c
    step[1] = y1 / b - l21 * step[2]
    step[0] = right[0] / a - l10 * step[1] - l20 * step[2]
    return True


@njit(**PLAIN)
def approach(nets, which, targets, exponents, scale, origin, centre, first, last, barycentric, distance):
    """Nearest point of given elements, by damped Newton with an active set; arguments as `invert`.

    Searches from the domain point of the nearest control point (pulled a little inside), and from the centre (v,).
    Coordinates that reach zero are held there, and released one by one while the slope pulls them back inside. Second
    derivatives are differences of first ones.
    """
    variables = exponents.shape[1]
    powers = np.empty((variables, exponents.max() + 1))
    prefix, bary, moved, change = np.empty(variables + 1), np.empty(variables), np.empty(variables), np.empty(variables)
    F, G, step, right = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    slopes, weights, H = np.empty((variables, 3)), np.empty((variables, 3)), np.empty((3, 3))
    gradient, other = np.empty(variables), np.empty(variables)
    held, reference = np.empty(variables, dtype=np.bool_), np.empty(variables, dtype=np.int64)
    target = np.empty(3)
    P, W = np.empty(nets.shape[1:]), np.zeros(nets.shape[1:])
    for m in range(first, last):
        recentre(nets[which[m]], targets[m], P, target)
        near, least = 0, np.inf
        for b in range(len(P)):
            W[b, 0] = P[b, 3]
            gap = 0.0
            for c in range(3):
                gap += (P[b, c] / P[b, 3] - target[c]) ** 2
            if gap < least:
                near, least = b, gap
        distance[m] = np.inf
        for s in range(2):
            for v in range(variables):
                degree = 0
                for i in range(variables):
                    if origin[i] == origin[v]:
                        degree += exponents[near, i]
                bary[v] = centre[v] if s == 1 else INSIDE * centre[v] + (1.0 - INSIDE) * exponents[near, v] / degree
            held[:] = False
            damping, released, residual = DAMPING, -1, np.inf
            for _ in range(ITERATIONS):
                residual = _gradient(
                    P, W, target, exponents, scale, bary, powers, prefix, F, slopes, G, weights, gradient
                )
                _reference(bary, origin, reference)
                H[:] = 0.0
                d = 0
                for v in range(variables):
                    if reference[v] == v:
                        continue
                    right[d] = 0.0
                    if not held[v]:
                        right[d] = gradient[reference[v]] - gradient[v]
                        moved[:] = bary
                        moved[v] += DIFFERENCE
                        moved[reference[v]] -= DIFFERENCE
                        _gradient(P, W, target, exponents, scale, moved, powers, prefix, F, slopes, G, weights, other)
                        row = 0
                        for i in range(variables):
                            if reference[i] != i:
                                if not held[i]:
                                    bend = other[i] - other[reference[i]] - gradient[i] + gradient[reference[i]]
                                    H[row, d] += 0.5 / DIFFERENCE * bend
                                    H[d, row] += 0.5 / DIFFERENCE * bend
                                row += 1
                    d += 1
                trace = abs(H[0, 0]) + abs(H[1, 1]) + abs(H[2, 2])
                progress, bound, trial = False, -1, residual
                for _attempt in range(ATTEMPTS):
                    if not _descend(H, damping * trace, right, step):
                        damping = 4.0 * damping
                        continue
                    change[:] = 0.0
                    d = 0
                    for v in range(variables):
                        if reference[v] != v:
                            if not held[v]:
                                change[v] += step[d]
                                change[reference[v]] -= step[d]
                            d += 1
                    reach, bound, size = 1.0, -1, 0.0
                    for v in range(variables):
                        size = max(size, abs(change[v]))
                        if bary[v] + reach * change[v] < 0.0:
                            reach, bound = bary[v] / -change[v], v
                    if not size > STILL:
                        break
                    if bound >= 0 and bound == released and reach <= 0.0:
                        # The slope of what was just released points inside: so does a shorter step.
                        damping *= 4.0
                        continue
                    for v in range(variables):
                        moved[v] = max(bary[v] + reach * change[v], 0.0)
                    if bound >= 0:
                        moved[bound] = 0.0
                    w = evaluate(P, target, exponents, scale, moved, powers, prefix, F, slopes)
                    trial = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
                    if trial < residual or (bound >= 0 and reach <= 0.0):
                        progress = True
                        break
                    damping *= 4.0
                if progress:
                    gain = residual - trial
                    residual = min(trial, residual)
                    bary[:] = moved
                    released = -1
                    if bound >= 0:
                        held[bound] = True
                    damping = max(damping / 16.0, LEAST_DAMPING)
                    if bound >= 0 or gain > STILL * residual:
                        continue
                # Stationary: release the coordinate that the slope pulls inside most.
                best, release = -PULL * residual, -1
                for v in range(variables):
                    if held[v] and gradient[v] - gradient[reference[v]] < best:
                        best, release = gradient[v] - gradient[reference[v]], v
                if release < 0:
                    break
                held[release] = False
                released = release
                damping = DAMPING
            if residual < distance[m]:
                distance[m] = residual
                barycentric[m] = bary
