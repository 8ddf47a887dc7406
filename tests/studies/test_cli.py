"""The command line: its JSON contract, exit codes and one-line errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from studies.cli import _show, main
from studies.commands import settings_of

BUILT = {"source", "input", "degree", "elements", "functions", "boundaries", "volume", "quality", "distance", "report",
         "seconds", "peak_mb"}
SOLVED = {"problem", "functions", "unknowns", "assemble_s", "solve_s", "iterations", "residual", "l2_error", "h1_error",
          "relative_l2_error", "relative_h1_error", "energy", "extrema", "peak_mb"}
QUALITY = {"certified", "refuted", "undecided", "min_det_lower", "min_det_upper", "scaled_jacobian"}
SCALED = {"min", "mean", "share_below_half", "cells_negative_gauss", "cells_negative_centre"}


@pytest.fixture
def ball(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A saved ball of curved tetrahedra converted to hexahedra."""
    path = tmp_path / "ball.npz"
    assert main(["build", "ball", "--source", "tets", "--set", "convert=hex4", "--set", "n=1", "-o", str(path)]) == 0
    capsys.readouterr()
    return path


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    """Run a command with --json and return its one object."""
    assert main([*map(str, words), "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    return json.loads(captured.out)


def test_build_info_and_refine_say_the_same_kind_of_thing(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info = answer(capsys, "info", ball)
    assert set(info) >= BUILT
    assert set(info["quality"]) >= QUALITY
    assert set(info["quality"]["scaled_jacobian"]) >= SCALED
    assert info["quality"]["refuted"] == info["quality"]["undecided"] == 0
    fine = answer(capsys, "refine", ball, "-o", ball.with_name("fine.npz"))
    assert fine["elements"]["hexahedron"] == 8 * info["elements"]["hexahedron"]
    assert abs(fine["volume"] - info["volume"]) < 1e-12
    raised = answer(capsys, "refine", ball, "--elevate", 1, "-o", ball.with_name("raised.npz"))
    assert raised["degree"] == info["degree"] + 1
    assert raised["elements"] == info["elements"]


def test_solve_answers_and_writes(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ball.with_name("out.vtu")
    found = answer(capsys, "solve", ball, "--heat", "--exact", "1+2*x-3*y+0.5*z", "-o", out)
    assert set(found) >= SOLVED
    assert found["relative_h1_error"] < 1e-11
    assert out.is_file()
    found = answer(capsys, "solve", ball, "--elasticity", "--exact", "x+2*y;3*z-y;x-y+z", "--solver", "cg")
    assert found["relative_h1_error"] < 1e-10
    assert found["iterations"] > 0


def test_problem_file(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = ball.with_name("case.toml")
    lines = ['problem = "heat"', "[material]", "conductivity = 2", "[load]", "source = 6"]
    lines += ['[boundary."*"]', "temperature = 0"]
    case.write_text("\n".join(lines))
    found = answer(capsys, "solve", ball, case)
    # u = (1 - r^2) / 2 on the unit ball.
    assert abs(found["extrema"]["temperature"][1] - 0.5) < 0.05


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a command that must exit 2 with one line."""
    assert main(list(map(str, words))) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


def test_bad_input_is_one_line(ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.npz"
    assert "nothing.msh" in refused(capsys, "build", "nothing.msh", "--source", "tets", "-o", out)
    assert "wood" in refused(capsys, "build", "ball", "--source", "wood", "-o", out)
    assert "colour" in refused(capsys, "build", "ball", "--source", "tets", "--set", "colour=red", "-o", out)
    assert "key=value" in refused(capsys, "build", "ball", "--source", "tets", "--set", "colour", "-o", out)
    assert not out.exists()
    junk = tmp_path / "junk.npz"
    junk.write_bytes(b"PK\x03\x04 not a zip")
    assert "junk.npz" in refused(capsys, "info", junk)
    assert "say what to solve" in refused(capsys, "solve", ball, "--heat")
    assert "import" in refused(capsys, "solve", ball, "--heat", "--exact", "__import__('os').system('true')")
    assert "negative" in refused(capsys, "refine", ball, "--levels", -1, "-o", out)
    assert "no study" in refused(capsys, "study", "run", "of_nothing")
    assert "suffix" in refused(capsys, "export", ball, "-o", tmp_path / "x.stl")
    assert "shape of this name (cube, ball)" in refused(capsys, "build", "bal", "--source", "tets", "-o", out)


def test_places_are_checked_before_the_work(
    ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError("the work began")

    for name in ("geometry.build", "geometry.refine", "problems.solve_exact", "studies.describe.export",
                 "studies.drawing.plot_domain"):
        monkeypatch.setattr(name, worked)
    missing = tmp_path / "no" / "x"
    assert "there is no folder" in refused(capsys, "build", "ball", "--source", "tets", "-o", missing)
    assert "there is no folder" in refused(capsys, "refine", ball, "-o", missing)
    assert "there is no folder" in refused(capsys, "export", ball, "-o", missing.with_suffix(".vtk"))
    assert "there is no folder" in refused(capsys, "solve", ball, "--heat", "--exact", "x", "-o", f"{missing}.vtu")
    assert "there is no folder" in refused(capsys, "plot", ball, "-o", f"{missing}.png")
    assert "end in .png" in refused(capsys, "plot", ball, "-o", tmp_path / "x.gif")
    assert "end in .vtu" in refused(capsys, "solve", ball, "--heat", "--exact", "x", "-o", tmp_path / "x.vtk")


def test_wrong_words_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """An option or name that a command would not heed is an error, and says what is expected."""
    for said, words in (
        ("unrecognized arguments: of_nothing", "study list of_nothing"),
        ("unrecognized arguments: --size", "study check tet_to_hex_exactness --size full"),
        ("unrecognized arguments: --mesh", "bench cube --mesh a.vtk"),
        ("three numbers as 1,-2,0.5 are needed, not '1,0'", "plot a.npz -o a.png --view 1,0"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(words.split())
        assert stop.value.code == 2
        assert said in capsys.readouterr().err
    assert "must be positive" in refused(capsys, "bench", "cube", "--elements", "0")


def test_settings_reach_the_source_as_they_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The source alone knows what they are: a file or an attribute may be called 7."""
    assert settings_of(["labels=7", "mend=true", "corners=1,2,3; 4,5,6", "features="]) == {
        "labels": "7", "mend": "true", "corners": "1,2,3; 4,5,6", "features": "",
    }
    target = ("-o", tmp_path / "x.npz")
    for said, words in (
        ("--set degree is given twice, '1' and '2'", ("--set", "degree=1", "--set", "degree=2")),
        ("--set takes key=value, not 'degree'", ("--set", "degree")),
        ("degree must be a whole number from 0 to 30, not '1.5'", ("--set", "degree=1.5")),
    ):
        assert said in refused(capsys, "build", "cube", *words, *target)
    assert main(["build", "cube", "--set", "elements=2", "--set", "degree=2", *map(str, target), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["degree"] == 2


def test_folded_solids_are_built_and_not_solved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from geometry.tet_to_hex import degree_of
    from iga.store import load, save

    path = tmp_path / "folded.npz"
    assert main(["build", "ball", "--source", "tets", "--set", "n=1", "-o", str(path)]) == 0
    domain = load(path)
    points = domain.points.copy()
    block = domain.space.blocks[0]
    assert degree_of(block.n) == 2
    points[block.dofs[0, 1]] += 3.0
    from dataclasses import replace

    save(replace(domain, points=points, report={}), path)
    capsys.readouterr()
    found = answer(capsys, "info", path)["quality"]
    assert found["refuted"] > 0
    assert 0 < len(found["folds"]) <= 10
    assert found["folds"][0]["det"] < 0
    assert len(found["folds"][0]["x"]) == 3
    assert "folded" in refused(capsys, "solve", path, "--heat", "--exact", "x")
    assert main(["solve", str(path), "--heat", "--exact", "x", "--allow-invalid"]) in (0, 1)


def test_rows_of_a_report_have_names(capsys: pytest.CaptureFixture[str]) -> None:
    """What a person sees of a list of rows says what its numbers are, also where a row lacks some."""
    _show({"report": {"rounds": [{"stage": "first fit", "cells": 8, "away": 0.25}, {"stage": "end", "ended": "near"}]}})
    assert capsys.readouterr().out.splitlines() == [
        "report:", "  rounds:",
        "    stage      cells  away  ended",
        "    first fit  8      0.25",
        "    end                     near",
    ]  # fmt: skip
    assert main(["sources"]) == 0
    assert capsys.readouterr().out.startswith("nurbs     ")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.startswith("iga 0.")


def test_help_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["build"], ["solve"], ["study"], ["study", "run"], ["bench", "cube"]):
        with pytest.raises(SystemExit) as stop:
            main([*words, "--help"])
        assert stop.value.code == 0
        assert "usage: iga" in capsys.readouterr().out


def test_sources_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    names = [row["source"] for row in answer(capsys, "sources")["sources"]]
    assert set(names) >= {"nurbs", "tets", "catmull_clark"}
    assert "convert" in answer(capsys, "sources", "tets")["about"]
    assert "elevate" in answer(capsys, "sources", "nurbs")["about"]
    assert "there are: nurbs" in refused(capsys, "sources", "wood")
