r"""Inner control points for a curved skin: spread its displacement into the volume, then move them until all is valid.

With straight elements as domain and the C0 Bernstein functions B_b as unknowns, the displacement u (curved minus
straight coefficients) is the discrete solution of

    int k grad u . grad v = 0 inside,      u given on the skin,

and then the distortion of all elements is lowered, inner points free, until each is certified (`iga.untangling`).

Axis letters: b Bernstein function, e element, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix
from iga.domain import Domain
from iga.integrands import Diffusion
from iga.linear.factorization import factorize
from iga.progress import QUIET, Progress
from iga.untangling import untangle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SMALLEST = 1.0 / 8.0
"""Smallest step of the displacement."""


@dataclass(frozen=True, eq=False)
class Curved:
    """Control points (n, 3), block and number (k, 2) of elements that are not certified, and steps taken."""

    points: Array
    invalid: Index
    steps: int


def spread(domain: Domain, fixed: Mask, displacement: Array) -> Array:
    """Harmonic displacement inside.

    Parameters
    ----------
    domain : straight solid.
    fixed : (n,) functions with given displacement; they include all that do not vanish on the boundary.
    displacement : (n, 3), used where ``fixed``.

    Returns
    -------
    (n, 3)
    """
    result = np.where(fixed[:, None], displacement, 0.0)
    free = np.flatnonzero(~fixed)
    if len(free) and np.abs(result).max() > 0.0:
        K = csr_array(matrix(domain, Diffusion()))
        right = -(K[free] @ result)
        result[free] = factorize(csr_array(K[free][:, free]), symmetric=True)(right)
    return result


def curve(straight: Domain, fixed: Mask, target: Array, rounds: int = 12, shown: Progress = QUIET) -> Curved:
    """Control points of a solid with a curved skin.

    The whole displacement is tried at once, then in steps: from a valid solid a small step leaves few elements to mend.

    Parameters
    ----------
    straight : straight solid with identity extraction.
    fixed : (n,) functions on the skin.
    target : (n, 3) their control points.
    rounds : most rounds of untangling in each step.
    """
    shift = spread(straight, fixed, target - straight.points)
    points, done, step, steps = straight.points, 0.0, 1.0, 0
    best: Curved | None = None
    while True:
        moved = points + step * shift
        if done + step == 1.0:
            moved[fixed] = target[fixed]
        steps += 1
        made = untangle(replace(straight, points=moved), ~fixed, rounds=rounds, shown=shown)
        whole = done + step == 1.0
        if whole and (best is None or len(made.invalid) < len(best.invalid)):
            best = Curved(made.points, made.invalid, steps)
        if not len(made.invalid):
            points, done = made.points, done + step
            if whole:
                break
            step = min(2.0 * step, 1.0 - done)
        elif step > SMALLEST:
            step /= 2.0
        elif whole:
            break
        else:
            step = 1.0 - done
    assert best is not None
    return best
