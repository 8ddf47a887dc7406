"""What a set of voxels is, as a shape: its parts, its holes, and whether its boundary is a manifold.

The boundary of a set of voxels is a manifold if and only if at every grid point the voxels of the set are
connected through faces among the eight around it, and so are the others. Then it has twice as many edges as faces,
so its Euler characteristic is (points) - (faces).

Axis letters: i j k voxel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Topology:
    """What a set of voxels is, as a shape.

    Attributes
    ----------
    pinched : grid points at which the boundary is not a manifold.
    parts, outsides : components of the set and of its complement, connected through faces.
    genus : of the boundary; meaningful if nothing is pinched and there is one part and one outside.
    faces : faces on the boundary.
    """

    pinched: int
    parts: int
    outsides: int
    genus: int
    faces: int


def topology(inside: Flags) -> Topology:
    """The topology of a set of voxels (i, j, k); a layer of empty voxels is added around it."""
    return Topology(*(int(value) for value in topology_of(np.pad(inside, 1), smooth_points())))


@cache
def smooth_points() -> Flags:
    """(256,) whether the boundary is a manifold at a grid point with these voxels of the eight around it."""
    connected = _connected_among_eight()
    smooth = connected & connected[::-1]
    smooth.setflags(write=False)
    return smooth


def _connected_among_eight() -> Flags:
    """(256,) whether these voxels of the eight around a grid point are connected through faces."""
    result = np.ones(256, dtype=bool)
    for pattern in range(256):
        members = [v for v in range(8) if pattern >> v & 1]
        if members:
            reached, front = {members[0]}, [members[0]]
            while front:
                v = front.pop()
                for bit in (1, 2, 4):
                    if v ^ bit in members and v ^ bit not in reached:
                        reached.add(v ^ bit)
                        front.append(v ^ bit)
            result[pattern] = len(reached) == len(members)
    return result


@njit(cache=True)
def topology_of(inside, smooth):  # type: ignore[no-untyped-def]
    """Numbers of `Topology`, for a set with a layer of empty voxels around it."""
    ni, nj, nk = inside.shape
    pinched, points, faces = 0, 0, 0
    for i in range(ni - 1):
        for j in range(nj - 1):
            for k in range(nk - 1):
                pattern = 0
                for v in range(8):
                    if inside[i + (v >> 2), j + (v >> 1 & 1), k + (v & 1)]:
                        pattern |= 1 << v
                if 0 < pattern < 255:
                    points += 1
                    pinched += not smooth[pattern]
                here = inside[i, j, k]
                faces += here != inside[i + 1, j, k]
                faces += here != inside[i, j + 1, k]
                faces += here != inside[i, j, k + 1]
    parts = np.zeros(2, dtype=np.int64)
    seen = np.zeros(inside.shape, dtype=np.bool_)
    stack = np.empty((inside.size, 3), dtype=np.int64)
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                if seen[i, j, k]:
                    continue
                value = inside[i, j, k]
                parts[1 if value else 0] += 1
                seen[i, j, k] = True
                stack[0] = i, j, k
                top = 1
                while top > 0:
                    top -= 1
                    a, b, c = stack[top]
                    for axis in range(3):
                        for step in (-1, 1):
                            u = a + (step if axis == 0 else 0)
                            v = b + (step if axis == 1 else 0)
                            w = c + (step if axis == 2 else 0)
                            if 0 <= u < ni and 0 <= v < nj and 0 <= w < nk and not seen[u, v, w] \
                                    and inside[u, v, w] == value:
                                seen[u, v, w] = True
                                stack[top] = u, v, w
                                top += 1
    return pinched, parts[1], parts[0], 1 - (points - faces) // 2, faces


@njit(cache=True)
def defects_of(inside, smooth, genus):  # type: ignore[no-untyped-def]
    """How far a set is from being a solid of the given genus; 0 if it is one."""
    pinched, parts, outsides, found, _ = topology_of(inside, smooth)
    return pinched + 2 * (parts - 1) + 2 * (outsides - 1) + abs(found - genus)
