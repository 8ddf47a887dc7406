"""B-spline and NURBS volumes: files, shapes from code, conforming multipatch, exact refinement."""

from geometry.nurbs.multipatch import Multipatch, glue
from geometry.nurbs.source import build, name, reads, refine, write_gismo
from geometry.patch import Patch

__all__ = ["Multipatch", "Patch", "build", "glue", "name", "reads", "refine", "write_gismo"]
