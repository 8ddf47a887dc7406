r"""Refining the tetrahedra at the boundary until the image of their facets is near the surface.

For a boundary facet T = a b c and the map P of the meccano's boundary onto the surface, either the paper's measure,

    d(T) = max_k vol(P(a), P(b), P(c), P(p_k)),    p_k the points of a quadrature rule of degree 5 on T,

a volume (an area, in the plane), or the length max_k dist(P(p_k), triangle P(a) P(b) P(c)). Every simplex with a facet
above the tolerance is bisected until there is none.

Axis letters: t boundary facet, n node, d dimension, q point.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.meccano.bisection import BisectedMesh, refine
from iga.cells import LINE, TRIANGLE
from iga.quadrature import gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Onto = Callable[[Index, Array], Array]
Measure = Literal["volume", "distance"]


def boundary_nodes(mesh: BisectedMesh, onto: Onto) -> tuple[Index, Array]:
    """Numbers (k,) and images (k, d) of the nodes on the boundary."""
    facets = mesh.facets
    nodes, first = np.unique(facets.nodes, return_index=True)
    d = mesh.blocks.dim
    return nodes, onto(facets.side[first // d], facets.s.reshape(-1, d - 1)[first])


def facet_distances(mesh: BisectedMesh, onto: Onto, nodes: Array, rows: Index, measure: Measure = "volume") -> Array:
    """d(T) of the facets ``rows`` (t,) of ``mesh.facets``.

    Parameters
    ----------
    onto : (side (q,), s (q, d - 1)) -> points (q, d) of the surface.
    nodes : (n, d) positions, of which those on the boundary count.
    """
    d, facets = mesh.blocks.dim, mesh.facets
    if not len(rows):
        return np.zeros(0)
    points = gauss(TRIANGLE if d == 3 else LINE, 3).points
    weights = np.column_stack([1.0 - points.sum(axis=1), points])
    s = np.einsum("qv,tvs->tqs", weights, facets.s[rows])
    x = onto(np.repeat(facets.side[rows], len(points)), s.reshape(-1, d - 1)).reshape(len(rows), len(points), d)
    corners = nodes[facets.nodes[rows]]
    if measure == "distance":
        return np.asarray(_distances(np.ascontiguousarray(corners), x))
    if d == 2:
        along = corners[:, 1] - corners[:, 0]
        away = x - corners[:, :1]
        return np.asarray(np.abs(along[:, :1] * away[..., 1] - along[:, 1:] * away[..., 0]).max(axis=1) / 2.0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.abs(np.einsum("td,tqd->tq", normal, x - corners[:, :1])).max(axis=1) / 6.0)


def adapt(
    mesh: BisectedMesh, onto: Onto, tolerance: float, measure: Measure = "volume", most: int = 1_000_000
) -> tuple[BisectedMesh, float]:
    """Refine until d(T) <= tolerance for all boundary facets.

    Returns
    -------
    The mesh, and the largest d(T).

    Raises
    ------
    InputError : it would need more than ``most`` simplices.
    """
    number, image = boundary_nodes(mesh, onto)
    nodes = np.zeros((len(mesh.ends), mesh.blocks.dim))
    nodes[number] = image
    found = np.zeros(len(mesh.tets))  # largest d(T) of each simplex
    fresh = np.ones(len(mesh.tets), dtype=bool)
    while True:
        facets = mesh.facets
        rows = np.flatnonzero(fresh[facets.tet])
        found[fresh] = 0.0
        np.maximum.at(found, facets.tet[rows], facet_distances(mesh, onto, nodes, rows, measure))
        if not (found > tolerance).any():
            return mesh, float(found.max())
        old = len(nodes)
        mesh, fresh = refine(mesh, found > tolerance, most)
        number, image = _new_boundary_nodes(mesh, onto, old)
        nodes = np.concatenate([nodes, np.zeros((len(mesh.ends) - old, nodes.shape[1]))])
        nodes[number] = image
        found = np.concatenate([found, np.zeros(len(mesh.tets) - len(found))])


def _new_boundary_nodes(mesh: BisectedMesh, onto: Onto, old: int) -> tuple[Index, Array]:
    """`boundary_nodes` of those with numbers from ``old``."""
    facets, d = mesh.facets, mesh.blocks.dim
    entries = np.flatnonzero(facets.nodes.ravel() >= old)
    nodes, first = np.unique(facets.nodes.ravel()[entries], return_index=True)
    entries = entries[first]
    if not len(entries):
        return nodes, np.zeros((0, d))
    return nodes, onto(facets.side[entries // d], facets.s.reshape(-1, d - 1)[entries])


@njit(cache=True)
def _distances(corners, x):  # type: ignore[no-untyped-def]
    """Largest distance of points x (t, q, d) to triangles (segments) with corners (t, d, d), (t,)."""
    result = np.zeros(len(corners))
    d = corners.shape[2]
    for t in range(len(corners)):
        for q in range(x.shape[1]):
            a, b = corners[t, 0], corners[t, 1]
            square = _to_segment(x[t, q], a, b)
            if d == 3:
                c = corners[t, 2]
                square = min(square, min(_to_segment(x[t, q], b, c), _to_segment(x[t, q], c, a)))
                u, v, w = b - a, c - a, x[t, q] - a
                uu, uv, vv = (u * u).sum(), (u * v).sum(), (v * v).sum()
                det = uu * vv - uv * uv
                if det > 1e-14 * uu * vv:
                    uw, vw = (u * w).sum(), (v * w).sum()
                    l, m = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
                    if l >= 0.0 and m >= 0.0 and l + m <= 1.0:
                        r = w - l * u - m * v
                        square = min(square, (r * r).sum())
            result[t] = max(result[t], np.sqrt(square))
    return result


@njit(cache=True)
def _to_segment(x, a, b):  # type: ignore[no-untyped-def]
    along, away = b - a, x - a
    length = (along * along).sum()
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, (along * away).sum() / length))
    r = away - t * along
    return (r * r).sum()
