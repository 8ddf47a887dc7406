r"""Dirichlet conditions, imposed weakly by Nitsche's method (Nitsche 1971, doi:10.1007/BF02995904).

With the flux s(u) = n . k grad u or the traction s(u) = n . sigma(u):

    a(u, v) - int s(u) v - int u s(v) + int gamma u v  =  f(v) - int g s(v) + int gamma g v

which stays positive definite if gamma exceeds, on each element E, the largest lambda with
int_F s(u)^2 <= lambda a_E(u, u) for all u; gamma is twice a bound of it, times the number of the element's facets with
the condition. The normal variant keeps only n . u and n . s: symmetry planes and sliding on curved boundaries.

Axis letters: e element or facet, q point, n function, c component, m = n c unknown of an element, t constrained
direction (c of them, or the normal).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import sum_of, unknowns
from iga.chunk import Chunk, facet_chunks, rule_for
from iga.conditions import Value, by_component, unclaimed
from iga.domain import Domain, facets_of
from iga.errors import InputError
from iga.field import as_tensors, evaluate
from iga.integrands import Diffusion, Elasticity, are_tensors, strain_operator
from iga.linear.coarse_space import rigid_motions

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DEFINITE = 1e-12
"""Multiple of the identity, in mean diagonal entries, that keeps energies definite where no function has any."""


def nitsche(
    domain: Domain,
    data: Mapping[str, Value],
    physics: Diffusion | Elasticity,
    normal: bool = False,
    points: int | None = None,
) -> tuple[csr_array, Array]:
    """Matrix and vector that impose boundary values weakly: add them to K and f.

    Parameters
    ----------
    data : boundary names or patterns with values, as for `dirichlet` but with all components given; where boundaries
        overlap, the later entry holds.
    physics : the integrand of the volume: its coefficient gives the flux or traction and the penalty.
    normal : fix the normal displacement only (elasticity); values are then numbers or scalar functions of x.
    points : Gauss points per direction, by default `iga.chunk.default_points`.

    Returns
    -------
    (N*c, N*c) and (N*c,)

    Raises
    ------
    InputError : a name matches no boundary, or a normal condition is asked of a scalar problem.
    """
    c = physics.components
    if normal and c != 3:
        raise InputError("a normal condition needs a vector problem")
    size = domain.space.n * c
    load = np.zeros(size)
    everything = facets_of(domain, list(data)) if data else ()
    times = [np.zeros(block.elements, dtype=np.int64) for block in domain.space.blocks]
    for f in everything:
        times[f.block][f.elements] += 1
    claimed: dict[tuple[int, int], NDArray[np.bool_]] = {}

    def terms() -> Iterator[tuple[Index, Array]]:
        for name, value in reversed(list(data.items())):
            for chunk in facet_chunks(domain, unclaimed(domain, facets_of(domain, name), claimed), points):
                S, V = _flux(chunk, physics), _trace(chunk, c)
                if normal:
                    S, V = (np.einsum("eqt,eqtm->eqm", chunk.normal, A)[:, :, None, :] for A in (S, V))
                gamma = 2.0 * times[chunk.block][chunk.elements] * _trace_constant(chunk, physics, S, points)
                local, force = _local(chunk, S, V, _values(chunk, name, value, V.shape[2]), gamma)
                index = unknowns(chunk.dofs, c)
                np.add.at(load, index, force)
                yield index, local

    K = sum_of(terms(), size)  # which fills the load
    return K, load


def _local(chunk: Chunk, S: Array, V: Array, g: Array, gamma: Array) -> tuple[Array, Array]:
    """Matrices (e, m, m) and vectors (e, m) of facets: flux S, value V (e, q, t, m), data (e, q, t), penalty (e,)."""
    e, q, t, m = S.shape
    scale = chunk.dx[:, :, None]
    flat_S, flat_V = S.reshape(e, q * t, m), V.reshape(e, q * t, m)
    weighted = (V * scale[..., None]).reshape(e, q * t, m).swapaxes(1, 2)
    cross = weighted @ flat_S
    local = gamma[:, None, None] * (weighted @ flat_V) - cross - cross.swapaxes(1, 2)
    right = (g * scale).reshape(e, q * t, 1)
    force = gamma[:, None] * (flat_V.swapaxes(1, 2) @ right)[..., 0]
    force -= (flat_S.swapaxes(1, 2) @ right)[..., 0]
    return local, force


def _values(chunk: Chunk, name: str, value: Value, directions: int) -> Array:
    """Data (e, q, t) of a Nitsche condition."""
    parts = by_component(name, value, directions)
    if any(part is None for part in parts):
        raise InputError(f"boundary {name!r}: a weak condition needs a value for each component")
    return np.stack([np.broadcast_to(evaluate(p, chunk), chunk.dx.shape) for p in parts if p is not None], axis=-1)


def _trace(chunk: Chunk, c: int) -> Array:
    """Operators V with V u the value on the facet, (e, q, c, n*c)."""
    e, q, n = len(chunk.elements), len(chunk.points), chunk.n
    N = np.broadcast_to(chunk.N, (e, q, n))
    return (N[:, :, None, :, None] * np.eye(c)[None, None, :, None, :]).reshape(e, q, c, n * c)


def _flux(chunk: Chunk, physics: Diffusion | Elasticity) -> Array:
    """Operators S with S u the outward flux or the traction, (e, q, c, n*c)."""
    n = chunk.normal
    if isinstance(physics, Diffusion):
        k = as_tensors(evaluate(physics.conductivity, chunk), 3)
        if are_tensors(k):
            direction = np.einsum("eqi,ij->eqj" if k.ndim == 2 else "eqi,eqij->eqj", n, k)
        else:
            direction = n * k[..., None]
        return (chunk.G @ direction[..., None])[..., 0][:, :, None, :]
    D = as_tensors(evaluate(physics.stiffness, chunk), 6)
    zero = np.zeros(n.shape[:2])
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    # Traction n . sigma from the Voigt stress xx, yy, zz, yz, xz, xy.
    normals = np.stack([np.stack([x, zero, zero, zero, z, y], -1), np.stack([zero, y, zero, z, zero, x], -1),
                        np.stack([zero, zero, z, y, x, zero], -1)], axis=-2)
    return np.asarray(normals @ D @ strain_operator(chunk.G))


def _trace_constant(chunk: Chunk, physics: Diffusion | Elasticity, S: Array, points: int | None) -> Array:
    """Bound (e,) of the largest lambda with int_F (S u)^2 <= lambda a_E(u, u).

    Both forms vanish on the motions without energy, which are made orthonormal and added to a_E to make it definite.
    With B = F^T F and C = F A^-1 F^T, which has the eigenvalues of A^-1 B, lambda <= |C^4|_F^(1/4), at most 1.8 times
    too large for 100 functions on F.
    """
    rule = rule_for(chunk.domain, chunk.block, points)
    inside = Chunk(chunk.domain, chunk.block, chunk.elements, rule.points, rule.weights, rule)
    A = physics(inside)
    e, q, t, m = S.shape
    F = S.reshape(e, q * t, m) * np.sqrt(np.repeat(chunk.dx, t, axis=1))[..., None]
    if isinstance(physics, Diffusion):
        modes = np.ones((1, m, 1)) / np.sqrt(m)
    else:
        points3 = chunk.domain.points[chunk.dofs]
        modes = np.linalg.qr(np.stack([rigid_motions(p) for p in points3]))[0]
    size = np.trace(A, axis1=1, axis2=2) / m
    # Hierarchical splines and T-splines may have more functions on an element than it has polynomials: both forms
    # vanish on what is left over, and the small multiple of the identity keeps A definite there.
    ground = modes @ modes.swapaxes(1, 2) + DEFINITE * np.eye(m)
    folded = np.flatnonzero((inside.det <= 0.0).any(axis=1))
    if len(folded):
        # The energy of a folded element is not positive; any penalty of the right size will do there.
        values, vectors = np.linalg.eigh(A[folded])
        A[folded] = (vectors * np.abs(values)[:, None, :]) @ vectors.swapaxes(1, 2)
        size[folded] = np.abs(values).mean(axis=1)
    A = A + size[:, None, None] * ground
    C = F @ np.linalg.solve(A, F.swapaxes(1, 2))
    squared = C @ C
    return np.asarray((np.linalg.norm(squared @ squared, axis=(1, 2))) ** 0.25)
