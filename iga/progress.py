"""Progress of long work, on standard error.

On a terminal a bar that vanishes when the work is done; elsewhere (logs, continuous integration) the latest stage in
one plain line at most every ten seconds, the first after ten: short work is silent. ``plain`` shows every message.
Standard output is never touched, so that ``--json`` stays one clean object.

The environment variable ``IGA_PROGRESS`` overrides the choice: ``bar``, ``plain``, ``lines`` or ``none``; `choosing`
does the same for a stretch of code, and comes first.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from iga.errors import InputError

T = TypeVar("T")
Style = Literal["auto", "bar", "plain", "lines", "none"]
WORDS = ("bar", "plain", "lines", "none")
SECONDS_BETWEEN_LINES = 5.0
SECONDS_BETWEEN_STAGES = 10.0


@dataclass(frozen=True)
class Progress:
    """Where progress goes; made by `progress` or taken as the constant `QUIET`.

    Attributes
    ----------
    style : "bar", "plain", "lines" or "none".
    """

    style: Style = "none"
    _shown: list[Any] = field(default_factory=list, repr=False, compare=False)
    _waiting: list[str] = field(default_factory=list, repr=False, compare=False)
    _lines: dict[str, float] = field(default_factory=lambda: {"last": time.monotonic()}, repr=False, compare=False)

    def track(self, items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
        """Yield the items and show how many are done; may be nested."""
        if total is None and isinstance(items, Sized):
            total = len(items)
        if self.style == "bar":
            yield from self._bar(items, label, total)
        elif self.style in ("plain", "lines"):
            yield from self._plain(items, label, total)
        else:
            yield from items

    def say(self, message: str, passing: bool = False) -> None:
        """Show one line that stays; with "lines" only if the last is long enough ago.

        Parameters
        ----------
        passing : whether it is a step of a stage; what was said of the last stage and not shown yet comes first.
        """
        if self.style == "none":
            return
        if self.style == "lines":
            if not passing:
                self._waiting[:] = [message]
            if not self._due():
                return
            message = self._waiting.pop() if self._waiting else message
        if self._shown:
            self._shown[-1].console.print(message, highlight=False, markup=False)
        else:
            print(message, file=sys.stderr, flush=True)

    def _bar(self, items: Iterable[T], label: str, total: int | None) -> Iterator[T]:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        if self._shown:  # an outer loop owns the display
            bars = self._shown[-1]
            task = bars.add_task(label, total=total)
            try:
                for item in items:
                    yield item
                    bars.advance(task)
            finally:
                bars.remove_task(task)
            return
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
            self._shown.append(bars)
            task = bars.add_task(label, total=total)
            try:
                for item in items:
                    yield item
                    bars.advance(task)
            finally:
                self._shown.pop()

    def _plain(self, items: Iterable[T], label: str, total: int | None) -> Iterator[T]:
        begin = last = time.monotonic()
        of = "" if total is None else f"/{total}"
        for done, item in enumerate(items, start=1):
            yield item
            now = time.monotonic()
            if self._due() if self.style == "lines" else now - last >= SECONDS_BETWEEN_LINES or done == total:
                print(f"{label}: {done}{of} ({now - begin:.0f} s)", file=sys.stderr, flush=True)
                last = now

    def _due(self) -> bool:
        """Whether the last line of style "lines" is long enough ago; then the next one counts from now."""
        now = time.monotonic()
        due = now - self._lines["last"] >= SECONDS_BETWEEN_STAGES
        if due:
            self._lines["last"] = now
        return due


_CHOSEN: ContextVar[Style] = ContextVar("chosen", default="auto")


@contextmanager
def choosing(style: Style) -> Iterator[None]:
    """Let "auto" mean another style within a block, for example "none"."""
    token = _CHOSEN.set(style)
    try:
        yield
    finally:
        _CHOSEN.reset(token)


QUIET = Progress("none")


def progress(style: Style = "auto") -> Progress:
    """Return the progress display that suits where standard error goes.

    Parameters
    ----------
    style : "auto" shows a bar on a terminal and lines elsewhere; the others are taken as said. `choosing` and
        ``IGA_PROGRESS`` in the environment replace "auto".

    Raises
    ------
    InputError : if ``IGA_PROGRESS`` is none of the known words.
    """
    if style == "auto":
        style = _CHOSEN.get()
    if style == "auto":
        said = os.environ.get("IGA_PROGRESS", "")
        if said and said not in WORDS:
            raise InputError(f"IGA_PROGRESS is {said!r}; it may be bar, plain, lines or none")
        if said:
            return Progress(said)  # type: ignore[arg-type]
        return Progress("bar" if sys.stderr.isatty() else "lines")
    return Progress(style)
