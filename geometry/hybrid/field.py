r"""The field along which layers are traced from a skin towards the mid-structure (Song and Cohen 2019, Section 4.1).

Inside the straight skeleton of the skin, filled with tetrahedra that are cut in eight a few times,

    g   distance to the skeleton's triangles, exact at the vertices
    M   mid-structure: vertices from where g rises to no neighbour by more than RIDGE times their distance, and with an
        average |grad g| below FLAT, and where g is largest: the ridges of g without the sheets that run into sharp
        edges; or vertices near given points
    h   harmonic, 0 on the skin and 1 on M, by linear finite elements

    f = h grad h / |grad h| + (1 - h) grad g

with gradients averaged at the vertices: off the skin paths leave along the normal, further in they follow h, which has
no ridge before M. A path runs along f from a vertex of the skin until h reaches ``END``, by steps of a share of the
tetrahedron at hand; it is given back at equal steps of its length.

Axis letters: v vertex, t tetrahedron, k vertex of the skin, s place on the path, c component.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from geometry.hybrid.filling import LIMIT, fill
from geometry.hybrid.shell import Shell
from geometry.simplices.closest import closest
from iga.assembly import matrix
from iga.cells import QUADRILATERAL, TETRAHEDRON
from iga.conforming import Complex, entity_keys, straight_domain
from iga.errors import InputError
from iga.integrands import Diffusion
from iga.linear.factorization import factorize
from iga.refinement import refine

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

RIDGE = 0.5
"""Slope of the distance above which it still rises: along the skin's normals it is 1, over a ridge less than 0."""
FLAT = 0.6
"""Average slope of a ridge at most: that of two unit slopes which differ by 106 degrees. The sheet that runs into an
edge of 90 degrees has 0.71 and is no ridge."""
END = 0.97
"""Value of h at which a path has arrived; at 1 itself, a maximum, f has no direction."""
STEP = 0.2
"""Step over the cube root of the tetrahedron's volume, so that about ten steps cross one."""
LEAVE = 0.1
"""Share of the first step that must lie within the tetrahedron by which a path leaves the skin."""
OUTSIDE, OUTSIDE_FIRST = -1e-9, -1e-3
"""Least barycentric coordinate within a tetrahedron: rounding; and of the first step, along a normal of faces that the
tetrahedra only approximate."""
RISE, PATIENCE = 2e-3, 8
"""A path ends where h was largest when it has not risen by so much for so many steps: it is past the mid-structure."""
MOST = 4000
"""Steps of a path at most."""
HOPS = 200
"""Tetrahedra that the walk to a point passes at most; a step is shorter than a tetrahedron, so it passes a few."""
STILL = 1e-6
"""Length of f, which is about 1, below which it has no direction."""
ENOUGH, CUTS = 100_000, 2
"""Tetrahedra above which the filling is not cut again, and how often it is cut."""


@dataclass(frozen=True, eq=False)
class Field:
    """Tetrahedra inside a skeleton, and functions at their vertices.

    Attributes
    ----------
    points : (v, 3), those of the skin first.
    tets : (t, 4), positive.
    neighbours : (t, 4) tetrahedron behind the face opposite to each vertex, -1 outside.
    distance, harmonic : (v,) g and h.
    middle : (v,) whether a vertex is of the mid-structure.
    flow : (v, 3) f.
    """

    points: Array
    tets: Index
    neighbours: Index
    distance: Array
    harmonic: Array
    middle: Mask
    flow: Array


def field_under(shell: Shell, limit: float = LIMIT, middle: Array | None = None) -> Field:
    """Field inside a skin.

    Parameters
    ----------
    limit : seconds for the mesh generator.
    middle : (m, 3) points of the mid-structure; by default it is found.

    Raises
    ------
    InputError : the skeleton cannot be filled, or no vertex is of the mid-structure.
    """
    triangles = skeleton(shell)
    points, tets = fill(shell.vertices, triangles, limit)
    coarse = straight_domain(Complex(((TETRAHEDRON, tets),)), points, 1)
    cuts = 0
    while cuts < CUTS and len(tets) * 8 ** (cuts + 1) <= ENOUGH:
        cuts += 1
    domain = refine(coarse, cuts)
    points, tets = domain.points, np.asarray(domain.space.blocks[0].dofs, dtype=np.int64)
    neighbours = _neighbours(tets, len(points))
    outer = np.zeros(len(points), dtype=bool)
    faces = np.array([face.vertices for face in TETRAHEDRON.faces])
    for f in range(4):
        outer[tets[neighbours[:, f] < 0][:, faces[f]]] = True
    distance = np.zeros(len(points))
    inside = np.flatnonzero(~outer)
    distance[inside] = closest(shell.vertices, triangles, points[inside])[1]
    chosen = _ridges(points, tets, distance, outer) if middle is None else _near(points, tets, middle, outer)
    if not chosen.any():
        raise InputError("no vertex inside the skin is of the mid-structure")
    K = csr_array(matrix(domain, Diffusion()))
    harmonic = chosen.astype(float)
    free = np.flatnonzero(~outer & ~chosen)
    if len(free):
        right = -(K[free] @ harmonic)
        harmonic[free] = factorize(csr_array(K[free][:, free]), symmetric=True)(right)
    up, out = (_gradients(points, tets, u) for u in (harmonic, distance))
    up /= np.linalg.norm(up, axis=1, keepdims=True) + 1e-300
    h = harmonic[:, None]
    return Field(points, tets, neighbours, distance, harmonic, chosen, h * up + (1.0 - h) * out)


def skeleton(shell: Shell) -> Index:
    """Triangles (t, 3) between the vertices of a shell; quadrilaterals are cut along a diagonal."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    for block, own in zip(shell.space.blocks, shell.corners):
        if block.basis.cell is QUADRILATERAL:
            found += [own[:, [0, 2, 3]], own[:, [0, 3, 1]]]
        else:
            found.append(own)
    return np.concatenate(found)


def _neighbours(tets: Index, count: int) -> Index:
    faces = np.array([face.vertices for face in TETRAHEDRON.faces])
    keys = entity_keys(tets[:, faces].reshape(-1, 3), count)
    order = np.argsort(keys, kind="stable")
    same = keys[order[:-1]] == keys[order[1:]]
    result = np.full(len(keys), -1, dtype=np.int64)
    a, b = order[:-1][same], order[1:][same]
    result[a], result[b] = b // 4, a // 4
    opposite = np.empty((len(tets), 4), dtype=np.int64)
    for f, own in enumerate(faces.tolist()):
        opposite[:, ({0, 1, 2, 3} - set(own)).pop()] = result.reshape(-1, 4)[:, f]
    return opposite


def _edges(tets: Index) -> Index:
    return np.unique(np.sort(tets[:, TETRAHEDRON.edges].reshape(-1, 2), axis=1), axis=0)


def _ridges(points: Array, tets: Index, distance: Array, outer: Mask) -> Mask:
    a, b = _edges(tets).T
    slope = (distance[b] - distance[a]) / np.linalg.norm(points[b] - points[a], axis=1)
    steepest = np.full(len(points), -np.inf)
    np.maximum.at(steepest, a, slope)
    np.maximum.at(steepest, b, -slope)
    flat = np.linalg.norm(_gradients(points, tets, distance), axis=1) < FLAT
    result = (steepest < RIDGE) & flat & ~outer
    result[distance.argmax()] |= not outer.all()
    return np.asarray(result)


def _near(points: Array, tets: Index, middle: Array, outer: Mask) -> Mask:
    """Inner vertices nearest to given points, and all within half an edge of them."""
    a, b = _edges(tets).T
    length = np.linalg.norm(points[b] - points[a], axis=1)
    reach = np.zeros(len(points))
    np.maximum.at(reach, a, length)
    np.maximum.at(reach, b, length)
    inside = np.flatnonzero(~outer)
    chosen = np.zeros(len(points), dtype=bool)
    if len(inside):
        chosen[inside[cKDTree(points[inside]).query(middle)[1]]] = True
        chosen[inside] |= cKDTree(middle).query(points[inside])[0] < 0.5 * reach[inside]
    return chosen


def _gradients(points: Array, tets: Index, u: Array) -> Array:
    """Gradients (v, 3) of a piecewise linear function, averaged by volume at the vertices."""
    J = points[tets[:, 1:]] - points[tets[:, :1]]
    gradient = np.linalg.solve(J, (u[tets[:, 1:]] - u[tets[:, :1]])[..., None])[..., 0]
    volume = np.abs(np.linalg.det(J))
    result, total = np.zeros_like(points), np.zeros(len(points))
    for k in range(4):
        np.add.at(result, tets[:, k], volume[:, None] * gradient)
        np.add.at(total, tets[:, k], volume)
    return np.asarray(result / total[:, None])


def paths(field: Field, starts: Index, directions: Array, samples: int = 17) -> tuple[Array, Array]:
    """Paths along the field from vertices of the skin.

    Parameters
    ----------
    starts : (k,) vertices.
    directions : (k, 3) ways off the skin, for the first step.
    samples : places on each path, equally spaced by length.

    Returns
    -------
    places (k, s, 3) and lengths (k,); a path that cannot leave its vertex has length zero.
    """
    order = np.argsort(field.tets.ravel(), kind="stable")
    first = np.searchsorted(field.tets.ravel()[order], np.arange(len(field.points) + 1))
    return _trace(
        field.points, field.tets, field.neighbours, field.harmonic, field.flow, order // 4, first, starts,
        directions, samples,
    )


@njit(cache=True)
def _weights(points: Any, tets: Any, t: Any, x: Any) -> Any:
    """Barycentric coordinates."""
    p = points[tets[t]]
    J = np.empty((3, 3))
    for i in range(3):
        for c in range(3):
            J[c, i] = p[i + 1, c] - p[0, c]
    s = np.linalg.solve(J, x - p[0])
    return np.array([1.0 - s[0] - s[1] - s[2], s[0], s[1], s[2]])


@njit(cache=True)
def _length(points: Any, tets: Any, t: Any) -> Any:
    """Cube root of a tetrahedron's volume."""
    p = points[tets[t]]
    return (abs(np.linalg.det(p[1:] - p[0])) / 6.0) ** (1.0 / 3.0)


@njit(cache=True)
def _walk(points: Any, tets: Any, neighbours: Any, t: Any, x: Any) -> Any:
    """Tetrahedron that holds a point, from one nearby, or -1."""
    for _ in range(HOPS):
        w = _weights(points, tets, t, x)
        k = np.argmin(w)
        if w[k] >= OUTSIDE:
            return t
        t = neighbours[t, k]
        if t < 0:
            return t
    return -1


@njit(cache=True)
def _leave(points: Any, tets: Any, neighbours: Any, around: Any, x: Any, direction: Any) -> Any:
    """First step from a vertex into one of the tetrahedra around it: the tetrahedron it ends in, or -1, and its end."""
    for own in around:
        size = STEP * _length(points, tets, own)
        if _weights(points, tets, own, x + LEAVE * size * direction).min() >= OUTSIDE_FIRST:
            end = x + size * direction
            t = _walk(points, tets, neighbours, own, end)
            if t >= 0:
                return t, end
    return -1, x


@njit(cache=True)
def _follow(points: Any, tets: Any, neighbours: Any, harmonic: Any, flow: Any, t: Any, line: Any, along: Any) -> Any:
    """Go on along f from line[1] in tetrahedron t; places and lengths are written. Returns the last place's number."""
    count, best, highest = 1, 1, 0.0
    while count < MOST:
        w = _weights(points, tets, t, line[count])
        h, f = 0.0, np.zeros(3)
        for k in range(4):
            h += w[k] * harmonic[tets[t, k]]
            f += w[k] * flow[tets[t, k]]
        size = np.sqrt((f**2).sum())
        if h >= END or size < STILL:
            break
        step = STEP * _length(points, tets, t)
        end = line[count] + step * f / size
        t = _walk(points, tets, neighbours, t, end)
        if t < 0:
            break
        w = _weights(points, tets, t, end)
        ahead = 0.0
        for k in range(4):
            ahead += w[k] * harmonic[tets[t, k]]
        if ahead > highest + RISE:
            highest, best = ahead, count + 1
        elif count - best > PATIENCE:
            break
        count += 1
        line[count] = end
        along[count] = along[count - 1] + step
    return best


@njit(cache=True)
def _trace(
    points: Any, tets: Any, neighbours: Any, harmonic: Any, flow: Any, around: Any, first: Any, starts: Any,
    directions: Any, samples: Any,
) -> Any:
    places = np.zeros((len(starts), samples, 3))
    lengths = np.zeros(len(starts))
    line = np.zeros((MOST + 2, 3))
    along = np.zeros(MOST + 2)
    for i in range(len(starts)):
        v = starts[i]
        line[0] = points[v]
        t, line[1] = _leave(points, tets, neighbours, around[first[v] : first[v + 1]], line[0], directions[i])
        if t < 0:
            places[i] = line[0]
            continue
        along[1] = np.sqrt(((line[1] - line[0]) ** 2).sum())
        count = _follow(points, tets, neighbours, harmonic, flow, t, line, along)
        lengths[i] = along[count]
        at = 0
        for s in range(samples):
            wanted = lengths[i] * s / (samples - 1)
            while at + 1 < count and along[at + 1] < wanted:
                at += 1
            share = (wanted - along[at]) / max(along[at + 1] - along[at], 1e-300)
            places[i, s] = line[at] + min(1.0, max(0.0, share)) * (line[at + 1] - line[at])
    return places, lengths
