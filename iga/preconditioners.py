r"""Multilevel preconditioners that are robust in the degree and the size of a space.

One symmetric cycle, from a residual r to a correction x:

    x = (D + L)^-1 r;    x += W A_1^-1 W^T (r - A x);    x += (D + U)^-1 (r - A x)

with W from a coarser space. From degree p the next coarser space is that of the degree-one functions on the same cells,
which for C0 Bernstein spaces is a subspace (W is degree elevation); a spline takes the average of the linear function's
Bernstein coefficients over one of its elements (a local quasi-interpolation that keeps constants). The degree-one
matrix A_1 = W^T A W is factored if that is cheap and coarsened by smoothed aggregation around the rigid motions if not
(Vanek, Mandel and Brezina 1996, doi:10.1007/BF02238511). The matrix is scaled to unit diagonal and stored in single
precision, which halves the traffic; the conjugate gradients around it stay in double precision. Sweeps run in parallel
on parts of the rows; couplings between parts enter the diagonal, enough to keep the cycle positive definite (Baker et
al. 2011, see `iga.kernels.sparse`).

Axis letters: n function, e element, b Bernstein function, v vertex, c component, m mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array, csr_array, csr_matrix

from iga.bernstein import bernstein, elevation, greville
from iga.block import Block, Kronecker, Patterns, bezier_coefficients, dense_extraction
from iga.domain import Space
from iga.errors import InputError
from iga.factorization import estimate, factorize
from iga.kernels import sparse

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]

TINY = 300
"""Unknowns up to which a matrix is always factored."""
COARSE = 3e10
"""Operations up to which a coarse matrix is factored (a second or so)."""


@dataclass(frozen=True, eq=False)
class Preconditioner:
    """A linear map from residuals to corrections, with a name for the log."""

    name: str
    apply: Callable[[Array], Array]

    def __call__(self, r: Array) -> Array:
        """Correction for a residual (n,)."""
        return self.apply(r)


@dataclass(frozen=True, eq=False)
class Level:
    """One level of a cycle, in single precision: scaled matrix, smoother, and transfer to the next coarser level."""

    pointers: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: Single
    inverse: Single
    starts: Index
    scale: Array
    down: csr_array | None
    up: csr_array | None


def jacobi(K: csr_array) -> Preconditioner:
    """Division by the diagonal."""
    inverse = 1.0 / _positive_diagonal(K)
    return Preconditioner("Jacobi", lambda r: inverse * r)


def multilevel(K: csr_array, W: csr_array | None, modes: Array, block: int = 1) -> Preconditioner:
    """Multilevel preconditioner of a symmetric positive definite matrix.

    Parameters
    ----------
    K : (n, n), sorted. Rows and columns of fixed unknowns may be those of the identity.
    W : (n, n_1) prolongation from degree one, or None if K itself is of low degree.
    modes : (n, m) functions of no energy but for boundary conditions (constants, rigid motions).
    block : 3 if unknowns come in triples that are to be relaxed together, else 1.

    Raises
    ------
    InputError : a diagonal entry of K is not positive.
    """
    levels: list[Level] = []
    name = "smoothed aggregation"
    A, width = K, block
    if W is not None and W.shape[1]:
        levels.append(_level(A, W, width))
        A = csr_array(W.T @ csr_array(A @ W))
        A.sum_duplicates()
        modes = _restrict_modes(W, modes)
        name = "degree one"
    elif W is not None:
        levels.append(_level(A, None, width))
        return Preconditioner("Gauss-Seidel", lambda r: _cycle(levels, 0, r, None))
    if A.shape[0] > TINY and (not levels or not _cheap(A)):
        hierarchy = _aggregate(A, modes, block)
        for fine, P in hierarchy[:-1]:
            levels.append(_level(fine, P, width if fine.shape[0] % width == 0 and fine is A else 1))
        A = hierarchy[-1][0]
        name = f"{name}, aggregation" if W is not None else name
    coarse = factorize(A, symmetric=True)
    if not levels:
        return Preconditioner("factorization", coarse)
    return Preconditioner(name, lambda r: _cycle(levels, 0, r, coarse._solve))


def rigid_motions(points: Array) -> Array:
    """Translations along and rotations about x, y, z of displaced points (n, 3), as columns (n*3, 6)."""
    x = (points - points.mean(axis=0)) / max(float(np.ptp(points, axis=0).max(initial=0.0)), 1e-300)
    modes = np.zeros((len(points), 3, 6))
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        modes[:, a, a] = 1.0
        modes[:, b, 3 + a] = -x[:, c]
        modes[:, c, 3 + a] = x[:, b]
    return modes.reshape(-1, 6)


def linear_prolongation(space: Space) -> csr_array | None:
    """Matrix (n, vertices) from the degree-one functions on the cells of a space; None if all are of degree one.

    For C0 Bernstein spaces this is degree elevation, so the product with vertex values reproduces linear functions.
    """
    if all(max(block.basis.degree) == 1 and block.extraction is None for block in space.blocks):
        return None
    random = np.random.default_rng(20185).random((space.n, 1))
    corner_values = []
    for block in space.blocks:
        bezier = bezier_coefficients(block, random)[:, _corners(block), 0]
        corner_values.append(bezier)
    vertices, count = _identify(np.concatenate([v.ravel() for v in corner_values]))
    rows: list[Index] = []
    columns: list[Index] = []
    values: list[Array] = []
    best = np.zeros(space.n)
    local_matrices = [_local(block) for block in space.blocks]
    for block, (_, sums, pattern) in zip(space.blocks, local_matrices):
        np.maximum.at(best, block.dofs, sums[pattern])
    taken = np.zeros(space.n, dtype=bool)
    at = 0
    for block, (matrices, sums, pattern), corner in zip(space.blocks, local_matrices, corner_values):
        own = vertices[at : at + corner.size].reshape(corner.shape)
        at += corner.size
        # The first element on which a function weighs most stands for it.
        fits = (sums[pattern] >= best[block.dofs] * (1 - 1e-9)) & ~taken[block.dofs]
        e, n = np.nonzero(fits)
        dofs, first = np.unique(block.dofs[e, n], return_index=True)
        e, n = e[first], n[first]
        taken[dofs] = True
        rows.append(np.repeat(dofs, len(own[0])))
        columns.append(own[e].ravel())
        shares = matrices[pattern[e], n] / sums[pattern[e], n][:, None]
        values.append(shares.ravel())
    entries = np.concatenate(values)
    keep = np.abs(entries) > 1e-12
    made = coo_array((entries[keep], (np.concatenate(rows)[keep], np.concatenate(columns)[keep])), (space.n, count))
    return csr_array(made.tocsr())


def _corners(block: Block) -> Index:
    """Bernstein function at each vertex of the cell."""
    points, vertices = greville(block.basis), block.basis.cell.vertices
    return np.abs(points[None] - vertices[:, None]).max(axis=-1).argmin(axis=1)


def _local(block: Block) -> tuple[Array, Array, Index]:
    """Products C E (k, n, v) with the elevation E from degree one, sums of C over b (k, n), and which k (e,)."""
    E = elevation(bernstein(block.basis.cell, 1), tuple(block.basis.degree))
    extraction = block.extraction
    if isinstance(extraction, Kronecker):
        _, first, pattern = np.unique(extraction.pattern, axis=0, return_index=True, return_inverse=True)
        C = dense_extraction(block, first)
    elif isinstance(extraction, Patterns):
        C, pattern = extraction.C, extraction.pattern
    else:
        C, pattern = np.eye(block.n)[None], np.zeros(block.elements, dtype=np.int64)
    assert C is not None
    return C @ E, C.sum(axis=2), np.asarray(pattern).ravel()


def _identify(values: Array) -> tuple[Index, int]:
    """Numbers of equal values, to rounding: vertices with the same value of a random function are one vertex."""
    order = np.argsort(values, kind="stable")
    group = np.concatenate([[0], np.cumsum(np.diff(values[order]) > 1e-13)])
    numbers = np.empty(len(values), dtype=np.int64)
    numbers[order] = group
    return numbers, int(group[-1]) + 1


def _restrict_modes(W: csr_array, modes: Array) -> Array:
    """Coarse coefficients whose prolongation is close to the modes: weighted means of the fine ones."""
    # The vertex functions peak at their vertices: the mean over the rows with the largest weights.
    peak = np.asarray(abs(W).max(axis=0).todense()).ravel()
    sharp = W.tocoo()
    sharp.data = np.where(np.abs(sharp.data) >= (1 - 1e-9) * peak[sharp.coords[1]], 1.0, 0.0)
    counts = np.asarray(sharp.sum(axis=0)).ravel()
    return np.asarray(sharp.T @ modes) / np.maximum(counts, 1.0)[:, None]


def _cheap(K: csr_array) -> bool:
    """Whether factoring a coarse matrix takes about a second at most."""
    if K.shape[0] > 400_000:
        return False
    cost = estimate(K)
    return cost is not None and cost.operations <= COARSE


def _aggregate(K: csr_array, modes: Array, block: int) -> list[tuple[csr_array, csr_array | None]]:
    """Matrices and prolongations of smoothed aggregation, finest first."""
    A = csr_matrix(K)
    if block > 1 and A.shape[0] % block == 0:
        A = A.tobsr((block, block))
    hierarchy = pyamg.smoothed_aggregation_solver(
        A, B=modes, max_coarse=min(8000, A.shape[0] // 4), improve_candidates=None, presmoother=None, postsmoother=None,
    )
    made: list[tuple[csr_array, csr_array | None]] = []
    for number, level in enumerate(hierarchy.levels):
        fine = K if number == 0 else csr_array(level.A)
        P = csr_array(level.P) if number + 1 < len(hierarchy.levels) else None
        made.append((fine, P))
    return made


def _positive_diagonal(K: csr_array) -> Array:
    d = K.diagonal()
    bad = np.flatnonzero(~(d > 0))
    if len(bad):
        raise InputError(f"diagonal entry {bad[0]} of the matrix is {d[bad[0]]:g}: it is not positive definite")
    return np.asarray(d, dtype=float)


def _level(K: csr_array, W: csr_array | None, block: int) -> Level:
    scale = 1.0 / np.sqrt(_positive_diagonal(K))
    K = csr_array(K)
    K.sort_indices()
    n = K.shape[0] // block
    rows = np.repeat(np.arange(K.shape[0]), np.diff(K.indptr))
    scaled = csr_array((K.data * scale[rows] * scale[K.indices], K.indices, K.indptr), shape=K.shape)
    del rows
    if block == 1:
        pointers, columns, values = scaled.indptr, scaled.indices, scaled.data
        starts = sparse.parts(pointers)
        outside = np.empty(n)
        sparse.outside_sums(pointers, columns, values, starts, outside)
        # M + M^T - A is positive definite if 2 m >= (sum outside) - d on the diagonal; a tenth of d to spare.
        inverse = 1.0 / (1.0 + np.maximum(0.0, 0.5 * (outside - 0.9)))
    else:
        blocked = bsr_array(scaled, blocksize=(block, block))
        blocked.sort_indices()
        pointers, columns, values = blocked.indptr, blocked.indices, blocked.data
        starts = sparse.parts(pointers, 1000)
        outside = np.empty(K.shape[0])
        sparse.outside_sums(scaled.indptr, scaled.indices, scaled.data, starts * block, outside)
        diagonal = values[columns == np.repeat(np.arange(n), np.diff(pointers))]
        lowest = np.linalg.eigvalsh(diagonal)[:, 0]
        extra = np.maximum(0.0, 0.5 * (outside.reshape(n, block) - 0.9 * np.maximum(lowest, 0.0)[:, None]))
        inverse = np.linalg.inv(diagonal + extra[:, :, None] * np.eye(block))
    down = up = None
    if W is not None:
        lifted = csr_array(csr_array(W).multiply((1.0 / scale)[:, None]))
        up = csr_array(lifted, dtype=np.float32)
        down = csr_array(lifted.T.tocsr(), dtype=np.float32)
    return Level(pointers.astype(np.int32), columns.astype(np.int32), values.astype(np.float32),
                 inverse.astype(np.float32), starts, scale, down, up)


def _cycle(levels: list[Level], depth: int, r: Array, coarse: Callable[[Array], Array] | None) -> Array:
    """One symmetric V-cycle for a residual in double precision."""
    level = levels[depth]
    size = float(np.abs(r).max(initial=0.0))
    if size == 0.0:
        return np.zeros_like(r)
    scaled = level.scale * r
    size = float(np.abs(scaled).max())
    b = (scaled / size).astype(np.float32)
    x = _sweep(level, b, forward=True)
    b -= _product(level, x)
    if level.down is not None and level.up is not None:
        rest = _transfer(level.down, b).astype(float)
        if depth + 1 < len(levels):
            correction = _cycle(levels, depth + 1, rest, coarse)
        else:
            assert coarse is not None
            correction = coarse(rest)
        step = _transfer(level.up, correction.astype(np.float32))
        x += step
        b -= _product(level, step)
    x += _sweep(level, b, forward=False)
    return level.scale * x * size


def _sweep(level: Level, b: Single, forward: bool) -> Single:
    y = np.empty_like(b)
    arguments = (level.pointers, level.columns, level.values, level.inverse, level.starts)
    if level.inverse.ndim == 1:
        (sparse.forward_scalar if forward else sparse.backward_scalar)(*arguments, b, y)
    else:
        kernel = sparse.forward_block if forward else sparse.backward_block
        kernel(*arguments, b.reshape(-1, 3), y.reshape(-1, 3))
    return y


def _product(level: Level, x: Single) -> Single:
    y = np.empty_like(x)
    if level.inverse.ndim == 1:
        sparse.multiply_scalar(level.pointers, level.columns, level.values, x, y)
    else:
        sparse.multiply_block(level.pointers, level.columns, level.values, x.reshape(-1, 3), y.reshape(-1, 3))
    return y


def _transfer(W: csr_array, x: Single) -> Single:
    y = np.empty(W.shape[0], dtype=np.float32)
    sparse.multiply_scalar(W.indptr, W.indices, W.data, x, y)
    return y
