"""The map of the meccano's boundary onto the surface (Pi_F of the paper): piecewise linear, one to one.

Axis letters: t triangle, f boundary side, q query point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.blocks import Blocks
from geometry.meccano.surface import Surface

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BoundaryMap:
    """A one-to-one map from the boundary sides of a meccano to a surface.

    Attributes
    ----------
    blocks : the meccano.
    surface : the surface; borders between patches run along its edges.
    side : (t,) the boundary side, a row of ``blocks.boundary_sides``, onto which each triangle is laid.
    parameters : (t, 3, 2) side coordinates s of the triangle's corners.
    """

    blocks: Blocks
    surface: Surface
    side: Index
    parameters: Array


def on_surface(mapping: BoundaryMap, side: Index, s: Array) -> tuple[Array, Index]:
    """Points (q, 3) of the surface at coordinates s (q, 2) of boundary sides (q,), and their triangles (q,)."""
    raise NotImplementedError
