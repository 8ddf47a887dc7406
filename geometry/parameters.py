"""Parameters of sources, given as texts by a command line or as Python values, and the rules that read them.

A source keeps one table of rules beside its settings:

    RULES = {"degree": whole(1, 8), "angle": optional(real(0.0, 180.0)), "convert": word("none", "hex4")}
    settings = Settings(**parsed("hybrid", parameters, RULES))

Whatever does not fit is refused by one sentence: "degree must be a whole number from 1 to 8, not '9'".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from iga.errors import InputError

LARGEST = 10**9
"""Largest whole number where a rule says none: nothing that is counted here is larger."""
SHOWN = 80
"""Characters of a refused value that a message shows."""


@dataclass(frozen=True)
class Rule:
    """What a parameter may be.

    Attributes
    ----------
    what : the end of the sentence "NAME must be ..".
    read : the value, from what was given; raises TypeError, ValueError, OverflowError or OSError if that does not fit,
        or an InputError that says why.
    """

    what: str
    read: Callable[[Any], Any]


def parsed(source: str, given: Mapping[str, Any], rules: Mapping[str, Rule]) -> dict[str, Any]:
    """Values of the parameters that were given.

    Parameters
    ----------
    source : its name, for messages.
    given : texts or Python values by name.
    rules : of all parameters that the source has.

    Raises
    ------
    InputError : a name is unknown, or a value does not fit its rule.
    """
    if unknown := sorted(set(given) - set(rules)):
        raise InputError(f"the source {source} has no parameter {unknown[0]!r}; there are: {', '.join(rules)}")
    return {key: _read(key, value, rules[key]) for key, value in given.items()}


def _read(key: str, value: Any, rule: Rule) -> Any:
    try:
        return rule.read(value)
    except InputError:  # says more than the rule does
        raise
    except (TypeError, ValueError, OverflowError, OSError):
        shown = " ".join(repr(value).split())
        shown = shown if len(shown) <= SHOWN else shown[:SHOWN] + ".."
        raise InputError(f"{key} must be {rule.what}, not {shown}") from None


def real(low: float = -math.inf, high: float = math.inf, ends: bool = True) -> Rule:
    """A finite number from ``low`` to ``high``; without ``ends``, strictly between them."""
    what = "a number"
    if math.isfinite(low):
        what += f" from {low:g}" if ends else f" above {low:g}"
    if math.isfinite(high):
        what += f" to {high:g}" if ends else f"{' and' if math.isfinite(low) else ''} below {high:g}"

    def read(value: Any) -> float:
        found = float(value)
        if not math.isfinite(found) or not low <= found <= high or (found in (low, high) and not ends):
            raise ValueError
        return found

    return Rule(what, read)


def whole(least: int = 0, most: int = LARGEST) -> Rule:
    """A whole number from ``least`` to ``most``."""

    def read(value: Any) -> int:
        found = float(value)
        if not least <= found <= most or found != int(found):
            raise ValueError
        return int(found)

    return Rule(f"a whole number from {least} {'on' if most == LARGEST else f'to {most}'}", read)


def truth() -> Rule:
    """A truth value."""

    def read(value: Any) -> bool:
        return word("true", "yes", "1", "false", "no", "0").read(value) in ("true", "yes", "1")

    return Rule("true or false", read)


def word(*allowed: str) -> Rule:
    """One of some words in lower case; capitals do not matter."""

    def read(value: Any) -> str:
        text = str(value).strip().lower()
        if text not in allowed:
            raise ValueError
        return text

    return Rule(f"one of {', '.join(allowed)}", read)


def rows(width: int, entry: Rule) -> Rule:
    """Rows of ``width`` entries, at least one, given as ``1,2,3; 4,5,6; ..`` or as a sequence of sequences."""
    example = ",".join("xyz" if width == 3 else "abcdefgh"[:width])

    def read(value: Any) -> tuple[tuple[Any, ...], ...]:
        given = [row.split(",") for row in value.split(";")] if isinstance(value, str) else value
        found = tuple(tuple(entry.read(one) for one in row) for row in given)
        if not found or any(len(row) != width for row in found):
            raise ValueError
        return found

    return Rule(f"rows of {width} entries as {example}; {example}; .., each {entry.what}", read)


def optional(rule: Rule, blank: str = "auto") -> Rule:
    """What a rule takes, or None, for which there is a word too."""

    def read(value: Any) -> Any:
        return None if value is None or (isinstance(value, str) and value.strip() == blank) else rule.read(value)

    return Rule(f"{blank} or {rule.what}", read)
