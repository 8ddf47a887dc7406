"""Settings of the source "catmull_clark", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.parameters import Rule, optional, parsed, real, truth, whole, word
from iga.errors import FormatError

Given = tuple[NDArray[np.int64], NDArray[np.int64]]
Parameter = float | str | NDArray[np.float64]

NAME = "catmull_clark"


@dataclass(frozen=True)
class Settings:
    """Settings of a build; see `source`.

    ``features`` may be crease edges (k, 2) and corner vertices (j,); ``lam``, ``mu``, ``gamma`` arrays with one number
    for each edge, face, cell, or the name of an attribute.
    """

    interpolate: str = "auto"
    features: str | float | Given = "auto"
    depth: int | None = None
    repair: bool = False
    pillow: bool = False
    bound: bool = False
    lam: Parameter = 0.25
    mu: Parameter = 0.125
    gamma: Parameter = 0.0625
    relaxation: float = 1.0
    space: str = "catmull_clark"
    attributes: tuple[str, ...] | None = None


def _features(value: Any) -> str | float | Given:
    if isinstance(value, tuple) or (isinstance(value, str) and value in ("auto", "none")):
        return value
    try:
        return float(real(0.0, 180.0).read(value))
    except (TypeError, ValueError):
        return read_features(Path(value))


def _shape(value: Any) -> Parameter:
    """A parameter of push-back: a number, the name of an attribute, or an array."""
    if isinstance(value, np.ndarray):
        return np.asarray(value, dtype=np.float64)
    try:
        number = float(value)
    except ValueError:
        return str(value)
    return float(real(0.0, 1.0, ends=False).read(number))


def _names(value: Any) -> tuple[str, ...]:
    parts = value.split(",") if isinstance(value, str) else value
    return tuple(part.strip() for part in parts if part.strip())


_SHAPE = Rule("a number above 0 and below 1, the name of an attribute, or an array of numbers", _shape)

RULES = {
    "interpolate": word("auto", "pia", "conjugate", "direct", "pushback", "butterfly", "none"),
    "features": Rule("auto, none, an angle from 0 to 180 degrees, or a file of crease edges", _features),
    "depth": optional(whole(0, 6)),
    "repair": truth(),
    "pillow": truth(),
    "bound": truth(),
    "lambda": _SHAPE,
    "mu": _SHAPE,
    "gamma": _SHAPE,
    "relaxation": real(0.0, 2.0, ends=False),
    "space": word("catmull_clark", "optimal"),
    "attributes": optional(Rule("names of attributes separated by commas", _names), "all"),
}


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Python keeps the word ``lambda`` for itself, so that ``lam`` is taken too.

    Raises
    ------
    InputError : a parameter is unknown, or has a value that does not fit.
    """
    made = parsed(NAME, {"lambda" if key == "lam" else key: value for key, value in parameters.items()}, RULES)
    return Settings(**{"lam" if key == "lambda" else key: value for key, value in made.items()})


def read_features(path: Path) -> Given:
    """Crease edges and corners from a text file: two vertex numbers on a line are an edge, one is a corner.

    Raises
    ------
    FormatError : a line is neither.
    """
    edges: list[list[int]] = []
    corners: list[list[int]] = []
    for place, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) > 2 or not all(number.isdecimal() for number in words):
            shown = line.strip()[:40]
            raise FormatError(f"{path.name}, line {place}: {shown!r} is neither an edge (two vertices) nor a corner")
        (edges if len(words) == 2 else corners).append([int(number) for number in words])
    return np.array(edges, dtype=np.int64).reshape(-1, 2), np.array(corners, dtype=np.int64).ravel()
