"""First solids: valid ones, from which growth goes on, near the surface if that can be.

The boundary comes first. The fit of the map on the coarse mesh is slid along the surface (`sliding`), and again on
finer meshes, split where it is off, until it is near all over. The solid inside is unfolded (`unfolding`), and then
slides along the surface as a whole, by stiffer and stiffer springs and without a fold on the way: shapes come first,
what they cost in nearness comes back. Where the finest sheet's inside stays folded, the coarsest is tried.

Where every sheet is far off, or what is inside stays folded, the solid starts valid instead: as a smooth blob whose
boundary is fitted with much fairness and whose inside is harmonic in the straight picture of the meccano, or, where
that cannot be untangled, as that picture itself. Springs of growing stiffness draw the boundary to ever better fits of
the map, as far as the solid stays valid, and as long as that brings it nearer: what is far off when sliding begins is
apt to become a web or a sac.

Axis letters: n function, f facet, q sample point, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import place
from geometry.meccano.fitting import fit_boundary, greville_points, harmonic, laid
from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.moving import approached, smoothed, untangled
from geometry.meccano.skin import Skin, side_coordinates, skin_of, values_at
from geometry.meccano.sliding import fitted, on_sheet, slid
from geometry.meccano.solid import Solid, held, sizes_of, split
from geometry.meccano.springs import SAMPLES, springs_to
from geometry.meccano.state import State, Task, measured
from geometry.meccano.unfolding import unfolded
from iga.progress import Progress

Array = NDArray[np.float64]

# Farthest that a sheet, or the solid inside it, may be off, in diagonals: one that lacks whole limbs is of no use.
_NEAR = 0.03
# Slides of the whole solid: softness of the springs, rounds and steps of descent, sample points along the edge of an
# element, power of the mean ratio.
_STIFFER = (1.0, 0.5, 0.25)
_SLIDE = (2, 30)
_SAMPLES = 4
_POWER = 4.0
# Else: rounds of untangling, and without progress; fairness of the fits that the boundary is drawn to, stiffness of the
# springs there, and steps of descent.
_TRIES, _PATIENCE = 8, 2
_FAIRNESS = (1.0, 0.1, 0.01, 1e-3)
_STIFF = (1.0, 10.0, 100.0)
_STEPS = 30
# More fits with the last fairness, at most, while each leaves only this share of what is off.
_DRAWS = 16
_COMING = 0.93
# Fairness of the blob.
_FAIREST = 100.0


def started(task: Task, start: Hierarchy, meshes: int) -> tuple[Task, State, str]:
    """The first solid, on the coarse mesh or a finer one.

    Parameters
    ----------
    meshes : most meshes on which a sheet slides.

    Returns
    -------
    The task with what the boundary aims for from then on, the solid's state, and how it was made: "unfolding" or
    "drawing".
    """
    skin = skin_of(start)
    aim = task.target(*side_coordinates(skin, SAMPLES))
    picture = place(start.tmesh.blocks, *greville_points(start))
    around = laid(picture, values_at(skin, SAMPLES), aim)
    near = sheets(task, skin, fitted(skin, around, aim), meshes)
    # The last is nearest, the first is unfolded with the least trouble.
    for sheet in (near[-1:] + near[:1])[: len(near)]:
        solid = unfolded(sheet.skin, sheet.points, task.shown)
        own = replace(task, target=on_sheet(sheet.skin, sheet.points, task.surface))
        state = measured(own, solid)
        # Springs that yield may let go of a limb.
        if not len(solid.invalid) and state.errors.worst.max() <= _NEAR * task.surface.diagonal:
            return own, _stiffened(own, state), "unfolding"
    return task, _drawn_near(task, _first(skin, picture, around, aim, task.shown), aim), "drawing"


def sheets(task: Task, skin: Skin, points: Array, meshes: int) -> list[Solid]:
    """Sheets slid along the surface, on finer and finer meshes until one is within the tolerance or cells are spent.

    Parameters
    ----------
    points : (n, 3) control points of the first sheet.
    meshes : most meshes.

    Returns
    -------
    Solids of which only the boundary counts; without those that are too far off to be filled.
    """
    near: list[Solid] = []
    sheet: Solid | None = Solid(skin.space, skin, points, np.empty(0, dtype=np.int64))
    for _ in range(meshes):
        if sheet is None:
            break
        aim = task.target(*side_coordinates(sheet.skin, SAMPLES))
        sheet = replace(sheet, points=slid(sheet.skin, sheet.points, task.surface, aim, task.aims.tolerance))
        worst = measured(task, sheet, aim).errors.worst
        task.shown.say(f"sheet: {sheet.space.tmesh.cells} cells, {worst.max():.4g} off")
        if worst.max() <= _NEAR * task.surface.diagonal:
            near.append(sheet)
        off = np.flatnonzero(worst > task.aims.tolerance)
        sheet = split(sheet, sheet.skin.cell[off[np.argsort(-worst[off], kind="stable")]], task.aims.max_cells)
    return near


def _stiffened(task: Task, state: State) -> State:
    """A solid near the surface, slid as a whole by stiffer and stiffer springs until it is within the tolerance."""
    free = np.ones(state.solid.space.n, dtype=bool)
    turns, steps = _SLIDE
    for softness in _STIFFER:
        springs = springs_to(task.surface, state.solid.skin, task.aims.tolerance, softness, state.aim)
        solid = smoothed(
            state.solid, free, steps, turns, _SAMPLES, _POWER, springs, repairs=1, folds=False, shown=task.shown
        )
        state = measured(task, solid, state.aim)
        if not state.excess(task.aims):
            break
    return state


def _drawn_near(task: Task, solid: Solid, aim: Array) -> State:
    """The first solid, drawn towards the map as far as that comes before long."""
    for fairness in _FAIRNESS:
        solid = _drawn(solid, aim, fairness, task)
    state = measured(task, solid, aim)
    # Polycubes of many blocks start far from their solids: what is still off then would become webs and sacs.
    for _ in range(_DRAWS):
        tried = measured(task, _drawn(state.solid, aim, _FAIRNESS[-1], task), aim)
        if tried.excess(task.aims) >= _COMING * state.excess(task.aims):
            break
        state = tried
    return state


def _first(skin: Skin, picture: Array, around: Array, aim: Array, shown: Progress) -> Solid:
    """A smooth, valid solid near the surface: its sides are nearly bilinear.

    Where the inside of that cannot be untangled, the start is the picture of the meccano itself, laid onto the surface.

    Parameters
    ----------
    picture, around : (n, 3) the meccano itself, and laid onto the surface.
    """
    blob = fit_boundary(skin, picture, SAMPLES, aim, fairness=_FAIREST)
    for points in (harmonic(skin.space, blob, skin.functions), around):
        solid = Solid(skin.space, skin, points, np.empty(0, dtype=np.int64))
        solid = untangled(solid, solid.inner, _TRIES, _PATIENCE, shown)
        if not len(solid.invalid):
            break
    return solid


def _drawn(solid: Solid, aim: Array, fairness: float, task: Task) -> Solid:
    """Draw the boundary towards its fit to ``aim`` with ever stiffer springs, as far as the solid stays valid."""
    skin = solid.skin
    wanted = fit_boundary(skin, solid.points, SAMPLES, aim, fairness=fairness)[skin.functions]
    size = sizes_of(solid)[skin.functions]
    springs = [held(skin, wanted, w / size**2) for w in _STIFF]
    found = smoothed(solid, np.ones(solid.space.n, dtype=bool), _STEPS, tether=springs, shown=task.shown)
    goal = found.points.copy()
    goal[skin.functions] = wanted
    return approached(found, goal)
