"""Heat conduction: conditions, materials, time steps, modes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from iga.assembly import integral
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.field import Field, attribute
from problems import heat, manufactured
from problems.benchmarks import box_heat_modes
from problems.formula import from_array, parse
from problems.heat import Convection, Heat
from problems.material import symbolic
from tests.problems.shapes import bent_box, box

SIDES = {"x0": (-1, 0, 0), "x1": (1, 0, 0), "y0": (0, -1, 0), "y1": (0, 1, 0), "z0": (0, 0, -1), "z1": (0, 0, 1)}
TENSOR = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 3.0]])
VARYING = from_array(TENSOR.astype(object) * parse("1 + x*y").expressions[0], "k")


def mixed(known: manufactured.Exact, conductivity: object, h: float = 2.0) -> Heat:
    """The same exact solution by a temperature on two sides, fluxes on two, convection on two."""
    # k du/dn = h (ambient - u)
    ambient = {
        name: from_array(
            known.u.expressions[0] + known.through(SIDES[name]).expressions[0] / symbolic(h), f"ambient at {name}"
        )
        for name in ("z0", "z1")
    }
    return Heat(
        conductivity,
        known.source,
        temperature={"x*": known.u},
        flux={name: known.through(SIDES[name]) for name in ("y0", "y1")},
        convection={name: Convection(h, value) for name, value in ambient.items()},
    )


@pytest.mark.parametrize("k", [3.0, TENSOR, parse("1+x"), VARYING], ids=["number", "tensor", "formula", "both"])
def test_patch_with_all_kinds_of_conditions(k: object) -> None:
    known = manufactured.heat("1+2*x-3*y+0.5*z", k)
    solution = heat.solve(mixed(known, k), bent_box(2, 2), points=6)
    assert solution.errors(known.u).relative_h1 < 1e-12


def test_attribute_as_conductivity() -> None:
    domain = bent_box(2, 2)
    slope = 1 + domain.points[:, :1]
    domain = replace(domain, attributes={"k": slope[:, 0], "K": slope * TENSOR.ravel()})
    scalar, tensor = attribute(domain, "k"), attribute(domain, "K")
    for field, k in ((scalar, parse("1+x")), (tensor, from_array(TENSOR * parse("1+x").expressions[0], "K"))):
        known = manufactured.heat("1+2*x-3*y+0.5*z", k)
        solution = heat.solve(Heat(field, known.source, {"*": known.u}), domain, points=6)
        assert solution.errors(known.u).relative_h1 < 1e-12
        exact = solution.error_of("heat_flux", lambda x, known=known: -known.flux(x), points=6)
        assert exact[0] < 1e-12 * exact[1]


def test_rates_with_a_varying_tensor_and_all_conditions() -> None:
    known = manufactured.heat("sin(2*x)*cos(y)*exp(0.5*z)", VARYING)
    errors = [heat.solve(mixed(known, VARYING), bent_box(n, 2)).errors(known.u) for n in (2, 4, 8)]
    l2 = np.log2([a.l2 / b.l2 for a, b in pairwise(errors)])
    h1 = np.log2([a.h1 / b.h1 for a, b in pairwise(errors)])
    assert l2[-1] > 2.9
    assert h1[-1] > 1.9
    assert errors[-1].relative_l2 < 2e-4
    assert errors[-1].relative_h1 < 4e-3


def test_heat_is_balanced() -> None:
    domain = box((3, 2, 2), 2)
    problem = Heat(2.0, parse("1 + x"), {"x0": 0.0}, {"y1": parse("z")}, {"x1": Convection(3.0, 1.0)})
    solution = heat.solve(problem, domain)
    u = Field(domain.space, solution.coefficients)
    exchanged = 3.0 * (1.0 - integral(domain, u, boundary="x1"))
    assert solution.reactions["x0"] + exchanged + 1.5 + 0.5 == pytest.approx(0.0, abs=1e-12)


def test_reactions_of_boundaries_that_meet() -> None:
    """All sides held at 1 + x: the heat comes in at x1 and leaves at x0; with a source all leaves, in balance."""
    held = {name: parse("1 + x") for name in ("x0", "x1", "y0", "y1", "z0", "z1")}
    found = heat.solve(Heat(2.0, temperature=held), box((3, 2, 2), 2)).reactions
    assert found == pytest.approx({"x0": -2.0, "x1": 2.0, "y0": 0.0, "y1": 0.0, "z0": 0.0, "z1": 0.0}, abs=1e-12)
    found = heat.solve(Heat(2.0, 6.0, temperature=dict.fromkeys(held, 0.0)), box((3, 2, 2), 2)).reactions
    assert sum(found.values()) == pytest.approx(-6.0, abs=1e-12)


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (Heat(), "nothing fixes the temperature: give a temperature or a convection"),
        (Heat(flux={"x0": 1.0}), "nothing fixes the temperature"),
        (Heat(temperature={"bore": 1.0}), "temperature: no boundary is called 'bore'; there are: x0, x1, y0"),
        (Heat(temperature={"x0": 1.0}, flux={"x*": 2.0}), "boundary 'x0' has both a temperature and a flux"),
        (
            Heat(temperature={"x0": 1.0}, convection={"x0": Convection(1.0)}),
            "boundary 'x0' has both a temperature and a convection",
        ),
        (Heat(temperature={"x?": 1.0, "?0": 2.0}), "boundary 'x0' is matched by both 'x?' and '?0'"),
        (Heat(temperature={"x0": 1.0}, convection={"x1": Convection(-1.0)}), "coefficient on 'x1' = -1 must be"),
        (Heat(temperature={"x0": parse("log(x)")}), "no finite real value at"),
    ],
)
def test_refusals(problem: Heat, words: str) -> None:
    with pytest.raises(InputError) as caught:
        heat.solve(problem, box((1, 1, 1), 1))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_name_beats_a_pattern() -> None:
    domain = box((2, 1, 1), 1)
    solution = heat.solve(Heat(temperature={"x?": 0.0, "x1": 1.0}), domain)
    assert solution.errors(parse("x")).l2 < 1e-13


def two_boxes() -> Domain:
    """Two separate unit cubes, the second from x = 3 on."""
    one = box((1, 1, 1), 1)
    shifted = one.points + np.array([3.0, 0.0, 0.0])
    block = replace(one.space.blocks[0], dofs=one.space.blocks[0].dofs + one.space.n)
    boundaries = dict(one.boundaries)
    boundaries |= {f"far_{name}": tuple(replace(f, block=1) for f in parts) for name, parts in one.boundaries.items()}
    return Domain(Space((one.space.blocks[0], block), 2 * one.space.n), np.vstack([one.points, shifted]), boundaries)


def test_every_separate_part_must_be_held() -> None:
    domain = two_boxes()
    with pytest.raises(InputError, match=r"of the part near \(3.5, 0.5, 0.5\)"):
        heat.solve(Heat(temperature={"x0": 1.0}), domain)
    solution = heat.solve(Heat(temperature={"x0": 1.0, "far_x1": 2.0}), domain)
    assert solution.extrema("temperature") == pytest.approx((1.0, 2.0))


@pytest.mark.parametrize(
    ("scheme", "theta", "order", "cap"),
    [("theta", 1.0, 1.0, 0.03), ("theta", 0.5, 2.0, 7e-4), ("bdf2", 0.5, 2.0, 3e-3)],
    ids=["backward Euler", "Crank-Nicolson", "BDF2"],
)
def test_orders_in_time(scheme: str, theta: float, order: float, cap: float) -> None:
    """A solution that the space holds at every time: what is left is the error of the time steps."""
    known = manufactured.heat("(1 + x*y - 2*z + x**2)*cos(2*t)", parse("1+x*y"), 2.0)
    problem = replace(mixed(known, parse("1+x*y")), capacity=2.0)
    errors = [
        heat.march(problem, box((1, 1, 1), 2), known.u, 1.0, steps, scheme, theta).compared(known.u).norms.l2
        for steps in (8, 16, 32)
    ]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates[-1] == pytest.approx(order, abs=0.15)
    assert errors[-1] < cap


def test_history_and_steady_limit() -> None:
    domain = box((2, 1, 1), 2)
    problem = Heat(1.0, temperature={"x0": 0.0, "x1": 1.0})
    solution = heat.march(problem, domain, parse("x"), 1.0, 5)
    assert solution.history.shape == (6, domain.space.n)
    np.testing.assert_allclose(solution.times, np.linspace(0, 1, 6))
    np.testing.assert_allclose(solution.history, np.tile(solution.history[0], (6, 1)), atol=1e-12)
    for solver in ("cg", "direct"):
        late = heat.march(problem, domain, 5.0, 40.0, 20, "theta", 1.0, solver=solver)
        assert late.errors(parse("x")).l2 < 1e-9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scheme": "euler"}, "time scheme 'euler' is unknown; there are: theta, bdf2"),
        ({"theta": 0.2}, "theta = 0.2 is outside"),
        ({"steps": 0}, "time must run forward"),
        ({"end": -1.0}, "time must run forward"),
    ],
)
def test_time_steps_are_refused(changes: dict, words: str) -> None:
    settings = {"end": 1.0, "steps": 3} | changes
    with pytest.raises(InputError, match=words):
        heat.march(Heat(temperature={"*": 0.0}), box((1, 1, 1), 1), 0.0, **settings)


def test_modes_of_a_box() -> None:
    size = (1.0, 1.25, 0.8)
    errors = []
    for n in (2, 4):
        values, shapes, log = heat.modes(Heat(2.0, temperature={"*": 7.0}, capacity=4.0), box((n, n, n), 3, size), 5)
        errors.append(np.max(np.abs(values / np.array(box_heat_modes(size, 5, 0.5)) - 1)))
    assert errors[1] < 4e-4
    assert np.log2(errors[0] / errors[1]) > 5.0  # rate 2p = 6 of eigenvalues
    assert shapes.shape == (len(shapes), 5)
    assert log["residual"] < 1e-10
    insulated = heat.modes(Heat(), box((2, 2, 2), 3), 3)[0]
    np.testing.assert_allclose(insulated, [0.0, np.pi**2, np.pi**2], rtol=1e-3, atol=1e-9)
    with pytest.raises(InputError, match="9 eigenpairs of 1 free unknowns"):
        heat.modes(Heat(temperature={"*": 0.0}), box((2, 2, 2), 1), 9)
