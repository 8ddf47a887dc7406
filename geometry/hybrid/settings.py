"""Settings of the source "hybrid", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from geometry.parameters import number, require_known, rows, whole
from iga.errors import InputError

NAME = "hybrid"


@dataclass(frozen=True)
class Settings:
    """Settings of a build; see `source`."""

    solid: int | None = None
    skin: str = "triangles"
    degree: int = 3
    size: float = 0.2
    tolerance: float = 2e-5
    layers: int = 0
    omega: float = 0.5
    subdivide: int | None = None
    limit: float = 300.0
    convert: str = "none"
    refine: int = 0
    strategy: str = "kept"
    paths: str = "blended"
    mid: tuple[tuple[float, ...], ...] | None = None
    relax: float = 0.5


_RANGES: dict[str, tuple[float, float]] = {
    "solid": (0, 10**6), "degree": (3, 8), "size": (1e-4, 1.0), "tolerance": (1e-10, 0.1), "layers": (0, 20),
    "omega": (0.01, 0.95), "subdivide": (0, 4), "limit": (1.0, 1e6), "refine": (0, 5),
    "relax": (0.0, 1.0),
}

_WORDS = {
    "convert": ("none", "hex4"), "skin": ("triangles", "hybrid", "hb-rep"),
    "paths": ("blended", "straight"), "strategy": ("kept", "recomputed", "layers", "trimmed"),
}


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : unknown parameter or value.
    """
    require_known(NAME, parameters, Settings.__dataclass_fields__)
    made: dict[str, Any] = {}
    for key, value in parameters.items():
        if (key == "subdivide" and str(value) == "auto") or (key == "solid" and value is None):
            made[key] = None
        elif key == "mid":
            made[key] = None if value is None or str(value) == "auto" else rows(value, key, 3)
            continue
        elif key in _WORDS:
            made[key] = str(value).lower()
            if made[key] not in _WORDS[key]:
                raise InputError(f"{key} must be one of {', '.join(_WORDS[key])}, not {value!r}")
            continue
        elif key in ("size", "tolerance", "omega", "limit", "relax"):
            made[key] = number(value, key)
        else:
            made[key] = whole(value, key)
        low, high = _RANGES[key]
        if made[key] is not None and not low <= made[key] <= high:
            raise InputError(f"{key} must lie between {low:g} and {high:g}, not {value!r}")
    return Settings(**made)
