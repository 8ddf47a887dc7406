"""Whether one spline surface lies on another: sample points of the first, projected on the second.

Closest points start from a grid of the target and are improved by Gauss-Newton steps clipped to its parameter range.
Axis letters: q sample point, g grid point, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.patch import Patch, derivatives, evaluate

Array = NDArray[np.float64]

SAMPLES = np.array([1 / 6, 1 / 2, 5 / 6])
STARTS = np.linspace(0, 1, 13)


def same_surface(face: Patch, target: Patch, tolerance: float, enough: int) -> bool:
    """Whether at least ``enough`` of nine interior points of a face lie within ``tolerance`` of another face."""
    points = evaluate(face, _grid(face, SAMPLES))
    points = points[(points >= target.control.min(axis=(0, 1)) - tolerance).all(axis=1)]
    points = points[(points <= target.control.max(axis=(0, 1)) + tolerance).all(axis=1)]
    if len(points) < enough:
        return False
    starts = _grid(target, STARTS)
    there = evaluate(target, starts)
    distance = np.linalg.norm(points[:, None] - there[None], axis=-1)
    grid = there.reshape(len(STARTS), len(STARTS), 3)
    spacing = sum(float(np.linalg.norm(np.diff(grid, axis=a), axis=-1).max()) for a in (0, 1))
    near = distance.min(axis=1) <= spacing + tolerance
    if near.sum() < enough:
        return False
    found = distances(points[near], target, starts[distance[near].argmin(axis=1)], tolerance)
    return int((found <= 10 * tolerance).sum()) >= enough


def _grid(face: Patch, fractions: Array) -> Array:
    """Parameters (g, 2) at fractions of the knot ranges."""
    u, v = (t[0] + (t[-1] - t[0]) * fractions for t in face.knots)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def distances(points: Array, face: Patch, starts: Array, tolerance: float, steps: int = 15) -> Array:
    """Distance of points (q, 3) to a face, (q,), from parameters (q, 2); stops when all are within ``tolerance``."""
    low = np.array([t[0] for t in face.knots])
    high = np.array([t[-1] for t in face.knots])
    parameters = starts
    best = np.full(len(points), np.inf)
    for _ in range(steps):
        x, J = derivatives(face, parameters)
        before, best = best, np.minimum(best, np.linalg.norm(points - x, axis=-1))
        if ((best <= tolerance) | (best > 0.99 * before)).all():  # there, or no longer coming closer
            break
        step = np.einsum("qdc,qc->qd", np.linalg.pinv(J), points - x)
        parameters = np.clip(parameters + step, low, high)
    return best
