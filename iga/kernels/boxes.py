"""Compiled kernel of point location: elements whose bounding boxes are near a point.

Boxes form a complete binary tree in an array: node i has the children 2i and 2i + 1, leaves hold LEAF elements each.

Axis letters: p point, e element, d direction.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from iga.kernels.options import PLAIN

LEAF = 4
"""Elements in a leaf of the tree."""


@njit(**PLAIN)
def query(low, high, first_leaf, order, boxes_low, boxes_high, points, radius, first, last, start, found, key):
    """Elements whose box is within ``radius`` (p,) of each point; counts them, or writes them if ``found`` has room.

    Parameters
    ----------
    low, high : (nodes, 3) boxes of the tree; ``order`` (e,) elements along the leaves; ``first_leaf`` the first leaf.
    boxes_low, boxes_high : (e, 3) boxes of the elements.
    start : (p + 1,) counts go to start[p + 1]; when writing, where each point's entries begin.
    found, key : elements, and what to sort them by: the distance of the box, or inside it (negative) the closeness of
        the point to its centre.
    """
    stack = np.empty(128, dtype=np.int64)
    writing = len(found) > 0
    for p in range(first, last):
        limit = radius[p] * radius[p]
        count = 0
        stack[0] = 1
        top = 0
        while top >= 0:
            node = stack[top]
            top -= 1
            distance = 0.0
            for d in range(3):
                gap = max(low[node, d] - points[p, d], points[p, d] - high[node, d], 0.0)
                distance += gap * gap
            if not distance <= limit:
                continue
            if node < first_leaf:
                stack[top + 1] = 2 * node
                stack[top + 2] = 2 * node + 1
                top += 2
                continue
            for i in range((node - first_leaf) * LEAF, min((node - first_leaf + 1) * LEAF, len(order))):
                e = order[i]
                distance, inside = 0.0, 0.0
                for d in range(3):
                    a, b = boxes_low[e, d], boxes_high[e, d]
                    gap = max(a - points[p, d], points[p, d] - b, 0.0)
                    distance += gap * gap
                    inside = max(inside, abs(2.0 * points[p, d] - a - b) / max(b - a, 1e-300))
                if distance <= limit:
                    if writing:
                        found[start[p] + count] = e
                        key[start[p] + count] = np.sqrt(distance) if distance > 0.0 else inside - 1.0
                    count += 1
        if not writing:
            start[p + 1] = count
