r"""Overlapping patches of unknowns: choosing them, inverting their matrices, and the additive Schwarz product

    y = sum_k R_k^T A_k^-1 R_k r,      A_k = R_k A R_k^T,

where R_k picks the unknowns of patch k. Unknown numbers below zero stand for nothing.

Arrays: unknowns (k, m) sorted in each row, inverses (k, m, m) in single precision, vectors (n,).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from iga.kernels.options import OPTIONS

Array = NDArray[Any]


@njit(**OPTIONS)
def choose(unknowns: Array, order: Array, covered: Array, chosen: Array) -> None:
    """Mark, in the given order, each patch that has an unknown no earlier one covers."""
    for k in order:
        new = False
        for i in unknowns[k]:
            if i >= 0 and not covered[i]:
                new = True
                covered[i] = True
        if new:
            chosen[k] = True


@njit(**OPTIONS)
def found_aggregates(unknowns: Array, order: Array, label: Array, count: int) -> int:
    """Give elements, in the given order, most of whose unknowns have no label a new one for these; return the next."""
    for k in order:
        present = 0
        free = 0
        for i in unknowns[k]:
            if i >= 0:
                present += 1
                if label[i] < 0:
                    free += 1
        if free > 0 and 4 * free >= 3 * present:
            for i in unknowns[k]:
                if i >= 0 and label[i] < 0:
                    label[i] = count
            count += 1
    return count


@njit(**OPTIONS)
def join_aggregates(unknowns: Array, label: Array, joined: Array) -> None:
    """Give unknowns without a label the one that most unknowns of their element have."""
    for k in range(len(unknowns)):
        waiting = False
        for i in unknowns[k]:
            if i >= 0 and joined[i] < 0:
                waiting = True
        if not waiting:
            continue
        best, most = -1, 0
        for i in unknowns[k]:
            if i >= 0 and label[i] >= 0:
                same = 0
                for j in unknowns[k]:
                    if j >= 0 and label[j] == label[i]:
                        same += 1
                if same > most:
                    best, most = label[i], same
        if best >= 0:
            for i in unknowns[k]:
                if i >= 0 and joined[i] < 0:
                    joined[i] = best


@njit(**OPTIONS)
def _invert_in_place(A: Array) -> None:
    """Gauss-Jordan elimination of a positive definite matrix of unit diagonal; a vanishing pivot's row becomes zero.

    Plain loops, so that no second set of threads starts under the threads that call this.
    """
    m = len(A)
    for k in range(m):
        pivot = A[k, k]
        if pivot < 1e-13:
            for j in range(m):
                A[k, j] = 0.0
                A[j, k] = 0.0
            continue
        A[k, k] = 1.0
        inverse = 1.0 / pivot
        for j in range(m):
            A[k, j] *= inverse
        for i in range(m):
            if i != k:
                factor = A[i, k]
                A[i, k] = 0.0
                if factor != 0.0:
                    for j in range(m):
                        A[i, j] -= factor * A[k, j]


@njit(**OPTIONS)
def invert(
    first: int, last: int, unknowns: Array, pointers: Array, columns: Array, values: Array, inverses: Array
) -> None:
    """Write the inverses of the patches' matrices; rows and columns of absent unknowns become zero."""
    m = unknowns.shape[1]
    for k in range(first, last):
        own = unknowns[k]
        A = np.zeros((m, m))
        scale = np.ones(m)
        for a in range(m):
            i = own[a]
            if i < 0:
                A[a, a] = 1.0
                continue
            b, at, stop = 0, pointers[i], pointers[i + 1]
            while b < m and at < stop:
                if own[b] < columns[at]:
                    b += 1
                elif own[b] > columns[at]:
                    at += 1
                else:
                    A[a, b] = values[at]
                    b += 1
                    at += 1
            scale[a] = 1.0 / np.sqrt(A[a, a])
        for a in range(m):
            for b in range(m):
                A[a, b] *= scale[a] * scale[b]
        _invert_in_place(A)
        for a in range(m):
            for b in range(m):
                present = own[a] >= 0 and own[b] >= 0
                inverses[k, a, b] = 0.5 * (A[a, b] + A[b, a]) * scale[a] * scale[b] if present else 0.0


@njit(**OPTIONS)
def smooth(first: int, last: int, unknowns: Array, inverses: Array, r: Array, y: Array) -> None:
    """Add the corrections of patches to y."""
    m = unknowns.shape[1]
    local = np.empty(m, dtype=np.float32)
    for k in range(first, last):
        for a in range(m):
            i = unknowns[k, a]
            local[a] = r[i] if i >= 0 else np.float32(0)
        for a in range(m):
            i = unknowns[k, a]
            if i >= 0:
                s = np.float32(0)
                for b in range(m):
                    s += inverses[k, a, b] * local[b]
                y[i] += s
