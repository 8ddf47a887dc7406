r"""From the map of the meccano's boundary to a certified solid, coarse to fine.

On a coarse T-mesh the solid starts valid: as a smooth blob whose boundary is fitted with much fairness and whose inside
is harmonic in the straight picture of the meccano, or, where that cannot be untangled, as that picture itself. Springs
of growing stiffness draw the boundary to ever better fits of the map, as far as the solid stays valid.

From then on boundary points slide along the surface while the shapes of all elements are smoothed, held by springs
between samples of the boundary and the points of the surface closest to them, and between samples of the surface and
the points of the boundary closest to those. They begin soft, so that boundaries that the map left far off, or twisted,
come along without a fold. Cells whose facets are farther from the surface than the tolerance are split with their
neighbours, the solid is carried to the finer space as it is, and slides again.

A step that would leave an element without certificate is shortened around it, so what starts valid ends valid.

Axis letters: n function, f facet, q sample point, v vertex of the surface, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from geometry.layouts.blocks import place
from geometry.meccano.collocation import prolongation
from geometry.meccano.errors import Errors, errors_of, feet, surface_samples, unit_normals
from geometry.meccano.fitting import fit_boundary, greville_points
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.skin import Skin, facet_rule, side_coordinates, skin_of, values_at, values_on
from geometry.meccano.tmesh import refined
from geometry.simplices.closest import closest
from geometry.simplices.surface import Surface
from iga.assembly import matrix
from iga.distortion import own_shapes
from iga.domain import Domain
from iga.integrands import Diffusion
from iga.linear.solvers import solve
from iga.progress import QUIET, Progress
from iga.scaled_jacobian import least_of_elements
from iga.tether import Tether
from iga.untangling import approach, smooth, untangle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Target = Callable[[Index, Array], Array]

_SAMPLES = 5
_OUTER = facet_rule(_SAMPLES)

_SPACING = 0.01
"""Of the samples of the surface at which errors are measured, in diagonals."""


@dataclass(frozen=True)
class Aims:
    """What a solid should be.

    Attributes
    ----------
    tolerance : distance from the surface, both ways.
    max_cells : most cells of the T-mesh.
    rounds : most rounds of refinement.
    slides : rounds of smoothing of poor shapes at the end.
    """

    tolerance: float
    max_cells: int
    rounds: int = 8
    slides: int = 1


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid on a T-mesh.

    Attributes
    ----------
    space : the functions.
    skin : its boundary.
    points : (n, 3) control points.
    invalid : (k, 2) block and number of elements that are not certified.
    """

    space: Hierarchy
    skin: Skin
    points: Array
    invalid: Index

    @property
    def domain(self) -> Domain:
        """The solid as a bare domain."""
        return Domain(self.space.space, self.points)

    @property
    def uncertified(self) -> Index:
        """Leaf cells of the invalid elements."""
        number = np.array([1 << 32, 1])
        return np.flatnonzero(np.isin(self.space.element @ number, self.invalid @ number))

    @property
    def inner(self) -> Mask:
        """(n,) functions that vanish on the boundary."""
        mask = np.ones(self.space.space.n, dtype=bool)
        mask[self.skin.functions] = False
        return mask


def harmonic(space: Hierarchy, points: Array, fixed: Index) -> Array:
    """Control points (n, c) that are harmonic in the picture of the meccano, with those of ``fixed`` functions given.

    Raises
    ------
    ConvergenceError : the solver does not reach its tolerance.
    """
    block, xi = greville_points(space)
    picture = Domain(space.space, place(space.tmesh.blocks, block, xi))
    K = matrix(picture, Diffusion())
    return np.stack([
        solve(K, np.zeros(len(points)), (fixed, points[fixed, c]), domain=picture, tolerance=1e-9)[0]
        for c in range(points.shape[1])
    ], axis=1)


def solid_of(
    start: Hierarchy, target: Target, surface: Surface, aims: Aims, shown: Progress = QUIET
) -> tuple[Solid, list[dict[str, Any]]]:
    """Grow a solid.

    Parameters
    ----------
    start : the coarse space.
    target : points (q, 3) of the surface for boundary sides (q,) and coordinates s (q, 2).
    surface : the surface.

    Returns
    -------
    The solid, and numbers of each round for a report.
    """
    history: list[dict[str, Any]] = []
    there = surface_samples(surface, _SPACING)[0]
    began = perf_counter()

    def measured(solid: Solid, aim: Array) -> Errors:
        return errors_of(solid.skin, solid.points, aim, there, surface)

    def note(stage: str, solid: Solid, errors: Errors) -> None:
        history.append({
            "stage": stage, "cells": solid.space.tmesh.cells, "invalid": len(solid.invalid),
            "away": float(errors.away.max()), "missed": float(errors.missed.max()),
            "facets_off": int((errors.worst > aims.tolerance).sum()), "seconds": perf_counter() - began,
        })
        shown.say(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                            for key, value in history[-1].items()))

    solid = _first(start, target, shown)
    aim = target(*side_coordinates(solid.skin, _OUTER))
    for fairness in _FAIRNESS:
        solid = _drawn(solid, aim, fairness, aims, shown)
    errors = measured(solid, aim)
    note("drawing", solid, errors)
    for step in range(aims.rounds + 1):
        # Soft springs only where they have some way to go.
        grades = [g for g in (_GRADES if step == 0 else _FINE) if g <= errors.worst.max() / aims.tolerance]
        for factor in grades or (1.0,):
            solid = _slid(solid, surface, factor, aims, shown, aim if factor > _LEADING else None)
        errors, before = measured(solid, aim), np.inf
        for _ in range(_REPEATS if step == 0 else 1):
            if not 0.0 < _excess(errors, aims) < _PROGRESS * before:
                break
            before = _excess(errors, aims)
            solid = _slid(solid, surface, 1.0, aims, shown)
            errors = measured(solid, aim)
        if len(solid.invalid):
            solid = _untangled(solid, True, shown)
            errors = measured(solid, aim)
        note("sliding", solid, errors)
        finer = _finer(solid, _marked(solid, errors, aims), aims) if step < aims.rounds else None
        if finer is None or finer.space.tmesh.cells < _WORTH * solid.space.tmesh.cells:
            break
        solid = finer
        aim = target(*side_coordinates(solid.skin, _OUTER))
    for _ in range(_LATE * aims.slides):
        solid = _slid(solid, surface, 1.0, aims, shown, free=poor(solid))
    errors = measured(solid, aim)
    snapped = _snapped(solid, surface, aim, aims)
    nearer = measured(snapped, aim)
    if _excess(nearer, aims) <= _excess(errors, aims):
        solid, errors = snapped, nearer
    note("fitting", solid, errors)
    return solid, history


# First solid: rounds of untangling, fairness of the fits that the boundary is drawn to, stiffness of the springs there.
_TRIES = 8
_FAIRNESS = (1.0, 0.1, 0.01, 1e-3)
_STIFF = (1.0, 10.0, 100.0)
# Sliding: spacing of samples of the surface in diagonals, give of a spring in tolerances, what distances along the
# surface count; what the map's own springs count, and down to which softness they lead.
_SPRINGS = 0.02
_HOLD = 0.25
_ALONG = 0.01
_LED = 0.1
_LEADING = 2.0
# Softness of the springs on the first mesh and on finer ones; the last is 1, repeated on the first mesh while it lowers
# what is off.
_GRADES = (8.0, 8.0, 8.0, 4.0, 4.0, 2.0)
_FINE = (2.0,)
_REPEATS = 4
_PROGRESS = 0.8
# Of each: rounds, steps of descent, power of the mean ratio. At the end, rounds and scaled Jacobian of poor shapes.
_TURNS = 2
_SLIDE = 30
_POWER = 4.0
_LATE = 2
_POOR = 0.6
# Refinement: facets off by this share of the worst at least, most cells for each cell, fewest that are worth a step.
_SHARE = 0.2
_GROWTH = 2.2
_WORTH = 1.1


def _first(space: Hierarchy, target: Target, shown: Progress) -> Solid:
    """A smooth, valid solid near the surface: its sides are nearly bilinear.

    Where the inside of that cannot be untangled, the start is the picture of the meccano itself, laid onto the surface.
    """
    skin = skin_of(space)
    block, xi = greville_points(space)
    picture = place(space.tmesh.blocks, block, xi)
    where = target(*side_coordinates(skin, _OUTER))
    blob = fit_boundary(skin, picture, _OUTER, where, fairness=100.0)
    laid = _laid(picture, values_at(skin, _OUTER), where)
    for points in (harmonic(space, blob, skin.functions), laid):
        solid = _untangled(Solid(space, skin, points, np.empty((0, 2), dtype=np.int64)), False, shown)
        if not len(solid.invalid):
            break
    return solid


def _untangled(solid: Solid, boundary: bool, shown: Progress) -> Solid:
    """Untangle by inner control points, or by all."""
    found = untangle(solid.domain, solid.inner | boundary, rounds=_TRIES, patience=2, shown=shown)
    return replace(solid, points=found.points, invalid=found.invalid)


def _laid(points: Array, A: csr_array, where: Array) -> Array:
    """Points (n, 3) moved by the similarity that brings A @ points nearest to places (k, 3) (Umeyama 1991)."""
    own = A @ points
    centre, goal = own.mean(axis=0), where.mean(axis=0)
    u, s, v = np.linalg.svd((where - goal).T @ (own - centre))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    scale = (s * sign).sum() / ((own - centre) ** 2).sum()
    return np.asarray(goal + scale * (points - centre) @ (u * sign @ v).T)


def _drawn(solid: Solid, aim: Array, fairness: float, aims: Aims, shown: Progress) -> Solid:
    """Draw the boundary towards its fit to ``aim`` with ever stiffer springs, as far as the solid stays valid."""
    skin = solid.skin
    wanted = fit_boundary(skin, solid.points, _OUTER, aim, fairness=fairness)[skin.functions]
    rows, n = len(skin.functions), solid.space.space.n
    pick = csr_array((np.ones(rows), (np.arange(rows), skin.functions)), shape=(rows, n))
    size = sizes_of(solid)[skin.functions]
    springs = [Tether(pick, wanted, np.zeros((rows, 3)), w / size**2, 1.0) for w in _STIFF]
    free = np.ones(n, dtype=bool)
    found = smooth(solid.domain, free, iterations=30, tether=springs, shown=shown)
    goal = found.points.copy()
    goal[skin.functions] = wanted
    made = approach(replace(solid.domain, points=found.points), goal)
    return replace(solid, points=made.points, invalid=made.invalid)


def _excess(errors: Errors, aims: Aims) -> float:
    """What facets are off beyond the tolerance, in all."""
    return float(np.maximum(errors.worst / aims.tolerance - 1.0, 0.0).sum())


def poor(solid: Solid) -> Mask:
    """(n,) functions that act on badly shaped elements."""
    bad, first = least_of_elements(solid.domain) < _POOR, 0
    mask = np.zeros(solid.space.space.n, dtype=bool)
    for block in solid.space.space.blocks:
        mask[block.dofs[bad[first : first + block.elements]]] = True
        first += block.elements
    return mask


def sizes_of(solid: Solid) -> Array:
    """(n,) edge length of the smallest element that each function acts on."""
    size = np.full(solid.space.space.n, np.inf)
    for block, shapes in zip(solid.space.space.blocks, own_shapes(solid.domain)):
        own = np.cbrt(np.abs(np.linalg.det(shapes)))
        np.minimum.at(size, block.dofs, own[:, None])
    return size


def _marked(solid: Solid, errors: Errors, aims: Aims) -> Index:
    """Cells to split, the worst first."""
    worst = np.zeros(solid.space.tmesh.cells)
    np.maximum.at(worst, solid.skin.cell, errors.worst / aims.tolerance)
    # Limbs first: most of what is off by little elsewhere will be right once they are drawn out.
    worst[worst <= max(1.0, _SHARE * worst.max())] = 0.0
    worst[solid.uncertified] += 1.0
    cells = np.flatnonzero(worst)
    return cells[np.argsort(-worst[cells], kind="stable")]


def _finer(solid: Solid, marks: Index, aims: Aims) -> Solid | None:
    """The same solid with the worst cells split: not many times as many cells at once, where that is possible."""
    # Blocks of one cell are split all or none, because cells on the two sides of a block's side have one size.
    some = _refined(solid, marks, int(min(aims.max_cells, _GROWTH * solid.space.tmesh.cells)))
    return some if some is not None else _refined(solid, marks, aims.max_cells)


def _refined(solid: Solid, marks: Index, most: int) -> Solid | None:
    """The same solid with marked cells split, as many as ``most`` cells allow; None if that allows none."""
    while len(marks):
        # A cell split without its neighbours adds no function.
        tmesh = refined(solid.space.tmesh, marks, reach=1)
        if tmesh.cells <= most:
            space = hierarchy(tmesh, solid.space.degree)
            return Solid(space, skin_of(space), prolongation(solid.space, space) @ solid.points, solid.invalid[:0])
        marks = marks[: (2 * len(marks)) // 3]
    return None


def _slid(
    solid: Solid, surface: Surface, factor: float, aims: Aims, shown: Progress, aim: Array | None = None,
    free: Mask | None = None,
) -> Solid:
    """Smooth with the boundary sliding along the surface, and led by the map to ``aim`` if that is given.

    Springs pull samples of the boundary to the surface, and samples of the surface pull the boundary where it is
    closest to them, which draws limbs out and keeps their tips in place. Springs are as stiff as ``factor`` times the
    tolerance asks: soft ones carry the boundary far, stiff ones bring it near.
    """
    hold = factor * aims.tolerance
    there, normals = surface_samples(surface, _SPRINGS)
    A = values_at(solid.skin, _OUTER)

    def springs(points: Array) -> Tether:
        near, _, triangle = closest(surface.points, surface.triangles, A @ points)
        facet, u, missed = feet(solid.skin, points, there)
        B = values_on(solid.skin, facet, u)
        each = np.bincount(facet, minlength=len(solid.skin.cell))[facet]
        weights = np.concatenate([np.full(len(near), 1.0 / len(_OUTER)), 1.0 / each]) / (_HOLD * hold) ** 2
        # What is missed by far, the tip of a limb, pulls towards itself.
        far, way = missed > hold, there - B @ points
        own = normals.copy()
        own[far] = way[far] / np.linalg.norm(way[far], axis=1, keepdims=True)
        rows, places, across = [A, B], [near, there], [unit_normals(surface)[triangle], own]
        if aim is not None:
            rows, places, across = [*rows, A], [*places, aim], [*across, np.zeros_like(aim)]
            led = _LED / _ALONG / len(_OUTER) / (_HOLD * hold) ** 2
            weights = np.concatenate([weights, np.full(len(aim), led)])
        return Tether(csr_array(vstack(rows)), np.concatenate(places), np.concatenate(across), weights, _ALONG)

    free = np.ones(solid.space.space.n, dtype=bool) if free is None else free
    found = smooth(
        solid.domain, free, rounds=_TURNS, iterations=_SLIDE, power=_POWER, tether=springs, repairs=1, shown=shown
    )
    return replace(solid, points=found.points, invalid=found.invalid)


def _snapped(solid: Solid, surface: Surface, aim: Array, aims: Aims) -> Solid:
    """Fit the boundary to the closest points of the surface, and to points of it (k, 3) that it misses."""
    A = values_at(solid.skin, _OUTER)
    near, _, triangle = closest(surface.points, surface.triangles, A @ solid.points)
    there = np.concatenate([aim, surface_samples(surface, _SPACING)[0]])
    facet, u, gap = feet(solid.skin, solid.points, there)
    far = gap > 0.3 * aims.tolerance
    there, B = there[far], csr_array((0, solid.space.space.n))
    if len(there):
        B = values_on(solid.skin, facet[far], u[far])
    way = there - B @ solid.points
    normals = np.concatenate([unit_normals(surface)[triangle], way / np.linalg.norm(way, axis=1, keepdims=True)])
    weights = np.full(len(near) + int(far.sum()), 1.0 / len(_OUTER))
    goal = fit_boundary(
        solid.skin, solid.points, csr_array(vstack([A, B])), np.concatenate([near, there]), normals, along=0.05,
        fairness=1e-4, weights=weights,
    )
    made = approach(solid.domain, goal)
    return replace(solid, points=made.points, invalid=made.invalid)
