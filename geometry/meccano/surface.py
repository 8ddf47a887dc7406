"""Surface triangulations: the input of the meccano."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed, oriented triangulation.

    Attributes
    ----------
    points : (v, 3) vertices.
    triangles : (t, 3) vertex numbers, outward by the right-hand rule.
    """

    points: Array
    triangles: Index
