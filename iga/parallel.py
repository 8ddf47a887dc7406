"""Threads: how many are used, and running array kernels on them.

Kernels release Python's global lock, so plain threads run them side by side. The number of threads is the number of
processors this process may use, unless limited:

    with limited(1):
        K = matrix(domain, Diffusion())
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any, TypeVar

import numba
import numpy as np

from iga.errors import InputError

Result = TypeVar("Result")

_limit: ContextVar[int | None] = ContextVar("threads", default=None)


def threads() -> int:
    """Return the number of threads in use."""
    limit = _limit.get()
    if limit is not None:
        return limit
    affinity = getattr(os, "sched_getaffinity", None)
    return max(len(affinity(0)) if affinity else os.cpu_count() or 1, 1)


@contextmanager
def limited(count: int) -> Iterator[None]:
    """Use ``count`` threads inside the ``with`` block, in kernels and, where threadpoolctl is installed, in BLAS.

    Raises
    ------
    InputError : ``count`` is less than one.
    """
    if count < 1:
        raise InputError(f"{count} threads: at least one is needed")
    token = _limit.set(count)
    blas, before = _blas(), numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    try:
        if blas is None:
            yield
        else:
            with blas.limit(limits=count, user_api="blas"):
                yield
    finally:
        _limit.reset(token)
        numba.set_num_threads(before)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread inside the ``with`` block, where threadpoolctl is installed.

    For products too small to share, whose waiting threads would cost more than they give, and inside threads of ours.
    """
    blas = _blas()
    if blas is None:
        yield
    else:
        with blas.limit(limits=1, user_api="blas"):
            yield


@lru_cache(maxsize=1)
def _blas() -> Any:
    """Controller of the BLAS thread pools; finding the libraries takes milliseconds, so it is kept."""
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController()


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="iga")


def run(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """Run tasks side by side, one thread each, and return their results in order."""
    if len(tasks) == 1:
        return [tasks[0]()]
    with one_blas_thread():
        waiting = [_pool(len(tasks)).submit(task) for task in tasks[1:]]
        try:
            first = tasks[0]()
        finally:
            wait(waiting)
    return [first, *(w.result() for w in waiting)]


def ranges(n: int, count: int | None = None) -> list[tuple[int, int]]:
    """Split range(n) into at most ``count`` (by default `threads`) contiguous parts of nearly equal length."""
    bounds = np.linspace(0, n, min(count or threads(), max(n, 1)) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(bounds)]
