"""Adding element vectors and matrices to global ones, of a symmetric matrix to the entries with row <= column.

Slots of the entries are computed once for a space (`iga.sparsity`): of functions i and j on an element, the row of the
lower number and the place within it. With c components an entry is c x c numbers, rows of one function together.

Axis letters: e element, n function on the element, N function of the space, c component.
"""

from __future__ import annotations

import numba
import numpy as np

from iga.kernels.options import OPTIONS


@numba.njit(**OPTIONS)
def scatter_symmetric(K, place, offset, dofs, scale, scaled, begin, length, c, a, twice, values):
    """Add a symmetric element matrix to the entries row <= column of components (a, a).

    Parameters
    ----------
    K, place : the matrix, and where in it the pairs i <= j are, row by row.
    offset : slots of the element (`iga.sparsity.Slots`).
    dofs, scale : (n,) function numbers and factors of the functions, which are one if not ``scaled``.
    begin, length : (N,) first entry of each row with c components, and number of functions in it.
    twice : whether the element may have one function twice; its two diagonal entries and both others then meet.
    """
    n = len(dofs)
    start = np.empty(n, np.int64)
    for i in range(n):
        start[i] = begin[dofs[i]] + a * c * length[dofs[i]] + a
    t = 0
    for i in range(n):
        w = n - i
        where, step = place[t : t + w], offset[t : t + w]
        number, row, first, factor = dofs[i:], start[i:], start[i], scale[i:]
        for j in range(w):
            value = K[np.uintp(where[j])]
            if scaled:
                value *= factor[0] * factor[j]
            at = np.uintp((first if number[0] <= number[j] else row[j]) + c * step[j])
            values[at] += value
            if twice and j > 0 and number[0] == number[j]:
                values[at] += value
        t += w


@numba.njit(**OPTIONS)
def scatter_general(K, place, L, lower, offset, dofs, scale, scaled, begin, length, c, a, b, twice, values):
    """Add an element matrix of components (a, b), and its transpose to (b, a), to the entries row <= column.

    Parameters
    ----------
    K, place : the matrix, and where in it entries (i, j), i <= j, are.
    L, lower : the same for entries (j, i), i <= j.
    """
    n = len(dofs)
    start = np.empty(n, np.int64)
    other = np.empty(n, np.int64)
    for i in range(n):
        start[i] = begin[dofs[i]] + a * c * length[dofs[i]] + b
        other[i] = begin[dofs[i]] + b * c * length[dofs[i]] + a
    t = 0
    for i in range(n):
        w = n - i
        upper, under, step = place[t : t + w], lower[t : t + w], offset[t : t + w]
        number, rows, others, factor = dofs[i:], start[i:], other[i:], scale[i:]
        row, opposite_row = start[i], other[i]
        for j in range(w):
            value, opposite = K[np.uintp(upper[j])], L[np.uintp(under[j])]
            if scaled:
                value *= factor[0] * factor[j]
                opposite *= factor[0] * factor[j]
            above = number[0] <= number[j]
            at = np.uintp((row if above else others[j]) + c * step[j])
            against = np.uintp((opposite_row if above else rows[j]) + c * step[j])
            values[at] += value
            values[against] += opposite
            if twice and j > 0 and number[0] == number[j]:
                values[at] += opposite
                values[against] += value
        t += w


@numba.njit(**OPTIONS)
def scatter_matrices(
    K, place, lower, offset, table, dofs, scale, scaled, begin, length, c, a, b, twice, values
):
    """Scatter ready element matrices, (e, entries): symmetric ones of components (a, a), or of (a, b) with a < b."""
    for e in range(dofs.shape[0]):
        k = table[e]
        if a == b:
            scatter_symmetric(K[e], place, offset[k], dofs[e], scale[e], scaled, begin, length, c, a, twice, values)
        else:
            scatter_general(
                K[e], place, K[e], lower, offset[k], dofs[e], scale[e], scaled, begin, length, c, a, b, twice, values
            )


@numba.njit(**OPTIONS)
def add_vectors(local, dofs, scale, vector):
    """vector[dofs[e, i], c] += scale[e, i] local[e, c, i]."""
    for e in range(dofs.shape[0]):
        for c in range(local.shape[1]):
            for i in range(dofs.shape[1]):
                vector[dofs[e, i], c] += scale[e, i] * local[e, c, i]
