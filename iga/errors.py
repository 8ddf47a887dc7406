"""The errors that users see: one line that names the entity and says what to do."""

from __future__ import annotations


class InputError(ValueError):
    """Something given to the program is wrong; the message names it in one line."""


class FormatError(InputError):
    """A file cannot be read as what it claims to be."""


class ConvergenceError(RuntimeError):
    """A solve did not reach its tolerance, so there is no result."""
