r"""Fast diagonalisation: a preconditioner for spaces of tensor-product functions, robust in degree and size.

On one patch the matrix of a second-order form is close to

    P = K_1 x M_2 x M_3 + M_1 x K_2 x M_3 + M_1 x M_2 x K_3

(Kronecker products) with one-dimensional K_d = int omega_d N' N', M_d = int mu_d N N. With K_d U_d = M_d U_d diag(l_d),
U_d^T M_d U_d = I,

    P^-1 = (U_1 x U_2 x U_3) diag(1 / (l_1 + l_2 + l_3)) (U_1 x U_2 x U_3)^T:

six small dense products (Sangalli and Tani 2016, doi:10.1137/16M1062375). The weights are constant on knot intervals
and separable fits of the form's coefficients at the element centres (in logarithms),

    D_dd(s) ~ omega_d(s_d) prod_{k != d} mu_k(s_k),

so that geometry and material enter as far as they separate. Each component has its own P.

Axis letters: d direction, s knot interval, i function of a direction, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from iga.bernstein import bernstein
from iga.block import Block, Kronecker
from iga.cells import HEXAHEDRON, LINE
from iga.chunk import Chunk
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.forms import buffers, control_points, known, site, terms
from iga.frame import Frame
from iga.parallel import one_blas_thread
from iga.quadrature import gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]


SHARED = 300_000
"""Unknowns from which on the dense products are worth several threads."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Product structure of a space of one patch.

    Attributes
    ----------
    shape : functions in each direction; function (i, j, k) has number (i shape[1] + j) shape[2] + k.
    first : for each direction (s,) the first function of each knot interval.
    pattern : for each direction (s,) its one-dimensional extraction operator.
    interval : (e, 3) knot intervals of the elements.
    """

    shape: tuple[int, int, int]
    first: tuple[Index, Index, Index]
    pattern: tuple[Index, Index, Index]
    interval: Index


def grid(space: Space) -> Grid | None:
    """Product structure of a space, or None if it is not one patch numbered lexicographically."""
    if len(space.blocks) != 1 or space.blocks[0].basis.cell is not HEXAHEDRON:
        return None
    block = space.blocks[0]
    if not isinstance(block.extraction, Kronecker) or not block.elements:
        return None
    n = [f.shape[1] for f in block.extraction.factors]
    local = block.dofs[0] - block.dofs[0, 0]
    n3 = int(local[n[2]]) if n[1] > 1 else 1
    plane = int(local[n[1] * n[2]]) if n[0] > 1 else 1
    if n3 < 1 or plane < 1 or plane % n3 or space.n % plane:
        return None
    shape = (space.n // plane, plane // n3, n3)
    start = block.dofs[:, 0]
    first = np.stack([start // plane, start % plane // n3, start % n3], axis=1)
    steps = np.indices(n).reshape(3, -1)
    if not np.array_equal(block.dofs - start[:, None], np.broadcast_to(steps.T @ [plane, n3, 1], block.dofs.shape)):
        return None
    firsts, patterns, interval = [], [], []
    for d in range(3):
        values, where, inverse = np.unique(first[:, d], return_index=True, return_inverse=True)
        pattern = block.extraction.pattern[where, d]
        if not np.array_equal(pattern[inverse], block.extraction.pattern[:, d]):
            return None
        firsts.append(values)
        patterns.append(pattern)
        interval.append(inverse.reshape(-1))
    if np.prod([len(f) for f in firsts]) != block.elements:
        return None
    return Grid(
        shape, (firsts[0], firsts[1], firsts[2]), (patterns[0], patterns[1], patterns[2]), np.stack(interval, axis=1)
    )


@dataclass(frozen=True, eq=False)
class FastDiagonalisation:
    """The preconditioner; calling it applies P^-1 to a residual over the free unknowns, in ascending order.

    Attributes
    ----------
    free : (m,) free unknowns.
    boxes : for each component the box of functions that P is made for: low and high (exclusive) in each direction.
    vectors, inverse : eigenvectors of each direction and 1 / (sum of eigenvalues), by component.
    """

    shape: tuple[int, int, int]
    free: Index
    boxes: tuple[NDArray[np.int64], ...]
    vectors: tuple[tuple[Array, Array, Array], ...]
    inverse: tuple[Array, ...]

    def __call__(self, r: Array) -> Array:
        """Correction for a residual (m,)."""
        with one_blas_thread() if len(r) < SHARED else nullcontext():
            return self._apply(r)

    def _apply(self, r: Array) -> Array:
        c = len(self.boxes)
        full = np.zeros((*self.shape, c))
        full.reshape(-1)[self.free] = r
        for a, ((i, j, k), U, inverse) in enumerate(zip(self.boxes, self.vectors, self.inverse)):
            inside = full[i[0] : i[1], j[0] : j[1], k[0] : k[1], a]
            x = _products(np.ascontiguousarray(inside), U[0].T, U[1].T, U[2].T)
            inside[...] = _products(x * inverse, *U)
        return full.reshape(-1)[self.free]


def fast_diagonalisation(
    domain: Domain, integrand: Callable[[Chunk], Array], free: Index | None = None
) -> FastDiagonalisation | None:
    """Make the preconditioner of a built-in form, or return None if the space has no product structure.

    Parameters
    ----------
    integrand : diffusion, elasticity or mass.
    free : (m,) unknowns that are solved for, all by default. Where they are not a box of functions (a face is fixed in
        part) the preconditioner is that of the smallest box around them, restricted.

    Raises
    ------
    InputError : not a built-in form.
    """
    if not known(integrand):
        raise InputError("fast diagonalisation exists for diffusion, elasticity and mass")
    structure = grid(domain.space)
    if structure is None or domain.space.constraint is not None:
        return None
    c = int(getattr(integrand, "components", 1))
    unknowns = np.arange(domain.space.n * c) if free is None else np.asarray(free)
    coefficients, masses = _centre_coefficients(domain, integrand, structure, c)
    boxes, vectors, inverses = [], [], []
    for a in range(c):
        mine = np.unravel_index(unknowns[unknowns % c == a] // c, structure.shape)
        if not len(mine[0]):
            box = np.zeros((3, 2), dtype=np.int64)
        else:
            box = np.array([[i.min(), i.max() + 1] for i in mine])
        omega, mu = _separate(coefficients[a]) if coefficients[a].any() else (None, _separate_mass(masses[a]))
        U, values = [], []
        for d in range(3):
            K, M = _line_matrices(domain.space.blocks[0], structure, d, None if omega is None else omega[d], mu[d])
            low, high = box[d]
            eigenvalues, eigenvectors = eigh(K[low:high, low:high], M[low:high, low:high])
            U.append(eigenvectors)
            values.append(eigenvalues)
        total = values[0][:, None, None] + values[1][:, None] + values[2]
        if omega is None:
            total = np.ones_like(total)
        elif total.size:
            # Held in part of a face only, or weakly: P alone has rigid motions; lift them to the next mode.
            total = np.maximum(total, total[total > 1e-12 * total.max()].min())
        boxes.append(box)
        vectors.append((U[0], U[1], U[2]))
        inverses.append(1.0 / total)
    return FastDiagonalisation(structure.shape, unknowns, tuple(boxes), tuple(vectors), tuple(inverses))


def _products(x: Array, A: Array, B: Array, C: Array) -> Array:
    """(A x B x C) x for x (n1, n2, n3)."""
    x = (A @ x.reshape(x.shape[0], -1)).reshape(A.shape[0], *x.shape[1:])
    x = B @ x
    return x @ C.T


def _centre_coefficients(
    domain: Domain, integrand: Callable[[Chunk], Array], structure: Grid, c: int
) -> tuple[list[Array], list[Array]]:
    """Coefficients at element centres by component: D_dd (3, s1, s2, s3), and that of the mass term (s1, s2, s3)."""
    f = Frame(domain.space.blocks[0], gauss(HEXAHEDRON, 1), domain.space.weights, repeat=0)
    work, control = buffers(f, pairs=True), control_points(domain)
    sizes = tuple(len(first) for first in structure.first)
    stiff = [np.zeros((3, *sizes)) for _ in range(c)]
    mass = [np.zeros(sizes) for _ in range(c)]
    for lo in range(0, f.block.elements, f.size):
        hi = min(lo + f.size, f.block.elements)
        where = tuple(structure.interval[lo:hi].T)
        for a, b, D in terms(integrand, site(f, 0, lo, hi, control, work), work):
            if a == b:
                mass[a][where] = D[:, 0, 0]
                for d, k in enumerate((4, 7, 9)):
                    stiff[a][(d, *where)] = D[:, k, 0]
    if domain.space.weights is not None:
        # Functions are w N / W: near an element w ~ W, so the factor w^2 puts the coefficients back in scale.
        centre = domain.space.weights[f.block.dofs].mean(axis=1) ** 2
        scale = np.zeros(sizes)
        scale[tuple(structure.interval.T)] = centre
        stiff = [s * scale for s in stiff]
        mass = [m * scale for m in mass]
    return stiff, mass


def _separate(D: Array) -> tuple[list[Array], list[Array]]:
    """Weights omega_d and mu_d of each direction from coefficients (3, s1, s2, s3)."""
    logs = np.log(np.maximum(D, 1e-300))
    mean = logs.mean(axis=(1, 2, 3))
    profile = [[logs[d].mean(axis=tuple(x for x in range(3) if x != k)) for k in range(3)] for d in range(3)]
    omega = [np.exp(profile[d][d]) for d in range(3)]
    mu = [np.exp(np.mean([profile[d][k] - mean[d] for d in range(3) if d != k], axis=0)) for k in range(3)]
    return omega, mu


def _separate_mass(D: Array) -> list[Array]:
    """Weights mu_d of each direction from the coefficient of a mass (s1, s2, s3)."""
    logs = np.log(np.maximum(D, 1e-300))
    profile = [logs.mean(axis=tuple(x for x in range(3) if x != k)) for k in range(3)]
    return [np.exp(profile[0]), np.exp(profile[1] - logs.mean()), np.exp(profile[2] - logs.mean())]


def _line_matrices(
    block: Block, structure: Grid, d: int, omega: Array | None, mu: Array
) -> tuple[Array, Array]:
    """One-dimensional K (zero without omega) and M of a direction."""
    assert isinstance(block.extraction, Kronecker)
    p = block.basis.degree[d]
    rule = gauss(LINE, p + 1)
    values, slopes = bernstein(LINE, p).tabulate(rule.points, 1)
    C = block.extraction.factors[d]
    N, dN = C @ values.T, C @ slopes[..., 0].T
    n = structure.shape[d]
    K, M = np.zeros((n, n)), np.zeros((n, n))
    index = structure.first[d][:, None] + np.arange(C.shape[1])
    rows, columns = index[:, :, None], index[:, None, :]
    pattern = structure.pattern[d]
    mass = np.einsum("kiq,q,kjq->kij", N, rule.weights, N)
    np.add.at(M, (rows, columns), mass[pattern] * mu[:, None, None])
    if omega is not None:
        stiff = np.einsum("kiq,q,kjq->kij", dN, rule.weights, dN)
        np.add.at(K, (rows, columns), stiff[pattern] * omega[:, None, None])
    return K, M
