"""Do heat and elasticity converge at the rates of theory on a trimmed solid, and what do pyramids and layers cost?

A bent box minus another (`shapes.curved_difference`), cubic functions (p = 3), cut level by level
(`geometry.hybrid.refinement`), with exact solutions. Variants of the same solid:

    tets        triangles on the skin, Bezier tetrahedra inside
    pyramids    quadrilaterals on the skin where they are the CAD surface, a pyramid on each, tetrahedra inside
    layers      wedges under the skin's triangles, tetrahedra inside
    hexes       the tetrahedra turned into four hexahedra each

Errors are relative; ``h`` is the cube root of the volume over the number of cells of the plain tetrahedra at the same
level. Rates of theory are p + 1 in L2 and p in H1, observed over the last pair.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import geometry
from iga.certificate import certify
from iga.domain import Domain, counts
from iga.progress import Progress
from problems import solve_exact
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, Value, table

NAME = "hybrid_convergence"
COLUMNS = (
    Column("variant", "text", key=True),
    Column("problem", "text", key=True),
    Column("level", "int", key=True),
    Column("cells", "int", relative=0.1),
    Column("pyramids", "int", relative=0.1),
    Column("certified", "int", relative=0.1),
    Column("functions", "int", relative=0.1),
    Column("h", format=".4f"),
    Column("l2_error", relative=0.3, absolute=1e-9, format=".2e"),
    Column("h1_error", relative=0.3, absolute=1e-9, format=".2e"),
    Column("l2_theory", "int"),
    Column("h1_theory", "int"),
    Column("seconds", "time", "s"),
)
SLOPES = (
    Slope("h", "l2_error", ("variant", "problem"), "l2_theory", 2),
    Slope("h", "h1_error", ("variant", "problem"), "h1_theory", 2),
)
EXACT = {
    "heat": "sin(x)*cos(0.7*y)*exp(0.3*z)",
    "elasticity": "sin(x)*cos(1.3*y);exp(0.5*x)*sin(z);cos(y)*sin(1.2*z)",
}
SOLID = "curved_difference"
SETTINGS: dict[str, Any] = {"size": 0.5, "tolerance": 1e-3, "subdivide": 0}
VARIANTS: dict[str, dict[str, Any]] = {
    "tets": {}, "pyramids": {"skin": "hybrid"}, "layers": {"layers": 3}, "hexes": {"convert": "hex4"},
}


def run(size: Size, progress: Progress) -> Result:
    """Solve on all variants and levels."""
    rows: list[dict[str, Value]] = []
    volume: float | None = None
    for variant, own in progress.track(VARIANTS.items(), "variants"):
        domain = geometry.build(SOLID, "hybrid", **SETTINGS, **own)
        levels = (1 if variant in ("hexes", "layers") else 2) if size == "ci" else (2 if variant == "hexes" else 3)
        for level in range(levels):
            if level:
                domain = geometry.refine(domain)
            volume = volume or float(domain.report["cad_volume"])
            for problem, formula in EXACT.items():
                if problem == "heat" or size == "full" or level == 0:
                    rows.append(_row(variant, problem, level, domain, formula))
    first = next(r for r in rows if r["variant"] == "tets")
    h = (cast(float, volume) / cast(int, first["cells"])) ** (1.0 / 3.0)
    for row in rows:
        row["h"] = h / 2.0 ** cast(int, row["level"])
    made = table(NAME, COLUMNS, rows, SLOPES)
    return Result(made, (Figure("rates", lambda path: _draw(path, made), "Errors on a trimmed solid"),), _said(made))


def _row(variant: str, problem: str, level: int, domain: Domain, formula: str) -> dict[str, Value]:
    _, found = solve_exact(domain, problem, formula, points=5)
    cells = counts(domain)
    return {
        "variant": variant, "problem": problem, "level": level, "cells": sum(cells.values()),
        "pyramids": cells.get("pyramid", 0), "certified": int((certify(domain, 1e9).verdict > 0).sum()),
        "functions": domain.space.n, "l2_error": found["relative_l2_error"], "h1_error": found["relative_h1_error"],
        "l2_theory": 4, "h1_theory": 3, "seconds": found["assemble_s"] + found["solve_s"],
    }  # fmt: skip


def _said(made: Table) -> str:
    names = [column.name for column in made.columns]
    rows = [dict(zip(names, row)) for row in made.rows]
    rates = made.rates()
    if not rates:
        return "One level alone: no rates."
    short = max(rate.expected - rate.last for rate in rates if rate.expected is not None)
    plain = max((r for r in rows if r["variant"] == "tets"), key=lambda r: cast(int, r["level"]))
    return (
        f"Over the last pair of levels rates fall short of p + 1 in L2 and p in H1 by {short:.2f} at most; the finest "
        f"tetrahedra have {plain['functions']} functions and an H1 error of {plain['h1_error']:.1e}."
    )


def _draw(path: Path, made: Table) -> None:
    names = [column.name for column in made.columns]
    rows = [dict(zip(names, row, strict=True)) for row in made.rows]
    with drawing(path, 1, 2) as panels:
        for axes, norm, text in ((panels[0], "l2_error", "L^2"), (panels[1], "h1_error", "H^1")):
            lines = []
            for family, variant in enumerate(VARIANTS):
                for problem in EXACT:
                    mine = [r for r in rows if r["variant"] == variant and r["problem"] == problem]
                    x = [cast(float, r["functions"]) for r in mine]
                    y = [cast(float, r[norm]) for r in mine]
                    lines.append(Series(f"{variant}, {problem}", x, y, family=family, dashed=problem != "heat"))
            convergence(axes, lines, "functions", f"relative error in ${text}$", legend=axes is panels[-1])
