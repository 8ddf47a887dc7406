r"""Inner control points for a curved skin: spread its displacement into the volume, then move them until all is valid.

With straight elements as domain and the C0 Bernstein functions B_b as unknowns, the displacement u (curved minus
straight coefficients) is the discrete solution of

    int k grad u . grad v = 0 inside,      u given on the skin,

and then the distortion of all elements is lowered, inner points free, until each is certified (`iga.untangling`). The
ideal elements have the volumes of the straight ones, and size counts as well as shape: where many elements are folded
at the start, shape alone is cheapest for elements that shrink to nothing.

**Pyramids.** In cube coordinates x = a (1-z), y = b (1-z) a pyramid's map is a sum of f_m(a, b) (1-z)^m, m = 0 .. d,
and (1-z)^m is homogeneous of degree m about the apex: where f_m is no polynomial of degree m in (x, y), derivatives of
order m jump there and higher ones are unbounded, and cells cut from the pyramid next to its apex keep their shape
however often it is refined. (Cubic, bent bases: H1 rate 2.77 without, 2.87 with what follows, 2.96 on a straight box.)
`smooth_tops` takes the nearest map whose terms m < d are polynomials,

    x = q(x, y, z) + D(a, b) (1-z)^d,      q of degree d - 1,

so that what only the base knows, D, meets the apex with d - 1 continuous derivatives. In the basis (1-z)^d B_i B_j are
the functions of the base, and all others hold the coefficients of q.

Axis letters: b Bernstein function, e element, c component.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix
from iga.bernstein import bernstein, greville, lagrange_to_bernstein
from iga.cells import PYRAMID
from iga.certificate import SIGN_ALONE, certify
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


@cache
def _polynomial_part(degree: int) -> tuple[Mask, Array]:
    """Which of a pyramid's functions do not act on its base, and the projection of their coefficients onto those of
    polynomials of one degree less.
    """
    basis = bernstein(PYRAMID, degree)
    points = greville(basis)
    powers = [(i, j, k) for i in range(degree) for j in range(degree - i) for k in range(degree - i - j)]
    values = np.stack([np.prod(points ** np.array(p), axis=1) for p in powers], axis=1)
    above = basis.exponents[:, 2] > 0
    E = (lagrange_to_bernstein(basis, points) @ values)[above]
    return above, E @ np.linalg.pinv(E)


def smooth_tops(
    domain: Domain, fixed: Mask, shapes: Sequence[Array], rounds: int = 12, shown: Progress = QUIET
) -> Domain | None:
    """Valid solid whose pyramids are smooth at their apexes, or None where that leaves elements that are not certified.

    Parameters
    ----------
    domain : valid solid with identity extraction, no two pyramids of which have a lateral face in common.
    fixed : (n,) functions on the skin.
    """
    points, held = domain.points.copy(), fixed.copy()
    for block in domain.space.blocks:
        if block.basis.cell is PYRAMID:
            above, projection = _polynomial_part(block.basis.degree[0])
            own = block.dofs[:, above]
            points[own] = projection @ points[own]
            held[block.dofs] = True
    moved = replace(domain, points=domain.points + spread(domain, held, points - domain.points))
    if (certify(moved, SIGN_ALONE).verdict > 0).all():
        return moved
    made = unfold(moved, ~held, shapes, rounds, shown)
    return None if len(made.invalid) else replace(domain, points=made.points)


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
