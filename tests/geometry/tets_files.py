"""Files of tet meshes, written by meshio."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from geometry.tets.mesh import TetMesh
from geometry.tets.order import node_columns
from iga.bernstein import bernstein, greville
from iga.cells import TETRAHEDRON


def nodes_of(mesh: TetMesh, order: str) -> tuple[np.ndarray, np.ndarray]:
    """Node coordinates and connectivity of a mesh's Lagrange form, nodes shared between neighbours."""
    basis = bernstein(TETRAHEDRON, mesh.degree)
    values = basis.tabulate(greville(basis), 0)[0] @ mesh.coefficients
    back = np.argsort(node_columns(mesh.degree, order))
    flat = values[:, back].reshape(-1, 3)
    first, inverse = np.unique(np.round(flat, 10), axis=0, return_index=True, return_inverse=True)[1:]
    return flat[first], inverse.reshape(len(values), -1)


def write(path: Path, mesh: TetMesh, order: str = "vtk") -> Path:
    points, cells = nodes_of(mesh, order)
    kind = {1: "tetra", 2: "tetra10", 3: "tetra20", 4: "tetra35", 5: "tetra56", 6: "tetra84"}[mesh.degree]
    options: dict = {".msh": {"file_format": "gmsh"}, ".vtu": {"binary": False}, ".vtk": {"binary": False}}
    meshio.write(path, meshio.Mesh(points, [(kind, cells)]), **options.get(path.suffix, {}))
    return path
