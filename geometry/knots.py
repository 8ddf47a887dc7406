r"""Univariate splines: knot vectors, blossoms, and the linear maps that knot insertion, elevation and extraction are.

A spline of degree p on knots t is F(x) = sum_i c_i N_i(x). On a knot interval [t_mu, t_mu+1) its blossom
f(x_1, .., x_p), the symmetric multi-affine map with f(x, .., x) = F(x), is a combination of the p+1 coefficients
mu-p .. mu. One routine, `blossom`, returns these combinations, and everything else is a choice of arguments:

    evaluation          f(x, .., x)
    knot insertion      new coefficient i = f(s_i+1, .., s_i+p), s the finer knots (Oslo algorithm, Cohen, Lyche and
                        Riesenfeld 1980)
    degree elevation    new coefficient i = mean over j of f(s_i+1, .., s_i+p+1 without s_i+j)
    Bezier extraction   coefficient b on [a, c] = f(a, .., a, c, .., c) with b times c

All combinations are convex inside the knot interval, so nothing loses digits. Knots are compared exactly: `snap` makes
nearly equal knots equal first.

Axis letters: m row (new coefficient or point), e knot interval, n function on the interval, b Bernstein function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_DEGREE = 30
"""A degree above this is taken for damage or a typing error."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Banded matrix: row m has ``values`` (m, k) in the columns ``first[m] .. first[m] + k - 1``."""

    first: Index
    values: Array


def apply(rows: Rows, coefficients: Array, axis: int) -> Array:
    """Multiply one axis of an array of coefficients by a banded matrix."""
    moved = np.moveaxis(coefficients, axis, 0)
    shape = (len(rows.first),) + (1,) * (moved.ndim - 1)
    result = rows.values[:, 0].reshape(shape) * moved[rows.first]
    for k in range(1, rows.values.shape[1]):
        result += rows.values[:, k].reshape(shape) * moved[rows.first + k]
    return np.ascontiguousarray(np.moveaxis(result, 0, axis))


def snap(knots: Array) -> Array:
    """Make knots equal that differ by less than 1e-10 of the knot vector's length, (k,)."""
    cluster = np.concatenate([[0], np.cumsum(np.diff(knots) > 1e-10 * (knots[-1] - knots[0]))])
    return knots[np.unique(cluster, return_index=True)[1]][cluster]


def check_knots(knots: Array, degree: int, n: int, where: str) -> None:
    """Refuse a knot vector that does not belong to n continuous functions of a degree.

    Raises
    ------
    InputError : naming ``where``.
    """
    if not 1 <= degree <= MAX_DEGREE:
        raise InputError(f"{where}: degree {degree} is not between 1 and {MAX_DEGREE}")
    if len(knots) != n + degree + 1:
        needed = n + degree + 1
        raise InputError(f"{where}: {n} control points of degree {degree} need {needed} knots, not {len(knots)}")
    if n < degree + 1:
        raise InputError(f"{where}: degree {degree} needs at least {degree + 1} control points, not {n}")
    if not np.isfinite(knots).all():
        raise InputError(f"{where}: knot {np.flatnonzero(~np.isfinite(knots))[0]} is not a finite number")
    fall = np.flatnonzero(np.diff(knots) < 0)
    if len(fall):
        i = int(fall[0])
        raise InputError(f"{where}: knots decrease from {knots[i]:g} to {knots[i + 1]:g} at position {i + 1}")
    if not knots[degree] < knots[n]:
        raise InputError(f"{where}: the knot vector has no interval of positive length")
    inner = knots[(knots > knots[degree]) & (knots < knots[n])]
    values, counts = np.unique(inner, return_counts=True)
    if len(counts) and counts.max() > degree:
        worst = int(counts.argmax())
        raise InputError(
            f"{where}: knot {values[worst]:g} is repeated {counts[worst]} times, which tears degree {degree} apart; "
            f"split the patch there"
        )


def breakpoints(knots: Array) -> tuple[Array, Index]:
    """Distinct knots and how often each is repeated."""
    values, counts = np.unique(knots, return_counts=True)
    return values, counts.astype(np.int64)


def find_spans(knots: Array, degree: int, x: Array) -> Index:
    """Number mu of the knot interval t_mu <= x < t_mu+1 of each x (the last interval at the end), (m,)."""
    n = len(knots) - degree - 1
    return np.clip(np.searchsorted(knots, x, side="right") - 1, degree, n - 1).astype(np.int64)


def blossom(knots: Array, degree: int, spans: Index, arguments: Array) -> Rows:
    """Coefficients of blossom values.

    Parameters
    ----------
    knots : (n + degree + 1,)
    spans : (m,) knot interval on which each blossom is meant.
    arguments : (m, degree) its arguments, in any order.

    Returns
    -------
    Rows of degree + 1 entries: value m is ``sum_k values[m, k] c[first[m] + k]``.
    """
    values = np.zeros((len(spans), degree + 1))
    values[:, 0] = 1.0
    for k in range(1, degree + 1):
        x = arguments[:, k - 1]
        for j in range(k - 1, -1, -1):
            low, high = knots[spans + 1 - k + j], knots[spans + 1 + j]
            upper = (x - low) / (high - low)
            values[:, j + 1] += upper * values[:, j]
            values[:, j] *= 1.0 - upper
    return Rows(spans - degree, values)


def evaluation(knots: Array, degree: int, x: Array) -> Rows:
    """Values of the functions at points x (m,), as rows."""
    return blossom(knots, degree, find_spans(knots, degree, x), np.broadcast_to(x[:, None], (len(x), degree)))


def derivative(knots: Array, degree: int, x: Array) -> Rows:
    """First derivatives of the functions at points x (m,), as rows."""
    spans = find_spans(knots, degree, x)
    lower = blossom(knots, degree - 1, spans, np.broadcast_to(x[:, None], (len(x), degree - 1))).values
    values = np.zeros((len(x), degree + 1))
    for j in range(degree):
        slope = degree / (knots[spans + 1 + j] - knots[spans + 1 - degree + j]) * lower[:, j]
        values[:, j + 1] += slope
        values[:, j] -= slope
    return Rows(spans - degree, values)


def insertion(knots: Array, degree: int, fine: Array) -> Rows:
    """Coefficients on finer knots from those on ``knots``; every knot must occur in ``fine``."""
    n = len(fine) - degree - 1
    arguments = np.lib.stride_tricks.sliding_window_view(fine[1:], degree)[:n]
    return blossom(knots, degree, find_spans(knots, degree, fine[:n]), arguments)


def elevation(knots: Array, degree: int) -> tuple[Array, Rows]:
    """Raise the degree by one at equal continuity: the knots of degree + 1 and the coefficients' matrix."""
    values, counts = breakpoints(knots)
    fine = np.repeat(values, counts + 1)
    n = len(fine) - degree - 2
    windows = np.lib.stride_tricks.sliding_window_view(fine[1:], degree + 1)[:n]
    spans = find_spans(knots, degree, fine[:n])
    total = np.zeros((n, degree + 1))
    for j in range(degree + 1):
        total += blossom(knots, degree, spans, np.delete(windows, j, axis=1)).values
    return fine, Rows(spans - degree, total / (degree + 1))


def bisected(knots: Array, levels: int = 1) -> Array:
    """Knots with every interval halved ``levels`` times by simple knots."""
    for _ in range(levels):
        values = np.unique(knots)
        knots = np.sort(np.concatenate([knots, 0.5 * (values[1:] + values[:-1])]))
    return knots


def extraction(knots: Array, degree: int) -> tuple[Array, Index]:
    """Bezier extraction on each knot interval of positive length.

    Returns
    -------
    C : (e, degree + 1, degree + 1) with N_n = sum_b C[e, n, b] B_b on interval e.
    first : (e,) number of the first function on each interval.
    """
    ends = np.unique(knots)
    spans = find_spans(knots, degree, ends[:-1])
    upper = np.tri(degree + 1, degree, -1)[None]  # argument k of coefficient b is the right end when k < b
    arguments = (1.0 - upper) * ends[:-1, None, None] + upper * ends[1:, None, None]
    rows = blossom(knots, degree, np.repeat(spans, degree + 1), arguments.reshape(-1, degree))
    return np.swapaxes(rows.values.reshape(-1, degree + 1, degree + 1), 1, 2), spans - degree


def distinct(C: Array) -> tuple[Array, Index]:
    """Distinct operators among (e, n, b), equal up to 5e-13, and which one each interval has."""
    keys = np.round(C.reshape(len(C), -1), 12) + 0.0
    _, kept, pattern = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return np.ascontiguousarray(C[kept]), pattern.reshape(-1).astype(np.int64)


def normalised(knots: Array) -> Array:
    """Knots mapped to [0, 1]."""
    return (knots - knots[0]) / (knots[-1] - knots[0])


def reversed_knots(knots: Array) -> Array:
    """Knots of the same curve run backwards."""
    return np.ascontiguousarray((knots[0] + knots[-1]) - knots[::-1])


def common(members: list[tuple[Array, int]], tolerance: float = 1e-6) -> tuple[Array, int]:
    """Coarsest normalised knot vector and degree whose splines hold those of all members.

    Parameters
    ----------
    members : (knots, degree) of each.
    tolerance : normalised knots closer than this are one knot, at the place where the first member has it (less, if
        a member has such short intervals itself).
    """
    tolerance = min(tolerance, *(0.1 * np.diff(np.unique(normalised(t))).min() for t, _ in members))
    degree = max(p for _, p in members)
    values, counts, order = [], [], []
    for number, (knots, p) in enumerate(members):
        places, repeats = breakpoints(normalised(knots))
        values.append(places)
        counts.append(repeats + (degree - p))
        order.append(np.full(len(places), number))
    place, count, member = (np.concatenate(x) for x in (values, counts, order))
    sort = np.lexsort((member, place))
    place, count, member = place[sort], count[sort], member[sort]
    cluster = np.concatenate([[0], np.cumsum(np.diff(place) > tolerance)])
    first = np.lexsort((member, cluster))[np.unique(np.sort(cluster), return_index=True)[1]]
    repeats = np.zeros(cluster[-1] + 1, dtype=np.int64)
    np.maximum.at(repeats, cluster, count)
    return np.repeat(place[first], repeats), degree
