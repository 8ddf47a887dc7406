"""Does a graded material given at the vertices of a hex mesh arrive at them (Xie et al. 2020, Figures 5, 6, 8, 9)?

Values 0, 50 and 100 at the vertices, in bands, are carried by the solid as an attribute: through the same operators as
the positions. The approximating solid smooths them, the interpolating ones take them on exactly at the limit points of
the vertices. Columns: the largest error at the vertices (of 100; of positions over the diagonal), the range that the
attribute takes in the solid (interpolation overshoots), and what it does to a problem: stored heat of a material of
conductivity 50 + value/2 between two temperatures on opposite parts of the boundary, and the mass for a density of
1 + value.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import geometry.catmull_clark as catmull_clark
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import diagonal, pia
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import HexMesh, hex_mesh, read_hexes
from geometry.catmull_clark.shapes import box, cross_of_tetrahedra, fan
from geometry.catmull_clark.source import stored_topology
from iga.assembly import integral
from iga.block import bezier_coefficients
from iga.domain import Domain
from iga.field import Field
from iga.pictures.plot import plot_field
from iga.progress import Progress
from problems import Heat, heat
from studies.catmull_clark_models import halves
from studies.data import HEXES
from studies.figures import plot_panels
from studies.study import Figure, Result, Size
from studies.table import Column, table

Array = NDArray[np.float64]

NAME = "catmull_clark_material"
COLUMNS = (
    Column("mesh", "text", key=True),
    Column("method", "text", key=True),
    Column("cells", "int"),
    Column("error", relative=1e-6, absolute=1e-9, format=".1e"),
    Column("position_error", relative=1e-6, absolute=1e-11, format=".1e"),
    Column("lowest", relative=1e-6, absolute=1e-7, format=".1f"),
    Column("highest", relative=1e-6, absolute=1e-7, format=".1f"),
    Column("mass", relative=1e-6, format=".4g"),
    Column("heat", relative=1e-5, format=".4g"),
    Column("seconds", "time", "s"),
)
SLOPES = ()
METHODS = {"approximating": "none", "push-back": "pushback", "PIA": "pia", "butterfly": "butterfly", "direct": "direct"}
METHODS_OF_MODELS = ("approximating", "PIA")
"""Those by which real meshes are interpolated."""


def run(size: Size, progress: Progress) -> Result:
    """Carry the values through every method; real meshes only by the approximating one and PIA."""
    rows = []
    meshes = _meshes(size, progress)
    cases = [(name, method) for name in meshes for method in METHODS if "." not in name or method in METHODS_OF_MODELS]
    for name, method in progress.track(cases, "materials"):
        rows.append({"mesh": name, "method": method, **_row(meshes[name], METHODS[method])})
    made = table(NAME, COLUMNS, rows, SLOPES)
    exact = max(row["error"] for row in rows if row["method"] != "approximating")
    smooth = max(row["error"] for row in rows if row["method"] == "approximating")
    summary = (
        f"Interpolating solids carry the values of 0 to 100 to {exact:.0e} at every vertex, the approximating one is "
        f"off by up to {smooth:.0f}. The price is overshoot: the attribute leaves 0 to 100 in between, so a coefficient"
        " that must be positive needs an offset."
    )
    figures = [Figure("side_by_side", lambda path: _picture(path, meshes), "approximating and interpolating")]
    figures.append(Figure("iterations", _iterations, "the material after 0, 1, 3 and 10 steps of PIA (Figure 6)"))
    return Result(made, tuple(figures), summary)


def _meshes(size: Size, progress: Progress) -> dict[str, HexMesh]:
    shapes = {"5 tetrahedra in 20": cross_of_tetrahedra(5), "fan of 5": fan(5)}
    if size == "full":
        shapes |= {"fan of 3": fan(3), "box 6": box(6, 6, 6)}
    made = {name: hex_mesh(*mesh) for name, mesh in shapes.items()}
    if size == "full":
        for file in ("rod.vtk", "bunny_octree.vtk", "airplane1_octree.vtk"):
            if (HEXES / file).is_file():
                made[file] = read_hexes(HEXES / file)
            else:
                progress.say(f"{file} is not there and left out")
    return {name: replace(mesh, attributes={"value": banded(mesh.points)}) for name, mesh in made.items()}


def banded(points: Array) -> Array:
    """Values 0, 50, 100, 50, 0, .. (v,) in bands across the longest direction of the points (v, 3)."""
    axis = int(np.ptp(points, axis=0).argmax())
    s = (points[:, axis] - points[:, axis].min()) / np.ptp(points[:, axis])
    return 50.0 * np.abs((np.floor(s * 7.999) + 2) % 4 - 2)


def _row(mesh: HexMesh, method: str) -> dict[str, Any]:
    settings = catmull_clark.Settings(interpolate=method, features="none", depth=0 if len(mesh.points) > 1000 else 1)
    domain = catmull_clark.domain_of(mesh, settings)
    limit = limit_matrix(stored_topology(domain))
    n = len(mesh.points)
    value = np.asarray(domain.attributes["value"])
    error = np.abs((limit @ value)[:n] - mesh.attributes["value"]).max()
    off = np.linalg.norm((limit @ domain.points)[:n] - mesh.points, axis=1).max() / diagonal(mesh.points)
    low, high = _range(domain, value)
    conductivity = Field(domain.space, 50.0 + 0.5 * value)
    split = halves(domain)
    problem = Heat(conductivity, temperature={"low": 0.0, "high": 1.0})
    solution = heat.solve(problem, split)
    return {
        "cells": len(mesh.topology.hexes), "error": float(error), "position_error": float(off), "lowest": low,
        "highest": high, "mass": float(integral(domain, Field(domain.space, 1.0 + value))),
        "heat": float(solution.log["energy"]),
        "seconds": float(solution.log["assemble_s"]) + float(solution.log["solve_s"]),
    }  # fmt: skip


def _range(domain: Domain, value: Array) -> tuple[float, float]:
    """Range of an attribute at 4 x 4 x 4 points of every element."""
    grid = np.array(list(np.ndindex(4, 4, 4))) / 3.0
    low, high = np.inf, -np.inf
    for block in domain.space.blocks:
        sampled = bezier_coefficients(block, value[:, None])[..., 0] @ block.basis.tabulate(grid, 0)[0].T
        low, high = min(low, float(sampled.min())), max(high, float(sampled.max()))
    return low, high


def _picture(path: Path, meshes: dict[str, HexMesh]) -> None:
    panels = []
    for name, mesh in meshes.items():
        if name in ("5 tetrahedra in 20", "bunny_octree.vtk", "airplane1_octree.vtk"):
            for method in METHODS_OF_MODELS:
                settings = catmull_clark.Settings(interpolate=METHODS[method], features="none", depth=0)
                domain = catmull_clark.domain_of(mesh, settings)
                values = np.asarray(domain.attributes["value"])
                for cut in (None, "-y"):
                    look: dict[str, Any] = {"limits": (0.0, 100.0), "cut": cut, "edges": "." not in name, "size": 520}
                    title = f"{name}: {method}{', inside' if cut else ''}"
                    panels.append((title, plot_field(domain, values, "value", **look)))
    plot_panels(path, panels, 4)


def _iterations(path: Path) -> None:
    """The attribute on the solids after some steps of progressive iteration."""
    points, cells = cross_of_tetrahedra(5)
    mesh = hex_mesh(points, cells)
    topology = with_features(mesh.topology, mesh.points, "none")
    given = np.column_stack([mesh.points, banded(mesh.points) / 100.0])
    panels = []
    for steps in (0, 1, 3, 10):
        values = pia(topology, given, iterations=steps).values
        stepped = replace(mesh, points=values[:, :3], attributes={"value": 100.0 * values[:, 3]})
        domain = catmull_clark.domain_of(stepped, catmull_clark.Settings(interpolate="none", features="none"))
        picture = plot_field(domain, domain.attributes["value"], "value", limits=(0.0, 100.0), size=520)
        panels.append((f"{steps} steps", picture))
    plot_panels(path, panels, 4)
