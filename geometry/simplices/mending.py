"""Mend small defects of a surface triangulation with VTK: doubled points, degenerate triangles, holes, orientation.

Shapes are changed only where something was wrong: points that are equal to rounding are merged if the surface is open
or has degenerate triangles, holes are closed when their circumscribed circle is smaller than a stated part of the
diagonal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.surface import degenerate
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Radius of the largest hole that is closed, and distance of points that are merged, in diagonals.
LARGEST_HOLE = 0.25
SAME = 1e-9


def mended(points: Array, triangles: Index) -> tuple[Array, Index, dict[str, Any]]:
    """Points (v, 3), triangles (t, 3) of the mended surface and what was done.

    Raises
    ------
    InputError : nothing is left.
    """
    import pyvista

    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    mesh = pyvista.PolyData.from_regular_faces(points, triangles.astype(int))
    # Where nothing is open, equal points may be meant to be apart.
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    is_open = (np.unique(ends[:, 0] * len(points) + ends[:, 1], return_counts=True)[1] == 1).any()
    if is_open or degenerate(points, triangles).any():
        mesh = mesh.clean(tolerance=SAME * diagonal, absolute=True, lines_to_points=False, polys_to_lines=False)
    clean = _triangles_only(mesh)
    before = clean.n_faces
    if not before:
        raise InputError("nothing is left of the surface after mending")
    closed = clean.fill_holes(LARGEST_HOLE * diagonal).triangulate()
    filled = closed.n_faces - before
    whole = closed.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True, auto_orient_normals=True, split_vertices=False,
        non_manifold_traversal=False,
    )
    whole = _triangles_only(whole)
    done = {
        "merged_vertices": max(len(points) - clean.n_points, 0),
        "removed_triangles": len(triangles) - before,
        "added_triangles": int(filled),
    }
    report = {"mended": {what: count for what, count in done.items() if count}}
    return np.asarray(whole.points, dtype=float), np.asarray(whole.regular_faces, dtype=np.int64), report


def _triangles_only(mesh: Any) -> Any:
    """The mesh without triangles of which two corners are the same vertex, and without doubled triangles."""
    import pyvista

    table = np.asarray(mesh.regular_faces if mesh.is_all_triangles else mesh.triangulate().regular_faces)
    table = table.reshape(-1, 3)
    table = table[(table != np.roll(table, 1, axis=1)).all(axis=1)]
    first = np.sort(np.unique(np.sort(table, axis=1), axis=0, return_index=True)[1])
    return pyvista.PolyData.from_regular_faces(mesh.points, table[first])
