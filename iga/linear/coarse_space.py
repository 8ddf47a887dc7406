r"""Coarse spaces of two-level preconditioners, by their prolongations W to the functions of a space.

**Degree one**: the degree-one functions on the same cells. For C0 Bernstein spaces these are a subspace (W is degree
elevation); a spline takes the mean of the linear function's Bernstein coefficients over one of its elements (a local
quasi-interpolation that keeps constants). **Modes on aggregates**: where that is hardly coarser, as for smooth splines,
W has the motions without energy on aggregates of elements (`aggregates`).

Axis letters: n function, e element, b Bernstein function, v vertex, c component, m mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from iga.bernstein import bernstein, elevation, functions_at
from iga.block import Block, bezier_coefficients, distinct_extractions
from iga.domain import Space
from iga.linear.aggregates import aggregated

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COARSER = 4
"""How many times fewer the degree-one functions must be than the unknowns to serve as coarse space."""


@dataclass(frozen=True, eq=False)
class CoarseSpace:
    """A coarse space: its name, its prolongation W (n, k), and the modes without energy in it (k, m)."""

    name: str
    W: csr_array
    modes: Array


def degree_one(W: csr_array, modes: Array) -> CoarseSpace:
    """Coarse space of degree-one functions, from their prolongation (n, k) and the modes of all unknowns (n, m)."""
    return CoarseSpace("degree one", W, _restrict_modes(W, modes))


def on_aggregates(modes: Array, elements: Sequence[Index]) -> CoarseSpace:
    """Coarse space of the modes (n, m) on aggregates of elements; see `iga.linear.aggregates`."""
    P = aggregated(modes, elements)
    return CoarseSpace("modes on aggregates", P, np.asarray(P.T @ modes))


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
        bezier = bezier_coefficients(block, random)[:, functions_at(block.basis, block.basis.cell.vertices), 0]
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


def _local(block: Block) -> tuple[Array, Array, Index]:
    """Products C E (k, n, v) with the elevation E from degree one, sums of C over b (k, n), and which k (e,)."""
    E = elevation(bernstein(block.basis.cell, 1), tuple(block.basis.degree))
    C, pattern = distinct_extractions(block)
    return C @ E, C.sum(axis=2), pattern


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
