"""Settings of the source "catmull_clark", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.parameters import number, require_known, require_one_of, truth, whole
from iga.errors import FormatError, InputError

Given = tuple[NDArray[np.int64], NDArray[np.int64]]
Parameter = float | str | NDArray[np.float64]

NAME = "catmull_clark"
METHODS = ("auto", "pia", "conjugate", "direct", "pushback", "butterfly", "none")
SPACES = ("catmull_clark", "optimal")


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


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : unknown parameter or value.
    """
    renamed = {"lam" if key == "lambda" else key: value for key, value in parameters.items()}
    shown = ["lambda" if key == "lam" else key for key in Settings.__dataclass_fields__]
    require_known(NAME, ["lambda" if key == "lam" else key for key in renamed], shown)
    made: dict[str, Any] = {}
    for key, value in renamed.items():
        if key == "depth":
            made[key] = None if str(value) == "auto" else whole(value, key, most=6)
        elif key in ("repair", "pillow", "bound"):
            made[key] = truth(value, key)
        elif key in ("lam", "mu", "gamma"):
            made[key] = _parameter(value)
        elif key == "relaxation":
            made[key] = number(value, key)
        elif key == "attributes":
            parts = value.split(",") if isinstance(value, str) else value
            made[key] = tuple(part.strip() for part in parts if part.strip())
        elif key == "features":
            made[key] = _features(value)
        else:
            made[key] = str(value)
    settings = Settings(**made)
    require_one_of(settings.interpolate, "interpolate", METHODS)
    require_one_of(settings.space, "space", SPACES)
    for key in ("lam", "mu", "gamma"):
        value = getattr(settings, key)
        if isinstance(value, float) and not 0.0 < value < 1.0:
            raise InputError(f"{'lambda' if key == 'lam' else key} must lie between 0 and 1, not {value:g}")
    return settings


def _parameter(value: Any) -> Parameter:
    """A number, the name of an attribute, or an array."""
    if isinstance(value, np.ndarray):
        return np.asarray(value, dtype=np.float64)
    try:
        return float(value)
    except (TypeError, ValueError):
        return str(value)


def _features(value: Any) -> str | float | Given:
    if isinstance(value, tuple) or (isinstance(value, str) and value in ("auto", "none")):
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        path = Path(str(value))
    if not path.is_file():
        raise InputError(f"features must be auto, none, degrees, or a file of crease edges, not {value!r}")
    return read_features(path)


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
        if len(words) > 2 or not all(word.isdecimal() for word in words):
            shown = line.strip()[:40]
            raise FormatError(f"{path.name}, line {place}: {shown!r} is neither an edge (two vertices) nor a corner")
        (edges if len(words) == 2 else corners).append([int(word) for word in words])
    return np.array(edges, dtype=np.int64).reshape(-1, 2), np.array(corners, dtype=np.int64).ravel()
