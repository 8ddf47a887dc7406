"""Closed surface triangulations: certified spline volumes of any genus."""

from geometry.meccano.domain import refine_domain, stored_space
from geometry.meccano.settings import Settings
from geometry.meccano.source import build, domain_of, name, reads, refine
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface

__all__ = ["Settings", "Surface", "build", "domain_of", "name", "read_surface", "reads", "refine", "refine_domain",
           "stored_space"]
