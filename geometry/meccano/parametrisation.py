"""The volumetric parametrisation (Pi of the paper): a tetrahedral mesh of the meccano and its image in the solid.

Nodes have dyadic coordinates in their blocks, stored as integers over 2^LEVELS.

Axis letters: m tetrahedron, v its vertex, n node, d dimension, q query point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.blocks import Blocks

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEVELS = 20


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """A piecewise linear map of a meccano onto a solid (of a polygon, in the plane).

    Attributes
    ----------
    blocks : the meccano.
    tets : (m, d + 1) node numbers.
    block : (m,) block of each tetrahedron.
    places : (m, d + 1, d) integer coordinates of its vertices in that block, over 2^LEVELS.
    nodes : (n, d) positions in the solid.
    """

    blocks: Blocks
    tets: Index
    block: Index
    places: Index
    nodes: Array


def image(mapping: Parametrisation, block: Index, xi: Array) -> Array:
    """Points (q, d) of the solid at points xi (q, d) of blocks (q,)."""
    raise NotImplementedError


def locate(mapping: Parametrisation, x: Array) -> tuple[Index, Array]:
    """Block (q,) and xi (q, d) of points x (q, d) of the solid; block -1 outside."""
    raise NotImplementedError
