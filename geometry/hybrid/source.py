r"""The geometry source "hybrid": trimmed CAD solids as watertight splines and a mixed spline volume.

    solid       which solid of a file with several, from 0
    degree      3 (default) or more: degrees above three are added to the cubic volume
    size        largest element of the skin, relative to the diagonal (default 0.2)
    tolerance   wanted distance of the skin to the CAD surfaces, relative to the diagonal (default 2e-5)
    layers      spline layers under the skin; 0 (default): pyramids and tetrahedra alone
    subdivide   how often the skin's elements are cut in four before the volume is filled; "auto" (default): 0, then 1
                if elements are left that are not certified
    limit       seconds after which a mesh generator is stopped (default 300)

The input is a STEP or IGES file, or the name of a shape (`shapes`). Boundaries carry the names of the CAD faces.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geometry.hybrid import refinement
from geometry.hybrid.brep import Brep
from geometry.hybrid.cad import cad_format, read_cad
from geometry.hybrid.settings import NAME, Settings, parse
from geometry.hybrid.shapes import SHAPES
from geometry.hybrid.shell import Shell, shell_of
from geometry.hybrid.skin import build_skin
from geometry.hybrid.subdividing import subdivided
from geometry.hybrid.volume import complete
from iga.domain import Domain, Provenance, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress, progress

name = NAME


def reads(path: str | Path) -> bool:
    """Whether a file is STEP or IGES, from its beginning."""
    return Path(path).is_file() and bool(cad_format(path))


def build(path: str | Path, **parameters: Any) -> Domain:
    """Domain from a CAD file with a solid.

    Parameters
    ----------
    path : a STEP or IGES file, or the name of a shape.
    parameters : see the module docstring.

    Raises
    ------
    InputError : an unknown or ill-typed parameter, a file that cannot be read (`FormatError`), or a solid of which no
        skin or no volume can be made, with the face or edge.
    """
    settings = parse(parameters)
    text = str(path)
    brep = SHAPES[text]() if text in SHAPES else read_cad(path, settings.solid)
    return domain_of(brep, settings, text if text in SHAPES else Path(path).name, progress())


def domain_of(brep: Brep, settings: Settings | None = None, source: str = "", shown: Progress = QUIET) -> Domain:
    """Domain of a solid in memory.

    Parameters
    ----------
    source : name of the input, for the provenance and messages.
    """
    settings = settings or Settings()
    if settings.layers:
        raise InputError(f"layers={settings.layers}: only layers=0 exists so far")
    skin = build_skin(brep, settings.size, settings.tolerance, source, shown)
    if skin.report.get("crossings") or skin.report.get("folded"):
        raise InputError(
            f"{source}: the skin cuts through itself or folds near {skin.report.get('worst_face', 'a face')} "
            f"({skin.report.get('crossings', 0)} crossings, {skin.report.get('folded', 0)} folds); try a smaller size"
        )
    provenance = Provenance(NAME, source, {k: v for k, v in vars(settings).items() if v is not None})
    domain = volume_under(shell_of(skin), settings, source, provenance, shown)
    if settings.degree > 3:
        domain = refinement.refine(domain, 0, settings.degree - 3)
    distance = skin.report.get("max_distance")
    told = {key: value for key, value in skin.report.items() if key not in ("volume", "elements", "max_distance")}
    domain = with_report(domain, cad_faces=len(brep.faces), cad_volume=brep.volume, **told)
    if distance is None:
        return domain
    reach = float(distance) * brep.diagonal
    return with_report(domain, distance={"to_input": reach, "from_input": None, "relative": float(distance)})


def volume_under(
    shell: Shell, settings: Settings, source: str, provenance: Provenance, shown: Progress = QUIET
) -> Domain:
    """Volume under a shell, its elements cut as often as it takes, once at most."""
    for _ in range(settings.subdivide or 0):
        shell = subdivided(shell)
    try:
        domain = complete(shell, provenance, settings.limit, shown=shown)
    except InputError as error:
        if settings.subdivide is not None:
            raise InputError(f"{source}: {error}") from error
        first: Domain | InputError = error
    else:
        if settings.subdivide is not None or not domain.report["not_certified"]:
            return with_report(domain, subdivided=settings.subdivide or 0)
        first = domain
    try:
        second = complete(subdivided(shell), provenance, settings.limit, shown=shown)
    except InputError as error:
        if isinstance(first, InputError):
            raise InputError(f"{source}: {first}") from error
        return with_report(first, subdivided=0)
    if isinstance(first, Domain) and first.report["not_certified"] <= second.report["not_certified"]:
        return with_report(first, subdivided=0)
    return with_report(second, subdivided=1)


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a volume: every cell, face to face.

    The boundary stays exactly, and so does the map outside pyramids.

    Raises
    ------
    InputError : the domain did not come from this source, or a number is negative.
    """
    if domain.provenance.source != NAME:
        raise InputError(f"the domain was made by {domain.provenance.source or 'hand'}, not by {NAME}")
    return refinement.refine(domain, levels, elevate)
