r"""Where file formats put the nodes of a Lagrange tetrahedron of any degree.

Nodes lie on the equispaced lattice a / n, a = (a0, a1, a2, a3) barycentric exponents. Every format lists vertices, then
edges, faces and the interior, which is a tetrahedron of degree n - 4 listed the same way; faces are triangles of degree
n - 3 listed vertices, edges, interior. They differ in which edge and face comes when, and in the direction of each:

    Gmsh  edges 01 12 20 30 32 31   faces 021 013 032 312   (Gmsh reference manual, node ordering)
    VTK   edges 01 12 20 03 13 23   faces 013 231 032 021   (vtkHigherOrderTetra)

meshio turns ten-node tetrahedra of Gmsh into VTK's order and leaves all higher degrees as they are in the file.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein
from iga.cells import TETRAHEDRON
from iga.errors import InputError

Index = NDArray[np.int64]

#: Edges and faces of each order by their vertices.
ORDERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "gmsh": (("01", "12", "20", "30", "32", "31"), ("021", "013", "032", "312")),
    "vtk": (("01", "12", "20", "03", "13", "23"), ("013", "231", "032", "021")),
}


@cache
def node_exponents(degree: int, order: str) -> Index:
    """Barycentric exponents (C(n+3, 3), 4) of the nodes in the order "gmsh" or "vtk"."""
    if order not in ORDERS:
        raise InputError(f"node order {order!r} is unknown; there are: {', '.join(ORDERS)}")
    edges, faces = ORDERS[order]
    return _lattice(degree, 4, edges, faces)


@cache
def node_columns(degree: int, order: str) -> Index:
    """For each Bernstein function (exponents descending) the position of its domain point in the order."""
    place = {tuple(a): k for k, a in enumerate(node_exponents(degree, order).tolist())}
    return np.array([place[tuple(a)] for a in bernstein(TETRAHEDRON, degree).exponents.tolist()], dtype=np.int64)


def _lattice(degree: int, vertices: int, edges: tuple[str, ...], faces: tuple[str, ...]) -> Index:
    """Exponents of a simplex with the given edges and faces, recursively."""
    if degree < 0:
        return np.zeros((0, vertices), dtype=np.int64)
    if degree == 0:
        return np.zeros((1, vertices), dtype=np.int64)
    unit = np.eye(vertices, dtype=np.int64)
    parts = [degree * unit]
    inner = np.arange(1, degree)[:, None]
    for a, b in (map(int, edge) for edge in edges):
        parts.append((degree - inner) * unit[a] + inner * unit[b])
    for face in faces:
        corners = unit[[int(v) for v in face]]
        parts.append((_lattice(degree - 3, 3, ("01", "12", "20"), ()) + 1) @ corners)
    if vertices == 4:
        parts.append(_lattice(degree - 4, 4, edges, faces) + 1)
    else:
        # Inside of a triangle: a triangle of degree n - 3.
        parts.append(_lattice(degree - 3, 3, edges, ()) + 1)
    return np.concatenate([part for part in parts if len(part)])
