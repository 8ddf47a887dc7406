"""At what rate do solutions on the meccano's spaces converge, and how much does adaptive refinement save?

Rates under uniform refinement, heat and elasticity with exact solutions on smooth data:

    block       a cube whose inside and sides are bent; both spaces on uniform T-meshes, 2^level cells along each edge
    pillowed    the same solid from a pillowed cube of seven blocks, C^0 between them
    star        a pillowed solid grown from a surface (full size only); level counts halvings, which keep the solid

and of the paper's T-splines beside them: their quotient reproduces constants and the solid's own coordinates only, so
they lose orders near the boundary (a clamped space does not). Their boundary functions are dependent there, so data are
imposed weakly. Between levels the T-spline solid changes a little, as its spaces are not nested; each level is measured
with its own solid.

The layer is exp(-20 (x + y)) on the block, sharp along one edge: cells are split everywhere, or where the residual
estimator says so (Doerfler's marking with the share 0.7). ``share`` is the number of functions of the adaptive loop
over those that uniform refinement takes for the same error, on the line between its levels in logarithms.

Errors are relative, H1 is the seminorm. ``effectivity`` is the estimate over the error in the energy norm.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks, cube, pillowed, place
from geometry.meccano import Settings, domain_of, refine_domain, stored_space
from geometry.meccano.adaptive import by_cell, doerfler
from geometry.meccano.collocation import quasi_interpolation
from geometry.meccano.domain import bare, build_domain
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.interpolation import interpolate
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.shapes import star
from geometry.meccano.t_spline import t_spline
from geometry.meccano.tmesh import uniform
from iga.domain import Domain, Provenance
from iga.norms import Errors
from iga.pictures.plot import plot_field
from iga.progress import Progress
from problems import heat, solve_exact
from problems.estimator import indicators
from problems.manufactured import heat as exact_heat
from studies.figures import Series, convergence, drawing, plot_panels
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, Value, numbers, table

Array = NDArray[np.float64]

NAME = "meccano_analysis"
COLUMNS = (
    Column("problem", "text", key=True),
    Column("solid", "text", key=True),
    Column("space", "text", key=True),
    Column("refinement", "text", key=True),
    Column("level", "int", key=True),
    Column("functions", "int", relative=0.02),
    Column("h", format=".4f"),
    Column("l2_error", relative=0.02, absolute=1e-10, format=".2e"),
    Column("h1_error", relative=0.02, absolute=1e-9, format=".2e"),
    Column("l2_theory"),
    Column("h1_theory"),
    Column("effectivity", relative=0.1, format=".1f"),
    Column("share", relative=0.1, at_most=1.0 / 3.0, format=".2f"),
    Column("seconds", "time", "s"),
)
GROUP = ("problem", "solid", "space", "refinement")
SLOPES = (
    Slope("h", "l2_error", GROUP, "l2_theory"),
    Slope("h", "h1_error", GROUP, "h1_theory"),
)
EXACT = {
    "heat": "sin(2*x)*cos(y)*exp(0.5*z)",
    "elasticity": "sin(2*x)*cos(y);0.5*cos(x)*exp(0.5*z);sin(y)*cos(2*z)",
}
LAYER = "exp(-20*(x+y))"
MARKED = 0.7
"""Share of the squared estimate that marked cells hold (Doerfler)."""
RATIONAL_POINTS = 6
"""Gauss points per direction on rational cells, where the default rule would be seen in the errors."""


def bent(x: Array) -> Array:
    """The block: points (n, 3) of the unit cube, moved; sides stay smooth and edges stay edges."""
    return x + 0.06 * np.sin(np.pi * x[:, [1, 2, 0]]) + 0.03 * np.sin(np.pi * x) * np.cos(2.0 * x[:, [2, 0, 1]])


def block(space: str, level: int, blocks: Blocks | None = None) -> Domain:
    """The block in one of the spaces, also cut into several blocks that fill the unit cube."""
    tmesh = uniform(blocks or cube(), level, 3)
    if space == "t-spline":
        own = t_spline(tmesh)
        return bare(own, interpolate(own, bent(own.anchors / (1 << LEVELS)))[0])
    clamped = hierarchy(tmesh)
    number, xi, matrix = quasi_interpolation(clamped)
    return build_domain(clamped, matrix @ bent(place(tmesh.blocks, number, xi)), Provenance("meccano"))


def run(size: Size, progress: Progress) -> Result:
    """Solve everything on its levels."""
    full = size == "full"
    last = 4 if full else 3
    jobs = [("heat", "block", "optimal"), ("heat", "block", "t-spline"), ("heat", "pillowed", "optimal")]
    if full:
        jobs += [
            ("heat", "star", "optimal"), ("elasticity", "block", "optimal"), ("elasticity", "block", "t-spline"),
            ("elasticity", "pillowed", "optimal"),
        ]
    rows: list[dict[str, Value]] = []
    for problem, solid, space in progress.track(jobs, "uniform refinement"):
        theory = (4.0, 3.0) if space == "optimal" else (None, None)
        domain = None
        fewer = int(problem == "elasticity" and space == "t-spline")
        for level in range(3) if solid == "star" else range(1, last - fewer + 1):
            began = perf_counter()
            if solid == "star":
                domain = refine_domain(domain) if domain is not None else _star()
            else:
                domain = block(space, level, pillowed(cube()) if solid == "pillowed" else None)
            points = RATIONAL_POINTS if space == "t-spline" else None
            _, found = solve_exact(domain, problem, EXACT[problem], points=points)
            rows.append({
                "problem": problem, "solid": solid, "space": space, "refinement": "uniform", "level": level,
                "functions": domain.space.n, "h": 0.5**level, "l2_error": found["relative_l2_error"],
                "h1_error": found["relative_h1_error"], "l2_theory": theory[0], "h1_theory": theory[1],
                "seconds": perf_counter() - began,
            })  # fmt: skip
    layer, final = _layer(3 if full else 2, progress)
    rows += layer
    made = table(NAME, COLUMNS, rows, SLOPES)
    figures = (
        Figure("rates", partial(_draw, made), "L2 and H1 errors, and the layer"),
        Figure("layer", partial(_picture, final), "the adaptive T-mesh and the layer on it"),
    )
    return Result(made, figures, _said(made))


def _star() -> Domain:
    return domain_of(star(10, 0.1), Settings(tolerance=0.02, max_cells=60, rounds=0, off="keep"))


def _layer(rounds: int, progress: Progress) -> tuple[list[dict[str, Value]], tuple[Domain, Array]]:
    """Rows of uniform and adaptive refinement, and the last adaptive solution."""
    rows: list[dict[str, Value]] = []
    even: list[tuple[int, float]] = []
    domain = start = block("optimal", 2)
    for level in progress.track(range(rounds + 1), "layer, uniform"):
        began = perf_counter()
        domain = refine_domain(domain) if level else domain
        error, _, _ = _solved(domain, False)
        even.append((domain.space.n, error.relative_h1))
        rows.append(_row("uniform", level, domain, error, None, began) | {"h": 0.5 ** (level + 2)})
    domain, level = start, 0
    while True:
        began = perf_counter()
        error, found, u = _solved(domain, True)
        row = _row("adaptive", level, domain, error, float(np.linalg.norm(found)) / error.h1, began)
        rows.append(row)
        if error.relative_h1 <= even[-1][1]:
            functions, errors = np.log(np.array(even)).T
            alike = np.exp(np.interp(-np.log(error.relative_h1), -errors, functions))
            row["share"] = float(domain.space.n / alike)
            return rows, (domain, u)
        if domain.space.n > even[-1][0]:
            return rows, (domain, u)
        progress.say(f"layer: {domain.space.n} functions, error {error.relative_h1:.2e}")
        domain = refine_domain(domain, doerfler(by_cell(stored_space(domain), found), MARKED))
        level += 1


def _solved(domain: Domain, estimate: bool) -> tuple[Errors, Array, Array]:
    """Errors of the layer, indicators of the elements if asked for, coefficients."""
    known = exact_heat(LAYER)
    problem = heat.Heat(1.0, known.source, {"boundary": known.u})
    solution = heat.solve(problem, domain).compared(known.u)
    assert solution.norms is not None
    found = indicators(problem, domain, solution.coefficients) if estimate else np.empty(0)
    return solution.norms, found, solution.coefficients


def _row(
    kind: str, level: int, domain: Domain, error: Errors, effectivity: float | None, began: float
) -> dict[str, Value]:
    return {
        "problem": "layer", "solid": "block", "space": "optimal", "refinement": kind, "level": level,
        "functions": domain.space.n, "l2_error": error.relative_l2, "h1_error": error.relative_h1,
        "effectivity": effectivity, "seconds": perf_counter() - began,
    }  # fmt: skip


def _said(made: Table) -> str:
    spread: dict[str, dict[str, list[float]]] = {}
    for rate in made.rates():
        group = dict(rate.group)
        if group["problem"] != "layer":
            spread.setdefault(str(group["space"]), {}).setdefault(rate.y, []).append(rate.last)
    rates = "; ".join(
        f"{space} " + ", ".join(f"{error.split('_')[0].upper()} {min(of):.2f} to {max(of):.2f}"
                                for error, of in found.items())
        for space, found in spread.items()
    )  # fmt: skip
    shares = [share for share in made.column("share") if share is not None]
    saved = f"adaptive refinement takes {shares[0]:.2f} of the functions of uniform" if shares else "no saving shown"
    return f"Rates over the last pair of levels: {rates}. On the layer {saved}."


def _draw(made: Table, path: Path) -> None:
    groups: dict[tuple[str, ...], list[dict[str, Value]]] = {}
    for row in made.records():
        groups.setdefault(tuple(str(row[name]) for name in GROUP), []).append(row)
    with drawing(path, 1, 3) as panels:
        for axes, y, title in zip(panels, ("l2_error", "h1_error"), ("L2 error", "H1 error")):
            series = []
            for number, (key, rows) in enumerate(groups.items()):
                if key[0] == "layer":
                    continue
                theory = numbers(rows, y.replace("error", "theory"))[0]
                rate = None if np.isnan(theory) else theory
                label, dashed = ", ".join(key[:3]), key[2] == "t-spline"
                series.append(Series(label, numbers(rows, "h"), numbers(rows, y), rate, number, dashed))
            convergence(axes, series, "$h$", "relative error", title)
        series = [
            Series(key[3], numbers(rows, "functions"), numbers(rows, "h1_error"))
            for key, rows in groups.items() if key[0] == "layer"
        ]  # fmt: skip
        convergence(panels[2], series, "functions", "relative error", "layer, H1 error")


def _picture(final: tuple[Domain, Array], path: Path) -> None:
    domain, u = final
    plain = Domain(domain.space, domain.points, {"boundary": domain.boundaries["boundary"]})
    look = {"size": 600, "view": (-1.0, -1.2, 0.8)}
    panels = [("adaptive T-mesh", plain.plot(**look, names=False)), ("layer", plot_field(plain, u, "u", **look))]  # type: ignore[arg-type]
    plot_panels(path, panels, 2)
