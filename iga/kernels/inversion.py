r"""Compiled kernels of point location: boxes near a point, and inversion of Bezier maps.

Boxes form a complete binary tree in an array: node i has the children 2i and 2i + 1, leaves hold LEAF elements each.

A rational map x = X / w is inverted on the polynomial system X(xi) - p w(xi) = sum_b B_b w_b (x_b - p) = 0, by damped
Newton in barycentric coordinates lambda, of which each simplex factor of the cell has one set (two for a line).

Axis letters: p point, e element, u distinct element, b Bernstein function, v barycentric coordinate, d direction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from iga.kernels.options import OPTIONS

STRICT: dict[str, Any] = {**OPTIONS, "fastmath": False}

LEAF = 4
ITERATIONS = 60
EXCLUDED, OPEN, FOUND = -1, 0, 1


@njit(**STRICT)
def query(low, high, first_leaf, order, boxes_low, boxes_high, points, radius, first, last, start, found, key):
    """Elements whose box is within ``radius`` (p,) of each point; counts them, or writes them if ``found`` has room.

    Parameters
    ----------
    low, high : (nodes, 3) boxes of the tree; ``order`` (e,) elements along the leaves; ``first_leaf`` the first leaf.
    boxes_low, boxes_high : (e, 3) boxes of the elements.
    start : (p + 1,) counts go to start[p + 1]; when writing, where each point's entries begin.
    found, key : elements, and what to sort them by: the distance of the box, or inside it (negative) the closeness of
        the point to its centre.
    """
    stack = np.empty(128, dtype=np.int64)
    writing = len(found) > 0
    for p in range(first, last):
        limit = radius[p] * radius[p]
        count = 0
        stack[0] = 1
        top = 0
        while top >= 0:
            node = stack[top]
            top -= 1
            distance = 0.0
            for d in range(3):
                gap = max(low[node, d] - points[p, d], points[p, d] - high[node, d], 0.0)
                distance += gap * gap
            if not distance <= limit:
                continue
            if node < first_leaf:
                stack[top + 1] = 2 * node
                stack[top + 2] = 2 * node + 1
                top += 2
                continue
            for i in range((node - first_leaf) * LEAF, min((node - first_leaf + 1) * LEAF, len(order))):
                e = order[i]
                distance, inside = 0.0, 0.0
                for d in range(3):
                    a, b = boxes_low[e, d], boxes_high[e, d]
                    gap = max(a - points[p, d], points[p, d] - b, 0.0)
                    distance += gap * gap
                    inside = max(inside, abs(2.0 * points[p, d] - a - b) / max(b - a, 1e-300))
                if distance <= limit:
                    if writing:
                        found[start[p] + count] = e
                        key[start[p] + count] = np.sqrt(distance) if distance > 0.0 else inside - 1.0
                    count += 1
        if not writing:
            start[p + 1] = count


@njit(**STRICT)
def _evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes):
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


@njit(**STRICT)
def _directions(slopes, origin, J):
    """Derivatives J (3, d) by reference coordinates; origin[v] is the first coordinate of v's simplex factor."""
    d = 0
    for v in range(len(origin)):
        if origin[v] != v:
            for c in range(3):
                J[c, d] = slopes[v, c] - slopes[origin[v], c]
            d += 1


@njit(**STRICT)
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


@njit(**STRICT)
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


@njit(**STRICT)
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


@njit(**STRICT)
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


@njit(**STRICT)
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


@njit(**STRICT)
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
    status : (m,) result: EXCLUDED (proved not inside), OPEN or FOUND; entries EXCLUDED on input are skipped.
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
        # Work relative to the element's first control point, so that small elements far away keep their digits.
        net = nets[which[m]]
        for c in range(3):
            shift = net[0, c] / net[0, 3]
            target[c] = targets[m, c] - shift
            for b in range(len(P)):
                P[b, c] = net[b, c] - shift * net[b, 3]
        for b in range(len(P)):
            P[b, 3] = net[b, 3]
        for s in range(len(starts)):
            bary[:] = starts[s]
            w = _evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
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
                if _solve(J, right, step) < 1e-7:
                    _damped(J, F, 1e-10, normal, right, step)
                # Not further than 0.3 outside the cell.
                reach = 1.0
                _move(bary, step, origin, 1.0, moved)
                for v in range(variables):
                    if moved[v] < -0.3:
                        reach = min(reach, max(0.0, (bary[v] + 0.3) / (bary[v] - moved[v])))
                if reach < 1e-3:
                    stuck += 1
                    if stuck > 1:
                        break
                    _project(moved, origin)
                    bary[:] = moved
                    w = _evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
                    residual = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
                    continue
                better = False
                for _halving in range(6):
                    _move(bary, step, origin, reach, moved)
                    w = _evaluate(P, target, exponents, scale, moved, powers, prefix, G, slopes)
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
                if change < 1e-15 or residual == 0.0:
                    break
            lowest = bary.min()
            if lowest < 0.0:
                _project(bary, origin)
                w = _evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
                residual = np.sqrt(F[0] ** 2 + F[1] ** 2 + F[2] ** 2) / w
            if residual <= tolerance:
                status[m] = FOUND
                barycentric[m] = bary
                distance[m] = residual
                break


@njit(**STRICT)
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


@njit(**STRICT)
def _gradient(P, W, target, exponents, scale, bary, powers, prefix, F, slopes, G, weights, gradient):
    """Slopes (v,) of half the squared distance by barycentric coordinates; returns the distance."""
    w = _evaluate(P, target, exponents, scale, bary, powers, prefix, F, slopes)
    _evaluate(W, target, exponents, scale, bary, powers, prefix, G, weights)
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


@njit(**STRICT)
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


@njit(**STRICT)
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
        net = nets[which[m]]
        for c in range(3):
            shift = net[0, c] / net[0, 3]
            target[c] = targets[m, c] - shift
            for b in range(len(P)):
                P[b, c] = net[b, c] - shift * net[b, 3]
        near, least = 0, np.inf
        for b in range(len(P)):
            P[b, 3] = net[b, 3]
            W[b, 0] = net[b, 3]
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
                bary[v] = centre[v] if s == 1 else 0.2 * centre[v] + 0.8 * exponents[near, v] / degree
            held[:] = False
            damping, released, residual = 1e-6, -1, np.inf
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
                        moved[v] += 1e-6
                        moved[reference[v]] -= 1e-6
                        _gradient(P, W, target, exponents, scale, moved, powers, prefix, F, slopes, G, weights, other)
                        row = 0
                        for i in range(variables):
                            if reference[i] != i:
                                if not held[i]:
                                    bend = other[i] - other[reference[i]] - gradient[i] + gradient[reference[i]]
                                    H[row, d] += 0.5e6 * bend
                                    H[d, row] += 0.5e6 * bend
                                row += 1
                    d += 1
                trace = abs(H[0, 0]) + abs(H[1, 1]) + abs(H[2, 2])
                progress, bound, trial = False, -1, residual
                for _attempt in range(30):
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
                    if not size > 1e-15:
                        break
                    if bound >= 0 and bound == released and reach <= 0.0:
                        # The slope of what was just released points inside: so does a shorter step.
                        damping *= 4.0
                        continue
                    for v in range(variables):
                        moved[v] = max(bary[v] + reach * change[v], 0.0)
                    if bound >= 0:
                        moved[bound] = 0.0
                    w = _evaluate(P, target, exponents, scale, moved, powers, prefix, F, slopes)
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
                    damping = max(damping / 16.0, 1e-12)
                    if bound >= 0 or gain > 1e-15 * residual:
                        continue
                # Stationary: release the coordinate that the slope pulls inside most.
                best, release = -1e-13 * residual, -1
                for v in range(variables):
                    if held[v] and gradient[v] - gradient[reference[v]] < best:
                        best, release = gradient[v] - gradient[reference[v]], v
                if release < 0:
                    break
                held[release] = False
                released = release
                damping = 1e-6
            if residual < distance[m]:
                distance[m] = residual
                barycentric[m] = bary
