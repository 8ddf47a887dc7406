r"""Surfaces whose rational directions are arcs of conics, as C1 bicubic polynomial splines of the sixth order.

Where weights are products w_ij = a_i b_j, every parameter line u of a patch is an affine picture of one rational curve

    sum_i R_i(u) P_i,    R_i = a_i B_i / sum_k a_k B_k.

A quadratic piece of it with a_1^2 < a_0 a_2 is a picture of the arc of the unit circle with the half angle alpha,
cos(alpha) = a_1 / sqrt(a_0 a_2). The arc is cut into equal arcs of angle theta, and each becomes the cubic with its
ends and tangents and arms of the length L that encloses the same area,

    3 sin(theta) L^2 - 12 (1 - cos(theta)) L + 10 (theta - sin(theta)) = 0,

which is off the arc by the sixth power of theta, to both sides (the area of a cubic is a quadratic form of its control
points; compare Dokken, Daehlen, Lyche, Morken 1990, doi:10.1016/0167-8396(90)90019-N). Arcs of equal angle have equal
arms, so cubics on equal knot intervals join with C1. The price is another parameter: the cubic runs nearly with the
angle, where the rational arc runs with its tangent. `Arcs` maps one to the other, point by point in one direction from
the centre, so that what remains is the distance across.

Axis letters: i control point of the arcs, m control point of the cubics, k arc, q point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.conics import in_quadratics
from geometry.hybrid.curves import cubic_functions
from geometry.hybrid.hbrep import DEGREE
from geometry.knots import apply, elevation
from geometry.patch import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Map = Callable[[Array], Array]

COUNTS = (1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64)
"""Cubics of an arc that are tried: ever more by a half."""
SMOOTH = 1e-9
"""Relative difference of derivatives below which arcs join smoothly."""
PRODUCT = 1e-12
"""Relative difference of weights from products below which they are products."""


@dataclass(frozen=True, eq=False)
class Arcs:
    """Rational quadratic arcs of one direction.

    Attributes
    ----------
    breaks : (k + 1,) knots.
    half : (k,) half angles.
    balance : (k,) sqrt(a_2 / a_0).
    count : cubics of each arc.
    """

    breaks: Array
    half: Array
    balance: Array
    count: int = 1


def arcs_of(knots: Array, weights: Array) -> Arcs | None:
    """Arcs of one direction of degree two with weights (i,); None if it is made of anything else."""
    breaks, repeats = np.unique(knots, return_counts=True)
    if (repeats[[0, -1]] != 3).any() or (repeats[1:-1] != 2).any():
        return None
    a = weights[np.arange(len(breaks) - 1)[:, None] * 2 + np.arange(3)]
    cosine = a[:, 1] / np.sqrt(a[:, 0] * a[:, 2])
    if (cosine >= 1.0 - 1e-12).any() or (cosine <= 0.0).any():
        return None
    return Arcs(breaks, np.arccos(cosine), np.sqrt(a[:, 2] / a[:, 0]))


def arm(theta: Array) -> Array:
    """Length L of a cubic's arms over an arc of the unit circle, so that it encloses the arc's area."""
    s, c = np.sin(theta), 1.0 - np.cos(theta)
    return np.asarray(20.0 * (theta - s) / (12.0 * c + np.sqrt(144.0 * c**2 - 120.0 * s * (theta - s))))


def _cubic(theta: Array) -> Array:
    """Control points (.., 4, 2) over arcs of the unit circle from (1, 0)."""
    L, zero, one = arm(theta), np.zeros_like(theta), np.ones_like(theta)
    c, s = np.cos(theta), np.sin(theta)
    x, y = (one, one, c + L * s, c), (zero, L, s - L * c, s)
    return np.stack([np.stack(x, axis=-1), np.stack(y, axis=-1)], axis=-1)


def radial_error(theta: Array) -> Array:
    """Largest distance of the cubic from the arc of the unit circle, at samples."""
    B = cubic_functions(np.linspace(0.0, 1.0, 65))
    return np.asarray(np.abs(np.linalg.norm(B @ _cubic(theta), axis=-1) - 1.0).max(axis=-1))


def _place(arcs: Arcs, x: Array) -> tuple[Index, Array]:
    """Arc (q,) of parameters, and the share (q,) of it that is behind them."""
    k = np.clip(np.searchsorted(arcs.breaks, x, side="right") - 1, 0, len(arcs.half) - 1)
    return k, (x - arcs.breaks[k]) / np.diff(arcs.breaks)[k]


def to_cubic(arcs: Arcs, u: Array) -> Array:
    """Parameters (q,) of the cubics where they are in the direction, from the centre, of the arcs' parameters (q,)."""
    k, t = _place(arcs, u)
    half, ratio = arcs.half[k], arcs.balance[k]
    even = t * ratio / (t * ratio + 1.0 - t)  # the parameter were both outer weights equal
    angle = half + 2.0 * np.arctan((2.0 * even - 1.0) * np.tan(0.5 * half))
    theta = 2.0 * half / arcs.count
    piece = np.clip(np.floor(angle / theta), 0, arcs.count - 1)
    rest = angle - piece * theta
    c = _cubic(theta)
    across = np.sin(rest)[:, None] * c[..., 0] - np.cos(rest)[:, None] * c[..., 1]  # falls with s, zero at the ray
    s = rest / theta
    for _ in range(6):
        r = 1.0 - s
        value = r**3 * across[:, 0] + 3 * r**2 * s * across[:, 1] + 3 * r * s**2 * across[:, 2] + s**3 * across[:, 3]
        d = np.diff(across, axis=1)
        s = s - value / (3.0 * (r**2 * d[:, 0] + 2.0 * r * s * d[:, 1] + s**2 * d[:, 2]))
    return np.asarray(arcs.breaks[k] + (piece + s) / arcs.count * np.diff(arcs.breaks)[k])


def from_cubic(arcs: Arcs, x: Array) -> Array:
    """The inverse of `to_cubic`."""
    k, t = _place(arcs, x)
    half = arcs.half[k]
    theta = 2.0 * half / arcs.count
    piece = np.clip(np.floor(t * arcs.count), 0, arcs.count - 1)
    s = t * arcs.count - piece
    p = np.einsum("qb,qbc->qc", cubic_functions(s), _cubic(theta))
    angle = piece * theta + np.arctan2(p[:, 1], p[:, 0])
    even = 0.5 + 0.5 * np.tan(0.5 * (angle - half)) / np.tan(0.5 * half)
    own = even / (even + (1.0 - even) * arcs.balance[k])
    return np.asarray(arcs.breaks[k] + own * np.diff(arcs.breaks)[k])


def cubics_of(arcs: Arcs, control: Array) -> tuple[Array, Array]:
    """Knots of the cubics, and rows (m, i) that make their control points of those of the arcs.

    Parameters
    ----------
    control : (i, .., 3) control points of the arcs, which say where these join smoothly.
    """
    blocks = []
    for k, half in enumerate(arcs.half.tolist()):
        theta = np.full(arcs.count, 2.0 * half / arcs.count)
        turn = theta * np.arange(arcs.count) - half
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        points = np.einsum("nbc,cdn->nbd", _cubic(theta), rotation)
        corners = np.array([
            (np.cos(half), 1.0 / np.cos(half), np.cos(half)), (-np.sin(half), 0.0, np.sin(half)), (1.0, 1.0, 1.0)
        ])
        shares = np.linalg.solve(corners, np.append(points.reshape(-1, 2), np.ones((4 * arcs.count, 1)), axis=1).T).T
        own = np.zeros((4 * arcs.count, len(control)))
        own[:, 2 * k : 2 * k + 3] = shares
        own[0], own[-1] = np.eye(len(control))[[2 * k, 2 * k + 2]]
        blocks.append(own.reshape(arcs.count, 4, -1))
    pieces = np.concatenate(blocks)
    step = np.repeat(np.diff(arcs.breaks) / arcs.count, arcs.count)
    knots, rows = [np.full(DEGREE + 1, arcs.breaks[0])], [pieces[0, :2]]
    fine = np.concatenate([a + (b - a) * np.arange(arcs.count) / arcs.count
                           for a, b in zip(arcs.breaks[:-1], arcs.breaks[1:])])  # fmt: skip
    for n in range(1, len(pieces)):
        before, after = (pieces[n - 1, 3] - pieces[n - 1, 2]) / step[n - 1], (pieces[n, 1] - pieces[n, 0]) / step[n]
        kink = np.tensordot(after - before, control, axes=1)
        smooth = np.abs(kink).max() <= SMOOTH * np.abs(np.tensordot(after, control, axes=1)).max()
        rows += [pieces[n - 1, 2:3]] if smooth else [pieces[n - 1, 2:]]
        rows.append(pieces[n, 1:2])
        knots.append(np.full(2 if smooth else 3, fine[n]))
    return np.concatenate([*knots, np.full(DEGREE + 1, arcs.breaks[-1])]), np.concatenate([*rows, pieces[-1, 2:]])


def _reach(arcs: Arcs, control: Array) -> Array:
    """How much larger than the unit circle the arcs (k,) of control points (i, .., 3) are at most."""
    found = []
    for k, half in enumerate(arcs.half.tolist()):
        p = control[2 * k : 2 * k + 3].reshape(3, -1, 3)
        plane = np.array([(1.0 / np.cos(half) - np.cos(half), 0.0), (np.sin(half), 2.0 * np.sin(half))])
        M = np.einsum("dnc,de->nce", p[1:] - p[0], np.linalg.inv(plane))
        found.append(np.linalg.norm(M, ord=2, axis=(1, 2)).max())
    return np.array(found)


def _counted(arcs: Arcs, control: Array, tolerance: float) -> Arcs | None:
    """Arcs with so many cubics that these are within a tolerance; None if that takes too many."""
    reach = _reach(arcs, control)
    for count in COUNTS:
        if (reach * radial_error(2.0 * arcs.half / count)).max() <= tolerance:
            return Arcs(arcs.breaks, arcs.half, arcs.balance, count)
    return None


def arcs_as_cubics(surface: Patch, tolerance: float) -> tuple[Patch, Map, Map] | None:
    """Bicubic spline within a tolerance of a surface with arcs in one direction or both.

    Parameters
    ----------
    surface : rational; a direction that is no arc must be polynomial, of degree three at most. Arcs of degree three are
        lowered first (`conics`).
    tolerance : largest distance in space.

    Returns
    -------
    The spline, the map of parameters (q, 2) of the surface to those of the spline, and its inverse; None if the surface
    is something else.
    """
    surface = in_quadratics(surface)
    w = surface.weights
    if w is None or np.abs(w - np.outer(w[:, 0], w[0]) / w[0, 0]).max() > PRODUCT * w.max():
        return None
    found: list[Arcs | None] = []
    for d, p in enumerate(surface.degree):
        own = w[:, 0] if d == 0 else w[0]
        arcs = arcs_of(surface.knots[d], own) if p == 2 else None
        if arcs is None and (p > DEGREE or np.ptp(own) > PRODUCT * own.max()):
            return None
        found.append(arcs)
    share = tolerance / max(1, sum(arcs is not None for arcs in found))
    knots, control = list(surface.knots), surface.control
    counted: list[Arcs | None] = []
    for d, arcs in enumerate(found):
        if arcs is None:
            for p in range(surface.degree[d], DEGREE):
                knots[d], rows = elevation(knots[d], p)
                control = apply(rows, control, d)
            counted.append(None)
            continue
        own = np.moveaxis(control, d, 0)
        arcs = _counted(arcs, own, share)
        if arcs is None:
            return None
        knots[d], matrix = cubics_of(arcs, own)
        control = np.moveaxis(np.tensordot(matrix, own, axes=1), 0, d)
        counted.append(arcs)

    def there(uv: Array) -> Array:
        return np.stack([uv[:, d] if a is None else to_cubic(a, uv[:, d]) for d, a in enumerate(counted)], axis=1)

    def back(uv: Array) -> Array:
        return np.stack([uv[:, d] if a is None else from_cubic(a, uv[:, d]) for d, a in enumerate(counted)], axis=1)

    return Patch((knots[0], knots[1]), np.ascontiguousarray(control)), there, back
