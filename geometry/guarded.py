"""A guard around libraries that print, warn, leave arrays half read and believe every number of a file."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOM = 1_000_000_000
"""Bytes that any file may take while it is read."""
EACH = 400
"""Bytes more for each byte of the file: text of small numbers becomes several arrays."""


@contextlib.contextmanager
def guarded(path: Path) -> Iterator[io.StringIO]:
    """Read a file in silence and in memory in proportion to its size.

    What is printed is kept in a text. Text that ends in the middle of an array is an error, other warnings are not.
    What asks for more memory gets a MemoryError: a damaged number, taken for a count or a largest label, may otherwise
    ask for all there is, and end the process.
    """
    said = io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
        np.errstate(all="ignore"),
        _within(ROOM + EACH * path.stat().st_size),
    ):
        warnings.simplefilter("ignore")
        # NumPy only warns when text ends or turns unreadable in the middle of an array.
        warnings.filterwarnings("error", message=".*could not be read to its end.*")
        yield said


@contextlib.contextmanager
def _within(room: int) -> Iterator[None]:
    """Allow so many bytes more; only Linux tells what is in use, elsewhere there is no bound."""
    if sys.platform != "linux":
        yield
        return
    import resource

    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = used + room if soft == resource.RLIM_INFINITY else min(used + room, soft)
    resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
