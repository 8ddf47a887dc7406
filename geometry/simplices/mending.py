"""Mend small defects of a surface triangulation: doubled points, degenerate triangles, orientation (VTK), holes, and
triangles that cross each other.

Shapes are changed only where something was wrong: points that are equal to rounding are merged if the surface is open
or has degenerate triangles, holes are filled (`filling`) if no vertex around them is farther from their middle than a
stated part of the diagonal. VTK fills holes too, but leaves curled ones open or fills them across the surface.

Triangles that cross are taken away, with those that share a vertex with them, as long as they are a small part of the
surface, and the holes are filled.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.crossing import crossing_pairs
from geometry.simplices.filling import filled, holes
from geometry.simplices.surface import Surface, degenerate, doubled_normals, shells_of
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LARGEST_HOLE = 0.25
"""Radius of the largest hole that is filled, in diagonals of the surface."""
SAME = 1e-9
"""Points closer than this part of the diagonal are one."""
MOST_VERTICES = 1000
"""Vertices around a hole up to which it is filled."""
MOST_CROSSING = 0.05
"""Part of the surface's area that may be filled anew because it crossed itself."""
ROUNDS = 4
"""How often crossing triangles are taken away: the filling may cross something too."""


@dataclass(frozen=True)
class Filling:
    """Holes that were filled, edges around them, triangles added and their area, and holes that were left open."""

    filled_holes: int
    edges_around_them: int
    added_triangles: int
    added_area: float
    holes_left_open: int


@dataclass(frozen=True)
class Mending:
    """What was done to a surface.

    Attributes
    ----------
    merged_vertices, removed_triangles : doubled or unused vertices, and triangles without area or doubled.
    filling : of the holes that it had.
    removed_crossing_triangles : with those around them; the holes that they left are filled.
    """

    merged_vertices: int
    removed_triangles: int
    filling: Filling
    removed_crossing_triangles: int = 0

    def report(self) -> dict[str, float]:
        """The numbers by name, but for those that are zero."""
        every = asdict(self)
        return {name: number for name, number in (every.pop("filling") | every).items() if number}


def mended(points: Array, triangles: Index) -> tuple[Array, Index, Mending]:
    """Points (v, 3) and triangles (t, 3) of the mended surface, and what was done.

    Parameters
    ----------
    points, triangles : (v, 3) numbers, and (t, 3) vertices in range.

    Raises
    ------
    InputError : nothing is left.
    """
    import pyvista

    diagonal = float(np.linalg.norm(np.ptp(points[np.unique(triangles)], axis=0)))
    mesh = pyvista.PolyData.from_regular_faces(points, triangles.astype(int))
    # Where nothing is open, equal points may be meant to be apart.
    is_open = (np.bincount(Surface(points, triangles).edge_of.ravel()) == 1).any()
    if is_open or degenerate(points, triangles).any():
        mesh = mesh.clean(tolerance=SAME * diagonal, absolute=True, lines_to_points=False, polys_to_lines=False)
    clean = _triangles_only(mesh)
    if not clean.n_faces:
        raise InputError("nothing is left of the surface after mending")
    alike = _oriented(clean, outwards=False)
    places = np.asarray(alike.points, dtype=float)
    closed, filling = _filled(places, np.asarray(alike.regular_faces, dtype=np.int64), LARGEST_HOLE * diagonal)
    whole = _oriented(pyvista.PolyData.from_regular_faces(places, closed.astype(int)), outwards=True)
    whole = _triangles_only(whole)
    table = np.asarray(whole.regular_faces, dtype=np.int64)
    crossing = 0
    if not filling.holes_left_open:
        table, crossing = _uncrossed(np.asarray(whole.points, dtype=float), table)
    merged = max(len(np.unique(triangles)) - clean.n_points, 0)
    done = Mending(merged, len(triangles) - clean.n_faces, filling, crossing)
    return np.asarray(whole.points, dtype=float), table, done


def _uncrossed(points: Array, triangles: Index) -> tuple[Index, int]:
    """Triangles without those that cross, holes filled, and how many; as they are where that does not succeed."""
    table, removed = triangles, 0
    for _ in range(ROUNDS):
        pairs = crossing_pairs(points, table)
        if not len(pairs):
            return table, removed
        near = np.zeros(len(points), dtype=bool)
        near[table[pairs.ravel()]] = True
        kept = table[~near[table].any(axis=1)]
        if not len(kept):
            break
        # Crumbs that are cut off go too.
        shell = shells_of(Surface(points, kept))
        main = shell == np.bincount(shell).argmax()
        if _area(points, kept[~main]) > MOST_CROSSING * _area(points, kept):
            break
        kept = kept[main]
        removed += len(table) - len(kept)
        table, filling = _filled(points, kept, np.inf)
        if filling.holes_left_open or filling.added_area > MOST_CROSSING * _area(points, table):
            break
    return triangles, 0


def _filled(points: Array, triangles: Index, radius: float) -> tuple[Index, Filling]:
    """Triangles with holes up to a radius filled, and what was done."""
    found, count, edges = holes(points, triangles), 0, 0
    rim = np.zeros(len(points), dtype=bool)
    for hole in found:
        rim[hole.loop] = True
    # Only triangles with an edge between two vertices of holes can be in the way of their filling.
    near = triangles[rim[triangles].sum(axis=1) > 1]
    new = triangles[:0]
    for hole in found:
        around = points[hole.loop]
        made = None
        if np.linalg.norm(around - around.mean(axis=0), axis=1).max() <= radius and len(around) <= MOST_VERTICES:
            made = filled(points, np.concatenate([near, new]), hole)
        if made is not None:
            new = np.concatenate([new, made])
            count, edges = count + 1, edges + len(around)
    return np.concatenate([triangles, new]), Filling(count, edges, len(new), _area(points, new), len(found) - count)


def _area(points: Array, triangles: Index) -> float:
    """Area of all triangles together."""
    return float(np.linalg.norm(doubled_normals(points[triangles]), axis=1).sum()) / 2.0


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
