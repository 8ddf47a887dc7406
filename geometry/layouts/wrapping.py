"""The boundary of a meccano drawn tight around a solid: where corners and edges should lie on its surface, roughly.

Every side is cut in STEPS x STEPS; the points move to the mean of their neighbours and then part of the way to the
nearest point of the surface that faces the same way, first a small part, at last all of it.

Axis letters: v point, t triangle, f side, p edge, q point of an edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from geometry.layouts.frame import Frame
from geometry.layouts.routing import Guides
from geometry.simplices.surface import Surface, area_vectors, doubled_normals
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = 8
"""Parts into which the sides are cut along each direction."""
ROUNDS = 80
"""Rounds of smoothing; from four fifths of them on, points lie on the surface."""
FACING = 0.5
"""Distance, in voxels, that a turn of the normal by one radian is worth."""


def wrap(surface: Surface, frame: Frame, places: Array, size: float) -> Guides:
    """Guides for the edges of a frame whose corners start at places (v, 3), with voxels of the given size."""
    points, sides = _fine(frame, places)
    triangles = np.concatenate((sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]))
    ends = np.unique(np.sort(np.stack((sides, np.roll(sides, -1, axis=1)), axis=2).reshape(-1, 2), axis=1), axis=0)
    beside = _neighbours(ends, len(points))
    valence = beside.sum(axis=1)[:, None]

    targets = surface.points[surface.triangles].mean(axis=1)
    normals = _unit(area_vectors(surface))
    tree = cKDTree(np.concatenate((targets, FACING * size * normals), axis=1))
    for step in range(ROUNDS):
        points = 0.5 * points + 0.5 * (beside @ points) / valence
        share = min(1.0, 0.05 + step / (0.8 * ROUNDS))
        here = _point_normals(points, triangles)
        nearest = tree.query(np.concatenate((points, FACING * size * here), axis=1))[1]
        # Only across the surface: a step along it is left to the smoothing.
        gap = targets[nearest] - points
        across = (gap * normals[nearest]).sum(axis=1, keepdims=True) * normals[nearest]
        far = (np.linalg.norm(gap, axis=1) > 0.5 * size)[:, None]
        points = points + share * np.where(far, gap, across)
    here = _point_normals(points, triangles)
    nearest = tree.query(np.concatenate((points, FACING * size * here), axis=1))[1]
    along = _along_edges(frame)
    return Guides(targets[nearest][along], normals[nearest][along])


def corner_vertices(surface: Surface, frame: Frame, guides: Guides) -> Index:
    """Distinct vertices (v,) of the surface near the ends of the guides, no two of them joined by an edge.

    Raises
    ------
    InputError : the surface has too few vertices.
    """
    wanted = np.empty((len(frame.places), 3))
    wanted[frame.ends[:, 0]] = guides.points[:, 0]
    wanted[frame.ends[:, 1]] = guides.points[:, -1]
    tree = cKDTree(surface.points)
    neighbours = _neighbours(surface.edges, len(surface.points))
    free = np.ones(len(surface.points), dtype=bool)
    result = np.empty(len(wanted), dtype=np.int64)
    for v in range(len(wanted)):
        for count in (8, 64, 512, len(surface.points)):
            found = np.atleast_1d(tree.query(wanted[v], min(count, len(surface.points)))[1])
            found = found[free[found]]
            if len(found):
                break
        else:
            raise InputError(f"the surface has too few vertices for the {len(wanted)} corners of the meccano")
        result[v] = found[0]
        near = neighbours.indices[neighbours.indptr[found[0]] : neighbours.indptr[found[0] + 1]]
        free[near] = False
        free[found[0]] = False
    return result


def _neighbours(edges: Index, size: int) -> csr_array:
    """Ones (size, size) where edges (k, 2) join two vertices."""
    a, b = edges.T
    return csr_array(coo_array((np.ones(2 * len(a)), (np.append(a, b), np.append(b, a))), shape=(size, size)))


def _fine(frame: Frame, places: Array) -> tuple[Array, Index]:
    """Points and sides of the frame cut in STEPS x STEPS: corners, then points inside edges, then inside sides."""
    n, m = STEPS, STEPS - 1
    corners, edges, sides = len(places), len(frame.ends), len(frame.sides)
    weights = np.arange(1, n)[:, None] / n
    ends = places[frame.ends]
    on_edges = ends[:, :1] * (1 - weights) + ends[:, 1:] * weights
    s, t = (grid.ravel() / n for grid in np.meshgrid(np.arange(1, n), np.arange(1, n), indexing="ij"))
    blend = np.stack(((1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t), axis=1)
    within = np.einsum("qc,fcd->fqd", blend, places[frame.sides])

    number = np.empty((sides, n + 1, n + 1), dtype=np.int64)
    number[:, 1:n, 1:n] = corners + edges * m + np.arange(sides * m * m).reshape(sides, m, m)
    number[:, [0, n, n, 0], [0, 0, n, n]] = frame.sides
    inner = corners + m * frame.side_edges[:, :, None] + np.arange(m)
    inner = np.where(frame.side_forward[:, :, None], inner, inner[:, :, ::-1])
    number[:, 1:n, 0], number[:, n, 1:n] = inner[:, 0], inner[:, 1]
    number[:, 1:n, n], number[:, 0, 1:n] = inner[:, 2, ::-1], inner[:, 3, ::-1]
    fine = np.stack((number[:, :-1, :-1], number[:, 1:, :-1], number[:, 1:, 1:], number[:, :-1, 1:]), axis=-1)
    return np.concatenate((places, on_edges.reshape(-1, 3), within.reshape(-1, 3))), fine.reshape(-1, 4)


def _along_edges(frame: Frame) -> Index:
    """(p, STEPS + 1) the fine points along each edge."""
    first = len(frame.places) + (STEPS - 1) * np.arange(len(frame.ends))
    inner = first[:, None] + np.arange(STEPS - 1)
    return np.concatenate((frame.ends[:, :1], inner, frame.ends[:, 1:]), axis=1)


def _unit(vectors: Array) -> Array:
    """Vectors (v, 3) of length one; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None])


def _point_normals(points: Array, triangles: Index) -> Array:
    """Unit normals (v, 3) at the points, means over the triangles around them by area."""
    areas = doubled_normals(points[triangles])
    total: Array = np.zeros_like(points)
    for d in range(3):
        total[:, d] = np.bincount(triangles.ravel(), np.repeat(areas[:, d], 3), len(points))
    return _unit(total)
