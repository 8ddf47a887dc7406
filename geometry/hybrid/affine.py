r"""Values at the vertices of a shell as affine maps of space: means of neighbours that keep them, and their slopes.

Layers are the skin moved by a displacement that is nearly affine where the skin is a plane, a cylinder or a sphere:
offsets of a cylinder of radius R by t are x - (t / R) (x - axis). So

    relaxed    moves values towards the affine map fitted to those of the neighbours (plain means of neighbours shrink
               offsets of curved surfaces, and leave the noise of traced paths)
    spread     gives control points the displacement  L(d) + L(G) (P - L(x)),  with L linear between an element's
               vertices, G their slopes and P - L(x) how far the control point bulges from the chord: an element that
               spans a sixth of a cylinder keeps the whole bulge under a linear displacement, while its chord shrinks,
               and the innermost layer turns sharply from element to element

**Creases.** The displacement has a kink where the skin has one: the rim of a hole moves along both of its faces. So
maps are fitted on each smooth side of a crease alone, and those of the crease to the vertices along it (`creases`);
where creases meet or end values stay. Control points on a crease follow the crease's maps, all others their side's.

**Bound.** Offsets inwards that stop before the mid-structure have slopes with a norm below one. Fits with larger ones
(``STEEPEST``) are noise across faces that are nearly flat, and are scaled down to it.

**Factors.** Where depths are lowered by factors s at the vertices, slopes are those of the shifts without the factors,
times s: the displacement s d tends to zero with s everywhere, not at the vertices alone.

Axis letters: e element, v vertex, g side, m corner of an element, k pair, b Bernstein function, x and c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.creases import Creases
from geometry.hybrid.shell import Shell
from iga.bernstein import bernstein, elevation
from iga.block import bezier_coefficients

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

STEEPEST = 1.0
"""Largest norm of slopes."""
STIFF = 0.05
"""Weight of the slope beside the values of neighbours at distance one: where they lie in a line or a plane."""
FLAT = 1e-3
"""The same for slopes, relative to all directions together."""


def relaxed(points: Array, values: Array, made: Creases, beta: Array, sweeps: int) -> Array:
    """Values (v, c) moved towards affine fits of their neighbours' values: on a crease, of those along it.

    Parameters
    ----------
    points : (v, 3) vertices.
    beta : (v,) share of the way in each sweep, 0 where a value stays.
    """
    count = len(points)
    degree = np.bincount(made.along[:, 0], minlength=count)
    inner = np.stack([made.vertex[made.beside[:, 0]], made.beside[:, 1]], axis=1)
    a, b = np.concatenate([inner[degree[inner[:, 0]] == 0], made.along]).T
    beta = np.where((degree == 0) | (degree == 2), beta, 0.0)
    x = points[b] - points[a]
    rows = np.concatenate([np.ones((len(x), 1)), x], axis=1)
    weighted = rows / np.einsum("kx,kx->k", x, x)[:, None]
    A = np.zeros((count, 4, 4))
    np.add.at(A, a, weighted[:, :, None] * rows[:, None])
    A[:, [1, 2, 3], [1, 2, 3]] += STIFF * np.bincount(a, minlength=count)[:, None]
    # The value at the vertex is the first coefficient: a fixed weight of each neighbour.
    first = np.linalg.solve(A, np.broadcast_to(np.eye(4)[:, :1], (count, 4, 1)))[:, :, 0]
    weight = np.einsum("ki,ki->k", first[a], weighted)[:, None]
    for _ in range(sweeps):
        fitted = np.zeros_like(values)
        np.add.at(fitted, a, weight * values[b])
        values = values + beta[:, None] * (fitted - values)
    return values


def slopes(points: Array, values: Array, owners: Index, pairs: Index) -> Array:
    """Slopes (g, 3, c) of affine maps through the values at vertices, fitted to some of their neighbours', bounded.

    Parameters
    ----------
    owners : (g,) vertex that each map goes through.
    pairs : (k, 2) maps and the neighbours that they are fitted to.
    """
    a, b = pairs.T
    x = points[b] - points[owners[a]]
    weighted = x / np.einsum("kx,kx->k", x, x)[:, None]
    A, B = np.zeros((len(owners), 3, 3)), np.zeros((len(owners), 3, values.shape[1]))
    np.add.at(A, a, weighted[:, :, None] * x[:, None])
    np.add.at(B, a, weighted[:, :, None] * (values[b] - values[owners[a]])[:, None])
    size = np.maximum(np.trace(A, axis1=1, axis2=2), np.bincount(a, minlength=len(owners)) < 1)
    A += FLAT * size[:, None, None] * np.eye(3)
    G = np.linalg.solve(A, B)
    norm = np.linalg.norm(G, ord=2, axis=(1, 2), keepdims=True)
    return np.asarray(G * (STEEPEST / np.maximum(norm, STEEPEST)))


def spread(shell: Shell, shift: Array, made: Creases, whole: Array | None = None, factor: Array | None = None) -> Array:
    """Displacement (n, c) of the control points of a shell of C0 functions by shifts (v, c) of its vertices.

    Parameters
    ----------
    whole, factor : shifts (v, c) without the factors (v,) of the depth, and those; slopes are the former's times these.
    """
    result = np.zeros((shell.space.n, shift.shape[1]))
    whole = shift if whole is None else whole
    count = len(shell.vertices)
    on_side = slopes(shell.vertices, whole, made.vertex, made.beside)
    on_crease = slopes(shell.vertices, whole, np.arange(count), made.along)
    if factor is not None:
        on_side *= factor[made.vertex, None, None]
        on_crease *= factor[:, None, None]
    for block, corners, side, sharp in zip(shell.space.blocks, shell.corners, made.side, made.sharp):
        cell = block.basis.cell
        L = elevation(bernstein(cell, 1), block.basis.degree)
        bulge = bezier_coefficients(block, shell.points) - L @ shell.vertices[corners]
        moved = np.einsum("ebx,bv,evxc->ebc", bulge, L, on_side[side], optimize=True)
        for k, ends in enumerate(cell.edges):
            inside = (L[:, ends] > 0.0).all(axis=1) & (np.delete(L, ends, axis=1) == 0.0).all(axis=1)
            own = np.flatnonzero(sharp[:, k])
            moved[np.ix_(own, inside)] = np.einsum(
                "ebx,bv,evxc->ebc", bulge[own][:, inside], L[np.ix_(inside, ends)], on_crease[corners[own][:, ends]],
                optimize=True,
            )
        result[block.dofs] = L @ shift[corners] + moved
    return result
