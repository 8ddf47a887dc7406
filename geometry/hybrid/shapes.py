r"""Solids made in code by Boolean operations, after the models of Song and Cohen 2019.

    ball                 the unit ball, one face with two poles and a seam
    curved_box           six bicubic faces of a bent box
    curved_difference    one bent box minus another (Figure 4.2a)
    tetrapod             union of four capsules (Figure 4.2c)
    bracket              a mechanical part of many Booleans (Figure 3.1)
    lettered_face        a bicubic surface of 4 x 4 knot intervals with an L-shaped hole (Figure 6.2)
    lettered_plate       a plate between two such surfaces

The papers do not give the models' numbers; these are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, Curve, Face
from geometry.cad.reading import brep_of
from geometry.patch import Patch
from iga.errors import InputError

Array = NDArray[np.float64]


def _bent_box(low: Array, size: Array, bend: float) -> Any:
    """Open CASCADE solid of six bicubic faces: faces of one trivariate cubic map, so that they share their edges."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
    from OCP.BRepLib import BRepLib
    from OCP.collections import Array2_gp_Pnt
    from OCP.Geom import Geom_BezierSurface
    from OCP.gp import gp_Pnt
    from OCP.TopoDS import TopoDS

    g = np.linspace(0.0, 1.0, 4)
    x, y, z = np.meshgrid(g, g, g, indexing="ij")
    bulge = np.stack([
        np.sin(np.pi * y) * (0.6 * np.cos(np.pi * z) - 0.5), np.sin(np.pi * z) * (0.5 + 0.4 * x) - 0.3 * x * z,
        np.sin(np.pi * x) * (0.8 - 0.5 * y) + 0.3 * x * y,
    ], axis=-1)  # fmt: skip
    lattice = low + size * (np.stack([x, y, z], axis=-1) + bend * bulge)
    sewing = BRepBuilderAPI_Sewing(1e-7)
    for axis in range(3):
        for side in (0, -1):
            grid = np.take(lattice, side, axis=axis)
            poles = Array2_gp_Pnt(1, 4, 1, 4)
            for i in range(4):
                for j in range(4):
                    poles.SetValue(i + 1, j + 1, gp_Pnt(*grid[i, j].tolist()))
            sewing.Add(BRepBuilderAPI_MakeFace(Geom_BezierSurface(poles), 1e-7).Face())
    sewing.Perform()
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(sewing.SewedShape())).Solid()
    BRepLib.OrientClosedSolid_s(solid)
    return solid


def ball() -> Brep:
    """Unit ball about the origin."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere

    return brep_of(BRepPrimAPI_MakeSphere(1.0).Shape(), "ball")


def curved_box(bend: float = 0.15) -> Brep:
    """Unit box with six bent bicubic faces; ``bend`` is the relative height of the bulges."""
    return brep_of(_bent_box(np.zeros(3), np.ones(3), bend), "curved_box")


def curved_difference(bend: float = 0.15) -> Brep:
    """Bent box minus a smaller one that takes away a corner and part of two sides."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut

    block = _bent_box(np.zeros(3), np.array([2.0, 1.6, 1.2]), bend)
    tool = _bent_box(np.array([0.9, 0.5, 0.45]), np.array([1.8, 1.6, 1.4]), 0.6 * bend)
    return united(BRepAlgoAPI_Cut(block, tool).Shape(), "curved_difference")


def tetrapod(length: float = 2.0, radius: float = 0.5) -> Brep:
    """Union of four capsules from the origin towards the corners of a tetrahedron."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Fuse
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    if not 0.0 < radius < length:
        raise InputError(f"tetrapod: the radius {radius} must lie between 0 and the length {length}")
    made = None
    for way in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        tip = length * np.array(way) / np.sqrt(3.0)
        # Caps are turned so that no pole or seam of one capsule meets another.
        turned = gp_Ax2(gp_Pnt(*tip.tolist()), gp_Dir(*map(float, way)))
        root = gp_Ax2(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(*map(float, way)))
        capsule = BRepAlgoAPI_Fuse(
            BRepPrimAPI_MakeCylinder(root, radius, length).Shape(), BRepPrimAPI_MakeSphere(turned, radius).Shape()
        ).Shape()
        made = capsule if made is None else BRepAlgoAPI_Fuse(made, capsule).Shape()
    return united(made, "tetrapod")


def bracket() -> Brep:
    """Mechanical part: a base plate with a rounded end, an upright with a bore, a rib, holes and a slot."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    def box(*bounds: float) -> Any:
        return BRepPrimAPI_MakeBox(gp_Pnt(*bounds[:3]), gp_Pnt(*bounds[3:])).Shape()

    def rod(base: tuple[float, float, float], way: tuple[float, float, float], radius: float, length: float) -> Any:
        return BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*base), gp_Dir(*way)), radius, length).Shape()

    up, along = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    made = box(0, 0, 0, 80, 40, 10)
    for part in (rod((80, 20, 0), up, 20, 10), box(0, 0, 10, 12, 40, 40), rod((0, 20, 40), along, 20, 12),
                 rod((0, 20, 40), along, 12, 18)):
        made = BRepAlgoAPI_Fuse(made, part).Shape()
    for part in (rod((80, 20, -1), up, 9, 12), rod((-1, 20, 40), along, 7, 30), rod((30, 10, -1), up, 4, 12),
                 rod((30, 30, -1), up, 4, 12), box(42, 17, -1, 58, 23, 11), rod((42, 20, -1), up, 3, 12),
                 rod((58, 20, -1), up, 3, 12)):
        made = BRepAlgoAPI_Cut(made, part).Shape()
    return united(made, "bracket")


def united(shape: Any, where: str) -> Brep:
    """Solid of an Open CASCADE shape, faces on one surface and edges on one curve joined."""
    from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain

    unify = ShapeUpgrade_UnifySameDomain(shape, True, True, False)
    unify.Build()
    return brep_of(unify.Shape(), where)


def lettered_plate(intervals: int = 4, thickness: float = 0.3) -> Brep:
    """`lettered_face` moved down by a thickness: a plate with an L-shaped hole, bicubic above and below."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
    from OCP.BRepLib import BRepLib
    from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
    from OCP.collections import Array1_double, Array1_gp_Pnt2d, Array1_int, Array2_gp_Pnt
    from OCP.Geom import Geom_BSplineSurface
    from OCP.Geom2d import Geom2d_BezierCurve
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec

    face = lettered_face(intervals)
    control = face.surface.control
    poles = Array2_gp_Pnt(1, control.shape[0], 1, control.shape[1])
    for i, row in enumerate(control.tolist()):
        for j, pole in enumerate(row):
            poles.SetValue(i + 1, j + 1, gp_Pnt(*pole))
    values, times = np.unique(face.surface.knots[0], return_counts=True)
    knots, repeats = Array1_double(1, len(values)), Array1_int(1, len(values))
    for k, (value, many) in enumerate(zip(values.tolist(), times.tolist())):
        knots.SetValue(k + 1, value)
        repeats.SetValue(k + 1, many)
    surface = Geom_BSplineSurface(poles, knots, knots, repeats, repeats, 3, 3)
    wires = []
    for loop in face.loops:
        wire = BRepBuilderAPI_MakeWire()
        for c in loop:
            points = Array1_gp_Pnt2d(1, 4)
            for k, point in enumerate(c.curve.control.tolist()):
                points.SetValue(k + 1, gp_Pnt2d(*point))
            wire.Add(BRepBuilderAPI_MakeEdge(Geom2d_BezierCurve(points), surface).Edge())
        wires.append(wire.Wire())
    made = BRepBuilderAPI_MakeFace(surface, wires[0], True)
    for wire in wires[1:]:
        made.Add(wire)
    top = made.Face()
    BRepLib.BuildCurves3d_s(top)
    return brep_of(BRepPrimAPI_MakePrism(top, gp_Vec(0.0, 0.0, -thickness)).Shape(), "lettered_plate")


SHAPES: dict[str, Callable[..., Brep]] = {
    "ball": ball, "curved_box": curved_box, "curved_difference": curved_difference, "tetrapod": tetrapod,
    "bracket": bracket, "lettered_plate": lettered_plate,
}
"""Solids by name."""


def lettered_face(intervals: int = 4) -> Face:
    """Bicubic surface over [0, 1]^2 with ``intervals`` knot intervals each way and an L-shaped hole.

    The hole's sides are slightly curved, so that trimming needs curvilinear triangles; nothing of it follows a knot
    line. Coedges carry no edges (number -1): it is a face on its own.
    """
    inner = np.linspace(0.0, 1.0, intervals + 1)[1:-1]
    knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
    where = np.array([knots[i + 1 : i + 4].mean() for i in range(intervals + 3)])
    x, y = np.meshgrid(where, where, indexing="ij")
    control = np.stack([x, y, 0.25 * np.sin(2.2 * x + 0.4) * np.cos(2.6 * y) + 0.1 * x * y], axis=-1)
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    letter = [(0.29, 0.27), (0.31, 0.74), (0.46, 0.72), (0.44, 0.45), (0.72, 0.40), (0.70, 0.29)]
    loops = []
    for corners, bow in ((square, 0.0), (letter, 0.03)):
        loop = []
        for a, b in zip(np.array(corners), np.array(corners[1:] + corners[:1])):
            side = b - a
            normal = np.array([-side[1], side[0]])
            middle = [a + s * side + bow * normal for s in (1 / 3, 2 / 3)]
            loop.append(Coedge(-1, False, Curve(np.repeat([0.0, 1.0], 4), np.array([a, *middle, b]))))
        loops.append(tuple(loop))
    return Face(Patch((knots, knots), control), tuple(loops), False, "bsplinesurface", "lettered")
