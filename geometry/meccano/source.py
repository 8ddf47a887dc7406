r"""The geometry source "meccano": closed surface triangulations as spline volumes.

Input is an STL, OBJ, OFF or PLY file, or the name of a shape: "ball", "star" or "torus".

    meccano     "auto" (default: pillowed, of a cube for genus 0 if the surface suits it, else of a polycube),
                "pillowed" (of a cube), "polycube" (pillowed, also for genus 0), "cube" (the paper's; its solids fold
                along the cube's edges, see `paper`)
    space       "optimal" (default): truncated hierarchical cubics; "t-spline": the paper's rational T-splines on a
                cube, or on a polycube without pillow, good for the geometry itself only; they fold as above
    tolerance   distance from the surface, relative to its diagonal (default 0.004; 0.005 for the paper's solids, where
                it steers the tetrahedra, and needing more than max_cells cells is refused)
    max_cells   most cells of the T-mesh (default 10000)
    off         what becomes of a solid that these cells, or the rounds, do not bring within the tolerance: "refuse"
                (default), or "keep", as it is, certified and with its distance in the report
    stretch     area of the surface per area of a side up to which limbs may be laid small (default 10)
    share       thickness of the pillow, as a part of a block (default 0.25)
    rounds      most rounds of refinement (default 14)
    smoothing   rounds in which poor shapes are smoothed at the end (default 1; 0 also where many are poor)
    measure     of the paper's solids: "volume" (default), the paper's d(T) below the cube of the tolerance, or
                "distance", a length below the tolerance
    remedy      of the paper's solids: "refine" (default), split cells with a negative centre; "untangle", move inner
                control points; "none"
    corners     eight points x,y,z; x,y,z; .. near which the cube's corners shall lie on the surface, in the order of
                the reference cell's vertices (default: found)
    labels      a file with the side of the meccano (0 to 5: x0, x1, y0, .. z1 of the cube; rows of
                `blocks.Blocks.boundary_sides` of a polycube) that each triangle belongs to
    cuboids     the polycube as boxes i,j,k,I,J,K; .. of whole numbers, lowest and highest corner of each (default:
                found); the grid is fitted to the surface's bounding box
    mend        repair small defects of the surface first: doubled points, degenerate triangles, orientation, holes,
                triangles that cross each other (default false)

The surface is divided into one patch for each boundary side of the meccano, each patch is laid on its side by mean
values, and the solid is grown into that map (`growth`). Refinement is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from geometry.inputs import require_file
from geometry.layouts.blocks import pillowed
from geometry.layouts.boundary_map import BoundaryMap, boundary_map, carried, on_surface
from geometry.layouts.partition import partition, price
from geometry.layouts.polycube import polycube_map, slender_map
from geometry.layouts.voxels import cuboids
from geometry.meccano.adaptation import Measure
from geometry.meccano.domain import build_domain, refine_domain
from geometry.meccano.errors import tessellation
from geometry.meccano.growth import CELLS, WITHIN, solid_of
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.paper import Kind, Remedy, boundary_triangles, paper_solid
from geometry.meccano.settings import NAME, Settings, parse
from geometry.meccano.shapes import SHAPES
from geometry.meccano.state import Aims
from geometry.meccano.tmesh import uniform
from geometry.simplices import reading
from geometry.simplices.distance import distances
from geometry.simplices.surface import Surface, genus, volume
from iga.clock import Clock
from iga.domain import Domain, Provenance, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress, progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

name = NAME

MANY_BLOCKS = (500, 16)
"""Meccanos of more blocks start with one cell in each, with 2^3, or else with 4^3."""

DEAR = 0.3
"""Price of a map onto the cube from which on a polycube is tried."""

FINER = (8.0, 10.0, 12.0)
"""Voxels along the longest axis of polycubes that are tried where all other maps are dear."""


def reads(path: str | Path) -> bool:
    """Whether a file looks like a surface triangulation. A shape's name is taken as well."""
    return str(path) in SHAPES or reading.reads(path)


def build(path: str | Path, **parameters: Any) -> Domain:
    """Domain from a file with a closed triangulation.

    Parameters
    ----------
    path : an STL, OBJ, OFF or PLY file, or the name of a shape (`shapes`).
    parameters : see the module docstring.

    Raises
    ------
    InputError : an unknown or ill-typed parameter, a file that cannot be read (`FormatError`), or a surface that bounds
        no solid or has no meccano.
    """
    settings = parse(parameters)
    clock = Clock()
    if str(path) in SHAPES:
        return domain_of(SHAPES[str(path)](), settings, str(path), {}, clock, progress())
    surface, report = reading.read_surface(require_file(path, SHAPES), settings.mend)
    clock.lap("surface")
    return domain_of(surface, settings, Path(path).name, report, clock, progress())


def domain_of(
    surface: Surface, settings: Settings | None = None, source: str = "", report: dict[str, Any] | None = None,
    clock: Clock | None = None, shown: Progress = QUIET,
) -> Domain:
    """Domain of a surface in memory.

    Parameters
    ----------
    source : name of the input, for the provenance.
    """
    settings, clock, report = settings or Settings(), clock or Clock(), dict(report or {})
    mapping, found = map_of(surface, settings, shown)
    report |= found
    clock.lap("boundary_map")
    if settings.as_paper:
        return _as_paper(mapping, surface, settings, source, report, clock, shown)
    blocks = pillowed(mapping.blocks, settings.share)
    mapping = carried(mapping, blocks)
    level = sum(len(blocks.corners) <= most for most in MANY_BLOCKS)
    start = uniform(blocks, level, 1)
    while start.cells > settings.max_cells and level:
        level -= 1
        start = uniform(blocks, level, 1)
    if start.cells > settings.max_cells:
        raise InputError(f"the meccano has {len(blocks.corners)} blocks, too many for max_cells={settings.max_cells}")
    aims = Aims(settings.aim * surface.diagonal, settings.max_cells, settings.rounds, settings.smoothing)
    solid, history = solid_of(
        hierarchy(start), lambda side, s: on_surface(mapping, side, s)[0], surface, aims, shown
    )
    clock.lap("solid")
    skin = tessellation(solid.skin, solid.points)
    report["distance"] = distances(surface, *skin)
    clock.lap("distance")
    ended = history[-1]["ended"]
    if ended != WITHIN and settings.off == "refuse":
        raise InputError(
            f"{source or 'the surface'}: the solid is {report['distance']['relative']:.1e} of the diagonal off where "
            f"{settings.aim:g} is wanted, when {_spent(ended, settings)}; give more, or a larger tolerance, or take it "
            "as it is with off=keep"
        )
    report |= {
        "blocks": len(blocks.corners), "cells": solid.space.tmesh.cells, "surface_volume": volume(surface),
        "levels": np.bincount(solid.space.tmesh.level).tolist(), "rounds": history, "seconds": clock.laps,
        "ended": ended, "within_tolerance": bool(report["distance"]["relative"] <= settings.aim),
        "uncertified_cells": np.sort(solid.invalid).tolist(),
    }
    return build_domain(solid.space, solid.points, Provenance(NAME, source, vars(settings).copy()), report)


def _spent(ended: str, settings: Settings) -> str:
    """What growth stopped at, in words."""
    return f"{settings.max_cells} cells are spent" if ended == CELLS else f"{settings.rounds} rounds are spent"


def _as_paper(
    mapping: BoundaryMap, surface: Surface, settings: Settings, source: str, report: dict[str, Any], clock: Clock,
    shown: Progress,
) -> Domain:
    kind: Kind = "t-spline" if settings.space == "t-spline" else "optimal"
    solid = paper_solid(
        mapping, kind, settings.aim * surface.diagonal, cast(Measure, settings.measure), cast(Remedy, settings.remedy),
        settings.rounds, settings.max_cells, clock.lap, shown,
    )
    made = build_domain(solid.fit.space, solid.fit.points, Provenance(NAME, source, vars(settings).copy()))
    distance = distances(surface, *boundary_triangles(made))
    clock.lap("distance")
    between = solid.report["between_spaces"]
    report |= solid.report | {
        "blocks": len(mapping.blocks.corners), "surface_volume": volume(surface), "distance": distance,
        "between_spaces": {**between, "relative": between["largest"] / surface.diagonal}, "seconds": clock.laps,
        "within_tolerance": bool(distance["relative"] <= settings.aim),
    }
    return with_report(made, **report)


def map_of(surface: Surface, settings: Settings, shown: Progress) -> tuple[BoundaryMap, dict[str, Any]]:
    """The boundary map of the meccano before pillowing."""
    labels = None if settings.labels is None else np.array(settings.labels)
    if settings.cuboids is not None:
        voxels = cuboids(surface, np.array(settings.cuboids).reshape(-1, 2, 3))
        return polycube_map(surface, voxels, limit=settings.stretch, progress=shown, labels=labels)
    if settings.corners is not None or labels is not None:
        corners = None if settings.corners is None else np.array(settings.corners)
        return boundary_map(partition(surface, corners, labels, progress=shown), settings.stretch, shown)
    auto = settings.meccano == "auto"
    if settings.meccano == "polycube" or (auto and genus(surface) > 0):
        return polycube_map(surface, limit=settings.stretch, progress=shown)
    if auto:
        return _cheaper(surface, settings, shown)
    return boundary_map(partition(surface, progress=shown), settings.stretch, shown)


def _cheaper(surface: Surface, settings: Settings, shown: Progress) -> tuple[BoundaryMap, dict[str, Any]]:
    """The map of a surface of genus 0 onto a cube, or, where that is dear (`partition.price`), onto a polycube.

    A polycube that follows thin limbs is tried first, because limbs are what makes the cube dear; finer ones last.
    """
    found: list[tuple[BoundaryMap, dict[str, Any]]] = []
    reasons: list[str] = []
    ways: list[Callable[[], tuple[BoundaryMap, dict[str, Any]]]] = [
        lambda: boundary_map(partition(surface, progress=shown), settings.stretch, shown),
        partial(slender_map, surface, settings.stretch, shown),
        partial(polycube_map, surface, limit=settings.stretch, progress=shown),
        *(partial(slender_map, surface, settings.stretch, shown, number) for number in FINER),
    ]
    for make in ways:
        try:
            found.append(make())
        except InputError as error:
            reasons.append(str(error))
        if found and price(found[-1][0]) < DEAR:
            break
    if not found:
        raise InputError(f"the surface is laid neither on a cube ({reasons[0]}) nor on a polycube ({reasons[-1]})")
    prices = [price(mapping) for mapping, _ in found]
    mapping, report = found[int(np.argmin(prices))]
    kind = "cube" if len(mapping.blocks.corners) == 1 else "polycube"
    return mapping, report | {"meccano": kind, "price": min(prices)}


def refine(domain: Domain, levels: int = 1, elevate: int = 0, cells: Index | None = None) -> Domain:
    """Halve the cells of the T-mesh, or split some of them; the solid stays.

    Parameters
    ----------
    cells : numbers of leaf cells (or truth values (c,)) to split, with their neighbours; all by default.

    Raises
    ------
    InputError : elevation is asked for, or the domain did not come from this source.
    """
    if elevate:
        raise InputError("meccano solids cannot be elevated; they are cubic")
    if levels < 0:
        raise InputError(f"cannot refine {levels} times")
    if cells is not None and levels != 1:
        raise InputError("some cells can be split once at a time")
    for _ in range(levels):
        domain = refine_domain(domain, cells)
    return domain
