r"""Values at the vertices of a shell as affine maps of space: means of neighbours that keep them, and their slopes.

Layers are the skin moved by a displacement that is nearly affine where the skin is a plane, a cylinder or a sphere:
offsets of a cylinder of radius R by t are x - (t / R) (x - axis). So

    relaxed    moves values towards the affine map fitted to those of the neighbours (plain means of neighbours shrink
               offsets of curved surfaces, and leave the noise of traced paths)
    spread     gives control points the displacement  L(d) + L(G) (P - L(x)),  with L linear between an element's
               vertices, G their slopes and P - L(x) how far the control point bulges from the chord: an element that
               spans a sixth of a cylinder keeps the whole bulge under a linear displacement, while its chord shrinks,
               and the innermost layer turns sharply from element to element

Axis letters: e element, v vertex, k pair, b Bernstein function, x and c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.shell import Shell
from iga.bernstein import bernstein, elevation
from iga.block import bezier_coefficients

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STIFF = 0.05
"""Weight of the slope beside the values of neighbours at distance one: where they lie in a line or a plane."""
FLAT = 1e-3
"""The same for slopes, relative to all directions together."""


def relaxed(points: Array, values: Array, edges: Index, beta: Array, sweeps: int) -> Array:
    """Values (v, c) moved towards affine fits of their neighbours' values.

    Parameters
    ----------
    points : (v, 3) vertices.
    edges : (k, 2) neighbours.
    beta : (v,) share of the way in each sweep, 0 where a value stays.
    """
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    x = points[b] - points[a]
    rows = np.concatenate([np.ones((len(x), 1)), x], axis=1)
    weighted = rows / np.einsum("kx,kx->k", x, x)[:, None]
    A = np.zeros((len(points), 4, 4))
    np.add.at(A, a, weighted[:, :, None] * rows[:, None])
    A[:, [1, 2, 3], [1, 2, 3]] += STIFF * np.bincount(a, minlength=len(points))[:, None]
    # The value at the vertex is the first coefficient: a fixed weight of each neighbour.
    first = np.linalg.solve(A, np.broadcast_to(np.eye(4)[:, :1], (len(points), 4, 1)))[:, :, 0]
    weight = np.einsum("ki,ki->k", first[a], weighted)[:, None]
    for _ in range(sweeps):
        fitted = np.zeros_like(values)
        np.add.at(fitted, a, weight * values[b])
        values = values + beta[:, None] * (fitted - values)
    return values


def slopes(points: Array, values: Array, edges: Index) -> Array:
    """Slopes (v, 3, c) of affine maps through the values at vertices, fitted to their neighbours'."""
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    x = points[b] - points[a]
    weighted = x / np.einsum("kx,kx->k", x, x)[:, None]
    A, B = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3, values.shape[1]))
    np.add.at(A, a, weighted[:, :, None] * x[:, None])
    np.add.at(B, a, weighted[:, :, None] * (values[b] - values[a])[:, None])
    A += FLAT * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(A, B))


def spread(shell: Shell, shift: Array, edges: Index) -> Array:
    """Displacement (n, c) of the control points of a shell of C0 functions by shifts (v, c) of its vertices."""
    result = np.zeros((shell.space.n, shift.shape[1]))
    G = slopes(shell.vertices, shift, edges)
    for block, corners in zip(shell.space.blocks, shell.corners):
        L = elevation(bernstein(block.basis.cell, 1), block.basis.degree)
        bulge = bezier_coefficients(block, shell.points) - L @ shell.vertices[corners]
        result[block.dofs] = L @ shift[corners] + np.einsum("ebx,bv,evxc->ebc", bulge, L, G[corners], optimize=True)
    return result
