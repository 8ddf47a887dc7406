r"""Moving control points until every cell is valid, boundary kept where the input allows.

On the tricubic closures of all cells, by `iga.untangling` (regularised mean ratio, the certificate in the loop), in
three steps, each only if cells are left that are not certified:

* `follow`: where many are folded, the interior first moves with the boundary instead of interpolating. With d the
  displacement from the vertices given to control points, d is harmonic inside for edge weights 1/length^2.
* `mend_inside`: interior control points are free.
* `mend_all`: faces of the boundary surface can fold themselves, and two faces can meet in one plane across an edge;
  no interior point mends that. Boundary points are freed too, corners excepted, on springs that hold limit points
  fast across the surface (across the curve, on creases) and softly along it:
  ((WEIGHT - ALONG) (n . r)^2 + ALONG |r|^2)/l^2, r the way from the place given, l the mean length of edges there. So
  vertices slide on the surface before the surface moves.

At the end all points go back towards the interpolating ones as far as all cells stay certified. How far the surface is
from the vertices given is measured by `surface_distance`.

Axis letters: v vertex, e cell, f boundary face, q sample, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from geometry.catmull_clark.domain import build_domain
from geometry.catmull_clark.features import outward_quads
from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows, limit_matrix
from geometry.catmull_clark.topology import CREASE, INTERIOR, Topology, incidence
from iga.bernstein import bernstein
from iga.cells import QUADRILATERAL
from iga.certificate import SIGN_ALONE, certify
from iga.distortion import own_shapes
from iga.domain import Domain
from iga.progress import QUIET, Progress
from iga.tether import Tether
from iga.untangling import approach, untangle

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WEIGHTS = (100.0, 10.0, 1.0)
"""Springs across the surface, tried one after the other until all cells are valid."""
ALONG = 0.5
"""Springs along the surface."""
FEW = 50
"""Invalid cells up to which interior points are optimised as they are; more are first made to follow the boundary."""
_RETURNS = 3
"""How often points go back towards where they were."""


@dataclass(frozen=True, eq=False)
class Repaired:
    """Control points (v, 3), and the cells whose closures are still not certified."""

    control: Array
    invalid: Index


def repair(
    topology: Topology, points: Array, control: Array, boundary: bool, shown: Progress = QUIET
) -> Repaired:
    """Make the closures of all cells valid.

    Parameters
    ----------
    points : (v, 3) the mesh whose edge lengths are the ideal ones.
    control : (v, 3) control points, as a rule interpolating.
    boundary : whether boundary points may move where interior ones do not suffice. If not, nothing is done to a mesh
        that folds without interpolation too.
    """
    wanted = build_domain(topology, control, 0)
    start = invalid = invalid_cells(wanted)
    ideal = replace(wanted, points=points)
    if not len(invalid) or (not boundary and len(invalid_cells(ideal))):
        return Repaired(control, invalid)
    shapes = own_shapes(ideal)
    domain = wanted
    if len(invalid) > FEW:
        followed = replace(wanted, points=follow(topology, points, control, invalid))
        left = invalid_cells(followed)
        domain, invalid = (followed, left) if len(left) < len(invalid) else (domain, invalid)
    if len(invalid):
        inside = topology.vertex_kind == INTERIOR
        mended = untangle(domain, inside, shapes, rounds=6, patience=2, shown=shown)
        domain, invalid = replace(domain, points=mended.points), mended.invalid
    inner = domain
    for weight in WEIGHTS if boundary else ():
        if len(invalid):
            tether = springs(topology, points, control, weight)
            mended = untangle(inner, topology.vertex_kind >= CREASE, shapes, tether=tether, shown=shown)
            if len(mended.invalid) < len(invalid):
                domain, invalid = replace(inner, points=mended.points), mended.invalid
    for _ in range(_RETURNS):
        domain = replace(domain, points=approach(domain, control - domain.points).points)
    invalid = invalid_cells(domain)
    return Repaired(domain.points, invalid) if len(invalid) < len(start) else Repaired(control, start)


def invalid_cells(domain: Domain) -> Index:
    """Cells whose closure is not certified, in a domain of depth 0."""
    verdict = certify(domain, tolerance=SIGN_ALONE, max_depth=6).verdict
    parents = [np.arange(b.elements) if b.parent is None else b.parent for b in domain.space.blocks]
    return np.sort(np.concatenate(parents)[verdict <= 0])


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


def springs(topology: Topology, points: Array, control: Array, weight: float) -> Tether:
    """Springs from the limit points of boundary vertices to where they are now, stiff across the surface."""
    t = topology
    limit = limit_matrix(t)
    outer = np.flatnonzero(t.vertex_kind < INTERIOR)
    normal, along = _normals(t, points), _crease_directions(t, points)
    crease = np.flatnonzero(t.vertex_kind == CREASE)
    normal[crease] = _unit(
        normal[crease] - (normal[crease] * along[crease]).sum(axis=1, keepdims=True) * along[crease]
    )
    # A second spring on creases, across the other direction.
    second = np.cross(along[crease], normal[crease])
    length = np.linalg.norm(points[t.edges[:, 1]] - points[t.edges[:, 0]], axis=1)
    size = np.bincount(t.edges.ravel(), np.repeat(length, 2)) / np.maximum(t.vertex_edges, 1)
    rows = np.concatenate([outer, crease])
    stiff = weight / np.maximum(size[rows], 1e-3 * length.max()) ** 2
    matrix = csr_array(vstack([limit[outer], limit[crease]]))
    return Tether(matrix, matrix @ control, np.concatenate([normal[outer], second]), stiff, ALONG / weight)


def _normals(t: Topology, points: Array) -> Array:
    """Unit normals of the boundary at its vertices, (v, 3)."""
    quads = outward_quads(t)[1]
    x = points[quads]
    area = np.cross(x[:, 3] - x[:, 0], x[:, 1] - x[:, 2])
    total = np.zeros_like(points)
    for corner in range(4):
        np.add.at(total, quads[:, corner], area)
    return _unit(total)


def _crease_directions(t: Topology, points: Array) -> Array:
    """Unit directions of creases at their vertices, (v, 3); zero elsewhere."""
    ends = t.edges[t.edge_kind == CREASE]
    way = _unit(points[ends[:, 1]] - points[ends[:, 0]])
    owner, direction = ends.T.ravel(), np.concatenate([way, way])
    order = np.argsort(owner, kind="stable")
    owner, direction = owner[order], direction[order]
    # Edges are turned to run like the first one at the vertex.
    first = direction[np.searchsorted(owner, owner)]
    sign = np.where((first * direction).sum(axis=1) < 0.0, -1.0, 1.0)
    total = np.zeros_like(points)
    np.add.at(total, owner, sign[:, None] * direction)
    return _unit(total)


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


_FACE = bernstein(QUADRILATERAL, 3)
_GRID = np.array(list(np.ndindex(9, 9))) / 8.0
_NEAREST = 8
"""Nearest samples of the surface from which the foot of a point is searched."""


def surface_distance(topology: Topology, control: Array, points: Array) -> Array:
    """Distance of points (k, 3) from the boundary surface (of the closures), (k,).

    The nearest of 9 x 9 samples of every boundary face, improved by Gauss-Newton steps in the faces of the nearest few:
    an upper bound of the distance, and the distance itself unless the nearest face is missed by all of them.
    """
    rows = bezier_rows(topology)
    faces = topology.boundary_faces
    net = (bezier_matrix(topology, rows) @ control)[rows.faces[faces]]
    samples = (_FACE.tabulate(_GRID, 0)[0] @ net).reshape(-1, 3)
    far, nearest = cKDTree(samples).query(points, _NEAREST)
    face, sample = np.divmod(nearest.ravel(), len(_GRID))
    s, own, target = _GRID[sample].copy(), net[face], np.repeat(points, _NEAREST, axis=0)
    best = np.asarray(far, dtype=np.float64).ravel()
    for _ in range(6):
        B, dB = _FACE.tabulate(s, 1)
        x, J = np.einsum("qb,qbc->qc", B, own), np.einsum("qbd,qbc->qcd", dB, own)
        best = np.minimum(best, np.linalg.norm(target - x, axis=1))
        normal = np.swapaxes(J, 1, 2) @ J + 1e-14 * (J**2).sum(axis=(1, 2))[:, None, None] * np.eye(2)
        step = np.linalg.solve(normal, np.swapaxes(J, 1, 2) @ (target - x)[:, :, None])[..., 0]
        s = np.clip(s + step, 0.0, 1.0)
    return np.asarray(best.reshape(-1, _NEAREST).min(axis=1))
