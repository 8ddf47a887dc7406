"""Settings of the source "hybrid", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from geometry.parameters import optional, parsed, real, rows, whole, word

NAME = "hybrid"
SKINS = ("triangles", "hybrid", "hb-rep")
"""Kinds of skins; see `source`."""


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


RULES = {
    "solid": optional(whole()),
    "skin": word(*SKINS),
    "degree": whole(3, 8),
    "size": real(1e-4, 1.0),
    "tolerance": real(1e-10, 0.1),
    "layers": whole(0, 20),
    "omega": real(0.01, 0.95),
    "subdivide": optional(whole(0, 4)),
    "limit": real(1.0, 1e6),
    "convert": word("none", "hex4"),
    "refine": whole(0, 5),
    "strategy": word("kept", "recomputed", "layers", "trimmed"),
    "paths": word("blended", "straight"),
    "mid": optional(rows(3, real())),
    "relax": real(0.0, 1.0),
}


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : a parameter is unknown, or has a value that does not fit.
    """
    return Settings(**parsed(NAME, parameters, RULES))
