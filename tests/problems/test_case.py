"""Problem files: what they mean, what they refuse, and that damaged ones never do worse than one clear line."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iga.errors import FormatError, InputError
from problems import solve_case, solve_exact
from problems.case import read
from tests.problems.shapes import box

EXAMPLES = sorted((Path(__file__).parents[2] / "problems" / "examples").glob("*.toml"))
CUBE = box((2, 2, 2), 2)

HEAT = """
problem = "heat"
quadrature = 4
exact = "x**2 + y"
[material]
conductivity = "1 + x"
[load]
source = "-2 - 4*x"
[boundary."x?"]
temperature = "x**2 + y"
[boundary.y0]
flux = "-(1 + x)"
[boundary.y1]
convection = { coefficient = 2, ambient = "x**2 + y + (1 + x)/2" }
"""

ELASTICITY = """
problem = "elasticity"
exact = "0.2*x; -0.06*y; -0.06*z"
[material]
E = 10
nu = 0.3
[boundary.x0]
displacement = [0, "free", "free"]
[boundary.y0]
displacement = ["free", 0, "free"]
[boundary.z0]
displacement = ["free", "free", 0]
[boundary.x1]
pressure = -2
"""


def solve(tmp_path: Path, text: str):
    path = tmp_path / "case.toml"
    path.write_text(text)
    return solve_case(CUBE, path)


@pytest.mark.parametrize("path", EXAMPLES, ids=[p.stem for p in EXAMPLES])
def test_examples_are_solved(path: Path) -> None:
    solution, answer = solve_case(CUBE, path)
    assert answer["functions"] == CUBE.space.n
    assert answer["residual"] < 1e-9
    assert np.isfinite(solution.coefficients).all()


@pytest.mark.parametrize("text", [HEAT, ELASTICITY], ids=["heat", "elasticity"])
def test_meaning(tmp_path: Path, text: str) -> None:
    _, answer = solve(tmp_path, text)
    assert answer["relative_h1_error"] < 1e-12


def test_three_ways_to_give_the_stiffness(tmp_path: Path) -> None:
    from problems.material import isotropic

    rows = str(isotropic(10.0, 0.3).tolist())
    lam, mu = 10 * 0.3 / (1.3 * 0.4), 10 / 2.6
    for way in (f"stiffness = {rows}", f"lambda = {lam}\nmu = {mu}", 'E = "10 + 0*x"\nnu = 0.3'):
        _, answer = solve(tmp_path, ELASTICITY.replace("E = 10\nnu = 0.3", way))
        assert answer["relative_h1_error"] < 1e-12


def test_attributes_and_tensors(tmp_path: Path) -> None:
    domain = replace(CUBE, attributes={"k": 1 + CUBE.points[:, 0]})
    path = tmp_path / "case.toml"
    for k in ('{ attribute = "k" }', '[["1 + x", 0, 0], [0, "1 + x", 0], [0, 0, 3]]'):
        path.write_text(HEAT.replace('"1 + x"', k, 1))
        assert solve_case(domain, path)[1]["relative_h1_error"] < 1e-12


def test_transient_and_modes(tmp_path: Path) -> None:
    transient = 'problem = "heat"\nexact = "x + t"\n[load]\nsource = 1\n[boundary."*"]\ntemperature = "x + t"\n'
    transient += '[transient]\nend = 2\nsteps = 3\ninitial = "x"\nscheme = "theta"\ntheta = 1.0\n'
    solution, answer = solve(tmp_path, transient)
    assert answer["problem"] == "transient heat"
    assert answer["relative_l2_error"] < 1e-12
    solution, answer = solve(tmp_path, 'problem = "heat"\n[boundary."*"]\ntemperature = 0\n[modes]\ncount = 2\n')
    assert answer["eigenvalues"][0] == pytest.approx(3 * np.pi**2, rel=1e-2)
    assert set(solution.fields) == {"mode_1", "mode_2"}


REFUSED = [
    (HEAT, 'problem = "heat"', "", "key 'problem' is missing; there are: heat, elasticity"),
    (HEAT, '"heat"', '"magnetism"', "key 'problem' 'magnetism' is unknown"),
    (HEAT, "quadrature = 4", "quadrature = 0", "quadrature must be a whole number of at least 1, not 0"),
    (HEAT, "quadrature", "quadrture", "the file has an unknown key 'quadrture'; did you mean 'quadrature'?"),
    (HEAT, "conductivity", "E", "[material] has an unknown key 'E'; there are: conductivity, capacity"),
    (HEAT, "source", "body_force", "[load] has an unknown key 'body_force'"),
    (HEAT, "flux", "traction", "[boundary.y0] has an unknown key 'traction'"),
    (HEAT, '"1 + x"', '"1 + q"', "[material] conductivity: formula '1 + q', column 5: unknown name 'q'"),
    (HEAT, '= "x**2 + y"\n[boundary', '= "t"\n[boundary', "[boundary.x?] temperature: formula 't', column 1"),
    (HEAT, '"-2 - 4*x"', '"t"', "[load] source: formula 't', column 1: unknown name 't' (known: x, y, z, pi, e)"),
    (HEAT, '"x**2 + y"', '"t"', "formula 't', column 1: unknown name 't'"),
    (HEAT, '"1 + x"', "true", "[material] conductivity must be a number, not True"),
    (HEAT, '"1 + x"', "[1, 2]", "[material] conductivity must be 3 rows of 3"),
    (HEAT, '"1 + x"', '{ attribute = "k" }', "the domain has no attribute 'k'; there are: none"),
    (HEAT, '"1 + x"', '{ field = "k" }', "[material] conductivity has an unknown key 'field'"),
    (HEAT, "boundary.y0", "boundary.bore", "flux: no boundary is called 'bore'; there are: x0, x1, y0, y1, z0, z1"),
    (HEAT, "boundary.y0", "boundary.x0", "boundary 'x0' has both a temperature and a flux"),
    (HEAT, "coefficient = 2, ", "", "[boundary.y1] convection must be { coefficient"),
    (HEAT, "coefficient = 2", "coefficient = -2", "convection coefficient on 'y1' = -2 must be positive"),
    (HEAT, 'flux = "-(1 + x)"', "", "[boundary.y0] needs a condition: temperature, flux, convection"),
    (HEAT, "x**2 + y", "x^2 + y", "'^' is no operation here"),
    (HEAT, '[boundary."x?"]', "[boundary", "(at line 9, column 10)"),
    (HEAT, "[material]", "[transient]\nend = 1\n[material]", "[transient] needs 'steps'"),
    (HEAT, 'exact = "x**2 + y"', "exact = 3", "key 'exact' must be a formula in quotes"),
    (HEAT, 'exact = "x**2 + y"', 'solver = "magic"', "solver 'magic' is unknown; there are: auto, direct, cg"),
    (ELASTICITY, "nu = 0.3", "nu = 0.5", "nu = 0.5 is incompressible"),
    (ELASTICITY, "nu = 0.3", "", "[material] needs 'nu' beside 'E'"),
    (ELASTICITY, "nu = 0.3", "mu = 0.3", "[material] needs one of: E and nu; lambda and mu; stiffness"),
    (ELASTICITY, "E = 10\nnu = 0.3", "", "[material] needs one of"),
    (ELASTICITY, '[0, "free", "free"]', '[0, "free"]', "[boundary.x0] displacement must be a list of three values"),
    (ELASTICITY, '[0, "free", "free"]', "[0, 0, 0]\npressure = 1", "'x0' has both a displacement and a pressure"),
    (ELASTICITY, '["free", 0, "free"]', '["free", "free", 0]', "the body can move freely: translation along y"),
    (ELASTICITY, "exact = \"0.2*x; -0.06*y; -0.06*z\"", 'exact = "x"', "1 given, 3 formulas"),
    (ELASTICITY, "[boundary.x1]", "[transient]\nend = 1\n[boundary.x1]", "unknown key 'transient'"),
    (ELASTICITY, "[boundary.x1]", "[modes]\ncount = -1\n[boundary.x1]", "[modes] count must be a whole number"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "words"), REFUSED, ids=[r[3][:40] for r in REFUSED])
def test_refusals(tmp_path: Path, text: str, old: str, new: str, words: str) -> None:
    assert old in text
    with pytest.raises(InputError) as caught:
        solve(tmp_path, text.replace(old, new, 1))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    with pytest.raises(FormatError, match="No such file"):
        read(path, CUBE)
    path.write_bytes(b"\xff\xfe\x00problem")
    with pytest.raises(FormatError, match="not a text file in UTF-8"):
        read(path, CUBE)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.data())
def test_damaged_files_are_read_or_refused_in_one_line(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from([HEAT, ELASTICITY, *(p.read_text() for p in EXAMPLES)]))
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = min(len(text), start + data.draw(st.integers(0, 12)))
        text = text[:start] + data.draw(st.text(alphabet='ab01[]{}"=.,\n#-+*x\x00é', max_size=5)) + text[end:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.toml"
        path.write_text(text, encoding="utf-8")
        try:
            read(path, CUBE)
        except InputError as error:
            assert "\n" not in str(error)


def test_solvers_that_a_problem_lacks_are_refused_before_the_work() -> None:
    for physics, formula in (("heat", "x"), ("elasticity", "x;y;z")):
        for solver in ("gauss", *(("matrix-free",) if physics == "heat" else ())):
            with pytest.raises(InputError, match=f"has no solver '{solver}'; there are: auto, direct, cg"):
                solve_exact(CUBE, physics, formula, solver)
