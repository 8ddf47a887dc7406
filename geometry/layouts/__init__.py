"""Surfaces of any genus divided as the boundary of a cube or polycube, and the maps from there onto them."""
