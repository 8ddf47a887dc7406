r"""Products and relaxation sweeps for sparse matrices with scalar or 3x3 entries, on ranges of rows.

    multiply        y = A x
    forward         y = (D + L)^-1 r         D diagonal (blocks), L and U strictly lower and upper part of A,
    backward        y = (D + U)^-1 r         both restricted to couplings inside one part of the rows

For sweeps the rows are cut into contiguous parts; a sweep ignores couplings between parts, so its result depends on the
parts but not on the number of threads (hybrid Gauss-Seidel: Baker, Falgout, Kolev and Yang 2011,
doi:10.1137/100798806). Column numbers must be sorted in each row. Each kernel works on rows or parts ``first`` to
``last``; the callers run several of them side by side.

Arrays: pointers (n+1,), columns (m,), values (m,) or (m, 3, 3), inverse (n,) or (n, 3, 3), starts (parts+1,), vectors
(n,) or (n, 3).
"""

from __future__ import annotations

from typing import Any

from numba import njit
from numpy.typing import NDArray

from iga.kernels.options import OPTIONS

Array = NDArray[Any]


@njit(**OPTIONS)
def multiply_scalar(first: int, last: int, pointers: Array, columns: Array, values: Array, x: Array, y: Array) -> None:
    """Write y = A x for scalar entries."""
    for i in range(first, last):
        s = values.dtype.type(0)
        for k in range(pointers[i], pointers[i + 1]):
            s += values[k] * x[columns[k]]
        y[i] = s


@njit(**OPTIONS)
def multiply_block(first: int, last: int, pointers: Array, columns: Array, values: Array, x: Array, y: Array) -> None:
    """Write y = A x for 3x3 entries."""
    for i in range(first, last):
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


@njit(**OPTIONS)
def forward_scalar(
    first: int, last: int, pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array,
    y: Array,
) -> None:
    """Write y = (D + L)^-1 r for scalar entries."""
    for part in range(first, last):
        start = starts[part]
        for i in range(start, starts[part + 1]):
            s = r[i]
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j >= i:
                    break
                if j >= start:
                    s -= values[k] * y[j]
            y[i] = s * inverse[i]


@njit(**OPTIONS)
def backward_scalar(
    first: int, last: int, pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array,
    y: Array,
) -> None:
    """Write y = (D + U)^-1 r for scalar entries."""
    for part in range(first, last):
        stop = starts[part + 1]
        for i in range(stop - 1, starts[part] - 1, -1):
            s = r[i]
            for k in range(pointers[i + 1] - 1, pointers[i] - 1, -1):
                j = columns[k]
                if j <= i:
                    break
                if j < stop:
                    s -= values[k] * y[j]
            y[i] = s * inverse[i]


@njit(inline="always")
def _solve_row(i: int, inverse: Array, s: float, t: float, u: float, y: Array) -> None:
    y[i, 0] = inverse[i, 0, 0] * s + inverse[i, 0, 1] * t + inverse[i, 0, 2] * u
    y[i, 1] = inverse[i, 1, 0] * s + inverse[i, 1, 1] * t + inverse[i, 1, 2] * u
    y[i, 2] = inverse[i, 2, 0] * s + inverse[i, 2, 1] * t + inverse[i, 2, 2] * u


@njit(**OPTIONS)
def forward_block(
    first: int, last: int, pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array,
    y: Array,
) -> None:
    """Write y = (D + L)^-1 r for 3x3 entries."""
    for part in range(first, last):
        start = starts[part]
        for i in range(start, starts[part + 1]):
            s, t, u = r[i, 0], r[i, 1], r[i, 2]
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j >= i:
                    break
                if j >= start:
                    a, b, c = y[j, 0], y[j, 1], y[j, 2]
                    s -= values[k, 0, 0] * a + values[k, 0, 1] * b + values[k, 0, 2] * c
                    t -= values[k, 1, 0] * a + values[k, 1, 1] * b + values[k, 1, 2] * c
                    u -= values[k, 2, 0] * a + values[k, 2, 1] * b + values[k, 2, 2] * c
            _solve_row(i, inverse, s, t, u, y)


@njit(**OPTIONS)
def backward_block(
    first: int, last: int, pointers: Array, columns: Array, values: Array, inverse: Array, starts: Array, r: Array,
    y: Array,
) -> None:
    """Write y = (D + U)^-1 r for 3x3 entries."""
    for part in range(first, last):
        stop = starts[part + 1]
        for i in range(stop - 1, starts[part] - 1, -1):
            s, t, u = r[i, 0], r[i, 1], r[i, 2]
            for k in range(pointers[i + 1] - 1, pointers[i] - 1, -1):
                j = columns[k]
                if j <= i:
                    break
                if j < stop:
                    a, b, c = y[j, 0], y[j, 1], y[j, 2]
                    s -= values[k, 0, 0] * a + values[k, 0, 1] * b + values[k, 0, 2] * c
                    t -= values[k, 1, 0] * a + values[k, 1, 1] * b + values[k, 1, 2] * c
                    u -= values[k, 2, 0] * a + values[k, 2, 1] * b + values[k, 2, 2] * c
            _solve_row(i, inverse, s, t, u, y)


@njit(**OPTIONS)
def outside_sums(pointers: Array, columns: Array, values: Array, starts: Array, out: Array) -> None:
    """Sum of absolute values, per row, of scalar entries that couple different parts."""
    for part in range(len(starts) - 1):
        start, stop = starts[part], starts[part + 1]
        for i in range(start, stop):
            s = 0.0
            for k in range(pointers[i], pointers[i + 1]):
                j = columns[k]
                if j < start or j >= stop:
                    s += abs(values[k])
            out[i] = s


@njit(**OPTIONS)
def absolute_product(
    first: int, last: int, pointers: Array, columns: Array, values: Array, x: Array, y: Array
) -> None:
    """Write y = |A| |x| for scalar entries."""
    for i in range(first, last):
        s = 0.0
        for k in range(pointers[i], pointers[i + 1]):
            s += abs(values[k] * x[columns[k]])
        y[i] = s


@njit(**OPTIONS)
def advance(step: float, p: Array, q: Array, x: Array, r: Array) -> float:
    """Update x += step p and r -= step q; return the squared length of the new r."""
    total = 0.0
    for i in range(len(x)):
        x[i] += step * p[i]
        s = r[i] - step * q[i]
        r[i] = s
        total += s * s
    return total


@njit(**OPTIONS)
def turn(ratio: float, z: Array, p: Array) -> None:
    """Write p = z + ratio p."""
    for i in range(len(p)):
        p[i] = z[i] + ratio * p[i]
