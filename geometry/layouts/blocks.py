"""Meccanos: unit cubes (squares in the plane) glued side to side, the parametric domain of a solid.

A point of the meccano is a block and a point of [0, 1]^d in it. Sides are numbered as the faces of the reference cell,
and a point of a side has the coordinates s of the cell's face map, xi = origin + axes @ s (`iga.cells.Face`).

Axis letters: k block, v corner of a block, d dimension, f side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.simplices.relocation import ideal_gradients, relocate
from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, QUADRILATERAL, Cell
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Blocks:
    """A meccano.

    Attributes
    ----------
    corners : (k, 2^d) corner numbers of each block, in the order of the reference cell's vertices.
    places : (n, d) where the corners lie in a straight picture of the meccano, which sets the ideal shapes of elements.
    """

    corners: Index
    places: Array

    @property
    def dim(self) -> int:
        """Dimension d."""
        return int(self.places.shape[1])

    @property
    def cell(self) -> Cell:
        """Reference cell of the blocks."""
        return HEXAHEDRON if self.dim == 3 else QUADRILATERAL

    @cached_property
    def across(self) -> Index:
        """(k, f, 2) block and side on the other side of each side; -1, -1 on the boundary.

        Raises
        ------
        InputError : a side belongs to more than two blocks.
        """
        sides = np.stack([self.corners[:, face.vertices] for face in self.cell.faces], axis=1)
        count = sides.shape[1]
        keys = np.sort(sides, axis=2).reshape(-1, sides.shape[2])
        _, number, members = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        if members.max() > 2:
            where = int(np.flatnonzero(number == members.argmax())[0])
            raise InputError(f"side {where % count} of block {where // count} belongs to {members.max()} blocks")
        result = np.full((len(keys), 2), -1, dtype=np.int64)
        order = np.argsort(number, kind="stable")
        inner = order[members[number[order]] == 2].reshape(-1, 2)
        for here, there in ((0, 1), (1, 0)):
            result[inner[:, here]] = np.stack(np.divmod(inner[:, there], count), axis=1)
        return result.reshape(len(self.corners), count, 2)

    @cached_property
    def boundary_sides(self) -> Index:
        """(f, 2) block and side of each side on the boundary, ascending."""
        return np.argwhere(self.across[:, :, 0] < 0)


def place(blocks: Blocks, block: Index, xi: Array) -> Array:
    """Points (q, d) of the straight picture at points xi (q, d) of blocks (q,)."""
    values = bernstein(blocks.cell, 1).tabulate(xi, 0)[0]
    return np.einsum("qv,qvd->qd", values, blocks.places[blocks.corners[block]])


def cube(dim: int = 3) -> Blocks:
    """The paper's meccano of genus 0: one block."""
    cell = HEXAHEDRON if dim == 3 else QUADRILATERAL
    return Blocks(np.arange(2**dim, dtype=np.int64)[None], cell.vertices.copy())


def polycube(voxels: Index) -> Blocks:
    """The meccano of unit voxels (squares) at integer positions (k, d), glued where they touch.

    Raises
    ------
    InputError : voxels are repeated, fall apart, or touch along an edge or at a vertex only, so that the boundary is
        no manifold.
    """
    voxels = np.asarray(voxels, dtype=np.int64)
    if voxels.ndim != 2 or voxels.shape[1] not in (2, 3) or not len(voxels):
        raise InputError(f"voxels must be a table (k, 3) or (k, 2) with k > 0, not {voxels.shape}")
    if len(np.unique(voxels, axis=0)) < len(voxels):
        raise InputError("a voxel is given twice")
    unit = cube(voxels.shape[1]).cell.vertices.astype(np.int64)
    places, corners = np.unique(
        (voxels[:, None] + unit).reshape(-1, voxels.shape[1]), axis=0, return_inverse=True
    )
    blocks = Blocks(corners.reshape(len(voxels), -1), places.astype(float))
    _check_manifold(blocks)
    return blocks


def _check_manifold(blocks: Blocks) -> None:
    """Refuse blocks whose boundary is no manifold, or that do not hang together."""
    across = blocks.across[..., 0]
    here = np.nonzero(across >= 0)
    links = coo_array((np.ones(len(here[0])), (here[0], across[here])), shape=(len(across),) * 2)
    if (parts := connected_components(links, directed=False)[0]) > 1:
        raise InputError(f"the blocks of the meccano fall into {parts} parts that share no side; give each its own")
    sides = boundary_corners(blocks)
    count, size = sides.shape
    cell = blocks.cell.faces[0].cell
    if blocks.dim == 3:
        ends = sides[:, cell.edges]
        _, number, members = np.unique(
            np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
        )
        if members.max() > 2:
            where = blocks.places[ends.reshape(-1, 2)[np.flatnonzero(members[number] > 2)[0]]]
            raise InputError(
                f"blocks touch along the edge from {where[0].tolist()} to {where[1].tolist()} only; "
                "fill a block beside it or take one away"
            )
        order = np.argsort(number, kind="stable").reshape(-1, 2)
        side, edge = np.divmod(order, len(cell.edges))
        slot = size * side[..., None] + cell.edges[edge]  # (pairs, 2 sides, 2 ends)
        same = sides.reshape(-1)[slot[:, 0, 0]] == sides.reshape(-1)[slot[:, 1, 0]]
        slot[~same, 1] = slot[~same, 1][:, ::-1]
        rows, columns = slot[:, 0].ravel(), slot[:, 1].ravel()
        fans = connected_components(
            coo_array((np.ones(len(rows)), (rows, columns)), shape=(count * size,) * 2), directed=False
        )[1]
        vertex = np.full(fans.max() + 1, -1)
        vertex[fans] = sides.reshape(-1)
        number, members = np.unique(vertex, return_counts=True)
        broken = number[members > 1]
    else:
        number, members = np.unique(sides, return_counts=True)
        broken = number[members != 2]
    if len(broken):
        raise InputError(
            f"blocks touch only at the vertex {blocks.places[broken[0]].tolist()}; "
            "fill a block beside it or take one away"
        )


def boundary_corners(blocks: Blocks) -> Index:
    """(f, 2^(d-1)) corner numbers of the boundary sides, in the order of the side cell's vertices."""
    vertices = np.array([face.vertices for face in blocks.cell.faces])
    block, side = blocks.boundary_sides.T
    return blocks.corners[block[:, None], vertices[side]]


def pillowed(blocks: Blocks, share: float = 0.3) -> Blocks:
    """The meccano with one new block under each boundary side, so that no block has two sides on the boundary.

    The old blocks come first and keep their axes. New blocks follow in the order of ``blocks.boundary_sides``; their
    boundary sides keep that order and the coordinates s. The axis that runs outwards is the last one (the first one, in
    the plane), so that the new blocks are positive. In the picture, boundary corners get a copy inside, ``share`` of a
    side's length below each side at the corner; the picture of several blocks is then straightened.

    Raises
    ------
    InputError : share is not in (0, 1/2), or no picture without folds is found.
    """
    if not 0.0 < share < 0.5:
        raise InputError(f"share must lie between 0 and 1/2, not {share}")
    sides = boundary_corners(blocks)
    moved = np.unique(sides)
    copy = np.arange(len(blocks.places))
    copy[moved] = len(blocks.places) + np.arange(len(moved))
    inner, outer = copy[sides], sides
    if blocks.dim == 3:
        new = np.stack([inner, outer], axis=2).reshape(len(sides), 8)
    else:
        new = np.concatenate([inner, outer], axis=1)
    places = np.concatenate([blocks.places, blocks.places[moved] + share * _inwards(blocks, sides)[moved]])
    made = Blocks(np.concatenate([copy[blocks.corners], new]), places)
    return made if len(blocks.corners) == 1 else straightened(made)


def straightened(blocks: Blocks, sweeps: int = 200) -> Blocks:
    """The meccano in a picture where the corners of its blocks are as near to those of cubes as they go.

    All places move, those on the boundary as well, to minimise the shapes of the 2^d corner simplices of each block.

    Raises
    ------
    InputError : a corner remains folded.
    """
    vertex = np.arange(2**blocks.dim)
    local = np.column_stack([vertex, vertex[:, None] ^ (1 << np.arange(blocks.dim))])
    ideals = np.tile(blocks.cell.vertices[local], (len(blocks.corners), 1, 1))
    simplices = blocks.corners[:, local].reshape(-1, blocks.dim + 1)
    free = np.ones(len(blocks.places), dtype=bool)
    made = relocate(simplices, ideal_gradients(ideals), blocks.places, free, sweeps, tolerance=1e-3)
    if made.quality.inverted:
        raise InputError(f"{made.quality.inverted} corners of the meccano's blocks stay folded; use smaller voxels")
    return Blocks(blocks.corners, made.nodes)


def _inwards(blocks: Blocks, sides: Index) -> Array:
    """(n, d) the smallest vector from each corner that goes one side's length below every boundary side at it.

    Least squares where no vector does: sides that look at each other round a corner.
    """
    points = blocks.places[sides]
    if blocks.dim == 3:
        normal = np.cross(points[:, 3] - points[:, 0], points[:, 1] - points[:, 2])
        length = np.sqrt(np.linalg.norm(normal, axis=1) / 2.0)
    else:
        along = points[:, 1] - points[:, 0]
        normal = np.column_stack([along[:, 1], -along[:, 0]])
        length = np.linalg.norm(along, axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    squares = np.zeros((len(blocks.places), blocks.dim, blocks.dim))
    right = np.zeros((len(blocks.places), blocks.dim))
    for v in range(sides.shape[1]):
        np.add.at(squares, sides[:, v], normal[:, :, None] * normal[:, None])
        np.add.at(right, sides[:, v], -length[:, None] * normal)
    return np.einsum("nde,ne->nd", np.linalg.pinv(squares, rcond=1e-9, hermitian=True), right)
