r"""Topology of a hexahedral mesh in arrays: edges, faces, valences, boundary, and what kind each entity is.

Every entity has a *kind*, the dimension of the smooth piece that its subdivision rule averages over:

    3 interior,  2 smooth boundary,  1 crease,  0 corner.

Interior rules average over incident cells, boundary rules over incident boundary faces, crease rules over the two
crease edges, and corners stay. The kinds of a subdivided mesh follow from those of its parent (see `subdivision`).
An entity is *regular* if its surroundings are those of a product mesh: edges of kind 3, 2, 1 with 4, 2, 1 cells, and
vertices of kind 3, 2, 1, 0 with 8, 4, 2, 1 cells and regular edges only.

Axis letters: e hexahedron, f face, m edge, v vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from iga.cells import HEXAHEDRON
from iga.conforming import entity_keys
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Kinds = NDArray[np.int8]

EDGES = HEXAHEDRON.edges
FACES = np.array([face.vertices for face in HEXAHEDRON.faces], dtype=np.int64)
_EDGE_AT = {frozenset(edge): k for k, edge in enumerate(EDGES.tolist())}
# Edges of each face: two along its second axis, two along its first (00-01, 10-11, 00-10, 01-11).
FACE_EDGES = np.array(
    [[_EDGE_AT[frozenset((f[a], f[b]))] for a, b in ((0, 1), (2, 3), (0, 2), (1, 3))] for f in FACES.tolist()]
)
MIRROR = np.array([1, 0, 3, 2, 5, 4, 7, 6])
INTERIOR, SMOOTH, CREASE, CORNER = 3, 2, 1, 0


@dataclass(frozen=True, eq=False)
class Topology:
    """Entities of a hexahedral mesh and their incidence.

    Attributes
    ----------
    hexes : (e, 8) vertex numbers in the order of `iga.cells.HEXAHEDRON`.
    vertices : number of vertices.
    edges, faces : (m, 2) with the smaller vertex first, and (f, 4) in the order of a quadrilateral (00, 01, 10, 11).
    hex_edges, hex_faces : (e, 12) and (e, 6), numbered as in the reference cell.
    face_edges : (f, 4).
    edge_cells, face_cells : (m,) and (f,) number of incident cells.
    vertex_kind, edge_kind, face_kind : kinds, see the module docstring.
    """

    hexes: Index
    vertices: int
    edges: Index
    faces: Index
    hex_edges: Index
    hex_faces: Index
    face_edges: Index
    edge_cells: Index
    face_cells: Index
    vertex_kind: Kinds
    edge_kind: Kinds
    face_kind: Kinds

    @cached_property
    def vertex_cells(self) -> Index:
        """Number of cells at each vertex, (v,)."""
        return np.bincount(self.hexes.ravel(), minlength=self.vertices)

    @cached_property
    def vertex_edges(self) -> Index:
        """Number of edges at each vertex, (v,): its valence n."""
        return np.bincount(self.edges.ravel(), minlength=self.vertices)

    @cached_property
    def boundary_faces(self) -> Index:
        """Numbers of the boundary faces."""
        return np.flatnonzero(self.face_kind == SMOOTH)

    @cached_property
    def boundary_valence(self) -> Index:
        """Number N of boundary faces at each vertex, (v,)."""
        return np.bincount(self.faces[self.boundary_faces].ravel(), minlength=self.vertices)

    @cached_property
    def regular_edges(self) -> Flags:
        """Edges with the number of cells that a product mesh has there, (m,)."""
        return self.edge_cells == np.array([0, 1, 2, 4])[self.edge_kind]

    @cached_property
    def regular_vertices(self) -> Flags:
        """Vertices whose star is that of a product mesh, (v,)."""
        odd = np.bincount(self.edges[~self.regular_edges].ravel(), minlength=self.vertices)
        return (odd == 0) & (self.vertex_cells == np.array([1, 2, 4, 8])[self.vertex_kind])

    @cached_property
    def regular_hexes(self) -> Flags:
        """Cells on which the limit is one tricubic piece, (e,)."""
        return cast(Flags, self.regular_vertices[self.hexes].all(axis=1))

    @cached_property
    def cells_of_vertex(self) -> csr_array:
        """Incidence (v, e) with entries 1."""
        return incidence(self.hexes, self.vertices).T.tocsr()

    @cached_property
    def boundary_sides(self) -> tuple[Index, Index]:
        """Cell and local face number of each boundary side."""
        cell, side = np.nonzero(self.face_kind[self.hex_faces] == SMOOTH)
        return cell, side


def incidence(members: Index, columns: int) -> csr_array:
    """Matrix (rows, columns) with a one at each of the members (rows, k) of its rows."""
    rows, k = members.shape
    return csr_array((np.ones(members.size), members.ravel(), np.arange(0, members.size + 1, k)), shape=(rows, columns))


def build_topology(hexes: Index, vertices: int) -> Topology:
    """Topology of a mesh, every boundary entity smooth. Use `check_topology` on input that may be bad.

    Parameters
    ----------
    hexes : (e, 8) vertex numbers.
    vertices : number of vertices.

    Raises
    ------
    InputError : a face has more than two cells, or its two cells disagree about its diagonals.
    """
    ends = np.sort(hexes[:, EDGES].reshape(-1, 2), axis=1)
    _, first, inverse = np.unique(ends[:, 0] * vertices + ends[:, 1], return_index=True, return_inverse=True)
    edges, hex_edges = ends[first], inverse.reshape(-1, len(EDGES))
    edge_cells = np.bincount(inverse, minlength=len(edges))
    corners = hexes[:, FACES].reshape(-1, 4)
    keys = entity_keys(corners, vertices)
    _, first, inverse, face_cells = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    faces, hex_faces = corners[first], inverse.reshape(-1, len(FACES))
    _check_faces(corners, faces, inverse, face_cells)
    cell, side = np.divmod(first, len(FACES))
    face_edges = hex_edges[cell[:, None], FACE_EDGES[side]]
    face_kind = np.where(face_cells == 1, SMOOTH, INTERIOR).astype(np.int8)
    edge_kind = np.full(len(edges), INTERIOR, dtype=np.int8)
    vertex_kind = np.full(vertices, INTERIOR, dtype=np.int8)
    edge_kind[face_edges[face_kind == SMOOTH]] = SMOOTH
    vertex_kind[faces[face_kind == SMOOTH]] = SMOOTH
    return Topology(
        hexes, vertices, edges, faces, hex_edges, hex_faces, face_edges, edge_cells, face_cells, vertex_kind, edge_kind,
        face_kind,
    )


def _check_faces(corners: Index, faces: Index, inverse: Index, count: Index) -> None:
    many = np.flatnonzero(count > 2)
    if len(many):
        raise InputError(f"the face with vertices {_names(faces[many[0]])} belongs to {count[many[0]]} cells")
    # Two cells see one face alike if the vertex across from the smallest is the same.
    def across(quads: Index) -> Index:
        smallest = quads.argmin(axis=1)
        return np.take_along_axis(quads, 3 - smallest[:, None], axis=1)[:, 0]

    bad = np.flatnonzero(
        (across(corners) != across(faces)[inverse]) | (corners.max(axis=1) != faces.max(axis=1)[inverse])
    )
    if len(bad):
        raise InputError(
            f"element {bad[0] // len(FACES)} does not fit its neighbour across the face with vertices "
            f"{_names(corners[bad[0]])} (wrong vertex order or a face that only partly matches)"
        )


def _names(vertices: Index) -> str:
    return ", ".join(str(v) for v in np.sort(vertices).tolist())


def with_kinds(topology: Topology, vertex: Kinds, edge: Kinds, face: Kinds) -> Topology:
    """Return the same mesh with other kinds."""
    return replace(topology, vertex_kind=vertex, edge_kind=edge, face_kind=face)


def check_topology(topology: Topology) -> None:
    """Check that the mesh is a manifold with boundary.

    Raises
    ------
    InputError : an edge has more than two boundary faces, or the cells at a vertex do not form a ball or half ball.
    """
    outer = topology.face_edges[topology.boundary_faces]
    count = np.bincount(outer.ravel(), minlength=len(topology.edges))
    bad = np.flatnonzero((count != 0) & (count != 2))
    if len(bad):
        a, b = topology.edges[bad[0]]
        raise InputError(
            f"the edge between vertices {a} and {b} has {count[bad[0]]} boundary faces; the solid touches itself there "
            "(non-manifold): split the vertices or remove a cell"
        )
    used = topology.vertex_cells > 0
    faces_at = np.bincount(topology.faces.ravel(), minlength=topology.vertices)
    # Euler number of the link of a vertex: 2 for a sphere, 1 for a disc.
    euler = topology.vertex_edges - faces_at + topology.vertex_cells
    bad = np.flatnonzero(used & (euler != np.where(topology.vertex_kind == INTERIOR, 2, 1)))
    if not len(bad):
        bad = _split_stars(topology)
    if len(bad):
        raise InputError(
            f"the cells at vertex {bad[0]} do not form one piece; parts of the solid touch there in a point "
            "(non-manifold): split the vertex"
        )


def _split_stars(topology: Topology) -> Index:
    """Vertices whose cells are not connected through faces at the vertex."""
    slot = np.arange(topology.hexes.size).reshape(topology.hexes.shape)
    owner: list[Index] = []
    members: list[Index] = []
    for side, corners in enumerate(FACES):
        for corner in corners:
            owner.append(topology.hex_faces[:, side] * topology.vertices + topology.hexes[:, corner])
            members.append(slot[:, corner])
    keys, corner_slots = np.concatenate(owner), np.concatenate(members)
    order = np.argsort(keys, kind="stable")
    keys, corner_slots = keys[order], corner_slots[order]
    pair = np.flatnonzero(keys[1:] == keys[:-1])
    size = topology.hexes.size
    graph = coo_array((np.ones(len(pair)), (corner_slots[pair], corner_slots[pair + 1])), shape=(size, size))
    label = connected_components(graph, directed=False)[1]
    vertex = topology.hexes.ravel()
    low = np.full(topology.vertices, size, dtype=np.int64)
    high = np.full(topology.vertices, -1, dtype=np.int64)
    np.minimum.at(low, vertex, label)
    np.maximum.at(high, vertex, label)
    return np.flatnonzero((high >= 0) & (low != high))


def orient(hexes: Index, vertices: int, points: Array) -> tuple[Index, int]:
    """Orient all cells of each connected piece alike, and each piece so that its volume is positive.

    A cell is not turned because it is inverted: only the numbering decides within a piece.

    Returns
    -------
    The cells (e, 8), and how many were mirrored.

    Raises
    ------
    InputError : the cells cannot be oriented alike.
    """
    corners = hexes[:, FACES].reshape(-1, 4)
    inverse = np.unique(entity_keys(corners, vertices), return_inverse=True)[1]
    order = np.argsort(inverse, kind="stable")
    pair = np.flatnonzero(inverse[order][1:] == inverse[order][:-1])
    one, two = order[pair], order[pair + 1]
    # Outward normals oppose: cycles 0, 2, 3, 1 from the smallest vertex run against each other.
    alike = _turn(corners[one]) != _turn(corners[two])
    a, b = one // len(FACES), two // len(FACES)
    e = len(hexes)
    rows = np.concatenate([a, a + e])
    columns = np.concatenate([np.where(alike, b, b + e), np.where(alike, b + e, b)])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * e, 2 * e))
    label = connected_components(graph, directed=False)[1]
    bad = np.flatnonzero(label[:e] == label[e:])
    if len(bad):
        raise InputError(f"the cells around element {bad[0]} cannot be oriented alike (inconsistent or non-orientable)")
    flip = label[:e] > label[e:]
    piece = np.minimum(label[:e], label[e:])
    sign = np.where(flip, -1.0, 1.0) * centre_volumes(points, hexes)
    negative = np.bincount(piece, sign, minlength=label.max() + 1) < 0
    flip ^= negative[piece]
    return np.where(flip[:, None], hexes[:, MIRROR], hexes), int(flip.sum())


def _turn(quads: Index) -> Flags:
    """Whether the cycle of each quadrilateral goes from its smallest vertex to the smaller neighbour."""
    cycle = quads[:, [0, 2, 3, 1]]
    start = cycle.argmin(axis=1)
    rows = np.arange(len(quads))
    return cycle[rows, (start + 1) % 4] < cycle[rows, (start + 3) % 4]


def centre_volumes(points: Array, hexes: Index) -> Array:
    """Jacobian determinant of the trilinear map at the centre of each cell, (e,)."""
    x = points[hexes]
    signs = np.where(HEXAHEDRON.vertices > 0, 0.25, -0.25)
    J = np.einsum("evc,vd->ecd", x, signs)
    return np.asarray(np.linalg.det(J), dtype=np.float64)
