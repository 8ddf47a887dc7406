"""How near is a hybrid B-rep to its surface: quality of trimming curves against cutting of triangles.

Table 5.1 of Song and Cohen 2019. Every trimming curve is given by 2^quality cubic Hermite pieces for each edge, in the
parameter plane and in space; ``refinement`` halves each piece at its middle. On the curvilinear triangle of a piece the
surface S is replaced by psi(phi^-1), and

    largest = max |psi(a, b) - S(phi(a, b))|,      on_curve = the same on the trimming curves alone,

which is a floor that cutting triangles cannot lower: the numbers fall along a row, and down a column until the floor.

``patch`` is a bicubic Bezier patch cut by an arc of radius 0.6, in the unit of the patch (all numbers given in the
module); ``box minus box`` are the trimmed faces of a bent box minus another, relative to the solid's diagonal. phi is
the blended map and psi the paper's selection. ``area`` is that of the triangles in the parameter plane, which shrinks
as they are cut.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import surface_points
from geometry.hybrid import shapes
from geometry.hybrid.band_errors import triangle_error
from geometry.hybrid.hbrep import polynomial_surface
from geometry.hybrid.trimming import Trimming, hermite, refined, trim_face
from geometry.patch import Patch
from iga.progress import Progress
from studies.figures import plot_heat_table
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]

NAME = "hybrid_error"
COLUMNS = (
    Column("model", "text", key=True),
    Column("refinement", "int", key=True),
    Column("quality", "int", key=True),
    Column("triangles", "int"),
    Column("largest", relative=0.01, format=".2e"),
    Column("on_curve", relative=0.01, format=".2e"),
    Column("area", relative=1e-3, format=".4f"),
)
SLOPES: tuple[Slope, ...] = ()
QUALITIES = range(5)
HEIGHTS = np.array([(0, 0.1, 0.3, 0.2), (0.1, 0.5, 0.4, 0.1), (0.2, 0.6, 0.2, 0), (0, 0.3, 0.1, 0.4)])
"""Control points of the patch, third coordinate."""


def run(size: Size, progress: Progress) -> Result:
    """Measure all combinations on both models."""
    levels = range(3 if size == "ci" else 4)
    rows: list[dict[str, Value]] = []
    patch = bezier_patch()
    for quality in QUALITIES:
        trimming = arc_trimming(patch, 2**quality)
        rows += [_row("patch", level, quality, [(patch, refined(trimming, level))], 1.0) for level in levels]
    brep = shapes.curved_difference()
    for quality in progress.track(QUALITIES, "box minus box"):
        trims = [(polynomial_surface(face.surface, 1e-9), trim_face(face, None, quality)) for face in brep.faces]
        for level in levels:
            cut = [(surface, refined(trimming, level)) for surface, trimming in trims]
            rows.append(_row("box minus box", level, quality, cut, brep.diagonal))
    rows.sort(key=lambda r: (str(r["model"]), r["refinement"], r["quality"]))
    return Result(table(NAME, COLUMNS, rows), (
        Figure("patch", partial(_draw, rows=rows, model="patch"), "Largest error, bicubic patch"),
        Figure("boxes", partial(_draw, rows=rows, model="box minus box"), "Largest error, box minus box"),
    ), _summary(rows))  # fmt: skip


def bezier_patch() -> Patch:
    """The bicubic patch z(x, y) over the unit square."""
    g = np.arange(4) / 3
    x, y = np.meshgrid(g, g, indexing="ij")
    knots = np.repeat([0.0, 1.0], 4)
    return Patch((knots, knots), np.stack([x, y, HEIGHTS], axis=-1))


def arc_trimming(surface: Patch, pieces: int) -> Trimming:
    """Quarter of the circle of radius 0.6 about (1, 1), from (1, 0.4) to (0.4, 1); the inside is towards the origin."""

    def arc(t: Array) -> Array:
        angle = -0.5 * np.pi * (1.0 + t)
        return np.stack([1 + 0.6 * np.cos(angle), 1 + 0.6 * np.sin(angle)], axis=1)

    plane, space = hermite(arc, pieces), hermite(lambda t: surface_points(surface, arc(t)), pieces)
    s = np.arange(pieces)
    cuts = np.linspace(0.0, 1.0, pieces + 1)
    return Trimming(plane, space, np.roll(s, -1), np.zeros(pieces, dtype=np.int64), cuts[:-1], cuts[1:])


def _row(
    model: str, level: int, quality: int, faces: list[tuple[Patch, Trimming]], unit: float
) -> dict[str, Value]:
    found = [triangle_error(surface, trimming) for surface, trimming in faces]
    found = [f for f in found if len(f.largest)]  # a face may have parameter lines for edges only
    return {
        "model": model, "refinement": level, "quality": quality, "triangles": sum(len(f.largest) for f in found),
        "largest": max(float(f.largest.max()) for f in found) / unit,
        "on_curve": max(float(f.curve.max()) for f in found) / unit,
        "area": float(sum(f.area.sum() for f in found)),
    }  # fmt: skip


def _values(rows: list[dict[str, Value]], model: str) -> Array:
    """Largest errors (refinement, quality) of a model."""
    found = {(r["refinement"], r["quality"]): r["largest"] for r in rows if r["model"] == model}
    levels = 1 + max(int(level) for level, _ in found if isinstance(level, int))
    return np.array([[found[level, quality] for quality in QUALITIES] for level in range(levels)], dtype=float)


def _summary(rows: list[dict[str, Value]]) -> str:
    said = []
    for model in ("patch", "box minus box"):
        v = _values(rows, model)
        said.append(f"{model}: {v[0, 0]:.1e} with the coarsest curves and triangles, {v[-1, -1]:.1e} with the finest")
    return "; ".join(said) + ". Cutting triangles helps until the curve's own error is reached."


def _draw(path: Path, rows: list[dict[str, Value]], model: str) -> None:
    v = _values(rows, model)
    names = [f"refinement {level}" for level in range(len(v))]
    plot_heat_table(path, names, [f"quality {q}" for q in QUALITIES], v, "Largest error")
