"""Studies: a module with ``NAME``, ``COLUMNS``, ``SLOPES`` and ``run(size, progress) -> Result``, run and held fast.

`STUDIES` names the studies and their modules. `run_study` writes what a study finds, `check_study` runs it at the size
meant for continuous integration and compares the table with ``studies/baselines/NAME.csv``.

Adding a study: write the module, add it to `STUDIES`, run ``iga study run NAME --size ci`` and, once the
numbers are right, copy the CSV file it writes to ``studies/baselines``.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, cast

from iga.errors import InputError
from iga.exchange.files import write_text
from iga.progress import QUIET, Progress
from studies.comparison import Difference, compare
from studies.table import Column, Slope, Table, read_csv, to_csv, to_json

STUDIES: dict[str, str] = {
    name: name
    for name in (
        "tet_to_hex_exactness",
        "tet_to_hex_continuity",
        "tets_versus_hexes",
        "nurbs_convergence",
        "elasticity_benchmarks",
        "catmull_clark_interpolation",
        "catmull_clark_convergence",
        "catmull_clark_material",
        "catmull_clark_models",
        "hybrid_error",
        "hybrid_refinement",
        "hybrid_solid",
        "hybrid_models",
        "hybrid_convergence",
        "hybrid_volume",
        "meccano_square",
        "meccano_models",
        "meccano_bunny",
        "meccano_genus",
        "meccano_analysis",
        "sources_compared",
    )
} | {"bench_cube": "bench_table"}
BASELINES = Path(__file__).parent / "baselines"
Size = Literal["ci", "full"]


@dataclass(frozen=True)
class Figure:
    """A picture of a study: `draw` writes it to the path it is given."""

    name: str
    draw: Callable[[Path], None]
    caption: str = ""


@dataclass(frozen=True)
class Result:
    """What a study found.

    Attributes
    ----------
    table : the numbers.
    figures : pictures, drawn only when results are written.
    summary : what the numbers say, in a sentence or two.
    """

    table: Table
    figures: tuple[Figure, ...] = ()
    summary: str = ""


class Study(Protocol):
    """What a study's module offers."""

    __doc__: str | None
    NAME: str
    COLUMNS: Sequence[Column]
    SLOPES: Sequence[Slope]

    def run(self, size: Size, progress: Progress) -> Result:
        """Find the numbers."""
        ...


@dataclass(frozen=True)
class Run:
    """A study that ran: what it found, the files it wrote, how long it took, why figures could not be drawn."""

    name: str
    result: Result
    files: tuple[Path, ...]
    seconds: float
    undrawn: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the keys of the command line's JSON answer: study, columns, rows, rates, files, undrawn, seconds."""
        return {
            "study": self.name, **to_json(self.result.table), "summary": self.result.summary,
            "files": [str(path) for path in self.files], "undrawn": list(self.undrawn),
            "seconds": round(self.seconds, 3),
        }  # fmt: skip


@dataclass(frozen=True)
class Check:
    """A study compared with its baseline; it passed if there are no differences."""

    name: str
    differences: tuple[Difference, ...]
    seconds: float

    @property
    def passed(self) -> bool:
        """True if the table is what the baseline says."""
        return not self.differences

    def __str__(self) -> str:
        """One line, or one more for each difference."""
        if self.passed:
            return f"{self.name}: as the baseline ({self.seconds:.1f} s)"
        lines = [f"{self.name}: {len(self.differences)} differences from the baseline ({self.seconds:.1f} s)"]
        return "\n  ".join([*lines, *map(str, self.differences)])


def find(name: str) -> Study:
    """Return the study of that name.

    Raises
    ------
    InputError : there is none.
    """
    if name not in STUDIES:
        raise InputError(f"there is no study {name!r}; there are: {', '.join(STUDIES)}")
    return cast(Study, importlib.import_module(f"studies.{STUDIES[name]}"))


def list_studies() -> list[tuple[str, str]]:
    """Names of all studies and the first line of what each is about."""
    return [(name, (find(name).__doc__ or "").strip().splitlines()[0]) for name in STUDIES]


def run_study(
    study: str | Study, size: Size = "full", out: str | Path | None = None, progress: Progress = QUIET
) -> Run:
    """Run a study and write its table (CSV, JSON) and figures (PNG) into a folder.

    A figure that cannot be drawn takes neither the table nor the other figures along; the run says why.

    Parameters
    ----------
    study : its name, or the module itself.
    size : "ci" takes seconds, "full" minutes.
    out : folder for the files, made where missing; None writes nothing.

    Raises
    ------
    InputError : no such study or size.
    """
    module = find(study) if isinstance(study, str) else study
    if size not in ("ci", "full"):
        raise InputError(f"the size of a study is ci or full, not {size!r}")
    begin = time.perf_counter()
    result = module.run(size, progress)
    seconds = time.perf_counter() - begin
    if out is None:
        return Run(module.NAME, result, (), seconds)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{module.NAME}.csv"]
    write_text(files[0], to_csv(result.table))
    undrawn = []
    for figure in result.figures:
        path = folder / f"{module.NAME}_{figure.name}.png"
        try:
            figure.draw(path)
        except InputError as error:
            undrawn.append(f"figure {figure.name}: {error}")
        else:
            files.append(path)
    files.append(folder / f"{module.NAME}.json")
    run = Run(module.NAME, result, tuple(files), seconds, tuple(undrawn))
    write_text(files[-1], json.dumps(run.to_json(), indent=1, allow_nan=False) + "\n")
    return run


def check_study(study: str | Study, baselines: str | Path = BASELINES, progress: Progress = QUIET) -> Check:
    """Run a study at size "ci" and compare its table with the baseline.

    Raises
    ------
    InputError : no such study, or it has no baseline.
    """
    module = find(study) if isinstance(study, str) else study
    path = Path(baselines) / f"{module.NAME}.csv"
    if not path.is_file():
        raise InputError(f"study {module.NAME!r} has no baseline; run it with --size ci, keep its CSV file as {path}")
    baseline = read_csv(path, module.COLUMNS, module.SLOPES)
    begin = time.perf_counter()
    got = module.run("ci", progress).table
    return Check(module.NAME, tuple(compare(got, baseline)), time.perf_counter() - begin)
