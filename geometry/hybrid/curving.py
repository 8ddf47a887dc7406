r"""Inner control points for a curved skin: spread its displacement into the volume, then move them until all is valid.

With straight elements as domain and the C0 Bernstein functions B_b as unknowns, the displacement u (curved minus
straight coefficients) is the discrete solution of

    int k grad u . grad v = 0 inside,      u given on the skin,

and then the distortion of all elements is lowered, inner points free, until each is certified (`iga.untangling`). The
ideal elements have the volumes of the straight ones, and size counts as well as shape: where many elements are folded
at the start, shape alone is cheapest for elements that shrink to nothing.

Axis letters: b Bernstein function, e element, c component.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix
from iga.chunk import chunks
from iga.distortion import own_shapes
from iga.domain import Domain
from iga.integrands import Diffusion
from iga.linear.factorization import factorize
from iga.progress import QUIET, Progress
from iga.untangling import Untangled, untangle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

LIMIT = 120.0
"""Seconds after which the displacement is no longer tried in smaller steps."""
SIZE = 1.0
"""Weight of size against shape."""
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


def sized_shapes(domain: Domain) -> tuple[Array, ...]:
    """Jacobian matrices (e, 3, 3) of ideal elements for each block with the volumes of a valid domain's elements."""
    made = []
    volumes = [np.zeros(block.elements) for block in domain.space.blocks]
    for chunk in chunks(domain, 2):
        volumes[chunk.block][chunk.elements] = np.abs(chunk.dx).sum(axis=1)
    for block, shapes, volume in zip(domain.space.blocks, own_shapes(domain), volumes):
        wanted = volume / block.basis.cell.volume
        made.append(shapes * np.cbrt(wanted / np.linalg.det(shapes))[:, None, None])
    return tuple(made)


def unfold(
    domain: Domain, free: Mask, shapes: Sequence[Array], rounds: int = 12, shown: Progress = QUIET
) -> Untangled:
    """Move free control points until all elements are certified, by shape and size."""
    samples = max(max(block.basis.degree) for block in domain.space.blocks) + 2
    return untangle(domain, free, shapes, rounds=rounds, samples=samples, size=SIZE, shown=shown)


def curve(
    straight: Domain, fixed: Mask, target: Array, rounds: int = 12, shown: Progress = QUIET, limit: float = LIMIT
) -> Curved:
    """Control points of a solid with a curved skin.

    The whole displacement is tried at once, then in steps: from a valid solid a small step leaves few elements to mend.

    Parameters
    ----------
    straight : straight solid with identity extraction.
    fixed : (n,) functions on the skin.
    target : (n, 3) their control points.
    rounds : most rounds of untangling in each step.
    limit : seconds after which no further step is tried.
    """
    end = time.monotonic() + limit
    shift = spread(straight, fixed, target - straight.points)
    points, done, step, steps = straight.points, 0.0, 1.0, 0
    shapes = sized_shapes(straight)
    best: Curved | None = None
    while True:
        moved = points + step * shift
        if done + step == 1.0:
            moved[fixed] = target[fixed]
        steps += 1
        made = unfold(replace(straight, points=moved), ~fixed, shapes, rounds, shown)
        whole = done + step == 1.0
        if whole and (best is None or len(made.invalid) < len(best.invalid)):
            best = Curved(made.points, made.invalid, steps)
        if best is not None and time.monotonic() > end:
            break
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
