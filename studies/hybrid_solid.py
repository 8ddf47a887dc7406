"""Which functions has the HB-rep of a whole solid, how near is it to the CAD surfaces, and does it carry a volume?

Every solid has a skin of quadrilaterals and triangles whose functions are the B-splines of its faces, revised beside
the trimming curves, and trim functions that neighbouring faces share (`geometry.hybrid.sealing`; Song and Cohen 2019,
Sections 3 and 5). ``tolerance`` is the wanted distance to the CAD surfaces.

``right`` triangles and ``rectangles`` lie along the curves, ``banded`` is their share of the area: Omega^banded of the
paper. Other triangles lie where these do not fit and between them and whole cells.

``untouched`` B-splines act on no element beside a curve, ``revised`` ones do, ``trim`` functions carry the curves;
``own`` are C0 functions where a face has no splines (near poles, faces too narrow for a quadrilateral). ``unity`` is
the largest deviation of their sum from one, ``on_curves`` the largest coefficient of any other function on a trimming
curve, ``condition`` that of a face's functions as combinations of Bernstein functions, columns scaled. ``exact`` is the
share of the area that is the CAD surface, ``distance`` the largest distance elsewhere (for rational surfaces with the
bound of what replacing them by polynomial splines moves), ``gap`` the largest distance between both sides of an edge,
all relative to the diagonal.

Where ``layers`` are asked for, spline layers lie under the skin: hexahedra below quadrilaterals and wedges below
triangles, in tensor products of the skin's functions and B-splines inwards, pyramids on the innermost quadrilaterals
and tetrahedra inside (Section 4). ``patch`` is the relative H1 error of a linear field there, ``refuted`` counts cells
that are not certified.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from geometry.hybrid import read_cad, shapes
from geometry.hybrid.layers import complete_with_layers
from geometry.hybrid.shell import shell_of
from geometry.hybrid.skin import Skin, build_skin
from iga.certificate import SIGN_ALONE, certify
from iga.domain import Domain, counts
from iga.pictures.plot import plot_domain
from iga.progress import Progress
from problems import solve_exact
from studies.data import CAD
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

NAME = "hybrid_solid"
COLUMNS = (
    Column("model", "text", key=True),
    Column("tolerance", key=True, format=".0e"),
    Column("quadrilaterals", "int", relative=0.1, absolute=5),
    Column("triangles", "int", relative=0.1, absolute=10),
    Column("right", "int", relative=0.1, absolute=5),
    Column("rectangles", "int", relative=0.1, absolute=5),
    Column("banded", relative=0.1, absolute=0.01, format=".3f"),
    Column("untouched", "int", relative=0.2, absolute=10),
    Column("revised", "int", relative=0.1, absolute=10),
    Column("trim", "int", relative=0.1, absolute=10),
    Column("own", "int", relative=0.2, absolute=20),
    Column("unity", at_most=1e-12, format=".1e"),
    Column("on_curves", at_most=1e-12, format=".1e"),
    Column("condition", at_most=1e8, format=".1e"),
    Column("exact", relative=0.05, absolute=0.02, format=".3f"),
    Column("distance", relative=0.5, absolute=1e-7, format=".1e"),
    Column("gap", at_most=1e-12, format=".1e"),
    Column("volume_error", relative=1.0, absolute=1e-7, format=".1e"),
    Column("hexahedra", "int", relative=0.1, absolute=5),
    Column("wedges", "int", relative=0.1, absolute=10),
    Column("cells", "int", relative=0.2, absolute=50),
    Column("refuted", "int"),
    Column("patch", at_most=1e-8, format=".1e"),
)
SLOPES: tuple[Slope, ...] = ()
Case = tuple[str, float, tuple[float, ...], bool]
CASES: dict[str, tuple[Case, ...]] = {
    "ci": (
        ("curved_box", 0.6, (1e-3,), True), ("curved_difference", 0.2, (1e-3, 1e-5), False),
        ("bracket", 0.2, (1e-3,), False),
    ),
    "full": (
        ("curved_box", 0.6, (1e-3,), True), ("curved_difference", 0.2, (1e-3, 1e-4, 1e-5, 1e-6), True),
        ("bracket", 0.2, (1e-3, 1e-5), True), ("tetrapod", 0.2, (2e-5,), False),
        ("block_through_hole.step", 0.2, (1e-3, 1e-4, 1e-5), True), ("block_torus_fillet3.step", 0.2, (2e-5,), True),
        ("face_3_loops.step", 0.2, (2e-5,), False), ("two_elliptical_edges.step", 0.2, (2e-5,), True),
        ("sliced_cylinder.step", 0.2, (2e-5,), True), ("angled.step", 0.2, (2e-5,), False),
        ("featuretype.step", 0.2, (2e-5,), False),
    ),
}
"""Model, size of elements, tolerances, and whether a volume with layers is made at the first of them."""
FIELD = "x+2*y-z"


def run(size: Size, progress: Progress) -> Result:
    """Build skins of all sizes, and volumes."""
    rows: list[dict[str, Value]] = []
    figures: list[Figure] = []
    for name, largest, tolerances, filled in progress.track(CASES[size], "models"):
        if name not in shapes.SHAPES and not (CAD / name).is_file():
            continue
        brep = shapes.SHAPES[name]() if name in shapes.SHAPES else read_cad(CAD / name)
        for number, tolerance in enumerate(tolerances):
            skin = build_skin(brep, largest, tolerance, name, kind="hb-rep")
            row = _row(name, tolerance, skin)
            if filled and number == 0:
                domain = complete_with_layers(shell_of(skin), 3, 0.5)
                row |= _volume(domain)
                figures.append(Figure(Path(name).stem, partial(_draw, domain), f"{name}, cut: layers and the inside."))
            rows.append(row)
    return Result(table(NAME, COLUMNS, rows, SLOPES), tuple(figures), _said(rows))


def _row(name: str, tolerance: float, skin: Skin) -> dict[str, Value]:
    report, told = skin.report, skin.report["hb_rep"]
    faces = [row for row in report["cad_faces_with_quadrilaterals"] if "right_triangles" in row]
    return {
        "model": name, "tolerance": tolerance, "quadrilaterals": report["quadrilaterals"],
        "triangles": report["elements"] - report["quadrilaterals"],
        "right": sum(row["right_triangles"] for row in faces), "rectangles": sum(row["rectangles"] for row in faces),
        "banded": sum(row["omega_banded"] * row["area"] for row in faces) / report["area"],
        "untouched": told["b_splines"],
        "revised": told["revised"], "trim": told["trim"], "own": told["own"], "unity": told["unity_error"],
        "on_curves": told["on_curves"], "condition": told["condition"], "exact": report["exact_area_share"],
        "distance": report["max_distance"], "gap": report["watertight_gap"],
        "volume_error": report["volume_error"],
    }  # fmt: skip


def _volume(domain: Domain) -> dict[str, Value]:
    cells = counts(domain)
    return {
        "hexahedra": cells.get("hexahedron", 0), "wedges": cells.get("wedge", 0), "cells": sum(cells.values()),
        "refuted": int((certify(domain, SIGN_ALONE).verdict <= 0).sum()),
        "patch": float(solve_exact(domain, "heat", FIELD)[1]["relative_h1_error"]),
    }  # fmt: skip


def _draw(domain: Domain, path: Path) -> None:
    plot_domain(domain, path, cut="y")


def _said(rows: list[dict[str, Value]]) -> str:
    def worst(key: str) -> Any:
        return max(row[key] for row in rows)  # type: ignore[type-var]

    return (
        f"Functions sum to one within {worst('unity'):.0e}, all but trim functions vanish on the curves "
        f"({worst('on_curves'):.0e}), and gaps are {worst('gap'):.0e} at most."
    )
