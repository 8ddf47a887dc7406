"""Tetrahedral meshes: Bezier tetrahedra as they stand, or converted exactly to hexahedra."""

from geometry.tet_to_hex import tets_to_degenerate_hexes, tets_to_hexes
from geometry.tets.domain import domain_of
from geometry.tets.mesh import TetMesh, checked_mesh
from geometry.tets.reader import read_tets
from geometry.tets.source import build, name, reads, refine

__all__ = ["TetMesh", "build", "checked_mesh", "domain_of", "name", "read_tets", "reads", "refine",
           "tets_to_degenerate_hexes", "tets_to_hexes"]
