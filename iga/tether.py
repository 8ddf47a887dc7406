r"""Springs that hold points of a solid near places while its control points move.

Axis letters: k spring, n function, m column of unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tether:
    """Springs that hold points of the solid: energy sum_k w_k ((1 - a) (n_k . r_k)^2 + a |r_k|^2), r = A P - places.

    Attributes
    ----------
    A : (k, n) matrix that gives the points from the control points.
    places, normals : (k, 3) where they should be, and unit vectors across which they count most.
    weights : (k,)
    along : a, what distances along the surface normal to the vectors count.
    """

    A: csr_array
    places: Array
    normals: Array
    weights: Array
    along: float = 0.0


def springs(
    tether: Tether | None, points: Array, moves: csr_array, size: Array
) -> tuple[Callable[[Array], tuple[float, Array]], Array]:
    """Energy of a tether as a function of steps, and units of the unknowns.

    A unit is the size of the smallest element that a column moves, less in directions in which springs are stiff:
    l (1 + l^2 K)^(-1/2) with K the column's own block of the springs' second derivatives.

    Parameters
    ----------
    points : (n, 3) control points before the step.
    moves : (n, m) matrix that gives the steps of the control points.
    size : (m,) sizes l.

    Returns
    -------
    A function that gives the energy and its slope (m, 3) for steps (m, 3) of the columns; and units (m, 3, 3).
    """
    if tether is None:
        return lambda step: (0.0, np.zeros_like(step)), size[:, None, None] * np.eye(3)
    A = csr_array(tether.A @ moves)
    rows = np.flatnonzero(np.diff(A.indptr))
    A, normals, w, along = A[rows], tether.normals[rows], tether.weights[rows], tether.along
    back = csr_array(A.T)
    start = tether.A[rows] @ points - tether.places[rows]

    def pull(step: Array) -> tuple[float, Array]:
        r = start + A @ step
        force = w[:, None] * (along * r + (1.0 - along) * (normals * r).sum(axis=1, keepdims=True) * normals)
        return float((force * r).sum()), 2.0 * (back @ force)

    each = along * np.eye(3) + (1.0 - along) * normals[:, :, None] * normals[:, None, :]
    stiff = back.power(2) @ (2.0 * w[:, None, None] * each).reshape(-1, 9)
    values, vectors = np.linalg.eigh(np.eye(3) + size[:, None, None] ** 2 * stiff.reshape(-1, 3, 3))
    return pull, size[:, None, None] * (vectors / np.sqrt(values)[:, None, :]) @ vectors.swapaxes(1, 2)
