r"""The hexahedral complex of Theorem 3: four hexahedra for each tetrahedron, glued by topology.

Its vertices are those of the tetrahedra, the midpoints of edges and the centroids of faces and bodies, each numbered
once for its edge or face. Two tetrahedra on a face therefore name the same hexahedral faces; nothing is compared by
position and nothing is averaged.

Axis letters: e tetrahedron, m sub-hexahedron (the vertex it keeps), f facet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.tet_to_hex import AXES
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.conforming import entity_keys

Index = NDArray[np.int64]

#: Vertices (4, 3) of the faces of a tetrahedron; face i lies opposite to vertex i.
FACES: Index = np.array([face.vertices for face in TETRAHEDRON.faces], dtype=np.int64)
#: Face of the degenerate hexahedron (Theorem 1) that each face of the tetrahedron becomes: t=1, r=0, s=0, t=0.
DEGENERATE_FACES: Index = np.array([5, 0, 2, 4], dtype=np.int64)


def hex_vertices(vertices: Index) -> Index:
    """Vertex numbers (4 e, 8) of the hexahedra of tetrahedra (e, 4); hexahedron 4 e + m keeps vertex m."""
    e = len(vertices)
    total = int(vertices.max()) + 1
    edge_ends = TETRAHEDRON.edges
    edge_keys, edge = np.unique(entity_keys(vertices[:, edge_ends].reshape(-1, 2), total), return_inverse=True)
    face_keys, face = np.unique(entity_keys(vertices[:, FACES].reshape(-1, 3), total), return_inverse=True)
    table = np.concatenate(
        [
            vertices,
            total + edge.reshape(e, 6),
            total + len(edge_keys) + face.reshape(e, 4),
            total + len(edge_keys) + len(face_keys) + np.arange(e)[:, None],
        ],
        axis=1,
    )
    return table[:, _corner_places()].reshape(-1, 8)


def _corner_places() -> Index:
    """For hexahedron m and corner (4, 8): the place among 4 vertices, 6 edges, 4 faces, 1 body."""
    sets = [{v} for v in range(4)] + [set(e) for e in TETRAHEDRON.edges.tolist()]
    sets += [set(f) for f in FACES.tolist()] + [{0, 1, 2, 3}]
    corners = HEXAHEDRON.vertices.astype(int).tolist()
    return np.array(
        [[sets.index({m} | {v for v, on in zip(AXES[m], corner) if on}) for corner in corners] for m in range(4)],
        dtype=np.int64,
    )


def hex_facets(facets: Index) -> Index:
    """Hexahedral facets (3 f, 2) of tetrahedral facets (f, 2), both as (element, face)."""
    table = np.array([[(m, 2 * AXES[m].index(i)) for m in range(4) if m != i] for i in range(4)], dtype=np.int64)
    made = table[facets[:, 1]]
    return np.stack([4 * facets[:, :1] + made[..., 0], made[..., 1]], axis=-1).reshape(-1, 2)
