"""Geometry source "hybrid": trimmed CAD models as watertight splines (HB-rep) and mixed spline volumes (HV-rep)."""
