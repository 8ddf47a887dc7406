"""Closest points of a triangulation, exact, by a tree of bounding boxes.

Axis letters: v vertex, t triangle, q query point.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.simplices.surface import doubled_normals
from geometry.tree import Tree, triangle_tree

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def closest(points: Array, triangles: Index, queries: Array) -> tuple[Array, Array, Index]:
    """Closest points (q, 3) of a triangulation to query points (q, 3), their distances (q,) and triangles (q,)."""
    corners, none = np.ascontiguousarray(points[triangles]), np.empty((0, 3))
    return _closest(corners, triangle_tree(corners), np.ascontiguousarray(queries), none, none, -1.0)


def closest_facing(
    points: Array, triangles: Index, queries: Array, ways: Array, cosine: float
) -> tuple[Array, Array, Index]:
    """As `closest`, among triangles whose normal makes an angle of at least that cosine with the query's unit vector.

    Parameters
    ----------
    ways : (q, 3) unit vectors.

    Returns
    -------
    Points, distances and triangles; NaN, infinite distance and triangle -1 where no triangle faces that way.
    """
    corners = np.ascontiguousarray(points[triangles])
    normals = doubled_normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return _closest(corners, triangle_tree(corners), np.ascontiguousarray(queries), normals, ways, cosine)


@njit(cache=True)
def _gap(tree: Tree, node: int, x: Array) -> float:
    """Squared distance of a point from a node's box."""
    total = 0.0
    for d in range(3):
        gap = max(tree.lower[node, d] - x[d], 0.0, x[d] - tree.upper[node, d])
        total += gap * gap
    return total


@njit(cache=True)
def _on_triangle(corners: Array, x: Array, y: Array) -> float:
    """Closest point of a triangle to x, left in y, and its squared distance (Ericson, 2005, 5.1.5)."""
    a, b, c = corners[0], corners[1], corners[2]
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = b[k] - a[k], c[k] - a[k]
        d1 += ab * (x[k] - a[k])
        d2 += ac * (x[k] - a[k])
        d3 += ab * (x[k] - b[k])
        d4 += ac * (x[k] - b[k])
        d5 += ab * (x[k] - c[k])
        d6 += ac * (x[k] - c[k])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    u, v = 0.0, 0.0
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        u = 1.0
    elif d6 >= 0 and d5 <= d6:
        v = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        u = d1 / (d1 - d3)
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v = d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        v = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        u = 1.0 - v
    else:
        total = va + vb + vc
        u, v = vb / total, vc / total
    square = 0.0
    for k in range(3):
        y[k] = a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k])
        square += (y[k] - x[k]) ** 2
    return square


@njit(cache=True)
def _closest(
    corners: Array, tree: Tree, queries: Array, normals: Array, ways: Array, cosine: float
) -> tuple[Array, Array, Index]:
    """Among all triangles if there are no normals, else among those that face the way of the query."""
    count, free = len(queries), len(normals) == 0
    points, squares = np.full((count, 3), np.nan), np.full(count, np.inf)
    owner = np.full(count, -1, dtype=np.int64)
    stack, bound = np.empty(128, dtype=np.int64), np.empty(128)
    y = np.empty(3)
    for q in range(count):
        x = queries[q]
        stack[0], bound[0] = 0, 0.0
        size = 1
        while size:
            size -= 1
            if bound[size] >= squares[q]:
                continue
            node = stack[size]
            child = tree.child[node]
            if child >= 0:
                one, two = _gap(tree, child, x), _gap(tree, child + 1, x)
                # The nearer child is looked at first.
                near = 0 if one <= two else 1
                stack[size], bound[size] = child + 1 - near, max(one, two)
                stack[size + 1], bound[size + 1] = child + near, min(one, two)
                size += 2
                continue
            for k in range(tree.begin[node], tree.end[node]):
                t = tree.order[k]
                if not free:
                    along = 0.0
                    for d in range(3):
                        along += normals[t, d] * ways[q, d]
                    if along < cosine:
                        continue
                square = _on_triangle(corners[t], x, y)
                if square < squares[q]:
                    squares[q], owner[q] = square, t
                    points[q] = y
    return points, np.sqrt(squares), owner
