"""Settings of the source "meccano", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.parameters import Rule, optional, parsed, real, rows, truth, whole, word
from iga.errors import InputError

NAME = "meccano"


@dataclass(frozen=True)
class Settings:
    """Settings of a build; see `source`."""

    meccano: str = "auto"
    space: str = "optimal"
    tolerance: float | None = None
    max_cells: int = 10000
    off: str = "refuse"
    stretch: float = 10.0
    share: float = 0.25
    rounds: int = 14
    smoothing: int = 1
    mend: bool = False
    measure: str = "volume"
    remedy: str = "refine"
    corners: tuple[tuple[float, ...], ...] | None = None
    labels: tuple[int, ...] | None = None
    cuboids: tuple[tuple[int, ...], ...] | None = None

    @property
    def as_paper(self) -> bool:
        """Whether the solid is built as in the paper, on a meccano without pillow."""
        return self.meccano == "cube" or self.space == "t-spline"

    @property
    def aim(self) -> float:
        """The tolerance, or what it is if none is given."""
        return self.tolerance if self.tolerance is not None else 0.005 if self.as_paper else 0.004


def _labels(value: Any) -> tuple[int, ...]:
    """Sides of the meccano, one for each triangle, from a text file or a sequence."""
    given = Path(value).read_text(errors="replace").split() if isinstance(value, str | Path) else value
    found = np.asarray(given, dtype=float)
    if found.ndim != 1 or not (found >= 0).all() or (found != np.floor(found)).any() or not np.isfinite(found).all():
        raise ValueError
    return tuple(found.astype(np.int64).tolist())


RULES = {
    "meccano": word("auto", "pillowed", "cube", "polycube"),
    "space": word("optimal", "t-spline"),
    "tolerance": optional(real(0.0, 1.0, ends=False)),
    "max_cells": whole(),
    "off": word("refuse", "keep"),
    "stretch": real(1.0, math.inf, ends=False),
    "share": real(0.0, 0.5, ends=False),
    "rounds": whole(),
    "smoothing": whole(),
    "mend": truth(),
    "measure": word("volume", "distance"),
    "remedy": word("refine", "untangle", "none"),
    "corners": optional(rows(3, real())),
    "labels": optional(Rule("a file with the side of each triangle, whole numbers from 0 on", _labels)),
    "cuboids": optional(rows(6, whole(-10**6, 10**6))),
}


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : a parameter is unknown, has a value that does not fit, or contradicts another.
    """
    settings = Settings(**parsed(NAME, parameters, RULES))
    if settings.meccano == "pillowed" and settings.space == "t-spline":
        raise InputError("the paper's T-splines need meccano=cube or meccano=polycube; they have no pillowed form")
    if settings.corners is not None and (settings.labels is not None or settings.cuboids is not None):
        raise InputError("corners are those of a cube whose patches are found; labels or cuboids say otherwise")
    if settings.meccano == "polycube" and settings.corners is not None:
        raise InputError("corners are those of a cube; with meccano=polycube give cuboids")
    return settings
