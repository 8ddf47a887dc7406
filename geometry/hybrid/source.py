r"""The geometry source "hybrid": trimmed CAD solids as watertight splines and a mixed spline volume.

    solid       which solid of a file with several, from 0
    skin        "triangles" (default), or "hybrid": quadrilaterals that are the CAD surface itself on curved faces
                (rational ones to the tolerance), pyramids on them, and triangles along trimming curves; or "hb-rep":
                the same on all faces, and the functions on the boundary are the faces' B-splines, revised beside the
                trimming curves, and trim functions that neighbours share (`sealing`). Triangles are the default because
                tetrahedra refine exactly and keep the full order, where pyramids, whose functions are rational, lose
                some on warped bases; and because a few parts fold with quadrilaterals alone
    degree      3 (default) or more: degrees above three are added to the cubic volume
    size        largest element of the skin, relative to the diagonal (default 0.2)
    tolerance   wanted distance of the skin to the CAD surfaces, relative to the diagonal (default 2e-5)
    layers      layers of control points under the skin, 3 at least; 0 (default): pyramids and tetrahedra alone. Where
                layers cannot be made valid they are dropped, and the report says so
    omega       share of the way to the mid-structure that layers take (default 0.5), less where they would fold
    paths       blended (default): layers are traced along the blend of harmonic gradient and distance; or straight
    mid         the mid-structure: auto (default), or points as "x,y,z; x,y,z; .."
    relax       relaxation of layers, 0 to 1 (default 0.5)
    subdivide   how often the skin's elements are cut in four before the volume is filled; "auto" (default): once if
                the skin has few elements, which would leave next to no vertex inside the solid, and once more if
                elements are left that are not certified
    limit       seconds after which a mesh generator is stopped (default 300)
    convert     none (default), or hex4: each tetrahedron becomes four hexahedra, exactly
    refine      levels of refinement (default 0), by a
    strategy    kept (default): build, then cut every cell; skin, map and partition are kept. The functions are C0 then,
                also where those of an HB-rep were smoother, and contain the old ones: on a triangle beside a trimming
                curve these are no splines on halved intervals (Song and Cohen 2019, Section 6), so spaces of B-splines
                would not be nested. The report's ``smoothness`` says 0
                recomputed: cut the skin's elements (the same surface), trace layers from it and fill the inside anew
                layers: cut the layers with the skin, after tracing, and fill what is below them anew (Song and Cohen
                2019, Section 6.1); without layers the same as recomputed
                trimmed: refine the trimmed B-rep (elements of half the size, a tolerance 16 times smaller) and build
                everything again, so that the skin comes nearer to the CAD surfaces
                The report says in numbers what was preserved (`comparison`)

The report sets the volume against the CAD kernel's (``cad_volume``), against the integral over the CAD surfaces between
their trimming curves (``surfaces_volume``), says how well either is defined where the file's faces do not meet
(``volume_spread``, relative), and what the volume is with the gaps between faces and edges closed (``closed_volume``;
see `integrals`).

The input is a STEP or IGES file, or the name of a shape: "ball", "curved_box", "curved_difference", "tetrapod",
"bracket" or "lettered_plate". Boundaries carry the names of the CAD faces; ``cad_faces`` in the report counts a closed
one, such as a whole cylinder, as the two halves in which it is worked on.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from geometry.cad.brep import Brep
from geometry.cad.integrals import closed_volume, integrals_of, strips_of, volume_spread
from geometry.cad.reading import cad_format, read_cad
from geometry.hybrid import refinement
from geometry.hybrid.comparison import preserved
from geometry.hybrid.hexes import has_hexes, with_hexes, with_tets
from geometry.hybrid.layers import complete_with_layers
from geometry.hybrid.settings import NAME, Settings, parse
from geometry.hybrid.shapes import SHAPES
from geometry.hybrid.shell import Shell, shell_of
from geometry.hybrid.skin import build_skin
from geometry.hybrid.subdividing import refined, subdivided
from geometry.hybrid.volume import complete
from geometry.inputs import require_file
from iga.cells import HEXAHEDRON
from iga.domain import Domain, Provenance, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress, progress

name = NAME
SHRINK = 16.0
"""By how much the tolerance falls when elements of the skin are halved: cubics are of order four."""
FEW = 400
"""Elements of a skin below which ``subdivide="auto"`` cuts them."""


def reads(path: str | Path) -> bool:
    """Whether a file is STEP or IGES, from its beginning."""
    return str(path) in SHAPES or (Path(path).is_file() and bool(cad_format(path)))


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
    began = perf_counter()
    brep = SHAPES[text]() if text in SHAPES else read_cad(require_file(path, SHAPES), settings.solid)
    read = perf_counter() - began
    domain = domain_of(brep, settings, text if text in SHAPES else Path(path).name, progress())
    return with_report(domain, stages={"read": read, **domain.report["stages"]})


def domain_of(brep: Brep, settings: Settings | None = None, source: str = "", shown: Progress = QUIET) -> Domain:
    """Domain of a solid in memory.

    Parameters
    ----------
    source : name of the input, for the provenance and messages.
    """
    settings = settings or Settings()
    shell, coarse = _built(brep, settings, source, shown)
    domain = coarse
    if settings.refine:
        domain = _refined(brep, shell, coarse, settings, source, shown)
        shown.say("comparing")
        domain = with_report(domain, strategy=settings.strategy, preserved=asdict(preserved(coarse, domain)))
    if settings.degree > 3:
        domain = refinement.refine(domain, 0, settings.degree - 3)
    return with_hexes(domain) if settings.convert == "hex4" else domain


def _built(brep: Brep, settings: Settings, source: str, shown: Progress) -> tuple[Shell, Domain]:
    """Shell as it was filled and its volume, without refinement."""
    began = perf_counter()
    kind = settings.skin
    skin = build_skin(brep, settings.size, settings.tolerance, source, shown, kind)
    if kind != "triangles" and (skin.report["crossings"] or skin.report["folded"]):
        kind = f"triangles, because quadrilaterals leave folds on {', '.join(skin.report['faulty_faces'])}"
        skin = build_skin(brep, settings.size, settings.tolerance, source, shown)
    if skin.report.get("crossings") or skin.report.get("folded"):
        raise InputError(
            f"{source}: the skin cuts through itself or folds on {', '.join(skin.report.get('faulty_faces', ()))} "
            f"({skin.report.get('crossings', 0)} crossings, {skin.report.get('folded', 0)} folds); try a smaller size"
        )
    made = perf_counter()
    provenance = Provenance(NAME, source, {k: v for k, v in vars(settings).items() if v is not None})
    shell = shell_of(skin)
    shell, domain = volume_under(shell, settings, source, provenance, shown)
    distance = skin.report.get("max_distance")
    told = {key: value for key, value in skin.report.items() if key not in ("volume", "elements", "max_distance")}
    stages = {"skin": made - began, "inside": perf_counter() - made}
    exact = integrals_of(brep)
    told |= {
        "skin": kind, "cad_faces": len(brep.faces), "cad_volume": brep.volume,
        "surfaces_volume": float(exact.volume.sum()), "volume_spread": volume_spread(brep, exact),
        "closed_volume": closed_volume(exact, strips_of(brep)), "stages": stages,
    }  # fmt: skip
    if distance is not None:
        reach = float(distance) * brep.diagonal
        told["distance"] = {"to_input": reach, "from_input": None, "relative": float(distance)}
    return shell, with_report(domain, **told)


def _refined(
    brep: Brep, shell: Shell, coarse: Domain, settings: Settings, source: str, shown: Progress
) -> Domain:
    """Refined volume by the strategy of the settings."""
    levels = settings.refine
    if settings.strategy == "kept":
        return refinement.refine(coarse, levels)
    if settings.strategy == "trimmed":
        finer = replace(settings, size=settings.size / 2**levels, tolerance=settings.tolerance / SHRINK**levels)
        return _built(brep, finer, source, shown)[1]
    if settings.strategy == "layers" and settings.layers and "layers_dropped" not in coarse.report:
        domain = _layered(shell, settings, coarse.report["omega"], coarse.provenance, shown, levels)
    else:
        for _ in range(levels):
            shell = refined(shell, shell.points)[0]
        made = _attempt(shell, settings, source, coarse.provenance, shown)
        domain = _told(made, coarse.report["subdivided"])
    return replace(domain, report={**coarse.report, **domain.report, "levels": levels})


def volume_under(
    shell: Shell, settings: Settings, source: str, provenance: Provenance, shown: Progress = QUIET
) -> tuple[Shell, Domain]:
    """Volume under a shell, and the shell as it was cut: as often as the settings say, or, where that is left open, not
    at all if no volume can be made of the cut one, or once more if elements are not certified.
    """
    times = settings.subdivide if settings.subdivide is not None else int(shell.space.elements < FEW)
    whole = shell
    for _ in range(times):
        shell = subdivided(shell)
    first = _attempt(shell, settings, source, provenance, shown)
    if isinstance(first, InputError) and times and settings.subdivide is None:
        plain = _attempt(whole, settings, source, provenance, shown)
        if isinstance(plain, Domain) and not plain.report["not_certified"]:
            return whole, _told(plain, 0)
    if (isinstance(first, Domain) and not first.report["not_certified"]) or settings.subdivide is not None:
        return shell, _told(first, times)
    finer = subdivided(shell)
    second = _attempt(finer, settings, source, provenance, shown)
    if isinstance(second, Domain) and (
        not isinstance(first, Domain) or second.report["not_certified"] < first.report["not_certified"]
    ):
        return finer, _told(second, times + 1)
    return shell, _told(first, times)


def _layered(
    shell: Shell, settings: Settings, omega: float, provenance: Provenance, shown: Progress, levels: int = 0
) -> Domain:
    middle = None if settings.mid is None else np.array(settings.mid)
    return complete_with_layers(
        shell, settings.layers, omega, provenance, settings.limit, shown, levels, settings.paths, middle, settings.relax
    )


def _attempt(
    shell: Shell, settings: Settings, source: str, provenance: Provenance, shown: Progress
) -> Domain | InputError:
    try:
        if settings.layers:
            return _layered(shell, settings, settings.omega, provenance, shown)
        return complete(shell, provenance, settings.limit, shown=shown)
    except InputError as error:
        return InputError(f"{source}: {error}")


def _told(made: Domain | InputError, times: int) -> Domain:
    if isinstance(made, InputError):
        raise made
    return with_report(made, subdivided=times)


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a volume: every cell, face to face.

    The boundary stays exactly, and so does the map outside pyramids. Hexahedra made of tetrahedra are cut themselves if
    there are no other cells; beside pyramids and wedges the tetrahedra are, and turned into hexahedra again.

    Raises
    ------
    InputError : the domain did not come from this source, or a number is negative.
    """
    if domain.provenance.source != NAME:
        raise InputError(f"the domain was made by {domain.provenance.source or 'hand'}, not by {NAME}")
    if has_hexes(domain) and {b.basis.cell for b in domain.space.blocks} != {HEXAHEDRON}:
        return with_hexes(refinement.refine(with_tets(domain), levels, elevate))
    return refinement.refine(domain, levels, elevate)
