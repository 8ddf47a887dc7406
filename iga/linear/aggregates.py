r"""Coarse spaces by aggregation over elements, for two-level preconditioners of smooth splines.

Splines of maximal smoothness have about one function per element, so the degree-one functions on the same cells are no
coarser than they are. Instead unknowns are joined to aggregates the size of an element's support: elements most of
whose unknowns are not taken yet found an aggregate (in random order), the unknowns in between join the aggregate that
their element has most of. On each aggregate the coarse functions are the motions without energy, restricted to it and
made orthonormal,

    P_g = M_g V L^-1/2,      M_g^T M_g = V L V^T,

without the directions in which M_g has nothing (a boundary is held, or an aggregate is small). Nicolaides 1987
(doi:10.1137/0724027). Splines overlap by their degree, so that plain restriction is smooth enough.

Axis letters: n unknown, e element, m mode, g aggregate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from iga.kernels import patches as kernels

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_DROPPED = 1e-8
"""Squared length of a mode, over that of the longest on an aggregate, below which it counts as absent."""


def aggregates(n: int, elements: Sequence[Index]) -> tuple[Index, int]:
    """Join unknowns to aggregates.

    Parameters
    ----------
    n : number of unknowns.
    elements : unknowns (e, m) of the elements of each block, negative for none.

    Returns
    -------
    Aggregate of each unknown (n,), -1 for those on no element; and their number.
    """
    label = np.full(n, -1, dtype=np.int64)
    random = np.random.default_rng(20189)
    count = 0
    for unknowns in elements:
        count = kernels.found_aggregates(unknowns, random.permutation(len(unknowns)), label, count)
    joined = label.copy()
    for unknowns in elements:
        kernels.join_aggregates(unknowns, label, joined)
    return joined, count


def aggregated(modes: Array, elements: Sequence[Index]) -> csr_array:
    """Coarse space P (n, k) with orthonormal columns that holds the modes (n, m)."""
    n, m = modes.shape
    label, count = aggregates(n, elements)
    there = np.flatnonzero(label >= 0)
    own = label[there]
    gram = np.zeros((count, m, m))
    for a in range(m):
        for b in range(a, m):
            products = np.bincount(own, modes[there, a] * modes[there, b], count)
            gram[:, a, b] = gram[:, b, a] = products
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
    values, vectors = np.linalg.eigh(gram / (scale[:, :, None] * scale[:, None, :]))
    keep = values > _DROPPED * values[:, -1:]
    vectors = vectors / scale[:, :, None] / np.sqrt(np.where(keep, values, 1.0))[:, None, :]
    entries = np.einsum("nm,nmk->nk", modes[there], vectors[own])
    number = np.where(keep, np.cumsum(keep.ravel()).reshape(keep.shape) - 1, -1)
    columns = number[own]
    some = columns >= 0
    rows = np.broadcast_to(there[:, None], columns.shape)
    made = coo_array((entries[some], (rows[some], columns[some])), shape=(n, int(keep.sum())))
    return csr_array(made.tocsr())
