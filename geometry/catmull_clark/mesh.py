"""Hexahedral meshes from files, checked.

Any format that meshio reads (``.vtk .vtu .mesh .inp .msh``) is accepted if its three-dimensional cells are linear
hexahedra; surface cells and unused vertices are dropped. Point data are kept as attributes.

Axis letters: e hexahedron, v vertex, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.catmull_clark.topology import Topology, build_topology, check_topology, orient
from geometry.guarded import guarded
from geometry.inputs import require_file
from iga.cells import HEXAHEDRON
from iga.errors import FormatError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SUFFIXES = (".vtk", ".vtu", ".mesh", ".inp", ".msh")
_SOLID = {
    "tetra": "tetrahedra", "tetra10": "quadratic tetrahedra", "wedge": "wedges", "pyramid": "pyramids",
    "hexahedron20": "quadratic hexahedra", "hexahedron27": "quadratic hexahedra", "wedge15": "quadratic wedges",
    "pyramid13": "quadratic pyramids", "polyhedron": "polyhedra",
}


@dataclass(frozen=True, eq=False)
class HexMesh:
    """A checked hexahedral mesh.

    Attributes
    ----------
    points : (v, 3).
    topology : connectivity; every boundary entity is smooth until features are set.
    attributes : values (v,) or (v, c) at the vertices.
    mirrored : how many cells of the input were numbered left-handed and turned.
    """

    points: Array
    topology: Topology
    attributes: Mapping[str, Array] = field(default_factory=dict)
    mirrored: int = 0


def hex_mesh(points: Array, hexes: Index, attributes: Mapping[str, Array] | None = None) -> HexMesh:
    """Check arrays and make a mesh of them.

    Parameters
    ----------
    points : (v, 3) coordinates.
    hexes : (e, 8) vertex numbers in the order of `iga.cells.HEXAHEDRON`, right- or left-handed.
    attributes : values at the vertices.

    Raises
    ------
    InputError : no cells, numbers out of range, a repeated vertex, a non-finite coordinate, two equal cells, a
        non-manifold or inconsistent mesh, a hanging node, an attribute of the wrong length.
    """
    points = np.ascontiguousarray(points, dtype=float)
    hexes = np.ascontiguousarray(hexes, dtype=np.int64)
    attributes = dict(attributes or {})
    if points.ndim != 2 or points.shape[1] != 3 or hexes.ndim != 2 or hexes.shape[1] != 8:
        raise InputError(f"a hex mesh needs points (v, 3) and cells (e, 8), not {points.shape} and {hexes.shape}")
    if not len(hexes):
        raise InputError("the mesh holds no hexahedra")
    bad = np.flatnonzero((hexes < 0).any(axis=1) | (hexes >= len(points)).any(axis=1))
    if len(bad):
        raise InputError(f"element {bad[0]} names a vertex outside 0..{len(points) - 1}")
    ordered = np.sort(hexes, axis=1)
    bad = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if len(bad):
        raise InputError(f"element {bad[0]} repeats a vertex ({', '.join(map(str, hexes[bad[0]].tolist()))})")
    for name, values in attributes.items():
        values = np.asarray(values, dtype=float)
        if len(values) != len(points):
            raise InputError(f"attribute {name!r} has {len(values)} values for {len(points)} vertices")
        if not np.isfinite(values).all():
            where = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))[0]
            raise InputError(f"attribute {name!r} is not finite at vertex {where}")
        attributes[name] = values
    _check_equal(ordered)
    used = np.unique(hexes)
    bad = used[~np.isfinite(points[used]).all(axis=1)]
    if len(bad):
        raise InputError(f"vertex {bad[0]} is not finite")
    # All checks come before vertices are numbered anew, so that messages name them as the file does.
    build_topology(hexes, len(points))  # raises before orientation is tried
    hexes, mirrored = orient(hexes, len(points), points)
    topology = build_topology(hexes, len(points))
    _check_hanging(points, topology)
    check_topology(topology)
    if len(used) < len(points):
        number = np.full(len(points), -1, dtype=np.int64)
        number[used] = np.arange(len(used))
        points = points[used]
        topology = build_topology(number[hexes], len(points))
        attributes = {name: values[used] for name, values in attributes.items()}
    return HexMesh(points, topology, attributes, mirrored)


def _check_equal(ordered: Index) -> None:
    """Two cells on the same eight vertices."""
    order = np.lexsort(ordered.T[::-1])
    same = np.flatnonzero((ordered[order][1:] == ordered[order][:-1]).all(axis=1))
    if len(same):
        a, b = sorted(order[[same[0], same[0] + 1]].tolist())
        raise InputError(f"elements {a} and {b} have the same vertices")


def _check_hanging(points: Array, topology: Topology) -> None:
    """A boundary vertex in the middle of a boundary edge or face of other cells is a hanging node."""
    outer = topology.boundary_faces
    edges = np.unique(topology.face_edges[outer])
    vertices = np.unique(topology.faces[outer])
    ends, quads = points[topology.edges[edges]], points[topology.faces[outer]]
    middles = np.concatenate([ends.mean(axis=1), quads.mean(axis=1)])
    length = np.concatenate(
        [np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), np.linalg.norm(quads[:, 3] - quads[:, 0], axis=1)]
    )
    distance, nearest = cKDTree(points[vertices]).query(middles)
    bad = np.flatnonzero((distance <= 1e-9 * length) & (length > 0))
    if len(bad):
        k, vertex = int(bad[0]), vertices[nearest[bad[0]]]
        if k < len(edges):
            a, b = topology.edges[edges[k]]
            where = f"the edge between vertices {a} and {b}"
        else:
            where = f"the face with vertices {', '.join(map(str, np.sort(topology.faces[outer[k - len(edges)]])))}"
        raise InputError(f"vertex {vertex} hangs in the middle of {where}; the mesh must be conforming")


def read_hexes(path: str | Path) -> HexMesh:
    """Read a hexahedral mesh from a file.

    Raises
    ------
    FormatError : the file is missing, cannot be read, or holds cells other than linear hexahedra.
    InputError : its mesh is not a conforming manifold (see `hex_mesh`); the message starts with the file's name.
    """
    path = Path(path)
    mesh = _read(path)
    solid: dict[str, int] = {}
    hexes = [np.zeros((0, 8), dtype=np.int64)]
    for block in mesh.cells:
        if block.type == "hexahedron":
            hexes.append(np.asarray(block.data, dtype=np.int64).reshape(-1, 8))
        elif block.type in _SOLID or block.type.startswith(("polyhedron", "VTK_LAGRANGE_HEX", "tetra", "wedge")):
            kind = _SOLID.get(block.type, block.type)
            solid[kind] = solid.get(kind, 0) + len(block.data)
    if solid:
        what = ", ".join(f"{n} {kind}" for kind, n in solid.items())
        raise FormatError(f"{path.name} holds {what}; this source needs a mesh of linear hexahedra only")
    cells = np.concatenate(hexes)
    if not len(cells):
        there = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        raise FormatError(f"{path.name} holds no hexahedra ({there})")
    order = np.empty(8, dtype=np.int64)
    order[list(HEXAHEDRON.vtk)] = np.arange(8)
    points = np.asarray(mesh.points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise FormatError(f"{path.name} has vertices with {points.shape[-1]} coordinates, not 3")
    data = {
        name: np.asarray(values, dtype=float)
        for name, values in mesh.point_data.items()
        if np.asarray(values).dtype.kind in "fiu" and np.asarray(values).ndim in (1, 2)
    }
    try:
        return hex_mesh(points, cells[:, order], data)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _read(path: Path) -> Any:
    import meshio

    require_file(path)
    try:
        with guarded(path) as said:
            return meshio.read(path)
    except (SystemExit, Exception) as error:  # meshio exits on unknown files and raises anything on damaged ones
        reason = str(error) if not isinstance(error, SystemExit) else said.getvalue()
        line = " ".join(reason.split())[:160] or type(error).__name__
        raise FormatError(f"{path.name} cannot be read as a mesh ({line})") from None
