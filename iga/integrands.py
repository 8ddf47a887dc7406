r"""Integrands: weak forms as plain functions of a chunk.

    Diffusion   K_ij = int grad N_i . k grad N_j            Load      f_i = int s N_i
    Elasticity  K_ij = int eps(N_i) : D : eps(N_j)          Pressure  f_i = -int p n N_i      (facets)
    Mass        M_ij = int rho N_i N_j                      InitialStrain  f_i = int eps(N_i) : D : eps0

Each is a frozen record of its coefficients that is called with a `Chunk` and returns one local array per element. On
facets ``Mass`` is a Robin or spring term and ``Load`` a flux or traction. A user's own integrand is any function of a
chunk that returns (e, n*c, n*c) or (e, n*c), local unknown n*c + component.

Strains and stresses are Voigt vectors in the order xx, yy, zz, yz, xz, xy with engineering shear strains.

Axis letters: e element, q point, n function on the element, c component, v Voigt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.chunk import Chunk
from iga.field import Coefficient, as_tensors, evaluate

Array = NDArray[np.float64]

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Tensor index pair of each Voigt component."""


def isotropic(lame: float | Array, shear: float | Array) -> Array:
    """Stiffness (..., 6, 6) of an isotropic material from the Lame parameters lambda and mu (the same units)."""
    lame, shear = np.broadcast_arrays(np.asarray(lame, dtype=float), np.asarray(shear, dtype=float))
    D = np.zeros((*lame.shape, 6, 6))
    D[..., :3, :3] = lame[..., None, None]
    for i in range(3):
        D[..., i, i] += 2.0 * shear
        D[..., 3 + i, 3 + i] = shear
    return D


def strain_operator(G: Array) -> Array:
    """Matrices B with strain = B u, from gradients (e, q, n, 3): (e, q, 6, n*3)."""
    e, q, n, _ = G.shape
    B = np.zeros((e, q, 6, n, 3))
    for v, (i, j) in enumerate(VOIGT):
        B[:, :, v, :, i] = G[..., j]
        if i != j:
            B[:, :, v, :, j] = G[..., i]
    return B.reshape(e, q, 6, n * 3)


def strain(gradient: Array) -> Array:
    """Voigt strain (..., 6) of displacement gradients (..., 3, 3), last axis the derivative."""
    return np.stack(
        [gradient[..., i, j] if i == j else gradient[..., i, j] + gradient[..., j, i] for i, j in VOIGT], axis=-1
    )


@dataclass(frozen=True, eq=False)
class Diffusion:
    """Diffusion; ``conductivity`` is scalar or (3, 3), constant or varying."""

    conductivity: Coefficient = 1.0
    components: int = 1

    def __call__(self, chunk: Chunk) -> Array:
        """Local matrices (e, n, n)."""
        k = as_tensors(evaluate(self.conductivity, chunk), 3)
        G = chunk.G
        flux = G @ np.swapaxes(k, -1, -2) if are_tensors(k) else G * k[..., None, None]
        e, q, n, d = G.shape
        left = G.transpose(0, 2, 1, 3).reshape(e, n, q * d)
        right = (flux * chunk.dx[..., None, None]).transpose(0, 1, 3, 2).reshape(e, q * d, n)
        return left @ right


@dataclass(frozen=True, eq=False)
class Elasticity:
    """Linear elasticity; ``stiffness`` is the Voigt matrix (6, 6), constant or varying."""

    stiffness: Coefficient
    components: int = 3

    def __call__(self, chunk: Chunk) -> Array:
        """Local matrices (e, n*3, n*3)."""
        D = as_tensors(evaluate(self.stiffness, chunk), 6)
        B = strain_operator(chunk.G)
        stress = (D @ B) * chunk.dx[..., None, None]
        e, q, v, m = B.shape
        return B.reshape(e, q * v, m).swapaxes(1, 2) @ stress.reshape(e, q * v, m)


@dataclass(frozen=True, eq=False)
class Mass:
    """Mass, or a Robin/spring term on facets; ``density`` is scalar, or (c, c) for coupled components."""

    density: Coefficient = 1.0
    components: int = 1

    def __call__(self, chunk: Chunk) -> Array:
        """Local matrices (e, n*c, n*c)."""
        rho = as_tensors(evaluate(self.density, chunk), self.components)
        coupled = rho.ndim >= 2 and rho.shape[-2:] == (self.components,) * 2 and rho.shape != chunk.dx.shape
        left = np.swapaxes(chunk.N, 1, 2)
        if not coupled:
            M = left @ (chunk.N * (chunk.dx * rho)[..., None])
            if self.components == 1:
                return M
            return _kron(M, np.eye(self.components))
        local = np.einsum("eqn,eq,eqcd,eqm->encmd", np.broadcast_to(chunk.N, (len(chunk.elements), *chunk.N.shape[1:])),
                          chunk.dx, np.broadcast_to(rho, (*chunk.dx.shape, *rho.shape[-2:])),
                          np.broadcast_to(chunk.N, (len(chunk.elements), *chunk.N.shape[1:])), optimize=True)
        m = chunk.n * self.components
        return local.reshape(len(chunk.elements), m, m)


@dataclass(frozen=True, eq=False)
class Load:
    """Source, body force, flux or traction; ``source`` is scalar, or (c,) for several components."""

    source: Coefficient
    components: int = 1

    def __call__(self, chunk: Chunk) -> Array:
        """Local vectors (e, n*c)."""
        s = evaluate(self.source, chunk)
        if self.components == 1:
            return ((chunk.dx * s)[:, None, :] @ chunk.N)[:, 0, :]
        s = np.broadcast_to(s, (*chunk.dx.shape, self.components)) * chunk.dx[..., None]
        return (chunk.N.swapaxes(1, 2) @ s).reshape(len(chunk.elements), -1)


@dataclass(frozen=True, eq=False)
class Pressure:
    """Pressure on facets, positive against the outward normal."""

    pressure: Coefficient
    components: int = 3

    def __call__(self, chunk: Chunk) -> Array:
        """Local vectors (e, n*3)."""
        p = np.broadcast_to(evaluate(self.pressure, chunk), chunk.dx.shape)
        traction = -chunk.normal * (p * chunk.dx)[..., None]
        return (chunk.N.swapaxes(1, 2) @ traction).reshape(len(chunk.elements), -1)


@dataclass(frozen=True, eq=False)
class InitialStrain:
    """Load of an initial strain (6,), such as thermal expansion, in a material ``stiffness`` (6, 6)."""

    stiffness: Coefficient
    strain: Coefficient
    components: int = 3

    def __call__(self, chunk: Chunk) -> Array:
        """Local vectors (e, n*3)."""
        D, eps = as_tensors(evaluate(self.stiffness, chunk), 6), evaluate(self.strain, chunk)
        stress = (D @ eps[..., None])[..., 0] * chunk.dx[..., None]
        return np.einsum("eqvm,eqv->em", strain_operator(chunk.G), stress, optimize=True)


def are_tensors(k: Array) -> bool:
    """Whether a conductivity, as `iga.field.evaluate` gives it, is (3, 3) at each point rather than a number."""
    return k.ndim in (2, 4) and k.shape[-2:] == (3, 3)


def _kron(M: Array, identity: Array) -> Array:
    """(e, n, n) and (c, c) to (e, n*c, n*c)."""
    e, n, _ = M.shape
    c = len(identity)
    return (M[:, :, None, :, None] * identity[None, None, :, None, :]).reshape(e, n * c, n * c)
