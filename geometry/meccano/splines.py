r"""B-splines of one variable with open uniform knots on [0, 1], as small tables.

At level l there are 2^l knot intervals and 2^l + p functions of degree p; on interval c the functions c, ..., c + p
act. Function i has the inner knots t_{i+1}, ..., t_{i+p} with t_m = clamp(m - p, 0, 2^l) / 2^l, and the coefficient of
i of a polynomial f on any interval of its support is the blossom of f at them. All tables follow from blossoms:

    Bezier extraction    N_i = sum_b E[i, b] B_b               blossom of N_i at (0^(p-b), 1^b)
    refinement           N_i = sum_j R[i, j] n_j, n finer      blossom of N_i at the inner knots of n_j

They depend on an interval only through its distances from the two ends, counted up to p - 1, and are computed in exact
fractions, so that what vanishes is zero.

Axis letters: i function on the interval, j finer function, b Bernstein function, q point.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def window(place: Index, level: int | Index, degree: int) -> tuple[Index, Index]:
    """Distances of intervals from the left and the right end, up to ``degree`` - 1: the leading indices of tables."""
    last = np.left_shift(1, level) - 1
    return np.minimum(place, degree - 1), np.minimum(last - place, degree - 1)


@cache
def bezier_table(degree: int) -> Array:
    """Extraction operators E (left, right, i, b)."""
    p = degree
    made = np.empty((p, p, p + 1, p + 1))
    for left in range(p):
        for right in range(p):
            ends = [Fraction(left)] * p + [Fraction(left + 1)] * p
            for b in range(p + 1):
                made[left, right, :, b] = _blossom(p, left + right + 1, left, ends[b : b + p])
    return made


@cache
def refinement_table(degree: int) -> Array:
    """Refinement R (left, right, half, i, j): interval c into its half 2c + half."""
    p = degree
    made = np.empty((p, p, 2, p + 1, p + 1))
    for left in range(p):
        for right in range(p):
            intervals = left + right + 1
            for half in (0, 1):
                for j in range(p + 1):
                    finer = 2 * left + half + j
                    inner = [Fraction(min(max(m - p, 0), 2 * intervals), 2) for m in range(finer + 1, finer + 1 + p)]
                    made[left, right, half, :, j] = _blossom(p, intervals, left, inner)
    return made


def _blossom(p: int, intervals: int, c: int, at: Sequence[Fraction]) -> list[float]:
    """Values (p + 1) at p arguments of the blossoms of the functions on interval c of unit intervals."""

    def knot(m: int) -> int:
        return min(max(m - p, 0), intervals)

    rows = [[Fraction(int(i == j)) for i in range(p + 1)] for j in range(p + 1)]
    for r, u in enumerate(at, start=1):
        for j in range(p, r - 1, -1):
            low, high = knot(c + j), knot(c + j + p + 1 - r)
            share = (u - low) / (high - low)
            rows[j] = [(1 - share) * a + share * b for a, b in zip(rows[j - 1], rows[j])]
    return [float(value) for value in rows[p]]


def functional(index: Index, level: Index, place: Array, size: Array, degree: int) -> Array:
    """Weights (q, b) on Bernstein coefficients over an interval that give the coefficient of a function.

    Parameters
    ----------
    index, level : (q,) the functions.
    place, size : (q,) intervals [place, place + size] on which the polynomials are given, inside the supports.
    """
    p = degree
    scale = np.ldexp(1.0, -level)
    weights = np.zeros((len(index), p + 1))
    weights[:, 0] = 1.0
    for r in range(1, p + 1):
        knot = np.clip(index + r - p, 0, np.left_shift(1, level)) * scale
        u = ((knot - place) / size)[:, None]
        weights[:, 1:] = (1 - u) * weights[:, 1:] + u * weights[:, :-1]
        weights[:, :1] *= 1 - u
    return weights
