"""Geometry sources: each turns one kind of input into an `iga.domain.Domain`."""

from geometry.sources import Source, build, refine, sources

__all__ = ["Source", "build", "refine", "sources"]
