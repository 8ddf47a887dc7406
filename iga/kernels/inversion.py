r"""Compiled kernel of point location: inversion of Bezier maps.

A rational map x = X / w is inverted on the polynomial system X(xi) - p w(xi) = sum_b B_b w_b (x_b - p) = 0, by damped
Newton in barycentric coordinates lambda, of which each simplex factor of the cell has one set (two for a line).

Axis letters: m target in an element, u distinct element, b Bernstein function, v barycentric coordinate, d direction.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from iga.kernels.options import PLAIN

ITERATIONS = 60
"""Most Newton steps from one start; a handful suffices where the map is close to affine."""
HALVINGS = 6
"""Most halvings of a Newton step that does not bring the point nearer."""
BEYOND = 0.3
"""How far outside the cell a step may lead, in barycentric coordinates: polynomials mean little there."""
BLOCKED = 1e-3
"""A step that may only go this part of its way leads outside: the point is put back into the cell."""
SINGULAR = 1e-7
"""Determinant, in products of the columns' lengths, below which a step is damped."""
DAMPING = 1e-10
"""Damping of such steps, in the mean square of the Jacobian's columns."""
STILL = 1e-15
"""Steps in barycentric coordinates, and parts of a distance, that are rounding."""
EXCLUDED, OPEN, FOUND, TESTED = -1, 0, 1, 2
"""What is known of a target in an element: not in it; nothing; where; nothing, and that tests cannot tell."""


@njit(**PLAIN)
def evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes):
    """F = sum_b B_b w_b (x_b - target), and its derivatives by barycentric coordinates, slopes (v, 3); returns w.

    ``P`` (b, 4) is (w (x - shift), w), and so is ``target`` relative to the shift.
    """
    variables = exponents.shape[1]
    for v in range(variables):
        powers[v, 0] = 1.0
        for i in range(1, powers.shape[1]):
            powers[v, i] = powers[v, i - 1] * bary[v]
    F[:] = 0.0
    slopes[:] = 0.0
    w = 0.0
    for b in range(len(scale)):
        x = P[b, 0] - target[0] * P[b, 3]
        y = P[b, 1] - target[1] * P[b, 3]
        z = P[b, 2] - target[2] * P[b, 3]
        prefix[0] = scale[b]
        for v in range(variables):
            prefix[v + 1] = prefix[v] * powers[v, exponents[b, v]]
        value = prefix[variables]
        F[0] += value * x
        F[1] += value * y
        F[2] += value * z
        w += value * P[b, 3]
        suffix = 1.0
        for v in range(variables - 1, -1, -1):
            e = exponents[b, v]
            if e > 0:
                slope = prefix[v] * suffix * e * powers[v, e - 1]
                slopes[v, 0] += slope * x
                slopes[v, 1] += slope * y
                slopes[v, 2] += slope * z
            suffix *= powers[v, e]
    return w


@njit(**PLAIN)
def _directions(slopes, origin, J):
    """Derivatives J (3, d) by reference coordinates; origin[v] is the first coordinate of v's simplex factor."""
    d = 0
    for v in range(len(origin)):
        if origin[v] != v:
            for c in range(3):
                J[c, d] = slopes[v, c] - slopes[origin[v], c]
            d += 1


@njit(**PLAIN)
def _solve(A, b, x):
    """Solve A x = b by cofactors; returns det A relative to the product of the column lengths."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    size = 1.0
    for d in range(3):
        size *= np.sqrt(A[0, d] ** 2 + A[1, d] ** 2 + A[2, d] ** 2)
    if not abs(det) > 1e-300:
        return 0.0
    x[0] = (
        c00 * b[0] + (A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2]) * b[1] + (A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]) * b[2]
    ) / det
    x[1] = (
        c01 * b[0] + (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) * b[1] + (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]) * b[2]
    ) / det
    x[2] = (
        c02 * b[0] + (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]) * b[1] + (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) * b[2]
    ) / det
    return abs(det) / size


@njit(**PLAIN)
def _damped(J, F, weight, normal, right, step):
    """Levenberg-Marquardt step of J step = -F, with ``weight`` relative to the mean of the diagonal of J^T J."""
    trace = 0.0
    for i in range(3):
        right[i] = -(J[0, i] * F[0] + J[1, i] * F[1] + J[2, i] * F[2])
        for j in range(3):
            normal[i, j] = J[0, i] * J[0, j] + J[1, i] * J[1, j] + J[2, i] * J[2, j]
        trace += normal[i, i]
    for i in range(3):
        normal[i, i] += weight * trace / 3.0
    return _solve(normal, right, step)


@njit(**PLAIN)
def _move(bary, step, origin, factor, moved):
    """Add a step in reference coordinates to barycentric ones."""
    for v in range(len(origin)):
        moved[v] = bary[v]
    d = 0
    for v in range(len(origin)):
        if origin[v] != v:
            moved[v] += factor * step[d]
            moved[origin[v]] -= factor * step[d]
            d += 1


@njit(**PLAIN)
def _project(bary, origin):
    """Nearest point of the cell: of each simplex factor, in its barycentric coordinates (exact for lines)."""
    v = 0
    while v < len(origin):
        end = v + 1
        while end < len(origin) and origin[end] == v:
            end += 1
        # Shift those that stay positive equally until the sum is one.
        active = 0
        while True:
            total, count = 0.0, 0
            for i in range(v, end):
                if bary[i] > 0.0:
                    total += bary[i]
                    count += 1
            shift = (1.0 - total) / count
            worst = False
            for i in range(v, end):
                if bary[i] > 0.0:
                    bary[i] += shift
                    if bary[i] < 0.0:
                        worst = True
                else:
                    bary[i] = 0.0
            active += 1
            if not worst or active > end - v:
                break
        v = end


@njit(**PLAIN)
def recentre(net, point, P, target):
    """Control points (b, 4) and a point, relative to the first one: so small elements far away keep their digits."""
    for c in range(3):
        shift = net[0, c] / net[0, 3]
        target[c] = point[c] - shift
        for b in range(len(P)):
            P[b, c] = net[b, c] - shift * net[b, 3]
    for b in range(len(P)):
        P[b, 3] = net[b, 3]


@njit(**PLAIN)
def _outside(P, target, J, slack, simplex):
    """Whether a linear functional separates the target from the control points, by more than ``slack``.

    The functionals are the rows of J^-1 and, for the tetrahedron, their sum; x lies in the hull of the x_b.
    """
    c = np.empty((4, 3))
    for d in range(3):
        a, b = (d + 1) % 3, (d + 2) % 3
        c[d, 0] = J[1, a] * J[2, b] - J[2, a] * J[1, b]
        c[d, 1] = J[2, a] * J[0, b] - J[0, a] * J[2, b]
        c[d, 2] = J[0, a] * J[1, b] - J[1, a] * J[0, b]
    for i in range(3):
        c[3, i] = c[0, i] + c[1, i] + c[2, i]
    for d in range(4 if simplex else 3):
        least, most = np.inf, -np.inf
        for b in range(len(P)):
            value = 0.0
            for i in range(3):
                value += c[d, i] * (P[b, i] - target[i] * P[b, 3])
            value /= P[b, 3]
            least = min(least, value)
            most = max(most, value)
        margin = slack * np.sqrt(c[d, 0] ** 2 + c[d, 1] ** 2 + c[d, 2] ** 2)
        if least > margin or most < -margin:
            return True
    return False


@njit(**PLAIN)
def invert(
    nets, which, targets, exponents, scale, origin, starts, tolerance, first, last, status, barycentric, distance
):
    """Find xi with x(xi) = target in given elements.

    Parameters
    ----------
    nets : (u, b, 4) control points (w x, w) of distinct elements, ``which`` (m,) the element of each target (m, 3).
    exponents, scale, origin : (b, v) and (b,) of the form; first barycentric coordinate of each one's factor (v,).
    starts : (s, v) barycentric coordinates to start from, one after the other until found.
    tolerance : largest accepted distance, and how far outside counts as on the boundary.
    status : (m,) result: EXCLUDED (proved not inside), FOUND, or as given. On input EXCLUDED is skipped, and only OPEN
        is tested for being outside.
    barycentric, distance : (m, v) and (m,) results where FOUND.
    """
    variables = exponents.shape[1]
    powers = np.empty((variables, exponents.max() + 1))
    prefix, bary, moved = np.empty(variables + 1), np.empty(variables), np.empty(variables)
    F, G, step, right, target = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    slopes, J, normal = np.empty((variables, 3)), np.empty((3, 3)), np.empty((3, 3))
    P = np.empty(nets.shape[1:])
    simplex = variables == 4
    for m in range(first, last):
        if status[m] == EXCLUDED:
            continue
        recentre(nets[which[m]], targets[m], P, target)
        for s in range(len(starts)):
            bary[:] = starts[s]
            w = evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
            if s == 0 and status[m] == OPEN:
                _directions(slopes, origin, J)
                if _outside(P, target, J, tolerance, simplex):
                    status[m] = EXCLUDED
                    break
            residual = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
            stuck = 0
            for _ in range(ITERATIONS):
                _directions(slopes, origin, J)
                for c in range(3):
                    right[c] = -F[c]
                if _solve(J, right, step) < SINGULAR:
                    _damped(J, F, DAMPING, normal, right, step)
                reach = 1.0
                _move(bary, step, origin, 1.0, moved)
                for v in range(variables):
                    if moved[v] < -BEYOND:
                        reach = min(reach, max(0.0, (bary[v] + BEYOND) / (bary[v] - moved[v])))
                if reach < BLOCKED:
                    stuck += 1
                    if stuck > 1:
                        break
                    _project(moved, origin)
                    bary[:] = moved
                    w = evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
                    residual = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
                    continue
                better = False
                for _halving in range(HALVINGS):
                    _move(bary, step, origin, reach, moved)
                    w = evaluate(P, target, exponents, scale, moved, powers, prefix, G, slopes)
                    trial = np.sqrt(G[0] ** 2 + G[1] ** 2 + G[2] ** 2) / w
                    if trial < residual:
                        better = True
                        break
                    reach *= 0.5
                if not better:
                    break
                change = 0.0
                for v in range(variables):
                    change = max(change, abs(moved[v] - bary[v]))
                bary[:] = moved
                F[:] = G
                residual = trial
                if change < STILL or residual == 0.0:
                    break
            lowest = bary.min()
            if lowest < 0.0:
                _project(bary, origin)
                w = evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
                residual = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
            if residual <= tolerance:
                status[m] = FOUND
                barycentric[m] = bary
                distance[m] = residual
                break
