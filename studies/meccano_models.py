"""Which surfaces become certified spline solids, how near do they come to the surface, and what do they cost?

Each closed triangulation is built with the settings of the source "meccano": at the small size the surfaces made by
formula, at full size all files of the data folder that are there (others are left out and said), with a row that says
"refused" and why where a surface bounds no solid or has no meccano, and "certified, but off" where a valid solid is
farther from its surface than the tolerance. Files in `MENDED` are built a second time with mend. Beside the verdicts
stands what the paper reports of its bunny (Escobar, Cascon, Rodriguez and Montenegro, section 4.2): cells, the share of
cells with a scaled Jacobian below one half, and the difference of volumes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

from geometry.layouts.frame import frame_of
from geometry.meccano import Settings, domain_of
from geometry.meccano.shapes import ball, star, torus
from geometry.meccano.tmesh import from_arrays
from geometry.simplices.reading import read_surface
from geometry.simplices.surface import Surface
from iga.assembly import volume
from iga.certificate import quality
from iga.domain import Domain
from iga.errors import InputError
from iga.pictures.plot import plot_domain
from iga.progress import Progress
from studies.data import SURFACES
from studies.describe import wholly_certified
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

NAME = "meccano_models"
COLUMNS = (
    Column("model", "text", key=True),
    Column("verdict", "text"),
    Column("genus", "int"),
    Column("blocks", "int"),
    Column("cells", "int", relative=0.1, absolute=100),
    Column("functions", "int", relative=0.1, absolute=200),
    Column("refuted", "int"),
    Column("undecided", "int"),
    Column("least", relative=0.2, absolute=0.05, format=".3f"),
    Column("below_half", relative=0.2, absolute=0.02, format=".3f"),
    Column("volume_error", relative=0.5, absolute=1e-3, format=".1e"),
    Column("distance", relative=0.3, absolute=1e-3, format=".2e"),
    Column("seconds", "time", "s"),
)
SLOPES: tuple[Slope, ...] = ()
SMALL: dict[str, tuple[Callable[[], Surface], Settings]] = {
    "ball": (lambda: ball(12), Settings(tolerance=0.01, max_cells=500)),
    "star": (lambda: star(12), Settings(tolerance=0.01, max_cells=1500)),
    "torus": (lambda: torus(32, 14), Settings(tolerance=0.01, max_cells=2000)),
}
MENDED = ("cow.off", "stanford_bunny_69k.obj")
"""Files that bound no solid as they are."""


def run(size: Size, progress: Progress) -> Result:
    """Build all models."""
    rows, solids = [], []
    jobs: list[tuple[str, Callable[[], Surface], Settings]] = [(k, f, s) for k, (f, s) in SMALL.items()]
    if size == "full":
        files = sorted(SURFACES.glob("*.*")) if SURFACES.is_dir() else []
        jobs += [(path.name, partial(surface_of, path), Settings()) for path in files]
        jobs += [(f"{path.name}, mended", partial(surface_of, path, True), Settings()) for path in files
                 if path.name in MENDED]
    for name, surface, settings in progress.track(jobs, "surfaces"):
        row, domain = _row(name, surface, settings)
        rows.append(row)
        if domain is not None:
            solids.append((name, domain))
    figures = tuple(
        Figure(Path(name).stem, partial(_draw, domain), f"{name}, cells of the T-mesh.") for name, domain in solids
    )
    return Result(table(NAME, COLUMNS, rows, SLOPES), figures, _said(rows, size))


def surface_of(path: Path, mend: bool = False) -> Surface:
    """The surface of a file, mended if asked for."""
    return read_surface(path, mend)[0]


def _row(name: str, surface: Callable[[], Surface], settings: Settings) -> tuple[dict[str, Value], Domain | None]:
    began = perf_counter()
    try:
        domain = domain_of(surface(), replace(settings, off="keep"), name)
    except InputError as error:
        return {"model": name, "verdict": f"refused: {error}", "seconds": perf_counter() - began}, None
    proof = quality(domain)
    shape = proof["scaled_jacobian"]
    told = domain.report
    good = wholly_certified(proof)
    verdict = "not certified" if not good else "certified" if told["within_tolerance"] else "certified, but off"
    row: dict[str, Value] = {
        "model": name, "verdict": verdict, "genus": frame_of(from_arrays(domain.provenance.arrays).blocks).genus,
        "blocks": told["blocks"], "cells": told["cells"], "functions": domain.space.n, "refuted": proof["refuted"],
        "undecided": proof["undecided"], "least": shape["min"], "below_half": shape["share_below_half"],
        "volume_error": abs(volume(domain, 5) / told["surface_volume"] - 1.0),
        "distance": told["distance"]["relative"], "seconds": perf_counter() - began,
    }  # fmt: skip
    return row, domain


def _draw(domain: Domain, path: Path) -> None:
    plot_domain(domain, path, up="y")


def whole_boundary(domain: Domain) -> Domain:
    """The domain with one name for its whole boundary, so that pictures show it in one colour."""
    return Domain(domain.space, domain.points, {"boundary": domain.boundaries["boundary"]})


def _said(rows: list[dict[str, Value]], size: Size) -> str:
    good = sum(str(row["verdict"]).startswith("certified") for row in rows)
    off = sum(row["verdict"] == "certified, but off" for row in rows)
    refused = sum(str(row["verdict"]).startswith("refused") for row in rows)
    missing = "" if size == "ci" or SURFACES.is_dir() else " The data folder is not there."
    far = f" ({off} of them farther from the surface than the tolerance)" if off else ""
    return f"{good} of {len(rows)} surfaces certified{far}, {refused} refused.{missing}"
