r"""Pillowing: one new layer of cells under the whole boundary.

A cell with two boundary faces across a smooth edge has a vanishing Jacobian there, because the limit surface has one
tangent plane for both. After pillowing every cell has one boundary face at most. The boundary vertices stay where they
are; their copies underneath move towards the mean centroid c of the cells around them,

    x' = x + DEPTH (c - x).

Axis letters: e cell, v vertex.
"""

from __future__ import annotations

import numpy as np

from geometry.catmull_clark.features import outward_quads
from geometry.catmull_clark.mesh import HexMesh
from geometry.catmull_clark.topology import build_topology, incidence

DEPTH = 0.4
"""Thickness of the new layer, as a share of the distance to the centroids of the cells around."""


def pillow(mesh: HexMesh) -> HexMesh:
    """Mesh with one more layer of cells; its boundary vertices come last, in the order they had."""
    t = mesh.topology
    quads = outward_quads(t)[1]
    outer = np.unique(quads)
    copy = np.full(t.vertices, -1, dtype=np.int64)
    copy[outer] = t.vertices + np.arange(len(outer))
    layer = np.stack([quads, copy[quads]], axis=2).reshape(-1, 8)
    hexes = np.concatenate([t.hexes, layer])
    centroids = incidence(t.hexes, t.vertices) / 8.0
    means = t.cells_of_vertex[outer] @ centroids

    def extend(values: np.ndarray) -> np.ndarray:
        inner = values.copy()
        target = (means @ values.reshape(len(values), -1)) / t.vertex_cells[outer][:, None]
        inner[outer] += DEPTH * (target.reshape(values[outer].shape) - values[outer])
        return np.concatenate([inner, values[outer]])

    attributes = {key: extend(values) for key, values in mesh.attributes.items()}
    topology = build_topology(hexes, t.vertices + len(outer))
    return HexMesh(extend(mesh.points), topology, attributes, mesh.mirrored)
