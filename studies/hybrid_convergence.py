"""Do heat and elasticity converge at the rates of theory on a trimmed solid, and what do pyramids and layers cost?

A bent box minus another (`shapes.curved_difference`), cubic functions (p = 3), cut level by level
(`geometry.hybrid.refinement`), with exact solutions. Variants of the same solid:

    tets        triangles on the skin, Bezier tetrahedra inside
    pyramids    quadrilaterals on the skin where they are the CAD surface, a pyramid on each, tetrahedra inside
    layers      wedges under the skin's triangles, tetrahedra inside
    hb-layers   an HB-rep for skin: hexahedra under its quadrilaterals, wedges under its triangles, whose functions are
                revised B-splines and trim functions times B-splines inwards; pyramids and tetrahedra inside
    hexes       the tetrahedra turned into four hexahedra each
    part        tetrahedra in block_through_hole.step, at full size where the data folder is there

Errors are relative; ``h`` is the cube root of the volume over the number of cells of the plain tetrahedra at the same
level (of its own for ``part`` and where there are layers, whose first meshes are coarser). Rates of theory are p + 1 in
L2 and p in H1, observed over the last pair.

The rate between levels 0 and 1 falls short by about 0.7 whatever the first mesh, because what is approximated on a
cell is the solution after the cell's own cubic map, and a cell of the first mesh spans the bends of the skin beside a
trimming curve. Cutting a cell halves the first derivatives of its map and divides the second ones by four: from level 1
on maps are nearly affine, and rates are within 0.2, from level 2 on within 0.1. Layers need the third pair for that:
cells below a bent skin that tends to a mid-structure are bent in one direction more (H1, heat: 2.54, 2.83, 2.94;
elasticity: 2.34, 2.83, 2.96, whose 1.9 million unknowns are solved without a matrix in 5 GB).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, cast

import geometry
from iga.certificate import SIGN_ALONE, certify
from iga.domain import Domain, counts
from iga.progress import Progress
from problems import solve_exact
from studies.data import CAD
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, Value, numbers, table

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
PART, LENGTH = "block_through_hole.step", 25.0
"""A real part, and the length in its units by which arguments of the exact solution are divided."""
SETTINGS: dict[str, Any] = {"size": 0.3, "tolerance": 1e-3, "subdivide": 0}
VARIANTS: dict[str, dict[str, Any]] = {
    "tets": {}, "pyramids": {"skin": "hybrid"}, "layers": {"layers": 3, "size": 0.6},
    "hb-layers": {"layers": 3, "size": 0.6, "skin": "hb-rep"}, "hexes": {"convert": "hex4"},
}
LEVELS: dict[str, dict[str, tuple[int, int]]] = {
    "ci": {"tets": (3, 2), "pyramids": (2, 1), "layers": (1, 1), "hb-layers": (1, 0), "hexes": (1, 1)},
    "full": {
        "tets": (4, 4), "pyramids": (3, 3), "layers": (4, 4), "hb-layers": (3, 3), "hexes": (2, 2), "part": (3, 3),
    },
}
"""Levels for heat and for elasticity."""


def run(size: Size, progress: Progress) -> Result:
    """Solve on all variants and levels."""
    rows: list[dict[str, Value]] = []
    plain = 1.0
    for variant, levels in progress.track(LEVELS[size].items(), "variants"):
        if variant == "part" and not (CAD / PART).is_file():
            continue
        text, own = (str(CAD / PART), {}) if variant == "part" else (SOLID, SETTINGS | VARIANTS[variant])
        domain = geometry.build(text, "hybrid", **{"subdivide": 0, **own})
        if variant not in ("pyramids", "hexes"):
            h = (domain.report["cad_volume"] / sum(counts(domain).values())) ** (1.0 / 3.0)
            plain = h if variant == "tets" else plain
        else:
            h = plain
        for level in range(max(levels)):
            if level:
                domain = geometry.refine(domain)
            for (problem, formula), most in zip(EXACT.items(), levels):
                if level < most:
                    scaled = re.sub(r"\b[xyz]\b", rf"(\g<0>/{LENGTH})", formula) if variant == "part" else formula
                    rows.append(_row(variant, problem, level, domain, scaled) | {"h": h / 2.0**level})
    made = table(NAME, COLUMNS, rows, SLOPES)
    return Result(made, (Figure("rates", lambda path: _draw(path, made), "Errors on a trimmed solid"),), _said(made))


def _row(variant: str, problem: str, level: int, domain: Domain, formula: str) -> dict[str, Value]:
    _, found = solve_exact(domain, problem, formula, points=5)
    cells = counts(domain)
    return {
        "variant": variant, "problem": problem, "level": level, "cells": sum(cells.values()),
        "pyramids": cells.get("pyramid", 0), "certified": int((certify(domain, SIGN_ALONE).verdict > 0).sum()),
        "functions": domain.space.n, "l2_error": found["relative_l2_error"], "h1_error": found["relative_h1_error"],
        "l2_theory": 4, "h1_theory": 3, "seconds": found["assemble_s"] + found["solve_s"],
    }  # fmt: skip


def _said(made: Table) -> str:
    rows, rates = made.records(), made.rates()
    short = max((rate.expected - rate.last for rate in rates if rate.expected and rate.levels > 2), default=0.0)
    plain = max((r for r in rows if r["variant"] == "tets"), key=lambda r: cast(int, r["level"]))
    return (
        f"Where there are three levels or more, rates over the last pair fall short of p + 1 in L2 and p in H1 by "
        f"{short:.2f} at most; the finest tetrahedra have {plain['functions']} functions and an H1 error of "
        f"{plain['h1_error']:.1e}. Rates between the first two levels are not those of the limit."
    )


def _draw(path: Path, made: Table) -> None:
    rows = made.records()
    with drawing(path, 1, 2) as panels:
        for axes, norm, text in ((panels[0], "l2_error", "L^2"), (panels[1], "h1_error", "H^1")):
            lines = []
            for family, variant in enumerate(dict.fromkeys(r["variant"] for r in rows)):
                for problem in EXACT:
                    mine = [r for r in rows if r["variant"] == variant and r["problem"] == problem]
                    x, y = numbers(mine, "functions"), numbers(mine, norm)
                    lines.append(Series(f"{variant}, {problem}", x, y, family=family, dashed=problem != "heat"))
            convergence(axes, lines, "functions", f"relative error in ${text}$", legend=axes is panels[-1])
