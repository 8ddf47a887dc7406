"""Trimmed CAD models: STEP and IGES files as NURBS faces, trimming curves and shared edges."""
