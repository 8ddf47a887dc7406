"""Which CAD solids become certified volumes, how near do they come to the CAD surfaces, and what do they cost?

Each solid is built with the settings of the source "hybrid": at the small size the shapes made in code, at full size
all STEP and IGES files of the data folder, each by a command line of its own (``iga build FILE --source hybrid``),
solid by solid where a file has several. A solid that is refused has a row that says why, with the face.

``exact`` is the share of the skin's area within 1e-12 of the diagonal of the CAD surface, ``gap`` the largest distance
between the two sides of an edge of the skin, ``distance`` that of the skin to the CAD surfaces, both relative to the
diagonal, ``jump`` the largest jump of a random field with coefficients in [-1, 1], and of the map relative to the
diagonal, across all facets between two cells at random points (`iga.conformity`). ``volume_error`` is
relative to the volume that the CAD kernel integrates, ``closed_error`` to the integral over the CAD surfaces between
their trimming curves with the gaps between faces closed by strips, and ``spread`` is how well the kernel's is defined:
what it changes when the integral is taken about another point, because faces do not meet (`geometry.cad.integrals`).
``read``, ``skin`` and ``inside`` are seconds of the stages, ``cpu`` those of the processor, in all.
"""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import geometry
from geometry.hybrid.refinement import mesh_of
from iga.clock import Clock
from iga.conformity import worst_jump
from iga.domain import Domain
from iga.errors import InputError
from iga.pictures.plot import plot_domain
from iga.progress import Progress
from iga.store import load
from studies.data import CAD
from studies.describe import describe, wholly_certified, with_quality
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

NAME = "hybrid_models"
COLUMNS = (
    Column("model", "text", key=True),
    Column("verdict", "text"),
    Column("faces", "int"),
    Column("elements", "int", relative=0.15, absolute=50),
    Column("functions", "int", relative=0.15, absolute=100),
    Column("refuted", "int"),
    Column("undecided", "int"),
    Column("exact", relative=0.05, absolute=0.02, format=".3f"),
    Column("gap", at_most=1e-12, format=".1e"),
    Column("jump", at_most=1e-12, format=".1e"),
    Column("distance", relative=0.5, absolute=1e-6, format=".1e"),
    Column("volume_error", at_most=1e-4, format=".1e"),
    Column("closed_error", at_most=1e-4, format=".1e"),
    Column("spread", at_most=1e-3, format=".1e"),
    Column("read", "time", "s"),
    Column("skin", "time", "s"),
    Column("inside", "time", "s"),
    Column("seconds", "time", "s"),
    Column("cpu", "time", "s"),
    Column("memory", "time", "MB"),
)
SLOPES: tuple[Slope, ...] = ()
SMALL: dict[str, tuple[str, dict[str, Any]]] = {
    "curved_box": ("curved_box", {"tolerance": 1e-3, "size": 0.6}),
    "curved_box, pyramids": ("curved_box", {"tolerance": 1e-3, "size": 0.6, "skin": "hybrid"}),
    "curved_box, layers": ("curved_box", {"tolerance": 1e-3, "size": 0.6, "layers": 3}),
    "bracket": ("bracket", {"tolerance": 1e-3}),
}
MOST = 900
"""Seconds after which a file is given up."""


def run(size: Size, progress: Progress) -> Result:
    """Build all models."""
    rows: list[dict[str, Value]] = []
    figures: list[Figure] = []
    for name, (shape, settings) in progress.track(SMALL.items(), "shapes"):
        row, domain = _shape(name, shape, settings)
        rows.append(row)
        if domain is not None:
            text = f"{name}: elements, coloured by CAD face."
            figures.append(Figure(name.replace(", ", "_"), partial(_draw, domain), text))
    files = sorted(p for p in CAD.glob("*") if p.suffix.lower() in (".step", ".stp", ".iges", ".igs"))
    with tempfile.TemporaryDirectory() as folder:
        for path in progress.track(files if size == "full" else [], "files"):
            made = [_file(path, path.name, None, Path(folder) / "part.npz")]
            several = re.search(r": (\d+) solids \(", str(made[0][0]["verdict"]))
            if several:
                count = int(several.group(1))
                made = [_file(path, f"{path.name} {k}", k, Path(folder) / "part.npz") for k in range(count)]
            for row, domain in made:
                rows.append(row)
                if domain is not None:
                    name = str(row["model"])
                    figures.append(Figure(name.replace(" ", "_"), partial(_draw, domain), f"{name}, by CAD face."))
    return Result(table(NAME, COLUMNS, rows, SLOPES), tuple(figures), _said(rows, size, bool(files)))


def _shape(name: str, shape: str, settings: dict[str, Any]) -> tuple[dict[str, Value], Domain | None]:
    clock, before = Clock(), time.process_time()
    try:
        domain = with_quality(geometry.build(shape, "hybrid", **settings))
    except InputError as error:
        return _refused(name, str(error), clock.seconds), None
    row = row_of(name, describe(domain, clock))
    row["jump"] = worst_jump(domain, mesh_of(domain))
    return {**row, "cpu": time.process_time() - before, "memory": None}, domain


def _file(path: Path, name: str, solid: int | None, target: Path) -> tuple[dict[str, Value], Domain | None]:
    """Build a solid by the command line, in a process of its own."""
    words = [sys.executable, "-m", "studies.cli", "build", str(path), "--source", "hybrid", "--json", "-o", str(target)]
    words += ["--set", f"solid={solid}"] if solid is not None else []
    clock, before = Clock(), resource.getrusage(resource.RUSAGE_CHILDREN)
    root = Path(__file__).resolve().parents[1]
    try:
        done = subprocess.run(words, capture_output=True, text=True, cwd=root, timeout=MOST, check=False)
    except subprocess.TimeoutExpired:
        return _refused(name, f"no answer in {MOST} s", clock.seconds), None
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()] or ["no message"]
        return {**_refused(name, lines[-1].removeprefix("iga: "), clock.seconds), "cpu": cpu}, None
    found = json.loads(done.stdout)
    row = row_of(name, found)
    domain = load(target)
    row["jump"] = worst_jump(domain, mesh_of(domain))
    row |= {"seconds": clock.seconds, "cpu": cpu, "memory": found["peak_mb"]}
    return row, domain


def row_of(name: str, found: dict[str, Any]) -> dict[str, Value]:
    """Row of the table from what ``iga build`` answers."""
    proof, report = found["quality"], found["report"]
    stages = report.get("stages", {})
    return {
        "model": name, "verdict": "certified" if wholly_certified(proof) else "not certified",
        "faces": report["cad_faces"], "elements": sum(found["elements"].values()), "functions": found["functions"],
        "refuted": proof["refuted"], "undecided": proof["undecided"], "exact": report["exact_area_share"],
        "gap": report["watertight_gap"],
        "distance": found["distance"]["relative"],
        "volume_error": abs(found["volume"] / report["cad_volume"] - 1.0),
        "closed_error": abs(found["volume"] / report["closed_volume"] - 1.0), "spread": report["volume_spread"],
        "read": stages.get("read"),
        "skin": stages.get("skin"), "inside": stages.get("inside"), "seconds": found["seconds"],
    }  # fmt: skip


def _refused(name: str, reason: str, seconds: float) -> dict[str, Value]:
    return {"model": name, "verdict": f"refused: {reason}", "seconds": seconds}


def _draw(domain: Domain, path: Path) -> None:
    plot_domain(domain, path)


def _said(rows: list[dict[str, Value]], size: Size, found: bool) -> str:
    good = sum(row["verdict"] == "certified" for row in rows)
    refused = sum(str(row["verdict"]).startswith("refused") for row in rows)
    missing = "" if size == "ci" or found else " The data folder is not there."
    return f"{good} of {len(rows)} solids certified, {refused} refused.{missing}"
