"""Distinct rows of a table, by hashing: sorting whole rows is what takes the time in building extraction patterns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def distinct(rows: NDArray[Any]) -> tuple[Index, Index]:
    """Find equal rows (bit for bit).

    Parameters
    ----------
    rows : (m, k) of any plain type.

    Returns
    -------
    first (u,), a row of each kind; number (m,), the kind of each row.
    """
    if not len(rows):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    packed = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
    packed = np.pad(packed, ((0, 0), (0, -packed.shape[1] % 8)))
    words = packed.view(np.uint64)
    factors = np.random.default_rng(101).integers(1, 2**63, words.shape[1], dtype=np.uint64) | np.uint64(1)
    mixed = words ^ (words >> np.uint64(29))
    hashed = (mixed * factors) ^ ((mixed * factors) >> np.uint64(32))
    _, first, number = np.unique(hashed.sum(axis=1), return_index=True, return_inverse=True)
    number = number.reshape(-1)
    if not np.array_equal(words, words[first[number]]):  # two kinds with one hash
        _, first, number = np.unique(packed.view(np.dtype((np.void, packed.shape[1]))).ravel(), return_index=True,
                                     return_inverse=True)
    return first, number
