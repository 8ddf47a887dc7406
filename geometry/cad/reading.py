r"""STEP and IGES files, and Open CASCADE shapes, to `Brep`.

`kernel` and `shapes`, which makes solids in code, touch Open CASCADE as well; it is imported when first used.

Closed faces are split at their seams, and every surface is turned into a B-spline or NURBS surface. Surfaces with an
angle for a parameter become rational quadratics, whose parameter t of an arc of half-angle a about the angle m is

    t = m + a tan((theta - m) / 2) / tan(a / 2),

so the curves in the parameter plane are carried over exactly before they are fitted; that S(c(t)) stays where it was is
checked, not assumed. Lengths are in the unit Open CASCADE converts to, millimetres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, Curve, Edge, Face, check_brep, fit_curve, surface_points
from geometry.cad.kernel import Label, explore, key_of, measures, read_iges, read_step, where_open, xyz
from geometry.inputs import require_file
from geometry.patch import Patch, make_patch
from iga.errors import FormatError, InputError

Array = NDArray[np.float64]

FIT, ENOUGH, DEGREE = 1e-12, 1e-9, 9
"""Tolerance of fitted curves, relative to the diagonal of the solid (in space) or of the face (in its plane), what is
enough where a curve is not smooth, and their degree."""
CARRIED = 1e-7
"""Largest relative distance by which carrying a curve to the NURBS parameter may move its points."""
_ARC_U = ("Cylinder", "Cone", "Sphere", "Torus", "SurfaceOfRevolution")
_ARC_V = ("Sphere", "Torus")


def cad_format(path: str | Path) -> str:
    """"STEP", "IGES" or "" for anything else, from the beginning of the file."""
    try:
        with Path(path).open("rb") as file:
            head = file.read(512)
    except OSError:
        return ""
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"ISO-10303-21"):
        return "STEP"
    line = head.splitlines()[0] if head.splitlines() else b""
    if len(line) >= 80 and line[72:73] == b"S" and line[73:80].strip().isdigit() and b"\0" not in line:
        return "IGES"
    return ""


def read_cad(path: str | Path, solid: int | None = None) -> Brep:
    """Read a solid from a STEP or IGES file.

    Parameters
    ----------
    path : the file.
    solid : which of its solids, from 0; None takes the only one.

    Raises
    ------
    FormatError : the file is not STEP or IGES, or Open CASCADE cannot read it.
    InputError : no solid, several solids and none said, an open shell, faces that are not valid.
    """
    path = require_file(path)
    kind = cad_format(path)
    if not kind:
        raise FormatError(f"{path}: this is not a CAD file; STEP begins with ISO-10303-21;, IGES with a start section")
    shape, label = read_step(path) if kind == "STEP" else read_iges(path)
    solids = explore(shape, "SOLID")
    if not solids:
        faces = len(explore(shape, "FACE"))
        raise InputError(f"{path}: there is no closed solid in it, only {faces} faces{where_open(shape)}")
    if solid is None and len(solids) > 1:
        named = ", ".join(f"{i} {label(s)[0]}".strip() for i, s in enumerate(solids))
        raise InputError(f"{path}: {len(solids)} solids ({named[:160]}); say which with solid=0 .. {len(solids) - 1}")
    number = 0 if solid is None else solid
    if not 0 <= number < len(solids):
        raise InputError(f"{path}: there is no solid {number}; it has {len(solids)}, counted from 0")
    return brep_of(solids[number], path.name, label)


def brep_of(shape: Any, where: str, label: Label | None = None) -> Brep:
    """Arrays of an Open CASCADE solid.

    Parameters
    ----------
    shape : TopoDS_Shape with one solid.
    where : name for messages.
    label : gives name and colour of a face, or of the solid.

    Raises
    ------
    InputError : naming the face or edge that is not valid.
    """
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.ShapeUpgrade import ShapeUpgrade_ShapeDivideClosed

    before = explore(shape, "FACE")
    if not BRepCheck_Analyzer(shape).IsValid():
        bad = [i for i, f in enumerate(before) if not BRepCheck_Analyzer(f).IsValid()]
        for i in bad:
            _require_plane_curves(before[i], f"{where}: face_{i}")
        what = f"face_{bad[0]} is not valid (loops that cross or do not close)" if bad else "the solid is not valid"
        raise InputError(f"{where}: {what}; heal it in the CAD system")
    divide = ShapeUpgrade_ShapeDivideClosed(shape)
    divided = shape
    if divide.Perform():
        divided = divide.Result()
    names, colours = {}, {}
    labels = [label(face) if label else ("", "") for face in before]
    if len({name for name, _ in labels}) == 1:  # a name that all faces share is the solid's, or a default
        labels = [("", colour) for _, colour in labels]
    for i, (face, (name, colour)) in enumerate(zip(before, labels)):
        pieces = [face] if divided is shape else explore(divide.GetContext().Apply(face), "FACE")
        for piece in pieces:
            names[key_of(piece)] = name or f"face_{i}"
            colours[key_of(piece)] = colour
    volume, area = measures(shape)
    brep = _arrays(divided, where, names, colours, label(shape)[0] if label else "", volume, area)
    check_brep(brep, where)
    return brep


def _require_plane_curves(face: Any, where: str) -> None:
    from OCP.BRep import BRep_Tool
    from OCP.TopoDS import TopoDS

    for number, edge in enumerate(explore(face, "EDGE")):
        if BRep_Tool.CurveOnSurface_s(TopoDS.Edge(edge), TopoDS.Face(face), 0.0, 1.0, None) is None:
            raise InputError(f"{where}: its edge {number} has no curve in the parameter plane; heal it in the CAD")


def _arrays(
    shape: Any, where: str, names: dict[int, str], colours: dict[int, str], name: str, volume: float, area: float
) -> Brep:
    from OCP.BRep import BRep_Tool
    from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher as ShapeMap
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS

    vertex_map, edge_map = ShapeMap(), ShapeMap()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_VERTEX, vertex_map)
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_EDGE, edge_map)
    vertices = np.array([xyz(BRep_Tool.Pnt_s(TopoDS.Vertex(vertex_map.FindKey(i + 1))))
                         for i in range(vertex_map.Extent())]).reshape(-1, 3)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0))) or 1.0
    edges = []
    for i in range(edge_map.Extent()):
        edge = TopoDS.Edge(edge_map.FindKey(i + 1).Oriented(TopAbs_Orientation.TopAbs_FORWARD))
        ends = tuple(vertex_map.FindIndex(v) - 1 for v in (TopExp.FirstVertex_s(edge), TopExp.LastVertex_s(edge)))
        if min(ends) < 0:
            raise InputError(f"{where}: edge {i} has no vertex at an end")
        edges.append(_edge(edge, ends, vertices, diagonal, f"{where}: edge {i}"))
    faces = []
    for i, found in enumerate(explore(shape, "FACE")):
        face = TopoDS.Face(found)
        key = key_of(face)
        place = names.get(key, f"face_{i}")
        faces.append(_face(face, edge_map, place, colours.get(key, ""), diagonal, f"{where}: {place}"))
    return Brep(vertices, tuple(edges), tuple(faces), name, volume, area)


def _edge(edge: Any, ends: tuple[int, ...], vertices: Array, diagonal: float, where: str) -> Edge:
    from OCP.BRep import BRep_Tool

    tolerance = float(BRep_Tool.Tolerance_s(edge))
    if BRep_Tool.Degenerated_s(edge):
        control = np.repeat(vertices[[ends[0]]], 2, axis=0)
        return Edge(Curve(np.array([0.0, 0.0, 1.0, 1.0]), control), (ends[0], ends[1]), tolerance, True)
    first, last = BRep_Tool.Range_s(edge)
    found = BRep_Tool.Curve_s(edge, 0.0, 1.0)
    if found is None:
        raise InputError(f"{where} has no curve in space")

    def points(t: Array) -> Array:
        return np.array([xyz(found.Value(s)) for s in (first + (last - first) * t).tolist()])

    curve = fit_curve(points, FIT * diagonal, DEGREE, _breaks(found, first, last), ENOUGH * diagonal)
    return Edge(curve, (ends[0], ends[1]), tolerance, False)


def _breaks(curve: Any, first: float, last: float) -> Array:
    """Knots of a spline curve between two parameters, as shares of the way."""
    while hasattr(curve, "BasisCurve"):
        curve = curve.BasisCurve()
    knots = [curve.Knot(i + 1) for i in range(curve.NbKnots())] if hasattr(curve, "NbKnots") else []
    t = (np.array(knots) - first) / (last - first)
    return np.concatenate([[0.0], t[(t > 1e-9) & (t < 1.0 - 1e-9)], [1.0]])


def _face(face: Any, edge_map: Any, name: str, colour: str, diagonal: float, where: str) -> Face:
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
    from OCP.TopAbs import TopAbs_Orientation
    from OCP.TopoDS import TopoDS

    kind = BRepAdaptor_Surface(face).GetType().name.removeprefix("GeomAbs_")
    flipped = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
    forward = TopoDS.Face(face.Oriented(TopAbs_Orientation.TopAbs_FORWARD))
    bounds = BRepTools.UVBounds_s(forward)
    original = BRep_Tool.Surface_s(forward)
    surface, carry = _surface(original, kind, bounds, where)
    scale = max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    outer = BRepTools.OuterWire_s(forward)
    loops: list[tuple[Coedge, ...]] = []
    for wire in explore(forward, "WIRE"):
        loop = []
        walk = BRepTools_WireExplorer(TopoDS.Wire(wire), forward)
        while walk.More():
            edge = walk.Current()
            number = edge_map.FindIndex(edge) - 1
            loop.append(_coedge(edge, number, forward, original, surface, carry, scale, diagonal, where))
            walk.Next()
        if len(loop) < len(explore(wire, "EDGE")):
            raise InputError(f"{where} has a loop that cannot be walked around: its edges do not join")
        loops.insert(0, tuple(loop)) if wire.IsSame(outer) else loops.append(tuple(loop))
    if not loops:
        raise InputError(f"{where} has no loop of edges")
    return Face(surface, tuple(loops), flipped, kind.lower(), name, colour)


def _coedge(
    edge: Any, number: int, face: Any, original: Any, surface: Patch, carry: Callable[[Array], Array], scale: float,
    diagonal: float, where: str,
) -> Coedge:  # fmt: skip
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_Orientation

    found = BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 1.0, None)
    if found is None:
        raise InputError(f"{where}: edge {number} has no curve in the parameter plane")
    first, last = BRep_Tool.Range_s(edge, face)

    def plane_points(t: Array) -> Array:
        values = [found.Value(s) for s in (first + (last - first) * t).tolist()]
        return np.array([(p.X(), p.Y()) for p in values])

    t = np.linspace(0.0, 1.0, 7)
    uv = plane_points(t)
    there = np.array([xyz(original.Value(u, v)) for u, v in uv.tolist()])
    off = float(np.linalg.norm(surface_points(surface, carry(uv)) - there, axis=1).max())
    if off > CARRIED * diagonal:
        raise InputError(f"{where}: its surface moves by {off:.1e} when it is turned into a B-spline surface")
    curve = fit_curve(
        lambda t: carry(plane_points(t)), FIT * scale, DEGREE, _breaks(found, first, last), ENOUGH * scale
    )
    return Coedge(number, edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED, curve)


def _surface(
    original: Any, kind: str, bounds: tuple[float, float, float, float], where: str
) -> tuple[Patch, Callable[[Array], Array]]:
    """Surface as a patch, and the map of the CAD parameters (q, 2) to the patch's."""
    from OCP.Geom import Geom_BezierSurface, Geom_BSplineSurface, Geom_RectangularTrimmedSurface
    from OCP.GeomConvert import GeomConvert

    u0, u1, v0, v1 = bounds
    if kind == "Plane":
        corners = np.array([[xyz(original.Value(u, v)) for v in (v0, v1)] for u in (u0, u1)])
        return Patch((np.repeat([u0, u1], 2), np.repeat([v0, v1], 2)), corners), lambda uv: uv
    # A range that is a period up to rounding crashes the conversion: make it the period.
    if original.IsUPeriodic() and abs(u1 - u0 - original.UPeriod()) < 1e-6:
        u1 = u0 + original.UPeriod()
    if original.IsVPeriodic() and abs(v1 - v0 - original.VPeriod()) < 1e-6:
        v1 = v0 + original.VPeriod()
    if isinstance(original, Geom_BSplineSurface) and not original.IsUPeriodic() and not original.IsVPeriodic():
        made = original
    elif isinstance(original, Geom_BezierSurface):
        made = GeomConvert.SurfaceToBSplineSurface_s(original)
    else:
        trimmed = Geom_RectangularTrimmedSurface(original, u0, u1, v0, v1)
        made = GeomConvert.SurfaceToBSplineSurface_s(trimmed)
    if made.IsUPeriodic():
        made.SetUNotPeriodic()
    if made.IsVPeriodic():
        made.SetVNotPeriodic()
    patch = _patch(made, where)
    if made is not original:
        # The trimmed surface moves a range of a periodic parameter to the first period: move it back.
        a, b = patch.knots
        a = a + (u0 - a[0] if original.IsUPeriodic() else 0.0)
        b = b + (v0 - b[0] if original.IsVPeriodic() else 0.0)
        patch = replace(patch, knots=(a, b))
    arcs = (kind in _ARC_U, kind in _ARC_V)
    basis = getattr(original, "BasisCurve", None)
    if basis is not None:
        conic = type(basis()).__name__ in ("Geom_Circle", "Geom_Ellipse") or _trimmed_conic(basis())
        arcs = (arcs[0], conic) if kind == "SurfaceOfRevolution" else (conic, arcs[1])
    breaks = [np.unique(t) for t in patch.knots]

    def carry(uv: Array) -> Array:
        columns = [_arc(uv[:, d], breaks[d]) if arcs[d] else uv[:, d] for d in range(2)]
        return np.stack(columns, axis=1)

    return patch, carry


def _trimmed_conic(curve: Any) -> bool:
    inner = getattr(curve, "BasisCurve", None)
    return inner is not None and type(inner()).__name__ in ("Geom_Circle", "Geom_Ellipse")


def _arc(theta: Array, breaks: Array) -> Array:
    """Parameter of the rational quadratic from the angle, interval by interval."""
    i = np.clip(np.searchsorted(breaks, theta, side="right") - 1, 0, len(breaks) - 2)
    middle, half = 0.5 * (breaks[i] + breaks[i + 1]), 0.5 * (breaks[i + 1] - breaks[i])
    return np.asarray(middle + half * np.tan(0.5 * (theta - middle)) / np.tan(0.5 * half))


def _patch(made: Any, where: str) -> Patch:
    knots = []
    for count, knot, many in (
        (made.NbUKnots(), made.UKnot, made.UMultiplicity), (made.NbVKnots(), made.VKnot, made.VMultiplicity)
    ):  # fmt: skip
        knots.append(np.repeat([knot(i + 1) for i in range(count)], [many(i + 1) for i in range(count)]))
    shape = (made.NbUPoles(), made.NbVPoles())
    control = np.array([[xyz(made.Pole(i + 1, j + 1)) for j in range(shape[1])] for i in range(shape[0])])
    weights = None
    if made.IsURational() or made.IsVRational():
        # One by one: the array that Weights() returns is freed twice in some versions of the bindings.
        weights = np.array([[made.Weight(i + 1, j + 1) for j in range(shape[1])] for i in range(shape[0])])
    return make_patch(knots, control, weights, where)
