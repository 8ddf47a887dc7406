r"""Springs between the boundary of a solid and the surface that it should have.

Each sample of the boundary is held by the point of the surface closest to it, across the surface, and each sample of
the surface pulls the boundary where that is closest to it, which draws limbs out and keeps their tips in place.

Closest points lie on the wrong sheet where the solid is still far off: a membrane between two ears is held by their
flanks, and never gives way. So a sheet is believed only if it faces the same way, within `FACING`, or if it is nearer
than the tolerance. Samples of the boundary then take the closest point among triangles that do, unless that is `BEYOND`
times as far: in a fold of the boundary some faces inwards, and would be drawn through the solid to its other side.

Samples without a sheet that they can believe follow the map of the boundary, which has the right topology: samples of
the boundary are drawn to where the map puts them, samples of the surface draw the point that the map puts there. These
springs pull in all directions alike, with a force that is bounded (the weights of Huber's norm), so that elements are
not crushed on long ways. Others do not: where the map is twisted, or has been slid away from, it would tear at what is
right.

Axis letters: n function, f facet, q sample point, k spring, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree

from geometry.meccano.errors import feet, surface_samples, unit_normals
from geometry.meccano.skin import Skin, facet_rule, outward, values_at, values_on
from geometry.simplices.closest import closest, closest_facing
from geometry.simplices.surface import Surface
from iga.tether import Tether

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SAMPLES = facet_rule(5)
"""Sample points (q, 2) of each facet."""

FACING = 0.5
"""Least cosine of the angle between normals of sheets that belong together."""

BEYOND = 4.0
"""Farthest sheet that is believed because it faces the right way, in distances of the closest one."""

ALONG = 0.01
"""What distances along the surface count."""

_SPACING = 0.02
_HOLD = 0.25
_LED = 0.1
_SIDES = 0.1


@dataclass(frozen=True, eq=False)
class _Pulls:
    """Springs from points A P to places; lost ones follow the map."""

    A: csr_array
    places: Array
    normals: Array
    weights: Array
    lost: Mask


def springs_to(
    surface: Surface, skin: Skin, tolerance: float, softness: float, aim: Array, free: Mask | None = None,
    led: bool = False,
) -> Callable[[Array], Tether]:
    """Springs for control points (n, 3).

    Parameters
    ----------
    tolerance : wanted distance; an energy of one is reached at a quarter of it, times ``softness``.
    softness : soft springs carry the boundary far, stiff ones bring it near.
    aim : (f q, 3) where the map puts samples of the facets.
    free : (n,) functions that may move, all by default; other facets have no springs.
    led : whether the map leads all samples a little.
    """
    hold = softness * tolerance
    there, normals = surface_samples(surface, _SPACING)
    facing = unit_normals(surface)
    touched = np.ones(len(skin.cell), dtype=bool) if free is None else _touched(skin, free)
    own = np.repeat(touched, len(SAMPLES))
    A, aims = csr_array(values_at(skin, SAMPLES)[own]), aim[own]

    def from_boundary(points: Array) -> _Pulls:
        x = A @ points
        near, triangle, lost = _believed(surface, x, outward(skin, points, SAMPLES)[own], tolerance)
        near[lost] = aims[lost]
        return _Pulls(A, near, facing[triangle], np.full(len(x), 1.0 / len(SAMPLES)), lost)

    def from_surface(points: Array) -> _Pulls:
        facet, u, missed, ways = feet(skin, points, there)
        lost = (missed > tolerance) & ((ways * normals).sum(axis=1) < FACING)
        if lost.any():
            sample = _laid_there(surface, aim, there[lost], normals[lost])
            facet[lost], u[lost] = sample // len(SAMPLES), SAMPLES[sample % len(SAMPLES)]
        each = np.bincount(facet, minlength=len(skin.cell))[facet]
        mine = touched[facet]
        B, places, across = values_on(skin, facet[mine], u[mine]), there[mine], normals[mine]
        # What is missed by far, the tip of a limb, pulls towards itself.
        far, way = missed[mine] > hold, places - B @ points
        across[far] = way[far] / np.linalg.norm(way[far], axis=1, keepdims=True)
        return _Pulls(B, places, across, 1.0 / each[mine], lost[mine])

    def springs(points: Array) -> Tether:
        pulls = [_bounded(made, points, hold) for made in (from_boundary(points), from_surface(points))]
        if led:
            weights = np.full(len(aims), _LED / ALONG / len(SAMPLES))
            pulls.append(_Pulls(A, aims, np.zeros_like(aims), weights, np.ones(len(aims), dtype=bool)))
        return Tether(
            csr_array(vstack([made.A for made in pulls])), np.concatenate([made.places for made in pulls]),
            np.concatenate([made.normals for made in pulls]),
            np.concatenate([made.weights for made in pulls]) / (_HOLD * hold) ** 2, ALONG,
        )

    return springs


def _bounded(pulls: _Pulls, points: Array, hold: float) -> _Pulls:
    """The same, but those lost pull in all directions alike, with no more force than at a distance of ``hold``."""
    lost = pulls.lost
    far = np.linalg.norm(pulls.A[lost] @ points - pulls.places[lost], axis=1)
    normals, weights = pulls.normals.copy(), pulls.weights.copy()
    normals[lost] = 0.0
    weights[lost] *= np.minimum(1.0, hold / np.maximum(far, 1e-300)) / ALONG
    return replace(pulls, normals=normals, weights=weights)


def _laid_there(surface: Surface, aim: Array, there: Array, normals: Array) -> Index:
    """Samples of the facets (k,) that the map puts (f q, 3) nearest to samples of the surface (k, 3), on its side."""
    facing = unit_normals(surface)[closest(surface.points, surface.triangles, aim)[2]]
    apart = _SIDES * surface.diagonal
    tree = cKDTree(np.hstack([aim, apart * facing]))
    return np.asarray(tree.query(np.hstack([there, apart * normals]))[1], dtype=np.int64)


def _touched(skin: Skin, free: Mask) -> Mask:
    """Facets (f,) that some of the functions move."""
    rows = values_at(skin, SAMPLES) @ free.astype(float) > 0.0
    return np.asarray(rows.reshape(len(skin.cell), -1).any(axis=1))


def _believed(surface: Surface, points: Array, ways: Array, near: float) -> tuple[Array, Index, Mask]:
    """Closest points (k, 3) of the surface, where these are farther than ``near`` those that face as the solid does.

    And their triangles, and which points have none.
    """
    found, gap, triangle = closest(surface.points, surface.triangles, points)
    lost = np.zeros(len(points), dtype=bool)
    odd = np.flatnonzero((gap > near) & ((unit_normals(surface)[triangle] * ways).sum(axis=1) < FACING))
    if len(odd):
        facing, far, there = closest_facing(surface.points, surface.triangles, points[odd], ways[odd], FACING)
        lost[odd] = there < 0
        other = (there < 0) | (far <= BEYOND * gap[odd])
        found[odd[other]], triangle[odd[other]] = facing[other], there[other]
    return found, triangle, lost
