"""A stop watch for the stages of a computation."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter


@dataclass
class Clock:
    """Seconds since it was made, and of each stage by name.

    Attributes
    ----------
    began, last : when it was made, and when the last stage ended.
    laps : seconds of each stage; a stage that is named again adds up.
    """

    began: float = field(default_factory=perf_counter)
    last: float = field(init=False)
    laps: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.last = self.began

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return perf_counter() - self.began

    def lap(self, stage: str) -> None:
        """The stage that ends now."""
        now = perf_counter()
        self.laps[stage] = self.laps.get(stage, 0.0) + now - self.last
        self.last = now
