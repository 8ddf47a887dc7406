r"""Spaces that are a C0 Bernstein space times a sparse map.

A mesh of any cells has the conforming Bernstein functions B_b (`iga.conforming`). Functions that are smoother where it
matters, such as those of a B-spline skin, follow from a sparse matrix M with

    N_i = sum_b M[b, i] B_b,

whose rows b give the Bernstein coefficients of the new functions. On an element with Bernstein functions g the rows
M[g] are its extraction. Elements whose rows are unit vectors need none.

Axis letters: e element, n function on the element, b Bernstein function, k distinct pattern.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.bernstein import LocalBasis
from iga.block import Block, Patterns

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_STEP = 4
"""Numbers of functions are rounded up to multiples of this, so that there are few blocks."""


def blocks_of(basis: LocalBasis, dofs: Index, M: csr_array) -> list[tuple[Block, Index]]:
    """Blocks of the elements of one cell.

    Parameters
    ----------
    dofs : (e, b) numbers of the Bernstein functions on each element.
    M : (all Bernstein functions, all functions).

    Returns
    -------
    Blocks and which of the elements each has. An element's list of functions is filled up, where it is shorter than the
    block's, with a function that it has anyway and a row of zeros.
    """
    plain = np.diff(M.indptr) == 1
    plain[plain] = M.data[M.indptr[:-1][plain]] == 1.0
    simple = plain[dofs].all(axis=1)
    result: list[tuple[Block, Index]] = []
    if simple.any():
        mine = np.flatnonzero(simple)
        result.append((Block(basis, M.indices[M.indptr[dofs[mine]]].astype(np.int64)), mine))
    rest = np.flatnonzero(~simple)
    if len(rest):
        result += [(block, rest[mine]) for block, mine in _extracted(basis, dofs[rest], M)]
    return result


def _extracted(basis: LocalBasis, dofs: Index, M: csr_array) -> list[tuple[Block, Index]]:
    count, b = dofs.shape
    rows = csr_array(M[dofs.ravel()])
    row = np.repeat(np.arange(count * b), np.diff(rows.indptr))
    element = row // b
    keys, local = np.unique(element * M.shape[1] + rows.indices, return_inverse=True)
    owner = keys // M.shape[1]
    sizes = np.bincount(owner, minlength=count)
    first = np.concatenate([[0], np.cumsum(sizes)])
    place = local.ravel() - first[element]
    width = -(-sizes // _STEP) * _STEP
    result = []
    for n in np.unique(width).tolist():
        mine = np.flatnonzero(width == n)
        position = np.full(count, -1)
        position[mine] = np.arange(len(mine))
        functions = np.repeat((keys[first[mine]] % M.shape[1])[:, None], n, axis=1)
        own = np.flatnonzero(position[owner] >= 0)
        functions[position[owner[own]], own - first[owner[own]]] = keys[own] % M.shape[1]
        C = np.zeros((len(mine), n, b))
        here = position[element] >= 0
        C[position[element[here]], place[here], row[here] % b] = rows.data[here]
        distinct, pattern = np.unique(C.reshape(len(mine), -1), axis=0, return_inverse=True)
        patterns = Patterns(distinct.reshape(-1, n, b), np.asarray(pattern, dtype=np.int64).ravel())
        result.append((Block(basis, functions, patterns), mine))
    return result
