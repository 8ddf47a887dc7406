"""Which orders have the two spaces on a Catmull-Clark solid, and does the extraordinary edge matter?

Heat conduction, plain control points on prisms around a straight edge of valence 3 to 8 (4 is regular) with sharp rims:

* general: a smooth exact solution that does not fit the natural ends of the splines. The subdivision space is capped at
  h^2.5 in L2 and h^1.5 in H1 by its boundary rule (second normal derivative zero), at any valence; the second space has
  h^4 and h^3, over the same volume. Also with irregular cells closed after 0, 1 and 2 subdivisions (depth).
* edge: the same solution with the second space on the cells around the edge alone, one layer, all of them irregular.
* layer (full size): the same on one layer of two cells around the edge, which has room for splines, one level more.
* ball: the same solution on the seven-block ball of Figure 7, smooth and interpolating, in both spaces.
* natural: an exact solution whose second normal derivative vanishes at the boundary, so that only the extraordinary
  edge can cost order.
* reference: the protocol of Xie et al. 2020, Figure 7: the seven-block ball, interpolating, u = 0 on its boundary, a
  source of one, levels 0 to 3 against level 4 in the subdivision space.
* centred (full size): the same with the source exp(-2 r^2).

Found at full size, last pair of levels, valences 3, 4, 5, 6, 8:

    general, subdivision space   L2 2.48 2.49 2.50 2.53 2.53     H1 1.52 1.51 1.52 1.52 1.49    the cap of the boundary
    general, second space        L2 3.69 4.08 4.45 3.84 3.88     H1 2.87 3.03 3.30 2.96 2.96    levels 0 to 2
    edge, second space           L2 3.98      3.96 3.98 3.99     H1 3.02      3.01 3.02 3.01    levels 0 to 3
    layer, second space          L2 3.95      4.23 3.96 3.97     H1 2.98      3.12 3.00 3.00    levels 0 to 3
    natural, subdivision space   L2 4.95 4.86 2.99 2.50 2.31     H1 3.50 3.56 2.10 1.74 1.59    capped by the edge
    ball, subdivision space      L2 2.53 4.38 2.76               H1 1.89 2.85 1.60              pairs 0-1, 1-2, 2-3
    ball, second space           L2 3.23 4.12 3.94               H1 2.54 3.09 3.01              pairs 0-1, 1-2, 2-3
    reference, source 1          L2 2.11 2.33 2.45               H1 1.56 1.47 1.54              pairs 0-1, 1-2, 2-3
    reference, centred           L2 4.98 2.24 2.48               H1 3.74 1.47 1.57              pairs 0-1, 1-2, 2-3

In the general problem the second space is short of order 4 at levels 0 to 2: splines take over the part of the prism
away from the edge, with fewer functions and larger errors than the Bezier functions of the zone, and the order shows
when they have several cells across. One level more has it: 3.95 and 2.97 at valence 3 (260,815 functions), and the
layer at every valence (83,545 to 356,073 functions). Depths 0, 1 and 2 differ in the fourth digit.

The printed 3.52 in L2 is no asymptotic order: the source is not given, and with a source of one no pair of levels shows
it. One straight line through levels 0 to 3 against the cube root of the number of functions, the paper's abscissa
(per_side), has the slope 3.52 for the centred source (2.61 for a source of one; 3.88 for exp(-6 r^2), not in the
table): level 0 with its eight free functions cannot see such a source, so the first pair is steep (4.98), while the
last has 2.48, the cap.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import geometry.catmull_clark as catmull_clark
from geometry.catmull_clark.shapes import ball, fan
from geometry.catmull_clark.source import stored_topology
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import INTERIOR
from iga.assembly import matrix, vector
from iga.domain import Domain
from iga.integrands import Diffusion, Load, Mass
from iga.linear.solvers import solve
from iga.pictures.plot import plot_field
from iga.progress import Progress
from problems import solve_exact
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, numbers, table

Array = NDArray[np.float64]

NAME = "catmull_clark_convergence"
COLUMNS = (
    Column("problem", "text", key=True),
    Column("space", "text", key=True),
    Column("valence", "int", key=True),
    Column("depth", "int", key=True),
    Column("level", "int", key=True),
    Column("functions", "int"),
    Column("h", format=".4f"),
    Column("per_side", format=".4f"),
    Column("l2_error", relative=1e-3, absolute=1e-12, format=".2e"),
    Column("h1_error", relative=1e-3, absolute=1e-11, format=".2e"),
    Column("l2_theory"),
    Column("h1_theory"),
    Column("seconds", "time", "s"),
)
GROUP = ("problem", "space", "valence", "depth")
SLOPES = (
    Slope("h", "l2_error", GROUP, "l2_theory"),
    Slope("h", "h1_error", GROUP, "h1_theory"),
    Slope("per_side", "l2_error", GROUP),
)
EXACT = {
    **dict.fromkeys(("general", "edge", "layer", "ball"), "sin(1.1*x+0.3)*cos(0.9*y)*exp(0.3*z)"),
    "natural": "exp(-4*(x**2+y**2))*sin(1.5707963267948966*z)",
}
THEORY = {
    ("general", "catmull_clark"): (2.5, 1.5), ("general", "optimal"): (4.0, 3.0),
    ("edge", "optimal"): (4.0, 3.0), ("layer", "optimal"): (4.0, 3.0), ("ball", "catmull_clark"): (2.5, 1.5),
    ("ball", "optimal"): (4.0, 3.0),
    ("natural", "catmull_clark"): (None, None), ("reference", "catmull_clark"): (2.5, 1.5),
    ("centred", "catmull_clark"): (2.5, 1.5),
}
"""Orders that theory allows at most; None where an extraordinary edge has no known one (4 and 3 without)."""

SIZES = {"edge": (1, 1), "layer": (1, 2)}
"""Layers of the fans and cells around their edges, where not two and two."""
SOURCES: dict[str, float | Callable[[Array], Array]] = {
    "reference": 1.0, "centred": lambda x: np.asarray(np.exp(-2.0 * (x**2).sum(axis=-1))),
}
"""Sources of the problems on the ball."""


@dataclass(frozen=True)
class Case:
    """One run of levels."""

    problem: str
    space: str
    valence: int
    depth: int
    levels: int


def _cases(size: Size) -> list[Case]:
    full = size == "full"
    valences = (3, 4, 5, 6, 8) if full else (4, 5)
    cases = [Case("general", "catmull_clark", m, 1, 4 if full else 3) for m in valences]
    # At the small size one level less off the regular mesh: all cells of the fan of 6 are irregular.
    optimal = dict.fromkeys(valences, 3) if full else {4: 3, 6: 2}
    cases += [Case("general", "optimal", m, 1, levels) for m, levels in optimal.items()]
    cases += [Case("edge", "optimal", m, 1, 4 if full else 3) for m in (3, 5, 6, 8)]
    cases += [Case("layer", "optimal", m, 1, 4) for m in valences if full and m != 4]
    cases += [Case("ball", "catmull_clark", 3, 1, 4 if full else 3), Case("ball", "optimal", 3, 1, 4 if full else 3)]
    cases += [Case("general", "catmull_clark", 5, depth, 3 if full else 2) for depth in (0, 2)]
    cases += [Case("natural", "catmull_clark", m, 1, 4 if full else 3) for m in (valences if full else (5,))]
    cases += [Case("centred", "catmull_clark", 3, 1, 4)] if full else []
    return [*cases, Case("reference", "catmull_clark", 3, 1, 4 if full else 2)]


def run(size: Size, progress: Progress) -> Result:
    """Solve all cases on their levels."""
    rows = []
    for case in progress.track(_cases(size), "Catmull-Clark solids"):
        found = _reference(case) if case.problem in SOURCES else _exact(case)
        theory = THEORY[case.problem, case.space]
        if case.problem == "natural" and case.valence == 4:
            theory = (4.0, 3.0)
        for level, row in enumerate(found):
            rows.append(
                {
                    "problem": case.problem, "space": case.space, "valence": case.valence, "depth": case.depth,
                    "level": level, "h": 0.5**level, "l2_theory": theory[0], "h1_theory": theory[1], **row,
                }
            )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    figures = (
        Figure("rates", lambda path: _draw(path, made, "catmull_clark"), "L2 and H1 errors of the subdivision space"),
        Figure("rates_optimal", lambda path: _draw(path, made, "optimal"), "L2 and H1 errors of the second space"),
        Figure("ball", _picture, "the interpolating ball with the reference solution, cut open (Figure 7)"),
    )
    return Result(made, figures, _said(made))


def _exact(case: Case) -> list[dict[str, Any]]:
    round_ = case.problem == "ball"
    shape = ball() if round_ else fan(case.valence, *SIZES.get(case.problem, (2, 2)))
    settings = catmull_clark.Settings(
        space=case.space, interpolate="pia" if round_ else "none", features="none" if round_ else "auto",
        depth=case.depth,
    )  # fmt: skip
    domain = catmull_clark.domain_of(catmull_clark.hex_mesh(*shape), settings)
    rows = []
    for level in range(case.levels):
        domain = catmull_clark.refine(domain) if level else domain
        _, found = solve_exact(domain, "heat", EXACT[case.problem])
        rows.append(
            {
                "functions": domain.space.n, "l2_error": found["relative_l2_error"],
                "h1_error": found["relative_h1_error"], "seconds": found["assemble_s"] + found["solve_s"],
            }
        )  # fmt: skip
    return rows


def _reference(case: Case) -> list[dict[str, Any]]:
    """Errors of the levels against one more level, where all of them are written (the spaces are nested)."""
    settings = catmull_clark.Settings(interpolate="pia", features="none", depth=case.depth)
    domain = catmull_clark.domain_of(catmull_clark.hex_mesh(*ball()), settings)
    solutions: list[Array] = []
    sizes, seconds = [], []
    for level in range(case.levels + 1):
        if level:
            S = subdivide(stored_topology(domain))[1]
            domain = catmull_clark.refine(domain)
            solutions = [S @ u for u in solutions]
        start = time.perf_counter()
        solutions.append(_held_at_zero(domain, SOURCES[case.problem]))
        sizes.append(domain.space.n)
        seconds.append(time.perf_counter() - start)
    M, K = matrix(domain, Mass(1.0)), matrix(domain, Diffusion(1.0))
    best = solutions[-1]

    def norm(u: Array) -> tuple[float, float]:
        mass = float(u @ (M @ u))
        return np.sqrt(mass), np.sqrt(mass + float(u @ (K @ u)))

    whole = norm(best)
    rows = []
    for u, n, t in zip(solutions[:-1], sizes, seconds):
        off = norm(u - best)
        rows.append(
            {
                "functions": n, "per_side": n ** (-1 / 3), "l2_error": off[0] / whole[0], "h1_error": off[1] / whole[1],
                "seconds": t,
            }
        )  # fmt: skip
    return rows


def _held_at_zero(domain: Domain, source: float | Callable[[Array], Array] = 1.0) -> Array:
    """Solution for a source and zero on the boundary: by coefficients, because nothing inside acts on it.

    (Projecting onto the boundary would need independent functions there; those of the cube's surface are not.)
    """
    outer = np.flatnonzero(stored_topology(domain).vertex_kind < INTERIOR)
    K, f = matrix(domain, Diffusion(1.0)), vector(domain, Load(source))
    return np.asarray(solve(K, f, fixed=(outer, np.zeros(len(outer))), domain=domain)[0])


def _said(made: Table) -> str:
    """Rates over the last pair of levels, by problem and space."""
    parts = []
    for problem, space in THEORY:
        mine = [r for r in made.rates() if (dict(r.group)["problem"], dict(r.group)["space"]) == (problem, space)]
        for norm, text in (("l2_error", "L2"), ("h1_error", "H1")):
            last = [rate.last for rate in mine if (rate.x, rate.y) == ("h", norm)]
            if last:
                parts.append(f"{problem}, {space} {text} {min(last):.2f} to {max(last):.2f}")
    lines = [
        f"{dict(rate.group)['problem']} {rate.fit:.2f} (last pair {rate.last:.2f})"
        for rate in made.rates() if rate.x == "per_side"
    ]
    paper = f" One line through all levels in L2 against the cube root of the functions: {', '.join(lines)}."
    return (
        f"Rates over the last pair of levels, all valences and depths: {'; '.join(parts)}. The protocol of the paper "
        "(its 3.52 in L2, source not given) shows the cap of the boundary rule; orders near 4 need a solution that "
        "fits the natural ends, as the natural problem does." + (paper if lines else "")
    )


def _picture(path: Path) -> None:
    settings = catmull_clark.Settings(interpolate="pia", features="none", depth=1)
    domain = catmull_clark.refine(catmull_clark.domain_of(catmull_clark.hex_mesh(*ball()), settings), 2)
    plot_field(domain, _held_at_zero(domain), "temperature", path, cut="-y", size=760)


def _draw(path: Path, made: Table, space: str) -> None:
    """Errors of one space; one colour for each valence and each problem on the ball."""
    rows: list[dict[str, Any]] = made.records()
    with drawing(path, 1, 2) as panels:
        for axes, norm, text in ((panels[0], "l2_error", "L^2"), (panels[1], "h1_error", "H^1")):
            lines = []
            for (problem, own), rates in THEORY.items():
                some = [row for row in rows if (row["problem"], row["space"]) == (problem, space) and own == space]
                for valence in sorted({row["valence"] for row in some}):
                    mine = [row for row in some if row["valence"] == valence and row["depth"] <= 1]
                    depth = max(row["depth"] for row in mine)
                    mine = [row for row in mine if row["depth"] == depth]
                    h, error = numbers(mine, "h"), numbers(mine, norm)
                    rate = rates[norm == "h1_error"] if (problem, valence) == ("general", 4) else None
                    on_ball = problem in ("ball", "reference", "centred")
                    label = problem if on_ball else f"{problem}, valence {valence}"
                    family = None if on_ball else valence + 10 * (problem == "layer")
                    lines.append(Series(label, h, error, rate, family=family, dashed=problem in ("natural", "edge")))
            convergence(axes, lines, "$h$", f"relative error in ${text}$", legend=axes is panels[-1])
