r"""Catmull-Clark subdivision of solids: connectivity and one sparse matrix per level.

A level maps control points P to S P; positions, attributes and anything else given at vertices go through the same S.
The rules are those of `lattice`: interior (1)-(3) of Xie et al. 2020 with edge averages weighted by valence, the
Catmull-Clark surface on the boundary, cubic curves along creases, fixed corners.

Axis letters: e hexahedron, v vertex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.catmull_clark.lattice import Rows, refinement_matrix, refinement_rows
from geometry.catmull_clark.topology import Topology, build_topology, with_kinds

Index = NDArray[np.int64]

_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
# Lattice points (of 27) of the eight vertices of each of the eight children, (8, 8).
CHILDREN = np.array([[(corner + step) @ np.array([9, 3, 1]) for step in _CORNERS] for corner in _CORNERS])


def subdivide(topology: Topology) -> tuple[Topology, csr_array]:
    """One level of subdivision.

    Returns
    -------
    The refined mesh, whose cells 8 e .. 8 e + 7 are the children of cell e by corner, and the matrix (v', v). New
    vertices are numbered old vertices, edge points, face points, cell points.
    """
    rows = refinement_rows(topology)
    return refine_topology(rows), refinement_matrix(topology, rows)


def refine_topology(rows: Rows) -> Topology:
    """Connectivity and kinds of the refined mesh."""
    hexes = rows.cells[:, CHILDREN].reshape(-1, 8)
    return inherit_kinds(build_topology(hexes, len(rows.kind)), rows.kind)


def inherit_kinds(fine: Topology, kind: NDArray[np.int8]) -> Topology:
    """Set the kinds of a refined mesh from the kinds (v',) of its vertices.

    New vertices are numbered by the dimension of the entity they come from, so a new edge or face lies inside the
    entity of its vertex with the largest number.
    """
    return with_kinds(fine, kind, kind[fine.edges[:, 1]], kind[fine.faces.max(axis=1)])
