"""The residual estimator: zero where the solution is exact, jumps and residuals of known size, steady effectivity."""

from __future__ import annotations

import numpy as np
import pytest

from iga.bernstein import bernstein
from iga.block import Block
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.chunk import Chunk
from iga.conforming import straight_domain
from iga.domain import Domain, Facets, Space
from iga.errors import InputError
from iga.field import Field
from problems import heat
from problems.estimator import _hessian, indicators
from problems.formula import parse
from problems.manufactured import heat as exact_heat
from tests.meshes import bend, box_complex
from tests.problems.shapes import box
from tests.splines import cube

CELLS = [TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID]


def bent(cell: Cell, degree: int, n: int = 2) -> Domain:
    flat = straight_domain(*box_complex(cell, n), degree)
    return Domain(flat.space, bend(flat.points), flat.boundaries)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(
    "conductivity",
    [2.5, np.diag([1.0, 2.0, 3.0]), parse("2+x*y"), "field"],
    ids=["number", "tensor", "formula", "field"],
)
def test_an_exact_temperature_leaves_nothing(cell: Cell, conductivity: object) -> None:
    domain = bent(cell, 2)
    known = exact_heat("1+x-2*y+3*z", parse("1+2*x") if isinstance(conductivity, str) else conductivity)
    if isinstance(conductivity, str):
        conductivity = Field(domain.space, 1 + 2 * domain.points[:, 0])
    problem = heat.Heat(conductivity, known.source, {"boundary": known.u})
    temperature = 1 + domain.points @ [1.0, -2.0, 3.0]
    assert indicators(problem, domain, temperature).max() < 1e-10


def test_an_exact_temperature_on_rational_functions() -> None:
    domain = cube((3, 3, 3), (2, 2, 2))
    weights = 1 + 0.3 * np.random.default_rng(5).random(domain.space.n)
    domain = Domain(Space(domain.space.blocks, domain.space.n, weights), domain.points, domain.boundaries)
    problem = heat.Heat(1.0, 0.0, {"*": parse("x-y")})
    assert indicators(problem, domain, domain.points @ [1.0, -1.0, 0.0]).max() < 1e-9


@pytest.mark.parametrize("rational", [False, True])
def test_second_derivatives_agree_with_differences(rational: bool) -> None:
    domain = cube((3, 3, 3), (2, 2, 2), 0.4)
    rng = np.random.default_rng(7)
    if rational:
        weights = 1 + 0.3 * rng.random(domain.space.n)
        domain = Domain(Space(domain.space.blocks, domain.space.n, weights), domain.points, domain.boundaries)
    u = rng.random(domain.space.n)
    xi, h = np.array([0.3, 0.6, 0.2]), 1e-4

    def at(point: np.ndarray) -> Chunk:
        return Chunk(domain, 0, np.array([3]), point[None], np.ones(1))

    found = _hessian(at(xi), u)[0, 0]
    # Gradients in space at nearby reference points, by the chain rule.
    slopes = np.stack([
        (at(xi + h * axis).gradient(u) - at(xi - h * axis).gradient(u))[0, 0] / (2 * h) for axis in np.eye(3)
    ], axis=1)
    assert np.abs(found - slopes @ at(xi).inverse[0, 0]).max() < 1e-5 * np.abs(found).max()
    assert np.abs(found - found.T).max() < 1e-10 * np.abs(found).max()


def test_jump_of_a_kink() -> None:
    """Two unit cubes, u = |x - 1|, k = 3: the flux jumps by 6 on a face of area one, h is the diagonal."""
    domain = box((2, 1, 1), 1, (2.0, 1.0, 1.0))
    u = np.abs(domain.points[:, 0] - 1)
    problem = heat.Heat(3.0, 0.0, {"x?": 1.0})
    found = indicators(problem, domain, u)
    assert found == pytest.approx(np.full(2, np.sqrt(0.5 * np.sqrt(3) * 36 / 3)), rel=1e-12)


def test_jump_across_a_hanging_face() -> None:
    """A unit cube beside four bars of half its width, u = |x - 1|, k = 3: each side has its share of its own faces."""
    corners = HEXAHEDRON.vertices
    bars = [[1.0, 0.5 * j, 0.5 * k] + corners * [1.0, 0.5, 0.5] for j in (0, 1) for k in (0, 1)]
    points = np.concatenate([corners, *bars])
    basis = bernstein(HEXAHEDRON, 1)
    blocks = (Block(basis, np.arange(8)[None]), Block(basis, 8 + np.arange(32).reshape(4, 8)))
    low, high = (
        next(k for k, face in enumerate(HEXAHEDRON.faces) if (corners[list(face.vertices), 0] == end).all())
        for end in (0, 1)
    )
    ends = {"low": (Facets(0, low, np.array([0])),), "high": (Facets(1, high, np.arange(4)),)}
    domain = Domain(Space(blocks, len(points)), points, ends)
    problem = heat.Heat(3.0, 0.0, {"low": 1.0, "high": 1.0})
    found = indicators(problem, domain, np.abs(points[:, 0] - 1))
    bar = np.sqrt(1.5)
    expected = [0.5 * np.sqrt(3) * 36 / 3] + 4 * [0.5 * bar * 36 / 3 / 4]
    assert found**2 == pytest.approx(expected, rel=1e-10)


def test_temperatures_that_are_missed() -> None:
    """One cube, u = x, k = 2, 0.5 prescribed on x = 0 under two names: 2 int 0.25 / h, once."""
    domain = box((1, 1, 1), 1)
    twice = Domain(domain.space, domain.points, {**domain.boundaries, "again": domain.boundaries["x0"]})
    expected = 2.0 * 0.25 / np.sqrt(3)
    for held in ({"x0": 0.5}, {"x0": 7.0, "again": 0.5}):
        problem = heat.Heat(2.0, 0.0, held, {"x1": 2.0})
        assert indicators(problem, twice, domain.points[:, 0]) == pytest.approx([np.sqrt(expected)], rel=1e-12)


def test_residuals_inside_and_on_the_boundary() -> None:
    """One cube, u = x, k = 2, source 5: 5 inside; on x = 1 the flux 2 against convection 3 (4 - u) there."""
    domain = box((1, 1, 1), 1)
    problem = heat.Heat(2.0, 5.0, {"x0": 0.0}, {"y0": 0.5}, {"x1": heat.Convection(3.0, 4.0)})
    h = np.sqrt(3)
    expected = h**2 * 25 / 2 + h * (3 * 3 - 2) ** 2 / 2 + h * 0.5**2 / 2
    assert indicators(problem, domain, domain.points[:, 0]) == pytest.approx([np.sqrt(expected)], rel=1e-12)


@pytest.mark.parametrize(("cell", "degree"), [(TETRAHEDRON, 1), (TETRAHEDRON, 2), (HEXAHEDRON, 1), (HEXAHEDRON, 2)])
def test_the_estimate_follows_the_error(cell: Cell, degree: int) -> None:
    known = exact_heat("sin(2*x)*exp(y)+z**2")
    ratios = []
    for n in (2, 4):
        domain = bent(cell, degree, n)
        problem = heat.Heat(1.0, known.source, {"boundary": known.u})
        solution = heat.solve(problem, domain).compared(known.u)
        assert solution.norms is not None
        ratios.append(np.linalg.norm(indicators(problem, domain, solution.coefficients)) / solution.norms.h1)
    assert 1 < ratios[0] < 40
    assert ratios[1] / ratios[0] == pytest.approx(1, abs=0.25)


def test_conductivities_without_a_derivative_are_refused() -> None:
    domain = box((1, 1, 1), 1)
    problem = heat.Heat(lambda x: 1 + x[..., 0], 0.0, {"*": 0.0})
    with pytest.raises(InputError, match="needs a conductivity"):
        indicators(problem, domain, np.zeros(domain.space.n))
