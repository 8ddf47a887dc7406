"""Parameters of sources, as a command line gives them (texts) or as Python values; messages name the parameter."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from iga.errors import InputError


def require_known(source: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that the source does not have.

    Raises
    ------
    InputError : the first unknown name.
    """
    there = list(known)
    unknown = sorted(set(given) - set(there))
    if unknown:
        raise InputError(f"the source {source} has no parameter {unknown[0]!r}; there are: {', '.join(there)}")


def number(value: Any, key: str) -> float:
    """A finite real number.

    Raises
    ------
    InputError : it is none.
    """
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = math.nan
    if not math.isfinite(found):
        raise InputError(f"{key} must be a number, not {value!r}")
    return found


def whole(value: Any, key: str, least: int = 0, most: int | None = None) -> int:
    """A whole number, not below ``least`` nor above ``most``.

    Raises
    ------
    InputError : it is none.
    """
    try:
        real = float(value)
        found = int(real) if real == int(real) else least - 1
    except (TypeError, ValueError, OverflowError):
        found = least - 1
    if found < least or (most is not None and found > most):
        bounds = f"from {least} on" if most is None else f"from {least} to {most}"
        raise InputError(f"{key} must be a whole number {bounds}, not {value!r}")
    return found


def rows(value: Any, key: str, width: int) -> tuple[tuple[float, ...], ...]:
    """Rows of numbers, given as ``1,2,3; 4,5,6; ..`` or as a sequence of sequences.

    Raises
    ------
    InputError : there are none, one of them has not ``width`` numbers, or one is no number.
    """
    try:
        given = [row.split(",") for row in value.split(";")] if isinstance(value, str) else [list(row) for row in value]
    except TypeError:
        given = []
    if not given or any(len(row) != width for row in given):
        example = ",".join("xyz" if width == 3 else "abcdefgh"[:width])
        raise InputError(f"{key} must be rows of {width} numbers as {example}; {example}; .., not {value!r}")
    return tuple(tuple(number(x, key) for x in row) for row in given)


def truth(value: Any, key: str) -> bool:
    """A truth value.

    Raises
    ------
    InputError : it is none.
    """
    text = str(value).lower()
    if text not in ("true", "false", "1", "0", "yes", "no"):
        raise InputError(f"{key} must be true or false, not {value!r}")
    return text in ("true", "1", "yes")


def require_one_of(value: Any, key: str, allowed: Iterable[str]) -> None:
    """Refuse a word that is none of the allowed ones.

    Raises
    ------
    InputError : it is none of them.
    """
    words = tuple(allowed)
    if value not in words:
        raise InputError(f"{key} is {value!r}; it must be one of {', '.join(words)}")
