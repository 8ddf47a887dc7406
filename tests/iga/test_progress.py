"""Progress in plain lines: what is shown, and when."""

from __future__ import annotations

import pytest

from iga import progress as module
from iga.progress import Progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds that a test sets."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_a_stage_is_shown_before_its_passing_steps(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    shown = Progress("lines")
    clock[0] = 1.0
    shown.say("stage one")
    for now in (2.0, 12.0, 13.0, 23.0):
        clock[0] = now
        shown.say(f"step at {now:g}", passing=True)
    assert capsys.readouterr().err.splitlines() == ["stage one", "step at 23"]


def test_the_latest_stage_replaces_one_that_was_not_shown(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = Progress("lines")
    for now, stage in ((1.0, "one"), (2.0, "two"), (11.0, "three"), (12.0, "four")):
        clock[0] = now
        shown.say(stage)
    assert capsys.readouterr().err.splitlines() == ["three"]


def test_plain_shows_every_message_and_none_shows_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    for style in ("plain", "none"):
        shown = Progress(style)  # type: ignore[arg-type]
        shown.say("stage")
        shown.say("step", passing=True)
    assert capsys.readouterr().err.splitlines() == ["stage", "step"]
    assert list(Progress("none").track(range(3), "nothing")) == [0, 1, 2]
