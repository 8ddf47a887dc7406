"""Which solids with holes become spline solids on polycubes found by themselves, and what do the two kinds cost?

Figure 6 of Escobar, Cascon, Rodriguez and Montenegro, "The meccano method for isogeometric solid modeling", shows one
solid of genus one whose surface parametrisation was given by hand. Here polycube and surface map are found; each model
is built twice:

    pillowed    the default: truncated hierarchical cubics on the pillowed polycube, every cell certified
    t-spline    the paper's T-splines on the polycube itself, interpolating the map of its tetrahedra

``gauss`` and ``centre`` are cells with a negative Gauss point and centre, ``refuted`` elements that fold somewhere. At
the small size a torus; at full size also the models with holes of the data folder (others are left out and said).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from geometry.layouts.blocks import place
from geometry.meccano import Settings, domain_of
from geometry.meccano.domain import bare
from geometry.meccano.fitting import greville_points
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.shapes import torus
from geometry.meccano.tmesh import from_arrays
from geometry.simplices.surface import Surface, genus
from iga.assembly import volume
from iga.certificate import quality
from iga.domain import Domain
from iga.errors import InputError
from iga.pictures.plot import plot_domain
from iga.pictures.skin import Cut
from iga.progress import Progress
from studies.data import SURFACES
from studies.describe import wholly_certified
from studies.figures import plot_panels
from studies.meccano_models import surface_of, whole_boundary
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

NAME = "meccano_genus"
COLUMNS = (
    Column("model", "text", key=True),
    Column("kind", "text", key=True),
    Column("verdict", "text"),
    Column("genus", "int"),
    Column("voxels", "int"),
    Column("blocks", "int"),
    Column("tets", "int", relative=0.1),
    Column("cells", "int", relative=0.1, absolute=50),
    Column("functions", "int", relative=0.1, absolute=100),
    Column("centre", "int", absolute=3),
    Column("gauss", "int", absolute=5),
    Column("refuted", "int", absolute=10),
    Column("least", relative=0.2, absolute=0.05, format=".3f"),
    Column("below_half", relative=0.2, absolute=0.02, format=".3f"),
    Column("volume_error", relative=0.5, absolute=2e-3, format=".1e"),
    Column("distance", relative=0.3, absolute=1e-3, format=".2e"),
    Column("seconds", "time", "s"),
)
SLOPES: tuple[Slope, ...] = ()
FILES = ("bob_small.ply", "kitten.off", "eight.off", "idler_riser.stl", "fertility.off")


def run(size: Size, progress: Progress) -> Result:
    """Build all models in both kinds."""
    jobs: list[tuple[str, Callable[[], Surface], Settings, Settings]] = [(
        "torus", lambda: torus(32, 14), Settings(tolerance=0.015, max_cells=1200, off="keep"),
        Settings(space="t-spline", tolerance=0.03),
    )]  # fmt: skip
    there = [SURFACES / name for name in FILES if (SURFACES / name).is_file()] if size == "full" else []
    for path in there:
        paper = Settings(space="t-spline", tolerance=0.01)
        jobs.append((path.name, partial(surface_of, path), Settings(tolerance=0.006, off="keep"), paper))
    rows: list[dict[str, Value]] = []
    shown: list[tuple[str, dict[str, Domain]]] = []
    for name, read, pillowed, paper in progress.track(jobs, "solids with holes"):
        made: dict[str, Domain] = {}
        for kind, settings in (("pillowed", pillowed), ("t-spline", paper)):
            row, domain = _row(name, kind, read(), settings)
            rows.append(row)
            if domain is not None:
                made[kind] = domain
        shown.append((name, made))
    figures = tuple(
        Figure(Path(name).stem, partial(_draw, made), f"{name}: polycube, solids, cuts.")
        for name, made in shown if made
    )
    return Result(table(NAME, COLUMNS, rows, SLOPES), figures, _said(rows, size, len(there)))


def _row(name: str, kind: str, surface: Surface, settings: Settings) -> tuple[dict[str, Value], Domain | None]:
    began = perf_counter()
    row: dict[str, Value] = {"model": name, "kind": kind, "genus": genus(surface)}
    try:
        domain = domain_of(surface, settings, name)
    except InputError as error:
        return row | {"verdict": f"refused: {error}", "seconds": perf_counter() - began}, None
    proof, told = quality(domain), domain.report
    shape = proof["scaled_jacobian"]
    good = wholly_certified(proof)
    # The paper judges cells, of which T-splines have several elements.
    last = told["remedy"][-1] if "remedy" in told else {
        "negative_centre": shape["cells_negative_centre"], "negative_gauss": shape["cells_negative_gauss"],
        "least": shape["min"], "below_half": shape["share_below_half"],
    }  # fmt: skip
    return row | {
        "verdict": "certified" if good else "not certified", "voxels": told["voxels"], "blocks": told["blocks"],
        "tets": told["tets"]["tets"] if "tets" in told else None, "cells": told["cells"], "functions": domain.space.n,
        "centre": last["negative_centre"], "gauss": last["negative_gauss"], "refuted": proof["refuted"],
        "least": last["least"], "below_half": last["below_half"],
        "volume_error": abs(volume(domain, 6) / told["surface_volume"] - 1.0),
        "distance": told["distance"]["relative"], "seconds": perf_counter() - began,
    }, domain  # fmt: skip


def _said(rows: list[dict[str, Value]], size: Size, files: int) -> str:
    pillowed = [row for row in rows if row["kind"] == "pillowed"]
    good = sum(row["verdict"] == "certified" for row in pillowed)
    missing = "" if size == "ci" or files == len(FILES) else f" {len(FILES) - files} models are not in the data folder."
    return f"{good} of {len(pillowed)} solids with holes certified.{missing}"


def _draw(made: dict[str, Domain], path: Path) -> None:
    look: dict[str, Any] = {"names": False, "size": 700}
    parts = []
    if "pillowed" in made:
        tmesh = from_arrays(made["pillowed"].provenance.arrays)
        space = hierarchy(tmesh)
        straight = bare(space, place(tmesh.blocks, *greville_points(space)))
        parts.append(("pillowed polycube", plot_domain(whole_boundary(straight), **look)))
    for kind, domain in made.items():
        parts.append((kind, plot_domain(whole_boundary(domain), **look)))
        # Across the shortest extent, where the holes show.
        normal = np.zeros(3)
        normal[np.ptp(domain.points, axis=0).argmin()] = 1.0
        parts.append((f"{kind}, cut", plot_domain(whole_boundary(domain), cut=Cut(normal.tolist()), **look)))
    plot_panels(path, parts, 3)
