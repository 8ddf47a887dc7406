r"""One spline or NURBS patch: evaluation and exact refinement.

    x(u) = sum_i w_i P_i N_i(u) / sum_i w_i N_i(u),   N_i(u) = N_i1(u_1) N_i2(u_2) ..

Insertion and elevation act on the homogeneous control points (w P, w), one direction after the other. The number of
directions is free: volumes have three, and their faces are patches with two.

Axis letters: d direction, q point, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.knots import (
    Rows,
    apply,
    bisected,
    breakpoints,
    check_knots,
    derivative,
    elevation,
    evaluation,
    insertion,
    normalised,
    reversed_knots,
    snap,
)
from iga.errors import InputError
from iga.quadrature import gauss_jacobi

Array = NDArray[np.float64]

FACES = ("x0", "x1", "y0", "y1", "z0", "z1")


@dataclass(frozen=True, eq=False)
class Patch:
    """A tensor-product spline in space.

    Attributes
    ----------
    knots : one knot vector per direction, each end repeated degree + 1 times.
    control : (n_1, .., n_d, 3) control points.
    weights : (n_1, .., n_d) positive weights, or None.
    """

    knots: tuple[Array, ...]
    control: Array
    weights: Array | None = None

    @cached_property
    def degree(self) -> tuple[int, ...]:
        """Degree of each direction."""
        return tuple(len(t) - n - 1 for t, n in zip(self.knots, self.control.shape))

    @cached_property
    def elements(self) -> tuple[int, ...]:
        """Knot intervals of positive length of each direction."""
        return tuple(len(np.unique(t)) - 1 for t in self.knots)


def make_patch(knots: list[Array], control: Array, weights: Array | None, where: str) -> Patch:
    """Patch from what a file says: everything checked, nearly equal knots made equal, open ends clamped.

    Parameters
    ----------
    knots : knot vector of each direction.
    control : (n_1, .., n_d, 3)
    weights : (n_1, .., n_d) or None.
    where : file and patch, for messages.

    Raises
    ------
    InputError : wrong counts, numbers that are not finite, knots that decrease or tear the patch, weights <= 0.
    """
    made = []
    for d, (t, n) in enumerate(zip(knots, control.shape)):
        t = np.asarray(t, dtype=float)
        check_knots(t, len(t) - n - 1, n, f"{where}, direction {'xyz'[d]}")
        t = snap(t)
        check_knots(t, len(t) - n - 1, n, f"{where}, direction {'xyz'[d]}")
        made.append(t)
    bad = np.argwhere(~np.isfinite(control).all(axis=-1))
    if len(bad):
        raise InputError(f"{where}: control point {tuple(bad[0].tolist())} is not finite")
    if np.abs(control).max() > 1e150:
        raise InputError(f"{where}: a control point lies beyond 1e150")
    if weights is not None:
        bad = np.argwhere(~((weights > 0) & (weights < 1e100) & (weights > 1e-100)))
        if len(bad):
            index = tuple(bad[0].tolist())
            raise InputError(f"{where}: weight {index} is {weights[index]:g}; weights must be positive")
        if np.ptp(weights) <= 1e-14 * weights.max():
            weights = None
    return _clamp(Patch(tuple(made), np.ascontiguousarray(control, dtype=float), weights))


def _clamp(patch: Patch) -> Patch:
    """Repeat the end knots degree + 1 times (an unclamped patch is defined on t_p .. t_n only)."""
    for d, (t, p) in enumerate(zip(patch.knots, patch.degree)):
        n = len(t) - p - 1
        inner = t[(t > t[p]) & (t < t[n])]
        fine = np.concatenate([np.full(p + 1, t[p]), inner, np.full(p + 1, t[n])])
        if len(fine) != len(t) or (fine != t).any():
            patch = _map(patch, d, fine, insertion(t, p, fine))
    return patch


def homogeneous(patch: Patch) -> Array:
    """Homogeneous control points (n_1, .., n_d, 4): (w P, w)."""
    w = np.ones(patch.control.shape[:-1]) if patch.weights is None else patch.weights
    return np.concatenate([patch.control * w[..., None], w[..., None]], axis=-1)


def from_homogeneous(knots: tuple[Array, ...], values: Array) -> Patch:
    """Rational patch from homogeneous control points (n_1, .., n_d, 4)."""
    return Patch(knots, values[..., :3] / values[..., 3:], np.ascontiguousarray(values[..., 3]))


def _map(patch: Patch, axis: int, knots: Array, rows: Rows) -> Patch:
    """Patch with new knots in one direction and control points mapped by the rows."""
    made = (*patch.knots[:axis], knots, *patch.knots[axis + 1 :])
    if patch.weights is None:
        return Patch(made, apply(rows, patch.control, axis))
    return from_homogeneous(made, apply(rows, homogeneous(patch), axis))


def insert(patch: Patch, axis: int, new: Array) -> Patch:
    """Insert knots in one direction, all at once; the shape stays as it is.

    Raises
    ------
    InputError : a new knot lies outside the patch or would be repeated more often than the degree.
    """
    t, p = patch.knots[axis], patch.degree[axis]
    new = np.asarray(new, dtype=float)
    if len(new) == 0:
        return patch
    if not (new.min() > t[0] and new.max() < t[-1]):
        raise InputError(f"new knots {new.min():g} .. {new.max():g} do not lie inside {t[0]:g} .. {t[-1]:g}")
    fine = np.sort(np.concatenate([t, new]))
    if breakpoints(fine)[1][1:-1].max() > p:
        raise InputError(f"a knot of degree {p} cannot be repeated more than {p} times")
    return _map(patch, axis, fine, insertion(t, p, fine))


def elevate(patch: Patch, times: int | tuple[int, ...]) -> Patch:
    """Raise the degree, in all directions or each by its own number; shape and continuity stay as they are."""
    each = (times,) * len(patch.knots) if isinstance(times, int) else times
    for axis, count in enumerate(each):
        for _ in range(count):
            patch = _map(patch, axis, *elevation(patch.knots[axis], patch.degree[axis]))
    return patch


def bisect(patch: Patch, levels: int = 1) -> Patch:
    """Halve every knot interval ``levels`` times by simple knots: smoothness is kept, and full at new knots."""
    for axis, t in enumerate(patch.knots):
        fine = bisected(t, levels)
        if len(fine) > len(t):
            patch = _map(patch, axis, fine, insertion(t, patch.degree[axis], fine))
    return patch


def fit(patch: Patch, axis: int, knots: Array, degree: int) -> Patch:
    """Bring one direction to a normalised knot vector and degree that hold its own (see `knots.common`)."""
    patch = elevate(patch, tuple(degree - p if d == axis else 0 for d, p in enumerate(patch.degree)))
    own = patch.knots[axis]
    low, length = own[0], own[-1] - own[0]
    places, repeats = breakpoints(knots)
    here, counts = breakpoints(own)
    nearest = np.abs(normalised(here)[:, None] - places[None]).argmin(axis=1)
    # A knot of the file that is off by rounding moves to the common place: equal traces need equal knots.
    moved = np.where(np.abs(normalised(here) - places[nearest]) > 1e-13, low + length * places[nearest], here)
    values = low + length * places
    values[nearest] = moved
    values[0], values[-1] = own[0], own[-1]
    shifted = replace(patch, knots=(*patch.knots[:axis], np.repeat(moved, counts), *patch.knots[axis + 1 :]))
    fine = np.repeat(values, repeats)
    if len(fine) == len(own):
        return shifted
    return _map(shifted, axis, fine, insertion(shifted.knots[axis], degree, fine))


def reverse(patch: Patch, axis: int) -> Patch:
    """Run one direction backwards."""
    knots = (*patch.knots[:axis], reversed_knots(patch.knots[axis]), *patch.knots[axis + 1 :])
    weights = None if patch.weights is None else np.ascontiguousarray(np.flip(patch.weights, axis))
    return Patch(knots, np.ascontiguousarray(np.flip(patch.control, axis)), weights)


def swap(patch: Patch) -> Patch:
    """Exchange the first two directions."""
    weights = None if patch.weights is None else np.ascontiguousarray(np.swapaxes(patch.weights, 0, 1))
    knots = (patch.knots[1], patch.knots[0], *patch.knots[2:])
    return Patch(knots, np.ascontiguousarray(np.swapaxes(patch.control, 0, 1)), weights)


def face_of(patch: Patch, face: int) -> Patch:
    """Face number 2 * direction + side as a patch of the other directions, in their order."""
    axis, side = divmod(face, 2)
    take = (slice(None),) * axis + (-side,)
    knots = patch.knots[:axis] + patch.knots[axis + 1 :]
    return Patch(knots, patch.control[take], None if patch.weights is None else patch.weights[take])


def split(patch: Patch, axis: int, knot: float) -> tuple[Patch, Patch]:
    """Cut a patch in two at a knot of one direction."""
    t, p = patch.knots[axis], patch.degree[axis]
    patch = insert(patch, axis, np.full(p - np.count_nonzero(t == knot), knot))
    t = patch.knots[axis]
    first = int(np.searchsorted(t, knot))
    parts = []
    for knots, span in (
        (np.append(t[: first + p], knot), slice(None, first)),
        (np.concatenate([[knot], t[first:]]), slice(first - 1, None)),
    ):
        take = (slice(None),) * axis + (span,)
        weights = None if patch.weights is None else patch.weights[take]
        parts.append(Patch((*patch.knots[:axis], knots, *patch.knots[axis + 1 :]), patch.control[take], weights))
    return parts[0], parts[1]


def evaluate(patch: Patch, points: Array) -> Array:
    """Points x (q, 3) at parameters (q, d)."""
    h = _combine(patch, points, -1)
    return h[:, :3] / h[:, 3:]


def derivatives(patch: Patch, points: Array) -> tuple[Array, Array]:
    """Points x (q, 3) and derivatives dx/du (q, 3, d) at parameters (q, d)."""
    h = _combine(patch, points, -1)
    x = h[:, :3] / h[:, 3:]
    slopes = [_combine(patch, points, d) for d in range(len(patch.knots))]
    return x, np.stack([(s[:, :3] - x * s[:, 3:]) / h[:, 3:] for s in slopes], axis=-1)


def _combine(patch: Patch, points: Array, which: int) -> Array:
    """Homogeneous values (q, 4), differentiated in direction ``which`` (-1: not at all)."""
    rows = [
        (derivative if d == which else evaluation)(t, p, points[:, d])
        for d, (t, p) in enumerate(zip(patch.knots, patch.degree))
    ]
    index = []
    for d, r in enumerate(rows):
        shape = [len(points)] + [1] * len(rows)
        shape[d + 1] = r.values.shape[1]
        index.append((r.first[:, None] + np.arange(r.values.shape[1])).reshape(shape))
    local = homogeneous(patch)[tuple(index)]
    for r in rows:
        local = np.einsum("qn,qn...->q...", r.values, local)
    return local


def grid_evaluate(patch: Patch, axes: list[Array]) -> tuple[Array, Array]:
    """Points (m_1, .., m_d, 3) and derivatives (m_1, .., m_d, 3, d) on a grid of parameters, axis by axis."""
    values = homogeneous(patch)

    def combine(which: int) -> Array:
        result = values
        for d, (t, p) in enumerate(zip(patch.knots, patch.degree)):
            result = apply((derivative if d == which else evaluation)(t, p, axes[d]), result, d)
        return result

    h = combine(-1)
    x = h[..., :3] / h[..., 3:]
    slopes = [combine(d) for d in range(len(axes))]
    return x, np.stack([(s[..., :3] - x * s[..., 3:]) / h[..., 3:] for s in slopes], axis=-1)


def signed_volume(patch: Patch, points: int = 2) -> float:
    """Integral of det dx/du with a few Gauss points per knot interval: its sign tells a left-handed patch."""
    x, w = gauss_jacobi(points, 0)
    axes, weights = [], []
    for t in patch.knots:
        ends = np.unique(t)
        h = np.diff(ends)
        axes.append((ends[:-1, None] + h[:, None] * x).ravel())
        weights.append((h[:, None] * w).ravel())
    _, J = grid_evaluate(patch, axes)
    return float(np.einsum("ijk,i,j,k->", np.linalg.det(J), *weights))
