"""The tour makes a whole page, with and without the folder of real meshes."""

from __future__ import annotations

from pathlib import Path

import pytest

from iga.progress import QUIET
from studies import demo


def test_solids_without_real_meshes(monkeypatch):
    monkeypatch.setattr(demo, "DATA", Path("none"))
    monkeypatch.setattr(demo, "HEXES", Path("none"))
    scenes = {scene.name: scene for scene in demo._scenes()}
    assert "bob" not in scenes
    assert "fertility" not in scenes
    for name in ("converted", "torus"):
        domain = scenes[name].make()
        solution = scenes[name].solve(domain)
        row = demo._row(scenes[name], domain, solution)
        assert row["residual"] < 1e-8
        assert 0.0 < row["largest"] < 1000.0


def test_a_real_hex_mesh_is_shown_where_it_is(data, monkeypatch):
    monkeypatch.setattr(demo, "HEXES", data / "hex" / "fertility.vtk")
    scene = next(scene for scene in demo._scenes() if scene.name == "fertility")
    domain = scene.make()
    assert sorted(domain.boundaries) == ["between", "high", "low"]
    row = demo._row(scene, domain, scene.solve(domain))
    assert row["residual"] < 1e-8
    assert row["functions"] == 4983
    assert 90.0 < row["largest"] < 110.0


@pytest.mark.long
def test_page(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(demo, "DATA", Path("none"))
    monkeypatch.setattr(demo, "HEXES", Path("none"))
    answer = demo.demo(tmp_path / "demo", QUIET, say=False)
    assert capsys.readouterr().out == ""
    assert all(Path(file).is_file() for file in answer["files"])
    text = (tmp_path / "demo" / "index.html").read_text(encoding="utf-8")
    assert text.count("<section") == 6 + len(demo.STUDIES)
