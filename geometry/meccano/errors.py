"""How far the boundary of a solid is from the surface it should have, at samples of both.

Axis letters: f facet, q sample point, k sample of the surface, v vertex, t triangle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.skin import Skin, values_at
from geometry.simplices.closest import closest
from geometry.simplices.distance import samples
from geometry.simplices.surface import Surface, area_vectors

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_CUTS = 6
_LINE = np.linspace(0.0, 1.0, _CUTS + 1)
_NODES = np.stack(np.meshgrid(_LINE, _LINE, indexing="ij"), axis=-1).reshape(-1, 2)
_FIRST = (np.arange(_CUTS)[:, None] * (_CUTS + 1) + np.arange(_CUTS)).ravel()
_TRIANGLES = np.concatenate([
    np.stack([_FIRST, _FIRST + _CUTS + 1, _FIRST + 1], axis=1),
    np.stack([_FIRST + 1, _FIRST + _CUTS + 1, _FIRST + _CUTS + 2], axis=1),
])


@dataclass(frozen=True, eq=False)
class Errors:
    """How far a solid is from the surface, at samples of all facets.

    Attributes
    ----------
    away : (f,) largest distance of the solid's boundary from the surface.
    missed : (f,) largest distance of points of the surface from the solid's boundary. They count for the facet that is
        closest to them, or, where that is far, for the one that the map puts there.
    """

    away: Array
    missed: Array

    @property
    def worst(self) -> Array:
        """(f,)"""
        return np.maximum(self.away, self.missed)


def errors_of(skin: Skin, points: Array, aim: Array, there: Array, surface: Surface, far: float) -> Errors:
    """Measure a solid with control points (n, 3).

    Parameters
    ----------
    aim : (f q, 3) where the map puts samples of its facets.
    there : (k, 3) samples of the surface.
    far : distance of a limb that the boundary has not reached. What is missed by less is a matter of the facet that is
        closest: the boundary has slid away from where the map put it.
    """
    count = len(skin.cell)
    nodes, _ = tessellation(skin, points)
    away = closest(surface.points, surface.triangles, nodes)[1].reshape(count, -1).max(axis=1)
    facet, _, gap, _ = feet(skin, points, np.concatenate([aim, there]))
    mapped = np.repeat(np.arange(count), len(aim) // count)
    facet[: len(aim)] = np.where(gap[: len(aim)] > far, mapped, facet[: len(aim)])
    missed = np.zeros(count)
    np.maximum.at(missed, facet, gap)
    return Errors(away, missed)


@lru_cache(maxsize=4)
def surface_samples(surface: Surface, spacing: float) -> tuple[Array, Array]:
    """Points (k, 3) of the surface with at most that spacing, relative to its diagonal, and normals there."""
    points = samples(surface.points, surface.triangles, spacing * surface.diagonal)
    return points, unit_normals(surface)[closest(surface.points, surface.triangles, points)[2]]


def tessellation(skin: Skin, points: Array) -> tuple[Array, Index]:
    """Points (v, 3) and triangles (t, 3), outward, on all facets: the same number on each, facet by facet."""
    first = len(_NODES) * np.arange(len(skin.cell))
    return values_at(skin, _NODES) @ points, (first[:, None, None] + _TRIANGLES).reshape(-1, 3)


def feet(skin: Skin, points: Array, queries: Array) -> tuple[Index, Array, Array, Array]:
    """Facets (k,), u (k, 2) where the boundary is closest to points (k, 3), distances (k,), unit normals (k, 3)."""
    nodes, triangles = tessellation(skin, points)
    foot, gap, number = closest(nodes, triangles, queries)
    facet, local = np.divmod(number, len(_TRIANGLES))
    corners = nodes[triangles[number]]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    normals = np.cross(sides[:, :, 0], sides[:, :, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    weights = (np.linalg.pinv(sides) @ (foot - corners[:, 0])[:, :, None])[:, :, 0]
    places = _NODES[_TRIANGLES[local]]
    u = places[:, 0] + np.einsum("ks,ksd->kd", weights, places[:, 1:] - places[:, :1])
    return facet, np.clip(u, 0.0, 1.0), gap, normals


def unit_normals(surface: Surface) -> Array:
    """(t, 3)"""
    normals = area_vectors(surface)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)
