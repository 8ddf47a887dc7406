r"""The paper's solid: tetrahedra of the meccano, the octree of their nodes, and splines close to their map.

    boundary map -> adapted tetrahedra, untangled and smoothed -> octree until no cell has a node inside
                 -> "t-spline": the rational T-splines that interpolate the map of the tetrahedra at all anchors
                    "optimal": truncated hierarchical cubics with clamped knots on the same octree, nearest to the same
                    map in the mean square, on the boundary first

Where the solid is smooth at an edge of the cube, cells there have two faces in one tangent plane, so det J vanishes at
the edge whatever the inner points are. The paper's remedy splits cells whose centre is negative, for a few rounds; the
other one moves inner control points (`iga.untangling`), the boundary being held. Both leave the edges as they are:
solids without folds need a pillowed meccano.

Axis letters: n function, c cell, q point in each cell, d direction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import place
from geometry.layouts.boundary_map import BoundaryMap, on_surface
from geometry.meccano.adaptation import Measure
from geometry.meccano.bisection import FULL
from geometry.meccano.domain import bare
from geometry.meccano.fitting import fit_boundary, greville_points
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.interpolation import interpolate, points_and_slopes
from geometry.meccano.parametrisation import Parametrisation, image
from geometry.meccano.skin import facet_rule, places_on, skin_of
from geometry.meccano.t_spline import TSpline, places_of, t_spline
from geometry.meccano.tmesh import TMesh, cells_at, octree, refined
from geometry.meccano.volume import Stage, parametrise
from iga.assembly import matrix
from iga.certificate import certify, summary
from iga.chunk import Chunk, rule_for
from iga.conditions import trace_functions
from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import Mass
from iga.linear.solvers import solve
from iga.progress import QUIET, Progress
from iga.quadrature import gauss
from iga.scaled_jacobian import scale
from iga.untangling import untangle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Kind = Literal["t-spline", "optimal"]
Remedy = Literal["none", "refine", "untangle"]

_TETS_PER_CELL = 60  # far more than an octree of their nodes needs
_ROUNDS = 6
_SAMPLES = 5


@dataclass(frozen=True, eq=False)
class Fit:
    """Splines on a T-mesh that follow a map of tetrahedra.

    Attributes
    ----------
    tmesh : cells of the meccano's blocks.
    space : the functions.
    points : (n, 3) control points.
    numbers : ``residual`` and ``condition`` of an interpolation.
    """

    tmesh: TMesh
    space: TSpline | Hierarchy
    points: Array
    numbers: dict[str, float] = field(default_factory=dict)


def tetrahedra(
    mapping: BoundaryMap, tolerance: float, measure: Measure, max_cells: int, sweeps: int = 40, shown: Progress = QUIET
) -> tuple[Parametrisation, list[Stage]]:
    """The volumetric parametrisation: Kuhn's tetrahedra of a cube, coloured ones of a polycube.

    Parameters
    ----------
    tolerance : a length; as a volume, its cube.
    """
    bound = tolerance if measure == "distance" else tolerance**3
    one = len(mapping.blocks.corners) == 1
    start: Literal["kuhn", "coloured"] = "kuhn" if one else "coloured"
    return parametrise(
        mapping.blocks, lambda side, s: on_surface(mapping, side, s)[0], bound, measure, start, 3 if one else 0,
        sweeps=sweeps, most=_TETS_PER_CELL * max_cells, progress=shown,
    )


def nodes_of(mapping: Parametrisation) -> tuple[Index, Index]:
    """Blocks (n,) and places (n, d) of all vertices of the simplices, those on block sides once for each block."""
    d = mapping.places.shape[2]
    rows = np.column_stack([np.repeat(mapping.block, d + 1), mapping.places.reshape(-1, d)])
    rows = np.unique(rows, axis=0)
    return rows[:, 0], rows[:, 1:]


def fit(kind: Kind, tmesh: TMesh, mapping: Parametrisation) -> Fit:
    """Splines on a T-mesh, close to the map of the tetrahedra."""
    if kind == "optimal":
        return _projected(hierarchy(tmesh), mapping)
    own = t_spline(tmesh)
    points, numbers = interpolate(own, image(mapping, *places_of(own, own.anchors)))
    return Fit(tmesh, own, points, numbers)


def _projected(space: Hierarchy, mapping: Parametrisation) -> Fit:
    """Nearest in L2: first on the boundary, then inside."""
    tmesh, skin = space.tmesh, skin_of(space)
    block, xi = greville_points(space)
    picture = Domain(space.space, place(tmesh.blocks, block, xi))
    rule = facet_rule(_SAMPLES)
    points = fit_boundary(skin, image(mapping, block, xi), rule, image(mapping, *places_on(skin, rule)), fairness=1e-6)
    load = np.zeros((space.space.n, 3))
    for number, elements in enumerate(space.space.blocks):
        cells = np.empty(elements.elements, dtype=np.int64)
        mine = np.flatnonzero(space.element[:, 0] == number)
        cells[space.element[mine, 1]] = mine
        own = rule_for(picture, number, None)
        for begin in range(0, elements.elements, 256):
            some = np.arange(begin, min(begin + 256, elements.elements))
            c = cells[some]
            chunk = Chunk(picture, number, some, own.points, own.weights, own)
            at = (tmesh.corner[c, None] + tmesh.size[c, None, None] * own.points).reshape(-1, 3) / FULL
            f = image(mapping, np.repeat(tmesh.block[c], len(own.points)), at).reshape(len(c), -1, 3)
            part = np.swapaxes(chunk.N, 1, 2) @ (chunk.dx[..., None] * f)
            np.add.at(load, elements.dofs[some], part)
    M = matrix(picture, Mass())
    for a in range(3):
        held = (skin.functions, points[skin.functions, a])
        points[:, a] = solve(M, load[:, a], held, domain=picture, tolerance=1e-9)[0]
    return Fit(tmesh, space, points)


def at_cells(made: Fit, local: Array) -> tuple[Array, Array]:
    """Points (c, q, 3) and derivatives (c, q, 3, d) at the same points (q, d) of all cells, cells as in the T-mesh."""
    own = made.space
    if isinstance(own, TSpline):
        inside = np.flatnonzero(own.owner >= 0)
        # Cells of the octree around a polycube lie in another order than those of its blocks.
        block, xi = places_of(own, own.tmesh.corner[inside] + own.tmesh.size[inside, None] // 2)
        order = np.empty(len(inside), dtype=np.int64)
        order[cells_at(made.tmesh, block, xi)] = np.arange(len(inside))
        corner, size = own.tmesh.corner[inside][order], own.tmesh.size[inside][order]
        x = (corner[:, None] + size[:, None, None] * local) / FULL
        S, slopes = points_and_slopes(own, made.points, x.reshape(-1, x.shape[2]))
        shape = (len(inside), len(local), 3)
        return S.reshape(shape), slopes.reshape(*shape, -1) * (size / FULL)[:, None, None, None]
    x, J = np.empty((made.tmesh.cells, len(local), 3)), np.empty((made.tmesh.cells, len(local), 3, 3))
    domain = bare(own, made.points)
    for number, block_ in enumerate(own.space.blocks):
        cells = np.empty(block_.elements, dtype=np.int64)
        mine = np.flatnonzero(own.element[:, 0] == number)
        cells[own.element[mine, 1]] = mine
        for begin in range(0, block_.elements, 512):
            some = np.arange(begin, min(begin + 512, block_.elements))
            chunk = Chunk(domain, number, some, local, np.ones(len(local)))
            x[cells[some]], J[cells[some]] = chunk.x, chunk.J
    return x, J


@dataclass(frozen=True)
class Round:
    """Scaled Jacobians of all cells at 2 x 2 x 2 Gauss points and at the centre, as the paper counts them.

    Attributes
    ----------
    cells : how many there are.
    negative_centre, negative_gauss : cells with a negative centre, and with a negative Gauss point.
    least, mean : over Gauss points.
    below_half : share of cells with a Gauss point below one half.
    centre_below_half : share of cells with a centre below one half.
    volume : by the Gauss points, negative ones included.
    """

    cells: int
    negative_centre: int
    negative_gauss: int
    least: float
    mean: float
    below_half: float
    centre_below_half: float
    volume: float


def judged(made: Fit) -> tuple[Round, Mask]:
    """Scaled Jacobians of a fit, and which cells (c,) have a negative centre."""
    rule = gauss(made.tmesh.blocks.cell, 2)
    J = at_cells(made, np.vstack([rule.points, np.full((1, made.tmesh.dim), 0.5)]))[1]
    scaled = scale("hexahedron", J)
    least, centre = scaled[:, :-1].min(axis=1), scaled[:, -1]
    found = Round(
        made.tmesh.cells, int((centre < 0.0).sum()), int((least < 0.0).sum()), float(least.min()),
        float(scaled[:, :-1].mean()), float((least < 0.5).mean()), float((centre < 0.5).mean()),
        float((np.linalg.det(J[:, :-1]) @ rule.weights).sum()),
    )
    return found, centre < 0.0


def remedied(
    kind: Kind, made: Fit, mapping: Parametrisation, rounds: int, max_cells: int, shown: Progress = QUIET
) -> tuple[Fit, list[Round]]:
    """The paper's remedy: split cells whose centre is negative, until there are none or no cells are left to spend.

    A round may well fold more than it mends, as splines on finer cells follow the kinks of the tetrahedra's map closer.
    Clamped splines gain functions only where neighbours are split as well.

    Returns
    -------
    The fit with the fewest negative centres, the earliest of equals, and the numbers of all rounds, that of the given
    fit first.
    """
    block, places = nodes_of(mapping)
    found, bad = judged(made)
    history, best, fewest, last = [found], made, found.negative_centre, made
    for _ in range(min(rounds, _ROUNDS)):
        if not bad.any():
            break
        shown.say(f"remedy: {int(bad.sum())} of {found.cells} cells have a negative centre")
        try:
            if kind == "optimal":
                finer = refined(last.tmesh, np.flatnonzero(bad), reach=1, limit=max_cells)
            else:  # centres are nodes of the next octree, which therefore splits their cells
                centre = last.tmesh.corner[bad] + last.tmesh.size[bad, None] // 2
                block, places = np.concatenate([block, last.tmesh.block[bad]]), np.concatenate([places, centre])
                finer = octree(last.tmesh.blocks, block, places, limit=max_cells)
        except InputError:  # no room for another round
            break
        last = fit(kind, finer, mapping)
        found, bad = judged(last)
        history.append(found)
        if found.negative_centre < fewest:
            best, fewest = last, found.negative_centre
    return best, history


def inner(made: Fit) -> Mask:
    """(n,) functions that vanish on the boundary of the meccano."""
    domain = bare(made.space, made.points)
    mask = np.ones(domain.space.n, dtype=bool)
    mask[trace_functions(domain, domain.boundaries["boundary"])] = False
    return mask


def untangled(made: Fit, shown: Progress = QUIET) -> Fit:
    """Move inner control points until elements are certified, as far as that goes with the boundary held."""
    found = untangle(bare(made.space, made.points), inner(made), rounds=_ROUNDS, shown=shown)
    return replace(made, points=found.points)


def apart(one: Fit, other: Fit) -> dict[str, float]:
    """Largest and root mean square distance of two solids on one T-mesh, between points of equal parameters."""
    line = np.array([0.0, 0.5, 1.0])
    local = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    gap = np.linalg.norm(at_cells(one, local)[0] - at_cells(other, local)[0], axis=2)
    return {"largest": float(gap.max()), "rms": float(np.sqrt((gap**2).mean()))}


def boundary_triangles(domain: Domain, cuts: int = 3) -> tuple[Array, Index]:
    """Points (v, 3) and triangles (t, 3), outward, on the boundary, each facet cut into ``cuts`` by ``cuts``."""
    line = np.linspace(0.0, 1.0, cuts + 1)
    u = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (np.arange(cuts)[:, None] * (cuts + 1) + np.arange(cuts)).ravel()
    one, two = first + cuts + 1, first + 1
    local = np.concatenate([np.column_stack([first, one, two]), np.column_stack([one, one + 1, two])])
    points = []
    for facets in domain.boundaries["boundary"]:
        face = domain.space.blocks[facets.block].basis.cell.faces[facets.face]
        xi = face.origin + u @ face.axes.T
        for begin in range(0, len(facets.elements), 512):
            some = facets.elements[begin : begin + 512]
            points.append(Chunk(domain, facets.block, some, xi, np.ones(len(u)), None, facets.face).x.reshape(-1, 3))
    made = np.concatenate(points)
    return made, (len(u) * np.arange(len(made) // len(u))[:, None, None] + local).reshape(-1, 3)


def volume_of(mapping: Parametrisation) -> float:
    """Volume of the tetrahedra's images."""
    x = mapping.nodes[mapping.tets]
    return float(np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6.0)


@dataclass(frozen=True, eq=False)
class PaperSolid:
    """What `paper_solid` finds.

    Attributes
    ----------
    mapping : the tetrahedra.
    stages : how they came about.
    fit : the splines.
    report : numbers, see `paper_solid`.
    """

    mapping: Parametrisation
    stages: list[Stage]
    fit: Fit
    report: dict[str, Any]


def paper_solid(
    boundary: BoundaryMap, kind: Kind, tolerance: float, measure: Measure, remedy: Remedy, rounds: int, max_cells: int,
    lap: Callable[[str], None] = lambda stage: None, shown: Progress = QUIET,
) -> PaperSolid:
    """Build a solid as the paper does.

    Parameters
    ----------
    tolerance : a length, see `tetrahedra`.
    lap : called with the name of each stage when it ends.

    Returns
    -------
    The solid. Its report has ``tets`` (counts, inverted ones before and after each sweep of each stage), ``remedy``
    (`Round` by round), ``refuted`` (elements, before and after the remedy), ``between_spaces`` (to the solid of the
    other space on the same octree) and the interpolation's ``residual`` and ``condition``.

    Raises
    ------
    InputError : the octree would have more than ``max_cells`` cells.
    """
    mapping, stages = tetrahedra(boundary, tolerance, measure, max_cells, shown=shown)
    lap("tetrahedra")
    tmesh = octree(boundary.blocks, *nodes_of(mapping), limit=max_cells)
    lap("octree")
    made = fit(kind, tmesh, mapping)
    lap("interpolation")
    first = made
    made, history = remedied(kind, made, mapping, rounds if remedy == "refine" else 0, max_cells, shown)
    if remedy == "untangle":
        made = untangled(made, shown)
        history.append(judged(made)[0])
    lap("remedy")
    before = summary(certify(bare(first.space, first.points)))
    after = before if made is first else summary(certify(bare(made.space, made.points)))
    lap("certificate")
    other = fit("optimal" if kind == "t-spline" else "t-spline", made.tmesh, mapping)
    between = apart(made, other)
    lap("other_space")
    last = stages[-1]
    report: dict[str, Any] = {
        "tets": {
            "nodes": last.nodes, "inner": last.inner, "tets": last.tets, "inverted": last.after,
            "volume": volume_of(mapping), "stages": [vars(stage).copy() for stage in stages],
        },
        "cells": made.tmesh.cells, "levels": np.bincount(made.tmesh.level).tolist(),
        "remedy": [vars(row).copy() for row in history],
        "refuted": {"before": before["refuted"], "after": after["refuted"]},
        "between_spaces": between, **made.numbers,
    }
    return PaperSolid(mapping, stages, made, report)
