r"""Control points of a solid from maps of the meccano.

Inside, the coefficient of a function is the value of the volumetric parametrisation at the function's Greville point
(the mean of its inner knots), which keeps straight lines and does not overshoot; truncation keeps coefficients
(Speleers and Manni 2016, doi:10.1007/s00211-016-0828-x). On the boundary the sum of squares

    sum_k w_k ((1 - a) (n_k . r_k)^2 + a |r_k|^2) + b sum_f int |d_uu x|^2 + 2 |d_uv x|^2 + |d_vv x|^2 du dv

of the distances r_k = x(s_k) - p_k from targets p_k at sample points of all facets is minimised, with n_k the normal of
the surface: distances along the surface count little (a) where the targets are only closest points.

Axis letters: n function, m boundary function, k sample point, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import LinearOperator, cg

from geometry.layouts.blocks import place
from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.skin import Skin, values_at
from iga.assembly import matrix
from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import Diffusion
from iga.linear.solvers import solve

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def greville_points(space: Hierarchy) -> tuple[Index, Array]:
    """Block (n,) and coordinates xi (n, d) of the Greville point of each function."""
    p, size = space.degree, np.left_shift(1, space.level)[:, None]
    inner = sum(np.clip(space.index + m - p, 0, size) for m in range(1, p + 1))
    return space.tmesh.block[space.home], inner / (p * size)


def fit_boundary(
    skin: Skin, points: Array, u: Array | csr_array, targets: Array, normals: Array | None = None, along: float = 1.0,
    fairness: float = 1e-4, weights: Array | None = None, fixed: Index | None = None,
) -> Array:
    """Control points (n, 3) whose boundary functions are fitted; the others stay.

    Parameters
    ----------
    points : (n, 3) where to start from.
    u : (q, 2) sample points of each facet, or a matrix (k, n) that gives any points from control points.
    targets, normals : (f q, 3) or (k, 3), where they should lie, and the normals of the surface there.
    along : a, weight of distances along the surface, relative to those across.
    fairness : b, relative to the sum of weights of a facet.
    weights : (f q,) of the samples; by default those of a facet sum to one.
    fixed : functions of the boundary that keep their control points.

    Raises
    ------
    InputError : the fit does not converge.
    """
    free = skin.functions if fixed is None else np.setdiff1d(skin.functions, fixed)
    full = values_at(skin, u) if isinstance(u, np.ndarray) else u
    A = csr_array(full[:, free])
    back = csr_array(A.T)
    w = np.full(len(targets), len(skin.cell) / len(targets)) if weights is None else weights
    bend = _bending(skin)
    F, unbend = csr_array(bend[:, free]), csr_array(bend[:, free].T)
    residual, bent = targets - full @ points, -(bend @ points)

    def weighted(r: Array) -> Array:
        if normals is None or along == 1.0:
            return w[:, None] * r
        across = (normals * r).sum(axis=1, keepdims=True) * normals
        return w[:, None] * (along * r + (1.0 - along) * across)

    def product(x: Array) -> Array:
        X = x.reshape(-1, 3)
        return (back @ weighted(A @ X) + fairness * (unbend @ (F @ X))).ravel()

    right = (back @ weighted(residual) + fairness * (unbend @ bent)).ravel()
    scale = back.power(2) @ w + fairness * np.asarray(unbend.power(2).sum(axis=1)).ravel()
    diagonal = np.repeat(1.0 / np.maximum(scale, 1e-12 * scale.max(initial=1.0)), 3)
    size = len(right)
    solved, failed = cg(
        LinearOperator((size, size), product), right, rtol=1e-3, maxiter=4000,
        M=LinearOperator((size, size), lambda x: diagonal * x.ravel()),
    )
    if failed:
        raise InputError(f"the fit of {len(free)} boundary control points did not converge in {failed} iterations")
    made = points.copy()
    made[free] += solved.reshape(-1, 3)
    return made


def harmonic(space: Hierarchy, points: Array, fixed: Index) -> Array:
    """Control points (n, c) that are harmonic in the picture of the meccano, with those of ``fixed`` functions given.

    Raises
    ------
    ConvergenceError : the solver does not reach its tolerance.
    """
    block, xi = greville_points(space)
    picture = Domain(space.space, place(space.tmesh.blocks, block, xi))
    K = matrix(picture, Diffusion())
    return np.stack([
        solve(K, np.zeros(len(points)), (fixed, points[fixed, c]), domain=picture, tolerance=1e-9)[0]
        for c in range(points.shape[1])
    ], axis=1)


def laid(points: Array, A: csr_array, where: Array) -> Array:
    """Points (n, 3) moved by the similarity that brings A @ points nearest to places (k, 3) (Umeyama 1991)."""
    own = A @ points
    centre, goal = own.mean(axis=0), where.mean(axis=0)
    u, s, v = np.linalg.svd((where - goal).T @ (own - centre))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    scale = (s * sign).sum() / ((own - centre) ** 2).sum()
    return np.asarray(goal + scale * (points - centre) @ (u * sign @ v).T)


def _bending(skin: Skin) -> csr_array:
    """Matrix whose rows squared sum to the bending energies of all facets (for cubics: a rule of 2 x 2 points)."""
    g = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    u = np.stack(np.meshgrid(g, g, indexing="ij"), axis=-1).reshape(-1, 2)
    kinds = (((2, 0), 0.5), ((1, 1), np.sqrt(0.5)), ((0, 2), 0.5))
    parts = [values_at(skin, u, order) * factor for order, factor in kinds]
    return csr_array(vstack(parts))
