"""How smoothly do the hexahedra of two tetrahedra join (Proposition 5)?

Two Bezier tetrahedra share a face; their hexahedra share three. For pairs that join C1 and pairs that join C0 only, at
degrees 1 to 8, the largest jumps over the shared faces relative to the largest value or derivative:

    trace   of the values
    g1      of the derivative across the face after the change of parameters that the two maps phi define (G1)
    c1      of the derivative across the face in the hexahedra's own parameters

A C1 pair gives a G1 pair, not a C1 pair: Proposition 5 of Xu et al. 2018 holds for k >= 1 in the sense of G^k.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geometry.tets.continuity import c1_pair, face_continuity
from iga.bernstein import bernstein
from iga.cells import TETRAHEDRON
from iga.progress import Progress
from studies.figures import COLOURS, MARKERS, drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Table, numbers, table

NAME = "tet_to_hex_continuity"
COLUMNS = (
    Column("pair", "text", key=True),
    Column("degree", "int", key=True),
    Column("trace", at_most=1e-13, format=".1e"),
    Column("g1", relative=1e-6, absolute=1e-12, format=".1e"),
    Column("c1", relative=1e-6, absolute=1e-12, format=".1e"),
)
SLOPES: tuple[Slope, ...] = ()
SEED = 4711
DEGREES = range(1, 9)


def run(size: Size, progress: Progress) -> Result:
    """Measure random pairs; at full size more of them, at more points."""
    pairs, count = (3, 200) if size == "ci" else (20, 2000)
    points = np.random.default_rng(SEED).random((count, 2))
    rows = []
    for kind in ("C1", "C0"):
        for degree in progress.track(DEGREES, f"{kind} pairs"):
            found = [_measure(kind, degree, SEED + k, points) for k in range(pairs)]
            rows.append((kind, degree, *np.max(found, axis=0).tolist()))
    made = table(NAME, COLUMNS, rows)
    g1 = max(row[3] for row in rows if row[0] == "C1")
    c1 = min(row[4] for row in rows if row[0] == "C1")
    summary = (
        f"Hexahedra of a C1 pair join G1 to round-off (largest jump {g1:.1e}) and not C1 (jump {c1:.2f} at least); "
        "those of a C0 pair join C0 only."
    )
    return Result(made, (Figure("jumps", lambda path: _draw(path, made), "Jumps across converted faces"),), summary)


def _measure(kind: str, degree: int, seed: int, points: np.ndarray) -> tuple[float, float, float]:
    first, second, apex = c1_pair(degree, seed)
    if kind == "C0":
        inside = bernstein(TETRAHEDRON, degree).exponents[:, 3] > 0
        second[inside] = np.random.default_rng(seed + 1).standard_normal((int(inside.sum()), 3))
    found = face_continuity(first, second, apex, points)
    return found.trace, found.g1, found.c1


def _draw(path: Path, made: Table) -> None:
    with drawing(path) as axes:
        axes.set_yscale("log")
        labels = {"trace": "values", "g1": "derivative, G1", "c1": "derivative, C1"}
        for number, (quantity, label) in enumerate(labels.items()):
            for kind in ("C1", "C0"):
                rows = [row for row in made.records() if row["pair"] == kind]
                jumps = np.maximum(numbers(rows, quantity), 1e-17)
                axes.plot(
                    numbers(rows, "degree"), jumps, color=COLOURS[number], marker=MARKERS[number],
                    linestyle="-" if kind == "C1" else "--",
                    markerfacecolor=None if kind == "C1" else "white", label=f"{label} ({kind} pair)",
                )  # fmt: skip
        axes.set_xlabel("degree $n$")
        axes.set_ylabel("largest relative jump (zero drawn at $10^{-17}$)")
        axes.set_ylim(1e-18, 30)
        axes.grid(True, axis="y")
        axes.legend(loc="center right")
