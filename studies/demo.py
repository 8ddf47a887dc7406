"""A tour in three minutes: solids from meshes and from code, heat and elasticity on them, tables, plots and pictures.

Everything ends in ``index.html``, one page that can be read offline. Meshes come from ``../shared/data`` where that
folder is there; where it is not, built-in shapes stand for them or a solid is left out, which is said.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import geometry
from geometry.tets import domain_of, read_tets, shapes
from iga.domain import Domain
from iga.exchange.export import write_vtu
from iga.pictures.plot import can_draw, plot_domain, plot_field
from iga.pictures.skin import Cut
from iga.progress import Progress
from problems import Elasticity, Heat, Solution, benchmarks, elasticity, heat, parse, parse_vector
from problems.material import isotropic
from studies.catmull_clark_models import halves
from studies.data import DATA
from studies.report import Picture, Section, print_run, wide_console, write_report
from studies.study import find, run_study
from studies.table import Column, Value, render, table

LABELS = {"von_mises": "von Mises stress", "temperature": "temperature"}
HEXES = DATA / "hex" / "fertility.vtk"
STUDIES = ("tet_to_hex_exactness", "tet_to_hex_continuity", "nurbs_convergence", "tets_versus_hexes")
COLUMNS = (
    Column("solid", "text", key=True),
    Column("problem", "text"),
    Column("cells", "text"),
    Column("degree", "int"),
    Column("elements", "int"),
    Column("functions", "int"),
    Column("shown", "text"),
    Column("smallest", format=".4g"),
    Column("largest", format=".4g"),
    Column("residual", format=".0e"),
    Column("seconds", "time", "s"),
)


@dataclass(frozen=True)
class Scene:
    """A solved problem and how to show it."""

    name: str
    title: str
    text: str
    make: Callable[[], Domain]
    solve: Callable[[Domain], Solution]
    shown: str
    unit: str
    look: dict[str, Any]


def demo(out: Path, progress: Progress, say: bool = True) -> dict[str, Any]:
    """Run the tour and write the page.

    Parameters
    ----------
    out : folder for the page and the files beside it, made where missing.
    say : print the tables to standard output.

    Returns
    -------
    The files written and the seconds it took.
    """
    begin = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    drawn = can_draw()
    if not drawn:
        progress.say("no pictures: this machine has neither EGL nor OSMesa (install libegl1 and libegl-mesa0)")
    if not HEXES.is_file():
        progress.say(f"no Catmull-Clark solid: {HEXES} is not there")
    sections, rows, files = [], [], []
    for scene in progress.track(_scenes(), "solids"):
        domain = scene.make()
        solution = scene.solve(domain)
        rows.append(_row(scene, domain, solution))
        files.append(write_vtu(out / f"{scene.name}.vtu", domain, solution.pictured()))
        pictures = _pictures(scene, domain, solution, out) if drawn else ()
        files += [picture.path for picture in pictures]
        sections.append(Section(scene.title, scene.text, pictures=pictures))
    made = table("solved solids", COLUMNS, rows)
    sections.insert(0, Section("Solved solids", "All solids of this page at a glance.", made))
    for name in progress.track(STUDIES, "studies"):
        run = run_study(name, "ci", out, progress)
        if say:
            print_run(run)
        title = (find(name).__doc__ or name).strip().splitlines()[0]
        figures = zip(run.files[1:-1], run.result.figures, strict=True)
        shown = [Picture(path, figure.caption, len(run.result.figures) == 1) for path, figure in figures]
        files += run.files
        note = f"Study {name}, small size."
        sections.append(Section(title, run.result.summary, run.result.table, tuple(shown), note))
    seconds = time.perf_counter() - begin
    page = write_report(
        out / "index.html",
        "Isogeometric analysis on solids that come from anywhere",
        "Tetrahedral and hexahedral meshes and NURBS volumes, solved in one framework. The files beside this "
        "page hold the same solids as Bezier cells for ParaView and the tables as CSV and JSON. Made in "
        f"{seconds:.0f} s.",
        sections,
    )
    if say:
        console = wide_console()
        console.print(render(made))
        console.print(f"open {page}", markup=False)
    return {"files": [str(page), *map(str, files)], "seconds": round(time.perf_counter() - begin, 1)}


def _row(scene: Scene, domain: Domain, solution: Solution) -> dict[str, Value]:
    low, high = solution.extrema(scene.shown)
    block = domain.space.blocks[0]
    return {
        "solid": scene.name.replace("_", " "), "problem": solution.problem, "cells": block.basis.cell.name,
        "degree": max(block.basis.degree), "elements": domain.space.elements,
        "functions": domain.space.n, "shown": LABELS[scene.shown], "smallest": low, "largest": high,
        "residual": float(solution.log["residual"]),
        "seconds": float(solution.log["assemble_s"]) + float(solution.log["solve_s"]),
    }  # fmt: skip


def _pictures(scene: Scene, domain: Domain, solution: Solution, out: Path) -> tuple[Picture, ...]:
    solid, field = out / f"{scene.name}_solid.png", out / f"{scene.name}.png"
    plot_domain(domain, solid, size=760, **{key: scene.look[key] for key in ("view",) if key in scene.look})
    quantity = solution.quantity(scene.shown)
    values = quantity.evaluate if quantity.coefficients is None else quantity.coefficients
    look = _warped(scene, solution)
    plot_field(domain, values, LABELS[scene.shown], field, unit=scene.unit, size=760, **look)
    return (Picture(solid, "The elements and the named boundaries."), Picture(field, _caption(scene)))


def _warped(scene: Scene, solution: Solution) -> dict[str, Any]:
    warp = {"warp": solution.coefficients} if solution.problem == "elasticity" else {}
    return {**scene.look, **warp}


def _caption(scene: Scene) -> str:
    what = LABELS[scene.shown]
    what = what[0].upper() + what[1:]
    moved = " on the deformed solid (displacement enlarged)" if scene.shown == "von_mises" else ""
    return f"{what}{moved}{', cut open' if 'cut' in scene.look else ''}."


# --- the solids ------------------------------------------------------------------------------------------------------


def _scenes() -> list[Scene]:
    scenes = [
        Scene(
            "ball", "Heat in a curved tetrahedral ball",
            "A ball of curved tetrahedra, heated inside by a source that is stronger on one side, its surface held at "
            "zero. The tetrahedra are solved as they stand, as degree-3 Bezier elements.",
            _ball, _heat_ball, "temperature", "K", {"cut": Cut("-y", smooth=True)},
        ),
        Scene(
            "converted", "Elasticity on hexahedra made of tetrahedra",
            "Each tetrahedron became four hexahedra by the exact conversion of Xu et al. (2018, Theorem 3); the solid "
            "is the same to round-off. It spins about the vertical axis in a soft bedding that holds it everywhere.",
            _converted, _spin, "von_mises", "Pa", {},
        ),
        Scene(
            "ring", "A pressurised thick ring",
            "A quarter of a thick cylinder as one rational patch: the circles are exact. Inner pressure, plane strain; "
            "the displacement is known in closed form (Lame).",
            lambda: geometry.build("thick_ring", "nurbs", refine=2, elevate=1),
            lambda domain: benchmarks.thick_cylinder(planes=("end", "start")).solve(domain), "von_mises", "Pa", {},
        ),
        Scene(
            "plate", "A plate with a hole in tension",
            "A quarter of the plate, two patches glued into one space; Kirsch's stresses act on the far sides.",
            lambda: geometry.build("plate_with_hole", "nurbs", refine=3),
            lambda domain: benchmarks.plate_with_hole().solve(domain), "von_mises", "Pa", {"view": (0.5, -0.9, 1.2)},
        ),
        Scene(
            "torus", "Heat in a NURBS torus",
            "Five patches of a quarter torus, hot at one end, cold at the other, cooled by air along its way.",
            lambda: geometry.build("torus", "nurbs", refine=2), _heat_torus, "temperature", "K",
            {"view": (1.0, 0.6, 1.1)},
        ),
    ]  # fmt: skip
    if (DATA / "tet" / "bob.mesh").is_file():
        scenes.insert(
            1,
            Scene(
                "bob", "Heat in a tetrahedral mesh from a file",
                "The mesh bob.mesh of 14,781 straight tetrahedra as quadratic Bezier elements. Warm water inside (a "
                "source), cold air outside (convection).",
                lambda: geometry.build(DATA / "tet" / "bob.mesh", "tets", degree=2), _heat_bob, "temperature", "K",
                {"cut": Cut("y", (0.0, -0.25, 0.0), smooth=True), "edges": False},
            ),
        )  # fmt: skip
    if HEXES.is_file():
        scenes.insert(
            3,
            Scene(
                "fertility", "Heat in a Catmull-Clark solid of a hex mesh from a file",
                "The mesh fertility.vtk of 4,000 hexahedra as a smooth volume through its boundary vertices (after Xie "
                "et al. 2020), four holes, every cell certified; cold at the base, hot at the heads.",
                lambda: halves(geometry.build(HEXES, "catmull_clark", repair=True), 1), _heat_between,
                "temperature", "K", {"view": (0.3, 0.7, 1.0), "edges": False},
            ),
        )  # fmt: skip
    return scenes


def _ball() -> Domain:
    file = DATA / "tet" / "sphere_fine_P3.msh"
    return geometry.build(file, "tets") if file.is_file() else domain_of(shapes.ball(1, 3))


def _heat_ball(domain: Domain) -> Solution:
    return heat.solve(Heat(source=parse("30*exp(2*x)*(1 + sin(6*z))"), temperature={"*": 0.0}), domain)


def _heat_bob(domain: Domain) -> Solution:
    convection = heat.Convection(2.0, 0.0)
    return heat.solve(Heat(source=parse("10*(1+x)**2"), convection={"*": convection}), domain)


def _heat_between(domain: Domain) -> Solution:
    return heat.solve(Heat(temperature={"low": 0.0, "high": 100.0}), domain)


def _heat_torus(domain: Domain) -> Solution:
    problem = Heat(temperature={"start": 100.0, "end": 0.0}, convection={"outer": heat.Convection(0.2, 20.0)})
    return heat.solve(problem, domain)


def _converted() -> Domain:
    file = DATA / "tet" / "escher_P2.vtk"
    mesh = read_tets(file) if file.is_file() else shapes.mapped(shapes.cube(2), _twisted, 2)
    return domain_of(mesh, "hex4", degree=3)


def _twisted(x: Any) -> Any:
    """Cube of side 2 about the origin, turned about the vertical axis by an angle that grows with the height."""
    turn, middle = 0.8 * x[..., 2], 2.0 * x[..., :2] - 1.0
    c, s, across, along = np.cos(turn), np.sin(turn), middle[..., 0], middle[..., 1]
    return np.stack([c * across - s * along, s * across + c * along, 2.0 * x[..., 2] - 1.0], axis=-1)


def _spin(domain: Domain) -> Solution:
    bedding = {"*": elasticity.Support(2.0)}
    spinning = parse_vector("8*x; 8*y; 0")
    return elasticity.solve(Elasticity(isotropic(100.0, 0.3), body_force=spinning, support=bedding), domain)
