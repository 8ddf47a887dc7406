"""Settings of the source "catmull_clark", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from iga.errors import InputError

NAME = "catmull_clark"
METHODS = ("auto", "pia", "conjugate", "direct", "pushback", "butterfly", "none")
SPACES = ("catmull_clark", "optimal")


@dataclass(frozen=True)
class Settings:
    """Settings of a build; see `source`."""

    interpolate: str = "auto"
    features: str | float = "auto"
    depth: int | None = None
    repair: bool = False
    pillow: bool = False
    bound: bool = False
    lam: float = 0.25
    mu: float = 0.125
    gamma: float = 0.0625
    relaxation: float = 1.0
    space: str = "catmull_clark"
    attributes: tuple[str, ...] | None = None


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : unknown parameter or value.
    """
    renamed = {"lam" if key == "lambda" else key: value for key, value in parameters.items()}
    unknown = sorted(set(renamed) - set(Settings.__dataclass_fields__))
    if unknown:
        there = ", ".join("lambda" if key == "lam" else key for key in Settings.__dataclass_fields__)
        raise InputError(f"the source {NAME} has no parameter {unknown[0]!r}; there are: {there}")
    made: dict[str, Any] = {}
    for key, value in renamed.items():
        if key == "depth":
            made[key] = None if str(value) == "auto" else _whole(value)
        elif key in ("repair", "pillow", "bound"):
            made[key] = _truth(value, key)
        elif key in ("lam", "mu", "gamma", "relaxation"):
            made[key] = _number(value, "lambda" if key == "lam" else key)
        elif key == "attributes":
            parts = value.split(",") if isinstance(value, str) else value
            made[key] = tuple(part.strip() for part in parts if part.strip())
        elif key == "features":
            made[key] = value if str(value) in ("auto", "none") else _number(value, "features (auto, none, or degrees)")
        else:
            made[key] = str(value)
    settings = Settings(**made)
    for key, allowed in (("interpolate", METHODS), ("space", SPACES)):
        if getattr(settings, key) not in allowed:
            raise InputError(f"{key} is {getattr(settings, key)!r}; it must be one of {', '.join(allowed)}")
    for key in ("lam", "mu", "gamma"):
        if not 0.0 < getattr(settings, key) < 1.0:
            shown = "lambda" if key == "lam" else key
            raise InputError(f"{shown} must lie between 0 and 1, not {getattr(settings, key):g}")
    return settings


def _whole(value: Any) -> int:
    try:
        depth = int(str(value))
    except ValueError:
        depth = -1
    if not 0 <= depth <= 6:
        raise InputError(f"depth must be auto or a whole number from 0 to 6, not {value!r}")
    return depth


def _number(value: Any, key: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{key} must be a number, not {value!r}") from None


def _truth(value: Any, key: str) -> bool:
    text = str(value).lower()
    if text not in ("true", "false", "1", "0", "yes", "no"):
        raise InputError(f"{key} must be true or false, not {value!r}")
    return text in ("true", "1", "yes")
