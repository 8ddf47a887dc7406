"""A solid on a T-mesh, and what acts where in it.

Axis letters: c leaf cell, n function, e element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.skin import Skin
from iga.distortion import own_shapes
from iga.domain import Domain
from iga.scaled_jacobian import least_of_elements

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

POOR = 0.3
"""Scaled Jacobian of badly shaped elements."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid on a T-mesh.

    Attributes
    ----------
    space : the functions.
    skin : its boundary.
    points : (n, 3) control points.
    invalid : (k, 2) block and number of elements that are not certified.
    """

    space: Hierarchy
    skin: Skin
    points: Array
    invalid: Index

    @property
    def domain(self) -> Domain:
        """The solid as a bare domain."""
        return Domain(self.space.space, self.points)

    @property
    def uncertified(self) -> Index:
        """Leaf cells of the invalid elements."""
        number = np.array([1 << 32, 1])
        return np.flatnonzero(np.isin(self.space.element @ number, self.invalid @ number))

    @property
    def inner(self) -> Mask:
        """(n,) functions that vanish on the boundary."""
        mask = np.ones(self.space.space.n, dtype=bool)
        mask[self.skin.functions] = False
        return mask


def moved(solid: Solid, functions: Mask) -> Mask:
    """(c,) leaf cells that some functions (n,) act on."""
    mask = np.zeros(solid.space.tmesh.cells, dtype=bool)
    for number, block in enumerate(solid.space.space.blocks):
        mine = solid.space.element[:, 0] == number
        mask[mine] = functions[block.dofs[solid.space.element[mine, 1]]].any(axis=1)
    return mask


def acting(solid: Solid, cells: Mask) -> Mask:
    """(n,) functions that act on some leaf cells (c,)."""
    mask = np.zeros(solid.space.space.n, dtype=bool)
    for number, block in enumerate(solid.space.space.blocks):
        mine = cells & (solid.space.element[:, 0] == number)
        mask[block.dofs[solid.space.element[mine, 1]]] = True
    return mask


def poor(solid: Solid) -> Mask:
    """(n,) functions that act on badly shaped elements."""
    first = np.cumsum([0, *(block.elements for block in solid.space.space.blocks)])
    block, element = solid.space.element.T
    return acting(solid, least_of_elements(solid.domain)[first[block] + element] < POOR)


def sizes_of(solid: Solid) -> Array:
    """(n,) edge length of the smallest element that each function acts on."""
    size = np.full(solid.space.space.n, np.inf)
    for block, shapes in zip(solid.space.space.blocks, own_shapes(solid.domain)):
        own = np.cbrt(np.abs(np.linalg.det(shapes)))
        np.minimum.at(size, block.dofs, own[:, None])
    return size
