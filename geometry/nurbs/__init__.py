"""B-spline and NURBS volumes: files, shapes from code, conforming multipatch, exact refinement."""

from geometry.nurbs.multipatch import Multipatch, glue
from geometry.nurbs.patch import Patch
from geometry.nurbs.source import build, name, reads, refine, write_gismo

__all__ = ["Multipatch", "Patch", "build", "glue", "name", "reads", "refine", "write_gismo"]
