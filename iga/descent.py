r"""Limited-memory BFGS for energies that are infinite where they make no sense.

The two-loop recursion (Nocedal and Wright, Numerical Optimization, 7.4) gives directions -H g; steps are halved, or
shortened by quadratic interpolation, until the energy is finite and falls by the Armijo rule. Pairs (s, y) without
positive curvature are left out. No step is longer than ``reach`` in any unknown, so unknowns should be measured in
units of what may change at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ARMIJO = 1e-4
"""Share of the slope by which a step must lower the energy (Nocedal and Wright 2006, Section 3.1)."""
_HALVINGS = 30
"""Trials of a line search: steps of 1e-9 of the first are lost in rounding."""
_FIRST = 0.1
"""Longest change of an unknown in a step along the gradient alone, whose length says nothing, in units of ``reach``."""
_CURVED = 1e-10
"""Least cosine between a step and the change of the gradient for which the pair is kept: below it is rounding."""
_SHORTEST, _LONGEST = 0.1, 0.5
"""Bounds of the factor by which interpolation shortens a step (Dennis and Schnabel 1996, Algorithm A6.3.1)."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended: the unknowns, the energy there, iterations made, and the norm of the gradient."""

    x: Array
    energy: float
    iterations: int
    slope: float


def descend(
    energy: Callable[[Array], tuple[float, Array]],
    x: Array,
    iterations: int,
    memory: int = 12,
    reach: float = 0.5,
    tolerance: float = 1e-6,
) -> Descent:
    """Minimise an energy from a point x (m,) where it is finite.

    Parameters
    ----------
    energy : its value and gradient at x (m,).
    iterations : most steps.
    memory : pairs kept.
    reach : largest change of any unknown in one step.
    tolerance : it ends when two steps together lower the energy by less than this, relatively.
    """
    value, gradient = energy(x)
    pairs: list[tuple[Array, Array, float]] = []
    falls = [np.inf, np.inf]
    step = 0
    while step < iterations and max(falls) > tolerance * abs(value):
        direction = _direction(gradient, pairs)
        slope = float(direction @ gradient)
        if slope >= 0.0:
            if not pairs:
                break
            pairs = []
            continue
        longest = float(np.abs(direction).max())
        if not longest > 0.0:
            break
        length = min(1.0, reach / longest) if pairs else _FIRST * reach / longest
        found = _search(energy, x, value, direction, slope, length)
        if found is None:
            if not pairs:
                break
            pairs = []
            continue
        new, lower, turned = found
        s, y = new - x, turned - gradient
        curvature = float(s @ y)
        if curvature > _CURVED * float(np.linalg.norm(s) * np.linalg.norm(y)):
            pairs = [*pairs[-(memory - 1) :], (s, y, curvature)]
        falls = [falls[1], value - lower]
        x, value, gradient = new, lower, turned
        step += 1
    return Descent(x, value, step, float(np.linalg.norm(gradient)))


def _direction(gradient: Array, pairs: list[tuple[Array, Array, float]]) -> Array:
    """Direction -H g (m,) by the two-loop recursion over pairs s, y with their products s.y, the latest last."""
    q = -gradient
    if not pairs:
        return q
    factors = []
    for s, y, curvature in reversed(pairs):
        a = float(s @ q) / curvature
        q = q - a * y
        factors.append(a)
    _, y, curvature = pairs[-1]
    q *= curvature / float(y @ y)
    for (s, y, curvature), a in zip(pairs, reversed(factors)):
        q += (a - float(y @ q) / curvature) * s
    return q


def _search(
    energy: Callable[[Array], tuple[float, Array]], x: Array, value: float, direction: Array, slope: float,
    length: float,
) -> tuple[Array, float, Array] | None:
    """Point on the ray from x where the energy has fallen enough, energy and gradient there; None if none is found."""
    for _ in range(_HALVINGS):
        new = x + length * direction
        lower, gradient = energy(new)
        if lower <= value + _ARMIJO * length * slope:
            return new, lower, gradient
        if np.isfinite(lower):
            best = -0.5 * slope * length**2 / (lower - value - slope * length)
            length = min(max(best, _SHORTEST * length), _LONGEST * length)
        else:
            length *= 0.5
    return None
