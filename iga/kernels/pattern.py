"""Kernels behind `iga.sparsity`: which functions meet, and where their entries are.

Elements are given as flat lists: element k acts on functions ``dofs[first[k]:first[k + 1]]``. A row's columns relative
to the row itself, and an element's functions relative to its first one, repeat throughout regular meshes. Rows and
elements that are equal in this sense form a class, found by 64-bit hashes, and only one of each is searched.
"""

from __future__ import annotations

import numba
import numpy as np

from iga.kernels.options import OPTIONS

_INTEGER = {k: v for k, v in OPTIONS.items() if k != "fastmath"}


@numba.njit(inline="always", **_INTEGER)
def _mix(key, value):
    """Combine a 64-bit key with a value (the finaliser of splitmix64)."""
    z = key ^ (np.uint64(value) + np.uint64(0x9E3779B97F4A7C15) + (key << np.uint64(6)))
    z *= np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(**_INTEGER)
def element_keys(first, dofs, keys, lo, hi):
    """Hash of each element's functions relative to its first one."""
    for k in range(lo, hi):
        base = dofs[first[k]]
        key = np.uint64(first[k + 1] - first[k])
        for s in range(first[k] + 1, first[k + 1]):
            key = _mix(key, dofs[s] - base)
        keys[k] = key


@numba.njit(**_INTEGER)
def incidence(first, dofs, n):
    """Elements on each function: start (n + 1,) and the elements, ascending, an element once per appearance."""
    start = np.zeros(n + 1, np.int64)
    for s in range(len(dofs)):
        start[dofs[s] + 1] += 1
    for r in range(n):
        start[r + 1] += start[r]
    cursor = start[:-1].copy()
    elements = np.empty(len(dofs), np.int32)
    for k in range(len(first) - 1):
        for s in range(first[k], first[k + 1]):
            r = dofs[s]
            elements[cursor[r]] = k
            cursor[r] += 1
    return start, elements


@numba.njit(**_INTEGER)
def row_keys(first, dofs, element_key, start, elements, keys, lo, hi):
    """Hash of the elements around each function, relative to that function."""
    for r in range(lo, hi):
        key = np.uint64(start[r + 1] - start[r])
        for s in range(start[r], start[r + 1]):
            k = elements[s]
            key = _mix(_mix(key, element_key[k]), dofs[first[k]] - r)
        keys[r] = key


@numba.njit(**_INTEGER)
def columns(first, dofs, start, elements, rows, n, ordered):
    """Columns of some rows, relative to the row, sorted if ``ordered``: pointers (len(rows) + 1,) and columns."""
    seen = np.full(n, -1, np.int64)
    pointers = np.zeros(len(rows) + 1, np.int64)
    found = np.empty(1024, np.int32)
    count = 0
    for s in range(len(rows)):
        r = rows[s]
        begin = count
        for t in range(start[r], start[r + 1]):
            k = elements[t]
            size = first[k + 1] - first[k]
            if count + size > len(found):
                grown = np.empty(2 * len(found) + size, np.int32)
                grown[:count] = found[:count]
                found = grown
            for u in range(first[k], first[k + 1]):
                c = dofs[u]
                if seen[c] != s:
                    seen[c] = s
                    found[count] = c - r
                    count += 1
        if ordered:
            found[begin:count].sort()
        pointers[s + 1] = count
    return pointers, found[:count].copy()


@numba.njit(**_INTEGER)
def transpose(indptr, relative, indices):
    """Sorted columns of a symmetric pattern from unsorted ones relative to the row: those of its transpose."""
    cursor = indptr[:-1].copy()
    for r in range(len(indptr) - 1):
        for k in range(indptr[r], indptr[r + 1]):
            column = r + relative[k]
            indices[cursor[column]] = r
            cursor[column] += 1


@numba.njit(**_INTEGER)
def fill(indptr, kind, pointers, relative, indices, lo, hi):
    """Column numbers of all rows from those of their classes."""
    for r in range(lo, hi):
        s, t = indptr[r], pointers[kind[r]]
        for k in range(indptr[r + 1] - s):
            indices[s + k] = r + relative[t + k]


@numba.njit(**_INTEGER)
def slot_keys(first, dofs, element_key, kind, keys, lo, hi):
    """Hash of each element with the classes of its rows: equal ones have equal slots."""
    for k in range(lo, hi):
        key = element_key[k]
        for s in range(first[k], first[k + 1]):
            key = _mix(key, kind[dofs[s]])
        keys[k] = key


@numba.njit(**_INTEGER)
def slots(dofs, indptr, indices, offset, lo, hi):
    """Places in their rows of all pairs of functions on some elements.

    Parameters
    ----------
    dofs : (k, n) functions of the elements.
    offset : (k, n (n+1)/2), filled: for each pair i <= j of local functions, row by row, the place of the larger
        function number in the row of the smaller.

    Returns
    -------
    Whether some element has one function twice.
    """
    n = dofs.shape[1]
    twice = False
    for k in range(lo, hi):
        order = np.argsort(dofs[k], kind="mergesort")
        for a in range(n):
            i = order[a]
            row = dofs[k, i]
            twice |= a > 0 and row == dofs[k, order[a - 1]]
            begin = indptr[row]
            low, high = begin, indptr[row + 1]
            while low < high:
                middle = (low + high) // 2
                if indices[middle] < row:
                    low = middle + 1
                else:
                    high = middle
            for b in range(a, n):
                j = order[b]
                while indices[low] != dofs[k, j]:
                    low += 1
                first, second = min(i, j), max(i, j)
                offset[k, first * n - first * (first - 1) // 2 + second - first] = low - begin
    return twice


@numba.njit(**_INTEGER)
def mirror(indptr, indices, values, c, lo, hi):
    """Fill the lower half of a symmetric matrix with c x c entries for columns (of the upper half) lo <= column < hi.

    Entry (r, a; k, b) of the k-th column in row r is at ``c*c*indptr[r] + a*c*len[r] + c*k + b``.
    """
    cursor = indptr[lo:hi].copy()
    for r in range(hi):
        low, high = indptr[r], indptr[r + 1]
        length = high - low
        target = max(r + 1, lo)
        left, right = low, high
        while left < right:
            middle = (left + right) // 2
            if indices[middle] < target:
                left = middle + 1
            else:
                right = middle
        for s in range(left, high):
            column = indices[s]
            if column >= hi:
                break
            t = cursor[column - lo]
            cursor[column - lo] += 1
            begin = indptr[column]
            below = indptr[column + 1] - begin
            for a in range(c):
                for b in range(c):
                    values[c * c * begin + b * c * below + c * (t - begin) + a] = values[
                        c * c * low + a * c * length + c * (s - low) + b
                    ]


@numba.njit(**_INTEGER)
def expand(indptr, indices, c, expanded, lo, hi):
    """Column numbers of a matrix with c x c entries."""
    for r in range(lo, hi):
        begin = indptr[r]
        length = indptr[r + 1] - begin
        for a in range(c):
            t = c * c * begin + a * c * length
            for k in range(length):
                for b in range(c):
                    expanded[t + c * k + b] = c * indices[begin + k] + b


@numba.njit(**OPTIONS)
def diagonals(indptr, indices):
    """Place of the diagonal in each row, (n,)."""
    n = len(indptr) - 1
    place = np.empty(n, np.int64)
    for r in range(n):
        low, high = indptr[r], indptr[r + 1]
        while low < high:
            middle = (low + high) // 2
            if indices[middle] < r:
                low = middle + 1
            else:
                high = middle
        place[r] = low
    return place


@numba.njit(**OPTIONS)
def symmetric_product(indptr, indices, diagonal, values, x, y, lo, hi):
    """Add to y (n,) what rows lo..hi of the upper half give: rows of y by rows, columns by the transpose."""
    for r in range(lo, hi):
        mine = x[r]
        s = values[diagonal[r]] * mine
        for k in range(diagonal[r] + 1, indptr[r + 1]):
            column = np.uintp(indices[k])
            s += values[k] * x[column]
            y[column] += values[k] * mine
        y[r] += s


@numba.njit(**OPTIONS)
def symmetric_product_block(indptr, indices, diagonal, values, x, y, lo, hi):
    """Do as `symmetric_product` with 3 x 3 entries, x and y (n, 3)."""
    for r in range(lo, hi):
        begin, end = indptr[r], indptr[r + 1]
        width = 3 * (end - begin)
        first = 9 * begin
        m0, m1, m2 = x[r, 0], x[r, 1], x[r, 2]
        s0, s1, s2 = 0.0, 0.0, 0.0
        for k in range(diagonal[r], end):
            column = np.uintp(indices[k])
            p = np.uintp(first + 3 * (k - begin))
            q, t = p + np.uintp(width), p + np.uintp(2 * width)
            a0, a1, a2 = values[p], values[p + np.uintp(1)], values[p + np.uintp(2)]
            b0, b1, b2 = values[q], values[q + np.uintp(1)], values[q + np.uintp(2)]
            c0, c1, c2 = values[t], values[t + np.uintp(1)], values[t + np.uintp(2)]
            u0, u1, u2 = x[column, 0], x[column, 1], x[column, 2]
            s0 += a0 * u0 + a1 * u1 + a2 * u2
            s1 += b0 * u0 + b1 * u1 + b2 * u2
            s2 += c0 * u0 + c1 * u1 + c2 * u2
            if k > diagonal[r]:
                y[column, 0] += a0 * m0 + b0 * m1 + c0 * m2
                y[column, 1] += a1 * m0 + b1 * m1 + c1 * m2
                y[column, 2] += a2 * m0 + b2 * m1 + c2 * m2
        y[r, 0] += s0
        y[r, 1] += s1
        y[r, 2] += s2


@numba.njit(**_INTEGER)
def touched(dofs, used):
    """Mark the functions of some elements."""
    for e in range(dofs.shape[0]):
        for i in range(dofs.shape[1]):
            used[dofs[e, i]] = True


@numba.njit(**_INTEGER)
def merge(values, begin, length, private, lo, hi):
    """Add rows that a thread kept to itself: values[begin[r] + k] += values[private[r] + k] for k < length[r]."""
    for r in range(lo, hi):
        if private[r] != begin[r]:
            for k in range(length[r]):
                values[begin[r] + k] += values[private[r] + k]
