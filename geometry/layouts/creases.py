"""Corners and borders of a division that lie on the creases of a surface.

A corner where sides of two directions meet belongs on a crease; one where three or more meet, rather on a corner of the
surface, where three creases meet. While corners are moved to the middle of the patches around them (`drawing`), such
places near the middle attract them. At last, borders between two corners on creases run along these.

Axis letters: v vertex of the surface or corner of the frame, f side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.frame import Frame
from geometry.layouts.layout import Layout, borders, straighten_border
from geometry.simplices.surface import Surface, sharp
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NEAR_CORNER, NEAR_CREASE = 0.5, 0.35
"""How near the middle, in radii of the disk, corners of the surface and creases attract corners of the patches."""


@dataclass(frozen=True, eq=False)
class Attraction:
    """What attracts the corners of a frame on a surface.

    Attributes
    ----------
    creases : (v,) creases that meet at each vertex of the surface.
    directions : (v,) different directions of the sides around each corner of the frame.
    """

    creases: Index
    directions: Index


def attraction(surface: Surface, frame: Frame) -> Attraction | None:
    """What attracts the corners of a frame on a surface; None if the surface has no creases."""
    edges = surface.edges[sharp(surface)]
    if not len(edges):
        return None
    creases = np.bincount(edges.ravel(), minlength=len(surface.points))
    corners = frame.places[frame.sides]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    kind = np.unique(normals.round(6), axis=0, return_inverse=True)[1].ravel()
    pairs = np.unique(np.stack([frame.sides.ravel(), np.repeat(kind, 4)], axis=1), axis=0)
    return Attraction(creases, np.bincount(pairs[:, 0], minlength=len(frame.places)))


def attracted(creases: Attraction | None, corner: int, vertices: Index, places: Array) -> Array:
    """How far (b,) vertices with places (b, 2) in the unit disk are from where a corner should lie; less is better."""
    distance = np.asarray((places**2).sum(axis=1))
    if creases is None or creases.directions[corner] < 2:
        return distance
    meeting = creases.creases[vertices]
    on_crease = (meeting > 1) & (distance < NEAR_CREASE**2)
    at_corner = (meeting > 2) & (distance < NEAR_CORNER**2) & (creases.directions[corner] > 2)
    return distance - on_crease - at_corner


def along_creases(layout: Layout, progress: Progress = QUIET) -> Layout:
    """Let borders between two corners on creases follow these, where that keeps the division a division."""
    points, triangles, side = layout.surface.points, layout.surface.triangles, layout.side
    creased = np.zeros(len(points), dtype=bool)
    creased[layout.surface.edges[sharp(layout.surface)]] = True
    for border in progress.track(borders(layout.blocks), "borders on creases"):
        a, b, f, g = border
        if f == g or not creased[layout.corner[[a, b]]].all():
            continue
        region = (side == f) | (side == g)
        used, local = _capped(points, triangles[region])
        capped = np.full(len(local.triangles), -1, dtype=np.int64)
        capped[: region.sum()] = side[region]
        corner = np.where(np.isin(layout.corner, used), np.searchsorted(used, layout.corner), -1)
        try:
            # Whether the surface has creases at all is known: the fan shall not count.
            made = straighten_border(Layout(layout.blocks, local, capped, corner), border, True, clean=0.0)
        except InputError:
            continue
        inner = made.side >= 0
        if len(inner) - inner.sum() != len(capped) - region.sum():
            continue
        new = made.surface.points[len(local.points) :]
        name = np.concatenate([used, [-1], len(points) + np.arange(len(new))])
        points = np.concatenate([points, new])
        triangles = np.concatenate([triangles[~region], name[made.surface.triangles[inner]]])
        side = np.concatenate([side[~region], made.side[inner]])
    return Layout(layout.blocks, Surface(points, triangles), side, layout.corner)


def _capped(points: Array, triangles: Index) -> tuple[Index, Surface]:
    """Vertices (u,) of some triangles, and these alone as a closed surface: with a fan around one more vertex."""
    used, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    tail, head = local.ravel(), np.roll(local, -1, axis=1).ravel()
    rim = ~np.isin(tail * len(used) + head, head * len(used) + tail)
    fan = np.stack([head[rim], tail[rim], np.full(rim.sum(), len(used))], axis=1)
    apex = points[used].mean(axis=0)
    return used, Surface(np.concatenate([points[used], apex[None]]), np.concatenate([local, fan]))
