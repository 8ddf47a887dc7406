"""How do layers reach inwards, and do they wrinkle: refined after tracing against traced anew on every level.

Figures 3.1, 4.1 to 4.3 and 6.3 of Song and Cohen 2019: four layers of control points (cubic, one element across) under
the skin of a bent box minus another, of four joined capsules and, at full size, of a mechanical part, traced to
``omega`` = 0.75 of the way to the mid-structure along the blend of harmonic gradient and distance.

    traced      layers of the skin as it is
    rebuilt     the skin's elements cut in four, layers traced from there
    refined     the coarse layers cut with the skin, after tracing (Section 6.1)
    straight    straight paths instead

``wrinkle`` is the largest angle in degrees by which the innermost layer turns across an edge between elements where the
skin itself turns by less than 20 degrees, ``bend`` the mean of these angles. ``depth`` is the mean displacement of
vertices relative to the largest distance inside, ``lowered`` how many vertices stay above the wanted depth because
layers would fold, and ``folded`` how many elements of the layers are not certified. Where volumes are filled
(``cells``), all of them are certified or counted in ``refuted``.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid import shapes
from geometry.hybrid.field import field_under
from geometry.hybrid.layers import complete_with_layers, moved, valid_layers
from geometry.hybrid.shell import Shell, shell_of
from geometry.hybrid.skin import build_skin
from geometry.hybrid.subdividing import refined
from geometry.hybrid.ways import ways_of
from iga.block import bezier_coefficients
from iga.certificate import SIGN_ALONE, certify
from iga.domain import Domain, counts
from iga.pictures.plot import plot_domain
from iga.progress import Progress
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]

NAME = "hybrid_volume"
COLUMNS = (
    Column("model", "text", key=True),
    Column("way", "text", key=True),
    Column("level", "int", key=True),
    Column("elements", "int", relative=0.1),
    Column("middle", "int", relative=0.3, absolute=20),
    Column("depth", relative=0.2, absolute=0.02, format=".3f"),
    Column("lowered", "int", relative=1.0, absolute=30),
    Column("folded", "int"),
    Column("wrinkle", "float", "deg", relative=0.5, absolute=5.0, format=".1f"),
    Column("bend", "float", "deg", relative=0.5, absolute=1.0, format=".2f"),
    Column("cells", "int", relative=0.2, absolute=100),
    Column("refuted", "int"),
)
SLOPES: tuple[Slope, ...] = ()
OMEGA = 0.75
LAYERS = 3
SMOOTH = np.deg2rad(20.0)
CI: dict[str, dict[str, float]] = {"curved_difference": {"size": 0.25, "tolerance": 1e-3}}
FULL: dict[str, dict[str, float]] = {
    "curved_difference": {"size": 0.12, "tolerance": 1e-3}, "tetrapod": {"size": 0.2, "tolerance": 1e-3},
    "bracket": {"size": 0.2, "tolerance": 1e-3},
}


def run(size: Size, progress: Progress) -> Result:
    """Trace, refine, fill."""
    rows: list[dict[str, Value]] = []
    figures: list[Figure] = []
    for name, settings in progress.track((CI if size == "ci" else FULL).items(), "models"):
        coarse = shell_of(build_skin(shapes.SHAPES[name](), settings["size"], settings["tolerance"]))
        field = field_under(coarse)
        inside = float(field.distance.max())
        ways = ways_of(coarse, field)
        middle = int(field.middle.sum())
        D, scale, left = valid_layers(coarse, ways, OMEGA, LAYERS)
        rows.append(_row(name, "traced", 0, coarse, D, inside, middle, scale, left))
        plain, below, over = valid_layers(coarse, ways_of(coarse, None), OMEGA, LAYERS)
        rows.append(_row(name, "straight", 0, coarse, plain, inside, 0, below, over))
        shell, fine = coarse, D
        for level in range(1, 2 if size == "ci" else 3):
            shell, values = refined(shell, np.moveaxis(fine, 0, 1).reshape(shell.space.n, -1))
            fine = np.moveaxis(values.reshape(shell.space.n, LAYERS + 1, 3), 1, 0)
            rows.append(_row(name, "refined", level, shell, fine, inside, middle, None, None))
            anew = field_under(shell)
            own, low, rest = valid_layers(shell, ways_of(shell, anew), OMEGA, LAYERS)
            rows.append(_row(name, "rebuilt", level, shell, own, inside, int(anew.middle.sum()), low, rest))
        domain = complete_with_layers(coarse, LAYERS, OMEGA)
        verdict = certify(domain, SIGN_ALONE).verdict
        rows[next(i for i, r in enumerate(rows) if r["model"] == name and r["way"] == "traced")] |= {
            "cells": sum(counts(domain).values()), "refuted": int((verdict <= 0).sum())
        }
        figures.append(Figure(f"{name}_skin", partial(_draw, domain, None), f"{name}, skin by CAD face."))
        figures.append(Figure(f"{name}_cut", partial(_draw, domain, "y"), f"{name}, cut: layers and tetrahedra."))
    return Result(table(NAME, COLUMNS, rows, SLOPES), tuple(figures), _said(rows))


def _row(
    name: str, way: str, level: int, shell: Shell, D: Array, inside: float, middle: int, scale: Array | None,
    left: int | None,
) -> dict[str, Value]:
    inner = moved(shell, D[0])
    skin, layer = turning(shell), turning(inner)
    smooth = skin < SMOOTH
    depth = np.linalg.norm(inner.vertices - shell.vertices, axis=1).mean() / inside
    return {
        "model": name, "way": way, "level": level, "elements": shell.space.elements,
        "middle": middle, "depth": float(depth), "lowered": None if scale is None else int((scale < 1.0).sum()),
        "folded": left, "wrinkle": float(np.rad2deg(layer[smooth].max())),
        "bend": float(np.rad2deg(layer[smooth].mean())),
    }  # fmt: skip


def turning(shell: Shell) -> Array:
    """Angle (k,) between the normals of the two elements at the middle of each edge, edges in order of vertices."""
    keys, normals = [], []
    for block, corners in zip(shell.space.blocks, shell.corners):
        cell = block.basis.cell
        net = bezier_coefficients(block, shell.points)
        gradients = block.basis.tabulate(cell.vertices[cell.edges].mean(axis=1), 1)[1]
        J = np.einsum("qbd,ebc->eqcd", gradients, net)
        n = np.cross(J[..., 0], J[..., 1])
        normals.append((n / (np.linalg.norm(n, axis=-1, keepdims=True) + 1e-300)).reshape(-1, 3))
        ends = np.sort(corners[:, cell.edges].reshape(-1, 2), axis=1)
        keys.append(ends[:, 0] * len(shell.vertices) + ends[:, 1])
    order = np.argsort(np.concatenate(keys), kind="stable")
    n = np.concatenate(normals)[order]
    return np.asarray(np.arccos(np.clip((n[::2] * n[1::2]).sum(axis=1), -1.0, 1.0)))


def _draw(domain: Domain, cut: str | None, path: Path) -> None:
    plot_domain(domain, path, cut=cut)


def _said(rows: list[dict[str, Value]]) -> str:
    first = rows[0]["model"]
    last = max(int(str(r["level"])) for r in rows if r["model"] == first)
    found: dict[Any, Any] = {r["way"]: r["wrinkle"] for r in rows if r["model"] == first and r["level"] == last}
    return (
        f"{first} at level {last}: the innermost layer turns by {found['rebuilt']:.1f} degrees at most across edges "
        f"where the skin is smooth if it is traced anew, by {found['refined']:.1f} if it is refined after tracing."
    )
