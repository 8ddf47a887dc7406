r"""Rational surfaces with cubic arcs, or arcs of half a turn and more, as quadratic pieces of less: the same surface.

Files give half circles as one rational cubic, with weights (1, 1/3, 1/3, 1): a quadratic, whose middle control point is
at infinity, with its degree raised. In homogeneous coordinates H_i = (w_i P_i, w_i) a cubic piece is a quadratic if

    H_3 - 3 H_2 + 3 H_1 - H_0 = 0,   and then with the control points   H_0, (3 H_1 - H_0) / 2, H_3.

Pieces are halved at their middle parameter until the middle weight says that each turns by less than `TURN`; parameters
stay as they are.

Axis letters: d direction, k piece, i control point of a piece.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.knots import apply, insertion
from geometry.patch import Patch

Array = NDArray[np.float64]

SAME = 1e-10
"""Third difference of a cubic piece, relative to its control points, below which it is a quadratic: files write 1/3 in
twelve digits."""
TURN = 0.1
"""Cosine of half the angle of a piece below which it is halved: the middle control point of half a turn is infinite."""
HALVINGS = 3
"""Enough for whole turns; what is no arc by then is none."""


def in_quadratics(surface: Patch) -> Patch:
    """The same rational surface with cubic directions that are quadratic as such, in arcs of less than half a turn.

    Parameters
    ----------
    surface : any; directions of other degrees, and polynomial ones, stay as they are.
    """
    if surface.weights is None:
        return surface
    knots = list(surface.knots)
    H = np.concatenate([surface.control * surface.weights[..., None], surface.weights[..., None]], axis=-1)
    for d, p in enumerate(surface.degree):
        w = np.moveaxis(H[..., 3], d, 0)
        if p in (2, 3) and np.ptp(w / w[:1], axis=0).max() > SAME:
            found = _quadratic(knots[d], p, H, d)
            if found is not None:
                knots[d], H = found
    weights = np.ascontiguousarray(H[..., 3])
    return Patch((knots[0], knots[1]), H[..., :3] / H[..., 3:], weights)


def _quadratic(knots: Array, degree: int, H: Array, d: int) -> tuple[Array, Array] | None:
    """Knots and homogeneous control points with one direction in quadratic pieces, or None if that cannot be."""
    breaks = np.unique(knots)
    for _ in range(HALVINGS + 1):
        fine = np.sort(np.concatenate([np.repeat(breaks, degree), breaks[[0, -1]]]))
        own = np.moveaxis(apply(insertion(knots, degree, fine), H, d), d, 0)
        pieces = own[np.arange(len(breaks) - 1)[:, None] * degree + np.arange(degree + 1)]
        if degree == 3:
            third = pieces[:, 3] - 3.0 * pieces[:, 2] + 3.0 * pieces[:, 1] - pieces[:, 0]
            if np.abs(third).max() > SAME * np.abs(pieces).max():
                return None
            pieces = np.stack([pieces[:, 0], 1.5 * pieces[:, 1] - 0.5 * pieces[:, 0], pieces[:, 3]], axis=1)
        w = pieces[..., 3].reshape(len(pieces), 3, -1)
        wide = (w[:, 1] < TURN * np.sqrt(w[:, 0] * w[:, 2])).any(axis=1)
        if not wide.any():
            joined = np.concatenate([pieces[:, :2].reshape(-1, *pieces.shape[2:]), pieces[-1:, 2]])
            return np.sort(np.concatenate([np.repeat(breaks, 2), breaks[[0, -1]]])), np.moveaxis(joined, 0, d)
        breaks = np.sort(np.concatenate([breaks, 0.5 * (breaks[1:] + breaks[:-1])[wide]]))
    return None
