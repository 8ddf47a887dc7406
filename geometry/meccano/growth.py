r"""From the map of the meccano's boundary to a certified solid, coarse to fine.

A first solid is valid, and near the surface where that could be (`starting`).

From then on boundary points slide along the surface while the shapes of all elements are smoothed, held by springs
between samples of the boundary and the points of the surface closest to them, and between samples of the surface and
the points of the boundary closest to those, as far as they face the same way (`springs`). They begin soft, so that
boundaries that the map left far off, or twisted, come along without a fold. Cells whose facets are farther from the
surface than the tolerance are split with their neighbours, the solid is carried to the finer space as it is, and slides
again around them. What splitting has not brought nearer is a sac that its small elements do not move by themselves: it
slides together with much that is around it. What is nearly within the tolerance is drawn nearer by stiffer springs
before anything is split. Fine tolerances are reached through coarser ones. At the end the boundary is fitted, and a
solid with many poor shapes slides as a whole while they become fewer.

Webs between limbs stay where elements below them are nearly folded: a descent that may fold elements on its way accepts
that, and then what is around cannot move without a fold. So while something is far off no element may fold, and slides
are patient on the first mesh and where they are repeated: more and shorter turns, elements below moving too, and sample
points closer to each other, since an element that folds between them holds back all around it.

A step that would leave an element without certificate is shortened around it, so what starts valid ends valid.

Axis letters: n function, f facet, q sample point, v vertex of the surface, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from geometry.meccano.errors import Errors, feet, surface_samples, unit_normals
from geometry.meccano.fitting import fit_boundary
from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.moving import approached, smoothed, untangled
from geometry.meccano.skin import values_at, values_on
from geometry.meccano.solid import Solid, acting, moved, poor, split
from geometry.meccano.springs import SAMPLES, springs_to
from geometry.meccano.starting import started
from geometry.meccano.state import LIMB, Aims, State, Target, Task, measured
from geometry.simplices.closest import closest
from geometry.simplices.surface import Surface
from iga.progress import QUIET, Progress
from iga.scaled_jacobian import least_of_elements

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

WITHIN, CELLS, ROUNDS = "within the tolerance", "cells spent", "rounds spent"
"""How growth ends."""

_SPACING = 0.01
"""Of the samples of the surface at which errors are measured, in diagonals."""


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
    tolerances = nested(aims.tolerance, surface.diagonal)
    task = Task(surface, target, replace(aims, tolerance=tolerances[0]), surface_samples(surface, _SPACING)[0], shown)

    def note(stage: str, state: State) -> None:
        errors = state.errors
        history.append({
            "stage": stage, "cells": state.solid.space.tmesh.cells, "invalid": len(state.solid.invalid),
            "away": float(errors.away.max()), "missed": float(errors.missed.max()),
            "facets_off": int((errors.worst > aims.tolerance).sum()), "seconds": perf_counter() - began,
        })
        shown.say(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                            for key, value in history[-1].items()))

    # Solids in the finest sheets have elements too poor to be drawn much nearer afterwards.
    task, state, stage = started(task, start, _SHEETS if len(tolerances) == 1 else 1)
    note(stage, state)
    for tolerance in tolerances:
        task = replace(task, aims=replace(aims, tolerance=tolerance))
        state, ended = _grown(task, state, start, note)
        if ended:
            break
    task = replace(task, aims=aims)
    state = _finished(task, state)
    note("fitting", state)
    history[-1]["ended"] = ended if state.excess(aims) else WITHIN
    return state.solid, history


def nested(tolerance: float, diagonal: float) -> list[float]:
    """Tolerances to go through: a fine one by halves from `_COARSE` diagonals, so that springs are soft at first."""
    halves = max(int(np.floor(np.log2(_COARSE * diagonal / tolerance) + 1e-9)), 0)
    return [tolerance * 2.0**k for k in range(halves, -1, -1)]


def _grown(task: Task, state: State, start: Hierarchy, note: Callable[[str, State], None]) -> tuple[State, str]:
    """A solid slid and refined until it is within the tolerance, or what stops it."""
    last = np.inf
    for step in count():
        if state.excess(task.aims):
            state = _settled(task, state, state.solid.space is start)
            note("sliding", state)
            if state.excess(task.aims) and state.errors.worst.max() > _STUCK * last:
                state = _drawn_in(task, state)
                note("drawing in", state)
            last = float(state.errors.worst.max())
        marks = _marked(state.solid, state.errors, task.aims)
        if not len(marks):
            break
        if step == task.aims.rounds:
            return state, ROUNDS
        finer = _finer(state.solid, marks, task.aims)
        if finer is None:
            return state, CELLS
        state = measured(task, finer)
    return state, ""


def _settled(task: Task, state: State, whole: bool) -> State:
    """A solid that has slid on its mesh, as a whole or around what is off, until limbs come no farther."""
    # What the coarse mesh leaves far off stays off: there patience costs little.
    free = np.ones(state.solid.space.n, dtype=bool) if whole else None
    for softness in _GRADES if whole else _FINE:
        # Soft springs only where there is some way to go.
        if softness * task.aims.tolerance <= state.errors.worst.max():
            state = _slid(task, state, softness, free, whole)
    slid = _slid(task, state, 1.0, free, whole)
    near = _NEARLY * task.aims.tolerance
    # A fine start may be nearer than slides keep it: then finer cells are of more use.
    if state.errors.worst.max() > near or slid.excess(task.aims) < state.excess(task.aims):
        state = slid
    state = _slid_on(task, state, LIMB)
    if state.errors.worst.max() <= near:
        state = _stiffer(task, state)
    if len(state.solid.invalid):
        everything = np.ones(state.solid.space.n, dtype=bool)
        state = measured(task, untangled(state.solid, everything, _TRIES, _FRUITLESS, task.shown), state.aim)
    return state


def _finished(task: Task, state: State) -> State:
    """A solid on its last mesh: nearer to the surface by stiffer springs and by fitting, and poor shapes smoothed."""
    aims = task.aims
    state = _stiffer(task, state)
    # Springs leave the solid to one side of the surface, within the tolerance; a fit does not, so its volume is right.
    snapped = measured(task, _snapped(state.solid, task.surface, state.aim, aims), state.aim)
    if snapped.excess(aims) <= state.excess(aims):
        state = snapped
    if aims.slides:
        state = _evened(task, state)
    for _ in range(aims.slides):
        bad = poor(state.solid)
        if bad.any():
            better = _slid(task, state, _LAST[-1], bad)
            # Shapes may not cost nearness.
            if better.excess(aims) <= state.excess(aims):
                state = better
    return state


def _evened(task: Task, state: State) -> State:
    """A solid with many poor shapes, slid as a whole while they become fewer and nothing is farther off."""
    everything = np.ones(state.solid.space.n, dtype=bool)
    shapes = least_of_elements(state.solid.domain)
    while _lack(shapes) > _UNEVEN:
        tried = _slid(task, state, _LAST[-1], everything)
        before, shapes = shapes, least_of_elements(tried.solid.domain)
        worse = shapes.min() < min(_LEAST, before.min()) or tried.excess(task.aims) > state.excess(task.aims)
        if worse or _lack(shapes) > _lack(before):
            break
        state = tried
        if _lack(shapes) > _PROGRESS * _lack(before):
            break
    return state


def _lack(shapes: Array) -> float:
    """What scaled Jacobians (e,) lack to a half, in the mean."""
    return float(np.maximum(0.5 - shapes, 0.0).mean())


def _stiffer(task: Task, state: State) -> State:
    """A solid that is nearly within the tolerance, drawn nearer by stiffer springs."""
    for softness in _LAST:
        state = _slid_on(task, state, 0.0, softness)
    return state


def _slid_on(task: Task, state: State, limit: float, softness: float = 1.0) -> State:
    """Slide while that lowers what is off, and something is by more than ``limit`` tolerances."""
    while state.excess(task.aims) and state.errors.worst.max() > limit * task.aims.tolerance:
        tried = _slid(task, state, softness, patient=True)
        before, now = state.excess(task.aims), tried.excess(task.aims)
        if now < before:
            state = tried
        if now > _PROGRESS * before:
            break
    return state


def _slid(task: Task, state: State, softness: float, free: Mask | None = None, patient: bool = False) -> State:
    """Smooth while free functions slide along the surface, by default those around what is off.

    Where something is far from the surface, elements may not fold on the way, and a patient slide takes more turns and
    moves elements under what is off too, which must make way for it.
    """
    patient = patient and state.far(task.aims)
    turns, steps = _PATIENT if patient else _QUICK
    if free is None:
        free = _off(state, task.aims.tolerance, int(patient))
    return _smoothed(task, state, softness, free, turns, steps)


def _drawn_in(task: Task, state: State) -> State:
    """What refinement has not brought nearer, slid together with much that is around it.

    Small elements do not move a sac by themselves: one by one they have their shapes, and the springs' forces reach no
    farther than those that are free. Splitting them would not help either.
    """
    tried = _smoothed(task, state, 1.0, _off(state, task.aims.tolerance, _AROUND), *_PERSISTENT)
    return tried if tried.excess(task.aims) < state.excess(task.aims) else state


def _off(state: State, tolerance: float, layers: int) -> Mask:
    """Functions (n,) that act on cells under what is off, and on so many layers of cells moved with these."""
    solid = state.solid
    off = np.zeros(solid.space.tmesh.cells, dtype=bool)
    off[solid.skin.cell[state.errors.worst > tolerance]] = True
    free = acting(solid, off)
    for _ in range(layers):
        free = acting(solid, moved(solid, free))
    return free


def _smoothed(task: Task, state: State, softness: float, free: Mask, turns: int, steps: int) -> State:
    """Smooth while free functions slide along the surface."""
    solid, far = state.solid, state.far(task.aims)
    springs = springs_to(task.surface, solid.skin, task.aims.tolerance, softness, state.aim, free, softness > _LEADING)
    slid = smoothed(
        solid, free, steps, turns, _SAMPLES[far], _POWER, springs, repairs=1, folds=not far, shown=task.shown
    )
    return measured(task, slid, state.aim)


# Most meshes on which the first sheet slides.
_SHEETS = 6
# Tolerance, in diagonals, from which finer ones are halved.
_COARSE = 0.004
# Rounds of untangling, and without progress, where a fold is left.
_TRIES, _FRUITLESS = 8, 2
# Softness of springs on the first mesh and on finer ones, before it is 1, on the last one, and down to which the map
# leads.
_GRADES = (8.0, 8.0, 8.0, 4.0, 4.0, 2.0)
_FINE = (2.0,)
_LAST = (1.0, 0.5)
_LEADING = 2.0
# Tolerances by which something is nearly within the tolerance.
_NEARLY = 2.0
# Lack of scaled Jacobians (`_lack`) from which on the whole solid is smoothed, and the least that may come of that.
_UNEVEN = 0.001
_LEAST = 0.2
# Sliding goes on while it leaves this share of what is off.
_PROGRESS = 0.8
# Of a slide: rounds and steps of descent, also where it is patient; sample points along the edge of an element, also
# where something is far off, since what folds between samples is held back; power of the mean ratio.
_QUICK = (2, 30)
_PATIENT = (6, 40)
_PERSISTENT = (6, 60)
_SAMPLES = (3, 4)
_POWER = 4.0
# What refinement leaves as far off as this share of what it was is stuck; it is drawn in with so many layers around.
_STUCK = 0.95
_AROUND = 3
# Refinement: facets off by this share of the worst at least, most cells for each cell.
_SHARE = 0.2
_GROWTH = 2.2


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
    some = split(solid, marks, int(min(aims.max_cells, _GROWTH * solid.space.tmesh.cells)))
    return some if some is not None else split(solid, marks, aims.max_cells)


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
