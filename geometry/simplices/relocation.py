r"""Untangling and smoothing of simplicial meshes by moving nodes (Escobar et al. 2003).

With A the edges of a simplex from one of its vertices, W those of its ideal from the same vertex, and S = A W^-1,

    eta = |S|^2 / (d h(sigma)^(2/d)),   sigma = det S,   h(sigma) = (sigma + (sigma^2 + 4 delta^2)^(1/2)) / 2,

is 1 where the simplex is similar to its ideal and grows as it flattens or folds. Each free node in turn goes to a
minimum of the p-norm of eta over the simplices around it, by Newton's method with a line search. There delta is
the smallest value for which h(sigma_min) >= epsilon, epsilon being relative to the mean |sigma| around the node:

    delta = (epsilon (epsilon - sigma_min))^(1/2)   if sigma_min < epsilon, else 0.

S does not depend on the vertex: S = sum_v x_v g_v^T with g_v the gradients of the barycentric coordinates on the ideal.

Axis letters: m simplex, v its vertex, n node, d dimension.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field

import nlopt
import numpy as np
from numpy.typing import NDArray

from geometry.simplices.kernels_relocation import energy_gradient, incidence, shapes, sweep
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EPSILON = 1e-3
"""Regularisation of the energy of inverted simplices, relative to ideal ones."""
EPSILONS = (1e-3, 1e-1, 1e-2)
"""Those that take turns in `relocate`."""
PATIENCE = 8
"""Sweeps without fewer inverted simplices after which the next one's turn comes."""


def ideal_gradients(ideal: Array) -> Array:
    """Gradients (m, d + 1, d) of the barycentric coordinates on ideal simplices with vertices (m, d + 1, d).

    Raises
    ------
    InputError : an ideal simplex is flat.
    """
    W = np.swapaxes(ideal[:, 1:] - ideal[:, :1], 1, 2)
    det = np.linalg.det(W)
    size = np.abs(W).max(axis=(1, 2)) ** W.shape[1]
    if (flat := np.flatnonzero(np.abs(det) <= 1e-12 * size)).size:
        raise InputError(f"the ideal shape of element {flat[0]} is flat")
    rows = np.linalg.inv(W)  # row v - 1 is the gradient of coordinate v
    return np.ascontiguousarray(np.concatenate([-rows.sum(axis=1, keepdims=True), rows], axis=1))


@dataclass(frozen=True)
class Quality:
    """Shapes of a mesh.

    Attributes
    ----------
    inverted : number of simplices without sigma > 0: folded, flat, or at nodes that are no numbers.
    least, mean : mean ratio d sigma^(2/d) / |S|^2, zero for inverted ones.
    """

    inverted: int
    least: float
    mean: float


def quality(simplices: Index, gradients: Array, nodes: Array) -> Quality:
    """Shapes of all simplices, summed up.

    Parameters
    ----------
    simplices, gradients, nodes : as in `relocate`; at least one simplex.
    """
    sigma, ratio = shapes(simplices, gradients, nodes)
    return Quality(int((~(sigma > 0.0)).sum()), float(ratio.min()), float(ratio.mean()))


@dataclass(frozen=True, eq=False)
class Relocated:
    """Result of relocation.

    Attributes
    ----------
    nodes : (n, d) positions with the fewest inverted simplices.
    inverted : (sweeps + 1,) inverted simplices before the first and after each sweep.
    moves : (sweeps,) largest move of a node, relative to the mean length of the edges at it.
    quality : shapes at the end.
    """

    nodes: Array
    inverted: Index
    moves: Array
    quality: Quality = field(repr=False)


def relocate(
    simplices: Index, gradients: Array, nodes: Array, free: NDArray[np.bool_], sweeps: int = 20, power: float = 2.0,
    epsilons: tuple[float, ...] = EPSILONS, tolerance: float = 1e-2, newton: int = 3,
) -> Relocated:
    """Move free nodes one after the other, sweep after sweep, until they rest.

    While simplices are inverted, the epsilons take turns: the next one's turn comes when the number of inverted
    simplices has not fallen for ``PATIENCE`` sweeps. The smallest does best on nearly all solids, larger ones where it
    is stuck. Valid meshes are smoothed with the smallest.

    Parameters
    ----------
    simplices : (m, d + 1)
    gradients : (m, d + 1, d) of `ideal_gradients`.
    nodes : (n, d)
    free : (n,) nodes that may move.
    sweeps : most sweeps.
    power : exponent p of the norm.
    epsilons : see above and the module docstring.
    tolerance : a sweep in which no node moves by more than this part of the edges at it is the last one, unless
        simplices are inverted.
    newton : most Newton steps at one node.
    """
    nodes = np.array(nodes, dtype=float)
    start, around = incidence(simplices, len(nodes))
    order = np.flatnonzero(free & (np.diff(start) > 0))
    inverted = [quality(simplices, gradients, nodes).inverted]
    moves: list[float] = []
    best, least, since, turn = nodes.copy(), inverted[0], 0, 0
    for step in range(sweeps if len(order) else 0):
        epsilon = epsilons[turn % len(epsilons)] if inverted[-1] else min(epsilons)
        way = order if step % 2 == 0 else order[::-1].copy()
        moves.append(float(sweep(nodes, simplices, gradients, start, around, way, power, epsilon, newton)))
        inverted.append(quality(simplices, gradients, nodes).inverted)
        since += 1
        if inverted[-1] < least or not inverted[-1]:
            best, least, since = nodes.copy(), inverted[-1], 0
        if moves[-1] < tolerance and not inverted[-1]:
            break
        if since == PATIENCE:
            turn, since = turn + 1, 0
    return Relocated(best, np.array(inverted), np.array(moves), quality(simplices, gradients, best))


def relocate_globally(
    simplices: Index, gradients: Array, nodes: Array, free: NDArray[np.bool_], rounds: int = 10, power: float = 2.0,
    epsilon: float = EPSILON, evaluations: int = 200,
) -> Relocated:
    """Move all free nodes at once: L-BFGS on sum_m eta^p with one delta for the mesh, which falls from round to round.

    In the plane and on small meshes it untangles in a few rounds. On large meshes of solids `relocate` is faster and
    leaves fewer simplices inverted: here the worst one sets delta for all. Arguments as there; ``evaluations`` bounds
    each round, and epsilon starts from 0.1.
    """
    nodes = np.array(nodes, dtype=float)
    rows = np.flatnonzero(free)
    inverted, moves = [quality(simplices, gradients, nodes).inverted], []
    for step in range(rounds if len(rows) else 0):
        sigma = shapes(simplices, gradients, nodes)[0]
        floor = max(epsilon, 0.1 ** (step + 1)) * float(np.abs(sigma).mean())
        least = float(sigma.min())
        delta = float(np.sqrt(floor * (floor - least))) if least < floor else 0.0
        start = nodes[rows].copy()
        nodes = _minimise(simplices, gradients, nodes, rows, power, delta, evaluations)
        moves.append(float(np.abs(nodes[rows] - start).max() / np.ptp(nodes, axis=0).max()))
        inverted.append(quality(simplices, gradients, nodes).inverted)
        if delta == 0.0 and moves[-1] < 1e-4:
            break
    return Relocated(nodes, np.array(inverted), np.array(moves), quality(simplices, gradients, nodes))


def _minimise(
    simplices: Index, gradients: Array, nodes: Array, rows: Index, power: float, delta: float, evaluations: int
) -> Array:
    """Nodes (n, d) after L-BFGS on those of ``rows``; the best that was seen, should the line search fail."""
    nodes = nodes.copy()
    best, lowest = nodes[rows].copy(), np.inf
    scale = energy_gradient(simplices, gradients, nodes, power, delta)[0]

    def objective(x: Array, slope: Array) -> float:
        nonlocal best, lowest
        nodes[rows] = x.reshape(best.shape)
        value, gradient = energy_gradient(simplices, gradients, nodes, power, delta)
        if slope.size:
            slope[:] = gradient[rows].ravel() / scale
        if value < lowest:
            best, lowest = nodes[rows].copy(), float(value)
        return float(value / scale)

    solver = nlopt.opt(nlopt.LD_LBFGS, best.size)
    solver.set_min_objective(objective)
    solver.set_maxeval(evaluations)
    solver.set_ftol_rel(1e-9)
    with suppress(nlopt.RoundoffLimited, nlopt.runtime_error):
        solver.optimize(best.ravel())
    nodes[rows] = best
    return nodes
