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

#: How near the middle, in radii of the disk, corners of the surface and creases attract corners of the patches.
NEAR_CORNER = 0.5
NEAR_CREASE = 0.35


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
    for border in progress.track(borders(layout.blocks), "borders on creases"):
        edges = layout.surface.edges[sharp(layout.surface)]
        on_crease = np.isin(layout.corner[list(border[:2])], edges)
        if on_crease.all():
            try:
                layout = straighten_border(layout, border, cut=True)
            except InputError:
                continue
    return layout
