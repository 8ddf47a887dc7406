r"""The boundary of a solid slid along the surface, before there is any solid.

What the map of the meccano's boundary leaves twisted or turned over would hold a solid back. So the fit of the map on
a coarse mesh, a closed sheet of spline facets, is straightened first: with U and V its tangents along u and v, a and b
their lengths where the sheet starts, and n the normal that the surface has around,

    E = sum_f sum_q w_q ( ((|U|^2 / a^2 + |V|^2 / b^2) / (2 h))^2 + k (h + 1 / h) / 2 ) + springs,
    h = (s + (s^2 + 4 d^2)^(1/2)) / 2,     s = det(U, V, n) / (a b)

is lowered by descent: the mean ratio of the tangents, regularised where the sheet is folded (Escobar et al. 2003, for
tetrahedra), and a measure of size. The springs are those of solids (`springs`). The points of the surface closest to
the slid sheet are then what the solid's boundary aims for (`on_sheet`).

Axis letters: f facet, q sample point of each facet, m boundary function, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from geometry.meccano.collocation import collocation
from geometry.meccano.errors import unit_normals
from geometry.meccano.fitting import fit_boundary
from geometry.meccano.skin import Skin, outward, places_on_sides, values_at
from geometry.meccano.springs import SAMPLES, springs_to
from geometry.simplices.closest import closest, closest_facing
from geometry.simplices.surface import Surface
from iga.descent import descend
from iga.tether import Tether, springs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Target = Callable[[Index, Array], Array]

_LINE = np.linspace(0.0, 1.0, 4)
NODES = np.stack(np.meshgrid(_LINE, _LINE, indexing="ij"), axis=-1).reshape(-1, 2)
"""Points (q, 2) of each facet where its shape counts, corners included, where facets fold first."""

# Fits from much fairness to little: each ends at a share of what the one before left.
_FAIRNESS = (1.0, 0.1, 0.01, 1e-3, 1e-3)
# Least cosine between a facet and the sheet of the surface it belongs to: less than is asked of springs, since it
# may be twisted.
_FACING = 0.3
# Least h that the regularisation leaves, and weight of the measure of size.
_EPSILON = 0.05
_SIZE = 0.2
# Rounds of descent, between which closest points and normals are found anew, and steps of each.
_TURNS = 14
_STEPS = 15


def fitted(skin: Skin, points: Array, aim: Array) -> Array:
    """Control points (n, 3) of which those of boundary functions make a sheet that is the fit of the map.

    Parameters
    ----------
    points : (n, 3), from which the fit starts.
    aim : (f q, 3) where the map puts `springs.SAMPLES` of all facets.

    Raises
    ------
    InputError : the fit does not converge.
    """
    made = points
    for fairness in _FAIRNESS:
        made = fit_boundary(skin, made, SAMPLES, aim, fairness=fairness)
    return made


def slid(skin: Skin, points: Array, surface: Surface, aim: Array, tolerance: float) -> Array:
    """Control points (n, 3) of which those of boundary functions make a sheet near the surface, as straight as may be.

    Parameters
    ----------
    points : (n, 3), a sheet; its facets' own lengths are kept.
    aim : (f q, 3) where the map puts `springs.SAMPLES` of all facets.
    tolerance : distance from the surface that counts as near.
    """
    made = points
    held = springs_to(surface, skin, tolerance, 1.0, aim)
    U, V = (csr_array(values_at(skin, NODES, order)[:, skin.functions]) for order in ((1, 0), (0, 1)))
    a, b = (_lengths(T @ made[skin.functions]) for T in (U, V))
    size = _sizes(U, np.sqrt(a * b))
    for _ in range(_TURNS):
        tether = held(made)
        tether = replace(tether, A=csr_array(tether.A[:, skin.functions]))
        made = made.copy()
        x = made[skin.functions]
        made[skin.functions] += _step(U, V, a, b, _facing(skin, made, surface), tether, x, size)
    return made


def sines(skin: Skin, points: Array, surface: Surface) -> Array:
    """(f,) least sine of the angle between the tangents of each facet, negative where it is turned over."""
    n = _facing(skin, points, surface)
    U, V = (values_at(skin, NODES, order) @ points for order in ((1, 0), (0, 1)))
    lengths = np.linalg.norm(U, axis=1) * np.linalg.norm(V, axis=1)
    found = (np.cross(U, V) * n).sum(axis=1) / np.maximum(lengths, 1e-300)
    return np.asarray(found.reshape(len(skin.cell), -1).min(axis=1))


def on_sheet(skin: Skin, points: Array, surface: Surface) -> Target:
    """Map from the boundary of the meccano to the points of a surface that are closest to a sheet near it."""
    def target(side: Index, s: Array) -> Array:
        block, xi = places_on_sides(skin, side, s)
        x = collocation(skin.space, block, xi) @ points
        return closest(surface.points, surface.triangles, x)[0]

    return target


def _facing(skin: Skin, points: Array, surface: Surface) -> Array:
    """Normals (f q, 3) that the surface has at and around the nodes of all facets."""
    x, own = values_at(skin, NODES) @ points, outward(skin, points, NODES)
    # Where a facet is turned over, its mean still faces the right way.
    ways = _unit(own + _means(own))
    triangle = closest_facing(surface.points, surface.triangles, x, ways, _FACING)[2]
    lost = triangle < 0
    triangle[lost] = closest(surface.points, surface.triangles, x[lost])[2]
    normals = unit_normals(surface)[triangle]
    return _unit(normals + _means(normals))


def _step(
    U: csr_array, V: csr_array, a: Array, b: Array, facing: Array, tether: Tether, x: Array, size: Array
) -> Array:
    """Step (m, 3) that lowers the energy of boundary control points x (m, 3)."""
    pull, soft = springs(tether, x, csr_array(eye_array(len(x))), size)
    P, Q = csr_array(U.T), csr_array(V.T)
    u, v = U @ x, V @ x
    low = float(((np.cross(u, v) * facing).sum(axis=1) / (a * b)).min())
    delta = np.sqrt(_EPSILON * max(_EPSILON - low, 0.0))

    def energy(z: Array) -> tuple[float, Array]:
        step = np.einsum("mij,mj->mi", soft, z.reshape(-1, 3))
        value, by_u, by_v = shape_energy(u + U @ step, v + V @ step, a, b, facing, delta)
        held, slope = pull(step)
        gradient = (P @ by_u + Q @ by_v) / len(NODES) + slope
        return value / len(NODES) + held, np.einsum("mij,mi->mj", soft, gradient).ravel()

    z = descend(energy, np.zeros(x.size), _STEPS).x
    return np.asarray(np.einsum("mij,mj->mi", soft, z.reshape(-1, 3)))


def shape_energy(u: Array, v: Array, a: Array, b: Array, facing: Array, delta: float) -> tuple[float, Array, Array]:
    """Energy of tangents u, v (k, 3) with ideal lengths a, b (k,), without springs, and its slopes by u and v (k, 3).

    Parameters
    ----------
    facing : (k, 3) unit normals of the surface.
    delta : d; without it the energy is infinite where a facet is turned over.
    """
    s = (np.cross(u, v) * facing).sum(axis=1) / (a * b)
    root = np.sqrt(s * s + 4.0 * delta**2)
    # Without cancellation where s is far below zero.
    h = np.where(s > 0.0, 0.5 * (s + root), 2.0 * delta**2 / np.maximum(root - s, 1e-300))
    if not (h > 0.0).all():
        return np.inf, np.zeros_like(u), np.zeros_like(v)
    ratio = ((u * u).sum(axis=1) / a**2 + (v * v).sum(axis=1) / b**2) / (2.0 * h)
    by_h = -2.0 * ratio**2 / h + 0.5 * _SIZE * (1.0 - 1.0 / h**2)
    by_s = (by_h * h / root / (a * b))[:, None]
    by_u = (2.0 * ratio / h / a**2)[:, None] * u + by_s * np.cross(v, facing)
    by_v = (2.0 * ratio / h / b**2)[:, None] * v + by_s * np.cross(facing, u)
    return float((ratio**2 + 0.5 * _SIZE * (h + 1.0 / h)).sum()), by_u, by_v


def _lengths(tangents: Array) -> Array:
    """Mean lengths of the tangents (f q, 3) of each facet, (f q,)."""
    return np.asarray(_means(np.linalg.norm(tangents, axis=1)[:, None])[:, 0])


def _sizes(U: csr_array, size: Array) -> Array:
    """(m,) size of the smallest facet that each function acts on, from those at all nodes (f q,)."""
    least = np.full(U.shape[1], np.inf)
    entries = U.tocoo()
    np.minimum.at(least, entries.coords[1], size[entries.coords[0]])
    return least


def _means(values: Array) -> Array:
    """Means (f q, c) of values at the nodes of each facet, for each of them."""
    return np.repeat(values.reshape(-1, len(NODES), values.shape[1]).mean(axis=1), len(NODES), axis=0)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))
