"""How many cells of the paper's T-spline solid fold, what does its remedy help, and what do solids without folds cost?

Figure 5 of Escobar, Cascon, Rodriguez and Montenegro, "The meccano method for isogeometric solid modeling", and its
text, with a bunny of 7,000 triangles (the paper's own is another one, so trends compare, not digits; its numbers stand
in the rows "paper"). At the small size, and where the data folder is missing, a star takes the bunny's place.

    tetrahedra          Kuhn's tetrahedra of the cube, adapted to the surface by volumes d(T), untangled and smoothed
    t-spline, round k   the paper's T-splines on the octree of their nodes; each round splits cells with a negative
                        centre
    optimal, cube       clamped hierarchical splines nearest to the same tetrahedra on the octree of round 0
    optimal, untangled  the same with inner control points moved
    pillowed            the default: no cell has two faces on the boundary, every cell is certified
    pillowed, fine      the same within a thousandth of the diagonal (full size only)

``centre`` and ``gauss`` are cells with a negative centre and with a negative one of 2 x 2 x 2 Gauss points, ``refuted``
Bezier elements that fold somewhere, proved. A cell on two sides of the cube has two faces in one tangent plane where
the surface is smooth, so on the cube some are bound to fold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import place
from geometry.meccano import Settings, domain_of, read_surface
from geometry.meccano.bisection import FULL
from geometry.meccano.domain import bare
from geometry.meccano.fitting import greville_points
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.paper import (
    Fit,
    Round,
    at_cells,
    boundary_triangles,
    fit,
    judged,
    nodes_of,
    remedied,
    tetrahedra,
    untangled,
    volume_of,
)
from geometry.meccano.parametrisation import Parametrisation
from geometry.meccano.shapes import star
from geometry.meccano.source import map_of
from geometry.meccano.tmesh import TMesh, octree
from geometry.simplices.distance import distances
from geometry.simplices.surface import Surface, volume
from iga.assembly import volume as content
from iga.cells import TETRAHEDRON
from iga.certificate import certify, summary
from iga.conforming import Complex, straight_domain
from iga.domain import Domain
from iga.pictures.plot import plot_domain, plot_field
from iga.pictures.skin import Cut
from iga.progress import QUIET, Progress
from iga.sampling import Samples
from iga.scaled_jacobian import scale, scaled_jacobian
from studies.data import SURFACES
from studies.figures import plot_panels
from studies.meccano_models import whole_boundary
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]

NAME = "meccano_bunny"
COLUMNS = (
    Column("model", "text", key=True),
    Column("nodes", "int", relative=0.05),
    Column("tets", "int", relative=0.05),
    Column("inverted", "int"),
    Column("cells", "int", relative=0.05),
    Column("functions", "int", relative=0.05),
    Column("centre", "int", relative=0.5, absolute=3),
    Column("gauss", "int", relative=0.3, absolute=5),
    Column("refuted", "int", relative=0.2, absolute=10),
    Column("least", relative=0.1, absolute=0.05, format=".3f"),
    Column("below_half", relative=0.2, absolute=0.02, format=".3f"),
    Column("centre_below_half", relative=0.2, absolute=0.02, format=".3f"),
    Column("volume_error", relative=0.3, absolute=1e-3, format=".1e"),
    Column("distance", relative=0.3, absolute=1e-3, format=".2e"),
    Column("between", relative=0.3, absolute=1e-3, format=".2e"),
    Column("seconds", "time", "s"),
)
SLOPES: tuple[Slope, ...] = ()
PAPER: tuple[dict[str, Value], ...] = (
    {"model": "paper, tetrahedra", "volume_error": 4.0 / 754.9},
    {"model": "paper, round 0", "cells": 9696, "centre": 5, "gauss": 39, "below_half": 0.06,
     "volume_error": 2.5 / 754.9},
    {"model": "paper, round 1", "centre": 4}, {"model": "paper, round 2", "centre": 2},
    {"model": "paper, round 3", "centre": 0},
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Solids:
    """What is drawn: tetrahedra, octree and the two solids."""

    mapping: Parametrisation
    tmesh: TMesh
    paper: Domain
    certified: Domain


def run(size: Size, progress: Progress) -> Result:
    """Build the paper's solid, round by round, and ours beside it."""
    bunny = SURFACES / "bunny_7k.off"
    full = size == "full" and bunny.is_file()
    surface = read_surface(bunny)[0] if full else star(10)
    tolerance, cells = (0.005, 10000) if full else (0.03, 1500)
    rows, solids = _paper(surface, tolerance, cells, progress)
    aims = {"pillowed": Settings(tolerance=0.01, max_cells=600)}
    if full:
        aims = {"pillowed": Settings(max_cells=cells), "pillowed, fine": Settings(tolerance=0.00083, max_cells=100000)}
    made = {}
    for model, aim in aims.items():
        made[model], row = _pillowed(surface, aim, progress)
        rows.append({"model": model, **row})
    shown, grown = _Solids(*solids, made["pillowed"]), next(row for row in rows if row["model"] == "pillowed")
    first, last = rows[1], next(row for row in reversed(rows) if str(row["model"]).startswith("t-spline"))
    summary_ = (
        f"The paper's T-splines have {first['gauss']} of {first['cells']} cells with a negative Gauss point and "
        f"{first['centre']} with a negative centre, {last['centre']} after the remedy; {first['refuted']} elements are "
        f"refuted before it and {last['refuted']} after. Pillowed, {grown['refuted']} of {grown['cells']} are."
    )
    panels: tuple[tuple[str, Callable[[Path], None], str], ...] = (
        ("figure_5", partial(_figure_5, shown), "As Figure 5: tetrahedra and cells of the cube, tetrahedra of the "
         "solid, T-spline solid, two cuts."),
        ("scaled_jacobian", partial(_jacobians, shown), "Scaled Jacobian, the paper's solid and the pillowed one."),
    )
    return Result(
        table(NAME, COLUMNS, [*rows, *PAPER], SLOPES), tuple(Figure(*panel) for panel in panels), summary_
    )


def _pillowed(surface: Surface, aim: Settings, progress: Progress) -> tuple[Domain, dict[str, Value]]:
    """Our solid, and its numbers."""
    began = perf_counter()
    certified = domain_of(surface, aim, shown=progress)
    proof, shape = summary(certify(certified)), scaled_jacobian(certified)
    return certified, {
        "cells": certified.report["cells"], "functions": certified.space.n, "centre": shape["cells_negative_centre"],
        "gauss": shape["cells_negative_gauss"], "refuted": proof["refuted"], "least": shape["min"],
        "below_half": shape["share_below_half"],
        "volume_error": abs(content(certified, 5) / volume(surface) - 1.0),
        "distance": certified.report["distance"]["relative"], "seconds": perf_counter() - began,
    }  # fmt: skip


def _paper(
    surface: Surface, tolerance: float, cells: int, progress: Progress
) -> tuple[list[dict[str, Value]], tuple[Parametrisation, TMesh, Domain]]:
    """Rows of tetrahedra, T-splines round by round, and clamped splines."""
    whole, began = volume(surface), perf_counter()
    boundary, _ = map_of(surface, Settings(meccano="cube"), QUIET)
    mapping, stages = tetrahedra(boundary, tolerance * surface.diagonal, "volume", cells, shown=progress)
    rows: list[dict[str, Value]] = [{
        "model": "tetrahedra", "nodes": stages[-1].nodes, "tets": stages[-1].tets, "inverted": stages[-1].after,
        "volume_error": abs(volume_of(mapping) / whole - 1.0), "seconds": perf_counter() - began,
    }]  # fmt: skip
    began = perf_counter()
    tmesh = octree(boundary.blocks, *nodes_of(mapping), limit=cells)
    made = fit("t-spline", tmesh, mapping)
    first = perf_counter() - began
    other = fit("optimal", tmesh, mapping)
    gap = float(np.linalg.norm(_lattice(made) - _lattice(other), axis=2).max()) / surface.diagonal
    began = perf_counter()
    last, history = remedied("t-spline", made, mapping, 4, cells, progress)
    spent = (perf_counter() - began) / max(len(history) - 1, 1)
    for number, found in enumerate(history):
        rows.append({"model": f"t-spline, round {number}", **_numbers(found, whole), "seconds": spent})
    rows[1] |= _proved(made, surface) | {"between": gap, "seconds": first}
    if last is not made:
        rows[-1] |= _proved(last, surface)
    for name, which in (("optimal, cube", lambda: other), ("optimal, untangled", lambda: untangled(other, progress))):
        began = perf_counter()
        own = which()
        rows.append({
            "model": name, **_numbers(judged(own)[0], whole), **_proved(own, surface),
            "seconds": perf_counter() - began,
        })  # fmt: skip
    return rows, (mapping, tmesh, bare(made.space, made.points))


def _lattice(made: Fit) -> Array:
    line = np.array([0.0, 0.5, 1.0])
    return at_cells(made, np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3))[0]


def _numbers(found: Round, whole: float) -> dict[str, Value]:
    return {
        "cells": found.cells, "centre": found.negative_centre, "gauss": found.negative_gauss, "least": found.least,
        "below_half": found.below_half, "centre_below_half": found.centre_below_half,
        "volume_error": abs(found.volume / whole - 1.0),
    }  # fmt: skip


def _proved(made: Fit, surface: Surface) -> dict[str, Value]:
    domain = bare(made.space, made.points)
    return {
        "functions": domain.space.n, "refuted": summary(certify(domain))["refuted"],
        "distance": distances(surface, *boundary_triangles(domain))["relative"],
    }  # fmt: skip


# --- pictures ---------------------------------------------------------------------------------------------------------


def _figure_5(shown: _Solids, path: Path) -> None:
    mapping = shown.mapping
    mesh = Complex(((TETRAHEDRON, mapping.tets),))
    places = np.zeros_like(mapping.nodes)
    places[mapping.tets] = mapping.places / FULL
    space = hierarchy(shown.tmesh)
    straight = bare(space, place(shown.tmesh.blocks, *greville_points(space)))
    look: dict[str, Any] = {"names": False, "size": 700, "up": "y"}
    middle = Cut((1.0, 0.0, 0.0), smooth=True), Cut((0.0, 0.0, 1.0), smooth=True)
    parts = [
        ("tetrahedra of the cube", plot_domain(straight_domain(mesh, places), **look)),
        ("T-mesh", plot_domain(whole_boundary(straight), **look)),
        ("tetrahedra of the solid", plot_domain(straight_domain(mesh, mapping.nodes), **look)),
        ("T-spline", plot_domain(whole_boundary(shown.paper), **look)),
        *(("cut", plot_domain(whole_boundary(shown.paper), cut=plane, **look)) for plane in middle),
    ]
    plot_panels(path, parts, 2)


def _jacobians(shown: _Solids, path: Path) -> None:
    def scaled(samples: Samples) -> Array:
        return scale("hexahedron", samples.J)

    look: dict[str, Any] = {"edges": False, "limits": (-1.0, 1.0), "colours": "RdBu", "size": 700, "up": "y"}
    parts = []
    for name, domain in (("T-splines on the cube", shown.paper), ("pillowed, certified", shown.certified)):
        for cut in (None, Cut((0.0, 0.0, 1.0))):
            title = name if cut is None else "cut"
            parts.append((title, plot_field(whole_boundary(domain), scaled, "scaled Jacobian", cut=cut, **look)))
    plot_panels(path, parts, 2)
