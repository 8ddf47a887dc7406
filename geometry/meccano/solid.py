"""A solid on a T-mesh, and what acts where in it.

Axis letters: c leaf cell, n function, m boundary function, e element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.meccano.collocation import prolongation
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.skin import Skin, skin_of
from geometry.meccano.tmesh import DEPTH, refined
from iga.distortion import own_shapes
from iga.domain import Domain, Space
from iga.scaled_jacobian import least_of_elements
from iga.tether import Tether

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
    invalid : (k,) leaf cells that are not certified.
    """

    space: Hierarchy
    skin: Skin
    points: Array
    invalid: Index

    @property
    def domain(self) -> Domain:
        """The solid as a bare domain: leaf cells, with plain splines that are tied to the functions."""
        X = self.space.expansion
        return Domain(Space((self.space.cells,), X.shape[0], constraint=X), X @ self.points)

    @property
    def inner(self) -> Mask:
        """(n,) functions that vanish on the boundary."""
        mask = np.ones(self.space.n, dtype=bool)
        mask[self.skin.functions] = False
        return mask


def moved(solid: Solid, functions: Mask) -> Mask:
    """(c,) leaf cells that some functions (n,) act on."""
    splines = abs(solid.space.expansion) @ functions.astype(float) > 0.0
    return np.asarray(splines[solid.space.cells.dofs].any(axis=1))


def acting(solid: Solid, cells: Mask) -> Mask:
    """(n,) functions that act on some leaf cells (c,)."""
    splines = np.zeros(solid.space.expansion.shape[0])
    splines[solid.space.cells.dofs[cells]] = 1.0
    return np.asarray(abs(solid.space.expansion).T @ splines > 0.0)


def poor(solid: Solid) -> Mask:
    """(n,) functions that act on badly shaped elements."""
    return acting(solid, least_of_elements(solid.domain) < POOR)


def sizes_of(solid: Solid) -> Array:
    """(n,) edge length of the smallest element that each function acts on."""
    X = solid.space.expansion
    size = np.full(X.shape[0], np.inf)
    shapes = own_shapes(solid.domain)[0]
    np.minimum.at(size, solid.space.cells.dofs, np.cbrt(np.abs(np.linalg.det(shapes)))[:, None])
    least = np.full(solid.space.n, np.inf)
    np.minimum.at(least, X.indices, np.repeat(size, np.diff(X.indptr)))
    return least


def split(solid: Solid, marks: Index, most: int) -> Solid | None:
    """The same solid with marked leaf cells (k,) split, as many as ``most`` cells allow; None if that allows none."""
    marks = marks[solid.space.tmesh.level[marks] < DEPTH]
    while len(marks):
        # A cell split without its neighbours adds no function.
        tmesh = refined(solid.space.tmesh, marks, reach=1)
        if tmesh.cells <= most:
            space = hierarchy(tmesh, solid.space.degree)
            return Solid(space, skin_of(space), prolongation(solid.space, space) @ solid.points, solid.invalid[:0])
        marks = marks[: (2 * len(marks)) // 3]
    return None


def held(skin: Skin, places: Array, weights: Array) -> Tether:
    """Springs of weights (m,) that hold the boundary functions' control points at places (m, 3)."""
    rows = len(skin.functions)
    pick = csr_array((np.ones(rows), (np.arange(rows), skin.functions)), shape=(rows, skin.space.n))
    return Tether(pick, places, np.zeros((rows, 3)), weights, 1.0)
