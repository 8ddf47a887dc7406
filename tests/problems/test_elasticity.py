"""Linear elasticity: conditions, materials, thermal strain, supports, modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.nurbs.source import build
from iga.chunk import facet_chunks
from iga.errors import InputError
from iga.field import Field, attribute
from iga.integrands import VOIGT
from problems import elasticity, manufactured
from problems.benchmarks import bar_modes
from problems.elasticity import Elasticity, Support, von_mises
from problems.formula import from_array, parse, parse_vector
from problems.material import isotropic, symbolic
from problems.rigid import free_motions
from tests.problems.shapes import bent_box, box, cylinder_sector, sphere_octant
from tests.problems.test_heat import SIDES, two_boxes

ROOT = np.random.default_rng(83).standard_normal((6, 6))
ANISOTROPIC = ROOT @ ROOT.T + 2 * np.eye(6)
STEEL = isotropic(10.0, 0.3)
LINEAR = "x+2*y; 3*z-y; x-y+z"


def mixed(known: manufactured.Exact, C: object, k: float = 2.0) -> Elasticity:
    """The same exact solution by displacements (one of them partial), tractions, and an elastic support."""
    # on z1: traction t = T - k u, so the added traction is T = t + k u
    added = from_array(known.through(SIDES["z1"]).array() + symbolic(k) * known.u.array(), "T")
    u = from_array(known.u.array()[0], "u")
    partial = known.through(SIDES["x1"]).array()
    partial[0] = parse("0").expressions[0]
    return Elasticity(
        C,
        known.source,
        displacement={"x0": known.u, "x1": (u, None, None)},
        traction={n: known.through(SIDES[n]) for n in ("y0", "y1", "z0")}
        | {"z1": added, "x1": from_array(partial, "T")},
        support={"z1": Support(k)},
    )


@pytest.mark.parametrize(
    "C",
    [STEEL, ANISOTROPIC, isotropic(parse("1+x"), 0.3), from_array(ANISOTROPIC * parse("1+x*y").expressions[0], "C")],
    ids=["isotropic", "anisotropic", "isotropic formula", "anisotropic formula"],
)
def test_patch_with_all_kinds_of_conditions(C: object) -> None:
    known = manufactured.elasticity(LINEAR, C)
    solution = elasticity.solve(mixed(known, C), bent_box(2, 2), points=6)
    assert solution.errors(known.u).relative_h1 < 1e-12
    error, size = solution.error_of(
        "stress", lambda x: np.stack([known.flux(x)[..., i, j] for i, j in VOIGT], axis=-1), points=6
    )
    assert error < 1e-12 * size


def test_attribute_as_modulus() -> None:
    domain = bent_box(2, 2)
    domain = replace(domain, attributes={"E": 1 + domain.points[:, 0]})
    known = manufactured.elasticity(LINEAR, isotropic(parse("1+x"), 0.3))
    problem = Elasticity(isotropic(attribute(domain, "E"), 0.3), known.source, {"*": known.u})
    assert elasticity.solve(problem, domain, points=6).errors(known.u).relative_h1 < 1e-12


def test_attributes_of_single_components_and_where_only_the_normal_is_held() -> None:
    """Uniaxial tension, whatever the way in which the supports and the material are given."""
    domain = box((2, 2, 2), 2)
    domain = replace(domain, attributes={"E": np.full(domain.space.n, 10.0), "zero": np.zeros(domain.space.n)})
    zero = attribute(domain, "zero")
    held = {"displacement": {"x0": (zero, None, None), "y0": (None, zero, None), "z0": (None, None, 0.0)}}
    sliding = {"normal_displacement": {"x0": zero, "y0": 0.0, "z0": 0.0}}
    for C in (STEEL, isotropic(attribute(domain, "E"), 0.3)):
        for supports in (held, sliding):
            solution = elasticity.solve(Elasticity(C, traction={"x1": (2.0, 0, 0)}, **supports), domain)
            assert solution.errors(parse_vector("0.2*x; -0.06*y; -0.06*z")).l2 < 1e-12
    clamped = elasticity.solve(Elasticity(STEEL, displacement={"x0": (zero, zero, 0.0)}), domain)
    assert np.abs(clamped.coefficients).max() < 1e-14
    with pytest.raises(InputError, match="single components cannot be attributes"):
        elasticity.solve(Elasticity(STEEL, traction={"x1": (zero, 0.0, 0.0)}, **held), domain)


def test_rates_with_all_conditions() -> None:
    known = manufactured.elasticity("sin(2*x)*y; cos(y)*exp(0.5*z); x*z**2 + sin(y)", STEEL)
    errors = [elasticity.solve(mixed(known, STEEL), bent_box(n, 2)).errors(known.u) for n in (2, 4, 8)]
    assert np.log2(errors[1].l2 / errors[2].l2) > 2.9
    assert np.log2(errors[1].h1 / errors[2].h1) > 1.9
    assert errors[2].relative_l2 < 3e-4
    assert errors[2].relative_h1 < 5e-3


def test_uniaxial_tension() -> None:
    held = {"x0": (0.0, None, None), "y0": (None, 0.0, None), "z0": (None, None, 0.0)}
    problem = Elasticity(STEEL, displacement=held, traction={"x1": (2.0, 0, 0)})
    solution = elasticity.solve(problem, bent_box(2, 2), points=6)
    assert solution.errors(parse_vector("0.2*x; -0.06*y; -0.06*z")).l2 < 1e-14
    assert solution.extrema("von_mises") == pytest.approx((2.0, 2.0))
    assert solution.log["energy"] == pytest.approx(0.5 * 2.0 * 0.2)
    np.testing.assert_allclose(solution.reactions["x0"], [-2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(solution.reactions["y0"], 0, atol=1e-12)


def test_reactions_of_boundaries_that_meet() -> None:
    """Held all round and swollen evenly: each side of the box takes up 2.5 times its area, none of its neighbours'."""
    every = {name: parse_vector("x; y; z") for name in ("x0", "x1", "y0", "y1", "z0", "z1")}
    sides = (1.0, 2.0, 3.0)
    domain = box((2, 2, 2), 2, sides)
    found = elasticity.solve(Elasticity(isotropic(1.0, 0.3), displacement=every), domain).reactions
    for axis, name in enumerate("xyz"):
        force = np.eye(3)[axis] * 2.5 * np.prod(sides) / sides[axis]
        np.testing.assert_allclose(found[f"{name}1"], force, atol=1e-10)
        np.testing.assert_allclose(found[f"{name}0"], -force, atol=1e-10)


def test_pressure_on_all_sides_compresses() -> None:
    held = {"x0": (0.0, None, None), "y0": (None, 0.0, None), "z0": (None, None, 0.0)}
    problem = Elasticity(STEEL, displacement=held, pressure={"?1": 3.0})
    solution = elasticity.solve(problem, bent_box(2, 2), points=6)
    shrink = 3.0 * (1 - 2 * 0.3) / 10.0
    assert solution.errors(parse_vector(f"-{shrink}*x; -{shrink}*y; -{shrink}*z")).l2 < 1e-14


def test_normal_support_carries_pressure_like_a_spring() -> None:
    """A ring on a normal bedding k under pressure p inside: Lame's solution with the outer pressure q = k u_r."""
    domain = cylinder_sector(4, 3)
    held = {"x0": (0.0, None, None), "y0": (None, 0.0, None), "z?": (None, None, 0.0)}
    E, nu, k, p, a, b = 10.0, 0.3, 5.0, 1.0, 1.0, 2.0
    bedding = {"outer": Support(k, normal=True)}
    problem = Elasticity(isotropic(E, nu), displacement=held, pressure={"inner": p}, support=bedding)
    solution = elasticity.solve(problem, domain)

    def outer(q: float) -> float:  # displacement of the outer surface under p inside and q outside
        A = (1 + nu) * (1 - 2 * nu) / E * (p * a**2 - q * b**2) / (b**2 - a**2)
        return A * b + (1 + nu) / E * (p - q) * a**2 * b**2 / (b**2 - a**2) / b

    q = k * outer(0.0) / (1 - k * (outer(1.0) - outer(0.0)))
    for chunk in facet_chunks(domain, "outer"):
        moved = solution.quantity("displacement").evaluate(chunk)
        np.testing.assert_allclose((moved * chunk.normal).sum(axis=-1), outer(q), rtol=1e-4)


def test_sliding_on_curved_and_plane_boundaries() -> None:
    """A hollow sphere in a rigid shell, u_r = r - 8/r^2: the outer sphere and the planes of symmetry only slide."""
    known = manufactured.elasticity(
        ";".join(f"(1 - 8/(x**2+y**2+z**2)**1.5)*{axis}" for axis in "xyz"), isotropic(3.0, 0.3)
    )
    problem = Elasticity(
        isotropic(3.0, 0.3),
        displacement={"inner": known.u},
        normal_displacement={"outer": 0.0, "x0": 0.0, "y0": 0.0, "z0": 0.0},
    )
    errors = [elasticity.solve(problem, sphere_octant(n, 2)).errors(known.u) for n in (1, 2, 4)]
    assert np.log2(errors[1].l2 / errors[2].l2) > 2.8
    assert np.log2(errors[1].h1 / errors[2].h1) > 1.8
    assert errors[2].relative_l2 < 2e-3
    inside = Elasticity(isotropic(3.0, 0.3), normal_displacement={"inner": 0.0})
    with pytest.raises(InputError, match="freely: rotation about x, rotation about y, rotation about z;"):
        elasticity.solve(inside, build("hollow_sphere_octant", degree=2))


@pytest.mark.parametrize("kind", ["number", "formula", "field", "function"])
def test_free_expansion_is_free_of_stress(kind: str) -> None:
    """A temperature that is linear in space expands a body without stress, if it is held as it would move by itself."""
    domain = box((2, 2, 2), 2)
    warm = {
        "number": (20.0, "0.02*x; 0.02*y; 0.02*z"),
        # T = 20 x: u_x = a (x^2 - y^2 - z^2)/2, u_y = a x y, u_z = a x z with a = 0.02
        "formula": (parse("20*x"), "0.01*(x**2-y**2-z**2); 0.02*x*y; 0.02*x*z"),
        "field": (Field(domain.space, 20 * domain.points[:, 0]), "0.01*(x**2-y**2-z**2); 0.02*x*y; 0.02*x*z"),
        "function": (lambda x: 20 * x[..., 0], "0.01*(x**2-y**2-z**2); 0.02*x*y; 0.02*x*z"),
    }
    temperature, text = warm[kind]
    u = parse_vector(text)
    problem = Elasticity(STEEL, displacement={"x0": u}, expansion=1e-3, temperature=temperature)
    solution = elasticity.solve(problem, domain)
    assert solution.errors(u).l2 < 1e-14
    assert solution.extrema("von_mises")[1] < 1e-13
    assert abs(solution.log["energy"]) < 1e-14


def test_clamped_expansion() -> None:
    C = isotropic(10.0, 0.25)
    problem = Elasticity(C, displacement={"*": (0.0, 0.0, 0.0)}, expansion=1e-3, temperature=50.0)
    solution = elasticity.solve(problem, box((2, 1, 1), 2))
    stress = solution.quantity("stress")
    expected = -10.0 * 1e-3 * 50.0 / (1 - 0.5)
    for _, _, value in solution.samples("stress"):
        np.testing.assert_allclose(value, np.broadcast_to([expected] * 3 + [0] * 3, value.shape), atol=1e-12)
    assert stress.shape == (6,)
    assert solution.log["energy"] == pytest.approx(0.5 * 3 * 0.05 * -expected)
    with pytest.raises(InputError, match=r"expansion is one number or six"):
        elasticity.solve(replace(problem, expansion=[1.0, 2.0]), box((1, 1, 1), 1))


def test_von_mises_of_known_states() -> None:
    states = np.array([[2.0, 0, 0, 0, 0, 0], [5, 5, 5, 0, 0, 0], [0, 0, 0, 0, 0, 2], [1, 2, 3, 4, 5, 6]])
    expected = [2.0, 0.0, 2 * np.sqrt(3), np.sqrt(0.5 * (1 + 1 + 4) + 3 * (16 + 25 + 36))]
    np.testing.assert_allclose(von_mises(states), expected)


# --- rigid motions ----------------------------------------------------------------------------------------------------

FREE = [
    ({}, {}, ["translation along x", "translation along y", "translation along z",
              "rotation about x", "rotation about y", "rotation about z"]),
    ({"x0": (0.0, None, None)}, {}, ["translation along y", "translation along z", "rotation about x"]),
    ({"x0": (0.0, None, None), "y0": (None, 0.0, None)}, {}, ["translation along z"]),
    ({"x0": (None, 0.0, None)}, {}, ["translation along x", "translation along z", "rotation about y",
                                     "rotation about z"]),
    ({"z?": (None, None, 0.0)}, {}, ["translation along x", "translation along y", "rotation about z"]),
    ({}, {"z0": Support(2.0, normal=True)}, ["translation along x", "translation along y", "rotation about z"]),
    ({"x0": (0.0, None, None)}, {"z0": Support(2.0, normal=True)}, ["translation along y"]),
]  # fmt: skip


@pytest.mark.parametrize(("displacement", "support", "names"), FREE)
def test_missing_motions_are_named(displacement: dict, support: dict, names: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        elasticity.solve(Elasticity(STEEL, displacement=displacement, support=support), box((2, 1, 1), 2))
    assert str(caught.value).startswith("the body can move freely: " + ", ".join(names) + ";")


def test_axis_of_a_free_rotation() -> None:
    ring = cylinder_sector(3, 6)  # round to 1e-9
    ring = replace(ring, points=ring.points + np.array([5.0, 0.0, 0.0]))
    supports = {"inner": Support(1.0, normal=True), "z0": Support(1.0, normal=True)}
    with pytest.raises(InputError, match=r"freely: rotation about z through \(5, 0, 0\);"):
        elasticity.solve(Elasticity(STEEL, support=supports), ring)


def test_parts_are_judged_one_by_one() -> None:
    held = Elasticity(STEEL, displacement={"x0": (0.0, 0.0, 0.0), "far_x0": (None, None, 0.0)})
    with pytest.raises(InputError, match=r"freely: translation along x, .* of part 2 near \(3.5, 0.5, 0.5\)"):
        elasticity.solve(held, two_boxes())


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 2)), max_size=8), st.floats(0.0, 6.0))
def test_count_of_free_motions_is_the_rank_defect(pins: list[tuple[int, int]], turn: float) -> None:
    """Pins at corners of a turned box in single directions: as many names as independent motions remain."""
    c, s = np.cos(turn), np.sin(turn)
    corners = box((1, 1, 1), 1).points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) + np.array([1.0, -2.0, 0.5])
    held = np.unique(np.array([3 * corner + axis for corner, axis in pins], dtype=np.int64))
    rows = []
    for unknown in held:
        point, axis = corners[unknown // 3], np.eye(3)[unknown % 3]
        rows.append(np.concatenate([axis, np.cross(point, axis)]))
    rank = np.linalg.matrix_rank(np.array(rows).reshape(-1, 6), tol=1e-8)
    names = free_motions(corners, held)
    assert len(names) == 6 - rank
    assert len(set(names)) == len(names)


def test_without_a_matrix(monkeypatch) -> None:
    held = {"x0": (0.0, None, None), "y0": (None, 0.0, None), "z0": (None, None, 0.0)}
    problem = Elasticity(STEEL, displacement=held, traction={"x1": (1.0, 0.3, 0.0)})
    expected = elasticity.solve(problem, box((3, 2, 2), 3), "direct")
    monkeypatch.setattr(elasticity, "LARGE", 1000)
    found = elasticity.solve(problem, box((3, 2, 2), 3))
    assert found.log["preconditioner"].endswith("by components")
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.reactions["x0"], expected.reactions["x0"], atol=1e-9)
    springs = Elasticity(STEEL, displacement=held, support={"x1": Support(1.0)})
    assert elasticity.solve(springs, box((3, 2, 2), 3)).log["solver"] == "direct"
    with pytest.raises(InputError, match="needs a material without fields"):
        elasticity.solve(springs, box((3, 2, 2), 3), "matrix-free")


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (Elasticity(STEEL, displacement={"base": (0.0, 0, 0)}), "displacement: no boundary is called 'base'"),
        (
            Elasticity(STEEL, displacement={"x0": (0.0, 0, 0)}, traction={"x*": (0.0, 0, 1)}),
            "boundary 'x0' has both a displacement and a traction",
        ),
        (Elasticity(STEEL, displacement={"x0": 0.0}), "displacement on 'x0' needs three components"),
        (Elasticity(np.eye(3), displacement={"x0": (0.0, 0, 0)}), "stiffness has shape (3, 3), expected (6, 6)"),
        (Elasticity(-STEEL, displacement={"x0": (0.0, 0, 0)}), "stiffness must be positive definite"),
        (Elasticity(STEEL, support={"x0": Support(-1.0)}), "support stiffness on 'x0' = -1 must be positive"),
        (
            Elasticity(isotropic(parse("x-0.5"), 0.3), displacement={"x0": (0.0, 0, 0)}),
            "stiffness must be positive definite, its smallest eigenvalue",
        ),
    ],
)
def test_refusals(problem: Elasticity, words: str) -> None:
    with pytest.raises(InputError) as caught:
        elasticity.solve(problem, box((2, 1, 1), 1))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_modes_of_a_bar() -> None:
    C = isotropic(2.0, 0.0)
    sides = {"y?": (None, 0.0, None), "z?": (None, None, 0.0)}
    problem = Elasticity(C, displacement={"x0": (0.0, None, None), **sides}, density=3.0)
    errors = []
    for n in (2, 4):
        values, _, log = elasticity.modes(problem, box((n, 1, 1), 3, (2.0, 0.3, 0.3)), 3)
        errors.append(np.abs(values / np.array(bar_modes(2.0, 3, 2.0, 3.0)) - 1)[1])
    assert errors[1] < 1e-4
    assert np.log2(errors[0] / errors[1]) > 5.0
    assert log["residual"] < 1e-10


def test_a_free_body_has_six_modes_without_energy() -> None:
    values, shapes, _ = elasticity.modes(Elasticity(STEEL), box((2, 1, 1), 2, (2.0, 0.5, 0.3)), 8)
    assert np.abs(values[:6]).max() < 1e-9 * values[6]
    assert values[6] > 0
    assert shapes.shape[1:] == (3, 8)
