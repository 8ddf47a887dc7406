"""GeoPDEs text files ("nurbs mesh v.2.1" and "v.2.0"; "nurbs geometry v.0.7" single and multipatch).

After comments (#) a line of counts; for each patch an optional name, degrees, numbers of control points, knots of each
direction, one line per homogeneous coordinate (w x, w y, w z) and one of weights, first direction fastest; then
interfaces (found again from the geometry, so skipped), subdomains, and boundaries as pairs of patch and side, both
counted from 1.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from geometry.nurbs.multipatch import Name
from geometry.nurbs.tokens import integers, numbers, read_text
from geometry.patch import Patch, make_patch
from iga.errors import FormatError, InputError


class _Lines:
    """Lines of a file that say something, taken one after the other."""

    def __init__(self, text: str, name: str) -> None:
        self.lines = [s for s in (line.strip() for line in text.splitlines()) if s and not s.startswith("#")]
        self.name = name
        self.at = 0

    def take(self, what: str) -> str:
        if self.at >= len(self.lines):
            raise FormatError(f"{self.name}: the file ends where {what} should be")
        self.at += 1
        return self.lines[self.at - 1]

    def integers(self, what: str, count: int) -> list[int]:
        found = integers(self.take(what), f"{self.name}, {what}")
        if len(found) != count:
            raise FormatError(f"{self.name}: {what} should be {count} whole numbers, not {len(found)}")
        return found

    def words(self, what: str) -> str | None:
        """Return the next line if it is a title and not a list of numbers."""
        if self.at < len(self.lines) and re.match(r"[A-Za-z]", self.lines[self.at]):
            return self.take(what)
        return None


def read(path: str | Path) -> tuple[list[Patch], list[Name]]:
    """Read the patches of a GeoPDEs file and the names of boundary faces.

    Raises
    ------
    FormatError : the file is truncated or counts do not fit.
    InputError : it holds a surface or curve, or a patch is not valid; the message names file and patch.
    """
    name = Path(path).name
    text = read_text(path)
    version = re.search(r"#.*nurbs\s+(mesh|geometry)\s+v\.?\s*(\d+\.\d+)", text[:2000], re.IGNORECASE)
    lines = _Lines(text, name)
    counts = integers(lines.take("the line of counts"), f"{name}, the line of counts")
    if version is not None and version[2] < "2.1" and counts:
        counts.insert(1, counts[0])  # older versions do not say the dimension of space
    if len(counts) < 2:
        raise FormatError(f"{name}: the first line should give dimensions and numbers of patches and interfaces")
    if len(counts) == 2:
        counts.append(1)
    dimension, space, patches, interfaces, subdomains = (*counts, 0, 0)[:5]
    if dimension != 3 or space != 3:
        kind = {1: "curve", 2: "surface"}.get(dimension, f"geometry of dimension {dimension}")
        raise InputError(f"{name}: a {kind}, not a volume: {dimension} parameters in {space}-dimensional space")
    if not 1 <= patches <= len(lines.lines) or interfaces < 0 or subdomains < 0:
        raise FormatError(f"{name}: {patches} patches, {interfaces} interfaces, {subdomains} subdomains?")
    made = [_patch(lines, f"{name}, patch {i + 1}") for i in range(patches)]
    for i in range(interfaces):
        lines.words("the name of an interface")
        for what in ("first side", "second side", "orientation"):
            lines.take(f"{what} of interface {i + 1}")
    for i in range(subdomains):
        lines.words("the name of a subdomain")
        lines.take(f"patches of subdomain {i + 1}")
    names: list[Name] = []
    while lines.at < len(lines.lines):
        title = lines.words("the name of a boundary")
        label = re.sub(r"\s+", "_", title.strip()).lower() if title else f"boundary_{len(names) + 1}"
        (sides,) = lines.integers(f"number of sides of {label}", 1)
        for _ in range(sides):
            patch, side = lines.integers(f"side of {label}", 2)
            if not (1 <= patch <= patches and 1 <= side <= 6):
                raise FormatError(f"{name}: {label} names side {side} of patch {patch}, which is not there")
            names.append((label, patch - 1, side - 1))
    return made, names


def _patch(lines: _Lines, where: str) -> Patch:
    lines.words("the name of a patch")
    degree = lines.integers("degrees of a patch", 3)
    n = lines.integers("numbers of control points of a patch", 3)
    knots = [numbers(lines.take("knots of a patch"), f"{where}, knots of direction {'xyz'[d]}") for d in range(3)]
    for d in range(3):
        if len(knots[d]) != n[d] + degree[d] + 1 or n[d] < 1 or degree[d] < 1:
            raise FormatError(f"{where}, direction {'xyz'[d]}: {n[d]} control points of degree {degree[d]} do not go "
                              f"with {len(knots[d])} knots")
    rows = []
    for what in ("x", "y", "z", "weights"):
        row = numbers(lines.take(f"{what} of {where}"), f"{where}, {what}")
        if len(row) != n[0] * n[1] * n[2]:
            raise FormatError(f"{where}: {n[0]} x {n[1]} x {n[2]} control points need as many {what}, not {len(row)}")
        rows.append(row.reshape(n[2], n[1], n[0]).transpose(2, 1, 0))
    weights = np.ascontiguousarray(rows[3])
    with np.errstate(all="ignore"):
        control = np.stack(rows[:3], axis=-1) / weights[..., None]
    if (weights > 0).all():
        return make_patch(knots, control, weights, where)
    return make_patch(knots, np.nan_to_num(control), weights, where)
