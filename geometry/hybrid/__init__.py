"""Trimmed CAD solids: B-rep from STEP and IGES, watertight hybrid B-rep, hybrid volume."""

from geometry.hybrid.brep import Brep
from geometry.hybrid.cad import read_cad

__all__ = ["Brep", "read_cad"]
