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
from iga.shaping import Shaping
from iga.tether import Tether

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


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
    task = Shaping(domain, free, shapes, samples, power, size, tether)
    points = domain.points.copy()
    invalid, worst = task.check(points, np.arange(task.elements), depth)
    history = [Round(len(invalid), 0, task.elements, np.nan)]
    best, since, reach = len(invalid), 0, 1
    while len(invalid) and since < patience and len(history) <= rounds:
        concerned = task.mask(invalid)
        task.add(worst)
        open_ = task.touching(task.grown(concerned, reach - 1))
        seen = np.flatnonzero(task.elements_of(open_))
        if not len(seen):
            break
        step, least = task.minimise(points, open_, seen, iterations)
        points = points + task.moves @ step
        left, worst = task.check(points, seen, depth)
        kept = np.ones(task.elements, dtype=bool)
        kept[seen] = False
        invalid = np.concatenate([invalid[kept[invalid]], left])
        history.append(Round(len(invalid), int(open_.sum()), len(seen), least))
        shown.say(f"untangling: {len(invalid)} elements not certified ({len(seen)} moved)", passing=True)
        reach = reach if len(invalid) < 0.7 * best else reach + 1
        since = 0 if len(invalid) < best else since + 1
        best = min(best, len(invalid))
    return _result(task, points, invalid, history)


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
    fold there; the others are regularised, and may, if they shall. Elements that are then not certified are untangled;
    around those that resist, control points go back towards where they were, in halves, until all are certified.
    Elements invalid at the start are left alone, with their surroundings.

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
    task = Shaping(domain, free, shapes, samples, power)
    points = domain.points.copy()
    broken, _ = task.check(points, np.arange(task.elements), depth)
    history = [Round(len(broken), 0, task.elements, np.nan)]
    open_ = task.open & ~task.touching(task.mask(broken))
    seen = np.flatnonzero(task.elements_of(open_))
    for number, own in enumerate(tethers if len(seen) else ()):
        task.tether = own(points) if callable(own) else own
        if shapes is None and number:
            task.shape(own_shapes(replace(domain, points=points)))
        step, least = task.minimise(points, open_, seen, iterations, folds=folds)
        step = task.mended(points, step, open_, seen, depth, repairs)
        points, count = task.advanced(points, step, seen, depth)
        history.append(Round(count, int(open_.sum()), len(seen), least))
        shown.say(f"smoothing: {count} elements held back", passing=True)
    return _result(task, points, broken, history)


def approach(domain: Domain, points: Array, depth: int = 6) -> Untangled:
    """Move control points as far towards given ones (n, 3) as all elements stay certified.

    All the way, except around elements that are not certified then, where it is a half, a quarter or nothing.

    Raises
    ------
    InputError : the space has a constraint.
    """
    if domain.space.constraint is not None:
        raise InputError("control points under a constraint cannot be moved one by one")
    task = Shaping(domain, np.ones(domain.space.n, dtype=bool), None, 3, 2.0)
    broken, _ = task.check(domain.points, np.arange(task.elements), depth)
    step = points - domain.points
    step[task.touching(task.mask(broken))] = 0.0
    seen = np.flatnonzero(task.elements_of((step != 0.0).any(axis=1)))
    made, count = task.advanced(domain.points, step, seen, depth)
    return _result(task, made, broken, [Round(count, domain.space.n, len(seen), np.nan)])


def _result(task: Shaping, points: Array, invalid: Index, history: list[Round]) -> Untangled:
    block = np.searchsorted(task.offsets, invalid, side="right") - 1
    pairs = np.stack([block, invalid - task.offsets[block]], axis=1)
    moved = np.flatnonzero((points != task.domain.points).any(axis=1))
    return Untangled(points, pairs, moved, tuple(history))
