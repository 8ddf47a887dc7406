"""Skins: the watertight boundary of a solid as quadrilaterals and triangles of splines, ready to be filled.

Axis letters: e element, v its vertex, k vertex of the skin, n function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Skin:
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
    """

    space: Space
    points: Array
    corners: tuple[Index, ...]
    vertices: Array
    face: tuple[Index, ...]
    names: tuple[str, ...]
