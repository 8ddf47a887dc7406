"""Solutions: quantities, probes, projections, summaries."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.nurbs.source import build
from iga.errors import InputError
from iga.located import Located
from problems import heat, manufactured
from problems.formula import parse
from problems.heat import Heat
from problems.manufactured import solve_exact
from tests.problems.shapes import bent_box, box


def test_scattered_points_on_rational_elements() -> None:
    """Values and gradients of a linear field at random reference points: exact whatever the map."""
    domain = build("hollow_sphere_octant", refine=1)
    rng = np.random.default_rng(101)
    block = rng.integers(0, len(domain.space.blocks), 20)
    element = np.array([rng.integers(0, domain.space.blocks[b].elements) for b in block])
    sample = Located(domain, block, element, rng.uniform(0, 1, (20, 3)))
    radii = np.linalg.norm(sample.x, axis=1)
    assert ((radii > 1 - 1e-12) & (radii < 2 + 1e-12)).all()
    field = domain.points @ np.array([1.0, -2.0, 0.5]) + 3.0
    np.testing.assert_allclose(sample.at(field), sample.x @ [1.0, -2.0, 0.5] + 3.0, rtol=1e-12)
    np.testing.assert_allclose(sample.gradient(field), np.tile([1.0, -2.0, 0.5], (20, 1)), atol=1e-10)
    np.testing.assert_allclose(sample.gradient(domain.points), np.tile(np.eye(3), (20, 1, 1)), atol=1e-10)


def test_probe() -> None:
    solution, _ = solve_exact(bent_box(2, 3), "heat", "1+2*x-3*y+0.5*z")
    points = np.random.default_rng(103).uniform(0.05, 0.95, (12, 3))
    np.testing.assert_allclose(solution.probe(points), 1 + points @ [2, -3, 0.5], atol=1e-9)
    np.testing.assert_allclose(solution.probe(points, "heat_flux"), np.tile([-2, 3, -0.5], (12, 1)), atol=1e-8)
    assert solution.probe([0.5, 0.5, 0.5]).shape == (1,)
    for given in ([0.1, 0.2], "middle", [[1.0, 2.0], [3.0]]):
        with pytest.raises(InputError, match="rows of three numbers"):
            solution.probe(given)
    with pytest.raises(InputError, match="outside"):
        solution.probe([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])


def test_quantities_are_known_by_name() -> None:
    solution, _ = solve_exact(bent_box(1, 2), "elasticity", "x+2*y;3*z-y;x-y+z", points=6)
    assert list(solution.quantities) == ["displacement", "strain", "stress", "von_mises"]
    assert list(solution.fields) == ["displacement"]
    assert set(solution.pictured()) == set(solution.quantities)
    with pytest.raises(InputError, match="the solution has no 'temperature'; it has: displacement, strain"):
        solution.extrema("temperature")
    np.testing.assert_allclose(solution.coefficients_of("strain"), np.tile([1, -1, 1, 2, 1, 2], (27, 1)), atol=1e-10)
    np.testing.assert_allclose(solution.coefficients_of("von_mises"), solution.extrema("von_mises")[0], rtol=1e-9)


def test_errors_need_a_formula_of_the_right_shape() -> None:
    solution = heat.solve(Heat(temperature={"*": 1.0}), box((1, 1, 1), 1))
    with pytest.raises(InputError, match=r"exact solution 'x; ?y; ?z' has 3 formulas; temperature needs 1"):
        solution.compared(manufactured.elasticity("x;y;z", np.eye(6)).u)
    assert solution.compared(parse("1")).norms.l2 < 1e-14
    assert solution.compared(parse("1")).summary()["relative_l2_error"] < 1e-14
    assert solution.summary()["l2_error"] is None


def test_direct_and_iterative_agree() -> None:
    solvers = ("direct", "cg", "matrix-free")
    results = [solve_exact(bent_box(3, 2), "elasticity", "sin(x)*y;x*z;cos(y)", solver=s) for s in solvers]
    (a, log_a), (b, log_b), (c, log_c) = results
    assert (log_a["solver"], log_b["solver"], log_c["solver"]) == ("direct", "cg", "cg")
    assert log_b["iterations"] > 1
    assert log_c["preconditioner"].endswith("by components")
    np.testing.assert_allclose(a.coefficients, b.coefficients, atol=1e-10)
    np.testing.assert_allclose(a.coefficients, c.coefficients, atol=1e-9)
    assert log_c["energy"] == pytest.approx(log_a["energy"], rel=1e-10)


def test_picture(tmp_path) -> None:
    from iga.pictures.plot import can_draw

    if not can_draw():
        pytest.skip("no graphics library")
    solution, _ = solve_exact(box((1, 1, 1), 2), "elasticity", "x*y;y;z", points=4)
    for name in ("displacement", "von_mises"):
        solution.plot(name, tmp_path / f"{name}.png", size=200)
        assert (tmp_path / f"{name}.png").stat().st_size > 1000
