r"""Sharp features of the boundary: creases and corners.

A boundary edge is a crease if its two boundary faces turn by more than an angle, or if it belongs to one cell only
(across a smooth edge such a cell would have two boundary faces in one tangent plane and a vanishing Jacobian). A
boundary vertex is a corner if other than two creases meet there, or if two meet at a kink. Creases found by angle that
end somewhere on a smooth surface (noise on curved coarse meshes) are dropped from their loose ends.

Axis letters: m edge, v vertex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark.topology import CORNER, CREASE, FACES, INTERIOR, SMOOTH, Topology, with_kinds
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ANGLE = 40.0
"""Degrees by which boundary faces must turn to make a crease, by default."""
KINK = 60.0
"""Degrees by which a crease must turn at a vertex to make it a corner."""


def outward_quads(topology: Topology) -> tuple[Index, Index]:
    """Boundary faces: their numbers (b,) and their vertices (b, 4) in outward order 00, 01, 10, 11 (axes cross out)."""
    cell, side = topology.boundary_sides
    return topology.hex_faces[cell, side], topology.hexes[cell[:, None], FACES[side]]


def boundary_angles(topology: Topology, points: Array) -> tuple[Index, Array]:
    """Boundary edges (b,) and the angle in degrees by which their two boundary faces turn (b,)."""
    number, quads = outward_quads(topology)
    x = points[quads]
    normal = np.cross(x[:, 3] - x[:, 0], x[:, 1] - x[:, 2])
    # The face's first axis is 00 -> 10 and axes[0] x axes[1] points outward: diagonals (11-00) x (01-10) do too.
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    edges = topology.face_edges[number].ravel()
    order = np.argsort(edges, kind="stable")
    owner = np.repeat(np.arange(len(quads)), 4)[order].reshape(-1, 2)
    cosine = np.einsum("bc,bc->b", normal[owner[:, 0]], normal[owner[:, 1]])
    return edges[order][::2], np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def smooth_folds(topology: Topology) -> Index:
    """Cells with two boundary faces across an edge that is no crease: their Jacobian vanishes on that edge."""
    fold = (topology.edge_cells == 1) & (topology.edge_kind == SMOOTH)
    return np.flatnonzero(fold[topology.hex_edges].any(axis=1))


def with_features(
    topology: Topology,
    points: Array,
    features: str | float | tuple[Index, Index] = "auto",
    kink: float = KINK,
) -> Topology:
    """Set creases and corners.

    Parameters
    ----------
    points : (v, 3).
    features : "none"; "auto" for angles above 40 degrees and edges of a single cell; a number of degrees, for such
        angles only; or crease edges as pairs of vertices (k, 2) and corner vertices (j,).
    kink : degrees; a crease that turns by more than this at a vertex has a corner there.

    Raises
    ------
    InputError : a given edge or vertex is not on the boundary, or the setting is unknown.
    """
    crease = np.zeros(len(topology.edges), dtype=bool)
    given = np.zeros(0, dtype=np.int64)
    if isinstance(features, tuple):
        pairs, given = np.asarray(features[0], dtype=np.int64), np.asarray(features[1], dtype=np.int64)
        crease[_edge_numbers(topology, pairs.reshape(-1, 2))] = True
        bad = given[(given < 0) | (given >= topology.vertices)]
        bad = bad if len(bad) else given[topology.vertex_kind[given] == INTERIOR]
        if len(bad):
            raise InputError(f"corner vertex {bad[0]} is not on the boundary")
    elif features != "none":
        angle = _angle(features)
        edges, turn = boundary_angles(topology, points)
        crease[edges] = turn > angle
        single = features == "auto"
        if single:
            crease[edges] |= topology.edge_cells[edges] == 1
        _prune(topology, crease, keep=(topology.edge_cells == 1) & single)
    plain = topology.edge_kind.copy()
    plain[plain == CREASE] = SMOOTH
    vertex = topology.vertex_kind.copy()
    vertex[vertex < SMOOTH] = SMOOTH
    edge = np.where(crease, CREASE, plain).astype(np.int8)
    sharp = topology.edges[crease]
    count = np.bincount(sharp.ravel(), minlength=topology.vertices)
    vertex[count > 0] = CORNER
    two = count == 2
    vertex[two] = CREASE
    vertex[two & (_turns(points, sharp, topology.vertices) > kink)] = CORNER
    vertex[given] = CORNER
    return with_kinds(topology, vertex, edge, topology.face_kind)


def _angle(features: str | float) -> float:
    if features == "auto":
        return ANGLE
    try:
        angle = float(features)
    except ValueError:
        raise InputError(f"features are 'auto', 'none' or an angle in degrees, not {features!r}") from None
    if not 0.0 <= angle <= 180.0:
        raise InputError(f"the feature angle must lie between 0 and 180 degrees, not {angle:g}")
    return angle


def _prune(topology: Topology, crease: NDArray[np.bool_], keep: NDArray[np.bool_]) -> None:
    """Drop creases that end somewhere on a smooth surface, edge by edge from their loose ends, in place."""
    while True:
        count = np.bincount(topology.edges[crease].ravel(), minlength=topology.vertices)
        loose = crease & ~keep & (count[topology.edges] == 1).any(axis=1)
        if not loose.any():
            return
        crease[loose] = False


def _edge_numbers(topology: Topology, pairs: Index) -> Index:
    """Numbers of boundary edges given by their vertices."""
    ends = np.sort(pairs, axis=1)
    keys = topology.edges[:, 0] * topology.vertices + topology.edges[:, 1]
    wanted = ends[:, 0] * topology.vertices + ends[:, 1]
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    bad = np.flatnonzero((keys[at] != wanted) | (topology.edge_kind[at] == INTERIOR))
    if len(bad):
        a, b = pairs[bad[0]]
        raise InputError(f"crease: there is no boundary edge between vertices {a} and {b}")
    return at


def _turns(points: Array, sharp: Index, vertices: int) -> Array:
    """Degrees by which two crease edges turn at each vertex, (v,): from the length of the sum of their directions."""
    along = points[sharp[:, 1]] - points[sharp[:, 0]]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    total = np.zeros((vertices, 3))
    np.add.at(total, sharp[:, 0], along)
    np.add.at(total, sharp[:, 1], -along)
    # |a + b| = 2 sin(turn / 2) for unit directions a, b that leave the vertex.
    return np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(total, axis=1) / 2.0, 0.0, 1.0)))


