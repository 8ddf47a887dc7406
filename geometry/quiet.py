"""Silence and a bound on memory around libraries that print, warn, leave arrays half read and believe every number."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np


@contextlib.contextmanager
def quiet() -> Iterator[io.StringIO]:
    """Keep what is printed in a text; text that ends in the middle of an array is an error, other warnings are not."""
    said = io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
        np.errstate(all="ignore"),
    ):
        warnings.simplefilter("ignore")
        # NumPy only warns when text ends or turns unreadable in the middle of an array.
        warnings.filterwarnings("error", message=".*could not be read to its end.*")
        yield said


ROOM = 1_000_000_000
"""Bytes that any file may take while it is read."""
EACH = 400
"""Bytes more for each byte of the file: text of small numbers becomes several arrays."""


@contextlib.contextmanager
def within_memory(path: Path) -> Iterator[None]:
    """Let what reads a file take memory in proportion to its size; what asks for more gets a MemoryError.

    A single damaged number, taken for a count or a largest label, may otherwise ask for all the memory there is, and
    end the process. Only Linux tells what is in use; elsewhere there is no bound.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = used + ROOM + EACH * path.stat().st_size
    if soft != resource.RLIM_INFINITY:
        bound = min(bound, soft)
    resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
