"""What does refinement do to a hybrid B-rep: functions, error, band, and what stays exact?

Figures 6.1 and 6.2 of Song and Cohen 2019: a bicubic surface of 4 x 4 knot intervals (49 control points) with an
L-shaped hole, and the same with every interval halved (121). Each side of the letter is given by 2^quality cubic
pieces. Strategies:

    coarse      the hybrid face as it is
    rebuilt     knots are inserted into the trimmed surface, then the hybrid face is built
    kept        the coarse face's trimming curves are cut at the new knot lines; its partition is cut, not chosen anew
    recomputed  the same with a new partition

Kept and recomputed have the same functions and the same geometry and differ in rectangles only. ``trim`` is the number
of trim functions (three for each curve segment), ``largest`` the largest distance to the surface at equal parameters,
relative to the diagonal, ``on_curve`` that on the trimming curve alone: where they are equal, a better error needs a
better curve. ``psi`` is the paper's selection, or the one with correction, whose triangles reach the curve's error at
once. ``band`` is the area of the band, ``exact`` the share of the area where the surface is
untouched, and ``outside`` the largest distance there.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import surface_points
from geometry.hybrid import shapes
from geometry.hybrid.band_errors import band_error
from geometry.hybrid.hbrep import HybridFace, hybrid_face, refine_hybrid, refined_surface
from geometry.hybrid.triangle import Psi, triangle_map
from geometry.hybrid.trimming import cut_at_knots, trim_face
from iga.block import bezier_coefficients
from iga.cells import QUADRILATERAL
from iga.progress import Progress
from studies.figures import drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]

NAME = "hybrid_refinement"
COLUMNS = (
    Column("quality", "int", key=True),
    Column("psi", "text", key=True),
    Column("strategy", "text", key=True),
    Column("level", "int", key=True),
    Column("revised", "int"),
    Column("trim", "int"),
    Column("triangles", "int"),
    Column("band_rectangles", "int"),
    Column("partition", "int"),
    Column("largest", relative=0.01, format=".2e"),
    Column("on_curve", relative=0.01, format=".2e"),
    Column("band", relative=1e-3, format=".4f"),
    Column("exact", relative=1e-3, format=".3f"),
    Column("outside", at_most=1e-12, format=".1e"),
)
SLOPES: tuple[Slope, ...] = ()
PLAIN = 16
"""Functions on a rectangle that no trim function reaches: the bicubic B-splines alone."""
CASES: tuple[tuple[int, Psi], ...] = ((0, "selection"), (1, "selection"), (1, "correction"))


def run(size: Size, progress: Progress) -> Result:
    """Build the face and refine it by all strategies."""
    face = shapes.lettered_face()
    face = replace(face, loops=face.loops[1:])  # the outer border of the surface is not trimmed
    diagonal = float(np.linalg.norm(np.ptp(face.surface.control.reshape(-1, 3), axis=0)))
    rows: list[dict[str, Value]] = []
    figures: list[Figure] = []
    for quality, psi in progress.track(CASES, "letter"):
        trimming = trim_face(face, None, quality)
        coarse = hybrid_face(face.surface, trimming, psi=psi, where="letter")
        made: list[tuple[str, int, HybridFace]] = [("coarse", 0, coarse)]
        for level in range(1, 2 if size == "ci" else 4):
            surface = refined_surface(face.surface, level)
            rebuilt = hybrid_face(surface, cut_at_knots(trimming, surface.knots), psi=psi, where="letter")
            made.append(("rebuilt", level, rebuilt))
            made.append(("kept", level, refine_hybrid(coarse, level, keep_partition=True, psi=psi)))
            made.append(("recomputed", level, refine_hybrid(coarse, level, psi=psi)))
        rows += [{"quality": quality, "psi": psi, **_row(name, level, h, diagonal)} for name, level, h in made]
        if not figures:
            figures = [
                Figure(f"{name}_{level}", partial(_draw, face=h), f"Band and partition, {name}, level {level}")
                for name, level, h in made[:4]
            ]
    first, last = (next(r for r in rows if r["quality"] == 1 and r["level"] == level) for level in (0, 1))
    summary = (
        f"{first['revised']} + {first['trim']} functions become {last['revised']} + {last['trim']}; the largest error "
        f"falls from {first['largest']:.1e} to {last['largest']:.1e}, with {last['on_curve']:.1e} on the curve itself."
    )
    return Result(table(NAME, COLUMNS, rows), tuple(figures), summary)


def _row(name: str, level: int, face: HybridFace, diagonal: float) -> dict[str, Value]:
    error = band_error(face, samples=24)
    return {
        "strategy": name, "level": level, "revised": face.revised, "trim": face.trim,
        "triangles": len(face.band.segment), "band_rectangles": len(face.band.low), "partition": len(face.parts.low),
        "largest": error.largest / diagonal, "on_curve": error.curve / diagonal, "band": error.area,
        "exact": error.share, "outside": _outside(face) / diagonal,
    }  # fmt: skip


def _outside(face: HybridFace) -> float:
    """Largest distance to the surface on rectangles that do not touch the trimming curve."""
    block = face.space.blocks[0]
    if block.n != PLAIN:
        return 0.0
    s = np.linspace(0.0, 1.0, 4)
    at = np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2)
    x = np.einsum("qb,ebc->eqc", block.basis.tabulate(at, 0)[0], bezier_coefficients(block, face.points))
    n = block.elements
    uv = face.low[:n, None] + at * (face.high[:n] - face.low[:n])[:, None]
    return float(np.abs(x.reshape(-1, 3) - surface_points(face.surface, uv.reshape(-1, 2))).max())


def _draw(path: Path, face: HybridFace) -> None:
    """The parameter plane: rectangles, blue where functions are revised, triangles along the curves, and knot lines."""
    with drawing(path, size=(6.0, 6.0)) as axes:
        from matplotlib.patches import Rectangle

        start = 0
        for block in face.space.blocks:
            if block.basis.cell is QUADRILATERAL:
                part = slice(start, start + block.elements)
                start += block.elements
                colour = "0.85" if block.n == PLAIN else "lightskyblue"
                for low, high in zip(face.low[part], face.high[part]):
                    axes.add_patch(Rectangle(tuple(low), *(high - low), facecolor=colour, edgecolor="k", linewidth=0.5))
        s = np.linspace(0.0, 1.0, 12)
        for phi in face.phi:
            sides = [triangle_map(phi[None], np.stack(x, 1))[0] for x in ((s, 0 * s), (1 - s, s), (0 * s, 1 - s))]
            axes.fill(*np.concatenate(sides).T, facecolor="navy", edgecolor="w", linewidth=0.3)
        for line in np.unique(face.surface.knots[0]):
            axes.axvline(line, color="m", linewidth=0.6)
        for line in np.unique(face.surface.knots[1]):
            axes.axhline(line, color="m", linewidth=0.6)
        axes.set_aspect("equal")
