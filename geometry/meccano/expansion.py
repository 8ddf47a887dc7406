r"""Truncated hierarchical splines expanded in plain splines: on each leaf cell in those of the cell's own level.

A spline of level l on a cell of that level is, as a coefficient of the function f = sum_n c_n N_n,

    c_n                  if it is inside and active, as function n (truncation keeps coefficients),
    0                    if it is inside, and active on a finer level only,
    sum_j R_j d_j        else, with d_j the coefficients of the splines of level l - 1 on the parent cell.

So f is given on all leaf cells by d = X c with one sparse matrix X, whose rows all cells around share, and by
tensor-product splines from there: no cell needs a matrix of its own. Values, shapes and certificates need no more;
assembly, which needs functions on elements, has `patterns`.

Axis letters: c leaf cell, m cell of one level, s spline on leaf cells of its level, i spline on a cell, n function,
d dimension.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from geometry.meccano.levels import Level, offsets, parents_of
from geometry.meccano.splines import bezier_table, refinement_table, window
from geometry.meccano.tmesh import TMesh
from iga.bernstein import bernstein
from iga.block import Block, Kronecker

Index = NDArray[np.int64]


def expansion(tmesh: TMesh, levels: Sequence[Level], p: int, count: int) -> tuple[Block, csr_array, Index]:
    """The splines on leaf cells, and how functions consist of them.

    Parameters
    ----------
    levels : splines of each level, with ``count`` active functions in all.

    Returns
    -------
    block : elements are the leaf cells, in their order; dofs are splines.
    X : (s, n)
    own : (n,) spline whose coefficient is that of each function.
    """
    size = (p + 1) ** tmesh.dim
    dofs, kinds = np.empty((tmesh.cells, size), dtype=np.int64), np.empty((tmesh.cells, tmesh.dim), dtype=np.int64)
    parts: list[csr_array] = []
    mine = np.empty(count, dtype=np.int64)
    above, known = csr_array((0, count)), 0
    for l, own in enumerate(levels):
        above = _coefficients(own, levels[l - 1] if l else None, parents_of(levels, l), above, p, count)
        leaf = np.flatnonzero(own.nodes.leaf >= 0)
        cells = own.nodes.leaf[leaf]
        used, number = np.unique(own.spline[leaf].ravel(), return_inverse=True)
        dofs[cells] = known + number.reshape(-1, size)
        left, right = window(own.nodes.place[leaf], own.nodes.level, p)
        kinds[cells] = left * p + right
        parts.append(above[used])
        active = own.number[leaf].ravel()
        mine[active[active >= 0]] = known + number.ravel()[active >= 0]
        known += len(used)
    E = bezier_table(p).reshape(p * p, p + 1, p + 1)
    block = Block(bernstein(tmesh.blocks.cell, p), dofs, Kronecker((E,) * tmesh.dim, kinds))
    return block, csr_array(vstack(parts)), mine


def _coefficients(
    own: Level, coarse: Level | None, parent: Index, above: csr_array, p: int, count: int
) -> csr_array:
    """Coefficients (splines of the level, n) from those of the level above."""
    _, first = np.unique(own.spline.ravel(), return_index=True)
    m, i = np.divmod(first, own.spline.shape[1])
    inside, number = own.inside[m, i], own.number[m, i]
    active = np.flatnonzero(number >= 0)
    made = csr_array((np.ones(len(active)), (active, number[active])), shape=(len(first), count))
    lower = np.flatnonzero(~inside)
    if coarse is None or not len(lower):
        return made
    m, i, up = m[lower], offsets(p, own.nodes.place.shape[1])[i[lower]], parent[m[lower]]
    place = own.nodes.place[m]
    left, right = window(place >> 1, own.nodes.level - 1, p)
    share = refinement_table(p)[left, right, place & 1]  # (s, d, p+1, p+1)
    share = np.take_along_axis(share, i[:, :, None, None], axis=3)[..., 0]
    whole = share[:, 0]
    for axis in range(1, share.shape[1]):
        whole = (whole[:, :, None] * share[:, axis, None]).reshape(len(lower), -1)
    row, j = np.nonzero(whole)
    refine = csr_array(
        (whole[row, j], (lower[row], coarse.spline[up[row], j])), shape=(len(first), above.shape[0])
    )
    return csr_array(made + refine @ above)
