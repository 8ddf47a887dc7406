r"""Interpolating subdivision of hexahedral meshes by the four-point rule: the volumetric butterfly scheme.

A level keeps all vertices and adds a point for each edge, face and cell by cubic interpolation along lines of the mesh,

    edge   (a + b)/2 - (D_a + D_b)/16,      D_a = a' - 2 a + b the second difference at a along the edge,

which with a' straight on beyond a is the four-point rule (-1, 9, 9, -1)/16. Face points are the same rule applied to
the edge points of two opposite edges (the mean of both directions), cell points the same applied to face points. On
product meshes that is the tensor product of tricubic Lagrange interpolation: the regular case of McDonnell, Chang, Qin,
"Interpolatory, solid subdivision of unstructured hexahedral meshes" (2004), C1 there, as Xie et al. 2020 compare with.

Off product meshes the rule needs an "opposite" of an item in a ring of m alike (edges at a vertex of a surface, faces
at an edge). It is the operator that is exact for quadratics on the regular ring: +1 on the Fourier modes 0 and +-2, -1
on +-1, zero on others,

    w_ij = (1 - 2 cos(2 pi d_ij/m) + 2 cos(4 pi d_ij/m))/m      (m = 4: the opposite itself; m = 3: no last term).

At vertices on one straight line of valence m the other edges form such a ring. At all other extraordinary vertices
D = 2 (E - v), E the mean of the neighbours weighted by valence, which is exact for linear data on balanced stars. Where
nothing lies beyond (the boundary seen from inside, creases seen from their faces, corners) D is that of the other end,
so that quadratics are reproduced, and zero if the other end has none either.

The masks at extraordinary edges and vertices are this module's own; the 2004 paper's were not at hand. The limit is no
polynomial and has no extraction: a domain is built by interpolating the points of one level (`source`).

Axis letters: v vertex, m edge, f face, e cell, k star of one size, n member of a star.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, vstack

from geometry.catmull_clark.lattice import refinement_rows
from geometry.catmull_clark.subdivision import refine_topology
from geometry.catmull_clark.topology import CREASE, EDGES, FACES, INTERIOR, SMOOTH, Topology

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

_OPPOSITE_FACE = np.array([1, 0, 3, 2, 5, 4])
# The two faces of a cell that meet in each of its edges, (12, 2).
_SIDES_AT_EDGE = np.array(
    [[side for side, face in enumerate(FACES.tolist()) if {a, b} <= set(face)] for a, b in EDGES.tolist()]
)


def butterfly(topology: Topology) -> tuple[Topology, csr_array]:
    """One level of interpolating subdivision.

    Returns
    -------
    The refined mesh and the matrix (v', v), numbered as by `subdivision.subdivide`; its first v rows are the identity.
    """
    t = topology
    edges = _edge_points(t)
    faces = _face_points(t, edges)
    cells = _cell_points(t, faces)
    matrix = vstack([_select(np.arange(t.vertices), t.vertices), edges, faces, cells]).tocsr()
    return refine_topology(refinement_rows(t)), csr_array(matrix)


def _select(columns: Index, size: int) -> csr_array:
    n = len(columns)
    return csr_array((np.ones(n), columns, np.arange(n + 1)), shape=(n, size))


def _four_point(a: csr_array, b: csr_array, D: csr_array, known: Flags) -> csr_array:
    """Rule for items with ends a, b (n, v) and second differences D (2n, v) at the ends, where ``known`` (2n,)."""
    n = a.shape[0]
    one, two = known[:n], known[n:]
    # Where one end has no second difference, that of the other counts twice.
    first = np.where(one, np.where(two, 1.0, 2.0), 0.0)
    second = np.where(two, np.where(one, 1.0, 2.0), 0.0)
    scale = csr_array((np.concatenate([first, second]), (np.tile(np.arange(n), 2), np.arange(2 * n))), shape=(n, 2 * n))
    return csr_array(0.5 * (a + b) - (1.0 / 16.0) * (scale @ D))


def ring_weights(beside: Flags) -> Array:
    """Weights w (k, m, m) of the opposites in rings, from who is beside whom (k, m, m)."""
    m = beside.shape[1]
    distance = np.where(np.eye(m, dtype=bool), 0, np.where(beside, 1, m))
    for _ in range(m // 2):
        through = np.where(beside[:, :, :, None], distance[:, None] + 1, m).min(axis=2)
        distance = np.minimum(distance, through)
    angle = 2.0 * np.pi * distance / m
    w = 1.0 - 2.0 * np.cos(angle)
    if m >= 4:
        w += (1.0 if m == 4 else 2.0) * np.cos(2.0 * angle)
    return np.asarray(w / m)


def _stars(
    owner: Index, member: Index, pairs: tuple[Index, Index, Index], wanted: Flags
) -> Iterator[tuple[Index, Index, Flags]]:
    """Stars of the owners wanted, by size: owners (k,), rows of ``owner`` (k, n), who is beside whom (k, n, n).

    Parameters
    ----------
    owner, member : incidences, no pair twice.
    pairs : owner and two of its members that are beside each other.
    """
    order = np.lexsort((member, owner))
    count = np.bincount(owner, minlength=len(wanted))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    bound = int(member.max()) + 1 if len(member) else 1
    keys = owner[order] * bound + member[order]
    of, one, two = pairs
    slot_one = np.searchsorted(keys, of * bound + one) - start[of]
    slot_two = np.searchsorted(keys, of * bound + two) - start[of]
    for n in np.unique(count[wanted & (count > 0)]).tolist():
        some = np.flatnonzero(wanted & (count == n))
        place = np.full(len(wanted), -1, dtype=np.int64)
        place[some] = np.arange(len(some))
        beside = np.zeros((len(some), n, n), dtype=bool)
        mine = place[of] >= 0
        k, i, j = place[of[mine]], slot_one[mine], slot_two[mine]
        beside[k, i, j] = True
        beside[k, j, i] = True
        yield some, order[start[some][:, None] + np.arange(n)], beside


def _entries(rows: Index, columns: Index, weights: Array, shape: tuple[int, int]) -> csr_array:
    rows, columns, weights = np.broadcast_arrays(rows, columns, weights)
    return csr_array(coo_array((weights.ravel(), (rows.ravel(), columns.ravel())), shape=shape))


def _edge_points(t: Topology) -> csr_array:
    """Points of edges (m, v)."""
    m, v = len(t.edges), t.vertices
    ends = _select(t.edges.T.ravel(), v)
    far = _select(t.edges[:, ::-1].T.ravel(), v)
    # Row r < m is the first end of edge r, row m + r its second.
    owner, edge = t.edges.T.ravel(), np.tile(np.arange(m), 2)
    opposite, known = _opposites_at_vertices(t, owner, edge)
    keep = csr_array((known.astype(float), (np.arange(2 * m), np.arange(2 * m))), shape=(2 * m, 2 * m))
    D = keep @ (opposite @ far - 2.0 * ends + far)
    return _four_point(ends[:m], ends[m:], csr_array(D), known)


def _opposites_at_vertices(t: Topology, owner: Index, edge: Index) -> tuple[csr_array, Flags]:
    """Weights of other edge ends that stand for what lies opposite of each, (2m, 2m), and whether there is any."""
    ends = len(owner)
    known = np.zeros(ends, dtype=bool)
    total = csr_array((ends, ends))
    kind = t.vertex_kind[owner]
    corner = np.array([[0, 2], [0, 3], [1, 2], [1, 3]])  # edges of a face (00-01, 10-11, 00-10, 01-11) at its corners
    for inside in (True, False):
        faces = np.arange(len(t.faces)) if inside else t.boundary_faces
        one, two = (t.face_edges[faces[:, None], corner[:, k]].ravel() for k in (0, 1))
        pairs = (t.faces[faces].ravel(), one, two)
        mine = np.ones(ends, dtype=bool) if inside else t.edge_kind[edge] < INTERIOR
        wanted = (t.vertex_kind == INTERIOR) if inside else (t.vertex_kind == SMOOTH)
        rows = np.flatnonzero(mine)
        for _, slots, beside in _stars(owner[rows], edge[rows], pairs, wanted):
            members = rows[slots]
            known[members] = True
            w = _star_weights(t, edge[members], beside) if inside else ring_weights(beside)
            total = total + _entries(members[:, :, None], members[:, None, :], w, (ends, ends))
    crease = np.flatnonzero((kind == CREASE) & (t.edge_kind[edge] == CREASE))
    along = crease[np.argsort(owner[crease], kind="stable")].reshape(-1, 2)
    known[along] = True
    return csr_array(total + _entries(along, along[:, ::-1], np.asarray(1.0), (ends, ends))), known


def _star_weights(t: Topology, edges: Index, beside: Flags) -> Array:
    """Opposites (k, n, n) at interior vertices whose edges are given (k, n)."""
    k, n = edges.shape
    valence = t.edge_cells[edges]
    apart = ~beside & ~np.eye(n, dtype=bool)
    if n == 6:
        straight = (valence == 4).all(axis=1)
    else:
        straight = np.zeros(k, dtype=bool)
    # One straight line: two edges of valence n - 2 apart from each other, all others of valence 4.
    pole = valence == n - 2
    line = (pole.sum(axis=1) == 2) & ((valence == 4) | pole).all(axis=1) & (n != 6)
    # Elsewhere D = 2 (E - v): the opposite is 2 E - e, E weighted by valence.
    w = 2.0 * np.broadcast_to((valence / valence.sum(axis=1, keepdims=True))[:, None], (k, n, n)) - np.eye(n)
    w[straight] = apart[straight]
    if line.any():
        some = np.flatnonzero(line)
        poles = np.argsort(~pole[some], axis=1, kind="stable")
        both, ring = poles[:, :2], poles[:, 2:]
        w[some] = 0.0
        w[some, both[:, 0], both[:, 1]] = w[some, both[:, 1], both[:, 0]] = 1.0
        own = beside[some[:, None, None], ring[:, :, None], ring[:, None, :]]
        w[some[:, None, None], ring[:, :, None], ring[:, None, :]] = ring_weights(own)
    return w


def _face_points(t: Topology, edges: csr_array) -> csr_array:
    """Points of faces (f, v) from those of edges (m, v)."""
    f = len(t.faces)
    # Incidence (face, side): sides 0 to 3 as `face_edges`; 0 and 1 are opposite, so are 2 and 3.
    owner, face = t.face_edges.T.ravel(), np.tile(np.arange(f), 4)
    far = edges[t.face_edges[:, [1, 0, 3, 2]].T.ravel()]
    near = edges[owner]
    known = np.zeros(4 * f, dtype=bool)
    total = csr_array((4 * f, 4 * f))
    pairs = (
        t.hex_edges.ravel(), t.hex_faces[:, _SIDES_AT_EDGE[:, 0]].ravel(), t.hex_faces[:, _SIDES_AT_EDGE[:, 1]].ravel()
    )
    for _, members, beside in _stars(owner, face, pairs, t.edge_kind == INTERIOR):
        known[members] = True
        total = total + _entries(members[:, :, None], members[:, None, :], ring_weights(beside), total.shape)
    outer = np.flatnonzero((t.face_kind[face] == SMOOTH) & (t.edge_kind[owner] == SMOOTH))
    across = outer[np.argsort(owner[outer], kind="stable")].reshape(-1, 2)
    known[across] = True
    total = csr_array(total + _entries(across, across[:, ::-1], np.asarray(1.0), total.shape))
    keep = csr_array((known.astype(float), (np.arange(4 * f), np.arange(4 * f))), shape=(4 * f, 4 * f))
    D = csr_array(keep @ (total @ far - 2.0 * near + far))
    made = [
        _four_point(near[s * f : (s + 1) * f], near[(s + 1) * f : (s + 2) * f], D[s * f : (s + 2) * f],
            known[s * f : (s + 2) * f])
        for s in (0, 2)
    ]
    return csr_array(0.5 * (made[0] + made[1]))


def _cell_points(t: Topology, faces: csr_array) -> csr_array:
    """Points of cells (e, v) from those of faces (f, v)."""
    e = len(t.hexes)
    owner = t.hex_faces.T.ravel()
    near, far = faces[owner], faces[t.hex_faces[:, _OPPOSITE_FACE].T.ravel()]
    known = t.face_kind[owner] == INTERIOR
    inner = np.flatnonzero(known)
    across = inner[np.argsort(owner[inner], kind="stable")].reshape(-1, 2)
    other = _entries(across, across[:, ::-1], np.asarray(1.0), (6 * e, 6 * e))
    keep = csr_array((known.astype(float), (np.arange(6 * e), np.arange(6 * e))), shape=(6 * e, 6 * e))
    D = csr_array(keep @ (other @ far - 2.0 * near + far))
    made = [
        _four_point(near[s * e : (s + 1) * e], near[(s + 1) * e : (s + 2) * e], D[s * e : (s + 2) * e],
            known[s * e : (s + 2) * e])
        for s in (0, 2, 4)
    ]
    return csr_array((1.0 / 3.0) * (made[0] + made[1] + made[2]))
