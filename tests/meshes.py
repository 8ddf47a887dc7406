"""Small meshes made for the tests: every cell, several sizes, and one mesh that mixes them."""

from __future__ import annotations

import numpy as np

from iga.bernstein import Bernstein
from iga.block import Block
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conforming import Complex
from iga.domain import Domain, Space


def box_complex(cell: Cell, n: int) -> tuple[Complex, np.ndarray]:
    """Unit cube in n^3 boxes, each cut into one kind of cell: 1 hexahedron, 2 wedges, 3 pyramids or 6 tetrahedra."""
    grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = grid / n
    lower = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    steps = HEXAHEDRON.vertices.astype(int)
    numbers = (lower + steps) @ np.array([(n + 1) ** 2, n + 1, 1])
    if cell is HEXAHEDRON:
        return Complex(((cell, numbers),)), points
    if cell is WEDGE:
        pieces = [[0, 1, 4, 5, 2, 3], [6, 7, 2, 3, 4, 5]]
    elif cell is PYRAMID:
        # Six pyramids over the faces of each box, with its centre as the apex.
        centre = len(points) + np.arange(len(numbers))
        points = np.vstack([points, points[numbers].mean(axis=1)])
        local = []
        for face in HEXAHEDRON.faces:
            base = np.array(face.vertices)
            order = np.empty(4, dtype=int)
            order[[0, 2, 1, 3]] = base  # the base of a pyramid looks outward along vertices 0, 2, 1, 3
            local.append(np.column_stack([numbers[:, order], centre]))
        return Complex(((cell, np.concatenate(local)),)), points
    else:
        # Kuhn: one tetrahedron for each path from corner 000 to corner 111, turned to positive orientation.
        paths = [(0, 4, 6, 7), (0, 4, 5, 7), (0, 2, 6, 7), (0, 2, 3, 7), (0, 1, 5, 7), (0, 1, 3, 7)]
        pieces = []
        for path in paths:
            corners = HEXAHEDRON.vertices[list(path)]
            positive = np.linalg.det(corners[1:] - corners[0]) > 0
            pieces.append(list(path) if positive else [path[0], path[2], path[1], path[3]])
    return Complex(((cell, numbers[:, pieces].reshape(-1, len(pieces[0]))),)), points


def mixed_complex() -> tuple[Complex, np.ndarray]:
    """A hexahedron, six pyramids around a point, two wedges, a tetrahedron and one more pyramid, all conforming."""
    points: list[tuple[float, float, float]] = []

    def vertex(*p: float) -> int:
        if p not in points:
            points.append(p)
        return points.index(p)

    def box(x: int, y: int) -> list[int]:
        return [vertex(x + i, y + j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]

    hexahedron = box(0, 0)
    cut = box(1, 0)
    centre = vertex(1.45, 0.55, 0.5)
    pyramids = []
    for face in HEXAHEDRON.faces:
        v00, v01, v10, v11 = (cut[v] for v in face.vertices)
        pyramids.append([v00, v10, v01, v11, centre])
    a, b, c, d = ([vertex(x, y, z) for z in (0, 1)] for x, y in ((0, 1), (1, 1), (0, 2), (1, 2)))
    wedges = [[*a, *b, *c], [*d, *c, *b]]
    tetrahedra = [[a[1], b[1], c[1], vertex(0.3, 1.3, 2)]]
    top = [hexahedron[v] for v in (1, 3, 5, 7)]
    pyramids.append([*top, vertex(0.5, 0.5, 2)])
    parts = ((HEXAHEDRON, [hexahedron]), (PYRAMID, pyramids), (WEDGE, wedges), (TETRAHEDRON, tetrahedra))
    return Complex(tuple((cell, np.array(v, dtype=np.int64)) for cell, v in parts)), np.array(points, dtype=float)


def bend(points: np.ndarray) -> np.ndarray:
    """A smooth map of space that is not affine, with positive Jacobian near the unit cube."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x + 0.15 * y * z + 0.1 * x * y, y - 0.12 * x * z + 0.05 * y * y, z + 0.1 * x * x], axis=-1)


def discontinuous(basis: Bernstein, points: np.ndarray, weights: np.ndarray | None = None) -> Domain:
    """Elements with control points (e, n, 3) that share nothing."""
    dofs = np.arange(points.shape[0] * basis.n).reshape(-1, basis.n)
    return Domain(Space((Block(basis, dofs),), dofs.size, weights), points.reshape(-1, 3))
