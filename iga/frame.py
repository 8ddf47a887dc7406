r"""Frames: the functions of one block at the points of a rule, as the tables that kernels take.

A frame interpolates coefficients to points, distributes point values to functions (the transpose), and adds element
matrices of forms with coefficients D (4 x 4 in function and reference derivatives, `iga.kernels.tensor`) to rows of a
sparse matrix. Hexahedra do so by sum factorisation, with one-dimensional tables for extraction by Kronecker factors or
none; all other cells by one matrix product per chunk of elements, K = D M with M the products of all pairs of
functions. Dense extraction patterns are applied to the Bernstein result: C^T u before, C f and C K C^T after.

Axis letters: e element, q point, n function on the element, b Bernstein, s = 0 (function), 1..3 (its reference
derivatives).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, bernstein
from iga.block import Block, Kronecker, Patterns
from iga.cells import HEXAHEDRON, LINE
from iga.chunk import rule_for
from iga.domain import Domain
from iga.kernels import scatter, tensor
from iga.quadrature import Quadrature
from iga.sparsity import Slots

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PAIRS = tuple((s, t) for s in range(4) for t in range(s, 4))
"""Entries of a symmetric 4 x 4 matrix in the order in which they are stored."""

LITERAL = 5e8
"""Floating-point operations from which on kernels are compiled for the sizes at hand: about what compiling costs."""

_specialise: ContextVar[bool] = ContextVar("specialise", default=False)


@contextmanager
def specialised() -> Iterator[None]:
    """Compile kernels for the sizes at hand inside the ``with`` block, however little the work is."""
    token = _specialise.set(True)
    try:
        yield
    finally:
        _specialise.reset(token)


@dataclass(frozen=True, eq=False)
class Frame:
    """Functions of a block at the points of a rule; `frames` makes those of a domain.

    Attributes
    ----------
    block, rule : the elements and the rule.
    rational : (N,) weights of the space's functions, or None.
    repeat : how many times each element's matrix of one component will be worked on, about; 0 to never specialise.
    """

    block: Block
    rule: Quadrature
    rational: Array | None = None
    repeat: int = 1

    @property
    def q(self) -> int:
        """Number of points."""
        return len(self.rule.weights)

    @property
    def size(self) -> int:
        """Elements per chunk, such that what a chunk needs fits the cache."""
        return min(max(8192 // self.q, 8), 1024)

    @cached_property
    def weights(self) -> Array:
        """Weights of the rule, (q,)."""
        return np.array(self.rule.weights)

    @property
    def factored(self) -> bool:
        """Whether the reference cell has sum factorisation."""
        return self.block.basis.cell is HEXAHEDRON and isinstance(self.block.basis, Bernstein)

    @property
    def dense(self) -> Patterns | None:
        """Dense extraction that has to be applied outside the kernels, or None."""
        return self.block.extraction if isinstance(self.block.extraction, Patterns) else None

    @cached_property
    def tables(self) -> tuple[Array, Array, Array]:
        """One-dimensional values and derivatives of each direction, (k, 2, q, n) each."""
        assert self.rule.factors is not None
        tables = []
        for d, (points, _) in enumerate(self.rule.factors):
            values, slopes = bernstein(LINE, self.block.basis.degree[d]).tabulate(points[:, None], 1)
            T = np.stack([values, slopes[..., 0]])[None]
            if isinstance(self.block.extraction, Kronecker):
                T = np.einsum("kib,sqb->ksqi", self.block.extraction.factors[d], T[0])
            tables.append(np.ascontiguousarray(T))
        return tables[0], tables[1], tables[2]

    @cached_property
    def products(self) -> tuple[Array, Array, Array]:
        """Products of pairs of the one-dimensional functions, (k, 4, q, n*n) each."""
        a, b, c = (tensor.products(T) for T in self.tables)
        return a, b, c

    @cached_property
    def pattern(self) -> NDArray[np.int32]:
        """Which one-dimensional functions each element has, (e, 3)."""
        if isinstance(self.block.extraction, Kronecker):
            return np.ascontiguousarray(self.block.extraction.pattern, dtype=np.int32)
        return np.zeros((self.block.elements, 3), np.int32)

    @cached_property
    def literal(self) -> tuple[int, int, int, int, int, int]:
        """Sizes that the kernels are compiled for; zeros where the work is too little to be worth compiling."""
        n1, n2, n3, q1, _, _ = self.sizes
        flops = 32 * (n1 * n2 * n3) ** 2 * q1 * self.block.elements * self.repeat
        return self.sizes if self.repeat and (flops > LITERAL or _specialise.get()) else (0, 0, 0, 0, 0, 0)

    @cached_property
    def sizes(self) -> tuple[int, int, int, int, int, int]:
        """Functions and points of each direction."""
        a, b, c = self.tables
        return a.shape[3], b.shape[3], c.shape[3], a.shape[2], b.shape[2], c.shape[2]

    @cached_property
    def values(self) -> Array:
        """Values and reference derivatives of all Bernstein functions, (4, q, b)."""
        N, dN = self.block.basis.tabulate(self.rule.points, 1)
        return np.ascontiguousarray(np.concatenate([N[None], np.moveaxis(dN, 2, 0)]))

    @cached_property
    def places(self) -> dict[bool, NDArray[np.int32]]:
        """Where sum factorisation leaves entries of element matrices, symmetric (True) or any (False)."""
        half, full = tensor.places(*self.sizes[:3])
        return {True: half, False: full}

    @cached_property
    def ones(self) -> Array:
        """Factors of functions without weights for a chunk, (size, n)."""
        return np.ones((self.size, self.block.n))

    @cached_property
    def moments(self) -> Array:
        """Products of pairs of Bernstein functions for symmetric forms, (10 q, b (b+1)/2), pairs i <= j."""
        i, j = np.triu_indices(self.block.basis.n)
        M = np.empty((10, self.q, len(i)))
        for k, (s, t) in enumerate(PAIRS):
            M[k] = self.values[s][:, i] * self.values[t][:, j]
            if s != t:
                M[k] += self.values[t][:, i] * self.values[s][:, j]
        return M.reshape(10 * self.q, -1)

    @cached_property
    def all_moments(self) -> Array:
        """Products of pairs of Bernstein functions for any form, (16 q, b*b)."""
        return np.einsum("sqi,tqj->stqij", self.values, self.values).reshape(16 * self.q, -1)

    def factors_of(self, lo: int, hi: int) -> Array:
        """Weights w_i of the functions on elements lo..hi, (m, n); ones if they are not rational."""
        if self.rational is not None:
            return self.rational[self.block.dofs[lo:hi]]
        return self.ones[: hi - lo]


def frames(domain: Domain, points: int | None = None, repeat: int = 1) -> list[Frame]:
    """Frames of all blocks of a domain at Gauss points, ``points`` per direction (`iga.chunk.default_points`)."""
    weights = domain.space.weights
    return [Frame(b, rule_for(domain, k, points), weights, repeat) for k, b in enumerate(domain.space.blocks)]


def interpolate(f: Frame, lo: int, hi: int, coefficients: Array, out: Array | None = None) -> Array:
    """Values and reference derivatives sum_i d_s N_i u_i at the points of elements lo..hi, without rational weights.

    Parameters
    ----------
    coefficients : (N, c).
    out : array for the result, or None.

    Returns
    -------
    (hi - lo, c, 4, q)
    """
    m, c = hi - lo, coefficients.shape[1]
    result = np.empty((m, c, 4, f.q)) if out is None else out[:m]
    dofs = f.block.dofs[lo:hi]
    if f.dense is not None:
        local_values = np.swapaxes(f.dense.C, 1, 2)[f.dense.pattern[lo:hi]] @ coefficients[dofs]
        coefficients = local_values.reshape(-1, c)
        dofs = np.arange(len(coefficients)).reshape(m, -1)
    if f.factored:
        tensor.interpolate(f.literal)(f.sizes, *f.tables, f.pattern[lo:hi], dofs, coefficients, result)
    else:
        columns = np.ascontiguousarray(coefficients[dofs].swapaxes(1, 2)).reshape(m * c, -1)
        np.matmul(columns, f.values.reshape(4 * f.q, -1).T, out=result.reshape(m * c, -1))
    return result


def distribute(f: Frame, lo: int, hi: int, r: Array, vector: Array, weighted: bool = True) -> None:
    """Add sum_q sum_s d_s N_i r_s to a vector (N, c), with r (hi - lo, c, 1 or 4, q) on elements lo..hi.

    Rational weights multiply the contributions if ``weighted``.
    """
    m, c, s, q = r.shape
    dofs, scale = f.block.dofs[lo:hi], f.factors_of(lo, hi) if weighted else f.ones[:m]
    if f.factored and f.dense is None:
        tensor.distribute(f.literal)(f.sizes, *f.tables, f.pattern[lo:hi], dofs, scale, r, vector)
        return
    if f.factored:
        b = f.block.basis.n
        result = np.zeros((m * b, c))
        own = np.arange(m * b).reshape(m, b)
        tensor.distribute(f.literal)(f.sizes, *f.tables, f.pattern[lo:hi], own, np.ones((m, b)), r, result)
        contribution = np.ascontiguousarray(result.reshape(m, b, c).swapaxes(1, 2))
    else:
        contribution = (r.reshape(m * c, s * q) @ f.values[:s].reshape(s * q, -1)).reshape(m, c, -1)
    if f.dense is not None:
        contribution = contribution @ np.swapaxes(f.dense.C, 1, 2)[f.dense.pattern[lo:hi]]
    scatter.add_vectors(contribution, dofs, scale, vector)


def add_diagonals(f: Frame, lo: int, hi: int, D: Array, vector: Array) -> None:
    """Add the diagonals of the element matrices of a form with symmetric D (hi - lo, 10, q) to a vector (N, 1)."""
    m = hi - lo
    dofs, scale = f.block.dofs[lo:hi], f.factors_of(lo, hi) ** 2
    if f.factored and f.dense is None:
        own = np.arange(m * f.block.n).reshape(m, -1)
        result, ones = np.zeros((m * f.block.n, 1)), f.ones[:m]
        for k, (s, t) in enumerate(PAIRS):
            tables = [_squares(T, int(s == d + 1), int(t == d + 1)) for d, T in enumerate(f.tables)]
            r = np.ascontiguousarray(D[:, k] if s == t else 2.0 * D[:, k])[:, None, None]
            tensor.distribute(f.literal)(f.sizes, *tables, f.pattern[lo:hi], own, ones, r, result)
        found = result.reshape(m, 1, -1)
    else:
        K = _bernstein_matrices(f, lo, hi, D)
        if f.dense is not None:
            C = f.dense.C[f.dense.pattern[lo:hi]]
            found = np.einsum("enb,enb->en", C @ K, C)[:, None]
        else:
            i, j = np.triu_indices(f.block.n)
            found = np.ascontiguousarray(K[:, i == j])[:, None]
    scatter.add_vectors(found, dofs, scale, vector)


def _squares(T: Array, a: int, b: int) -> Array:
    """Tables whose values are products of derivatives a and b of each one-dimensional function with itself."""
    product = T[:, a] * T[:, b]
    return np.stack([product, np.zeros_like(product)], axis=1)


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a matrix that element matrices are added to (see `iga.sparsity`).

    Attributes
    ----------
    slots : places of the block's entries in their rows.
    begin, length : (N,) first entry of each function's rows, and functions in each row.
    components : number c.
    values : entries.
    """

    slots: Slots
    begin: Index
    length: Index
    components: int
    values: Array


def add_matrices(f: Frame, lo: int, hi: int, D: Array, a: int, b: int, rows: Rows) -> None:
    """Add element matrices of a form with coefficients D to the components (a, b) of a matrix's upper half.

    Parameters
    ----------
    D : (hi - lo, 10, q) symmetric, for a = b; (hi - lo, 16, q) for a < b, which sets (b, a) to the transpose as well.
    """
    slots = rows.slots
    where = (
        slots.offset, slots.table[lo:hi], f.block.dofs[lo:hi], f.factors_of(lo, hi), f.rational is not None, rows.begin,
        rows.length, rows.components,
    )
    symmetric = D.shape[1] == 10
    if f.factored and f.dense is None:
        kernel = (tensor.symmetric if symmetric else tensor.general)(f.literal)
        pair: tuple[int, ...] = (a,) if symmetric else (a, b)
        kernel(f.sizes, *f.products, f.pattern[lo:hi], D, f.places[symmetric], *where, *pair, slots.twice, rows.values)
        return
    K = _bernstein_matrices(f, lo, hi, D)
    n = f.block.n
    if f.dense is not None:
        C = f.dense.C[f.dense.pattern[lo:hi]]
        K = (C @ K @ np.swapaxes(C, 1, 2)).reshape(-1, n * n)
    i, j = np.triu_indices(n)
    half = K.shape[1] != n * n
    upper = (np.arange(len(i)) if half else i * n + j).astype(np.int32)
    lower = upper if half else (j * n + i).astype(np.int32)
    scatter.scatter_matrices(K, upper, lower, *where, a, b, slots.twice, rows.values)


def _bernstein_matrices(f: Frame, lo: int, hi: int, D: Array) -> Array:
    """Element matrices of Bernstein functions, (m, b, b) where dense extraction follows, else (m, b (b+1)/2 or b*b)."""
    m, b = len(D), f.block.basis.n
    symmetric = D.shape[1] == 10
    if f.factored:
        # Rows of a matrix with one dense row per Bernstein function of each element.
        own = np.arange(m * b).reshape(m, b)
        half: Array = np.zeros((m * b, b))
        begin, length = np.arange(m * b) * b, np.full(m * b, b)
        table, scale = np.zeros(m, np.int64), np.ones((m, b))
        offset = np.concatenate([np.arange(i, b) for i in range(b)]).astype(np.uint16)[None]
        start = (*f.products, f.pattern[lo:hi], D, f.places[symmetric], offset, table, own, scale, False)
        if symmetric:
            tensor.symmetric(f.literal)(f.sizes, *start, begin, length, 1, 0, False, half.reshape(-1))
            half = half.reshape(m, b, b)
            return half + np.swapaxes(np.triu(half, 1), 1, 2)
        # With two components the upper half holds K in (0, 1) and its transpose in (1, 0).
        K: Array = np.zeros((m * b, 2, b, 2))
        tensor.general(f.literal)(f.sizes, *start, 4 * begin, length, 2, 0, 1, False, K.reshape(-1))
        K = K.reshape(m, b, 2, b, 2)
        return K[:, :, 0, :, 1] + np.swapaxes(np.triu(K[:, :, 1, :, 0], 1), 1, 2)
    products = D.reshape(m, -1) @ (f.moments if symmetric else f.all_moments)
    if f.dense is None:
        return products
    if not symmetric:
        return products.reshape(m, b, b)
    i, j = np.triu_indices(b)
    full = np.empty((m, b, b))
    full[:, i, j] = products
    full[:, j, i] = products
    return full
