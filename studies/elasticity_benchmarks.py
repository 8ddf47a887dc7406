"""Does the program reproduce the classical answers: Lame, Kirsch, Timoshenko, Fichera?

Problems with known solutions on exact NURBS solids, refined at fixed degree: thick sphere and thick cylinder under
pressure (Lame), the plate with a hole in tension (Kirsch, extruded), a cantilever with an end load, a heated hollow
sphere with its thermal stress, the steady heat in it, and the Fichera corner, whose edges allow an H1 rate of 2/3
whatever the degree. Errors are relative, displacement or temperature in L2 and H1; ``von_mises`` is the largest von
Mises stress at the quadrature points.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import geometry
from iga.progress import Progress
from problems import benchmarks
from problems.benchmarks import Benchmark
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, Value, numbers, table

NAME = "elasticity_benchmarks"
COLUMNS = (
    Column("benchmark", "text", key=True),
    Column("degree", "int", key=True),
    Column("level", "int", key=True),
    Column("functions", "int"),
    Column("h", format=".4f"),
    Column("l2_error", relative=2e-3, absolute=1e-10, format=".2e"),
    Column("h1_error", relative=2e-3, absolute=1e-10, format=".2e"),
    Column("h1_theory", format=".3g"),
    Column("von_mises", relative=1e-3, format=".4f"),
    Column("seconds", "time", "s"),
)
SLOPES = (Slope("h", "h1_error", ("benchmark", "degree"), "h1_theory"),)

Case = tuple[str, dict[str, Any], Callable[[], Benchmark]]
CASES: dict[str, Case] = {
    "thick_sphere": ("hollow_sphere_octant", {}, benchmarks.thick_sphere),
    "thick_cylinder": ("thick_ring", {}, lambda: benchmarks.thick_cylinder(planes=("end", "start"))),
    "plate_with_hole": ("plate_with_hole", {}, benchmarks.plate_with_hole),
    "cantilever": ("box", {"length": 4.0}, benchmarks.cantilever),
    "heated_sphere": ("hollow_sphere_octant", {}, benchmarks.heated_sphere),
    "hollow_sphere_heat": ("hollow_sphere_octant", {}, benchmarks.hollow_sphere_heat),
    "fichera_corner": ("fichera", {}, benchmarks.fichera_corner),
}
PLAN = {
    "ci": {"thick_sphere": [(4, 2)], "thick_cylinder": [(2, 3)], "plate_with_hole": [(2, 3)], "cantilever": [(2, 3)],
           "hollow_sphere_heat": [(4, 3)], "heated_sphere": [(4, 2)], "fichera_corner": [(2, 4)]},
    "full": {"thick_sphere": [(4, 3)], "thick_cylinder": [(2, 4), (3, 4)], "plate_with_hole": [(2, 4), (3, 4)],
             "cantilever": [(2, 4)], "hollow_sphere_heat": [(4, 4)], "heated_sphere": [(4, 3)],
             "fichera_corner": [(1, 5), (2, 5)]},
}  # fmt: skip
"""Degree and number of levels; the sphere's exact patches have degree 4."""


def run(size: Size, progress: Progress) -> Result:
    """Solve every benchmark on its levels."""
    cases = [(name, p, k) for name, plan in PLAN[size].items() for p, levels in plan for k in range(levels)]
    rows = [_row(*case) for case in progress.track(cases, "benchmarks")]
    made = table(NAME, COLUMNS, rows, SLOPES)
    finest = {row["benchmark"]: row["h1_error"] for row in rows}
    said = ", ".join(f"{name} {error:.1e}" for name, error in finest.items())
    summary = f"Relative H1 errors on the finest meshes: {said}."
    return Result(made, (Figure("rates", lambda path: _draw(path, made), "H1 errors of the benchmarks"),), summary)


def _row(name: str, degree: int, level: int) -> dict[str, Value]:
    shape, measures, make = CASES[name]
    domain = geometry.build(shape, "nurbs", degree=degree, **measures)
    domain = geometry.refine(domain, level) if level else domain
    bench = make()
    solution = bench.solve(domain)
    norms = solution.norms
    assert norms is not None
    smooth = float(degree) if bench.h1_rate is None else bench.h1_rate
    stressed = "von_mises" in solution.quantities
    return {
        "benchmark": name, "degree": degree, "level": level, "functions": domain.space.n, "h": 0.5**level,
        "l2_error": norms.relative_l2, "h1_error": norms.relative_h1, "h1_theory": smooth,
        "von_mises": solution.extrema("von_mises")[1] if stressed else None,
        "seconds": solution.log["assemble_s"] + solution.log["solve_s"],
    }  # fmt: skip


def _draw(path: Path, made: Table) -> None:
    rows, series = made.records(), []
    for name, degree in dict.fromkeys((row["benchmark"], row["degree"]) for row in rows):
        own = [row for row in rows if (row["benchmark"], row["degree"]) == (name, degree)]
        h, error = numbers(own, "h"), numbers(own, "h1_error")
        if len(own) > 1 and min(error) > 1e-12:  # others are exact: round-off has no rate
            series.append(Series(f"{str(name).replace('_', ' ')}, $p={degree}$", h, error))
    with drawing(path, size=(6.2, 4.6)) as axes:
        convergence(axes, series, "$h$ (relative)", r"relative error in $H^1$")
