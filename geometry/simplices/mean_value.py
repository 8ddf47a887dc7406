r"""Floater's mean value parametrisation: a disk of triangles laid injectively onto a convex polygon.

Boundary vertices are given; each inner vertex i is a convex combination of its neighbours j with weights

    w_ij = (tan(alpha / 2) + tan(beta / 2)) / |x_j - x_i|,

alpha and beta the angles at i on either side of the edge [M. Floater, Mean value coordinates, CAGD 20 (2003) 19-27].
Positive weights and a convex polygon make the map one to one, if no inner edge joins two vertices of one side of the
polygon (`paths.without_chords` splits those).

Long limbs shrink exponentially in such a map. Rounds of reweighting [S. Yoshizawa, A. Belyaev, H.-P. Seidel, A fast
and simple stretch-minimizing mesh parameterization, SMI 2004] divide w_ij by a power of the stretch at j, the root mean
square of the singular values of plane -> surface around it, which widens what is too small; weights stay positive.

Axis letters: v vertex, t triangle, b boundary vertex.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from geometry.simplices.surface import doubled_normals
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DAMPING = 0.5
"""Power of the stretch in one round; whole powers overshoot, and give up angles for areas."""
EXCEPTION = 1e-3
"""Share of a patch's area that may stretch more than the limit."""


def mean_value(
    points: Array, triangles: Index, loop: Index, targets: Array, rounds: int = 0, limit: float = 1.0
) -> Array:
    """Places (v, 2) of all vertices in the plane.

    Parameters
    ----------
    points, triangles : (v, 3) and (t, 3), a disk; vertices in no triangle get (nan, nan).
    loop : (b,) its boundary vertices.
    targets : (b, 2) their places on a convex polygon.
    rounds : most rounds of reweighting against stretch. They end when the root mean square of the stretch grows.
    limit : they also end when the area in space per area in the plane, relative to the whole disk's, exceeds this
        on a thousandth of the disk only: angles are better the fewer rounds there are.

    Raises
    ------
    InputError : the triangles do not form a disk with that boundary, so that the equations are singular.
    """
    places = np.full((len(points), 2), np.nan)
    places[loop] = targets
    inner = np.setdiff1d(triangles, loop)
    if not len(inner):
        return places
    tail, head, weight = _weights(points, triangles)
    row = np.full(len(points), -1, dtype=np.int64)
    row[inner] = np.arange(len(inner))
    keep = row[tail] >= 0
    tail, head, weight = tail[keep], head[keep], weight[keep]
    best, least = places, np.inf
    areas = _areas(points[triangles])
    for k in range(rounds + 1):
        trial = places.copy()
        trial[inner] = _solve(row, tail, head, weight, places, len(inner))
        if rounds == 0:
            return trial
        squares = _squared_stretch(points[triangles], trial[triangles])
        total = float(areas @ squares)
        if not total < least:
            break
        best, least = trial, total
        if _exceeds(areas, signed_areas(trial[triangles]), limit) <= EXCEPTION:
            break
        if k < rounds:
            share = np.bincount(triangles.ravel(), np.repeat(areas, 3), len(points))
            stretch = np.bincount(triangles.ravel(), np.repeat(areas * squares, 3), len(points))
            stretch = np.sqrt(stretch / np.where(share > 0, share, 1.0))
            weight = weight / stretch[head] ** DAMPING
    return best


def _weights(points: Array, triangles: Index) -> tuple[Index, Index, Array]:
    """Directed edges (tail, head) and their mean value weights, one entry per triangle and edge end."""
    corners = points[triangles]
    right = np.roll(corners, -1, axis=1) - corners
    left = np.roll(corners, 1, axis=1) - corners
    a, b = np.linalg.norm(right, axis=2), np.linalg.norm(left, axis=2)
    half = np.linalg.norm(np.cross(right, left), axis=2) / np.maximum(a * b + (right * left).sum(axis=2), 1e-300)
    half = np.clip(half, 1e-8, 1e8)
    tail = np.concatenate([triangles.ravel()] * 2)
    head = np.concatenate([np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, 1, axis=1).ravel()])
    return tail, head, np.concatenate([(half / a).ravel(), (half / b).ravel()])


def _solve(row: Index, tail: Index, head: Index, weight: Array, places: Array, size: int) -> Array:
    """Places (size, 2) of the inner vertices."""
    total = np.bincount(row[tail], weight, size)
    weight = weight / total[row[tail]]
    free = row[head] >= 0
    entries = np.concatenate([np.ones(size), -weight[free]])
    rows = np.concatenate([np.arange(size), row[tail[free]]])
    columns = np.concatenate([np.arange(size), row[head[free]]])
    matrix = csc_array(coo_array((entries, (rows, columns)), shape=(size, size)))
    fixed = ~free
    right = np.stack(
        [np.bincount(row[tail[fixed]], weight[fixed] * places[head[fixed], c], size) for c in (0, 1)], axis=1
    )
    try:
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return np.asarray(factors.solve(right))
    except RuntimeError:
        raise InputError("a patch of the surface is no disk: its parametrisation has no unique solution") from None


def _exceeds(space: Array, plane: Array, limit: float) -> float:
    """Share of the area in space that is stretched beyond the limit."""
    much = space * plane.sum() > limit * plane * space.sum()
    return float(space[much].sum() / space.sum())


def _areas(corners: Array) -> Array:
    """Areas (t,) of triangles in space (t, 3, 3)."""
    return np.asarray(np.linalg.norm(doubled_normals(corners), axis=1) / 2.0)


def signed_areas(corners: Array) -> Array:
    """Areas (t,) of plane triangles (t, 3, 2), negative if clockwise."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2.0


def _squared_stretch(space: Array, plane: Array) -> Array:
    """Mean square (t,) of the singular values of the affine maps from plane triangles to those in space."""
    twice = 2.0 * signed_areas(plane)
    s, t = plane[..., 0], plane[..., 1]
    turn = np.array([1, 2, 0])
    other = turn[turn]
    ds = np.einsum("tk,tkd->td", t[:, turn] - t[:, other], space)
    dt = np.einsum("tk,tkd->td", s[:, other] - s[:, turn], space)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = ((ds**2).sum(axis=1) + (dt**2).sum(axis=1)) / (2.0 * twice**2)
    return np.where(twice > 0, square, np.inf)


def area_stretch(points: Array, triangles: Index, plane: Array) -> Array:
    """Area in space per area in the plane (t,), relative to that of the whole patch; plane is (t, 3, 2)."""
    space = _areas(points[triangles])
    flat = signed_areas(plane)
    with np.errstate(divide="ignore"):
        return (space / flat) / (space.sum() / flat.sum())


def flipped(plane: Array) -> Index:
    """Triangles of a plane map (t, 3, 2) whose area is not positive, decided exactly.

    Floating point decides where its error bound allows, rational arithmetic elsewhere.
    """
    one, two = plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]
    first, second = one[:, 0] * two[:, 1], one[:, 1] * two[:, 0]
    unsure = ~(np.abs(first - second) > 4e-16 * 4 * (np.abs(first) + np.abs(second)))
    bad = first - second <= 0
    for t in np.flatnonzero(unsure):
        if not np.isfinite(plane[t]).all():
            bad[t] = True
            continue
        (ax, ay), (bx, by), (cx, cy) = [[Fraction(float(x)) for x in corner] for corner in plane[t]]
        bad[t] = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0
    return np.flatnonzero(bad)
