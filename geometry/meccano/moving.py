"""Solids on T-meshes moved while they stay certified (`iga.untangling`), in terms of the functions of their space.

A solid's elements are leaf cells with plain splines, which are tied to the functions by the expansion, d = X c
(`expansion`). The functions' own coefficients are among those of the splines, so nothing is lost on the way back.

Axis letters: n function, s spline on leaf cells, c leaf cell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.solid import Solid
from iga.progress import QUIET, Progress
from iga.tether import Tether
from iga.untangling import Untangled, approach, smooth, unfold, untangle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def untangled(solid: Solid, free: Mask, rounds: int, patience: int, shown: Progress = QUIET) -> Solid:
    """Untangle by free functions (n,); see `iga.untangling.untangle`."""
    return _back(solid, untangle(
        solid.domain, _touched(solid.space, free), rounds=rounds, patience=patience, shown=shown
    ))


def unfolded(solid: Solid, tether: Tether, shown: Progress = QUIET) -> Solid:
    """Unfold by all functions, with springs on control points (n, 3); see `iga.untangling.unfold`."""
    everything = np.ones(solid.space.expansion.shape[0], dtype=bool)
    return _back(solid, unfold(solid.domain, everything, _on_splines(tether, _pick(solid.space)), shown=shown))


def smoothed(
    solid: Solid, free: Mask, iterations: int, rounds: int = 2, samples: int = 3, power: float = 2.0,
    tether: Sequence[Tether] | Callable[[Array], Tether] | None = None, repairs: int = 2, folds: bool = True,
    shown: Progress = QUIET,
) -> Solid:
    """Improve shapes by free functions (n,), with springs on control points (n, 3); see `iga.untangling.smooth`."""
    own, pick = solid.space.own, _pick(solid.space)
    tethers: Sequence[Tether] | Callable[[Array], Tether] | None
    if callable(tether):
        make = tether

        def tethers(points: Array) -> Tether:
            return _on_splines(make(points[own]), pick)
    else:
        tethers = None if tether is None else [_on_splines(each, pick) for each in tether]
    return _back(solid, smooth(
        solid.domain, _touched(solid.space, free), rounds=rounds, iterations=iterations, samples=samples, power=power,
        tether=tethers, repairs=repairs, folds=folds, shown=shown,
    ))


def approached(solid: Solid, points: Array) -> Solid:
    """Move control points as far towards given ones (n, 3) as all stays certified; see `iga.untangling.approach`."""
    return _back(solid, approach(solid.domain, points - solid.points))


def _back(solid: Solid, found: Untangled) -> Solid:
    return replace(solid, points=found.points[solid.space.own], invalid=found.invalid[:, 1])


def _pick(space: Hierarchy) -> csr_array:
    """Matrix (n, s) from the coefficients of splines to those of functions."""
    return csr_array((np.ones(space.n), (np.arange(space.n), space.own)), shape=space.expansion.shape[::-1])


def _touched(space: Hierarchy, free: Mask) -> Mask:
    """Splines (s,) that some of the functions are made of; only these functions act on no others."""
    return np.asarray(abs(space.expansion) @ free.astype(float) > 0.0)


def _on_splines(tether: Tether, pick: csr_array) -> Tether:
    return replace(tether, A=csr_array(tether.A @ pick))
