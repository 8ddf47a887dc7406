"""Axes of a solid: the rotation that brings the normals of its surface as close to the axes as they can be.

It minimises ``sum_t A_t |R n_t|_1`` over the triangles (Huang et al., "l1-based construction of polycube maps from
complex shapes", ACM Trans. Graph. 33(3), 2014, doi:10.1145/2602141).

Axis letters: t triangle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geometry.simplices.surface import Surface, area_vectors

Array = NDArray[np.float64]


def orientation(surface: Surface, trials: int = 400, seed: int = 7) -> Array:
    """Rotation (3, 3) that brings the surface's normals nearest to the axes, in the mean; its rows are the axes.

    The solid is longest along the first axis.
    """
    normals = area_vectors(surface)
    centred = surface.points - surface.points.mean(axis=0)
    principal = np.linalg.svd(centred, full_matrices=False)[2]
    random = np.random.default_rng(seed)

    def excess(rotation: Array) -> float:
        return float(np.abs(normals @ rotation.T).sum())

    candidates = [np.eye(3), principal, *(_turn(random.normal(size=4)) for _ in range(trials))]
    found = min((_descend(rotation, excess) for rotation in sorted(candidates, key=excess)[:5]), key=excess)
    found = found[np.argsort(-np.ptp(centred @ found.T, axis=0), kind="stable")]
    return np.asarray(found * np.array([1.0, 1.0, np.sign(np.linalg.det(found))])[:, None])


def _turn(quaternion: Array) -> Array:
    """Rotation (3, 3) of a quaternion (4,) of any length but 0."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def _descend(rotation: Array, value: Callable[[Array], float]) -> Array:
    """Lower the value by small turns of a rotation."""

    def turned(angles: Array) -> Array:
        return _turn(np.concatenate(([1.0], angles))) @ rotation

    simplex = np.vstack((np.zeros(3), 0.1 * np.eye(3)))
    options = {"xatol": 1e-4, "fatol": 1e-9, "initial_simplex": simplex}
    return turned(minimize(lambda angles: value(turned(angles)), np.zeros(3), method="Nelder-Mead", options=options).x)
