"""Paths on a surface along edges of its triangles, and the splits of triangles that make room for them.

Splitting edges changes the triangulation, never the surface. A path may not touch walls (edges of other paths, the
border of the region it must stay in) except at its ends; an edge that joins two wall vertices is split first, so that
a path exists wherever the region is connected.

Axis letters: v vertex, t triangle, k edge, p vertex of a path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from geometry.simplices.surface import CLEAN, Surface, edge_rows, sharp
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SNAP = 0.15
"""A straight path that crosses an edge closer to its end than this share of its length goes through the end instead."""
LEAST_SHARE = 1e-3
"""New vertices lie no closer to an end of their edge than this share of its length: triangles would be flat."""
ASTRAY = 1e-9
"""A straight path that leaves a triangle beyond the ends of an edge by more than this share has gone astray."""
EASE = 0.3
"""Length of creases, as a part of their true length, for paths that shall follow them."""


@dataclass(frozen=True, eq=False)
class Path:
    """A path and the surface it runs on.

    Attributes
    ----------
    surface : the surface, some of its triangles split; old vertices keep their numbers.
    vertices : (p,) from start to end; neighbours are joined by edges.
    origin : (t,) the triangle before splitting that each triangle is part of.
    split : (k, 2) vertices between which each new vertex lies, in the order of their numbers.
    """

    surface: Surface
    vertices: Index
    origin: Index
    split: Index

    @property
    def edges(self) -> Index:
        """(p - 1, 2) its edges, from vertex to vertex."""
        return np.stack([self.vertices[:-1], self.vertices[1:]], axis=1)

    @property
    def length(self) -> float:
        """Its length."""
        return float(np.linalg.norm(np.diff(self.surface.points[self.vertices], axis=0), axis=1).sum())


def split_edges(surface: Surface, edges: Index, points: Array) -> tuple[Surface, Index]:
    """Put new vertices, numbered after the old ones, on edges; each triangle is cut in up to four.

    Two new vertices in one triangle are joined by an edge.

    Parameters
    ----------
    edges, points : (k,) distinct rows of ``surface.edges`` and (k, 3) the points on them.

    Returns
    -------
    The surface and for each triangle (t,) the one it was part of.
    """
    count = len(surface.triangles)
    if not len(edges):
        return surface, np.arange(count)
    middle = np.full(len(surface.edges), -1, dtype=np.int64)
    middle[edges] = len(surface.points) + np.arange(len(edges))
    on = middle[surface.edge_of]
    number = (on >= 0).sum(axis=1)
    whole = np.flatnonzero(number == 0)
    parts, origins = [surface.triangles[whole]], [whole]
    for new in (1, 2, 3):
        rows = np.flatnonzero(number == new)
        if not len(rows):
            continue
        # Turned so that the edges with new vertices come first (of two), or first (of one).
        has = on[rows] >= 0
        first = has & (~np.roll(has, 1, axis=1) if new < 3 else np.array([True, False, False]))
        turn = (np.argmax(first, axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(surface.triangles[rows], turn, axis=1).T
        p, q, r = np.take_along_axis(on[rows], turn, axis=1).T
        if new == 1:
            cut = [(a, p, c), (p, b, c)]
        elif new == 2:
            cut = [(p, b, q), (a, p, q), (a, q, c)]
        else:
            cut = [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
        parts += [np.stack(t, axis=1) for t in cut]
        origins += [rows] * len(cut)
    origin = np.concatenate(origins)
    order = np.argsort(origin, kind="stable")
    made = Surface(np.concatenate([surface.points, points]), np.concatenate(parts)[order])
    return made, origin[order]


def refined(surface: Surface, least: int) -> tuple[Surface, Index]:
    """Cut all triangles in four until there are at least that many; and the triangle each is part of."""
    origin = np.arange(len(surface.triangles))
    while len(surface.triangles) < least:
        middles = surface.points[surface.edges].mean(axis=1)
        surface, part = split_edges(surface, np.arange(len(surface.edges)), middles)
        origin = origin[part]
    return surface, origin


def rim(surface: Surface, inside: Mask) -> Mask:
    """Edges (k,) between the region, a mask (t,) of triangles, and the rest."""
    beside = inside[surface.beside]
    return beside[:, 0] != beside[:, 1]


def loop_of(surface: Surface, inside: Mask, start: int) -> Index:
    """Boundary vertices (b,) of a disk of triangles in the order of its orientation, from vertex ``start``.

    Raises
    ------
    InputError : the boundary is not one simple loop through the vertex.
    """
    edges = np.flatnonzero(rim(surface, inside))
    ends = surface.edges[edges]
    up = inside[surface.beside[edges, 0]]
    tail, head = np.where(up, ends[:, 0], ends[:, 1]), np.where(up, ends[:, 1], ends[:, 0])
    after = dict(zip(tail.tolist(), head.tolist()))
    loop = [start]
    while len(loop) <= len(edges) and loop[-1] in after:
        loop.append(after[loop[-1]])
        if loop[-1] == start:
            break
    if loop[-1] != start or len(loop) != len(edges) + 1 or len(after) != len(edges):
        raise InputError(f"a patch of the surface is no disk: its border is not one simple loop through vertex {start}")
    return np.array(loop[:-1], dtype=np.int64)


def without_chords(surface: Surface, group: Index) -> tuple[Surface, Index]:
    """Split edges inside a group (t,) of triangles that join two vertices of the group's border.

    Returns
    -------
    The surface and for each triangle the one it was part of.
    """
    beside = group[surface.beside]
    inner = beside[:, 0] == beside[:, 1]
    border = np.zeros(len(surface.points), dtype=bool)
    border[surface.edges[~inner]] = True
    chords = np.flatnonzero(inner & border[surface.edges].all(axis=1))
    return split_edges(surface, chords, surface.points[surface.edges[chords]].mean(axis=1))


def trace(
    surface: Surface, start: int, end: int, inside: Mask | None = None, walls: Index | None = None,
    places: Array | None = None, avoid: Index | None = None, creases: bool = False,
    clean: float = CLEAN,
) -> Path:
    """Shortest path along edges from one vertex to another.

    Parameters
    ----------
    start, end : vertices; they may lie on walls.
    inside : (t,) the region to stay in, border excluded; None for everywhere.
    walls : (w, 2) edges, as pairs of vertices, that the path may not touch.
    places : (v, n) coordinates in which lengths are measured; the points themselves if None. New vertices halve edges.
    avoid : further vertices that the path may not touch but at its ends.
    creases : let the path rather follow sharp edges of the surface.
    clean : see `sharp`.

    Raises
    ------
    InputError : the region does not connect the two.
    """
    inside = np.ones(len(surface.triangles), dtype=bool) if inside is None else inside
    places = surface.points if places is None else places
    wall = rim(surface, inside)
    if walls is not None:
        wall[edge_rows(surface, walls)] = True
    blocked = np.zeros(len(surface.points), dtype=bool)
    blocked[surface.edges[wall]] = True
    if avoid is not None:
        blocked[avoid] = True
    blocked[[start, end]] = True
    open_edges = inside[surface.beside].any(axis=1) & ~wall
    chords = np.flatnonzero(open_edges & blocked[surface.edges].all(axis=1))
    # The edge between start and end is itself a path.
    direct = (surface.edges[chords] == np.sort([start, end])).all(axis=1)
    if direct.any():
        return Path(surface, np.array([start, end]), np.arange(len(surface.triangles)), surface.edges[:0])
    middles = surface.edges[chords]
    surface, origin = split_edges(surface, chords, surface.points[middles].mean(axis=1))
    places = np.concatenate([places, places[middles].mean(axis=1)])
    blocked = np.concatenate([blocked, np.zeros(len(chords), dtype=bool)])
    blocked[[start, end]] = False
    inside = inside[origin]
    # The ends may not be short cuts into another region: only edges of the region itself count.
    usable = inside[surface.beside].all(axis=1) & ~blocked[surface.edges].any(axis=1)
    ends = surface.edges[usable]
    length = np.linalg.norm(places[ends[:, 1]] - places[ends[:, 0]], axis=1) + 1e-300
    if creases:
        length = np.where(sharp(surface, clean)[usable], EASE * length, length)
    size = len(surface.points)
    graph = csr_array(coo_array((length, (ends[:, 0], ends[:, 1])), shape=(size, size)))
    before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)[1]
    vertices = [end]
    while vertices[-1] != start:
        vertices.append(int(before[vertices[-1]]))
        if vertices[-1] < 0:
            raise InputError(f"no path leads from vertex {start} to vertex {end} without crossing another path")
    return Path(surface, np.array(vertices[::-1], dtype=np.int64), origin, middles)


def straight(surface: Surface, inside: Mask, places: Array, start: int, end: int) -> Path:
    """Path that is straight in a plane parametrisation of a region, cut through its triangles.

    Parameters
    ----------
    inside : (t,) the region.
    places : (v, 2) one-to-one plane coordinates of its vertices.
    start, end : two of its vertices; the segment between them lies in the region.

    Raises
    ------
    InputError : the segment could not be followed (the parametrisation is not one to one).
    """
    for snap in (SNAP, LEAST_SHARE):
        steps = _walk(surface, inside, places, start, end, snap)
        if steps is not None:
            break
    else:
        raise InputError(f"no straight path leads from vertex {start} to vertex {end}")
    cut = [(edge, share) for edge, share in steps if share >= 0]
    edges = np.array([edge for edge, _ in cut], dtype=np.int64)
    shares = np.array([share for _, share in cut]).reshape(-1, 1)
    ends = surface.points[surface.edges[edges]] if len(edges) else np.zeros((0, 2, 3))
    vertices, new = [], len(surface.points)
    for entity, share in steps:
        vertices.append(new if share >= 0 else entity)
        new += share >= 0
    made, origin = split_edges(surface, edges, ends[:, 0] * (1 - shares) + ends[:, 1] * shares)
    return Path(made, np.array(vertices, dtype=np.int64), origin, surface.edges[edges])


def _walk(
    surface: Surface, inside: Mask, places: Array, start: int, end: int, snap: float
) -> list[tuple[int, float]] | None:
    """Steps of a straight path: (vertex, -1) or (edge, share along it); None if it goes astray."""
    border = np.zeros(len(surface.points), dtype=bool)
    border[surface.edges[rim(surface, inside)]] = True
    tri, edge_of, beside = surface.triangles, surface.edge_of, surface.beside
    region = np.flatnonzero(inside)
    corner = np.argsort(tri[region].ravel(), kind="stable")
    owner, sorted_vertex = region[corner // 3], tri[region].ravel()[corner]
    goal = places[end]
    steps: list[tuple[int, float]] = [(start, -1.0)]
    used: set[int] = set()
    here, vertex, triangle, entry = places[start], start, -1, -1
    for _ in range(len(region) + 1):
        way = goal - here
        if vertex >= 0:
            found = None
            for t in owner[np.searchsorted(sorted_vertex, vertex) : np.searchsorted(sorted_vertex, vertex, "right")]:
                i = int(np.flatnonzero(tri[t] == vertex)[0])
                right, left = int(tri[t, (i + 1) % 3]), int(tri[t, (i + 2) % 3])
                if end in (right, left):
                    return [*steps, (end, -1.0)]
                if _cross(way, places[right] - here) <= 0 < _cross(way, places[left] - here):
                    found = (int(t), int(edge_of[t, (i + 1) % 3]))
            if found is None:
                return None
            triangle, exit_edge = found
        else:
            i = int(np.flatnonzero(edge_of[triangle] == entry)[0])
            right, left, apex = (int(tri[triangle, (i + j) % 3]) for j in (1, 0, 2))
            # The entry edge runs from corner i to corner i + 1; seen from inside, corner i is on the left.
            if apex == end:
                return [*steps, (end, -1.0)]
            side = _cross(way, places[apex] - here)
            exit_edge = int(edge_of[triangle, (i + 1) % 3] if side > 0 else edge_of[triangle, (i + 2) % 3])
        if triangle in used:
            return None
        used.add(triangle)
        a, b = surface.edges[exit_edge]
        one, two = _cross(way, places[a] - here), _cross(way, places[b] - here)
        share = one / (one - two) if one != two else 0.5
        if not -ASTRAY <= share <= 1 + ASTRAY:
            return None
        nearest = int(a if share < 0.5 else b)
        if min(share, 1 - share) < snap and not border[nearest]:
            vertex, here = nearest, places[nearest]
            steps.append((vertex, -1.0))
            continue
        share = min(max(share, LEAST_SHARE), 1 - LEAST_SHARE)
        here = places[a] * (1 - share) + places[b] * share
        steps.append((exit_edge, float(share)))
        across = beside[exit_edge]
        triangle = int(across[1] if across[0] == triangle else across[0])
        if not inside[triangle]:
            return None
        vertex, entry = -1, exit_edge
    return None


def chord_shares(points: Array) -> Array:
    """Chord length (b,) from the first of points (b, 3) to each, over the whole length."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.asarray(travelled / travelled[-1])


def _cross(a: Array, b: Array) -> float:
    """Cross product of two vectors (2,)."""
    return float(a[0] * b[1] - a[1] * b[0])
