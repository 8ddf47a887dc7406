"""Which orders have the two spaces on a Catmull-Clark solid, and does the extraordinary edge matter?

Heat conduction with a smooth exact solution that does not fit the natural ends of the splines, on prisms around a
straight edge of valence 3 to 8 (4 is regular) with sharp rims, plain control points. The subdivision space is capped at
h^2.5 in L2 and h^1.5 in H1 by its boundary rule (second normal derivative zero), at any valence; the second space has
h^4 and h^3, over the same volume.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geometry.catmull_clark as catmull_clark
from geometry.catmull_clark.shapes import fan
from iga.progress import Progress
from problems import solve_exact
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, table

NAME = "catmull_clark_convergence"
COLUMNS = (
    Column("space", "text", key=True),
    Column("valence", "int", key=True),
    Column("level", "int", key=True),
    Column("functions", "int"),
    Column("h", format=".4f"),
    Column("l2_error", relative=1e-3, absolute=1e-12, format=".2e"),
    Column("h1_error", relative=1e-3, absolute=1e-11, format=".2e"),
    Column("l2_theory"),
    Column("h1_theory"),
    Column("seconds", "time", "s"),
)
SLOPES = (
    Slope("h", "l2_error", ("space", "valence"), "l2_theory"),
    Slope("h", "h1_error", ("space", "valence"), "h1_theory"),
)
EXACT = "sin(1.1*x+0.3)*cos(0.9*y)*exp(0.3*z)"
THEORY = {"catmull_clark": (2.5, 1.5), "optimal": (4.0, 3.0)}
LEVELS = {"ci": {"catmull_clark": 3, "optimal": 3}, "full": {"catmull_clark": 4, "optimal": 3}}


def run(size: Size, progress: Progress) -> Result:
    """Solve on all valences, spaces and levels."""
    valences = (4, 5) if size == "ci" else (3, 4, 5, 6, 8)
    rows = []
    for space, valence in progress.track([(s, m) for s in THEORY for m in valences], "Catmull-Clark solids"):
        mesh = catmull_clark.hex_mesh(*fan(valence, 2, 2))
        settings = catmull_clark.Settings(space=space, interpolate="none", depth=1)
        domain = catmull_clark.domain_of(mesh, settings)
        for level in range(LEVELS[size][space]):
            domain = catmull_clark.refine(domain) if level else domain
            _, found = solve_exact(domain, "heat", EXACT)
            rows.append(
                {
                    "space": space, "valence": valence, "level": level, "functions": domain.space.n, "h": 0.5**level,
                    "l2_error": found["relative_l2_error"], "h1_error": found["relative_h1_error"],
                    "l2_theory": THEORY[space][0], "h1_theory": THEORY[space][1],
                    "seconds": found["assemble_s"] + found["solve_s"],
                }
            )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    return Result(made, (Figure("rates", lambda path: _draw(path, made), "L2 and H1 errors"),), _said(made))


def _said(made: Table) -> str:
    """Rates over the last pair of levels, by space."""
    parts = []
    for space in THEORY:
        mine = [rate for rate in made.rates() if dict(rate.group)["space"] == space]
        for norm, text in (("l2_error", "L2"), ("h1_error", "H1")):
            last = [rate.last for rate in mine if rate.y == norm]
            parts.append(f"{space} {text} {min(last):.2f} to {max(last):.2f}")
    return "Rates over the last pair of levels, all valences: " + ", ".join(parts) + "."


def _draw(path: Path, made: Table) -> None:
    names = [column.name for column in made.columns]
    rows: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in made.rows]
    with drawing(path, 1, 2) as panels:
        for axes, norm, text in ((panels[0], "l2_error", "L^2"), (panels[1], "h1_error", "H^1")):
            lines = []
            for space, rates in THEORY.items():
                for valence in sorted({row["valence"] for row in rows}):
                    mine = [row for row in rows if row["space"] == space and row["valence"] == valence]
                    h, error = [row["h"] for row in mine], [row[norm] for row in mine]
                    rate = rates[norm == "h1_error"] if valence == 4 else None
                    dashed = space == "optimal"
                    lines.append(Series(f"{space}, valence {valence}", h, error, rate, family=valence, dashed=dashed))
            convergence(axes, lines, "$h$", f"relative error in ${text}$", legend=axes is panels[-1])
