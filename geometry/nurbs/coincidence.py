"""Whether one spline surface lies on another: sample points of the first, projected on the second.

Closest points start from a grid of the target and are improved by Gauss-Newton steps clipped to its parameter range.
Axis letters: q sample point, g grid point, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.nurbs.patch import Patch, derivatives, evaluate

Array = NDArray[np.float64]


def same_surface(face: Patch, target: Patch, tolerance: float, enough: int) -> bool:
    """Whether at least ``enough`` of nine interior points of a face lie within ``tolerance`` of another face."""
    points = evaluate(face, _grid(face, np.array([1 / 6, 1 / 2, 5 / 6])))
    inside = (points >= target.control.min(axis=(0, 1)) - tolerance).all(axis=1)
    inside &= (points <= target.control.max(axis=(0, 1)) + tolerance).all(axis=1)
    if inside.sum() < enough:
        return False
    return int((distances(points[inside], target) <= 10 * tolerance).sum()) >= enough


def _grid(face: Patch, fractions: Array) -> Array:
    """Parameters (g, 2) at fractions of the knot ranges."""
    u, v = (t[0] + (t[-1] - t[0]) * fractions for t in face.knots)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def distances(points: Array, face: Patch, steps: int = 15) -> Array:
    """Distance of points (q, 3) to a face, (q,)."""
    starts = _grid(face, np.linspace(0, 1, 13))
    there = evaluate(face, starts)
    parameters = starts[np.linalg.norm(points[:, None] - there[None], axis=-1).argmin(axis=1)]
    low = np.array([t[0] for t in face.knots])
    high = np.array([t[-1] for t in face.knots])
    best = np.full(len(points), np.inf)
    for _ in range(steps):
        x, J = derivatives(face, parameters)
        best = np.minimum(best, np.linalg.norm(points - x, axis=-1))
        step = np.einsum("qdc,qc->qd", np.linalg.pinv(J), points - x)
        parameters = np.clip(parameters + step, low, high)
    return best
