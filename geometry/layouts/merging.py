"""Sets of voxels on fewer planes: neighbouring layers become one where that changes little.

A meccano of many blocks starts with many cells and spends them where they are not needed. So while there are too many,
two neighbouring layers become one, as one or the other or both together are, whichever leaves least volume between the
set and the solid for each block saved, as long as the topology stays, layers are not too thick and the mismatch allows.

Axis letters: i j k voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.topology import topology
from geometry.layouts.voxels import Voxels, lies_like, shares
from geometry.simplices.surface import Surface, genus
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

THICKEST = 4
"""Most layers that become one."""
MOST = 150
"""Blocks of a pillowed meccano that will do; with more, layers of voxels are made one."""
MERGED = 0.6
"""Mismatch up to which that is done."""


@dataclass(frozen=True, eq=False)
class Layers:
    """A set of voxels of different sides.

    Attributes
    ----------
    inside : (i, j, k) the set.
    first : of each axis, the fine layer with which each layer begins, and the number of fine layers.
    """

    inside: Flags
    first: tuple[Index, Index, Index]


def expanded(layers: Layers) -> Flags:
    """The same set on the fine grid."""
    result = layers.inside
    for axis, first in enumerate(layers.first):
        result = np.repeat(result, np.diff(first), axis=axis)
    return result


def merged(surface: Surface, voxels: Voxels, progress: Progress = QUIET) -> tuple[Voxels, dict[str, Any]]:
    """Voxels in fewer layers, where there are too many for a meccano that is refined later.

    Parameters
    ----------
    voxels : of one size, with the topology of the solid inside the surface.

    Returns
    -------
    The voxels and a report: voxels, boundary_sides and mismatch.
    """
    handles = genus(surface)
    origin, spacing = np.array([line[0] for line in voxels.planes]), float(np.diff(voxels.planes[0][:2])[0])
    ni, nj, nk = (len(line) - 1 for line in voxels.planes)
    inside = np.zeros((ni, nj, nk), dtype=bool)
    inside[tuple(voxels.cells.T)] = True
    share = shares(surface, voxels.rotation, origin, spacing, (ni, nj, nk))

    def blocks(trial: Flags) -> int:
        found = topology(trial)
        sound = (found.pinched, found.parts, found.outsides, found.genus) == (0, 1, 1, handles)
        return int(trial.sum()) + found.faces if sound else 0

    progress.say("fewer layers of voxels")
    made = fewer_layers(inside, share, blocks, MOST, MERGED)
    if handles and not lies_like(surface, voxels.rotation, origin, spacing, expanded(made)):
        made = single(inside)
    x, y, z = (line[first] for line, first in zip(voxels.planes, made.first, strict=True))
    cells = np.argwhere(made.inside)
    report = {
        "voxels": len(cells), "boundary_sides": topology(made.inside).faces,
        "mismatch": mismatch(made, share),
    }
    return Voxels(cells, voxels.rotation, (x, y, z)), report


def fewer_layers(
    inside: Flags, share: Array, blocks: Callable[[Flags], int], most: int, limit: float
) -> Layers:
    """A set of voxels with fewer layers; with as many if the mismatch is above the limit already.

    Parameters
    ----------
    inside, share : (i, j, k) the set, and what part of each voxel the solid fills.
    blocks : number of blocks of the meccano of a set; 0 for a set that is not a solid of the right topology.
    most : blocks that will do.
    limit : volume between the set and the solid, as a share of the solid's, that will do.
    """
    ends = [np.flatnonzero(np.any(inside, axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    first: list[Index] = []
    for axis, found in enumerate(ends):
        # Empty layers outside are one.
        n = inside.shape[axis]
        first.append(np.unique(np.concatenate([[0], np.arange(found[0], found[-1] + 2), [n]])))
    layers = Layers(_reduced(inside, first), (first[0], first[1], first[2]))
    count, off = blocks(layers.inside), mismatch(layers, share)
    while count > most:
        best: tuple[float, int, float, Layers] | None = None
        for axis in range(3):
            for plane in range(2, len(layers.first[axis]) - 2):
                for made in _joined(layers, axis, plane):
                    number = blocks(made.inside)
                    now = mismatch(made, share)
                    if not 0 < number < count or now > limit:
                        continue
                    price = (now - off) / (count - number)
                    if best is None or price < best[0]:
                        best = price, number, now, made
        if best is None:
            break
        _, count, off, layers = best
    return layers


def _reduced(inside: Flags, first: list[Index]) -> Flags:
    """One of each group of layers that begin with ``first`` along each axis."""
    for axis, starts in enumerate(first):
        inside = np.take(inside, starts[:-1], axis=axis)
    return inside


def _joined(layers: Layers, axis: int, plane: int) -> list[Layers]:
    """Sets with the layers on both sides of a plane made one."""
    first = layers.first[axis]
    if first[plane + 1] - first[plane - 1] > THICKEST:
        return []
    below, above = (np.take(layers.inside, [row], axis=axis) for row in (plane - 1, plane))
    head, tail = np.split(layers.inside, [plane - 1, plane + 1], axis=axis)[::2]
    lines = list(layers.first)
    lines[axis] = np.delete(first, plane)
    return [
        Layers(np.concatenate([head, one, tail], axis=axis), (lines[0], lines[1], lines[2]))
        for one in (below, above, below | above, below & above)
    ]


def single(inside: Flags) -> Layers:
    """A set of voxels as it is."""
    x, y, z = (np.arange(n + 1) for n in inside.shape)
    return Layers(inside, (x, y, z))


def mismatch(layers: Layers, share: Array) -> float:
    """Volume between a set and a solid, as a share of the solid's; see `fewer_layers` for ``share``."""
    inside = expanded(layers)
    return float((np.where(inside, 1.0 - share, share)).sum() / share.sum())
