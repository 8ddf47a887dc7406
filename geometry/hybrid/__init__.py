"""Trimmed CAD solids: B-rep from STEP and IGES, watertight hybrid B-rep, hybrid volume."""

from geometry.cad.brep import Brep
from geometry.cad.reading import read_cad
from geometry.hybrid.settings import Settings
from geometry.hybrid.source import build, domain_of, name, reads, refine

__all__ = ["Brep", "Settings", "build", "domain_of", "name", "read_cad", "reads", "refine"]
