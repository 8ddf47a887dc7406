"""How fast is the cube benchmark, in degrees, sizes and ways of applying the operator?

Runs `studies.bench_cube`: heat and elasticity on a single-patch cube with a curved interior map, splines of maximal
smoothness, solved to a relative residual of 1e-10, as an assembled matrix and matrix-free. Errors and unknowns are held
against the baseline; times belong to the machine and are not.
"""

from __future__ import annotations

from pathlib import Path

from iga.parallel import threads
from iga.progress import Progress
from studies import bench_cube
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, numbers, table

NAME = "bench_cube"
COLUMNS = (
    Column("problem", "text", key=True),
    Column("mode", "text", key=True),
    Column("p", "int", key=True),
    Column("n_per_dir", "int", key=True),
    Column("ndofs", "int"),
    Column("l2_error", relative=1e-4, format=".3e"),
    Column("t_assemble", "time", "s"),
    Column("t_solve", "time", "s"),
    Column("t_total", "time", "s"),
    Column("peak", "time", "MB", format=".0f"),
)
MOST_THREADS = 2
"""Threads in use, so that times of machines compare."""
SLOPES = (Slope("n_per_dir", "l2_error", ("problem", "mode", "p")),)
SIZES: dict[str, dict[tuple[str, int], tuple[int, ...]]] = {
    "ci": {("heat", 2): (4, 6, 8), ("heat", 3): (4, 6, 8), ("elasticity", 2): (2, 4, 6)},
    "full": {
        ("heat", 2): (8, 16, 24, 32),
        ("heat", 3): (8, 16, 24, 32),
        ("elasticity", 2): (8, 12, 16),
        ("elasticity", 3): (8, 12, 16),
    },
}


def run(size: Size, progress: Progress) -> Result:
    """Run all problems, degrees, sizes and modes."""
    cases = [
        (problem, mode, p, n)
        for (problem, p), sizes in SIZES[size].items()
        for mode in bench_cube.MODES
        for n in sizes
    ]
    rows = []
    for problem, mode, p, n in progress.track(cases, "bench cube"):
        found = bench_cube.run(problem, p, n, min(threads(), MOST_THREADS), mode)
        rows.append(
            {
                "problem": problem, "mode": mode, "p": p, "n_per_dir": n, "ndofs": found["ndofs"],
                "l2_error": found["l2_error"], "t_assemble": found["t_assemble_s"], "t_solve": found["t_solve_s"],
                "t_total": found["t_total_s"], "peak": found["peak_rss_mb"],
            }
        )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    last = rows[-1]
    summary = (
        f"The largest run ({last['problem']}, degree {last['p']}, {last['ndofs']} unknowns, {last['mode']}) took "
        f"{last['t_total']:.2f} s."
    )
    return Result(made, (Figure("times", lambda path: _draw(path, made), "Error against time"),), summary)


def _draw(path: Path, made: Table) -> None:
    rows = made.records()
    groups = list(dict.fromkeys((row["problem"], row["p"]) for row in rows))
    lines = []
    for number, (problem, p) in enumerate(groups):
        for mode in bench_cube.MODES:
            own = [r for r in rows if (r["problem"], r["p"], r["mode"]) == (problem, p, mode)]
            seconds, error = numbers(own, "t_total"), numbers(own, "l2_error")
            label = f"{problem} $p={p}$, {mode}"
            lines.append(Series(label, seconds, error, family=number, dashed=mode == "matrix-free"))
    with drawing(path, size=(5.6, 4.0)) as axes:
        convergence(axes, lines, "seconds", r"error in $L^2$")
