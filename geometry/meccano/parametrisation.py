"""The volumetric parametrisation (Pi of the paper): a tetrahedral mesh of the meccano and its image in the solid.

Nodes have dyadic coordinates in their blocks, stored as integers over 2^LEVELS. Points keep their barycentric
coordinates. Simplices are looked up in a tree of boxes: those in the meccano (block k with 2 k added to the first
coordinate, so that one tree holds all blocks), or their images.

Axis letters: m simplex, v its vertex, n node, d dimension, q query point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.meccano.kernels_location import LEAF, find, tree_boxes
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEVELS = 20
SLACK = 1e-9  # barycentric coordinates below this are outside


@dataclass(frozen=True, eq=False)
class SimplexTree:
    """Simplices in a binary tree of boxes; make it with `simplex_tree`.

    Attributes
    ----------
    corners : (m, d + 1, d) vertices.
    order : (m,) simplices along the leaves, LEAF to each.
    boxes : (2 leaves, 2, d) lowest and highest coordinates; node i has the children 2 i and 2 i + 1, the root is 1.
    """

    corners: Array
    order: Index
    boxes: Array


def simplex_tree(corners: Array) -> SimplexTree:
    """Tree of simplices with vertices (m, d + 1, d)."""
    corners = np.ascontiguousarray(corners, dtype=float)
    centre = corners.mean(axis=1)
    low = centre.min(axis=0)
    extent = max(float((centre - low).max()), 1e-300)
    cells = ((centre - low) * (((1 << 20) - 1) / extent)).astype(np.uint64)
    order = np.argsort(_interleaved(cells), kind="stable")
    leaves = 1 << max(int(np.ceil(np.log2(max(len(order), 1) / LEAF))), 0)
    return SimplexTree(corners, order, tree_boxes(corners, order, leaves))


def _interleaved(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Morton codes (m,) of integer coordinates (m, d) below 2^20."""
    code = np.zeros(len(cells), dtype=np.uint64)
    d = cells.shape[1]
    for bit in range(20):
        for axis in range(d):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(d * bit + axis)
    return code


def containing(tree: SimplexTree, points: Array) -> tuple[Index, Array]:
    """Simplex (q,) that holds each point (q, d), -1 if there is none, and barycentric coordinates (q, d + 1)."""
    return find(tree.corners, tree.order, tree.boxes, np.ascontiguousarray(points, dtype=float), SLACK)


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """A piecewise linear map of a meccano onto a solid (of a polygon, in the plane).

    Attributes
    ----------
    blocks : the meccano.
    tets : (m, d + 1) node numbers.
    block : (m,) block of each simplex.
    places : (m, d + 1, d) integer coordinates of its vertices in that block, over 2^LEVELS.
    nodes : (n, d) positions in the solid.
    """

    blocks: Blocks
    tets: Index
    block: Index
    places: Index
    nodes: Array

    @cached_property
    def in_meccano(self) -> SimplexTree:
        """Simplices in the meccano."""
        corners = self.places / float(1 << LEVELS)
        corners[..., 0] += 2.0 * self.block[:, None]
        return simplex_tree(corners)

    @cached_property
    def in_solid(self) -> SimplexTree:
        """Images of the simplices."""
        return simplex_tree(self.nodes[self.tets])


def image(mapping: Parametrisation, block: Index, xi: Array) -> Array:
    """Points (q, d) of the solid at points xi (q, d) of blocks (q,).

    Raises
    ------
    InputError : a point lies outside its block.
    """
    points = np.array(xi, dtype=float)
    points[:, 0] += 2.0 * np.asarray(block)
    found, weights = containing(mapping.in_meccano, points)
    if (lost := np.flatnonzero(found < 0)).size:
        q = int(lost[0])
        raise InputError(f"point {q}, {np.asarray(xi)[q].tolist()}, is not in block {np.asarray(block)[q]}")
    return np.asarray(np.einsum("qv,qvd->qd", weights, mapping.nodes[mapping.tets[found]]))


def locate(mapping: Parametrisation, x: Array) -> tuple[Index, Array]:
    """Block (q,) and xi (q, d) of points x (q, d) of the solid; block -1 and xi NaN outside."""
    found, weights = containing(mapping.in_solid, x)
    xi = np.einsum("qv,qvd->qd", weights, mapping.places[found] / float(1 << LEVELS))
    outside = found < 0
    xi[outside] = np.nan
    return np.where(outside, -1, mapping.block[found]), xi
