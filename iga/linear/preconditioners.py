r"""Preconditioners that are robust in the degree and the size of a space.

Additive Schwarz on two levels, for degree two and more: with R_k the functions on element k, A_k = R_k A R_k^T and D
the number of chosen elements a function is on,

    z = D^-1/2 (sum_k R_k^T A_k^-1 R_k) D^-1/2 r  +  W A_1^-1 W^T r.

W is the prolongation of a coarse space (`coarse_space`). The ill-conditioned high Bernstein modes live on one element,
where A_k^-1 is exact, so that iterations hardly depend on the degree; neighbouring elements overlap in the functions
they share (Pavarino 1993, doi:10.1007/BF01385709). Where functions are on many elements (splines), enough elements to
cover every function are chosen. A_1 = W^T A W is factored if that is cheap and else preconditioned by

smoothed aggregation, for degree one: cycles x = (D+L)^-1 r; x += P A_c^-1 P^T (r - A x); x += (D+U)^-1 (r - A x) around
the constants or rigid motions (Vanek, Mandel and Brezina 1996, doi:10.1007/BF02238511). Sweeps run in parallel on
parts of the rows; couplings between parts enter the diagonal, enough to keep the cycle positive definite (Baker et al.
2011, see `iga.kernels.sparse`).

Inverses and sweeps use matrices scaled to unit diagonal in single precision, which halves the traffic; the conjugate
gradients around them stay in double precision.

Axis letters: n function, e element, m mode.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array, csr_matrix

from iga.errors import InputError
from iga.kernels import patches as patch_kernels
from iga.kernels import sparse
from iga.linear.coarse_space import CoarseSpace
from iga.linear.factorization import estimate, factorize
from iga.linear.products import on_rows, product
from iga.parallel import ranges, run, threads

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
    down: csr_array
    up: csr_array


def two_level(K: csr_array, coarse: CoarseSpace, elements: Sequence[Index]) -> Preconditioner:
    """Additive Schwarz on elements with a coarse space.

    Parameters
    ----------
    K : (n, n) symmetric positive definite, sorted.
    coarse : without columns there is no coarse space.
    elements : unknowns (e, m) of the elements of each block, -1 for unknowns that are fixed.

    Raises
    ------
    InputError : a diagonal entry of K is not positive.
    """
    scale = 1.0 / np.sqrt(_positive_diagonal(K))
    patches, count = _patches(K, elements)
    weight = 1.0 / np.sqrt(np.maximum(count, 1))
    alone = np.where(count == 0, scale**2, 0.0)
    name, correct, W = "element Schwarz", None, coarse.W
    if W.shape[1]:
        A = csr_array(W.T @ csr_array(K @ W))
        A.sum_duplicates()
        up, down = W, csr_array(W.T.tocsr())
        if _cheap(A):
            correct, name = factorize(A, symmetric=True).fast, f"{name}, {coarse.name}"
        else:
            inner = aggregation(A, coarse.modes)
            correct, name = inner.apply, f"{name}, {coarse.name}, {inner.name}"

    def apply(r: Array) -> Array:
        size = float(np.abs(r).max(initial=0.0)) or 1.0
        z = alone * r + weight * (_schwarz(patches, (r * (weight / size)).astype(np.float32)) * size)
        if correct is not None:
            z += product(up, correct(product(down, r)))
        return z

    return Preconditioner(name, apply)


def aggregation(K: csr_array, modes: Array, block: int = 1) -> Preconditioner:
    """Smoothed aggregation with Gauss-Seidel cycles; a small matrix is factored.

    Parameters
    ----------
    K : (n, n) symmetric positive definite, sorted. Rows and columns of fixed unknowns may be those of the identity.
    modes : (n, k) functions of no energy but for boundary conditions (constants, rigid motions).
    block : 3 if unknowns come in triples that are to be relaxed together, else 1.

    Raises
    ------
    InputError : a diagonal entry of K is not positive.
    """
    _positive_diagonal(K)
    if K.shape[0] <= TINY:
        return Preconditioner("factorization", factorize(K, symmetric=True).fast)
    matrices, prolongations = _aggregate(K, modes, block)
    levels = [_level(A, P, block if depth == 0 else 1) for depth, (A, P) in enumerate(zip(matrices, prolongations))]
    coarse = factorize(matrices[-1], symmetric=True).fast
    return Preconditioner("smoothed aggregation", lambda r: _cycle(levels, 0, r, coarse))


def _cheap(K: csr_array) -> bool:
    """Whether factoring a coarse matrix takes about a second at most."""
    if K.shape[0] > 400_000:
        return False
    cost = estimate(K)
    return cost is not None and cost.operations <= COARSE


def _aggregate(K: csr_array, modes: Array, block: int) -> tuple[list[csr_array], list[csr_array]]:
    """Matrices of smoothed aggregation, finest first, and the prolongations between them."""
    A = csr_matrix(K)
    if block > 1 and A.shape[0] % block == 0:
        A = A.tobsr((block, block))
    hierarchy = pyamg.smoothed_aggregation_solver(
        A, B=modes, max_coarse=min(8000, A.shape[0] // 4), improve_candidates=None, presmoother=None, postsmoother=None,
    )
    matrices = [K, *(csr_array(level.A) for level in hierarchy.levels[1:])]
    # Where nothing is coupled any more there is nothing to aggregate: the next matrix is zero.
    while not matrices[-1].count_nonzero():
        matrices.pop()
    return matrices, [csr_array(level.P) for level in hierarchy.levels[: len(matrices) - 1]]


def _positive_diagonal(K: csr_array) -> Array:
    d = K.diagonal()
    bad = np.flatnonzero(~(d > 0))
    if len(bad):
        raise InputError(f"diagonal entry {bad[0]} of the matrix is {d[bad[0]]:g}: it is not positive definite")
    return np.asarray(d, dtype=float)


def _level(K: csr_array, W: csr_array, block: int) -> Level:
    """The level of a matrix K (n, n) with the prolongation W (n, m) from the next coarser one."""
    scale = 1.0 / np.sqrt(_positive_diagonal(K))
    K = csr_array(K)
    K.sort_indices()
    n = K.shape[0] // block
    rows = np.repeat(np.arange(K.shape[0]), np.diff(K.indptr))
    scaled = csr_array((K.data * scale[rows] * scale[K.indices], K.indices, K.indptr), shape=K.shape)
    del rows
    if block == 1:
        pointers, columns, values = scaled.indptr, scaled.indices, scaled.data
        starts = _parts(pointers, 3000)
        outside = np.empty(n)
        sparse.outside_sums(pointers, columns, values, starts, outside)
        # M + M^T - A is positive definite if 2 m >= (sum outside) - d on the diagonal; a tenth of d to spare.
        inverse = 1.0 / (1.0 + np.maximum(0.0, 0.5 * (outside - 0.9)))
    else:
        blocked = bsr_array(scaled, blocksize=(block, block))
        blocked.sort_indices()
        pointers, columns, values = blocked.indptr, blocked.indices, blocked.data
        starts = _parts(pointers, 1000)
        outside = np.empty(K.shape[0])
        sparse.outside_sums(scaled.indptr, scaled.indices, scaled.data, starts * block, outside)
        diagonal = values[columns == np.repeat(np.arange(n), np.diff(pointers))]
        lowest = np.linalg.eigvalsh(diagonal)[:, 0]
        extra = np.maximum(0.0, 0.5 * (outside.reshape(n, block) - 0.9 * np.maximum(lowest, 0.0)[:, None]))
        inverse = np.linalg.inv(diagonal + extra[:, :, None] * np.eye(block))
    lifted = csr_array(W.multiply((1.0 / scale)[:, None]))
    up, down = csr_array(lifted, dtype=np.float32), csr_array(lifted.T.tocsr(), dtype=np.float32)
    return Level(pointers.astype(np.int32), columns.astype(np.int32), values.astype(np.float32),
                 inverse.astype(np.float32), starts, scale, down, up)


def _cycle(levels: list[Level], depth: int, r: Array, coarse: Callable[[Array], Array]) -> Array:
    """One symmetric V-cycle for a residual in double precision; below the last level the solution ``coarse``."""
    if depth == len(levels):
        return coarse(r)
    level = levels[depth]
    scaled = level.scale * r
    size = float(np.abs(scaled).max(initial=0.0))
    if size == 0.0:
        return np.zeros_like(r)
    b = (scaled / size).astype(np.float32)
    x = _sweep(level, b, forward=True)
    b -= _product(level, x)
    correction = _cycle(levels, depth + 1, product(level.down, b).astype(float), coarse)
    step = product(level.up, correction.astype(np.float32))
    x += step
    b -= _product(level, step)
    x += _sweep(level, b, forward=False)
    return level.scale * x * size


def _sweep(level: Level, b: Single, forward: bool) -> Single:
    y = np.empty_like(b)
    count, work = len(level.starts) - 1, level.values.size
    arguments = (level.pointers, level.columns, level.values, level.inverse, level.starts)
    if level.inverse.ndim == 1:
        on_rows(sparse.forward_scalar if forward else sparse.backward_scalar, count, work, *arguments, b, y)
    else:
        kernel = sparse.forward_block if forward else sparse.backward_block
        on_rows(kernel, count, work, *arguments, b.reshape(-1, 3), y.reshape(-1, 3))
    return y


def _product(level: Level, x: Single) -> Single:
    y = np.empty_like(x)
    arguments = (level.pointers, level.columns, level.values)
    if level.inverse.ndim == 1:
        on_rows(sparse.multiply_scalar, len(x), level.values.size, *arguments, x, y)
    else:
        pair = (x.reshape(-1, 3), y.reshape(-1, 3))
        on_rows(sparse.multiply_block, len(pair[0]), level.values.size, *arguments, *pair)
    return y


def _parts(pointers: NDArray[np.int32], size: int, most: int = 16) -> Index:
    """Starts (parts+1,) of contiguous parts with about equal numbers of entries, each of ``size`` rows or so."""
    n = len(pointers) - 1
    count = int(np.clip(n // size, 1, most))
    starts = np.searchsorted(pointers, np.linspace(0, pointers[-1], count + 1)).astype(np.int64)
    starts[0], starts[-1] = 0, n
    return np.unique(starts)


def _patches(K: csr_array, elements: Sequence[Index]) -> tuple[list[tuple[NDArray[np.int32], Single]], Array]:
    """Chosen elements' unknowns (k, m) and inverses (k, m, m) per block, and how many of them each unknown is in."""
    covered = np.zeros(K.shape[0], dtype=bool)
    count = np.zeros(K.shape[0])
    made = []
    random = np.random.default_rng(20187)
    for unknowns in elements:
        own = np.sort(unknowns, axis=1).astype(np.int32)
        own[:, 1:][own[:, 1:] == own[:, :-1]] = -1  # a degenerate element names a function twice
        chosen = np.zeros(len(own), dtype=bool)
        patch_kernels.choose(own, random.permutation(len(own)), covered, chosen)
        own = np.ascontiguousarray(own[chosen])
        inverses = np.empty((*own.shape, own.shape[1]), dtype=np.float32)
        on_rows(patch_kernels.invert, len(own), inverses.size, own, K.indptr, K.indices, K.data, inverses)
        np.add.at(count, own[own >= 0], 1.0)
        made.append((own, inverses))
    return made, count


def _schwarz(patches: list[tuple[NDArray[np.int32], Single]], r: Single) -> Single:
    """Sum of the patches' corrections."""
    tasks = []
    sums = []
    work = sum(inverses.size for _, inverses in patches)
    for first, last in ranges(1 << 20, threads() if work > 100_000 else 1):
        y = np.zeros_like(r)
        sums.append(y)
        tasks.append((first / (1 << 20), last / (1 << 20), y))

    def share(first: float, last: float, y: Single) -> None:
        for own, inverses in patches:
            n = len(own)
            patch_kernels.smooth(round(first * n), round(last * n), own, inverses, r, y)

    run([partial(share, *task) for task in tasks])
    for y in sums[1:]:
        sums[0] += y
    return sums[0]
