r"""Springs between the boundary of a solid and the surface that it should have.

Each sample of the boundary is held by the point of the surface closest to it, across the surface, and each sample of
the surface pulls the boundary where that is closest to it, which draws limbs out and keeps their tips in place.

Closest points lie on the wrong sheet where the solid is still far off: a membrane between two ears is held by their
flanks, and never gives way. So a sheet is believed only if it faces the same way, within `FACING`, or if it is nearer
than the tolerance. Samples of the boundary then take the closest point among triangles that do; samples of the surface
wait.

Axis letters: n function, f facet, q sample point, k spring, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

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

ALONG = 0.01
"""What distances along the surface count."""

_SPACING = 0.02
_HOLD = 0.25
_LED = 0.1


def springs_to(
    surface: Surface, skin: Skin, tolerance: float, softness: float, aim: Array | None = None, free: Mask | None = None
) -> Callable[[Array], Tether]:
    """Springs for control points (n, 3).

    Parameters
    ----------
    tolerance : wanted distance; an energy of one is reached at a quarter of it, times ``softness``.
    softness : soft springs carry the boundary far, stiff ones bring it near.
    aim : (f q, 3) where the map puts samples of the facets; if given, it leads them there as well.
    free : (n,) functions that may move, all by default; other facets have no springs.
    """
    hold = softness * tolerance
    there, normals = surface_samples(surface, _SPACING)
    touched = np.ones(len(skin.cell), dtype=bool) if free is None else _touched(skin, free)
    own = np.repeat(touched, len(SAMPLES))
    A = csr_array(values_at(skin, SAMPLES)[own])

    def springs(points: Array) -> Tether:
        near, triangle = _believed(surface, A @ points, outward(skin, points, SAMPLES)[own], tolerance)
        facet, u, missed, ways = feet(skin, points, there)
        each = np.bincount(facet, minlength=len(skin.cell))[facet]
        trusted = touched[facet] & ((missed <= tolerance) | ((ways * normals).sum(axis=1) >= FACING))
        B = values_on(skin, facet[trusted], u[trusted])
        places, across = there[trusted], normals[trusted]
        # What is missed by far, the tip of a limb, pulls towards itself.
        far, way = missed[trusted] > hold, places - B @ points
        across[far] = way[far] / np.linalg.norm(way[far], axis=1, keepdims=True)
        made = Tether(
            csr_array(vstack([A, B])), np.concatenate([near, places]),
            np.concatenate([unit_normals(surface)[triangle], across]),
            np.concatenate([(triangle >= 0) / len(SAMPLES), 1.0 / each[trusted]]) / (_HOLD * hold) ** 2, ALONG,
        )
        return made if aim is None else _led(made, A, aim[own], _LED / ALONG / len(SAMPLES) / (_HOLD * hold) ** 2)

    return springs


def _led(tether: Tether, A: csr_array, aim: Array, weight: float) -> Tether:
    """Springs that lead samples A P to places (k, 3) as well."""
    return replace(
        tether, A=csr_array(vstack([tether.A, A])), places=np.concatenate([tether.places, aim]),
        normals=np.concatenate([tether.normals, np.zeros_like(aim)]),
        weights=np.concatenate([tether.weights, np.full(len(aim), weight)]),
    )


def _touched(skin: Skin, free: Mask) -> Mask:
    """Facets (f,) that some of the functions move."""
    rows = values_at(skin, SAMPLES) @ free.astype(float) > 0.0
    return np.asarray(rows.reshape(len(skin.cell), -1).any(axis=1))


def _believed(surface: Surface, points: Array, ways: Array, near: float) -> tuple[Array, Index]:
    """Closest points (k, 3) of the surface that are nearer than ``near`` or face as the solid does, and triangles.

    Triangle -1 where there is none.
    """
    found, gap, triangle = closest(surface.points, surface.triangles, points)
    agree = (unit_normals(surface)[triangle] * ways).sum(axis=1)
    odd = np.flatnonzero((gap > near) & (agree < FACING))
    if len(odd):
        place, _, own = closest_facing(surface.points, surface.triangles, points[odd], ways[odd], FACING)
        found[odd], triangle[odd] = np.where(own[:, None] >= 0, place, points[odd]), own
    return found, triangle
