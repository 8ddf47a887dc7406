"""From a STEP file with named faces to answers, by the command line: a quarter of a thick tube."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.cli import main

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("netgen") is None or importlib.util.find_spec("OCP") is None,
    reason="the extra for CAD is not installed",
)
INNER, OUTER, HEIGHT = 10.0, 20.0, 8.0
E, NU, PRESSURE = 1000.0, 0.3, 7.0
HEAT = """
problem = "heat"
[material]
conductivity = 2.0
[boundary.bore]
temperature = 100
[boundary.jacket]
temperature = 0
"""
LAME = f"""
problem = "elasticity"
[material]
E = {E}
nu = {NU}
[boundary.bore]
pressure = {PRESSURE}
[boundary."cut x"]
displacement = [0, "free", "free"]
[boundary."cut y"]
displacement = ["free", 0, "free"]
[boundary."end*"]
displacement = ["free", "free", 0]
"""


def tube(folder: Path) -> Path:
    """Write the STEP file: faces are named by what they are."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    from geometry.cad.brep import surface_points
    from geometry.hybrid import read_cad

    solid = BRepAlgoAPI_Cut(
        BRepPrimAPI_MakeCylinder(OUTER, HEIGHT, np.pi / 2).Shape(),
        BRepPrimAPI_MakeCylinder(INNER, HEIGHT, np.pi / 2).Shape(),
    ).Shape()
    writer = STEPControl_Writer()
    writer.Transfer(solid, STEPControl_StepModelType.STEPControl_AsIs)
    path = folder / "tube.step"
    writer.Write(str(path))
    text = path.read_text()
    pieces = text.split("ADVANCED_FACE('',")
    assert len(pieces) == 7
    path.write_text("".join(f"{piece}ADVANCED_FACE('number{k}'," for k, piece in enumerate(pieces[:-1])) + pieces[-1])
    found = {}
    for face in read_cad(path).faces:
        ends = np.array([k[[0, -1]] for k in face.surface.knots])
        x, y, z = surface_points(face.surface, ends.mean(axis=1)[None])[0]
        radius = np.hypot(x, y)
        planes = {"cut x": abs(x), "cut y": abs(y), "end low": abs(z), "end high": abs(z - HEIGHT)}
        rounds = {"bore": abs(radius - INNER), "jacket": abs(radius - OUTER)}
        tests = planes if face.kind == "plane" else rounds
        found[face.name] = min(tests, key=lambda name: tests[name])
    assert len(set(found.values())) == 6
    text = path.read_text()
    for old, new in found.items():
        text = text.replace(f"'{old}'", f"'{new}'")
    path.write_text(text)
    return path


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tube")


@pytest.mark.parametrize("convert", ["none", "hex4"])
def test_conditions_reach_the_faces_of_their_names(
    convert: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = folder / f"tube_{convert}.npz"
    built = answer(
        capsys, "build", tube(folder), "--source", "hybrid", "--set", "tolerance=1e-4", "--set", "subdivide=0",
        "--set", f"convert={convert}", "-o", part,
    )  # fmt: skip
    assert set(built["boundaries"]) == {"bore", "jacket", "cut x", "cut y", "end low", "end high"}
    assert built["quality"]["certified"] == sum(built["elements"].values())
    assert set(built["elements"]) == {"tetrahedron" if convert == "none" else "hexahedron"}

    (folder / "heat.toml").write_text(HEAT)
    heat = answer(capsys, "solve", part, folder / "heat.toml")
    flow = 0.5 * np.pi * HEIGHT * 2.0 * 100.0**2 / np.log(OUTER / INNER)  # k dT^2 (pi/2) h / ln(b/a)
    assert heat["energy"] == pytest.approx(0.5 * flow, rel=2e-3)
    low, high = heat["extrema"]["temperature"]  # at Gauss points
    assert 0.0 < low < 2.0
    assert 98.0 < high < 100.0

    (folder / "lame.toml").write_text(LAME)
    found = answer(capsys, "solve", part, folder / "lame.toml")
    # Radial displacement of the bore in plane strain (Lame).
    a2, b2 = INNER**2, OUTER**2
    u = PRESSURE * INNER * (1 + NU) / E * ((1 - 2 * NU) * a2 + b2) / (b2 - a2)
    work = PRESSURE * u * 0.5 * np.pi * INNER * HEIGHT
    assert found["energy"] == pytest.approx(0.5 * work, rel=2e-3)


def test_a_name_that_is_not_there_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = folder / "tube_none.npz"
    if not part.exists():
        assert main(["build", str(tube(folder)), "--source", "hybrid", "--set", "tolerance=1e-4", "-o", str(part)]) == 0
    (folder / "wrong.toml").write_text(HEAT.replace("jacket", "shirt"))
    capsys.readouterr()
    assert main(["solve", str(part), str(folder / "wrong.toml")]) == 2
    said = capsys.readouterr().err
    assert "shirt" in said
    assert "jacket" in said
