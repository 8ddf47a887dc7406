"""Settings of the source "meccano", from texts or Python values; `source` says what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry.parameters import number, require_known, require_one_of, rows, truth, whole
from iga.errors import InputError

NAME = "meccano"
MECCANOS = ("auto", "pillowed", "cube", "polycube")
SPACES = ("optimal", "t-spline")
MEASURES = ("volume", "distance")
REMEDIES = ("refine", "untangle", "none")


@dataclass(frozen=True)
class Settings:
    """Settings of a build; see `source`."""

    meccano: str = "auto"
    space: str = "optimal"
    tolerance: float | None = None
    max_cells: int = 10000
    stretch: float = 10.0
    share: float = 0.25
    rounds: int = 14
    smoothing: int = 1
    mend: bool = False
    measure: str = "volume"
    remedy: str = "refine"
    corners: tuple[tuple[float, ...], ...] | None = None
    labels: tuple[int, ...] | None = None
    cuboids: tuple[tuple[float, ...], ...] | None = None

    @property
    def as_paper(self) -> bool:
        """Whether the solid is built as in the paper, on a meccano without pillow."""
        return self.meccano == "cube" or self.space == "t-spline"

    @property
    def aim(self) -> float:
        """The tolerance, or what it is if none is given."""
        return self.tolerance if self.tolerance is not None else 0.005 if self.as_paper else 0.004


def parse(parameters: Mapping[str, Any]) -> Settings:
    """Settings from parameters as a command line gives them (texts) or as Python values.

    Raises
    ------
    InputError : unknown parameter or value.
    """
    require_known(NAME, parameters, Settings.__dataclass_fields__)
    made: dict[str, Any] = {}
    for key, value in parameters.items():
        if key == "mend":
            made[key] = truth(value, key)
        elif key in ("max_cells", "rounds", "smoothing"):
            made[key] = whole(value, key)
        elif key in ("tolerance", "stretch", "share"):
            made[key] = number(value, key)
        elif key == "corners":
            made[key] = None if value is None else rows(value, key, 3)
        elif key == "cuboids":
            made[key] = None if value is None else rows(value, key, 6)
        elif key == "labels":
            made[key] = None if value is None else _labels(value)
        else:
            made[key] = str(value)
    settings = Settings(**made)
    require_one_of(settings.meccano, "meccano", MECCANOS)
    require_one_of(settings.space, "space", SPACES)
    require_one_of(settings.measure, "measure", MEASURES)
    require_one_of(settings.remedy, "remedy", REMEDIES)
    if settings.meccano == "pillowed" and settings.space == "t-spline":
        raise InputError("the paper's T-splines need meccano=cube or meccano=polycube; they have no pillowed form")
    if settings.corners is not None and (settings.labels is not None or settings.cuboids is not None):
        raise InputError("corners are those of a cube whose patches are found; labels or cuboids say otherwise")
    if settings.meccano == "polycube" and settings.corners is not None:
        raise InputError("corners are those of a cube; with meccano=polycube give cuboids")
    for key, low, high in (("aim", 0.0, 1.0), ("stretch", 1.0, float("inf")), ("share", 0.0, 0.5)):
        if not low < getattr(settings, key) < high:
            key = "tolerance" if key == "aim" else key
            raise InputError(f"{key} must lie between {low:g} and {high:g}, not {getattr(settings, key):g}")
    return settings


def _labels(value: Any) -> tuple[int, ...]:
    """Sides of the meccano, one for each triangle, from a text file or a sequence."""
    if isinstance(value, str):
        path = Path(value)
        if not path.is_file():
            raise InputError(f"labels must be a file with the side of each triangle, not {value!r}")
        value = path.read_text(errors="replace").split()
    return tuple(whole(side, "labels") for side in value)
