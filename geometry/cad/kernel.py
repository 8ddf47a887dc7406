"""Open CASCADE: reading of STEP and IGES files, parts of shapes, their measures, names and colours.

With `reading` and `hybrid.shapes` this module alone touches Open CASCADE, and imports it when first used.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.errors import FormatError

Array = NDArray[np.float64]
Label = Callable[[Any], tuple[str, str]]
"""Name and colour of a face or solid."""
SEWING = 1e-4
"""Distance (millimetres) within which edges of loose faces are one."""


def where_open(shape: Any) -> str:
    """Where a shell is open: its first edge that one face alone has."""
    seen: dict[int, list[tuple[int, Any]]] = {}
    for number, face in enumerate(explore(shape, "FACE")):
        for edge in explore(face, "EDGE"):
            seen.setdefault(key_of(edge), []).append((number, edge))
    for uses in seen.values():
        if len(uses) == 1:
            from OCP.BRep import BRep_Tool
            from OCP.TopoDS import TopoDS

            number, edge = uses[0]
            if not BRep_Tool.Degenerated_s(TopoDS.Edge(edge)):
                ends = [xyz(BRep_Tool.Pnt_s(TopoDS.Vertex(v))) for v in explore(edge, "VERTEX")]
                where = " - ".join("({:.6g}, {:.6g}, {:.6g})".format(*p) for p in ends)
                return f"; the shell is open at the edge {where} of face_{number}"
    return ""


def key_of(shape: Any) -> int:
    """The same number for a face or edge wherever it is met, whichever way round."""
    return hash(shape.Located(type(shape.Location())()).Oriented(_forward()))


def _forward() -> Any:
    from OCP.TopAbs import TopAbs_Orientation

    return TopAbs_Orientation.TopAbs_FORWARD


def xyz(p: Any) -> tuple[float, float, float]:
    """Coordinates of a point or vector."""
    return p.X(), p.Y(), p.Z()


def explore(shape: Any, what: str) -> list[Any]:
    """Parts of a shape, each once, in the kernel's order."""
    from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher as ShapeMap
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp

    found = ShapeMap()
    TopExp.MapShapes_s(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{what}"), found)
    return [found.FindKey(i + 1) for i in range(found.Extent())]


def measures(shape: Any) -> tuple[float, float]:
    """Volume and area.

    The volume is the one by Gauss-Kronrod rules: the kernel's plain call may be wrong by a percent, and its call with
    a tolerance stops too early on long thin faces (5e-4 on a wing, which `integrals` shows).
    """
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    volume, area = GProp_GProps(), GProp_GProps()
    BRepGProp.VolumePropertiesGK_s(shape, volume, 1e-8, False, True, False, False, False)
    BRepGProp.SurfaceProperties_s(shape, area, 1e-7)
    return float(volume.Mass()), float(area.Mass())


def quiet() -> None:
    """No messages of the kernel: it prints on standard output, where ``--json`` has one object and nothing else."""
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    for printer in list(messenger.Printers()):
        messenger.RemovePrinter(printer)


_NO_NUMBER = re.compile(
    rb"[(,]\s*([+-]?(?:(?:nan|inf)[a-z]*|[\d.]+e\+?0*(?:10[1-9]|1[1-9]\d|[2-9]\d\d|[1-9]\d{3,})))\s*[,)]", re.IGNORECASE
)
"""NaN, infinity, and numbers beyond 2e100, which is the kernel's infinity."""


def check_step(path: Path) -> None:
    """Refuse what is no finite number in a STEP file: the kernel reads it, and its checks of a solid may not end then.

    Raises
    ------
    FormatError : naming the line.
    """
    text = re.sub(rb"'[^']*'", lambda quoted: b"''" + b"\n" * quoted[0].count(b"\n"), path.read_bytes())
    found = _NO_NUMBER.search(text)
    if found:
        line = text.count(b"\n", 0, found.start(1)) + 1
        raise FormatError(f"{path}: line {line} has {found[1].decode()}, which is no finite number")


def read_step(path: Path) -> tuple[Any, Label]:
    """Shape of a STEP file, and names and colours of its faces and solids.

    Raises
    ------
    FormatError : the kernel cannot read the file.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Quantity import Quantity_Color
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    quiet()
    check_step(path)
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    reader = STEPCAFControl_Reader()
    reader.SetColorMode(True)
    try:
        read = reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone and reader.Transfer(document)
    except Exception as error:  # whatever the kernel throws at bytes it cannot read
        raise FormatError(f"{path}: Open CASCADE cannot read this STEP file: {str(error).splitlines()[0]}") from error
    shape = reader.Reader().OneShape() if read else None
    if shape is None or shape.IsNull():
        cut_off = b"END-ISO-10303-21" not in path.read_bytes()
        hint = "; it is cut off, END-ISO-10303-21 is missing" if cut_off else ""
        raise FormatError(f"{path}: Open CASCADE finds no shape in this STEP file{hint}")
    transfer = reader.Reader().WS().TransferReader()
    tool = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

    def read_label(part: Any) -> tuple[str, str]:
        entity = transfer.EntityFromShapeResult(part, 1)
        text = entity.Name() if entity is not None and hasattr(entity, "Name") else None
        name = text.ToCString().strip() if text is not None else ""
        colour = Quantity_Color()
        kinds = (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen)
        code = ""
        if any(tool.GetColor(part, kind, colour) for kind in kinds):
            levels = [round(255 * c) for c in (colour.Red(), colour.Green(), colour.Blue())]
            code = "#{:02x}{:02x}{:02x}".format(*levels)
        return ("" if name.upper() in ("NONE", "UNKNOWN") else name), code

    # Read now: the document and its tables go when this function returns.
    parts = [*explore(shape, "SOLID"), *explore(shape, "FACE")]
    labels = {key_of(part): read_label(part) for part in parts}
    return shape, lambda part: labels.get(key_of(part), ("", ""))


def read_iges(path: Path) -> tuple[Any, Label]:
    """Shape of an IGES file, loose faces sewn; it gives no names.

    Raises
    ------
    FormatError : the kernel cannot read the file.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.IGESControl import IGESControl_Reader
    from OCP.TopoDS import TopoDS

    quiet()
    reader = IGESControl_Reader()
    try:
        read = reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
        if read:
            reader.TransferRoots()
            shape = reader.OneShape()
    except Exception as error:
        raise FormatError(f"{path}: Open CASCADE cannot read this IGES file: {str(error).splitlines()[0]}") from error
    if not read or shape.IsNull():
        raise FormatError(f"{path}: Open CASCADE finds no shape in this IGES file")
    if not explore(shape, "SOLID"):
        # IGES mostly holds loose faces: sew them.
        sewing = BRepBuilderAPI_Sewing(SEWING)
        sewing.Add(shape)
        sewing.Perform()
        shells = [s for s in explore(sewing.SewedShape(), "SHELL") if s.Closed()]
        if len(shells) == 1:
            shape = BRepBuilderAPI_MakeSolid(TopoDS.Shell(shells[0])).Solid()
    return shape, lambda part: ("", "")
