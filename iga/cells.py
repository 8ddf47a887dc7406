"""Reference cells: vertices, edges, faces and how faces lie in their cell.

All numbering and orientation of the project lives here. Reference coordinates are in [0, 1]. Vertex v of a cell is
local function v of its Bernstein basis of degree one, which fixes the order of vertices. A face carries the affine map
``xi = origin + axes @ s`` from its own reference cell, chosen so that ``axes[:, 0] x axes[:, 1]`` points out of the
cell; ``Face.vertices`` lists the cell's vertices in the order of the face cell's vertices.

Axis letters: v vertex, d reference dimension, s reference coordinate on a face.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Face:
    """A face of a cell (an edge, of a two-dimensional cell).

    Attributes
    ----------
    cell : reference cell of the face itself.
    vertices : the owner's vertex numbers, in the order of ``cell``'s vertices.
    origin, axes : (d,) and (d, d-1), the map ``xi = origin + axes @ s``.
    """

    cell: Cell
    vertices: tuple[int, ...]
    origin: Array
    axes: Array


@dataclass(frozen=True, eq=False)
class Cell:
    """A reference cell.

    Attributes
    ----------
    name, dim : the name in messages and files, and the dimension d.
    vertices : (v, d) coordinates.
    edges : (k, 2) pairs of vertex numbers.
    faces : faces (edges, if d = 2) with outward orientation.
    volume : measure of the reference cell.
    vtk : for each vertex in VTK's order, the vertex number here.
    """

    name: str
    dim: int
    vertices: Array
    edges: NDArray[np.int64]
    faces: tuple[Face, ...]
    volume: float
    vtk: tuple[int, ...]

    def __repr__(self) -> str:
        """Name only; the rest is constant."""
        return self.name.upper()

    @cached_property
    def centre(self) -> Array:
        """Mean of the vertices, (d,)."""
        return self.vertices.mean(axis=0)


def _face(owner: list[tuple[int, ...]], cell: Cell, *vertices: int) -> Face:
    """Face through the named vertices of the owner; the first and the ends of its axes fix the map."""
    corners = np.array([owner[v] for v in vertices], dtype=float)
    units = [int(np.flatnonzero((cell.vertices == unit).all(axis=1))[0]) for unit in np.eye(cell.dim)]
    axes = np.stack([corners[u] - corners[0] for u in units], axis=1) if cell.dim else np.zeros((len(owner[0]), 0))
    return Face(cell, vertices, corners[0], axes)


def _cell(
    name: str,
    vertices: list[tuple[int, ...]],
    edges: list[tuple[int, int]],
    faces: list[tuple[Cell, tuple[int, ...]]],
    volume: float,
    vtk: tuple[int, ...],
) -> Cell:
    made = tuple(_face(vertices, cell, *numbers) for cell, numbers in faces)
    return Cell(
        name, len(vertices[0]), np.array(vertices, dtype=float), np.array(edges, dtype=np.int64).reshape(-1, 2), made,
        volume, vtk,
    )


POINT = Cell("point", 0, np.zeros((1, 0)), np.zeros((0, 2), dtype=np.int64), (), 1.0, (0,))

#   0 ------- 1
LINE = _cell("line", [(0,), (1,)], [(0, 1)], [(POINT, (0,)), (POINT, (1,))], 1.0, (0, 1))

#   y
#   2
#   | \
#   0 - 1  x
TRIANGLE = _cell(
    "triangle",
    [(0, 0), (1, 0), (0, 1)],
    [(0, 1), (1, 2), (0, 2)],
    [(LINE, (0, 1)), (LINE, (1, 2)), (LINE, (2, 0))],
    0.5,
    (0, 1, 2),
)

#   y
#   1 --- 3
#   |     |
#   0 --- 2  x
QUADRILATERAL = _cell(
    "quadrilateral",
    [(0, 0), (0, 1), (1, 0), (1, 1)],
    [(0, 1), (0, 2), (1, 3), (2, 3)],
    [(LINE, (0, 2)), (LINE, (2, 3)), (LINE, (3, 1)), (LINE, (1, 0))],
    1.0,
    (0, 2, 3, 1),
)

#   z
#   3
#   | \  2 y
#   | / \
#   0 --- 1  x
TETRAHEDRON = _cell(
    "tetrahedron",
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)],
    [(TRIANGLE, (1, 2, 3)), (TRIANGLE, (0, 3, 2)), (TRIANGLE, (0, 1, 3)), (TRIANGLE, (0, 2, 1))],
    1.0 / 6.0,
    (0, 1, 2, 3),
)

#   z
#       1 ------- 5          faces: 0 x=0, 1 x=1, 2 y=0, 3 y=1, 4 z=0, 5 z=1
#     / |       / |
#   3 ------- 7   |          (0 at the back; x to the right, y to the front, z up)
#   |   0 ----|-- 4  x
#   | /       | /
#   2 ------- 6
#  y
HEXAHEDRON = _cell(
    "hexahedron",
    [(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1), (1, 0, 0), (1, 0, 1), (1, 1, 0), (1, 1, 1)],
    [(0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7)],
    [
        (QUADRILATERAL, (0, 2, 1, 3)),
        (QUADRILATERAL, (4, 5, 6, 7)),
        (QUADRILATERAL, (0, 1, 4, 5)),
        (QUADRILATERAL, (2, 6, 3, 7)),
        (QUADRILATERAL, (0, 4, 2, 6)),
        (QUADRILATERAL, (1, 3, 5, 7)),
    ],
    1.0,
    (0, 4, 6, 2, 1, 5, 7, 3),
)

#   z
#   1 ------- 3              faces: 0 z=0, 1 z=1 (triangles), 2 y=0, 3 x+y=1, 4 x=0 (quadrilaterals)
#   | \5/     |
#   0 -|----- 2  x           triangle (x, y) times line z
#     \4/
#      y
WEDGE = _cell(
    "wedge",
    [(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1), (0, 1, 0), (0, 1, 1)],
    [(0, 1), (2, 3), (4, 5), (0, 2), (2, 4), (0, 4), (1, 3), (3, 5), (1, 5)],
    [
        (TRIANGLE, (0, 4, 2)),
        (TRIANGLE, (1, 3, 5)),
        (QUADRILATERAL, (0, 1, 2, 3)),
        (QUADRILATERAL, (2, 3, 4, 5)),
        (QUADRILATERAL, (0, 4, 1, 5)),
    ],
    0.5,
    (0, 2, 4, 1, 3, 5),
)

#   4 apex over vertex 0     faces: 0 base z=0; triangles 1 y=0, 2 x=0, 3 x+z=1, 4 y+z=1
#   | \
#   1 --\- 3                 base (0,0,0) (0,1,0) (1,0,0) (1,1,0)
#   |     |
#   0 --- 2  x
PYRAMID = _cell(
    "pyramid",
    [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 0, 1)],
    [(0, 1), (0, 2), (1, 3), (2, 3), (0, 4), (1, 4), (2, 4), (3, 4)],
    [
        (QUADRILATERAL, (0, 2, 1, 3)),
        (TRIANGLE, (0, 2, 4)),
        (TRIANGLE, (0, 4, 1)),
        (TRIANGLE, (2, 3, 4)),
        (TRIANGLE, (1, 4, 3)),
    ],
    1.0 / 3.0,
    (0, 2, 3, 1, 4),
)

CELLS: dict[str, Cell] = {
    cell.name: cell for cell in (LINE, TRIANGLE, QUADRILATERAL, TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID)
}
