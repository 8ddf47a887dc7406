"""Geometry source "meccano": a closed surface triangulation as a certified spline volume."""
