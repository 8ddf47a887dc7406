"""Whether one set of voxels can be turned into another without a change of topology on the way.

Equal genus is not enough: a polycube may have its handles where the solid has none. So the solid's own voxels, on a
fine grid, grow into the polycube and shrink to it, one simple voxel at a time: a voxel is simple if among the 18
voxels around it that share a face or an edge with it the set's have one part, connected through faces, that touches
it through a face, and among the 26 around it the others have one part, connected through faces, edges or corners
[G. Bertrand, G. Malandain, A new characterization of three-dimensional simple points, Pattern Recognition Letters 15
(1994) 169-175, doi:10.1016/0167-8655(94)90046-9]. Adding or removing a simple voxel keeps the topology. If the voxels
arrive at the polycube, it lies in space as the solid does; if they get stuck, it most likely does not.

Axis letters: i j k voxel.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Flags = NDArray[np.bool_]


def deforms(start: Flags, goal: Flags) -> bool:
    """Whether simple voxels lead from one set (i, j, k) to another."""
    current = np.pad(start, 1)
    return int(_deform(current, np.pad(goal, 1))) == 0


@njit(cache=True)
def _deform(current, goal):  # type: ignore[no-untyped-def]
    """Move the set towards the goal in place; voxels that still differ."""
    ni, nj, nk = current.shape
    level = np.zeros(current.shape, dtype=np.bool_)
    while True:
        moved = 0
        for grow in (True, False):
            while True:
                # Layer by layer, so that a front stays even: only voxels beside the front of the layer before.
                for i in range(ni):
                    for j in range(nj):
                        for k in range(nk):
                            level[i, j, k] = current[i, j, k]
                step = 0
                for i in range(1, ni - 1):
                    for j in range(1, nj - 1):
                        for k in range(1, nk - 1):
                            if goal[i, j, k] != grow or current[i, j, k] == grow:
                                continue
                            reached = level[i - 1, j, k] == grow or level[i + 1, j, k] == grow
                            reached |= level[i, j - 1, k] == grow or level[i, j + 1, k] == grow
                            reached |= level[i, j, k - 1] == grow or level[i, j, k + 1] == grow
                            if not reached:
                                continue
                            if simple(current[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2]):
                                current[i, j, k] = grow
                                step += 1
                moved += step
                if step == 0:
                    break
        if moved == 0:
            break
    return (current != goal).sum()


@njit(cache=True)
def simple(near):  # type: ignore[no-untyped-def]
    """Whether the middle of 3 x 3 x 3 voxels is simple."""
    seen = np.zeros((3, 3, 3), dtype=np.bool_)
    stack = np.empty((27, 3), dtype=np.int64)
    parts = np.zeros(2, dtype=np.int64)
    for kind in range(2):
        value = kind == 0
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    away = abs(i - 1) + abs(j - 1) + abs(k - 1)
                    if away == 0 or seen[i, j, k] or near[i, j, k] != value:
                        continue
                    if value and away != 1:
                        continue  # parts of the set are begun at the faces
                    parts[kind] += 1
                    seen[i, j, k] = True
                    stack[0] = i, j, k
                    top = 1
                    while top > 0:
                        top -= 1
                        a, b, c = stack[top]
                        for u in range(max(a - 1, 0), min(a + 2, 3)):
                            for v in range(max(b - 1, 0), min(b + 2, 3)):
                                for w in range(max(c - 1, 0), min(c + 2, 3)):
                                    middle = abs(u - 1) + abs(v - 1) + abs(w - 1)
                                    if middle == 0 or seen[u, v, w] or near[u, v, w] != value:
                                        continue
                                    if value and (middle == 3 or abs(u - a) + abs(v - b) + abs(w - c) != 1):
                                        continue
                                    seen[u, v, w] = True
                                    stack[top] = u, v, w
                                    top += 1
    return parts[0] == 1 and parts[1] == 1
