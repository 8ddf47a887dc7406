"""Running and checking studies, with a study made here."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from iga.errors import InputError
from iga.progress import QUIET
from studies.figures import Series, convergence, drawing, plot_heat_table
from studies.report import print_run
from studies.study import BASELINES, STUDIES, Figure, Result, check_study, find, list_studies, run_study
from studies.table import Column, Slope, table

COLUMNS = (Column("level", "int", key=True), Column("h"), Column("error", relative=1e-3), Column("t", "time", "s"))
SLOPES = (Slope("h", "error", expected=2.0),)


def draw(path, lines):
    with drawing(path) as axes:
        convergence(axes, lines, "$h$", "error")


def study(factor=1.0):
    def run(size, progress):
        levels = 4 if size == "ci" else 6
        rows = [(k, 0.5**k, factor * 0.25**k, 0.1) for k in progress.track(range(levels), "levels")]
        made = table("toy", COLUMNS, rows, SLOPES)
        lines = [Series("$p=1$", made.column("h"), made.column("error"), 2.0)]
        return Result(made, (Figure("rates", lambda path: draw(path, lines)),), "It converges.")

    return SimpleNamespace(__doc__="A toy.", NAME="toy", COLUMNS=COLUMNS, SLOPES=SLOPES, run=run)


def test_run_writes_table_figures_and_json(tmp_path):
    run = run_study(study(), "full", tmp_path / "out")
    assert [p.name for p in run.files] == ["toy.csv", "toy_rates.png", "toy.json"]
    assert all(p.stat().st_size > 0 for p in run.files)
    data = json.loads(run.files[-1].read_text())
    assert {"study", "columns", "rows", "rates", "files", "seconds"} <= set(data)
    assert len(data["rows"]) == 6
    assert run_study(study(), "ci").files == ()


def test_figures_that_cannot_be_drawn_take_nothing_along(tmp_path, capsys):
    def refuse(path):
        raise InputError("the cut takes all elements away")

    whole = study()
    found = whole.run("ci", QUIET)
    broken = replace(found, figures=(Figure("cut", refuse), *found.figures))
    whole.run = lambda size, progress: broken
    run = run_study(whole, "ci", tmp_path)
    assert [p.name for p in run.files] == ["toy.csv", "toy_rates.png", "toy.json"]
    assert run.undrawn == ("figure cut: the cut takes all elements away",)
    assert json.loads(run.files[-1].read_text())["undrawn"] == list(run.undrawn)
    print_run(run)
    assert capsys.readouterr().out.splitlines()[-1] == run.undrawn[0]


def test_check_passes_and_fails(tmp_path):
    run_study(study(), "ci", tmp_path)
    passed = check_study(study(), tmp_path)
    assert passed.passed
    assert str(passed).startswith("toy: as the baseline")
    failed = check_study(study(1.01), tmp_path)
    assert not failed.passed
    assert len(failed.differences) == 4
    assert "level = 2: error: expected 0.0625, got 0.063125 (allowed: ± 6.3e-05)" in str(failed)


def test_unknown_names_are_told(tmp_path):
    with pytest.raises(InputError, match="no study 'none'"):
        find("none")
    with pytest.raises(InputError, match="ci or full, not 'big'"):
        run_study(study(), "big")
    with pytest.raises(InputError, match="has no baseline"):
        check_study(study(), tmp_path)


def test_every_study_is_described_and_has_a_baseline():
    listed = dict(list_studies())
    assert set(listed) == set(STUDIES)
    for name, line in listed.items():
        assert len(line) > 20
        assert name == find(name).NAME
        assert (BASELINES / f"{name}.csv").is_file(), name


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_figures_are_written(tmp_path, suffix):
    h = [0.5, 0.25, 0.125]
    draw(
        tmp_path / f"a.{suffix}",
        [Series(f"$p={p}$", h, [x ** (p + 1) for x in h], p + 1, p) for p in (1, 2)]
        + [Series("falling", [10.0, 80.0, 640.0, 9e5], [1.0, 0.2, 0.04, 1e-3], -2 / 3, dashed=True)],
    )
    assert (tmp_path / f"a.{suffix}").stat().st_size > 3000


def test_series_without_points_are_left_out(tmp_path):
    empty = Series("none", [], [], 2.0)
    for number, some in enumerate(([], [empty], [empty, Series("one", [1.0], [2.0])])):
        path = tmp_path / f"{number}.png"
        draw(path, some)
        assert path.stat().st_size > 1000


def test_heat_tables(tmp_path):
    plot_heat_table(tmp_path / "h.png", ["a"], ["x", "y"], np.array([[1e-15, np.nan]]))
    assert (tmp_path / "h.png").stat().st_size > 3000
