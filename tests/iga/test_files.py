"""Files appear whole or not at all; progress keeps to standard error."""

from __future__ import annotations

import os

import pytest

import iga.progress
from iga.errors import InputError
from iga.exchange.files import replacing, write_text
from iga.progress import QUIET, Progress, choosing, progress


def interrupted(path, error):
    with replacing(path) as temporary:
        temporary.write_text("half")
        raise error


def test_failure_leaves_the_old_file(tmp_path):
    path = tmp_path / "table.csv"
    write_text(path, "old\n")
    with pytest.raises(RuntimeError, match="interrupted"):
        interrupted(path, RuntimeError("interrupted"))
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]


def test_full_disk_is_one_line(tmp_path):
    path = tmp_path / "table.csv"
    write_text(path, "old\n")
    with pytest.raises(InputError, match=r"table\.csv: cannot be written: No space left"):
        interrupted(path, OSError(28, "No space left on device"))
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]


def test_devices_are_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: is a device or a pipe"):
        write_text(pipe, "x")
    assert pipe.is_fifo()


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        write_text(tmp_path / "none" / "a.txt", "x")
    with pytest.raises(InputError, match="is a folder"):
        write_text(tmp_path, "x")


def test_short_work_is_silent_away_from_a_terminal(capsys, monkeypatch):
    monkeypatch.delenv("IGA_PROGRESS", raising=False)
    assert list(progress().track(range(3), "work")) == [0, 1, 2]
    progress().say("hello")
    assert list(QUIET.track([5], "work")) == [5]
    out = capsys.readouterr()
    assert out.out == out.err == ""


def test_long_work_says_its_stage_now_and_then(capsys, monkeypatch):
    """In a log: one line at most every ten seconds, the first after ten; none where nothing is to be shown."""
    monkeypatch.delenv("IGA_PROGRESS", raising=False)
    now = [100.0]
    monkeypatch.setattr(iga.progress.time, "monotonic", lambda: now[0])
    shown = progress()
    for second, message in ((104.0, "early"), (111.0, "reading"), (115.0, "between"), (122.0, "filling")):
        now[0] = second
        shown.say(message)
    for item in shown.track(range(30), "cells"):
        now[0] = 122.0 + item
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.splitlines() == ["reading", "filling", "cells: 11/30 (10 s)", "cells: 21/30 (20 s)"]
    with choosing("none"):
        assert progress().style == "none"
    assert progress().style == "lines"


@pytest.mark.parametrize("style", ["plain", "bar"])
def test_progress_writes_to_standard_error_only(style, capsys):
    shown = Progress(style)
    for _ in shown.track(range(2), "outer"):
        assert list(shown.track(iter("abc"), "inner")) == ["a", "b", "c"]
        shown.say("a line")
    out = capsys.readouterr()
    assert out.out == ""
    assert "a line" in out.err


def test_progress_by_environment(monkeypatch):
    monkeypatch.setenv("IGA_PROGRESS", "plain")
    assert progress().style == "plain"
    monkeypatch.setenv("IGA_PROGRESS", "loud")
    with pytest.raises(InputError, match="bar, plain, lines or none"):
        progress()
