"""Bad input of the source "hybrid", one test each; units, names and colours of files that are good."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import geometry
from geometry.cad.brep import Curve, check_brep
from geometry.cad.kernel import explore
from geometry.cad.reading import brep_of
from geometry.hybrid import read_cad, shapes
from geometry.hybrid.skin import build_skin
from iga.errors import FormatError, InputError
from tests.geometry.test_hybrid_cad import write_step


def box(size: float = 1.0) -> Any:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    return BRepPrimAPI_MakeBox(size, size, size).Shape()


def prism(*curves: Any) -> Any:
    """Solid over a plane region bounded by curves, one unit high."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
    from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
    from OCP.gp import gp_Vec

    wire = BRepBuilderAPI_MakeWire()
    for curve in curves:
        wire.Add(curve)
    return BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(wire.Wire(), True).Face(), gp_Vec(0, 0, 1)).Shape()


def line(a: tuple[float, float], b: tuple[float, float]) -> Any:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.gp import gp_Pnt

    return BRepBuilderAPI_MakeEdge(gp_Pnt(*a, 0.0), gp_Pnt(*b, 0.0)).Edge()


def refused(call: Any, *arguments: Any) -> str:
    """The one line of a refusal."""
    with pytest.raises(InputError) as caught:
        call(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_open_shell(tmp_path: Path) -> None:
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Shell

    shell, builder = TopoDS_Shell(), BRep_Builder()
    builder.MakeShell(shell)
    for face in explore(box(), "FACE")[:5]:
        builder.Add(shell, face)
    message = refused(read_cad, write_step(shell, tmp_path / "open.step"))
    assert "no closed solid" in message
    assert re.search(r"open at the edge \(.*\) of face_\d", message)


def test_loop_that_crosses_itself(tmp_path: Path) -> None:
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.3)]
    shape = prism(*(line(a, b) for a, b in zip(corners, corners[1:] + corners[:1])))
    message = refused(brep_of, shape, "bow.step")
    assert re.search(r"bow.step: face_\d is not valid \(loops that cross or do not close\)", message)


def test_edge_beyond_tolerance() -> None:
    brep = shapes.curved_box()
    edge = brep.edges[3]
    bent = edge.curve.control.copy()
    bent[len(bent) // 2] += 0.05
    edges = (*brep.edges[:3], replace(edge, curve=Curve(edge.curve.knots, bent)), *brep.edges[4:])
    message = refused(check_brep, replace(brep, edges=edges), "box")
    assert re.search(r"box: edge 3 lies 0.0\d+ off face_\d and face_\d", message)


def test_loop_with_a_gap_in_the_short_direction() -> None:
    """The gap is a twentieth of the face's width, and less than a thousandth of its length."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    brep = brep_of(BRepPrimAPI_MakeBox(100.0, 1.0, 1.0).Shape(), "bar")
    extents = [np.array([np.ptp(k) for k in face.surface.knots]) for face in brep.faces]
    number = next(k for k, extent in enumerate(extents) if extent.max() > 50.0 * extent.min())
    face, short = brep.faces[number], int(extents[number].argmin())
    first, *others = face.loops[0]
    moved = first.curve.control.copy()
    moved[:, short] += 0.05
    loop = (replace(first, curve=Curve(first.curve.knots, moved)), *others)
    faces = (*brep.faces[:number], replace(face, loops=(loop, *face.loops[1:])), *brep.faces[number + 1 :])
    message = refused(check_brep, replace(brep, faces=faces), "bar")
    assert message.startswith(f"bar: {face.name} has a loop with a gap at (u, v) = ")


def test_missing_curve_in_the_parameter_plane() -> None:
    from OCP.BRep import BRep_Builder
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.Geom2d import Geom2d_Curve
    from OCP.TopoDS import TopoDS

    shape = BRepPrimAPI_MakeCylinder(1.0, 2.0).Shape()
    face = next(f for f in explore(shape, "FACE") if len(explore(f, "EDGE")) == 3)
    circle = next(e for e in explore(face, "EDGE") if len(explore(e, "VERTEX")) == 1)
    nothing: Geom2d_Curve | None = None
    BRep_Builder().UpdateEdge(TopoDS.Edge(circle), nothing, TopoDS.Face(face), 1e-7)
    assert re.search(r"can: face_\d: its edge \d has no curve in the parameter plane", refused(brep_of, shape, "can"))


def test_assembly_asks_which_solid(tmp_path: Path) -> None:
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    pair, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(pair)
    for size in (1.0, 2.0):
        builder.Add(pair, box(size))
    path = write_step(pair, tmp_path / "pair.step")
    assert "2 solids" in refused(read_cad, path)
    assert "solid=0 .. 1" in refused(geometry.build, path, "hybrid")
    assert "no solid 2" in refused(read_cad, path, 2)
    assert [read_cad(path, i).volume for i in (0, 1)] == pytest.approx([1, 8])
    domain = geometry.build(path, "hybrid", solid="1", size="1", subdivide="0")
    assert domain.report["cad_volume"] == pytest.approx(8)


@pytest.mark.parametrize(("unit", "millimetres"), [("M", 1000.0), ("INCH", 25.4), ("MM", 1.0)])
def test_units_become_millimetres(tmp_path: Path, unit: str, millimetres: float) -> None:
    from OCP.Interface import Interface_Static

    shape = box(25.4)
    Interface_Static.SetCVal_s("write.step.unit", unit)
    try:
        path = write_step(shape, tmp_path / "box.step")
    finally:
        Interface_Static.SetCVal_s("write.step.unit", "MM")
    text = path.read_text()
    # What the file says is the length in its own unit.
    x = [float(v) for v in re.findall(r"CARTESIAN_POINT\('',\(([-0-9.E+]+),", text)]
    assert max(x) == pytest.approx(25.4 / millimetres, rel=1e-12)
    assert read_cad(path).volume == pytest.approx(25.4**3, rel=1e-9)


def test_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "empty.step"
    path.write_bytes(b"")
    with pytest.raises(FormatError, match=r"empty.step: this is not a CAD file; STEP begins with"):
        read_cad(path)


def test_text_that_is_not_step(tmp_path: Path) -> None:
    path = tmp_path / "letter.step"
    path.write_text("Dear reader,\nthis is a letter.\n")
    with pytest.raises(FormatError, match=r"letter.step: this is not a CAD file; STEP begins with"):
        read_cad(path)


def test_cut_off_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """And the kernel's own words stay off standard output, where a command's JSON goes."""
    path = write_step(box(), tmp_path / "box.step")
    path.write_bytes(path.read_bytes()[:2000])
    capfd.readouterr()
    with pytest.raises(InputError, match=r"Open CASCADE finds no shape in this STEP file; it is cut off"):
        read_cad(path)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("word", ["nan", "-INF", "1e300", "1.E+0101"])
def test_numbers_that_are_none(tmp_path: Path, word: str) -> None:
    """The kernel reads nan without a word, and its checks of a solid do not end then; in a name it is a word."""
    path = write_step(box(), tmp_path / "box.step")
    text = path.read_text().replace("FILE_DESCRIPTION(('", "FILE_DESCRIPTION(('(nan,inf)", 1)
    path.write_text(text)
    assert read_cad(path).volume == pytest.approx(1.0)
    before, number, after = text.partition("CARTESIAN_POINT('',(")
    path.write_text(before + number + word + after[after.index(",") :])
    line = before.count("\n") + 1
    assert f"box.step: line {line} has {word}, which is no finite number" in refused(read_cad, path)


def test_cusp_is_refused_with_its_edges() -> None:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.gp import gp_Ax2, gp_Circ, gp_Dir, gp_Pnt

    circle = gp_Circ(gp_Ax2(gp_Pnt(0, 1, 0), gp_Dir(0, 0, 1)), 1.0)
    arc = BRepBuilderAPI_MakeEdge(circle, gp_Pnt(0, 0, 0), gp_Pnt(1, 1, 0)).Edge()
    under = prism(line((0.0, 0.0), (1.0, 0.0)), line((1.0, 0.0), (1.0, 1.0)), arc)
    message = refused(build_skin, brep_of(under, "horn"), 0.2, 2e-5, "horn")
    assert re.search(r"horn: face_\d has a cusp at \(.*\): its edges \d+ and \d+ leave in the same direction", message)
    # Outside of the same arc the angle is 180 degrees less 0: no cusp.
    beside = prism(line((0.0, 0.0), (-1.0, 0.0)), line((-1.0, 0.0), (-1.0, 2.0)), line((-1.0, 2.0), (1.0, 2.0)),
                   line((1.0, 2.0), (1.0, 1.0)), arc)
    assert build_skin(brep_of(beside, "beside")).report["folded"] == 0


def coloured(path: Path) -> Path:
    """Box with one red face, and names for three faces."""
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    shape = box()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).AddShape(shape)
    red = Quantity_Color(1.0, 0.0, 0.0, Quantity_TypeOfColor.Quantity_TOC_RGB)
    XCAFDoc_DocumentTool.ColorTool_s(document.Main()).SetColor(
        explore(shape, "FACE")[2], red, XCAFDoc_ColorType.XCAFDoc_ColorSurf
    )
    writer = STEPCAFControl_Writer()
    writer.Transfer(document)
    writer.Write(str(path))
    names = iter(["inlet", "outlet", "wall", "", "wall", ""])
    text = re.sub(r"ADVANCED_FACE\('[^']*'", lambda _: f"ADVANCED_FACE('{next(names)}'", path.read_text())
    path.write_text(text)
    return path


def test_names_and_colours_are_kept(tmp_path: Path) -> None:
    path = coloured(tmp_path / "box.step")
    brep = read_cad(path)
    assert [face.name for face in brep.faces] == ["inlet", "outlet", "wall", "face_3", "wall", "face_5"]
    assert [face.colour for face in brep.faces] == ["", "", "#ff0000", "", "", ""]
    domain = geometry.build(path, "hybrid", size=1, subdivide=0)
    assert set(domain.boundaries) == {"inlet", "outlet", "wall", "face_3", "face_5"}
    counted = {name: sum(len(f.elements) for f in own) for name, own in domain.boundaries.items()}
    assert counted["wall"] == 2 * counted["inlet"]  # both faces of that name
    assert np.isclose(domain.report["cad_volume"], 1.0)
