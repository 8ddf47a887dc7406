"""Every source on one solid and one equation: what does each way there cost, and how fast does it converge?

The unit ball, as exact NURBS patches, as curved tetrahedra, as the hexahedra made of them, as a Catmull-Clark solid of
a hex mesh with either space, grown from a surface triangulation, and under the skin of a CAD model. Heat conduction
with a smooth manufactured solution is solved on each by its own refinement. Two errors must not be confused:
``off_sphere`` is the largest distance of the solid's boundary from the sphere over the diameter, which refinement keeps
(the solid stays the same); ``l2_error`` and ``h1_error`` are those of the solution on the solid as it is.

``theory`` is the order of the L2 error: p + 1, and 2.5 for Catmull-Clark functions, which end naturally at the
boundary. ``size`` is 2^-level. The figure compares errors at equal
numbers of functions.

At full size the same is done with the bunny, from what the data folder holds of it: a tet mesh, a hex mesh, a surface
triangulation. The three are different models of one animal, so that the formula is stretched to each one's box.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import cast

import numpy as np

import geometry
from geometry.tets import domain_of, shapes
from iga.assembly import volume, walk
from iga.certificate import quality
from iga.domain import Domain, max_degree
from iga.progress import Progress
from problems import solve_exact
from studies.data import DATA
from studies.figures import Series, convergence, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, numbers, table

NAME = "sources_compared"
COLUMNS = (
    Column("model", "text", key=True),
    Column("way", "text", key=True),
    Column("level", "int", key=True),
    Column("degree", "int"),
    Column("elements", "int", relative=0.1),
    Column("functions", "int", relative=0.1),
    Column("not_certified", "int"),
    Column("size", format=".3f"),
    Column("volume_error", relative=0.3, absolute=1e-12, format=".1e"),
    Column("off_sphere", relative=0.3, absolute=1e-12, format=".1e"),
    Column("l2_error", relative=0.1, format=".2e"),
    Column("h1_error", relative=0.1, format=".2e"),
    Column("theory", format=".1f"),
    Column("build", "time", "s"),
    Column("solve", "time", "s"),
)
SLOPES = (
    Slope("size", "l2_error", ("model", "way"), "theory"),
    Slope("size", "h1_error", ("model", "way")),
)
EXACT = "sin(2*x)*cos(y)*exp(z/2)"


@dataclass(frozen=True)
class Way:
    """One way to the solid.

    Attributes
    ----------
    build : the coarsest domain.
    levels : refinements at each size of the study.
    theory : order of the L2 error.
    """

    build: Callable[[], Domain]
    levels: dict[Size, int]
    theory: float


def _tets(convert: str) -> Domain:
    return domain_of(shapes.ball(0, 3), convert)


def _hexes(space: str) -> Domain:
    # Eight corners of the ball's hex mesh have three boundary faces at large angles, which are no features of a sphere.
    return geometry.build("round_ball", "catmull_clark", features="none", space=space)


WAYS: dict[str, Way] = {
    "nurbs": Way(partial(geometry.build, "ball", "nurbs"), {"ci": 2, "full": 3}, 5),
    "tets": Way(partial(_tets, "none"), {"ci": 2, "full": 4}, 4),
    "tets to hexes": Way(partial(_tets, "hex4"), {"ci": 1, "full": 3}, 4),
    "catmull_clark": Way(partial(_hexes, "catmull_clark"), {"ci": 2, "full": 3}, 2.5),
    "catmull_clark optimal": Way(partial(_hexes, "optimal"), {"ci": 1, "full": 2}, 4),
    "meccano": Way(
        partial(geometry.build, "ball", "meccano", tolerance=0.01, max_cells=500), {"ci": 1, "full": 2}, 4
    ),
    "hybrid": Way(partial(geometry.build, "ball", "hybrid"), {"ci": 1, "full": 2}, 4),
}
BUNNY: dict[str, Way] = {
    "tets": Way(partial(geometry.build, DATA / "tet" / "bunny.mesh", "tets"), {"full": 1}, 2),
    "tets to hexes": Way(
        partial(geometry.build, DATA / "tet" / "bunny.mesh", "tets", convert="hex4"), {"full": 0}, 2
    ),
    "catmull_clark": Way(
        partial(geometry.build, DATA / "hex" / "bunny_octree.vtk", "catmull_clark", repair=True), {"full": 0}, 2.5
    ),
    "catmull_clark optimal": Way(
        partial(geometry.build, DATA / "hex" / "bunny_octree.vtk", "catmull_clark", repair=True, space="optimal"),
        {"full": 0}, 4,
    ),
    "meccano": Way(partial(geometry.build, DATA / "surface" / "bunny_7k.off", "meccano"), {"full": 0}, 4),
}  # fmt: skip


def run(size: Size, progress: Progress) -> Result:
    """Solve on all ways and levels."""
    jobs = [("ball", name, way) for name, way in WAYS.items()]
    if size == "full" and DATA.is_dir():
        jobs += [("bunny", name, way) for name, way in BUNNY.items()]
    rows: list[dict[str, Value]] = []
    figures = [Figure("functions", partial(_draw, rows=rows), "Error against the number of functions.")]
    for model, name, way in progress.track(jobs, "ways to a solid"):
        found, domain, exact = _rows(model, name, way, size)
        rows += found
        picture = partial(_picture, domain, exact)
        figures.append(Figure(f"{model} {name}".replace(" ", "_"), picture, "The solution on the last level."))
    made = table(NAME, COLUMNS, rows, SLOPES)
    return Result(made, tuple(figures), _verdict(rows, size))


def _rows(model: str, name: str, way: Way, size: Size) -> tuple[list[dict[str, Value]], Domain, str]:
    """Rows of all levels, the domain of the last one, and the exact solution there."""
    began = perf_counter()
    domain = way.build()
    build = perf_counter() - began
    exact = EXACT if model == "ball" else _stretched(domain)
    kept = _shape(domain) if model == "ball" else {}
    rows: list[dict[str, Value]] = []
    for level in range(way.levels[size] + 1):
        if level:
            began = perf_counter()
            domain = geometry.refine(domain)
            build = perf_counter() - began
        proof = quality(domain)
        found = solve_exact(domain, "heat", exact)[1]
        rows.append({
            "model": model, "way": name, "level": level, "degree": max_degree(domain),
            "elements": domain.space.elements, "functions": domain.space.n,
            "not_certified": proof["refuted"] + proof["undecided"] + proof["degenerate"],
            "size": 0.5**level, **kept, "l2_error": found["relative_l2_error"],
            "h1_error": found["relative_h1_error"], "theory": way.theory, "build": build,
            "solve": found["assemble_s"] + found["solve_s"],
        })  # fmt: skip
    return rows, domain, exact


def _shape(domain: Domain) -> dict[str, Value]:
    """What the solid misses of the ball: relative volume, and distance over the diameter at 8 x 8 points a face."""
    names = list(domain.boundaries)
    radii = [np.linalg.norm(chunk.x, axis=-1) for chunk in walk(domain, 8, names)]
    return {
        "volume_error": abs(volume(domain, 10) / (4.0 / 3.0 * np.pi) - 1.0),
        "off_sphere": max(float(np.abs(r - 1.0).max()) for r in radii) / 2.0,
    }


def _stretched(domain: Domain) -> str:
    """The formula on the box of the domain moved to [-1, 1]^3, all axes by the same factor."""
    control = domain.points
    low, high = control.min(axis=0), control.max(axis=0)
    middle, half = (low + high) / 2.0, float((high - low).max()) / 2.0
    x, y, z = (f"(({axis})-({float(m)!r}))/{half!r}" for axis, m in zip("xyz", middle))
    return f"sin(2*{x})*cos({y})*exp({z}/2)"


def _draw(path: Path, rows: list[dict[str, Value]]) -> None:
    models = list(dict.fromkeys(cast(str, row["model"]) for row in rows))
    with drawing(path, 1, len(models), (5.6, 4.2)) as axes:
        for panel, model in zip(np.atleast_1d(axes), models):
            series = []
            for way in WAYS:
                own = [row for row in rows if (row["model"], row["way"]) == (model, way)]
                series.append(Series(way, numbers(own, "functions"), numbers(own, "l2_error")))
            convergence(panel, series, "functions", "relative $L_2$ error", model)


def _picture(domain: Domain, exact: str, path: Path) -> None:
    solution = solve_exact(domain, "heat", exact)[0]
    solution.plot("temperature", path, cut="z")


def _verdict(rows: list[dict[str, Value]], size: Size) -> str:
    last = {cast(str, row["way"]): row for row in rows if row["model"] == "ball"}
    best = min(last.values(), key=lambda row: cast(float, row["l2_error"]) * cast(int, row["functions"]) ** (4 / 3))
    missing = "" if size == "ci" or DATA.is_dir() else " The data folder is not there, so there is no bunny."
    ways = {(row["model"], row["way"]) for row in rows}
    folded = {(row["model"], row["way"]) for row in rows if row["not_certified"]}
    return (
        f"{len(ways) - len(folded)} of {len(ways)} ways end in certified solids; the smallest error for its functions "
        f"on the ball (at fourth order) has {best['way']}.{missing}"
    )
