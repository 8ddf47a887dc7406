"""Surface triangulations: what they must be to bound a solid, and what they enclose.

A surface is taken only if it bounds one solid: every edge belongs to two triangles that run through it in opposite
directions, the triangles around a vertex are one fan, there is one shell, no triangle is degenerate, the volume
V = 1/6 sum p0 . (p1 x p2) is positive and no two triangles cross. Its genus is g = 1 - (V - E + F) / 2.

Axis letters: v vertex, t triangle, k edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.simplices.crossing import crossing_pairs
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FLAT = 1e-9
"""Triangles lower than this part of their longest edge count as degenerate."""
LARGEST = 1e90
"""Coordinates beyond this are taken for errors; products of three of them must not overflow."""
CREASE = 40.0
"""Degrees between the normals at an edge from which on it is a crease."""
CLEAN = 2.0
"""There are creases if they are this much longer than edges at which the surface turns by a fourth of that or more."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed, oriented triangulation.

    Attributes
    ----------
    points : (v, 3) vertices.
    triangles : (t, 3) vertex numbers, outward by the right-hand rule.
    """

    points: Array
    triangles: Index

    @cached_property
    def edges(self) -> Index:
        """(k, 2) vertices of each edge, ascending; edges in lexical order."""
        return self._edge_table[0]

    @cached_property
    def edge_of(self) -> Index:
        """(t, 3) edge between corners i and i + 1 of each triangle."""
        return self._edge_table[1]

    @cached_property
    def _edge_table(self) -> tuple[Index, Index]:
        ends = np.sort(half_edges(self.triangles), axis=1)
        keys, inverse = np.unique(ends[:, 0] * len(self.points) + ends[:, 1], return_inverse=True)
        return np.stack(np.divmod(keys, len(self.points)), axis=1), inverse.reshape(-1, 3)

    @cached_property
    def beside(self) -> Index:
        """(k, 2) the triangles at each edge: the one that runs through it upwards, then the other."""
        result = np.full((len(self.edges), 2), -1, dtype=np.int64)
        up = self.triangles < np.roll(self.triangles, -1, axis=1)
        number = np.repeat(np.arange(len(self.triangles)), 3).reshape(-1, 3)
        result[self.edge_of[up], 0] = number[up]
        result[self.edge_of[~up], 1] = number[~up]
        return result

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def half_edges(triangles: Index) -> Index:
    """(3 t, 2) vertices of the sides of triangles (t, 3), in their order: from corner 0 to 1, 1 to 2, 2 to 0."""
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def edge_rows(surface: Surface, ends: Index) -> Index:
    """Rows (k,) of ``surface.edges`` that join pairs of vertices (k, 2), given in any order.

    Raises
    ------
    InputError : no edge joins a pair.
    """
    factors = np.array([len(surface.points), 1])
    keys, wanted = surface.edges @ factors, np.sort(ends, axis=1) @ factors
    row = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    if (apart := np.flatnonzero(keys[row] != wanted)).size:
        raise InputError(f"no edge of the surface joins the vertices {ends[apart[0], 0]} and {ends[apart[0], 1]}")
    return row


def doubled_normals(corners: Array) -> Array:
    """Normals (t, 3) of triangles with corners (t, 3, 3), twice as long as the triangles' areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def euler_characteristic(surface: Surface) -> int:
    """Vertices - edges + triangles."""
    return len(surface.points) - len(surface.edges) + len(surface.triangles)


def genus(surface: Surface) -> int:
    """Number of handles."""
    return 1 - euler_characteristic(surface) // 2


def volume(surface: Surface) -> float:
    """Volume enclosed by the surface."""
    corners = (surface.points - surface.points.mean(axis=0))[surface.triangles]
    return float(np.linalg.det(corners).sum()) / 6.0


def area_vectors(surface: Surface) -> Array:
    """Normals (t, 3) as long as the triangles' areas."""
    return doubled_normals(surface.points[surface.triangles]) / 2.0


def sharp(surface: Surface, clean: float = CLEAN) -> NDArray[np.bool_]:
    """Whether each edge (k,) is a crease, where the surface turns by more than `CREASE` degrees.

    On surfaces that turn almost as much at many other edges (scans, coarse meshes of round solids) none is: where
    creases are not ``clean`` times as long as edges that turn by a quarter of the angle at least.
    """
    normal = area_vectors(surface)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    one, two = surface.beside.T
    cosine = (normal[one] * normal[two]).sum(axis=1)
    crease = cosine < np.cos(np.radians(CREASE))
    bent = (cosine < np.cos(np.radians(CREASE / 4))) & ~crease
    length = np.linalg.norm(surface.points[surface.edges[:, 1]] - surface.points[surface.edges[:, 0]], axis=1)
    return np.asarray(crease & (length[crease].sum() > clean * length[bent].sum()))


def checked_surface(points: Array, triangles: Index, crossings: bool = False) -> tuple[Surface, dict[str, Any]]:
    """The surface, turned outwards and without unused vertices, and what was done to it.

    Parameters
    ----------
    points, triangles : (v, 3) and (t, 3), as read.
    crossings : report triangles that cross each other instead of refusing them.

    Returns
    -------
    The surface and a report: vertices, triangles, genus, volume, and ``turned``, ``unused_vertices`` and
    ``crossing_pairs`` if any.

    Raises
    ------
    InputError : the triangulation does not bound one solid; the message names the first entity that is wrong.
    """
    report: dict[str, Any] = {}
    require_numbers(points, triangles)
    _require_edges(points, triangles)
    used = np.unique(triangles)
    if len(used) < len(points):
        report["unused_vertices"] = len(points) - len(used)
    surface = Surface(np.ascontiguousarray(points[used]), np.searchsorted(used, triangles).astype(np.int64))
    _require_vertices(surface, used)
    shells = shells_of(surface)
    if shells.max() > 0:
        sizes = np.bincount(shells).tolist()
        raise InputError(
            f"the surface has {len(sizes)} shells of {_listed(sizes)} triangles; give one closed surface per solid"
        )
    size = volume(surface)
    if abs(size) <= 1e-12 * surface.diagonal**3:
        raise InputError(f"the surface encloses no volume ({size:.3g})")
    if size < 0:
        surface = Surface(surface.points, np.ascontiguousarray(surface.triangles[:, ::-1]))
        report["turned"] = "the triangles faced inwards and were turned round"
    pairs = crossing_pairs(surface.points, surface.triangles)
    if len(pairs) and crossings:
        report["crossing_pairs"] = len(pairs)
    elif len(pairs):
        raise InputError(
            f"triangles {pairs[0, 0]} and {pairs[0, 1]} cross each other ({len(pairs)} such pairs in all); "
            "give a surface that does not intersect itself"
        )
    report |= {
        "vertices": len(surface.points), "triangles": len(surface.triangles), "genus": genus(surface),
        "volume": abs(size),
    }
    return surface, report


def require_numbers(points: Array, triangles: Index) -> None:
    """Coordinates are numbers, vertex numbers are in range, and there are enough triangles for a solid.

    Raises
    ------
    InputError : one of these does not hold.
    """
    bad = np.flatnonzero(~(np.abs(points) <= LARGEST).all(axis=1))
    if len(bad):
        raise InputError(f"vertex {bad[0]} has a coordinate that is no number up to {LARGEST:g}")
    outside = np.flatnonzero(((triangles < 0) | (triangles >= len(points))).any(axis=1))
    if len(outside):
        raise InputError(f"triangle {outside[0]} names a vertex that is not among the {len(points)} vertices")
    if len(triangles) < 4:
        raise InputError(f"{len(triangles)} triangles cannot enclose a solid")


def degenerate(points: Array, triangles: Index) -> NDArray[np.bool_]:
    """Whether each triangle (t,) is lower than `FLAT` times its longest edge."""
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    # Scaled first: tiny solids have tiny areas.
    scale = np.abs(sides).max(axis=(1, 2), initial=0.0)
    sides /= np.where(scale > 0, scale, 1.0)[:, None, None]
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    return ~(twice > FLAT * longest)


def _require_edges(points: Array, triangles: Index) -> None:
    """No degenerate triangle, every edge in two triangles, in opposite directions."""
    flat = np.flatnonzero(degenerate(points, triangles))
    if len(flat):
        a, b, c = triangles[flat[0]]
        raise InputError(
            f"triangle {flat[0]} with vertices {a}, {b}, {c} is degenerate ({len(flat)} in all); "
            "remove such triangles or build with mend=true"
        )
    half = half_edges(triangles)
    low, high = half.min(axis=1), half.max(axis=1)
    first, inverse, count = np.unique(
        low * len(points) + high, return_index=True, return_inverse=True, return_counts=True
    )[1:]
    for kind in (count > 2, count < 2):
        bad = np.flatnonzero(kind)
        if len(bad):
            a, b = half[first[bad[0]]]
            if kind[bad[0]] and count[bad[0]] == 1:
                raise InputError(
                    f"the edge between vertices {a} and {b} belongs to one triangle only ({len(bad)} such edges): "
                    "the surface is not closed; close its holes or build with mend=true"
                )
            raise InputError(
                f"the edge between vertices {a} and {b} belongs to {count[bad[0]]} triangles ({len(bad)} such edges): "
                "the surface is no manifold there"
            )
    up = np.bincount(inverse, weights=(half[:, 0] == low).astype(float))
    bad = np.flatnonzero(up != 1)
    if len(bad):
        a, b = half[first[bad[0]]]
        raise InputError(
            f"the two triangles at the edge between vertices {a} and {b} have opposite orientations "
            f"({len(bad)} such edges); orient the triangles alike or build with mend=true"
        )


def fans(triangles: Index, edge_of: Index) -> Index:
    """Fan (t, 3) of every triangle corner: corners in one fan are joined by edges at their common vertex.

    Parameters
    ----------
    triangles, edge_of : (t, 3) vertices, and edges as in `Surface`; every edge has two triangles.
    """
    corner = np.arange(3 * len(triangles)).reshape(-1, 3)
    # Each edge joins, at either end, a corner of the one triangle with a corner of the other.
    here = np.concatenate([corner, np.roll(corner, -1, axis=1)]).ravel()
    vertex = np.concatenate([triangles, np.roll(triangles, -1, axis=1)]).ravel()
    edge = np.tile(edge_of.ravel(), 2)
    order = np.lexsort((vertex, edge))
    pairs = here[order].reshape(-1, 2)
    size = 3 * len(triangles)
    link = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return connected_components(link, directed=False)[1].reshape(-1, 3).astype(np.int64)


def _require_vertices(surface: Surface, names: Index) -> None:
    """The triangles around a vertex are one fan; ``names`` (v,) are the vertices' numbers in the input."""
    fan = fans(surface.triangles, surface.edge_of)
    if fan.max() + 1 == len(surface.points):
        return
    pairs = np.unique(np.stack([surface.triangles.ravel(), fan.ravel()], axis=1), axis=0)
    count = np.bincount(pairs[:, 0])
    bad = np.flatnonzero(count > 1)
    raise InputError(
        f"the triangles around vertex {names[bad[0]]} are {count[bad[0]]} fans ({len(bad)} such vertices): the surface "
        "is no manifold there; give each fan its own vertex or build with mend=true"
    )


def shells_of(surface: Surface) -> Index:
    """Shell (t,) of each triangle: triangles are joined by edges."""
    edge_of, count, edges = surface.edge_of, len(surface.triangles), len(surface.edges)
    number = np.repeat(np.arange(count), 3)
    link = coo_array((np.ones(3 * count, dtype=np.int8), (number, count + edge_of.ravel())), shape=(count + edges,) * 2)
    return connected_components(link, directed=False)[1][:count].astype(np.int64)


def _listed(sizes: list[int]) -> str:
    """A few numbers for a message."""
    shown = ", ".join(str(size) for size in sizes[:4])
    return shown + (", ..." if len(sizes) > 4 else "")
