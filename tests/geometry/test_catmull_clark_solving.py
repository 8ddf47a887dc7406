"""Solving on Catmull-Clark solids: iterations stay few, and parts of a smooth boundary are held weakly."""

from __future__ import annotations

import numpy as np
import pytest

import geometry.catmull_clark as source
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.settings import Settings
from geometry.catmull_clark.shapes import fan
from problems import solve_exact


@pytest.mark.parametrize(("physics", "exact", "most"), [
    ("heat", "sin(2*x)*cos(y)*exp(z/2)", 75), ("elasticity", "sin(2*x)*cos(y);x*y;z**2", 85),
])
def test_few_iterations_around_an_extraordinary_edge(physics: str, exact: str, most: int) -> None:
    """The coarse space must suit unclamped splines, whose degree-one functions are no coarser than they are."""
    domain = source.refine(source.domain_of(hex_mesh(*fan(5, 2, 2)), Settings(interpolate="none")))
    direct, _ = solve_exact(domain, physics, exact, solver="direct")
    iterated, _ = solve_exact(domain, physics, exact, solver="cg")
    assert iterated.log["iterations"] <= most
    scale = np.abs(direct.coefficients).max()
    np.testing.assert_allclose(iterated.coefficients, direct.coefficients, atol=1e-9 * scale)
