"""Bezier tetrahedra or the hexahedra made of them: who solves the same problem better?

Heat conduction with a smooth manufactured solution on a curved cube. Each level is one mesh of degree-p tetrahedra,
solved as it stands and as four hexahedra per tetrahedron (Theorem 3), which are the same solid to round-off. Compared
are the error against the number of functions and against the seconds to assemble and solve (default rules, default
solver, two threads; times depend on the machine and are never held against the baseline).
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from geometry.tets import domain_of, shapes
from iga.progress import Progress
from problems import solve_exact
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, Value, numbers, table

Array = NDArray[np.float64]

NAME = "tets_versus_hexes"
COLUMNS = (
    Column("cells", "text", key=True),
    Column("degree", "int", key=True),
    Column("level", "int", key=True),
    Column("elements", "int"),
    Column("functions", "int"),
    Column("h", format=".3f"),
    Column("l2_error", relative=1e-3, format=".2e"),
    Column("h1_error", relative=1e-3, format=".2e"),
    Column("l2_theory", "int"),
    Column("h1_theory", "int"),
    Column("assemble", "time", "s"),
    Column("solve", "time", "s"),
    Column("total", "time", "s"),
)
SLOPES = (
    Slope("h", "l2_error", ("cells", "degree"), "l2_theory"),
    Slope("h", "h1_error", ("cells", "degree"), "h1_theory"),
)
EXACT = "sin(2*x)*cos(y)*exp(z)"
CELLS = {"tets": "none", "hexes": "hex4"}
LEVELS: dict[str, dict[int, tuple[int, ...]]] = {
    "ci": {1: (2, 4, 6), 2: (1, 2, 4), 3: (1, 2, 3), 4: (1, 2)},
    "full": {1: (2, 4, 8, 16), 2: (2, 4, 6, 8), 3: (1, 2, 4, 6), 4: (1, 2, 3, 4)},
}
"""Cells of the cube along a side: so that the hexahedra of the last level have about 1e5 functions at full size."""


def bent(x: Array) -> Array:
    """Curve the cube gently, without symmetry."""
    return x + 0.1 * np.sin(2.0 * x[..., [1, 2, 0]])


def run(size: Size, progress: Progress) -> Result:
    """Solve on all degrees and levels, on both kinds of cells."""
    _solve(1, 1, "tets")  # compilation is no part of the times
    _solve(1, 1, "hexes")
    cases = [(p, k, n, cells) for p, ns in LEVELS[size].items() for k, n in enumerate(ns) for cells in CELLS]
    rows = [_row(*case) for case in progress.track(cases, "tets and hexes")]
    rows.sort(key=lambda r: (r["cells"] == "hexes", cast(int, r["degree"]), cast(int, r["level"])))
    made = table(NAME, COLUMNS, rows, SLOPES)
    figures = (
        Figure("functions", lambda path: _draw(path, made, "functions", "functions"), "Error against functions."),
        Figure("seconds", lambda path: _draw(path, made, "total", "seconds"), "Error against seconds to solution."),
    )
    return Result(made, figures, _verdict(made))


def _solve(degree: int, n: int, cells: str) -> dict[str, Value]:
    domain = domain_of(shapes.mapped(shapes.cube(n), bent, degree), CELLS[cells])
    runs = [solve_exact(domain, "heat", EXACT)[1]]
    while len(runs) < 3 and runs[0]["assemble_s"] + runs[0]["solve_s"] < 1.0:  # short times are noisy: take the best
        runs.append(solve_exact(domain, "heat", EXACT)[1])
    found = min(runs, key=lambda run: run["assemble_s"] + run["solve_s"])
    seconds = {"assemble": found["assemble_s"], "solve": found["solve_s"]}
    return {
        "elements": domain.space.elements, "functions": domain.space.n,
        "l2_error": found["relative_l2_error"], "h1_error": found["relative_h1_error"], **seconds,
        "total": sum(seconds.values()),
    }  # fmt: skip


def _row(degree: int, level: int, n: int, cells: str) -> dict[str, Value]:
    names: dict[str, Value] = {"cells": cells, "degree": degree, "level": level, "h": 1.0 / n}
    return {**names, "l2_theory": degree + 1, "h1_theory": degree, **_solve(degree, n, cells)}


def _curve(made: Table, cells: str, degree: int, x: str) -> tuple[Array, Array]:
    """Values of `x` and L2 errors on all levels of one degree."""
    rows = [row for row in made.records() if (row["cells"], row["degree"]) == (cells, degree)]
    return np.array(numbers(rows, x)), np.array(numbers(rows, "l2_error"))


def cost_ratio(made: Table, degree: int, x: str) -> float:
    """How many times more of `x` the hexahedra need than the tetrahedra for equal error.

    Both are read off straight lines in the doubly logarithmic plane, in the middle of the errors that both reach.
    """
    (tx, te), (hx, he) = (_curve(made, cells, degree, x) for cells in CELLS)
    low, high = max(te.min(), he.min()), min(te.max(), he.max())
    target = np.log(np.sqrt(low * high))
    needed = [np.interp(target, np.log(e[::-1]), np.log(c[::-1])) for c, e in ((tx, te), (hx, he))]
    return float(np.exp(needed[1] - needed[0]))


def _verdict(made: Table) -> str:
    degrees = sorted({int(d) for d in made.column("degree") if isinstance(d, int)})
    parts = []
    for what, x in (("functions", "functions"), ("seconds", "total")):
        ratios = {p: cost_ratio(made, p, x) for p in degrees}
        winners = {p: "tets" if r > 1.05 else "hexes" if r < 0.95 else "neither" for p, r in ratios.items()}
        said = ", ".join(f"{r:.2f} at degree {p}" for p, r in ratios.items())
        if len(set(winners.values())) == 1:
            plain = f"{next(iter(winners.values()))} win at every degree"
        else:
            plain = "; ".join(f"degree {p}: {w}" for p, w in winners.items())
        parts.append(f"By {what}: {plain} (for equal L2 error hexes need, as a multiple of what tets need, {said}).")
    return " ".join(parts)


def _draw(path: Path, made: Table, x: str, label: str) -> None:
    lines = []
    for degree in sorted(set(LEVELS["full"])):
        for cells in CELLS:
            cost, error = _curve(made, cells, degree, x)
            rate = -(degree + 1) / 3 if cells == "hexes" and x == "functions" else None
            lines.append(Series(f"{cells} $p={degree}$", cost, error, rate, family=degree, dashed=cells == "hexes"))
    with drawing(path, size=(5.4, 4.2)) as axes:
        convergence(axes, lines, label, r"relative error in $L^2$")
