"""Geometry sources: each turns one kind of input into a `iga.Domain`."""
