"""Hexahedral meshes: Catmull-Clark solids, smooth volumes with a spline space on any hex mesh."""

from geometry.catmull_clark.evaluation import evaluate
from geometry.catmull_clark.mesh import HexMesh, hex_mesh, read_hexes
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.source import build, domain_of, name, reads, refine

__all__ = ["HexMesh", "Settings", "build", "domain_of", "evaluate", "hex_mesh", "name", "read_hexes", "reads", "refine"]
