"""Products of sparse matrices with vectors, on all threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.kernels import sparse
from iga.parallel import ranges, run, threads

Array = NDArray[np.float64]

WORTH = 100_000
"""Matrix entries from which a second thread is worth its start."""


def product(K: csr_array, x: NDArray[Any]) -> NDArray[Any]:
    """K x for x (n,) or (n, k)."""
    if x.ndim != 1:
        return np.asarray(K @ x)
    y = np.empty(K.shape[0], dtype=np.result_type(K.data, x))
    on_rows(sparse.multiply_scalar, K.shape[0], K.nnz, K.indptr, K.indices, K.data, np.ascontiguousarray(x), y)
    return y


def absolute_product(K: csr_array, x: Array) -> Array:
    """|K| |x| for x (n,)."""
    y = np.empty(K.shape[0])
    on_rows(sparse.absolute_product, K.shape[0], K.nnz, K.indptr, K.indices, K.data, np.ascontiguousarray(x), y)
    return y


def on_rows(kernel: Callable[..., None], n: int, work: int, *arrays: Any) -> None:
    """Run ``kernel(first, last, *arrays)`` over range(n), in parts side by side if the work is worth it."""
    count = threads() if work > WORTH else 1
    run([partial(kernel, first, last, *arrays) for first, last in ranges(n, count)])
