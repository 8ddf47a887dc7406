"""Shells: what the volume needs of a skin, with the vertices of its elements numbered.

Axis letters: e element, v its vertex, k vertex of the shell, n function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geometry.hybrid.skin import Skin
from iga.bernstein import functions_at
from iga.block import bezier_coefficients
from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAME = 1e-9
"""Distance, relative to the diagonal, below which corners of elements are one vertex."""


@dataclass(frozen=True, eq=False)
class Shell:
    """A closed surface; elements meet edge to edge, and share the functions that act on a common edge.

    Attributes
    ----------
    space : functions on blocks of quadrilaterals, degree (d, d), and triangles, degree (d,), in the plane of [0, 1]^2;
        the third coordinate of cells points outwards by the right-hand rule.
    points : (n, 3) control points.
    corners : for each block (e, v) vertex numbers, in the order of the reference cell's vertices; elements that share
        an edge share its two vertices.
    vertices : (k, 3) positions of the vertices, on the surface.
    face : for each block (e,) number of the CAD face that each element lies on.
    names : name of each CAD face.
    adjust : (k, n) rows that are small where the surface inside a face goes on smoothly to its trimming curves
        (`sealing.Sealed`), or None.
    """

    space: Space
    points: Array
    corners: tuple[Index, ...]
    vertices: Array
    face: tuple[Index, ...]
    names: tuple[str, ...]
    adjust: csr_array | None = None


def shell_of(skin: Skin) -> Shell:
    """Shell of a skin.

    Vertices are functions where an element's extraction is the identity; corners of other elements are recognised by
    their position.
    """
    blocks = skin.space.blocks
    at = [functions_at(block.basis, block.basis.cell.vertices) for block in blocks]
    spots = [bezier_coefficients(block, skin.points)[:, own] for block, own in zip(blocks, at)]
    if all(block.extraction is None for block in blocks):
        numbers = [block.dofs[:, own] for block, own in zip(blocks, at)]
    else:
        flat = np.concatenate([s.reshape(-1, 3) for s in spots])
        reach = SAME * float(np.linalg.norm(np.ptp(flat, axis=0)))
        pairs = cKDTree(flat).query_pairs(reach, output_type="ndarray")
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(flat), len(flat)))
        label = connected_components(graph, directed=False)[1].astype(np.int64)
        cuts = np.cumsum([s.shape[0] * s.shape[1] for s in spots])[:-1]
        numbers = [own.reshape(s.shape[:2]) for own, s in zip(np.split(label, cuts), spots)]
    used = np.unique(np.concatenate([own.ravel() for own in numbers]))
    corners = tuple(np.searchsorted(used, own) for own in numbers)
    vertices = np.zeros((len(used), 3))
    for own, s in zip(corners, spots):
        vertices[own] = s
    adjust = None if skin.sealed is None else skin.sealed.adjust
    return Shell(skin.space, skin.points, corners, vertices, skin.faces, skin.names, adjust)
