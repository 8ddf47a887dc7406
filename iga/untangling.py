r"""Valid and well-shaped elements by moving control points, with the certificate in the loop.

The regularised mean ratio is minimised over the control points that are free (`iga.shaping`). Rounds of descent
alternate with the certificate of the elements concerned. What is not certified is where the next round works: its
surroundings are free to move, and its worst points become sample points. Elsewhere nothing moves, and control points
that are not free keep their values bit by bit.

Axis letters: e element, n function, c component.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from iga.distortion import own_shapes
from iga.domain import Domain
from iga.errors import InputError
from iga.progress import QUIET, Progress
from iga.shaping import (
    Shaping,
    elements_of,
    grown,
    invalid_elements,
    mask_of,
    minimise,
    shaping,
    touching,
    with_samples,
    with_shapes,
)
from iga.tether import Tether

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_FAST = 0.7
"""Where a round leaves more than this share of the invalid elements, the next one frees one more ring around them."""
_REPAIR_STEPS, _REPAIR_DELTAS = 15, 3
"""Descent steps, and values of delta, when a round of smoothing untangles what it folded: much less than a round."""
_LEAST_SHARE = 0.2
"""Share of a step below which it is not halved again but given up."""
_STAYING = 0.6
"""Share of the elements not certified; a round of `unfold` that leaves more calls for softer springs."""
_FEW = 0.01
"""Share of all elements; fewer that `unfold` leaves are untangled alone: moving all again would fold others."""


@dataclass(frozen=True)
class Round:
    """One round: elements not certified after it, functions free in it, elements seen, smallest det S after it."""

    invalid: int
    free: int
    elements: int
    least: float


@dataclass(frozen=True, eq=False)
class Untangled:
    """Result of `untangle` and `smooth`.

    Attributes
    ----------
    points : (n, 3) control points.
    invalid : (k, 2) block and number of the elements that are not certified.
    moved : (m,) functions whose control points differ from the given ones.
    history : the rounds.
    """

    points: Array
    invalid: Index
    moved: Index
    history: tuple[Round, ...]


def untangle(
    domain: Domain,
    free: Mask,
    shapes: Sequence[Array] | None = None,
    rounds: int = 12,
    iterations: int = 60,
    samples: int = 3,
    power: float = 2.0,
    size: float = 0.0,
    patience: int = 4,
    depth: int = 6,
    tether: Tether | None = None,
    shown: Progress = QUIET,
) -> Untangled:
    """Move free control points until every element is certified, as far as that succeeds.

    Parameters
    ----------
    domain : a solid.
    free : (n,) which control points may move. With a constraint T, coefficients move that act on free points alone.
    shapes : Jacobian matrices (e, 3, 3) of the ideal elements of each block, by default `own_shapes`.
    rounds : most rounds; ``patience`` of them without progress end it.
    iterations : most descent steps for each value of delta.
    samples : sample points along each edge of an element.
    power : p of the mean ratio.
    size : factor of a measure of size. Where much is folded at the start, the mean ratio alone may find it cheaper to
        let elements shrink to nothing; the ideal elements should then have the right sizes too.
    depth : depth of the certificates.
    tether : springs, whose energy is added to that of the elements (about one each).

    Raises
    ------
    InputError : arrays do not fit the domain.
    """
    task = shaping(domain, free, shapes, samples, power, size, tether)
    points = domain.points.copy()
    invalid, worst = invalid_elements(task, points, np.arange(task.elements), depth)
    history = [Round(len(invalid), 0, task.elements, np.nan)]
    best, since, reach = len(invalid), 0, 1
    while len(invalid) and since < patience and len(history) <= rounds:
        task = with_samples(task, worst)
        open_ = touching(task, grown(task, mask_of(task, invalid), reach - 1))
        seen = np.flatnonzero(elements_of(task, open_))
        if not len(seen):
            break
        step, least = minimise(task, points, open_, seen, iterations)
        points = points + task.moves @ step
        left, worst = invalid_elements(task, points, seen, depth)
        kept = np.ones(task.elements, dtype=bool)
        kept[seen] = False
        invalid = np.concatenate([invalid[kept[invalid]], left])
        history.append(Round(len(invalid), int(open_.sum()), len(seen), least))
        shown.say(f"untangling: {len(invalid)} elements not certified ({len(seen)} moved)", passing=True)
        reach = reach if len(invalid) < _FAST * best else reach + 1
        since = 0 if len(invalid) < best else since + 1
        best = min(best, len(invalid))
    return _result(task, points, invalid, history)


def unfold(
    domain: Domain,
    free: Mask,
    tether: Tether,
    rounds: int = 12,
    iterations: int = 30,
    samples: int = 4,
    power: float = 2.0,
    size: float = 0.2,
    yielding: float = 0.5,
    depth: int = 6,
    shown: Progress = QUIET,
) -> Untangled:
    """Move all free control points at once until every element is certified; parameters as in `untangle`.

    For solids folded in many places, whose elements must make way for each other over long ways: `untangle` moves no
    more than what is around. Ideal elements have the elements' own edge lengths, anew in each round.

    Parameters
    ----------
    tether : springs. Where elements stay folded, what holds them is apt to be wrong, so springs there are softened.
    rounds : most rounds.
    yielding : factor by which springs soften around elements that are not certified, after rounds that left most so.

    Raises
    ------
    InputError : arrays do not fit the domain.
    """
    task = shaping(domain, free, None, samples, power, size, tether)
    points = domain.points.copy()
    invalid, worst = invalid_elements(task, points, np.arange(task.elements), depth)
    history = [Round(len(invalid), 0, task.elements, np.nan)]
    seen = np.flatnonzero(elements_of(task, task.open))
    while len(invalid) and len(history) <= rounds:
        task = shaping(replace(domain, points=points), free, None, samples, power, size, tether)
        task = with_samples(task, worst)
        step, least = minimise(task, points, task.open, seen, iterations, 3)
        points = points + task.moves @ step
        before, (invalid, worst) = len(invalid), invalid_elements(task, points, np.arange(task.elements), depth)
        if len(invalid) > _STAYING * before:
            tether = _softened(task, tether, invalid, yielding)
        history.append(Round(len(invalid), int(task.open.sum()), len(seen), least))
        shown.say(f"unfolding: {len(invalid)} elements not certified")
        if 0 < len(invalid) <= _FEW * task.elements:
            alone = untangle(
                replace(domain, points=points), free, rounds=8, iterations=iterations, samples=samples, power=power,
                size=size, patience=3, depth=depth, tether=tether, shown=shown,
            )
            if not len(alone.invalid):
                points, invalid, history = alone.points, invalid[:0], [*history, *alone.history[1:]]
    return _result(replace(task, domain=domain), points, invalid, history)


def _softened(task: Shaping, tether: Tether, invalid: Index, factor: float) -> Tether:
    """Springs whose weights are less by a factor around elements (k,)."""
    around = abs(task.moves) @ touching(task, mask_of(task, invalid)).astype(float)
    soft = abs(tether.A) @ around > 0.0
    return replace(tether, weights=np.where(soft, factor, 1.0) * tether.weights)


def smooth(
    domain: Domain,
    free: Mask,
    shapes: Sequence[Array] | None = None,
    rounds: int = 2,
    iterations: int = 40,
    samples: int = 3,
    power: float = 2.0,
    depth: int = 6,
    tether: Tether | Sequence[Tether] | Callable[[Array], Tether] | None = None,
    repairs: int = 2,
    folds: bool = True,
    shown: Progress = QUIET,
) -> Untangled:
    """Improve the shapes of all elements of a valid domain, which stays valid; parameters as in `untangle`.

    Each round descends with all free control points. Groups of elements whose samples stay above det S = 0.05 cannot
    fold there; the others are regularised, and may fold on the way (``folds``). Elements that are then not certified
    are untangled; around those that resist, control points go back towards where they were, in halves, until all are
    certified. Elements invalid at the start are left alone, with their surroundings.

    Parameters
    ----------
    shapes : by default `own_shapes` at the start of each round.
    tether : springs, or those of each round, which then set the number of rounds: with ever stiffer ones a valid solid
        is drawn to a place that it could not reach in one step. Or a function that gives the springs of a round for the
        control points at its start.
    repairs : most times that elements are untangled in a round.
    folds : whether elements may fold on the way. Where springs pull hard, regularised elements end nearly folded, and
        then hold back all around them.
    """
    tethers: list[Tether | Callable[[Array], Tether] | None]
    if tether is None or isinstance(tether, Tether) or callable(tether):
        tethers = [tether] * rounds
    else:
        tethers = list(tether)
    task = shaping(domain, free, shapes, samples, power)
    points = domain.points.copy()
    broken, _ = invalid_elements(task, points, np.arange(task.elements), depth)
    history = [Round(len(broken), 0, task.elements, np.nan)]
    open_ = task.open & ~touching(task, mask_of(task, broken))
    seen = np.flatnonzero(elements_of(task, open_))
    for number, own in enumerate(tethers if len(seen) else ()):
        task = replace(task, tether=own(points) if callable(own) else own)
        if shapes is None and number:
            task = with_shapes(task, own_shapes(replace(domain, points=points)))
        step, least = minimise(task, points, open_, seen, iterations, folds=folds)
        task, step = _mended(task, points, step, open_, seen, depth, repairs)
        invalid, worst = invalid_elements(task, points + task.moves @ step, seen, depth)
        task, count = with_samples(task, worst), len(invalid)
        points = _advanced(task, points, step, invalid, seen, depth)
        history.append(Round(count, int(open_.sum()), len(seen), least))
        shown.say(f"smoothing: {count} elements held back", passing=True)
    return _result(task, points, broken, history)


def approach(domain: Domain, steps: Array, depth: int = 6) -> Untangled:
    """Add steps (n, 3) to control points as far as all elements stay certified.

    All the way; around elements that are not certified then, a half, a quarter or an eighth of it, or nothing.
    Elements not certified at the start are left alone, with their surroundings. Of a space with a constraint the free
    coefficients take the steps.

    Raises
    ------
    InputError : the steps do not fit the domain or are not finite.
    """
    task = shaping(domain, np.ones(domain.space.n, dtype=bool), None, 3, 2.0)
    if steps.shape != (task.moves.shape[1], 3):
        raise InputError(f"{task.moves.shape[1]} control points cannot take an array {steps.shape} of steps")
    if len(bad := np.flatnonzero(~np.isfinite(steps).all(axis=1))):
        raise InputError(f"control point {bad[0]} is to move by {steps[bad[0]].tolist()}, which is no step")
    broken, _ = invalid_elements(task, domain.points, np.arange(task.elements), depth)
    steps = steps.copy()
    steps[touching(task, mask_of(task, broken))] = 0.0
    seen = np.flatnonzero(elements_of(task, (steps != 0.0).any(axis=1)))
    invalid, _ = invalid_elements(task, domain.points + task.moves @ steps, seen, depth)
    made = _advanced(task, domain.points, steps, invalid, seen, depth)
    return _result(task, made, broken, [Round(len(invalid), len(steps), len(seen), np.nan)])


def _mended(
    task: Shaping, points: Array, step: Array, open_: Mask, seen: Index, depth: int, repairs: int
) -> tuple[Shaping, Array]:
    """Steps (m, 3) of the columns after untangling what they leave invalid, and the task with its sample points."""
    for _ in range(repairs):
        moved = points + task.moves @ step
        invalid, worst = invalid_elements(task, moved, seen, depth)
        if not len(invalid):
            break
        task = with_samples(task, worst)
        near = open_ & touching(task, mask_of(task, invalid))
        own = np.flatnonzero(elements_of(task, near))
        step = step + minimise(task, moved, near, own, _REPAIR_STEPS, _REPAIR_DELTAS)[0]
    return task, step


def _advanced(task: Shaping, points: Array, step: Array, invalid: Index, seen: Index, depth: int) -> Array:
    """Points (n, 3) moved by steps (m, 3) of the columns, less of them around elements that are then invalid."""
    share = np.ones(len(step))
    while len(invalid):
        back = touching(task, mask_of(task, invalid))
        share[back] = np.where(share[back] > _LEAST_SHARE, 0.5 * share[back], 0.0)
        # Elements not seen are broken from the start: they never become valid, and need not.
        near = seen[elements_of(task, back)[seen]]
        invalid, _ = invalid_elements(task, points + task.moves @ (share[:, None] * step), near, depth)
    return points + task.moves @ (share[:, None] * step)


def _result(task: Shaping, points: Array, invalid: Index, history: list[Round]) -> Untangled:
    """Result of a task at control points (n, 3); ``invalid`` are numbers of elements of all blocks together."""
    block = np.searchsorted(task.offsets, invalid, side="right") - 1
    pairs = np.stack([block, invalid - task.offsets[block]], axis=1)
    moved = np.flatnonzero((points != task.domain.points).any(axis=1))
    return Untangled(points, pairs, moved, tuple(history))
