"""Do B-splines and NURBS of every degree converge at the rates of theory?

Heat conduction with a smooth manufactured solution, degree p = 1..5 in all directions, maximal smoothness inside a
patch: L2 rate p + 1, H1 rate p. On the cube with the curved interior map of the performance problems (straight for p =
1, which cannot carry the map) and, from p = 2, on a quarter of a thick ring, whose circles are exact only as rational
splines.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import geometry
from iga.domain import Domain
from iga.progress import Progress
from problems import solve_exact
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, numbers, table

NAME = "nurbs_convergence"
COLUMNS = (
    Column("solid", "text", key=True),
    Column("degree", "int", key=True),
    Column("level", "int", key=True),
    Column("elements", "int"),
    Column("functions", "int"),
    Column("h", format=".4f"),
    Column("l2_error", relative=1e-3, absolute=1e-12, format=".2e"),
    Column("h1_error", relative=1e-3, absolute=1e-11, format=".2e"),
    Column("l2_theory", "int"),
    Column("h1_theory", "int"),
    Column("seconds", "time", "s"),
)
SLOPES = (
    Slope("h", "l2_error", ("solid", "degree"), "l2_theory"),
    Slope("h", "h1_error", ("solid", "degree"), "h1_theory"),
)
EXACT = {"cube": "sin(2*x)*cos(1.5*y)*exp(z)", "ring": "sin(x)*cos(y)*exp(0.5*z)"}
DEGREES = range(1, 6)
FULL = (2, 4, 8, 16)
CI = {1: (2, 4, 8), 2: (2, 4, 8), 3: (2, 4, 8), 4: (2, 4), 5: (2, 4)}


def run(size: Size, progress: Progress) -> Result:
    """Solve on all degrees and levels."""
    levels = CI if size == "ci" else dict.fromkeys(DEGREES, FULL)
    cases = [(solid, p, n) for solid in EXACT for p in DEGREES for n in levels[p] if solid == "cube" or p > 1]
    rows = []
    for solid, p, n in progress.track(cases, "splines"):
        domain = _domain(solid, p, n)
        _, found = solve_exact(domain, "heat", EXACT[solid])
        rows.append(
            {
                "solid": solid, "degree": p, "level": int(np.log2(n)), "h": 1.0 / n, "functions": domain.space.n,
                "elements": domain.space.elements,
                "l2_error": found["relative_l2_error"], "h1_error": found["relative_h1_error"], "l2_theory": p + 1,
                "h1_theory": p, "seconds": found["assemble_s"] + found["solve_s"],
            }
        )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    short = max(rate.expected - rate.last for rate in made.rates() if rate.expected is not None)
    said = f"fall short of theory by {short:.2f} at most" if short > 0 else "are those of theory or better"
    summary = f"Over the last pair of levels the rates {said} (p + 1 in L2, p in H1)."
    return Result(made, (Figure("rates", lambda path: _draw(path, made), "L2 and H1 errors"),), summary)


def _domain(solid: str, degree: int, n: int) -> Domain:
    """Degree in all directions, n elements along each."""
    if solid == "ring":
        return geometry.build("thick_ring", "nurbs", degree=degree, refine=int(np.log2(n)))
    return geometry.build("cube" if degree == 1 else "bench_cube", "nurbs", degree=degree, elements=n)


def _draw(path: Path, made: Table) -> None:
    rows = made.records()
    with drawing(path, 1, 2) as panels:
        for axes, norm, text in ((panels[0], "l2_error", "L^2"), (panels[1], "h1_error", "H^1")):
            lines = []
            for solid in EXACT:
                for p in DEGREES:
                    own = [row for row in rows if (row["solid"], row["degree"]) == (solid, p)]
                    h, error = numbers(own, "h"), numbers(own, norm)
                    rate = float(p + (norm == "l2_error")) if solid == "cube" else None
                    lines.append(Series(f"{solid} $p={p}$", h, error, rate, family=p, dashed=solid == "ring"))
            convergence(axes, lines, "$h$", f"relative error in ${text}$", legend=axes is panels[-1])
