r"""Volumes from planar patches: extrusion along z and revolution about the z axis; exact circular arcs.

A circular arc of half-angle h <= 45 degrees is the rational quadratic with weights 1, cos h, 1 whose middle control
point lies at distance r / cos h (Piegl and Tiller, The NURBS Book, section 7.3). Revolution multiplies every
homogeneous control point (w x, w y, w) of a profile by the arc's, so the product is exact. Profiles are patches with
two directions in the plane z = 0, right-handed in (x, y).

Axis letters: d direction, n control point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.patch import Patch, from_homogeneous, homogeneous
from iga.errors import InputError

Array = NDArray[np.float64]


def arc(angle: float) -> tuple[Array, Array]:
    """Unit arc from angle 0: knots, and homogeneous points (n, 3) as (w cos, w sin, w).

    Parameters
    ----------
    angle : in degrees, 0 < angle <= 360; one segment for each started 90 degrees.
    """
    if not 0 < angle <= 360:
        raise InputError(f"an angle of {angle:g} degrees is not in (0, 360]")
    segments = int(np.ceil(angle / 90 - 1e-12))
    turn = np.deg2rad(np.arange(2 * segments + 1) * (angle / (2 * segments)))
    points = np.column_stack([np.cos(turn), np.sin(turn), np.ones_like(turn)])
    points[np.abs(points) < 1e-15] = 0.0
    points[1::2, 2] = np.cos(np.deg2rad(angle / (2 * segments)))
    if angle == 360:
        points[-1] = points[0]
    inner = np.repeat(np.arange(1, segments) / segments, 2)
    return np.concatenate([np.zeros(3), inner, np.ones(3)]), points


def line(low: float, high: float) -> tuple[Array, Array]:
    """Knots and values (2,) of a straight direction."""
    return np.array([0.0, 0.0, 1.0, 1.0]), np.array([low, high])


def extrude(profile: Patch, low: float, high: float) -> Patch:
    """Volume of a planar profile between two heights; the new direction is the third."""
    knots, z = line(low, high)
    control = np.repeat(profile.control[:, :, None], 2, axis=2)
    control[..., 2] = z
    weights = None if profile.weights is None else np.repeat(profile.weights[:, :, None], 2, axis=2)
    return Patch((*profile.knots, knots), control, weights)


def revolve(profile: Patch, angle: float) -> Patch:
    """Volume swept by a profile in x > 0 turned about the z axis, its y becoming height; the new direction is second.

    The directions (profile 0, angle, profile 1) are right-handed for a right-handed profile.
    """
    knots, turn = arc(angle)
    flat = homogeneous(profile)  # (n1, n2, 4): w x, w y, 0, w
    n1, n2 = flat.shape[:2]
    values = np.empty((n1, len(turn), n2, 4))
    # Homogeneous products: the arc's rows are (w cos, w sin, w) already.
    values[..., 0] = flat[:, None, :, 0] * turn[None, :, None, 0]
    values[..., 1] = flat[:, None, :, 0] * turn[None, :, None, 1]
    values[..., 2] = flat[:, None, :, 1] * turn[None, :, None, 2]
    values[..., 3] = flat[:, None, :, 3] * turn[None, :, None, 2]
    return from_homogeneous((profile.knots[0], knots, profile.knots[1]), values)


def rectangle(x0: float, x1: float, y0: float, y1: float) -> Patch:
    """Bilinear rectangle in the plane."""
    return quadrilateral(np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]]))


def quadrilateral(corners: Array) -> Patch:
    """Bilinear patch in the plane with corners (4, 2) at parameters 00, 01, 10, 11."""
    control = np.zeros((2, 2, 3))
    control[..., :2] = corners.reshape(2, 2, 2)
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return Patch((knots, knots), control)


def ruled(first: tuple[Array, Array, Array], second: tuple[Array, Array, Array]) -> Patch:
    """Planar patch between two curves (knots, points (n, 2), weights (n,)) of equal knots; first direction across."""
    control = np.zeros((2, len(first[1]), 3))
    control[0, :, :2], control[1, :, :2] = first[1], second[1]
    return Patch((np.array([0.0, 0.0, 1.0, 1.0]), first[0]), control, np.stack([first[2], second[2]]))


def disc(radius: float, core: float) -> list[Patch]:
    """Disc of five patches: a square whose corners lie at ``core`` of the radius, and four around it."""
    s = radius * core / np.sqrt(2.0)
    patches = [quadrilateral(np.array([[-s, -s], [-s, s], [s, -s], [s, s]]))]
    knots, quarter = arc(90)
    for side in range(4):
        turn = np.deg2rad(-45.0 + 90.0 * side)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        outer = radius * (quarter[:, :2] / quarter[:, 2:]) @ rotation.T
        ends = radius * core * quarter[[0, 2], :2] @ rotation.T
        inner = np.stack([ends[0], 0.5 * (ends[0] + ends[1]), ends[1]])
        patches.append(ruled((knots, inner, np.ones(3)), (knots, outer, quarter[:, 2])))
    return patches
