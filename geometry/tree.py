"""A binary tree of bounding boxes, in any dimension: sets are halved at the median of their longest side.

Axis letters: i box, n node of the tree, d dimension.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAF = 4
"""Boxes in a leaf."""


class Tree(NamedTuple):
    """A tree; node 0 is the root.

    Attributes
    ----------
    order : (i,) boxes in the order of the leaves.
    lower, upper : (n, d) box around all boxes of each node.
    begin, end : (n,) slice of ``order``.
    child : (n,) first of two children that follow each other, or -1 for a leaf.
    """

    order: Index
    lower: Array
    upper: Array
    begin: Index
    end: Index
    child: Index


def tree_of(lower: Array, upper: Array) -> Tree:
    """Tree of the boxes between corners ``lower`` and ``upper``, each (i, d)."""
    return Tree(*_build(np.ascontiguousarray(lower), np.ascontiguousarray(upper)))


def triangle_tree(corners: Array) -> Tree:
    """Tree of the bounding boxes of triangles (t, 3, d)."""
    return tree_of(corners.min(axis=1), corners.max(axis=1))


@njit(cache=True)
def _build(lower: Array, upper: Array) -> tuple[Index, Array, Array, Index, Index, Index]:
    count, dim = lower.shape
    order = np.arange(count)
    size = max(2 * count, 1)
    low, high = np.empty((size, dim)), np.empty((size, dim))
    begin, end = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
    child = np.full(size, -1, dtype=np.int64)
    end[0] = count
    nodes, todo = 1, 0
    while todo < nodes:
        a, b = begin[todo], end[todo]
        for d in range(dim):
            low[todo, d], high[todo, d] = np.inf, -np.inf
            for k in range(a, b):
                low[todo, d] = min(low[todo, d], lower[order[k], d])
                high[todo, d] = max(high[todo, d], upper[order[k], d])
        if b - a > LEAF:
            axis = 0
            for d in range(1, dim):
                if high[todo, d] - low[todo, d] > high[todo, axis] - low[todo, axis]:
                    axis = d
            part = order[a:b].copy()
            order[a:b] = part[np.argsort(lower[part, axis] + upper[part, axis])]
            half = (a + b) // 2
            child[todo] = nodes
            begin[nodes], end[nodes] = a, half
            begin[nodes + 1], end[nodes + 1] = half, b
            nodes += 2
        todo += 1
    return order, low[:nodes], high[:nodes], begin[:nodes], end[:nodes], child[:nodes]
