"""CAD files and solids made by Booleans as plain arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.cad.brep import (
    Brep,
    curve_points,
    curve_tangents,
    fit_curve,
    sealing_gap,
    surface_frame,
    surface_points,
)
from geometry.cad.reading import cad_format
from geometry.hybrid import read_cad, shapes
from iga.errors import FormatError, InputError


def write_step(shape: object, path: Path) -> Path:
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    from geometry.cad.kernel import quiet

    quiet()
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))
    return path


def drilled_plate() -> object:
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    box = BRepPrimAPI_MakeBox(gp_Pnt(0, 0, 0), gp_Pnt(40, 30, 10)).Shape()
    rod = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(15, 15, -1), gp_Dir(0, 0, 1)), 5, 12).Shape()
    return BRepAlgoAPI_Cut(box, rod).Shape()


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Brep:
    return read_cad(write_step(drilled_plate(), tmp_path_factory.mktemp("cad") / "plate.step"))


def test_fitted_curve_meets_its_tolerance() -> None:
    def spiral(t: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(9 * t), np.sin(9 * t), t], axis=1)

    t = np.linspace(0, 1, 1001)
    for tolerance in (1e-4, 1e-9):
        apart = np.linalg.norm(curve_points(fit_curve(spiral, tolerance), t) - spiral(t), axis=1)
        assert apart.max() < 2 * tolerance
    curve = fit_curve(lambda t: np.stack([t**5 - t, t**2], axis=1), 1e-12)
    assert len(curve.control) == 6
    assert curve_tangents(curve, np.array([0.5]))[0] == pytest.approx([5 / 16 - 1, 1.0], abs=1e-12)


def test_drilled_plate_arrives_whole(plate: Brep) -> None:
    assert plate.volume == pytest.approx(40 * 30 * 10 - np.pi * 250, rel=1e-6)
    assert sorted(f.kind for f in plate.faces) == ["cylinder"] * 2 + ["plane"] * 6
    assert len({f.name for f in plate.faces}) == 7  # the two halves of the bore share a name
    assert len(plate.vertices) - len(plate.edges) + len(plate.faces) == 2 + 2 - 4 + sum(
        len(f.loops) - 1 for f in plate.faces
    )  # Euler-Poincare: genus 1, faces with inner loops
    assert sealing_gap(plate).max() < 1e-8 * plate.diagonal


def test_cylinder_is_exact(plate: Brep) -> None:
    random = np.random.default_rng(5)
    for face in plate.faces:
        if face.kind == "cylinder":
            low, high = (np.array([k[i] for k in face.surface.knots]) for i in (0, -1))
            uv = low + (high - low) * random.random((50, 2))
            x, du, dv = surface_frame(face.surface, uv)
            assert np.abs(np.hypot(x[:, 0] - 15, x[:, 1] - 15) - 5).max() < 1e-12
            outwards = np.cross(du, dv) * (-1 if face.reversed else 1)
            assert (np.einsum("qc,qc->q", outwards[:, :2], x[:, :2] - 15) < 0).all()  # out of the solid, into the bore
            e = 1e-6
            assert np.abs((surface_points(face.surface, uv + np.array([e, 0.0])) - x) / e - du).max() < 1e-4


def test_loops_run_with_the_inside_on_their_left(plate: Brep) -> None:
    for face in plate.faces:
        areas = []
        for loop in face.loops:
            t = np.linspace(0, 1, 200)
            uv = np.concatenate([curve_points(c.curve, t[::-1] if c.reversed else t) for c in loop])
            areas.append(0.5 * np.sum(uv[:, 0] * np.roll(uv[:, 1], -1) - uv[:, 1] * np.roll(uv[:, 0], -1)))
        assert areas[0] > 0
        assert all(a < 0 for a in areas[1:])


@pytest.mark.parametrize(("name", "faces"), [("curved_difference", 9), ("tetrapod", 16), ("bracket", 23)])
def test_shapes_are_closed(name: str, faces: int) -> None:
    brep = shapes.SHAPES[name]()
    assert len(brep.faces) == faces
    assert sealing_gap(brep).max() < 1e-6 * brep.diagonal
    assert brep.volume > 0


def test_files_that_are_refused(tmp_path: Path) -> None:
    cases = {
        "text.step": (b"hello", "not a CAD file"),
        "empty.step": (b"", "not a CAD file"),
        "mesh.obj": (b"v 0 0 0\nv 1 0 0\n", "STEP begins"),
        "cut.step": (b"ISO-10303-21;\nHEADER;\nFILE_DESC", "Open CASCADE"),
    }
    for name, (text, message) in cases.items():
        (tmp_path / name).write_bytes(text)
        with pytest.raises(FormatError, match=message):
            read_cad(tmp_path / name)
    with pytest.raises(FormatError, match="no such file"):
        read_cad(tmp_path / "nothing.step")


def test_iges_is_sewn(tmp_path: Path) -> None:
    from OCP.IGESControl import IGESControl_Writer

    writer = IGESControl_Writer()
    writer.AddShape(drilled_plate())
    writer.Write(str(tmp_path / "plate.igs"))
    assert cad_format(tmp_path / "plate.igs") == "IGES"
    # The kernel integrates the rational faces that IGES makes of the bore to 1.4e-6.
    assert read_cad(tmp_path / "plate.igs").volume == pytest.approx(12000 - np.pi * 250, rel=1e-5)


@settings(max_examples=15, deadline=None)
@given(st.binary(max_size=300))
def test_hostile_bytes_give_one_line(tmp_path_factory: pytest.TempPathFactory, junk: bytes) -> None:
    path = tmp_path_factory.mktemp("junk") / "junk.step"
    path.write_bytes(b"ISO-10303-21;\n" + junk)
    with pytest.raises(InputError) as caught:
        read_cad(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("file", "solid", "faces", "gap"), [
    ("block_torus_fillet3.step", None, 10, 1e-7), ("tail_turbine.stp", None, 20, 1e-4),
    ("io1-cm-214.stp", None, 29, 1e-7), ("wrenchnut.stp", 0, 28, 1e-4),
])  # fmt: skip
def test_real_parts(data: Path, file: str, solid: int | None, faces: int, gap: float) -> None:
    brep = read_cad(data / "cad" / file, solid)
    assert len(brep.faces) == faces
    assert sealing_gap(brep).max() < gap * brep.diagonal  # what the files themselves keep
