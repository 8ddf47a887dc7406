"""Mesh generators as a process: ``python -m geometry.hybrid.fillers NAME IN OUT`` (see `geometry.hybrid.filling`).

A process of its own because meshing cannot be interrupted and may not come to an end. IN holds ``points`` (n, 3) and
``triangles`` (t, 3) turned outwards, OUT gets ``points`` and ``tets``. Only Netgen comes with this package; its licence
(LGPL) allows that. Gmsh (GPL) and TetGen (AGPL) are used where a user has installed them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def netgen(points: Array, triangles: Index, grading: float) -> tuple[Array, Index]:
    """Fill by Netgen's advancing front and Delaunay method."""
    from netgen import meshing

    mesh = meshing.Mesh(dim=3)
    face = mesh.Add(meshing.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    numbers = [mesh.Add(meshing.MeshPoint(meshing.Pnt(*point))) for point in points.tolist()]
    for triangle in triangles.tolist():
        mesh.Add(meshing.Element2D(face, [numbers[v] for v in triangle]))
    mesh.GenerateVolumeMesh(grading=grading)
    made = np.array([point.p for point in mesh.Points()])
    return made, np.array([[v.nr - 1 for v in element.vertices] for element in mesh.Elements3D()], dtype=np.int64)


def gmsh(points: Array, triangles: Index, grading: float) -> tuple[Array, Index]:
    """Fill by Gmsh's Delaunay method."""
    import gmsh as library

    library.initialize()
    library.option.setNumber("General.Terminal", 0)
    surface = library.model.addDiscreteEntity(2)
    numbers = np.arange(1, len(points) + 1)
    library.model.mesh.addNodes(2, surface, numbers, points.ravel())
    library.model.mesh.addElementsByType(surface, 2, [], (triangles + 1).ravel())
    library.model.geo.addVolume([library.model.geo.addSurfaceLoop([surface])])
    library.model.geo.synchronize()
    library.model.mesh.generate(3)
    tags, coordinates, _ = library.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    place[tags.astype(np.int64)] = np.arange(len(tags))
    _, corners = library.model.mesh.getElementsByType(4)
    order = np.concatenate([place[numbers], np.setdiff1d(np.arange(len(tags)), place[numbers])])
    back = np.empty(len(tags), dtype=np.int64)
    back[order] = np.arange(len(tags))
    return coordinates.reshape(-1, 3)[order], back[place[corners.astype(np.int64)]].reshape(-1, 4)


def tetgen(points: Array, triangles: Index, grading: float) -> tuple[Array, Index]:
    """Fill by TetGen's constrained Delaunay method, with quality, without new points on the surface."""
    import tetgen as library

    made = library.TetGen(points, triangles.astype(np.int32))
    answer = made.tetrahedralize(plc=True, quality=True, nobisect=True, minratio=1.6)
    return np.asarray(answer[0]), np.asarray(answer[1], dtype=np.int64)


FILLERS: dict[str, Callable[[Array, Index, float], tuple[Array, Index]]] = {
    "netgen": netgen, "gmsh": gmsh, "tetgen": tetgen,
}


def main(name: str, source: str, target: str) -> None:
    """Fill the surface in one file and write the mesh to another."""
    with np.load(source) as data:
        made, tets = FILLERS[name](data["points"], data["triangles"], float(data["grading"]))
    np.savez(target, points=made, tets=tets.reshape(-1, 4))


if __name__ == "__main__":
    main(*sys.argv[1:4])
