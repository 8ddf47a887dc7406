r"""Ways inwards from the vertices of a skin: paths along a field, or straight ones.

A straight one of a vertex v goes along w, where n_f . w = -1 for the normals n_f of the elements around it in the sense
of least squares, an offset of all of them, also at edges and corners. It ends where the ball around v + D w with radius
D, which touches all of them, meets another point v + q of the skin,

    |q - D w|^2 = D^2,

an estimate of the distance to the mid-structure.

Axis letters: e element, v vertex, s place on a path, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.creases import Creases, creases
from geometry.hybrid.field import Field, paths
from geometry.hybrid.flat_corners import tangents_of
from geometry.hybrid.shell import Shell

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SLOPE = 0.3
"""Largest difference of depth between neighbours over their distance."""
LONGEST = 2.0
"""Largest |w|: sharp edges move less than a full offset."""


@dataclass(frozen=True, eq=False)
class Ways:
    """Paths inwards from the vertices of a shell.

    Attributes
    ----------
    places : (v, s, 3) points on the paths, equally spaced by length.
    lengths : (v,)
    straight : (v, 3) displacement that `directions` and the largest ball allow.
    edges : (k, 2) vertices that are joined.
    creases : smooth sides of the skin and its creases.
    """

    places: Array
    lengths: Array
    straight: Array
    edges: Index
    creases: Creases


def ways_of(shell: Shell, field: Field | None) -> Ways:
    """Paths along a field, or straight ones without."""
    w = directions(shell)
    edges, made = _edges(shell), creases(shell)
    straight = bounded(shell.vertices, touching_balls(shell.vertices, w, _targets(shell)), edges)[:, None] * w
    if field is None:
        places = np.stack([shell.vertices, shell.vertices + straight], axis=1)
        return Ways(places, np.linalg.norm(straight, axis=1), straight, edges, made)
    unit = w / np.linalg.norm(w, axis=1, keepdims=True)
    return Ways(*paths(field, np.arange(len(w)), unit), straight, edges, made)


def directions(shell: Shell) -> Array:
    """Direction w (v, 3) of each vertex."""
    skin = tangents_of(shell)
    count = len(shell.vertices)
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(A, skin.vertex, skin.normal[:, :, None] * skin.normal[:, None, :])
    np.add.at(b, skin.vertex, -skin.normal)
    times = np.bincount(skin.vertex, minlength=count)[:, None]
    mean = b / times
    ridge = 1e-3  # where all normals are equal to within a degree or two, w is their mean
    w = np.linalg.solve(A / times[:, :, None] + ridge * np.eye(3), ((1.0 + ridge) * mean)[:, :, None])[:, :, 0]
    length = np.linalg.norm(w, axis=1, keepdims=True)
    return np.asarray(w * np.minimum(1.0, LONGEST / length))


def inward(shell: Shell, ways: Ways, depth: Array) -> NDArray[np.bool_]:
    """Which paths (v,) lead inwards from all elements around their vertices, at least half as well as w does."""
    skin = tangents_of(shell)
    count = len(shell.vertices)
    places, lengths = ways.places, ways.lengths
    longest = np.linalg.norm(directions(shell), axis=1)[skin.vertex]
    at = np.clip(np.rint(depth / (lengths + 1e-300) * (places.shape[1] - 1)).astype(np.int64), 1, places.shape[1] - 1)
    good = lengths > 0.0
    for part in (1, 2):  # at half the depth, and at the whole
        spot = places[np.arange(count), np.maximum(at * part // 2, 1)] - shell.vertices
        spot = spot / (np.linalg.norm(spot, axis=1, keepdims=True) + 1e-300)
        inward = -np.einsum("ec,ec->e", skin.normal, spot[skin.vertex]) * longest
        least = np.full(count, np.inf)
        np.minimum.at(least, skin.vertex, inward)
        good &= least > 0.5
    return np.asarray(good)


def _targets(shell: Shell) -> Array:
    """Points that the layers keep away from: vertices, and middles of edges and elements."""
    found = [shell.vertices]
    for block, corners in zip(shell.space.blocks, shell.corners):
        found += [shell.vertices[corners].mean(axis=1)]
        ends = corners[:, block.basis.cell.edges].reshape(-1, 2)
        found += [shell.vertices[np.unique(np.sort(ends, axis=1), axis=0)].mean(axis=1)]
    return np.concatenate(found)


def _edges(shell: Shell) -> Index:
    ends = [c[:, b.basis.cell.edges].reshape(-1, 2) for b, c in zip(shell.space.blocks, shell.corners)]
    return np.unique(np.sort(np.concatenate(ends), axis=1), axis=0)


def bounded(vertices: Array, depth: Array, edges: Index) -> Array:
    """Depths (v,) lowered until those of neighbours differ by a share of their distance at most."""
    depth = depth.copy()
    length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    for _ in range(len(vertices)):
        before = depth.copy()
        np.minimum.at(depth, edges[:, 0], before[edges[:, 1]] + SLOPE * length)
        np.minimum.at(depth, edges[:, 1], before[edges[:, 0]] + SLOPE * length)
        if np.array_equal(before, depth):
            break
    return depth


@numba.njit(cache=True)
def touching_balls(vertices, w, targets):  # type: ignore[no-untyped-def]
    """Radius D (v,) of the smallest ball |q - D w| = D through a target v + q in front of each vertex (v, 3)."""
    result = np.full(len(vertices), np.inf)
    for v in range(len(vertices)):
        a = w[v, 0] ** 2 + w[v, 1] ** 2 + w[v, 2] ** 2 - 1.0
        for t in range(len(targets)):
            b, c = 0.0, 0.0
            for k in range(3):
                q = targets[t, k] - vertices[v, k]
                b += q * w[v, k]
                c += q * q
            # Points beside the vertex, to within the error of its normals, are no obstacle.
            if b <= 0.05 * np.sqrt(c) or b * b <= 1.02 * a * c:
                continue
            if abs(a) < 1e-9:
                D = c / (2.0 * b)
            else:
                D = c / (b + np.sqrt(b * b - a * c))
            result[v] = min(result[v], D)
    return result
