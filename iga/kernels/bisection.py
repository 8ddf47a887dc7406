"""Compiled kernel of the Jacobian certificate: enclosing the least value of a polynomial or ratio by bisection.

The Bernstein coefficients of a piece bound its values from below, those at its vertices are values. De Casteljau's
algorithm halves a piece, and its coefficients come nearer to its values with the square of its size.

Axis letters: e element, k coefficient of det J, v vertex.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from iga.kernels.options import PLAIN


@njit(**PLAIN)
def _halve(row, other, entries, starts, first, last):
    """De Casteljau at 1/2 along lines first:last: the near half stays in ``row``, the far half goes to ``other``."""
    for line in range(first, last):
        a, b = starts[line], starts[line + 1]
        n = b - a - 1
        other[entries[b - 1]] = row[entries[b - 1]]
        for step in range(n):
            # Run backwards so that row[i] still holds the previous step's value.
            for i in range(n, step, -1):
                row[entries[a + i]] = 0.5 * (row[entries[a + i - 1]] + row[entries[a + i]])
            other[entries[b - 2 - step]] = row[entries[b - 1]]


@njit(**PLAIN)
def _least(numerator, weight):
    """Smallest coefficient, or ratio of coefficients."""
    least = np.inf
    if len(weight):
        for k in range(len(numerator)):
            least = min(least, numerator[k] / weight[k])
    else:
        for k in range(len(numerator)):
            least = min(least, numerator[k])
    return least


@njit(**PLAIN)
def _direction(numerator, weight, level, entries, starts, firsts):
    """Direction of the largest second difference of numerator - level * weight: where bisection helps most."""
    best, chosen = -1.0, 0
    for direction in range(len(firsts) - 1):
        largest = 0.0
        for line in range(firsts[direction], firsts[direction + 1]):
            for i in range(starts[line], starts[line + 1] - 2):
                j, k, m = entries[i], entries[i + 1], entries[i + 2]
                bend = numerator[j] - 2.0 * numerator[k] + numerator[m]
                if len(weight):
                    bend -= level * (weight[j] - 2.0 * weight[k] + weight[m])
                largest = max(largest, abs(bend))
        if largest > best:
            best, chosen = largest, direction
    return chosen


@njit(**PLAIN)
def bisect(
    numerators, weights, error, floor, tolerance, depth, budget, lines, pairs, corners, vertices, first, step, bounds,
    points,
):
    """Enclose the minimum of det J over each element by adaptive bisection.

    A piece is done with when the sign is decided on it (its least coefficient is above the error bound, or a value
    below minus the error bound has been found anywhere in the element, or the minimum touches zero within the error
    bound) and its least coefficient is no lower than ``min(floor, upper - tolerance |upper|)``.

    Parameters
    ----------
    numerators, weights : (e, k) coefficients of det J and nothing (e, 0), or of its numerator and of w^4.
    error : (e,) error bound of coefficients, det J units.
    depth, budget : most bisections along a branch, most pieces of an element.
    lines, pairs, corners : of `iga.determinant.splits`; ``vertices`` (v, 3) of the form's cell.
    first, step : this call works on every ``step``-th element from ``first`` on.
    bounds : (e, 2) result: smallest coefficient of the final pieces, smallest value found.
    points : (e, 3) result: where that value is attained, form coordinates.
    """
    entries, starts, firsts = lines
    size = numerators.shape[1]
    rational = weights.shape[1] > 0
    for e in range(first, numerators.shape[0], step):
        stack = np.empty((depth + 2, size))
        under = np.empty((depth + 2, weights.shape[1]))
        shape = np.empty((depth + 2, len(vertices), 3))
        level = np.empty(depth + 2, dtype=np.int64)
        least = np.empty(depth + 2)
        stack[0] = numerators[e]
        under[0] = weights[e]
        shape[0] = vertices
        level[0] = 0
        least[0] = _least(stack[0], under[0])
        upper = np.inf
        for v in range(len(corners)):
            value = numerators[e, corners[v]]
            if rational:
                value /= weights[e, corners[v]]
            if value < upper:
                upper = value
                points[e] = vertices[v]
        lower = np.inf
        top, pieces = 0, 1
        while top >= 0:
            low = least[top]
            decided = upper < -error[e] or low > error[e] or (upper <= error[e] and low >= -error[e])
            wanted = min(floor, upper - tolerance * abs(upper)) - error[e]
            if (decided and low >= wanted) or level[top] >= depth or pieces >= budget or not (low > -np.inf):
                lower = min(lower, low)
                top -= 1
                continue
            direction = _direction(stack[top], under[top], low, entries, starts, firsts)
            _halve(stack[top], stack[top + 1], entries, starts, firsts[direction], firsts[direction + 1])
            if rational:
                _halve(under[top], under[top + 1], entries, starts, firsts[direction], firsts[direction + 1])
            shape[top + 1] = shape[top]
            for p in range(pairs.shape[1]):
                i, j = pairs[direction, p, 0], pairs[direction, p, 1]
                if i >= 0:
                    for d in range(3):
                        middle = 0.5 * (shape[top, i, d] + shape[top, j, d])
                        shape[top, j, d] = middle
                        shape[top + 1, i, d] = middle
            level[top] += 1
            level[top + 1] = level[top]
            pieces += 1
            for piece in range(top, top + 2):
                least[piece] = _least(stack[piece], under[piece])
                for v in range(len(corners)):
                    value = stack[piece, corners[v]]
                    if rational:
                        value /= under[piece, corners[v]]
                    if value < upper:
                        upper = value
                        points[e] = shape[piece, v]
            if least[top + 1] > least[top]:
                # The lower piece goes on top, to be worked on first.
                for k in range(size):
                    stack[top, k], stack[top + 1, k] = stack[top + 1, k], stack[top, k]
                for k in range(weights.shape[1]):
                    under[top, k], under[top + 1, k] = under[top + 1, k], under[top, k]
                for v in range(len(vertices)):
                    for d in range(3):
                        shape[top, v, d], shape[top + 1, v, d] = shape[top + 1, v, d], shape[top, v, d]
                least[top], least[top + 1] = least[top + 1], least[top]
            top += 1
        bounds[e, 0] = lower
        bounds[e, 1] = upper
