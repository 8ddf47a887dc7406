r"""Interpolating less where an interpolating boundary folds, and letting the interior follow the boundary.

Interpolation overshoots. Two remedies come before `untangling`, both one linear solve:

* `follow`: the interior moves with the boundary instead of interpolating. With d the displacement from the vertices
  given to control points, d is harmonic inside for edge weights 1/length^2, so cells keep their shapes.
* `relax`: where the boundary surface itself folds, which no interior point can mend, boundary control points go back
  towards the vertices, v + theta (p - v), theta halved around such faces until none is left. theta = 0 is the
  approximating surface.

A face is taken to fold if its normal, at samples, turns against its mean, or if det J < 0 at a sample of an edge
between two boundary faces. That steers the relaxation only; what is valid is decided by the certificate.

Axis letters: v vertex, e cell, q sample, b Bernstein function, c component, d reference dimension.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from geometry.catmull_clark.domain import CUBIC
from geometry.catmull_clark.lattice import Rows
from geometry.catmull_clark.topology import INTERIOR, SMOOTH, Topology, incidence

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_HALVINGS = 4
_SAMPLES = np.array(list(np.ndindex(5, 5, 5))) / 4.0
_SLOPES = CUBIC.tabulate(_SAMPLES, 1)[1]


def follow(topology: Topology, points: Array, control: Array, near: Index) -> Array:
    """Control points whose interior near some cells follows the rest.

    Parameters
    ----------
    points : (v, 3) vertices given.
    control : (v, 3) control points; on the boundary, and away from the cells, they stay.
    near : cells.
    """
    t = topology
    around = incidence(t.hexes, t.vertices)
    chosen = np.zeros(len(t.hexes), dtype=bool)
    chosen[near] = True
    chosen = around @ (around.T @ chosen > 0) > 0
    free = np.zeros(t.vertices, dtype=bool)
    free[t.hexes[chosen]] = True
    free &= t.vertex_kind == INTERIOR
    if not free.any():
        return control
    ends = t.edges
    length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    weight = 1.0 / np.maximum(length, 1e-3 * length.max()) ** 2
    pair = (np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]]))
    A = csr_array(coo_array((np.tile(weight, 2), pair), shape=(t.vertices, t.vertices)))
    L = csr_array(diags_array(np.asarray(A.sum(axis=1)).ravel()) - A)[np.flatnonzero(free)]
    moved = control - points
    right = -(L[:, np.flatnonzero(~free)] @ moved[~free])
    moved[free] = splu(L[:, np.flatnonzero(free)].tocsc()).solve(right)
    return np.asarray(points + moved)


def relax(topology: Topology, rows: Rows, matrix: csr_array, points: Array, control: Array) -> Array:
    """Control points whose boundary surface does not fold, as far as going back to the vertices can mend it.

    Parameters
    ----------
    rows, matrix : Bezier points of the closures, as of `untangling.Closures`.
    points : (v, 3) vertices given.
    control : (v, 3) interpolating control points.
    """
    t = topology
    around = incidence(t.hexes, t.vertices)
    theta = np.ones((t.vertices, 1))
    outer = t.vertex_kind < INTERIOR
    current = control
    for halving in range(_HALVINGS + 1):
        bad = folded_boundary(t, rows, matrix, current)
        if not len(bad):
            break
        marked = np.zeros(len(t.hexes), dtype=bool)
        marked[bad] = True
        marked = around @ (around.T @ marked > 0) > 0
        near = np.zeros(t.vertices, dtype=bool)
        near[t.hexes[marked]] = True
        theta[near & outer] *= 0.5 if halving < _HALVINGS else 0.0
        current = np.where(outer[:, None], points + theta * (control - points), control)
    return current


def folded_boundary(topology: Topology, rows: Rows, matrix: csr_array, control: Array) -> Index:
    """Cells with a boundary face that folds, at samples."""
    t = topology
    cells = np.flatnonzero((t.face_kind[t.hex_faces] == SMOOTH).any(axis=1))
    net = (matrix @ control)[rows.cells[cells]]
    J = np.einsum("qbd,ebc->eqcd", _SLOPES, net)
    det = np.linalg.det(J)
    outer = t.face_kind[t.hex_faces[cells]] == SMOOTH
    bad = np.zeros(len(cells), dtype=bool)
    for side in range(6):
        d, end = divmod(side, 2)
        on = _SAMPLES[:, d] == end
        tangents = J[:, on]
        normal = np.cross(tangents[..., (d + 1) % 3], tangents[..., (d + 2) % 3])
        turned = np.einsum("eqc,ec->eq", normal, normal.mean(axis=1)) <= 0.0
        bad |= outer[:, side] & turned.any(axis=1)
        for other in range(side + 1, 6):
            if other // 2 != d:
                edge = on & (_SAMPLES[:, other // 2] == other % 2)
                bad |= outer[:, side] & outer[:, other] & (det[:, edge] <= 0.0).any(axis=1)
    return cells[bad]
