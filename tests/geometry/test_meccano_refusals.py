"""Input that makes no solid, by the command line: exit status 2, one line that says what is wrong, no file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geometry.meccano.shapes import ball, torus
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface, volume
from studies.cli import main


def write(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    lines = [f"OFF\n{len(points)} {len(triangles)} 0", *(" ".join(map(str, p)) for p in points.tolist())]
    lines += [f"3 {a} {b} {c}" for a, b, c in triangles.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def open_surface() -> tuple[np.ndarray, np.ndarray]:
    return ball(3).points, ball(3).triangles[1:]


def non_manifold_edge() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    return whole.points, np.concatenate([whole.triangles, whole.triangles[:1]])


def non_manifold_vertex() -> tuple[np.ndarray, np.ndarray]:
    """Two balls with one vertex in common."""
    whole = ball(3)
    other = np.where(whole.triangles == 0, 0, whole.triangles + len(whole.points) - 1)
    mirrored = 2.0 * whole.points[0] - whole.points[1:]
    return np.concatenate([whole.points, mirrored]), np.concatenate([whole.triangles, other[:, ::-1]])


def self_intersecting() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    points = whole.points.copy()
    points[np.argmax(points[:, 2])] = (0.0, 0.0, -3.0)
    return points, whole.triangles


def two_shells() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    return (
        np.concatenate([whole.points, whole.points + 5.0]),
        np.concatenate([whole.triangles, whole.triangles + len(whole.points)]),
    )


def partly_inside_out() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    triangles = whole.triangles.copy()
    triangles[::2] = triangles[::2, ::-1]
    return whole.points, triangles


def degenerate() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    points = whole.points.copy()
    points[whole.triangles[0, 0]] = points[whole.triangles[0, 1]]
    return points, whole.triangles


def not_a_number() -> tuple[np.ndarray, np.ndarray]:
    whole = ball(3)
    points = whole.points.copy()
    points[7, 1] = np.nan
    return points, whole.triangles


def holed() -> tuple[np.ndarray, np.ndarray]:
    return torus(12, 6).points, torus(12, 6).triangles


def whole() -> tuple[np.ndarray, np.ndarray]:
    return ball(6).points, ball(6).triangles


CASES = {
    "open": (open_surface, [], "belongs to one triangle only"),
    "non-manifold edge": (non_manifold_edge, [], "belongs to 3 triangles"),
    "non-manifold vertex": (non_manifold_vertex, [], "fans"),
    "self-intersecting": (self_intersecting, [], "cross each other"),
    "many shells": (two_shells, [], "2 shells"),
    "partly inside-out": (partly_inside_out, [], "opposite orientations"),
    "degenerate triangle": (degenerate, [], "degenerate"),
    "NaN": (not_a_number, [], "vertex 7 has a coordinate"),
    "a cube for a torus": (holed, ["meccano=cube"], "genus"),
    "a pillowed cube for a torus": (holed, ["meccano=pillowed"], "genus"),
    "too many cells": (whole, ["meccano=cube", "tolerance=0.02", "max_cells=20"], "more than the limit of 20"),
    "pillowed, too many cells": (whole, ["tolerance=0.001", "max_cells=60"], "wanted, when 60 cells are spent"),
    "too few rounds": (whole, ["tolerance=0.001", "max_cells=500", "rounds=0"], "wanted, when 0 rounds are spent"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_makes_no_solid(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, settings, message = CASES[case]
    path = write(tmp_path / "surface.off", *make())
    sets = [part for setting in settings for part in ("--set", setting)]
    status = main(["build", str(path), "--source", "meccano", *sets, "-o", str(tmp_path / "solid.npz")])
    said = capsys.readouterr().err.strip().splitlines()
    assert status == 2
    assert said[-1].startswith("iga: ")
    assert message in said[-1]
    assert [line for line in said if line.startswith("iga: ")] == said[-1:]
    assert [file.name for file in tmp_path.iterdir()] == ["surface.off"]


def test_wholly_inside_out_surfaces_are_turned_and_said(tmp_path: Path) -> None:
    right = ball(3)
    surface, report = read_surface(write(tmp_path / "turned.off", right.points, right.triangles[:, ::-1]))
    assert "turned" in report
    assert volume(surface) == pytest.approx(volume(Surface(right.points, right.triangles)), rel=1e-12)


def test_solids_that_are_off_are_kept_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write(tmp_path / "surface.off", *whole()), tmp_path / "solid.npz"
    sets = ["--set", "tolerance=0.001", "--set", "max_cells=60", "--set", "off=keep"]
    assert main(["build", str(path), "--source", "meccano", *sets, "-o", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert report["ended"] == "cells spent"
    assert not report["within_tolerance"]
    assert out.is_file()
