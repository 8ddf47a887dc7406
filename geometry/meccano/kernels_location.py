"""Compiled parts of point location in simplices; see `parametrisation`."""

from __future__ import annotations

import numpy as np
from numba import njit

# mypy: disallow-untyped-defs = False

LEAF = 4


@njit(cache=True)
def tree_boxes(corners, order, leaves):
    """Boxes (2 leaves, 2, d) of a complete binary tree over the simplices in their order."""
    d = corners.shape[2]
    boxes = np.empty((2 * leaves, 2, d))
    boxes[:, 0] = np.inf
    boxes[:, 1] = -np.inf
    for k in range(len(order)):
        node = leaves + k // LEAF
        for v in range(d + 1):
            for i in range(d):
                x = corners[order[k], v, i]
                boxes[node, 0, i] = min(boxes[node, 0, i], x)
                boxes[node, 1, i] = max(boxes[node, 1, i], x)
    for node in range(leaves - 1, 0, -1):
        for i in range(d):
            boxes[node, 0, i] = min(boxes[2 * node, 0, i], boxes[2 * node + 1, 0, i])
            boxes[node, 1, i] = max(boxes[2 * node, 1, i], boxes[2 * node + 1, 1, i])
    return boxes


@njit(cache=True)
def _barycentric(corners, t, x, weights):
    """Barycentric coordinates of a point in simplex t; returns the smallest, -inf in a flat simplex."""
    d = corners.shape[2]
    if d == 2:
        ux, uy = corners[t, 1, 0] - corners[t, 0, 0], corners[t, 1, 1] - corners[t, 0, 1]
        vx, vy = corners[t, 2, 0] - corners[t, 0, 0], corners[t, 2, 1] - corners[t, 0, 1]
        wx, wy = x[0] - corners[t, 0, 0], x[1] - corners[t, 0, 1]
        det = ux * vy - uy * vx
        if det == 0.0:
            return -np.inf
        weights[1] = (wx * vy - wy * vx) / det
        weights[2] = (ux * wy - uy * wx) / det
        weights[0] = 1.0 - weights[1] - weights[2]
        return min(weights[0], weights[1], weights[2])
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
    wx, wy, wz = corners[t, 3, 0] - ax, corners[t, 3, 1] - ay, corners[t, 3, 2] - az
    px, py, pz = x[0] - ax, x[1] - ay, x[2] - az
    cx, cy, cz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
    det = ux * cx + uy * cy + uz * cz
    if det == 0.0:
        return -np.inf
    weights[1] = (px * cx + py * cy + pz * cz) / det
    ex, ey, ez = uy * pz - uz * py, uz * px - ux * pz, ux * py - uy * px
    weights[2] = (wx * ex + wy * ey + wz * ez) / det
    weights[3] = (vx * ex + vy * ey + vz * ez) / -det
    weights[0] = 1.0 - weights[1] - weights[2] - weights[3]
    return min(weights[0], weights[1], weights[2], weights[3])


@njit(cache=True)
def find(corners, order, boxes, points, slack):
    """Simplex (q,) that holds each point, -1 if a coordinate is below -slack in all, and coordinates (q, d + 1)."""
    d = corners.shape[2]
    leaves = len(boxes) // 2
    found = np.full(len(points), -1, dtype=np.int64)
    result = np.full((len(points), d + 1), np.nan)
    stack = np.empty(128, dtype=np.int64)
    weights = np.empty(d + 1)
    pad = slack * max(np.abs(boxes[1]).max(), 1e-300)
    for q in range(len(points)):
        best = -slack
        stack[0] = 1
        top = 0
        while top >= 0 and best < 0.0:
            node = stack[top]
            top -= 1
            inside = True
            for i in range(d):
                x = points[q, i]
                inside &= boxes[node, 0, i] - pad <= x and x <= boxes[node, 1, i] + pad
            if not inside:
                continue
            if node < leaves:
                stack[top + 1], stack[top + 2] = 2 * node, 2 * node + 1
                top += 2
                continue
            first = (node - leaves) * LEAF
            for k in range(first, min(first + LEAF, len(order))):
                least = _barycentric(corners, order[k], points[q], weights)
                if least > best or (found[q] < 0 and least >= -slack):
                    best = least
                    found[q] = order[k]
                    result[q] = weights
    return found, result
