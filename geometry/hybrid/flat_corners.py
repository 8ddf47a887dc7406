r"""Tetrahedra that a smooth skin would flatten, cut until none is left.

At a vertex det J of a tetrahedron is the triple product of its three edges' tangents. Around a vertex v of the skin
where that is smooth, all edges along the skin lie in one plane. So a face inside the solid with two edges v-a and v-b
along the skin is tangent to it at v, and whatever lies between the two is flat, however inner control points are
placed, although the straight tetrahedra are fine. The cures are topological: the chord a-b gets a new vertex in its
middle (the face, if a-b too runs along the skin), and what then still has three edges in one plane gets one inside.

Axis letters: t tetrahedron, v vertex, k edge, face or corner, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.shell import Shell
from iga.bernstein import functions_at
from iga.block import bezier_coefficients
from iga.cells import QUADRILATERAL, TETRAHEDRON

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TANGENT = 0.25
"""Sine of the angle between two edges and a tangent plane of the skin below which their face is cut."""
FLAT = 0.15
"""Triple product of unit tangents below which a tetrahedron is cut."""
_EDGES = TETRAHEDRON.edges
_FACES = np.array([face.vertices for face in TETRAHEDRON.faces])
_ROUNDS = 60
"""Rounds of cuts: in each an edge is cut unless another one of the same tetrahedron was first."""


@dataclass(frozen=True, eq=False)
class Tangents:
    """First-order data of a skin at its vertices.

    Attributes
    ----------
    edges : (k, 2) directed edges, ascending.
    along : (k, 3) unit tangent of each at its first vertex.
    vertex : (m,) vertex of each corner of an element, ascending.
    normal : (m, 3) unit normal there, outwards.
    """

    edges: Index
    along: Array
    vertex: Index
    normal: Array


def tangents_of(skin: Shell) -> Tangents:
    """Tangents and normals of a skin at its vertices."""
    pairs, along, vertex, normal = [], [], [], []
    for block, corners in zip(skin.space.blocks, skin.corners):
        net = bezier_coefficients(block, skin.points)
        basis = block.basis
        places = basis.cell.vertices
        ring = [0, 2, 3, 1] if basis.cell is QUADRILATERAL else [0, 1, 2]
        for k, here in enumerate(ring):
            both = []
            for end in (ring[(k + 1) % len(ring)], ring[k - 1]):
                step = (places[end] - places[here]) / basis.degree[0]
                first, second = functions_at(basis, np.stack([places[here], places[here] + step]))
                both.append(_unit(net[:, second] - net[:, first]))
                pairs.append(corners[:, [here, end]])
            along += both
            vertex.append(corners[:, here])
            normal.append(_unit(np.cross(both[0], both[1])))
    edges, where = np.unique(np.concatenate(pairs), axis=0, return_index=True)
    at = np.concatenate(vertex)
    order = np.argsort(at, kind="stable")
    return Tangents(edges, np.concatenate(along)[where], at[order], np.concatenate(normal)[order])


def _unit(x: Array) -> Array:
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300))


def without_flat_corners(vertices: Array, tets: Index, skin: Tangents) -> tuple[Array, Index, int]:
    """Cut tetrahedra that lie flat at a vertex of the skin.

    Parameters
    ----------
    vertices : (v, 3)
    tets : (t, 4) positive.

    Returns
    -------
    vertices and tetrahedra, with new ones, and how many vertices are new.
    """
    start = len(vertices)
    for _ in range(_ROUNDS):
        chords, faces = _tangent_faces(len(vertices), tets, skin)
        if not len(chords):
            break
        vertices, tets = _cut(vertices, tets, chords, _EDGES)
    if len(faces):
        vertices, tets = _cut(vertices, tets, faces, _FACES)
    flat = _flat(len(vertices), tets, skin)
    middle = vertices[tets[flat]].mean(axis=1)
    new = len(vertices) + np.arange(len(middle))
    vertices = np.concatenate([vertices, middle])
    parts = [np.delete(tets, flat, axis=0)]
    for v in range(4):
        own = tets[flat].copy()
        own[:, v] = new
        parts.append(own)
    return vertices, np.concatenate(parts), len(vertices) - start


def _tangent_faces(n: int, tets: Index, skin: Tangents) -> tuple[Index, Index]:
    """Faces inside the solid that are tangent to the skin at a vertex.

    Returns
    -------
    Chords opposite to that vertex (k, 2), ascending, and where the chord runs along the skin the faces (m, 3).
    """
    faces, times = np.unique(np.sort(tets[:, _FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    faces = faces[times == 2]
    keys = skin.edges @ np.array([n, 1])
    chords, whole = [], []
    for v, a, b in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
        corner = faces[:, [v, a, b]]
        first, on_first = _lookup(keys, corner[:, 0] * n + corner[:, 1])
        second, on_second = _lookup(keys, corner[:, 0] * n + corner[:, 2])
        both = on_first & on_second
        corner, first, second = corner[both], first[both], second[both]
        # Every corner of the skin's elements at the vertex, for each candidate.
        begin = np.searchsorted(skin.vertex, corner[:, 0])
        count = np.searchsorted(skin.vertex, corner[:, 0], side="right") - begin
        owner = np.repeat(np.arange(len(corner)), count)
        at = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        low = np.abs((skin.along[first][owner] * skin.normal[at]).sum(axis=1)) < TANGENT
        low &= np.abs((skin.along[second][owner] * skin.normal[at]).sum(axis=1)) < TANGENT
        bad = np.bincount(owner, low, minlength=len(corner)) > 0
        along_skin = _lookup(keys, corner[:, 1] * n + corner[:, 2])[1]
        chords.append(np.sort(corner[bad & ~along_skin][:, 1:], axis=1))
        whole.append(np.sort(corner[bad & along_skin], axis=1))
    return np.unique(np.concatenate(chords), axis=0), np.unique(np.concatenate(whole), axis=0)


def _lookup(keys: Index, wanted: Index) -> tuple[Index, NDArray[np.bool_]]:
    """Places of keys in an ascending list, and whether they are there."""
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return place, keys[place] == wanted


def _cut(vertices: Array, tets: Index, chosen: Index, table: Index) -> tuple[Array, Index]:
    """Cut edges or faces at their centres, and each tetrahedron around them in as many parts as they have vertices.

    Of those that share a tetrahedron the first is cut alone.

    Parameters
    ----------
    chosen : (k, 2) edges or (k, 3) faces, ascending.
    table : (m, 2) or (m, 3) local vertices of all edges, or faces, of a tetrahedron.
    """
    n, size = len(vertices), chosen.shape[1]
    order = n ** np.arange(size - 1, -1, -1)
    place, hit = _lookup(chosen @ order, np.sort(tets[:, table], axis=2) @ order)
    rank = np.where(hit, place, len(chosen))
    first = rank.min(axis=1)
    lost = np.unique(rank[hit & (rank != first[:, None])])
    kept = np.setdiff1d(rank[hit], lost)
    new = np.full(len(chosen) + 1, -1)
    new[kept] = n + np.arange(len(kept))
    cut = new[first] >= 0
    local = table[rank[cut].argmin(axis=1)]
    rows = np.arange(int(cut.sum()))
    parts = [tets[~cut]]
    for k in range(size):
        own = tets[cut].copy()
        own[rows, local[:, k]] = new[first[cut]]
        parts.append(own)
    return np.concatenate([vertices, vertices[chosen[kept]].mean(axis=1)]), np.concatenate(parts)


def _flat(n: int, tets: Index, skin: Tangents) -> Index:
    """Tetrahedra with three edges along the skin at a vertex that are nearly in one plane."""
    keys = skin.edges @ np.array([n, 1])
    flat = np.zeros(len(tets), dtype=bool)
    for v, others in enumerate(([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])):
        place, on = _lookup(keys, tets[:, [v]] * n + tets[:, others])
        flat |= on.all(axis=1) & (np.linalg.det(skin.along[place]) < FLAT)
    return np.flatnonzero(flat)
