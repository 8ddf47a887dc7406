"""Meccanos of any genus: a polycube with the topology of a solid, and its surface divided as the polycube's boundary.

The voxels come from `voxels`, rough places of corners and edges from `wrapping`, the edges from `routing`; `drawing`
makes them straight and even. On a surface with creases that is done twice, drawn to these and not, and the cheaper
division is taken. The division is then laid on the polycube's sides as any other (`boundary_map`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import polycube
from geometry.layouts.boundary_map import BoundaryMap, boundary_map
from geometry.layouts.creases import along_creases, attraction
from geometry.layouts.drawing import Drawing, layout_of, relax
from geometry.layouts.frame import frame_of
from geometry.layouts.layout import Layout, balance, by_labels
from geometry.layouts.merging import merged
from geometry.layouts.partition import price
from geometry.layouts.routing import route
from geometry.layouts.voxels import Voxels, place, voxelise
from geometry.layouts.wrapping import corner_vertices, wrap
from geometry.simplices.paths import refined
from geometry.simplices.surface import Surface, genus, sharp
from iga.errors import InputError
from iga.progress import QUIET, Progress

Index = NDArray[np.int64]

PER_SIDE = 200
"""Triangles at least for each side of the polycube, so that there is room for its edges."""
SLENDER = 0.1
"""Share inside from which on a voxel belongs to a polycube that follows thin limbs."""
THREAD = 0.03
"""The same for limbs much thinner than the voxels that are asked for."""
REACH = 0.6
"""Voxels' sides that the surface may be away from such a polycube."""
BEYOND = 1.0
"""Voxels along the longest axis by which finer ones are compared."""


def polycube_layout(
    surface: Surface, voxels: Voxels | None = None, sweeps: int = 8, progress: Progress = QUIET,
    labels: Index | None = None,
) -> tuple[Layout, dict[str, Any]]:
    """Divide a surface as the boundary of a polycube.

    Parameters
    ----------
    voxels : the polycube; None to let it be found (`voxelise`), on a surface with creases in few layers. Cuboids given
        by hand: see `voxels.cuboids`.
    sweeps : how often every corner is moved to the middle of the patches around it.
    labels : (t,) side of the polycube for each triangle, to give the whole division of given voxels by hand.

    Returns
    -------
    The division and a report: what `voxels.Fitted`, `merged` and `balance` say.

    Raises
    ------
    InputError : the polycube's boundary touches itself or has another genus than the surface, or its edges find no way.
    """
    report: dict[str, Any] = {}
    if voxels is None:
        fitted = voxelise(surface, progress=progress)
        voxels, report = fitted.voxels, fitted.report()
        if sharp(surface).any():
            voxels, fewer = merged(surface, voxels, progress)
            report |= fewer
    blocks = polycube(voxels.cells)
    frame = frame_of(blocks)
    if frame.genus != genus(surface):
        raise InputError(f"the polycube has genus {frame.genus}, but the surface has genus {genus(surface)}")
    if labels is not None:
        return by_labels(surface, blocks, labels), report
    fine, _ = refined(surface, PER_SIDE * len(frame.sides))
    guides = wrap(fine, frame, place(voxels, frame.places), voxels.size)
    corners = corner_vertices(fine, frame, guides)
    drawing = Drawing(frame, fine, corners, route(fine, frame, corners, guides, progress))
    layout = layout_of(relax(drawing, sweeps, progress), blocks)
    creases = attraction(fine, frame)
    if creases is not None:
        layout = _cheaper(layout, along_creases(layout_of(relax(drawing, sweeps, progress, creases), blocks), progress))
    return layout, report | balance(layout)


def _cheaper(plain: Layout, creased: Layout) -> Layout:
    """The division along creases, unless its map is dearer: where only some creases find a border."""
    try:
        return min(creased, plain, key=lambda layout: price(boundary_map(layout)[0]))
    except InputError:
        return plain


def slender_map(
    surface: Surface, limit: float = 10000.0, progress: Progress = QUIET, resolution: float | None = None
) -> tuple[BoundaryMap, dict[str, Any]]:
    """The map of a polycube that also follows limbs and wings thinner than its voxels.

    Corners are moved less often than in other polycubes: patches at the ends of limbs would swallow the limbs.

    Parameters
    ----------
    resolution : voxels along the solid's longest axis; None for the fewest that will do. Few voxels with a tenth inside
        may fill the room between legs, and then limbs are lost in the sides of one thick body; more of them, with less
        inside, tell legs apart.
    """
    if resolution is None:
        fitted = voxelise(surface, progress=progress, fullness=SLENDER, reach=REACH, beyond=BEYOND)
    else:
        fitted = voxelise(surface, resolution, progress=progress, fullness=THREAD)
    mapping, quality = polycube_map(surface, fitted.voxels, sweeps=2, limit=limit, progress=progress)
    return mapping, fitted.report() | quality


def polycube_map(
    surface: Surface, voxels: Voxels | None = None, sweeps: int = 8, limit: float = 10000.0, progress: Progress = QUIET,
    labels: Index | None = None,
) -> tuple[BoundaryMap, dict[str, Any]]:
    """The boundary map of a polycube onto a surface of any genus; see `polycube_layout` and `boundary_map`.

    Returns
    -------
    The map and the reports of the layout and of `boundary_map`.
    """
    layout, report = polycube_layout(surface, voxels, sweeps, progress, labels)
    mapping, quality = boundary_map(layout, limit, progress)
    return mapping, report | quality
