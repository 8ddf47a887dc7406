"""Mend small defects of a surface triangulation: doubled points, degenerate triangles, orientation (VTK), and holes.

Shapes are changed only where something was wrong: points that are equal to rounding are merged if the surface is open
or has degenerate triangles, holes are filled (`filling`) if no vertex around them is farther from their middle than a
stated part of the diagonal. VTK fills holes too, but leaves curled ones open or fills them across the surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.filling import filled, holes
from geometry.simplices.surface import degenerate
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Radius of the largest hole that is filled, and distance of points that are merged, in diagonals; most vertices there.
LARGEST_HOLE = 0.25
SAME = 1e-9
MOST_VERTICES = 1000


def mended(points: Array, triangles: Index) -> tuple[Array, Index, dict[str, Any]]:
    """Points (v, 3), triangles (t, 3) of the mended surface and what was done.

    Raises
    ------
    InputError : nothing is left.
    """
    import pyvista

    diagonal = float(np.linalg.norm(np.ptp(points[np.unique(triangles)], axis=0)))
    mesh = pyvista.PolyData.from_regular_faces(points, triangles.astype(int))
    # Where nothing is open, equal points may be meant to be apart.
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    is_open = (np.unique(ends[:, 0] * len(points) + ends[:, 1], return_counts=True)[1] == 1).any()
    if is_open or degenerate(points, triangles).any():
        mesh = mesh.clean(tolerance=SAME * diagonal, absolute=True, lines_to_points=False, polys_to_lines=False)
    clean = _triangles_only(mesh)
    if not clean.n_faces:
        raise InputError("nothing is left of the surface after mending")
    done = {
        "merged_vertices": max(len(np.unique(triangles)) - clean.n_points, 0),
        "removed_triangles": len(triangles) - clean.n_faces,
    }
    closed, found = _closed(_oriented(clean, outwards=False), LARGEST_HOLE * diagonal)
    whole = _triangles_only(_oriented(closed, outwards=True))
    report = {"mended": {what: count for what, count in (done | found).items() if count}}
    return np.asarray(whole.points, dtype=float), np.asarray(whole.regular_faces, dtype=np.int64), report


def _closed(mesh: Any, radius: float) -> tuple[Any, dict[str, Any]]:
    """The mesh with holes up to a radius filled, and how many, of how many edges, with what, and what stays open."""
    import pyvista

    points, triangles = np.asarray(mesh.points, dtype=float), np.asarray(mesh.regular_faces, dtype=np.int64)
    found, count, edges = holes(points, triangles), 0, 0
    parts = [triangles]
    for hole in found:
        around = points[hole.loop]
        size = np.linalg.norm(around - around.mean(axis=0), axis=1).max()
        made = None
        if size <= radius and len(around) <= MOST_VERTICES:
            made = filled(points, np.concatenate(parts), hole)
        if made is not None:
            parts.append(made)
            count, edges = count + 1, edges + len(around)
    new = points[np.concatenate([triangles[:0], *parts[1:]])]
    area = float(np.linalg.norm(np.cross(new[:, 1] - new[:, 0], new[:, 2] - new[:, 0]), axis=1).sum()) / 2.0
    return pyvista.PolyData.from_regular_faces(points, np.concatenate(parts).astype(int)), {
        "filled_holes": count, "edges_around_them": edges, "added_triangles": len(new), "added_area": area,
        "holes_left_open": len(found) - count,
    }


def _oriented(mesh: Any, outwards: bool) -> Any:
    """The mesh with triangles that face the same way as their neighbours, and outwards where it is closed."""
    return mesh.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True, auto_orient_normals=outwards,
        split_vertices=False, non_manifold_traversal=False,
    )


def _triangles_only(mesh: Any) -> Any:
    """The mesh without triangles of which two corners are the same vertex, and without doubled triangles."""
    import pyvista

    table = np.asarray(mesh.regular_faces if mesh.is_all_triangles else mesh.triangulate().regular_faces)
    table = table.reshape(-1, 3)
    table = table[(table != np.roll(table, 1, axis=1)).all(axis=1)]
    first = np.sort(np.unique(np.sort(table, axis=1), axis=0, return_index=True)[1])
    return pyvista.PolyData.from_regular_faces(mesh.points, table[first])
