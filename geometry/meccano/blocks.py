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


def pillowed(blocks: Blocks, share: float = 0.35) -> Blocks:
    """The meccano with one new block under each boundary side, so that no block has two sides on the boundary.

    The old blocks shrink by ``share`` about the mean of the corners' neighbours; a new block's last axis runs outwards:
    its boundary side is the one of the old block, with the same coordinates s.
    """
    raise NotImplementedError
