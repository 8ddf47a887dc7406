"""Catmull-Clark solids: smooth volumes and spline spaces on any hexahedral mesh."""
