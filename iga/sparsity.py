r"""Sparsity of a space's matrices, found once per space and used by every matrix on it.

Functions i and j share an entry if an element has both. The pattern is symmetric and so are the matrices of the
built-in forms: only pairs row <= column are computed and scattered, then mirrored. Rows whose columns are equal
relative to the row, and elements whose entries lie at equal places in their rows, are stored once
(`iga.kernels.pattern`): a B-spline mesh of any size has a few hundred distinct ones, an unstructured mesh one per
element.

With c components the entry of (function r, component a) and (k-th function in its row, component b) is at
``c*c*start[r] + a*c*length[r] + c*k + b``.

Axis letters: n function on the element, k distinct slot table, e element.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.domain import Space
from iga.errors import InputError
from iga.kernels import pattern as kernels
from iga.parallel import ranges, run

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Slots:
    """Where the entries of a block's elements are.

    Attributes
    ----------
    offset : (k, n (n+1)/2) for each pair i <= j of local functions, row by row, the place of the larger function number
        in the row of the smaller.
    table : (e,) which of the k each element has.
    twice : whether some element has one function twice (degenerate elements do).
    """

    offset: NDArray[Any]
    table: Index
    twice: bool


@dataclass(frozen=True, eq=False)
class Sparsity:
    """Compressed rows of a space's matrices with one component, and the slots of each block."""

    indptr: Index
    indices: NDArray[np.int32]
    slots: tuple[Slots, ...]

    @property
    def n(self) -> int:
        """Number of functions."""
        return len(self.indptr) - 1


_known: WeakKeyDictionary[Space, Sparsity] = WeakKeyDictionary()


def sparsity(space: Space) -> Sparsity:
    """Sparsity of a space; found at the first call, kept as long as the space lives."""
    if space not in _known:
        _known[space] = find(space)
    return _known[space]


def find(space: Space) -> Sparsity:
    """Find the sparsity of a space (see `sparsity`, which keeps it)."""
    n = space.n
    if n >= 2**31:
        raise InputError(f"{n} functions are too many for 32-bit column numbers")
    dofs = [block.dofs for block in space.blocks]
    sizes = np.concatenate([np.full(len(d), d.shape[1]) for d in dofs]) if dofs else np.zeros(0, np.int64)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    flat = dofs[0].reshape(-1) if len(dofs) == 1 else np.concatenate([d.reshape(-1) for d in dofs])
    elements = len(first) - 1

    element_key = np.empty(elements, np.uint64)
    run([partial(kernels.element_keys, first, flat, element_key, *part) for part in ranges(elements)])
    start, around = kernels.incidence(first, flat, n)
    key = np.empty(n, np.uint64)
    run([partial(kernels.row_keys, first, flat, element_key, start, around, key, *part) for part in ranges(n)])
    _, representative, kind = np.unique(key, return_index=True, return_inverse=True)
    # Keys sort at random; in the order of their rows the searches walk through memory.
    rank = np.argsort(representative)
    kind = np.argsort(rank)[kind.reshape(-1)]
    rows = representative[rank]
    regular = 4 * len(rows) < n
    if not regular:
        # Few rows are alike: find all of them, and sort them together by transposing, faster than one by one.
        rows = kind = np.arange(n)
    pointers, relative = _columns(first, flat, start, around, rows, n, regular)
    del start, around
    lengths = np.diff(pointers)[kind]
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    indices = np.empty(indptr[-1], np.int32)
    if regular:
        run([partial(kernels.fill, indptr, kind, pointers, relative, indices, *part) for part in ranges(n)])
    else:
        kernels.transpose(indptr, relative, indices)
    del relative

    run([partial(kernels.slot_keys, first, flat, element_key, kind, element_key, *part) for part in ranges(elements)])
    slots, begin = [], 0
    longest = int(lengths.max(initial=0))
    for d in dofs:
        slots.append(_slots(d, element_key[begin : begin + len(d)], indptr, indices, longest))
        begin += len(d)
    return Sparsity(indptr, indices, tuple(slots))


def _columns(
    first: Index, flat: Index, start: Index, around: NDArray[np.int32], rows: Index, n: int, ordered: bool
) -> tuple[Index, NDArray[np.int32]]:
    """Relative columns of some rows, searched by all threads."""
    search = partial(kernels.columns, first, flat, start, around)
    parts = run([partial(search, rows[lo:hi], n, ordered) for lo, hi in ranges(len(rows))])
    counts = np.concatenate([np.diff(pointers) for pointers, _ in parts])
    return np.concatenate([[0], np.cumsum(counts)]), np.concatenate([found for _, found in parts])


def _slots(dofs: Index, keys: NDArray[np.uint64], indptr: Index, indices: NDArray[np.int32], longest: int) -> Slots:
    """Slots of one block."""
    n = dofs.shape[1]
    _, representative, table = np.unique(keys, return_index=True, return_inverse=True)
    rank = np.argsort(representative)
    table = np.argsort(rank)[table.reshape(-1)]
    chosen = np.ascontiguousarray(dofs[representative[rank]])
    offset = np.empty((len(chosen), n * (n + 1) // 2), np.uint16 if longest < 2**16 else np.int32)
    twice = run([partial(kernels.slots, chosen, indptr, indices, offset, *part) for part in ranges(len(chosen))])
    return Slots(offset, table, any(twice))


def finish(pattern: Sparsity, values: Array, components: int) -> csr_array:
    """Mirror the upper half of a symmetric matrix into the lower and return the matrix.

    Parameters
    ----------
    values : (nnz c^2,) entries in the order of the module docstring, those with row <= column set.
    components : number c.
    """
    c, n = components, pattern.n
    size = int(pattern.indptr[-1]) * c * c
    run([partial(kernels.mirror, pattern.indptr, pattern.indices, values, c, *part) for part in ranges(n)])
    wide = np.int64 if size >= 2**31 else np.int32
    if c == 1:
        # The pattern's arrays are shared by all matrices of the space; a matrix that is changed in place must not
        # change the others, so it gets its own.
        indptr, indices = pattern.indptr.astype(wide), pattern.indices.astype(wide)
    else:
        lengths = np.repeat(np.diff(pattern.indptr) * c, c)
        indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(wide)
        indices = np.empty(size, wide)
        run([partial(kernels.expand, pattern.indptr, pattern.indices, c, indices, *part) for part in ranges(n)])
    matrix = csr_array((values[:size], indices, indptr), shape=(n * c, n * c))
    matrix.has_sorted_indices = True
    matrix.has_canonical_format = True
    return matrix


def symmetric_product(pattern: Sparsity, matrix: csr_array, components: int) -> Callable[[Array], Array]:
    """Make the product with a symmetric matrix that has a space's sparsity, reading only its upper half.

    A product is limited by memory traffic, and this one needs half of it (for three components a third, as column
    numbers are those of functions).

    Parameters
    ----------
    matrix : (n c, n c) from assembly on the space, symmetric.
    components : number c, 1 or 3.

    Raises
    ------
    InputError : the matrix does not have the pattern.
    """
    c = components
    if c not in (1, 3) or matrix.shape[0] != pattern.n * c or matrix.nnz != c * c * int(pattern.indptr[-1]):
        raise InputError(f"a matrix {matrix.shape} with {matrix.nnz} entries does not have the space's sparsity")
    diagonal = kernels.diagonals(pattern.indptr, pattern.indices)
    kernel = kernels.symmetric_product if c == 1 else kernels.symmetric_product_block
    # Parts of equal numbers of entries.
    work = np.cumsum(pattern.indptr[1:] - diagonal)
    parts = [tuple(np.searchsorted(work, part)) for part in ranges(int(work[-1]))]
    parts = [(0 if k == 0 else lo, pattern.n if k == len(parts) - 1 else hi) for k, (lo, hi) in enumerate(parts)]

    def product(x: Array) -> Array:
        given = np.ascontiguousarray(x, dtype=float).reshape((-1,) if c == 1 else (-1, c))
        results = [np.zeros_like(given) for _ in parts]
        run([
            partial(kernel, pattern.indptr, pattern.indices, diagonal, matrix.data, given, y, *part)
            for part, y in zip(parts, results)
        ])
        for other in results[1:]:
            results[0] += other
        return results[0].reshape(-1)

    return product

