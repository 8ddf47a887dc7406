r"""Cases: a problem written down in a TOML file.

A value is a number, a formula in x, y, z (and t where time runs) in quotes, or an attribute of the domain,
``{ attribute = "name" }``. Vectors are lists of three; ``"free"`` leaves a component of a displacement free.

Heat::

    problem = "heat"
    solver = "auto"                     # or "direct", "cg", for elasticity "matrix-free"; optional
    quadrature = 4                      # Gauss points per direction; optional
    exact = "1 + x"                     # only to measure the error; optional

    [material]
    conductivity = 2.0                  # or a formula, an attribute, three rows of three numbers or formulas
    capacity = 1.0                      # density times specific heat, for transient cases and modes (default 1)

    [load]
    source = "10*sin(pi*x)"             # heat per volume

    [boundary.inner]                    # a name, or a pattern in quotes: [boundary."side_*"]
    temperature = 100
    [boundary.outer]
    convection = { coefficient = 5, ambient = 20 }
    flux = 3                            # heat that enters, per area; boundaries not named are insulated

    [transient]                         # instead of the steady state
    end = 2.0
    steps = 40
    scheme = "bdf2"                     # or "theta"
    theta = 0.5                         # 0.5 (second order) to 1
    initial = 20                        # temperature at time 0

    [modes]                             # instead: lowest eigenpairs, for elasticity squares of angular frequencies
    count = 6

Elasticity::

    problem = "elasticity"

    [material]                          # E and nu, or lambda and mu, or stiffness (six rows, Voigt xx yy zz yz xz xy)
    E = 210e3
    nu = 0.3
    expansion = 1.2e-5                  # thermal strain per degree
    density = 7.8e-9                    # for modes (default 1)

    [load]
    body_force = [0, 0, -9.81]
    temperature = "20*z"                # rise above the stress-free temperature

    [boundary.base]
    displacement = [0, 0, 0]            # held; [0, "free", "free"] is a roller
    [boundary.side]
    normal_displacement = 0             # slides without friction along the surface, also a curved one
    [boundary.top]
    traction = [0, 0, "x"]              # force per area
    pressure = 10                       # against the outward normal
    support = { stiffness = 1e4, normal = true }    # elastic: along the normal, or (normal = false) all directions
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iga.domain import Domain
from iga.errors import FormatError, InputError
from iga.field import attribute
from problems import elasticity, heat, material
from problems.formula import Formula, from_array, parse_expression, parse_vector
from problems.formula import parse as parse_formula
from problems.solution import Quantity, Solution, primary

KEYS = {
    "heat": {
        "": ("problem", "solver", "quadrature", "exact", "material", "load", "boundary", "transient", "modes"),
        "material": ("conductivity", "capacity"),
        "load": ("source",),
        "boundary": ("temperature", "flux", "convection"),
        "convection": ("coefficient", "ambient"),
        "transient": ("end", "steps", "scheme", "theta", "initial"),
        "modes": ("count",),
    },
    "elasticity": {
        "": ("problem", "solver", "quadrature", "exact", "material", "load", "boundary", "modes"),
        "material": ("E", "nu", "lambda", "mu", "stiffness", "expansion", "density"),
        "load": ("body_force", "temperature"),
        "boundary": ("displacement", "normal_displacement", "traction", "pressure", "support"),
        "support": ("stiffness", "normal"),
        "modes": ("count",),
    },
}
SPACE, SPACE_TIME = ("x", "y", "z"), ("x", "y", "z", "t")


@dataclass(frozen=True, eq=False)
class Case:
    """A problem with the settings of its solution."""

    problem: heat.Heat | elasticity.Elasticity
    solver: str = "auto"
    quadrature: int | None = None
    exact: Formula | None = None
    transient: Mapping[str, Any] | None = None
    modes: int | None = None


def read(path: str | Path, domain: Domain) -> Case:
    """Read a case for a domain (whose attributes it may name).

    Raises
    ------
    FormatError
        The file is not TOML.
    InputError
        In one line: an unknown key, a missing or wrong value, a formula that cannot be read, an unknown attribute.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FormatError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{path}: {str(error).splitlines()[0]}") from None
    try:
        return make(table, domain)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def make(table: Mapping[str, Any], domain: Domain) -> Case:
    """Make a case of the tables of a file."""
    physics = table.get("problem")
    if physics not in KEYS:
        given = "is missing" if physics is None else f"{physics!r} is unknown"
        raise InputError(f"key 'problem' {given}; there are: {', '.join(KEYS)}")
    keys = KEYS[physics]
    known(table, keys[""], "the file")
    sections = {name: section(table, name) for name in ("material", "load", "boundary", "transient", "modes")}
    for name in ("material", "load", "transient", "modes"):
        known(sections[name], keys.get(name, ()), f"[{name}]")
    for name, conditions in sections["boundary"].items():
        if not isinstance(conditions, dict) or not conditions:
            raise InputError(f"[boundary.{name}] needs a condition: {', '.join(keys['boundary'])}")
        known(conditions, keys["boundary"], f"[boundary.{name}]")
    if sections["transient"] and sections["modes"]:
        raise InputError("[transient] and [modes] exclude each other")
    variables = SPACE_TIME if "transient" in table else SPACE
    exact = table.get("exact")
    if exact is not None and not isinstance(exact, str):
        raise InputError("key 'exact' must be a formula in quotes")
    solver = table.get("solver", "auto")
    solvers = heat.SOLVERS if physics == "heat" else elasticity.SOLVERS
    if solver not in solvers:
        raise InputError(f"solver {solver!r} is unknown; there are: {', '.join(solvers)}")
    return Case(
        read_heat(sections, domain, variables) if physics == "heat" else read_elasticity(sections, domain),
        solver,
        positive_integer(table["quadrature"], "quadrature") if "quadrature" in table else None,
        None if exact is None else parse_vector(exact, 1 if physics == "heat" else 3, variables),
        read_transient(sections["transient"], domain) if "transient" in table else None,
        positive_integer(sections["modes"].get("count", 6), "[modes] count") if "modes" in table else None,
    )


def solve_case(
    domain: Domain, path: str | Path, solver: str | None = None, points: int | None = None
) -> tuple[Solution, dict[str, Any]]:
    """Read a case and solve it; return the solution and its summary. ``solver`` and ``points`` override the file's."""
    solution = solve(domain, read(path, domain), solver, points)
    return solution, solution.summary()


def solve(domain: Domain, case: Case, solver: str | None = None, points: int | None = None) -> Solution:
    """Solve a case: steady, transient or modes."""
    solver, points = solver or case.solver, case.quadrature if points is None else points
    physics: Any = heat if isinstance(case.problem, heat.Heat) else elasticity
    if case.modes is not None:
        return mode_solution(domain, case, physics, points)
    if case.transient is not None and isinstance(case.problem, heat.Heat):
        solution = heat.march(case.problem, domain, **case.transient, solver=solver, points=points, keep=False)
    else:
        solution = physics.solve(case.problem, domain, solver, points)
    return solution if case.exact is None else solution.compared(case.exact, points)


def mode_solution(domain: Domain, case: Case, physics: Any, points: int | None) -> Solution:
    """Return the modes as quantities mode_1, mode_2, ... with the eigenvalues in the log."""
    values, shapes, log = physics.modes(case.problem, domain, case.modes, points)
    quantities: dict[str, Quantity] = {f"mode_{k + 1}": primary(shapes[..., k].copy()) for k in range(len(values))}
    name = "heat modes" if physics is heat else "elasticity modes"
    return Solution(domain, name, shapes[..., 0].copy(), quantities, {**log, "eigenvalues": values.tolist()})


# --- the two physics -------------------------------------------------------------------------------------------------


def read_heat(sections: Mapping[str, Any], domain: Domain, variables: tuple[str, ...]) -> heat.Heat:
    """Read the tables of a heat problem; loads and conditions may vary with these variables."""
    of_material, load = sections["material"], sections["load"]
    data: dict[str, dict[str, Any]] = {"temperature": {}, "flux": {}, "convection": {}}
    for name, conditions in sections["boundary"].items():
        for kind, value in conditions.items():
            where = f"[boundary.{name}] {kind}"
            if kind == "convection":
                if not isinstance(value, dict) or "coefficient" not in value:
                    raise InputError(f"{where} must be {{ coefficient = ..., ambient = ... }}")
                known(value, KEYS["heat"]["convection"], where)
                value = heat.Convection(
                    scalar(value["coefficient"], f"{where} coefficient", domain, SPACE),
                    scalar(value.get("ambient", 0.0), f"{where} ambient", domain, variables),
                )
            else:
                value = scalar(value, where, domain, variables)
            data[kind][name] = value
    conductivity = of_material.get("conductivity", 1.0)
    if isinstance(conductivity, list):
        conductivity = square(conductivity, 3, "[material] conductivity")
    else:
        conductivity = scalar(conductivity, "[material] conductivity", domain, SPACE)
    return heat.Heat(
        conductivity,
        scalar(load.get("source", 0.0), "[load] source", domain, variables),
        data["temperature"],
        data["flux"],
        data["convection"],
        scalar(of_material.get("capacity", 1.0), "[material] capacity", domain, SPACE),
    )


def read_transient(table: Mapping[str, Any], domain: Domain) -> dict[str, Any]:
    """Read the section of a transient heat problem."""
    for key in ("end", "steps", "initial"):
        if key not in table:
            raise InputError(f"[transient] needs '{key}'")
    return {
        "initial": scalar(table["initial"], "[transient] initial", domain, SPACE),
        "end": material.number(table["end"], "[transient] end"),
        "steps": positive_integer(table["steps"], "[transient] steps"),
        "scheme": table.get("scheme", "bdf2"),
        "theta": material.number(table.get("theta", 0.5), "[transient] theta"),
    }


def read_elasticity(sections: Mapping[str, Any], domain: Domain) -> elasticity.Elasticity:
    """Read the tables of an elasticity problem."""
    of_material, load = sections["material"], sections["load"]
    data: dict[str, dict[str, Any]] = {kind: {} for kind in KEYS["elasticity"]["boundary"]}
    for name, conditions in sections["boundary"].items():
        for kind, value in conditions.items():
            where = f"[boundary.{name}] {kind}"
            if kind == "support":
                if not isinstance(value, dict) or "stiffness" not in value:
                    raise InputError(f"{where} must be {{ stiffness = ..., normal = true or false }}")
                known(value, KEYS["elasticity"]["support"], where)
                if not isinstance(value.get("normal", False), bool):
                    raise InputError(f"{where} normal must be true or false")
                stiffness = scalar(value["stiffness"], f"{where} stiffness", domain, SPACE)
                value = elasticity.Support(stiffness, value.get("normal", False))
            elif kind in ("pressure", "normal_displacement"):
                value = scalar(value, where, domain, SPACE)
            else:
                value = vector(value, where, domain, kind == "displacement")
            data[kind][name] = value
    expansion = of_material.get("expansion", 0.0)
    if isinstance(expansion, list):
        expansion = [material.number(value, "[material] expansion") for value in expansion]
    else:
        expansion = material.number(expansion, "[material] expansion")
    return elasticity.Elasticity(
        read_stiffness(of_material, domain),
        vector(load.get("body_force", [0, 0, 0]), "[load] body_force", domain),
        data["displacement"],
        data["traction"],
        data["pressure"],
        data["support"],
        expansion,
        scalar(load.get("temperature", 0.0), "[load] temperature", domain, SPACE),
        scalar(of_material.get("density", 1.0), "[material] density", domain, SPACE),
        data["normal_displacement"],
    )


def read_stiffness(table: Mapping[str, Any], domain: Domain) -> Any:
    """Read the elastic constants: exactly one of the three ways to give them."""
    given = [names for names in (("E", "nu"), ("lambda", "mu"), ("stiffness",)) if any(name in table for name in names)]
    if len(given) != 1:
        raise InputError("[material] needs one of: E and nu; lambda and mu; stiffness")
    if given[0] == ("stiffness",):
        return square(table["stiffness"], 6, "[material] stiffness")
    for name in given[0]:
        if name not in table:
            raise InputError(f"[material] needs '{name}' beside '{next(n for n in given[0] if n != name)}'")
    make_stiffness = material.isotropic if given[0] == ("E", "nu") else material.lame
    return make_stiffness(*(scalar(table[name], f"[material] {name}", domain, SPACE) for name in given[0]))


# --- values ----------------------------------------------------------------------------------------------------------


def section(table: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a table of the file, empty if it is not there."""
    value = table.get(name, {})
    if not isinstance(value, dict):
        raise InputError(f"'{name}' must be a table: [{name}]")
    return value


def known(table: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    """Raise on the first key that is not known, with the nearest that is."""
    for key in table:
        if key not in keys:
            near = difflib.get_close_matches(key, keys, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(keys) or 'none'}"
            raise InputError(f"{where} has an unknown key '{key}'; {hint}")


def scalar(value: Any, where: str, domain: Domain, variables: tuple[str, ...]) -> Any:
    """Return a number, formula or attribute."""
    if isinstance(value, str):
        try:
            return parse_formula(value, variables)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    if isinstance(value, dict):
        known(value, ("attribute",), where)
        if not isinstance(value.get("attribute"), str):
            raise InputError(f"{where} needs the name of an attribute")
        return attribute(domain, value["attribute"])
    return material.number(value, where)


def vector(value: Any, where: str, domain: Domain, free: bool = False) -> Any:
    """Return three numbers or formulas (None for "free"), or an attribute."""
    if isinstance(value, dict):
        return scalar(value, where, domain, SPACE)
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{where} must be a list of three values")
    return tuple(None if free and part == "free" else scalar(part, where, domain, SPACE) for part in value)


def square(value: Any, size: int, where: str) -> Any:
    """Return a (size, size) array, or a formula of that shape if any entry is one."""
    if (
        not isinstance(value, list)
        or any(not isinstance(row, list) or len(row) != size for row in value)
        or len(value) != size
    ):
        raise InputError(f"{where} must be {size} rows of {size}")
    if not any(isinstance(entry, str) for row in value for entry in row):
        return material.tensor([[material.number(entry, where) for entry in row] for row in value], size, where)
    try:
        entries = [
            [
                parse_expression(entry, SPACE)
                if isinstance(entry, str)
                else material.symbolic(material.number(entry, where))
                for entry in row
            ]
            for row in value
        ]
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return from_array(np.array(entries, dtype=object), where)


def positive_integer(value: Any, where: str) -> int:
    """Return an integer of at least 1."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"{where} must be a whole number of at least 1, not {value!r}")
    return value
