r"""From the map of the meccano's boundary to a certified solid, coarse to fine.

On a coarse T-mesh the boundary comes first: the fit of the map is slid along the surface (`sliding`), the solid inside
it is unfolded (`unfolding`), and what is then near the surface all over only needs its last steps. Where the coarse
boundary is far off, or what is inside stays folded, the solid starts valid instead: as a smooth blob whose boundary is
fitted with much fairness and whose inside is harmonic in the straight picture of the meccano, or, where that cannot be
untangled, as that picture itself. Springs of growing stiffness draw the boundary to ever better fits of the map, as far
as the solid stays valid, and as long as that brings it nearer: what is far off when sliding begins is apt to become a
web or a sac.

From then on boundary points slide along the surface while the shapes of all elements are smoothed, held by springs
between samples of the boundary and the points of the surface closest to them, and between samples of the surface and
the points of the boundary closest to those, as far as they face the same way (`springs`). They begin soft, so that
boundaries that the map left far off, or twisted, come along without a fold. Cells whose facets are farther from the
surface than the tolerance are split with their neighbours, the solid is carried to the finer space as it is, and slides
again around them. Fine tolerances are reached through coarser ones.

Webs between limbs stay where elements below them are nearly folded: a descent that may fold elements on its way accepts
that, and then what is around cannot move without a fold. So while something is far off no element may fold, and slides
are patient on the first mesh and where they are repeated: more and shorter turns, elements below moving too, and sample
points closer to each other, since an element that folds between them holds back all around it.

A step that would leave an element without certificate is shortened around it, so what starts valid ends valid.

Axis letters: n function, f facet, q sample point, v vertex of the surface, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from geometry.layouts.blocks import place
from geometry.meccano.collocation import prolongation
from geometry.meccano.errors import Errors, errors_of, feet, surface_samples, unit_normals
from geometry.meccano.fitting import fit_boundary, greville_points, harmonic, laid
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.moving import approached, smoothed, untangled
from geometry.meccano.skin import Skin, side_coordinates, skin_of, values_at, values_on
from geometry.meccano.sliding import on_sheet, slid
from geometry.meccano.solid import Solid, acting, held, moved, poor, sizes_of
from geometry.meccano.springs import SAMPLES, springs_to
from geometry.meccano.tmesh import DEPTH, refined
from geometry.meccano.unfolding import unfolded
from geometry.simplices.closest import closest
from geometry.simplices.surface import Surface
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Target = Callable[[Index, Array], Array]

_SPACING = 0.01
"""Of the samples of the surface at which errors are measured, in diagonals."""


@dataclass(frozen=True)
class Aims:
    """What a solid should be.

    Attributes
    ----------
    tolerance : distance from the surface, both ways.
    max_cells : most cells of the T-mesh.
    rounds : most rounds of refinement for each of the tolerances gone through.
    slides : rounds of smoothing of poor shapes at the end.
    """

    tolerance: float
    max_cells: int
    rounds: int = 8
    slides: int = 1


@dataclass(frozen=True, eq=False)
class _Task:
    """What all steps need: the surface, where the map puts points of the boundary, samples (k, 3) of the surface."""

    surface: Surface
    target: Target
    aims: Aims
    there: Array
    shown: Progress


@dataclass(frozen=True, eq=False)
class _State:
    """A solid, where the map puts samples of its facets (f q, 3), and how far it is off."""

    solid: Solid
    aim: Array
    errors: Errors

    def excess(self, aims: Aims) -> float:
        """What facets are off beyond the tolerance, in all."""
        return float(np.maximum(self.errors.worst / aims.tolerance - 1.0, 0.0).sum())


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
    The solid, and numbers of each round for a report; the last says why growth ended.
    """
    history: list[dict[str, Any]] = []
    began = perf_counter()
    task = _Task(surface, target, aims, surface_samples(surface, _SPACING)[0], shown)

    def note(stage: str, state: _State) -> None:
        errors = state.errors
        history.append({
            "stage": stage, "cells": state.solid.space.tmesh.cells, "invalid": len(state.solid.invalid),
            "away": float(errors.away.max()), "missed": float(errors.missed.max()),
            "facets_off": int((errors.worst > aims.tolerance).sum()), "seconds": perf_counter() - began,
        })
        shown.say(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                            for key, value in history[-1].items()))

    task, state, stage = _started(task, start)
    note(stage, state)
    for tolerance in nested(aims.tolerance, surface.diagonal):
        state, ended = _grown(replace(task, aims=replace(aims, tolerance=tolerance)), state, start, note)
        if ended:
            break
    state = _finished(task, state)
    note("fitting", state)
    history[-1]["ended"] = ended if state.excess(aims) else "within the tolerance"
    return state.solid, history


def _started(task: _Task, start: Hierarchy) -> tuple[_Task, _State, str]:
    """The first solid, what its boundary aims for from then on, and how it was made."""
    skin, surface = skin_of(start), task.surface
    aim = task.target(*side_coordinates(skin, SAMPLES))
    picture = place(start.tmesh.blocks, *greville_points(start))
    around = laid(picture, values_at(skin, SAMPLES), aim)
    sheet = slid(skin, around, surface, aim, task.aims.tolerance)
    if _errors(task, skin, sheet, aim).worst.max() <= _NEAR * surface.diagonal:
        own = replace(task, target=on_sheet(skin, sheet, surface))
        solid = unfolded(skin, sheet, task.shown)
        if not len(solid.invalid):
            return own, _measured(own, solid), "unfolding"
    return task, _begun(task, _first(skin, picture, around, aim, task.shown), aim), "drawing"


def _begun(task: _Task, solid: Solid, aim: Array) -> _State:
    """The first solid, drawn towards the map as far as that comes before long."""
    for fairness in _FAIRNESS:
        solid = _drawn(solid, aim, fairness, task)
    state = _measured(task, solid, aim)
    # Polycubes of many blocks start far from their solids: what is still off then would become webs and sacs.
    for _ in range(_DRAWS):
        tried = _measured(task, _drawn(state.solid, aim, _FAIRNESS[-1], task), aim)
        if tried.excess(task.aims) >= _COMING * state.excess(task.aims):
            break
        state = tried
    return state


def nested(tolerance: float, diagonal: float) -> list[float]:
    """Tolerances to go through: a fine one by halves from `_COARSE` diagonals, so that springs are soft at first."""
    halves = max(int(np.floor(np.log2(_COARSE * diagonal / tolerance) + 1e-9)), 0)
    return [tolerance * 2.0**k for k in range(halves, -1, -1)]


def _grown(task: _Task, state: _State, start: Hierarchy, note: Callable[[str, _State], None]) -> tuple[_State, str]:
    """A solid slid and refined until it is within the tolerance, or what stops it."""
    for step in count():
        state = _settled(task, state, state.solid.space is start)
        note("sliding", state)
        marks = _marked(state.solid, state.errors, task.aims)
        if not len(marks):
            break
        if step == task.aims.rounds:
            return state, "rounds spent"
        finer = _finer(state.solid, marks, task.aims)
        if finer is None:
            return state, "cells spent"
        state = _measured(task, finer)
    return state, ""


def _measured(task: _Task, solid: Solid, aim: Array | None = None) -> _State:
    aim = task.target(*side_coordinates(solid.skin, SAMPLES)) if aim is None else aim
    return _State(solid, aim, _errors(task, solid.skin, solid.points, aim))


def _errors(task: _Task, skin: Skin, points: Array, aim: Array) -> Errors:
    return errors_of(skin, points, aim, task.there, task.surface, _LIMB * task.aims.tolerance)


def _settled(task: _Task, state: _State, whole: bool) -> _State:
    """A solid that has slid on its mesh, as a whole or around what is off, until limbs come no farther."""
    # What the coarse mesh leaves far off stays off: there patience costs little.
    free = np.ones(state.solid.space.n, dtype=bool) if whole else None
    for softness in _GRADES if whole else _FINE:
        # Soft springs only where there is some way to go.
        if softness * task.aims.tolerance <= state.errors.worst.max():
            state = _slid(task, state, softness, free, whole)
    state = _slid_on(task, _slid(task, state, 1.0, free, whole), _LIMB)
    if len(state.solid.invalid):
        state = _measured(task, _untangled(state.solid, True, task.shown), state.aim)
    return state


def _finished(task: _Task, state: _State) -> _State:
    """A solid on its last mesh: nearer to the surface by stiffer springs and by fitting, and poor shapes smoothed."""
    aims = task.aims
    for softness in _LAST:
        state = _slid_on(task, state, 0.0, softness)
    # Springs leave the solid to one side of the surface, within the tolerance; a fit does not, so its volume is right.
    snapped = _measured(task, _snapped(state.solid, task.surface, state.aim, aims), state.aim)
    if snapped.excess(aims) <= state.excess(aims):
        state = snapped
    for _ in range(aims.slides):
        bad = poor(state.solid)
        if bad.any():
            better = _slid(task, state, _LAST[-1], bad)
            # Shapes may not cost nearness.
            if better.excess(aims) <= state.excess(aims):
                state = better
    return state


def _slid_on(task: _Task, state: _State, limit: float, softness: float = 1.0) -> _State:
    """Slide while that lowers what is off, and something is by more than ``limit`` tolerances."""
    while state.excess(task.aims) and state.errors.worst.max() > limit * task.aims.tolerance:
        tried = _slid(task, state, softness, patient=True)
        before, now = state.excess(task.aims), tried.excess(task.aims)
        if now < before:
            state = tried
        if now > _PROGRESS * before:
            break
    return state


def _slid(task: _Task, state: _State, softness: float, free: Mask | None = None, patient: bool = False) -> _State:
    """Smooth while free functions slide along the surface, by default those around what is off.

    Where something is far from the surface, elements may not fold on the way, and a patient slide takes more turns and
    moves elements under what is off too, which must make way for it.
    """
    solid, tolerance = state.solid, task.aims.tolerance
    far = bool(state.errors.worst.max() > _LIMB * tolerance)
    turns, steps = _PATIENT if patient and far else _QUICK
    if free is None:
        off = np.zeros(solid.space.tmesh.cells, dtype=bool)
        off[solid.skin.cell[state.errors.worst > tolerance]] = True
        free = acting(solid, off)
        if patient and far:
            free = acting(solid, moved(solid, free))
    springs = springs_to(task.surface, solid.skin, tolerance, softness, state.aim, free, softness > _LEADING)
    slid = smoothed(
        solid, free, steps, turns, _SAMPLES[far], _POWER, springs, repairs=1, folds=not far, shown=task.shown
    )
    return _measured(task, slid, state.aim)


# First solid: farthest that a sheet is off, in diagonals, for it to be filled; coarse sheets lack whole limbs.
_NEAR = 0.03
# Else: rounds of untangling, fairness of the fits that the boundary is drawn to, stiffness of the springs there.
_TRIES = 8
_FAIRNESS = (1.0, 0.1, 0.01, 1e-3)
_STIFF = (1.0, 10.0, 100.0)
# More fits with the last fairness, at most, while each leaves only this share of what is off.
_DRAWS = 16
_COMING = 0.93
# Tolerance, in diagonals, from which finer ones are halved.
_COARSE = 0.004
# Softness of springs on the first mesh and on finer ones, before it is 1, on the last one, and down to which the map
# leads.
_GRADES = (8.0, 8.0, 8.0, 4.0, 4.0, 2.0)
_FINE = (2.0,)
_LAST = (1.0, 0.5)
_LEADING = 2.0
# Sliding goes on while it leaves this share of what is off, on meshes that can be refined while something is off by so
# many tolerances.
_PROGRESS = 0.8
_LIMB = 3.0
# Of a slide: rounds and steps of descent, also where it is patient; sample points along the edge of an element, also
# where something is far off, since what folds between samples is held back; power of the mean ratio.
_QUICK = (2, 30)
_PATIENT = (6, 40)
_SAMPLES = (3, 4)
_POWER = 4.0
# Refinement: facets off by this share of the worst at least, most cells for each cell.
_SHARE = 0.2
_GROWTH = 2.2


def _first(skin: Skin, picture: Array, around: Array, aim: Array, shown: Progress) -> Solid:
    """A smooth, valid solid near the surface: its sides are nearly bilinear.

    Where the inside of that cannot be untangled, the start is the picture of the meccano itself, laid onto the surface.

    Parameters
    ----------
    picture, around : (n, 3) the meccano itself, and laid onto the surface.
    """
    blob = fit_boundary(skin, picture, SAMPLES, aim, fairness=100.0)
    for points in (harmonic(skin.space, blob, skin.functions), around):
        solid = _untangled(Solid(skin.space, skin, points, np.empty(0, dtype=np.int64)), False, shown)
        if not len(solid.invalid):
            break
    return solid


def _untangled(solid: Solid, boundary: bool, shown: Progress) -> Solid:
    """Untangle by inner control points, or by all."""
    return untangled(solid, solid.inner | boundary, _TRIES, 2, shown)


def _drawn(solid: Solid, aim: Array, fairness: float, task: _Task) -> Solid:
    """Draw the boundary towards its fit to ``aim`` with ever stiffer springs, as far as the solid stays valid."""
    skin = solid.skin
    wanted = fit_boundary(skin, solid.points, SAMPLES, aim, fairness=fairness)[skin.functions]
    size = sizes_of(solid)[skin.functions]
    springs = [held(skin, wanted, w / size**2) for w in _STIFF]
    found = smoothed(solid, np.ones(solid.space.n, dtype=bool), 30, tether=springs, shown=task.shown)
    goal = found.points.copy()
    goal[skin.functions] = wanted
    return approached(found, goal)


def _marked(solid: Solid, errors: Errors, aims: Aims) -> Index:
    """Cells to split, the worst first."""
    worst = np.zeros(solid.space.tmesh.cells)
    np.maximum.at(worst, solid.skin.cell, errors.worst / aims.tolerance)
    # Limbs first: most of what is off by little elsewhere will be right once they are drawn out.
    worst[worst <= max(1.0, _SHARE * worst.max())] = 0.0
    worst[solid.invalid] += 1.0
    cells = np.flatnonzero(worst)
    return cells[np.argsort(-worst[cells], kind="stable")]


def _finer(solid: Solid, marks: Index, aims: Aims) -> Solid | None:
    """The same solid with the worst cells split: not many times as many cells at once, where that is possible."""
    # Blocks of one cell are split all or none, because cells on the two sides of a block's side have one size.
    some = _refined(solid, marks, int(min(aims.max_cells, _GROWTH * solid.space.tmesh.cells)))
    return some if some is not None else _refined(solid, marks, aims.max_cells)


def _refined(solid: Solid, marks: Index, most: int) -> Solid | None:
    """The same solid with marked cells split, as many as ``most`` cells allow; None if that allows none."""
    marks = marks[solid.space.tmesh.level[marks] < DEPTH]
    while len(marks):
        # A cell split without its neighbours adds no function.
        tmesh = refined(solid.space.tmesh, marks, reach=1)
        if tmesh.cells <= most:
            space = hierarchy(tmesh, solid.space.degree)
            return Solid(space, skin_of(space), prolongation(solid.space, space) @ solid.points, solid.invalid[:0])
        marks = marks[: (2 * len(marks)) // 3]
    return None


def _snapped(solid: Solid, surface: Surface, aim: Array, aims: Aims) -> Solid:
    """Fit the boundary to the closest points of the surface, and to points of it (k, 3) that it misses."""
    A = values_at(solid.skin, SAMPLES)
    near, _, triangle = closest(surface.points, surface.triangles, A @ solid.points)
    there = np.concatenate([aim, surface_samples(surface, _SPACING)[0]])
    facet, u, gap, _ = feet(solid.skin, solid.points, there)
    far = gap > 0.3 * aims.tolerance
    there, B = there[far], csr_array((0, solid.space.n))
    if len(there):
        B = values_on(solid.skin, facet[far], u[far])
    way = there - B @ solid.points
    normals = np.concatenate([unit_normals(surface)[triangle], way / np.linalg.norm(way, axis=1, keepdims=True)])
    weights = np.full(len(near) + int(far.sum()), 1.0 / len(SAMPLES))
    goal = fit_boundary(
        solid.skin, solid.points, csr_array(vstack([A, B])), np.concatenate([near, there]), normals, along=0.05,
        fairness=1e-4, weights=weights,
    )
    return approached(solid, goal)
