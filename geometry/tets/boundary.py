r"""Smooth parts of the boundary of a Bezier tet mesh, found by the angle between neighbouring facets.

Normals are those of the curved facets at the middle of each shared edge, so a well curved sphere is one smooth part
however coarse it is. Where an edge belongs to more than two facets (the boundary is no manifold there) parts end.

Axis letters: f facet, k edge of the facet, t function of the facet, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.tets.mesh import FACES, TetMesh
from iga.bernstein import bernstein, face_functions
from iga.cells import TETRAHEDRON, TRIANGLE
from iga.conforming import entity_keys
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def split_by_angle(mesh: TetMesh, angle: float) -> dict[str, Index]:
    """Split each named boundary into parts that meet at more than ``angle`` degrees.

    Returns
    -------
    ``name_0``, ``name_1``, ... in the order of their first facet, each (f, 2) of tetrahedron and face.

    Raises
    ------
    InputError : the angle is not between 0 and 180.
    """
    if not 0 < angle < 180:
        raise InputError(f"angle {angle:g} must lie between 0 and 180 degrees")
    facets = np.concatenate(list(mesh.boundaries.values()))
    group = np.repeat(np.arange(len(mesh.boundaries)), [len(f) for f in mesh.boundaries.values()])
    normals = _edge_normals(mesh, facets)
    corners = mesh.vertices[facets[:, 0, None], FACES[facets[:, 1]]]
    ends = corners[:, TRIANGLE.edges].reshape(-1, 2)
    key = entity_keys(ends, int(mesh.vertices.max()) + 1)
    rank = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.concatenate([[True], key[rank][1:] != key[rank][:-1]]))
    count = np.diff(np.concatenate([start, [len(rank)]]))
    one, two = rank[start[count == 2]], rank[start[count == 2] + 1]
    flat = normals.reshape(-1, 3)
    smooth = (flat[one] * flat[two]).sum(axis=1) >= np.cos(np.radians(angle))
    smooth &= group[one // 3] == group[two // 3]
    a, b = one[smooth] // 3, two[smooth] // 3
    link = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(len(facets), len(facets)))
    label = connected_components(link, directed=False)[1]
    result = {}
    for g, name in enumerate(mesh.boundaries):
        own = np.flatnonzero(group == g)
        first, part = np.unique(label[own], return_index=True, return_inverse=True)[1:]
        place = np.argsort(np.argsort(first))[part]
        for k in range(len(first)):
            result[f"{name}_{k}"] = facets[own[place == k]]
    return result


def _edge_normals(mesh: TetMesh, facets: Index) -> Array:
    """Outward unit normals (f, 3, 3) at the middle of the facets' edges."""
    basis = bernstein(TETRAHEDRON, mesh.degree)
    middles = TRIANGLE.vertices[TRIANGLE.edges].mean(axis=1)
    normals = np.empty((len(facets), 3, 3))
    for face in range(4):
        trace, functions = face_functions(basis, face)
        rows = np.flatnonzero(facets[:, 1] == face)
        coefficients = mesh.coefficients[facets[rows, 0][:, None], functions]
        slopes = np.einsum("ktd,ftc->fkdc", trace.tabulate(middles, 1)[1], coefficients)
        normal = np.cross(slopes[:, :, 0], slopes[:, :, 1])
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        normals[rows] = normal / np.where(length > 0, length, 1.0)
    return normals
