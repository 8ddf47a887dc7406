"""The boundary of a meccano as a surface of quadrilaterals, with the order of edges around its corners.

A layout places the corners on a solid's surface and draws the edges there without crossings. If at every corner the
edges leave in the frame's cyclic order and the surface has the frame's genus, then what lies between the edges are
disks, one for each side, each bordered by its four edges. For with V corners, E edges and F sides, a strip around the
drawn edges has F borders, so the Euler characteristics of the regions sum to 2 - 2g - (V - E) = F; there are at most F
regions, each with a border and hence of characteristic at most 1: they are F disks.

Axis letters: f boundary side, v corner, p edge, j place in the cyclic order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks
from geometry.layouts.layout import round_corners
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Frame:
    """The boundary sides of a meccano.

    Attributes
    ----------
    names : (v,) the corners' numbers in the meccano.
    places : (v, 3) corners in the straight picture.
    sides : (f, 4) corners of each side, counter-clockwise seen from outside; the first is s = (0, 0), the next (1, 0).
    ends : (p, 2) corners of each edge, ascending.
    side_edges : (f, 4) edge from corner i to corner i + 1 of each side.
    side_forward : (f, 4) whether the side follows that edge from its lower corner to its higher one.
    """

    names: Index
    places: Array
    sides: Index
    ends: Index
    side_edges: Index
    side_forward: NDArray[np.bool_]

    @cached_property
    def genus(self) -> int:
        """Genus of the boundary."""
        return 1 - (len(self.places) - len(self.ends) + len(self.sides)) // 2

    @cached_property
    def around(self) -> tuple[Index, ...]:
        """For each corner its edges, counter-clockwise seen from outside."""
        # In a side the edge that leaves the corner is followed, counter-clockwise, by the edge that arrives there.
        leaving = self.side_edges.ravel()
        arriving = np.roll(self.side_edges, 1, axis=1).ravel()
        corner = self.sides.ravel()
        result = []
        order = np.argsort(corner, kind="stable")
        bounds = np.searchsorted(corner[order], np.arange(len(self.places) + 1))
        for v in range(len(self.places)):
            here = order[bounds[v] : bounds[v + 1]]
            after = dict(zip(leaving[here].tolist(), arriving[here].tolist(), strict=True))
            cycle = [int(leaving[here[0]])]
            while after[cycle[-1]] != cycle[0] and len(cycle) <= len(here):
                cycle.append(after[cycle[-1]])
            if len(cycle) != len(here):
                raise InputError(f"the meccano's boundary touches itself at corner {self.places[v].tolist()}")
            result.append(np.array(cycle, dtype=np.int64))
        return tuple(result)


def frame_of(blocks: Blocks) -> Frame:
    """The frame of a meccano.

    Raises
    ------
    InputError : the boundary touches itself along an edge or at a corner, or is not one piece.
    """
    used, corners = np.unique(round_corners(blocks), return_inverse=True)
    corners = corners.reshape(-1, 4)
    both = np.stack((corners, np.roll(corners, -1, axis=1)), axis=2)
    ends, number, members = np.unique(
        np.sort(both.reshape(-1, 2), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    places = blocks.places[used]
    if (members != 2).any():
        where = places[ends[members.argmax()]].tolist()
        raise InputError(f"the meccano's boundary touches itself along the edge from {where[0]} to {where[1]}")
    frame = Frame(used, places, corners, ends, number.reshape(-1, 4), both[:, :, 0] < both[:, :, 1])
    _ = frame.around  # raises where the boundary touches itself at a corner
    return frame
