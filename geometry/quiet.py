"""Silence around libraries that print, warn and leave arrays half read."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator

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
