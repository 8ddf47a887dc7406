"""From error indicators to a finer T-mesh: marking and the step of an adaptive loop.

    solve -> estimate -> mark -> refine

The estimate comes from whoever solved (`problems.estimator` for heat). Marking is Doerfler's: the fewest cells that
carry a given share of the sum of squares (SIAM J. Numer. Anal. 33, 1996), which makes adaptive loops converge at the
best rate. A single split cell adds no spline, because no support of a finer one fits in it; so marked cells are split
together with their neighbours.

Axis letters: c leaf cell, e element.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.meccano.collocation import prolongation
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.tmesh import refined
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def by_cell(own: Hierarchy, values: Array) -> Array:
    """Values (c,) of leaf cells from values (e,) of elements, blocks of the space one after the other."""
    start = np.concatenate([[0], np.cumsum([block.elements for block in own.space.blocks])])
    return np.asarray(values[start[own.element[:, 0]] + own.element[:, 1]])


def doerfler(indicators: Array, share: float = 0.5) -> Index:
    """Fewest entries, ascending, whose squares sum to at least ``share`` of all.

    Raises
    ------
    InputError : a share outside (0, 1], or indicators that are not finite or negative.
    """
    if not 0.0 < share <= 1.0:
        raise InputError(f"the share to mark is {share}; it lies in (0, 1]")
    bad = np.flatnonzero(~(np.isfinite(indicators) & (indicators >= 0)))
    if len(bad):
        raise InputError(f"error indicator {bad[0]} is {indicators[bad[0]]}")
    order = np.argsort(-indicators, kind="stable")
    sums = np.cumsum(indicators[order] ** 2)
    if not len(sums) or sums[-1] == 0.0:
        return np.empty(0, dtype=np.int64)
    return np.sort(order[: int(np.searchsorted(sums, share * sums[-1] * (1.0 - 1e-14))) + 1])


def adapt(
    own: Hierarchy, indicators: Array, share: float = 0.5, reach: int = 1, limit: int = 2_000_000
) -> tuple[Hierarchy, csr_array]:
    """Refine where indicators (e,) of elements are large.

    Parameters
    ----------
    share : of the squared estimate that marked cells carry.
    reach : how many neighbours of its own size around a marked cell are split with it.
    limit : most cells.

    Returns
    -------
    The finer space, and the prolongation to it (coefficients, control points among them, are T @ old).
    """
    marked = doerfler(by_cell(own, indicators), share)
    finer = hierarchy(refined(own.tmesh, marked, reach=reach, limit=limit), own.degree)
    return finer, prolongation(own, finer)
