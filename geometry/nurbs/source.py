"""The geometry source "nurbs": files and built-in shapes to domains, refinement, and writing back.

Input is a G+Smo ``.xml``, GeoPDEs ``.txt`` or MFEM NURBS ``.mesh`` file (told apart by content, not by name), or the
name of a shape. Parameters of every input:

    elevate    raise the degree of all directions by this much (0)
    degree     raise the degree of each direction to at least this (0)
    refine     halve all knot intervals this many times, after elevation (0)
    tolerance  points closer than this are one when patches are glued, relative to the model's diagonal (1e-6)

and of a shape, its own (angles in degrees; see `shapes`):

    box                   length=1, width=1, height=1, degree=1, elements=1 (in each direction)
    cube                  side=1, degree=1, elements=1
    thick_ring            inner=1, outer=2 (radii), height=1, angle=90 (360 closes it)
    hollow_sphere_octant  inner=1, outer=2
    ball                  radius=1, core=0.5 (size of the cube inside, relative)
    cylinder              radius=1, height=1, core=0.5
    torus                 major=2, minor=0.5, angle=90, core=0.5
    plate_with_hole       radius=1, size=4 (half a side), thickness=1
    fichera               side=1
    bench_cube            degree=2, elements=8
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from geometry.inputs import require_file
from geometry.knots import MAX_DEGREE
from geometry.nurbs import geopdes, gismo, mfem
from geometry.nurbs.domain import build_domain, from_arrays
from geometry.nurbs.multipatch import Multipatch, Name, glue, refined
from geometry.nurbs.shapes import MAX_ENTRIES, SHAPES
from geometry.parameters import Rule, parsed, real, whole
from geometry.patch import Patch, elevate
from iga.domain import Domain
from iga.errors import FormatError, InputError

name = "nurbs"

COMMON: dict[str, float] = {"elevate": 0, "degree": 0, "refine": 0, "tolerance": 1e-6}
_RULES = {"degree": whole(0, MAX_DEGREE), "tolerance": real(0.0, 0.1, ends=False)}
MAX_LEVELS = 12
"""Most refinements: 4096 intervals out of each."""


def _reader(path: str | Path) -> Callable[[str | Path], tuple[list[Patch], list[Name]]] | None:
    """Reader for a file, by its first bytes."""
    try:
        with Path(path).open("rb") as file:
            head = file.read(4096).decode("utf-8", errors="replace")
    except (OSError, ValueError):
        return None
    start = head.lstrip("\ufeff \t\r\n")
    if start.startswith("MFEM NURBS"):
        return mfem.read
    if start.startswith("<") and ("<xml" in head or "<Geometry" in head):
        return gismo.read
    comments = "\n".join(line for line in head.splitlines() if line.startswith("#")).lower()
    if "nurbs mesh" in comments or "nurbs geometry" in comments:
        return geopdes.read
    return None


def reads(path: str | Path) -> bool:
    """Whether this source reads a file, or knows a shape of this name."""
    return (str(path) in SHAPES and not Path(path).exists()) or _reader(path) is not None


def build(path: str | Path, **parameters: Any) -> Domain:
    """Build a domain from a file or from the name of a shape.

    Parameters
    ----------
    path : a file, or one of `shapes.SHAPES`.
    parameters : see the module docstring.

    Raises
    ------
    InputError : the file is not readable, its patches do not fit each other, or a parameter is unknown or out of range.
    """
    if str(path) in SHAPES and not Path(path).exists():
        maker = SHAPES[str(path)]
        own = {key: p.default for key, p in inspect.signature(maker).parameters.items()}
        settings = check_parameters(parameters, {**COMMON, **own}, str(path))
        multipatch = maker(**{key: settings[key] for key in own})
        if "degree" not in own:
            multipatch = _raise_degree(multipatch, int(settings["degree"]))
        return _finish(multipatch, str(path), settings)
    settings = check_parameters(parameters, COMMON, str(path))
    reader = _reader(path)
    if reader is None:
        require_file(path, SHAPES)
        raise FormatError(f"{path}: not a NURBS file (G+Smo XML, GeoPDEs text or MFEM NURBS mesh)")
    patches, names = reader(path)
    patches = [_lift(p, int(settings["degree"])) for p in patches]
    return _finish(glue(patches, names, settings["tolerance"], Path(path).name), str(path), settings)


def _finish(multipatch: Multipatch, source: str, settings: Mapping[str, Any]) -> Domain:
    return build_domain(_refined(multipatch, settings["refine"], settings["elevate"], source), source, settings)


def _refined(multipatch: Multipatch, levels: int, elevated: int, source: str) -> Multipatch:
    """Refine after checking that the result is of a size that makes sense."""
    if not (0 <= levels <= MAX_LEVELS and 0 <= elevated <= MAX_DEGREE):
        raise InputError(f"{source}: refine={levels}, elevate={elevated} is outside 0..{MAX_LEVELS}, 0..{MAX_DEGREE}")
    entries = 0
    for p in multipatch.patches:
        if max(p.degree) + elevated > MAX_DEGREE:
            raise InputError(f"{source}: degree {max(p.degree)} + {elevated} is above {MAX_DEGREE}")
        size = 1
        for elements, q in zip(p.elements, p.degree):
            size *= elements * 2**levels * (q + elevated + 1)
        entries += size
    if entries > MAX_ENTRIES:
        raise InputError(f"{source}: refine={levels}, elevate={elevated} needs {entries:.0e} table entries; take less")
    return refined(multipatch, levels, elevated)


def _lift(patch: Patch, degree: int) -> Patch:
    """Raise each direction to at least a degree."""
    if degree > MAX_DEGREE:
        raise InputError(f"degree {degree} is above {MAX_DEGREE}")
    return elevate(patch, tuple(max(degree - p, 0) for p in patch.degree))


def _raise_degree(multipatch: Multipatch, degree: int) -> Multipatch:
    return replace(multipatch, patches=tuple(_lift(p, degree) for p in multipatch.patches))


def check_parameters(given: Mapping[str, Any], known: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Settings with defaults filled in.

    Raises
    ------
    InputError : a name is unknown, or a value is of the wrong kind.
    """
    return {**known, **parsed(f"{name} on {source}", given, {key: _rule(key, known[key]) for key in known})}


def _rule(key: str, default: float) -> Rule:
    """What a parameter may be: like its default, where nothing else is said of it."""
    return _RULES.get(key) or (whole() if isinstance(default, int) else real())


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Elevate, then halve all knot intervals; the solid stays as it is to round-off.

    Parameters
    ----------
    domain : built by this source.
    levels, elevate : how often to halve, and how many degrees to add.

    Raises
    ------
    InputError : the domain is of another source, or too large.
    """
    if domain.provenance.source != name:
        raise InputError(f"the domain was built by source {domain.provenance.source!r}, not by {name!r}")
    multipatch = from_arrays(domain.provenance.arrays, float(domain.report.get("largest_gap", 0.0)))
    settings = dict(domain.provenance.parameters)
    finer = _refined(multipatch, levels, elevate, domain.provenance.input)
    settings["refine"] = int(settings.get("refine", 0)) + levels
    settings["elevate"] = int(settings.get("elevate", 0)) + elevate
    return build_domain(finer, domain.provenance.input, settings)


def write_gismo(path: str | Path, domain: Domain) -> Path:
    """Write the patches of a domain of this source as G+Smo XML, and return the path.

    Raises
    ------
    InputError : the domain has no NURBS patches, or the file cannot be written.
    """
    if domain.provenance.source != name:
        raise InputError(f"only NURBS domains can be written as G+Smo XML, not those of {domain.provenance.source!r}")
    multipatch = from_arrays(domain.provenance.arrays)
    gismo.write(path, multipatch.patches, multipatch.interfaces, multipatch.names)
    return Path(path)
