r"""Compiled products and relaxation sweeps for sparse matrices with scalar or 3x3 entries, on all threads.

    multiply        y = A x
    forward         y = (D + L)^-1 r         D diagonal (blocks), L and U strictly lower and upper part of A,
    backward        y = (D + U)^-1 r         both restricted to couplings inside one part of the rows

The rows are cut into contiguous parts, one per task; a sweep ignores couplings between parts, so its result depends on
the parts but not on the number of threads (hybrid Gauss-Seidel: Baker, Falgout, Kolev and Yang 2011,
doi:10.1137/100798806). Column numbers must be sorted in each row.

Arrays: pointers (n+1,), columns (m,), values (m,) or (m, 3, 3), inverse (n,) or (n, 3, 3), starts (parts+1,), vectors
(n,) or (n, 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(parallel=True, cache=True, nogil=True)
def multiply_scalar(pointers: Array, columns: Array, values: Array, x: Array, y: Array) -> None:
    """Write y = A x for scalar entries."""
    for i in prange(len(pointers) - 1):
        s = values.dtype.type(0)
        for k in range(pointers[i], pointers[i + 1]):
            s += values[k] * x[columns[k]]
        y[i] = s


@njit(parallel=True, cache=True, nogil=True)
def multiply_block(pointers: Array, columns: Array, values: Array, x: Array, y: Array) -> None:
    """Write y = A x for 3x3 entries."""
    for i in prange(len(pointers) - 1):
        s = t = u = values.dtype.type(0)
        for k in range(pointers[i], pointers[i + 1]):
            j = columns[k]
            a, b, c = x[j, 0], x[j, 1], x[j, 2]
            s += values[k, 0, 0] * a + values[k, 0, 1] * b + values[k, 0, 2] * c
            t += values[k, 1, 0] * a + values[k, 1, 1] * b + values[k, 1, 2] * c
            u += values[k, 2, 0] * a + values[k, 2, 1] * b + values[k, 2, 2] * c
        y[i, 0] = s
        y[i, 1] = t
        y[i, 2] = u


@njit(parallel=True, cache=True, nogil=True)
def forward_scalar(
    pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array, y: Array
) -> None:
    """Write y = (D + L)^-1 r for scalar entries."""
    for part in prange(len(starts) - 1):
        first = starts[part]
        for i in range(first, starts[part + 1]):
            s = r[i]
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j >= i:
                    break
                if j >= first:
                    s -= values[k] * y[j]
            y[i] = s * inverse[i]


@njit(parallel=True, cache=True, nogil=True)
def backward_scalar(
    pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array, y: Array
) -> None:
    """Write y = (D + U)^-1 r for scalar entries."""
    for part in prange(len(starts) - 1):
        last = starts[part + 1]
        for i in range(last - 1, starts[part] - 1, -1):
            s = r[i]
            for k in range(pointers[i + 1] - 1, pointers[i] - 1, -1):
                j = columns[k]
                if j <= i:
                    break
                if j < last:
                    s -= values[k] * y[j]
            y[i] = s * inverse[i]


@njit(inline="always")
def _solve_row(i: int, inverse: Array, s: float, t: float, u: float, y: Array) -> None:
    y[i, 0] = inverse[i, 0, 0] * s + inverse[i, 0, 1] * t + inverse[i, 0, 2] * u
    y[i, 1] = inverse[i, 1, 0] * s + inverse[i, 1, 1] * t + inverse[i, 1, 2] * u
    y[i, 2] = inverse[i, 2, 0] * s + inverse[i, 2, 1] * t + inverse[i, 2, 2] * u


@njit(parallel=True, cache=True, nogil=True)
def forward_block(
    pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array, y: Array
) -> None:
    """Write y = (D + L)^-1 r for 3x3 entries."""
    for part in prange(len(starts) - 1):
        first = starts[part]
        for i in range(first, starts[part + 1]):
            s, t, u = r[i, 0], r[i, 1], r[i, 2]
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j >= i:
                    break
                if j >= first:
                    a, b, c = y[j, 0], y[j, 1], y[j, 2]
                    s -= values[k, 0, 0] * a + values[k, 0, 1] * b + values[k, 0, 2] * c
                    t -= values[k, 1, 0] * a + values[k, 1, 1] * b + values[k, 1, 2] * c
                    u -= values[k, 2, 0] * a + values[k, 2, 1] * b + values[k, 2, 2] * c
            _solve_row(i, inverse, s, t, u, y)


@njit(parallel=True, cache=True, nogil=True)
def backward_block(
    pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array, y: Array
) -> None:
    """Write y = (D + U)^-1 r for 3x3 entries."""
    for part in prange(len(starts) - 1):
        last = starts[part + 1]
        for i in range(last - 1, starts[part] - 1, -1):
            s, t, u = r[i, 0], r[i, 1], r[i, 2]
            for k in range(pointers[i + 1] - 1, pointers[i] - 1, -1):
                j = columns[k]
                if j <= i:
                    break
                if j < last:
                    a, b, c = y[j, 0], y[j, 1], y[j, 2]
                    s -= values[k, 0, 0] * a + values[k, 0, 1] * b + values[k, 0, 2] * c
                    t -= values[k, 1, 0] * a + values[k, 1, 1] * b + values[k, 1, 2] * c
                    u -= values[k, 2, 0] * a + values[k, 2, 1] * b + values[k, 2, 2] * c
            _solve_row(i, inverse, s, t, u, y)


@njit(parallel=True, cache=True, nogil=True)
def outside_sums(pointers: Array, columns: Array, values: Array, starts: Array, out: Array) -> None:
    """Sum of absolute values, per row, of scalar entries that couple different parts."""
    for part in prange(len(starts) - 1):
        first, last = starts[part], starts[part + 1]
        for i in range(first, last):
            s = 0.0
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j < first or j >= last:
                    s += abs(values[k])
            out[i] = s


@njit(parallel=True, cache=True, nogil=True)
def advance(step: float, p: Array, q: Array, x: Array, r: Array) -> float:
    """Update x += step p and r -= step q; return the squared length of the new r."""
    total = 0.0
    for i in prange(len(x)):
        x[i] += step * p[i]
        s = r[i] - step * q[i]
        r[i] = s
        total += s * s
    return total


@njit(parallel=True, cache=True, nogil=True)
def direct_search(ratio: float, z: Array, p: Array) -> None:
    """Write p = z + ratio p."""
    for i in prange(len(p)):
        p[i] = z[i] + ratio * p[i]


def parts(pointers: Array, size: int = 3000, most: int = 16) -> NDArray[np.int64]:
    """Starts (parts+1,) of contiguous parts with about equal numbers of entries, each of ``size`` rows at least."""
    n = len(pointers) - 1
    count = int(np.clip(n // size, 1, most))
    starts = np.searchsorted(pointers, np.linspace(0, pointers[-1], count + 1)).astype(np.int64)
    starts[0], starts[-1] = 0, n
    return np.unique(starts)
