"""Heat and elasticity on bunny-like and airplane-like Catmull-Clark solids (Xie et al. 2020, Figures 5, 8 and 9).

Each solid stands on the part of its boundary that is lowest along one axis and is loaded on the opposite part: heat
between a cold and a hot end, elasticity held at the low end and pressed down at the high one, everything else free and
insulated. Columns: the certificate, the patch test (a linear field prescribed on the boundary, relative error in L2),
volume against the divergence theorem on the boundary, energies, extrema and times. Built-in shapes stand for the models
at the small size; at full size all meshes of the data folder that are there (others are left out and said).

Found at full size, repaired where cells would fold (vertices whose control points moved, of those on the boundary, and
how far the surface is then, over the diagonal); all cells of all meshes are certified, patch tests hold to 4e-15,
volumes equal the divergence theorem to 1.4e-15:

    mesh                   cells   functions  moved  boundary  surface   strain energy  largest stress
    bunny_octree           21,695     26,375  5,951         0  0                  1610            112
    airplane1_octree       24,318     29,899  3,823       148  1.6e-4            74.79           38.8
    bone_octree             8,619     10,356  2,554        41  2.0e-5            554.0           31.6
    ellipsoid               6,816      7,293      0         0  0              2.595e-5           1.65
    fertility               4,000      4,983    732         0  0              3.824e-5           81.3
    rod                     1,280      1,815    108         0  0                0.3670           41.9
    rod_pillowed_inverted   2,272      2,805    356         0  0                0.3263           23.9
    joint                   6,144      7,512  3,485       735  4.5e-3             2477            184
    mount1                  4,480      5,849    784       204  1.8e-3            296.6           9.63
    mount_with_holes        3,712      5,060    969       498  6.5e-5            8.158           15.3

The largest stress is at the rim of the held part, where it grows without end under refinement. The bunny's elasticity
(79,125 unknowns, 71 million entries) takes 2.5 GB and 85 s on one thread, 98 iterations.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import geometry.catmull_clark as catmull_clark
from geometry.catmull_clark.mesh import HexMesh, hex_mesh, read_hexes
from geometry.catmull_clark.shapes import cross_of_tetrahedra, fan
from geometry.catmull_clark.subdivision import subdivide
from iga.assembly import integral, volume
from iga.certificate import quality
from iga.chunk import facet_chunks
from iga.domain import Domain, Facets, all_facets
from iga.pictures.plot import plot_field
from iga.progress import Progress
from problems import Elasticity, Heat, Solution, elasticity, heat, solve_exact
from problems.material import isotropic
from studies.data import HEXES
from studies.figures import plot_panels
from studies.study import Figure, Result, Size
from studies.table import Column, table

Array = NDArray[np.float64]

NAME = "catmull_clark_models"
COLUMNS = (
    Column("model", "text", key=True),
    Column("cells", "int"),
    Column("functions", "int"),
    Column("certified", "int"),
    Column("refuted", "int"),
    Column("undecided", "int"),
    Column("moved", "int", absolute=2),
    Column("slid", "int", absolute=2),
    Column("surface", relative=0.1, absolute=1e-6, format=".1e"),
    Column("patch_test", at_most=1e-10, format=".0e"),
    Column("divergence", at_most=1e-10, format=".0e"),
    Column("volume", relative=1e-4, format=".5g"),
    Column("heat_energy", relative=1e-3, format=".4g"),
    Column("hottest", relative=1e-3, absolute=1e-3, format=".3g"),
    Column("strain_energy", relative=1e-2, format=".4g"),
    Column("largest_stress", relative=5e-2, format=".3g"),
    Column("build_s", "time", "s"),
    Column("assemble_s", "time", "s"),
    Column("solve_s", "time", "s"),
)
SLOPES = ()
MODELS = {
    "bunny_octree.vtk": (2, (0.3, -1.0, 0.3)), "airplane1_octree.vtk": (0, (0.6, -1.0, 0.9)),
    "bone_octree.vtk": (0, (0.3, -1.0, 0.6)), "ellipsoid.mesh": (0, (0.3, -1.0, 0.6)),
    "fertility.vtk": (2, (0.3, -1.0, 0.6)), "rod.vtk": (0, (0.3, -1.0, 0.6)), "joint.vtk": (0, (0.3, -1.0, 0.6)),
    "rod_pillowed_inverted.vtk": (0, (0.3, -1.0, 0.6)), "mount1.vtk": (0, (0.3, -1.0, 0.6)),
    "mount_with_holes.vtk": (0, (0.3, -1.0, 0.6)),
}
"""Files, the axis along which each is loaded, and where it is seen from."""
BUILT_IN = {"block of 5 tetrahedra": (cross_of_tetrahedra(5), 2, 1), "prism of valence 3": (fan(3, 4), 2, 0)}
"""Shapes, the axis along which each is loaded, and how often it is subdivided first."""


def run(size: Size, progress: Progress) -> Result:
    """Build, certify and solve all models."""
    rows, shown = [], []
    for name, (mesh, axis, view) in progress.track(list(_models(size, progress).items()), "models"):
        row, solutions = _row(mesh, axis, "." in name)
        rows.append({"model": name, **row})
        shown.append((name, view, solutions))
    valid = [row["model"] for row in rows if row["certified"] == row.pop("_elements")]
    made = table(NAME, COLUMNS, rows, SLOPES)
    worst = max((row["patch_test"] for row in rows), default=0.0)
    summary = (
        f"{len(valid)} of {len(rows)} models are certified on every element. Patch tests hold to {worst:.0e} and "
        f"volumes equal the divergence theorem to {max(row['divergence'] for row in rows):.0e}."
    )
    figure = Figure("solved", lambda path: _picture(path, shown), "temperature and von Mises stress")
    return Result(made, (figure,), summary)


def _models(size: Size, progress: Progress) -> dict[str, tuple[HexMesh, int, tuple[float, ...] | None]]:
    made: dict[str, tuple[HexMesh, int, tuple[float, ...] | None]] = {}
    for name, (shape, axis, levels) in BUILT_IN.items():
        mesh = hex_mesh(*shape)
        for _ in range(levels):
            topology, S = subdivide(mesh.topology)
            mesh = HexMesh(S @ mesh.points, topology)
        made[name] = (mesh, axis, None)
    if size == "full":
        for file, (axis, view) in MODELS.items():
            if (HEXES / file).is_file():
                made[file] = (read_hexes(HEXES / file), axis, view)
            else:
                progress.say(f"{file} is not there and left out")
    return made


def _row(mesh: HexMesh, axis: int, real: bool) -> tuple[dict[str, Any], tuple[Solution, Solution]]:
    start = time.perf_counter()
    domain = catmull_clark.domain_of(mesh, catmull_clark.Settings(repair=real, depth=0 if real else 1))
    build_s = time.perf_counter() - start
    found = quality(domain)
    split = halves(domain, axis)
    hot = heat.solve(Heat(temperature={"low": 0.0, "high": 100.0}), split)
    force = np.zeros(3)
    force[axis] = -1.0
    pressed = Elasticity(
        isotropic(1000.0, 0.3), displacement={"low": (0.0, 0.0, 0.0)}, traction={"high": tuple(force.tolist())}
    )
    bent = elasticity.solve(pressed, split)
    logs = (hot.log, bent.log)
    row = {
        "cells": len(mesh.topology.hexes), "functions": domain.space.n, "certified": found["certified"],
        "refuted": found["refuted"], "undecided": found["undecided"], "moved": int(domain.report["moved_vertices"]),
        "slid": int(domain.report.get("moved_boundary_vertices", 0)),
        "surface": float(domain.report.get("boundary_distance", 0.0)),
        "_elements": domain.space.elements,
        "patch_test": solve_exact(domain, "heat", "1+2*x-y+3*z", points=5)[1]["relative_l2_error"],
        "divergence": abs(outflow(domain) / float(integral(domain, 1.0, points=6)) - 1.0), "volume": volume(domain, 6),
        "heat_energy": float(hot.log["energy"]), "hottest": hot.extrema("temperature")[1],
        "strain_energy": float(bent.log["energy"]), "largest_stress": bent.extrema("von_mises")[1],
        "build_s": build_s, "assemble_s": sum(float(log["assemble_s"]) for log in logs),
        "solve_s": sum(float(log["solve_s"]) for log in logs),
    }  # fmt: skip
    return row, (hot, bent)


def outflow(domain: Domain) -> float:
    """Volume by the divergence theorem: the integral of x . n/3 over the boundary."""
    return sum(
        float((chunk.dx * np.einsum("eqc,eqc->eq", chunk.x, chunk.normal)).sum()) / 3.0
        for chunk in facet_chunks(domain, all_facets(domain), points=6)
    )


def halves(domain: Domain, axis: int | None = None, share: float = 0.1) -> Domain:
    """The domain with its boundary named by where it is: "low", "high" (that share of the height) and "between".

    Facets are told apart by the mean of their points; the axis is by default the longest.
    """
    axis = int(np.ptp(domain.points, axis=0).argmax()) if axis is None else axis
    middle: list[tuple[Facets, Array]] = []
    for facets in all_facets(domain):
        places = [chunk.x[..., axis].mean(axis=1) for chunk in facet_chunks(domain, (facets,), points=2)]
        middle.append((facets, np.concatenate(places)))
    every = np.concatenate([place for _, place in middle])
    low, high = every.min(), every.max()
    named: dict[str, list[Facets]] = {"low": [], "high": [], "between": []}
    for facets, place in middle:
        s = (place - low) / (high - low)
        low_end, high_end = s <= share, s >= 1.0 - share
        for name, take in (("low", low_end), ("high", high_end), ("between", ~(low_end | high_end))):
            if take.any():
                named[name].append(Facets(facets.block, facets.face, facets.elements[take]))
    return replace(domain, boundaries={name: tuple(parts) for name, parts in named.items()})


def _picture(path: Path, shown: list[tuple[str, tuple[float, ...] | None, tuple[Solution, Solution]]]) -> None:
    panels = []
    for name, view, (hot, bent) in shown:
        look: dict[str, Any] = {"view": view, "edges": "." not in name, "size": 560}
        temperature = plot_field(hot.domain, hot.coefficients, "temperature", **look)
        values = np.concatenate([value.ravel() for *_, value in bent.samples("von_mises", 2)])
        usual = float(np.quantile(values, 0.98))  # peaks at the ends of supports would leave one colour for all else
        stress = plot_field(
            bent.domain, bent.quantity("von_mises").evaluate, "von Mises stress", warp=bent.coefficients,
            limits=(0.0, usual), **look,
        )  # fmt: skip
        panels += [(f"{name}: heat", temperature), ("elasticity", stress)]
    plot_panels(path, panels, 2 if len(panels) <= 4 else 4)
