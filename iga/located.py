r"""Fields at scattered points of a solid: each at its own reference coordinates of its own element.

With N the Bernstein functions of the element, P_i the coefficients and w the weights (one where there are none),

    u = sum_i N_i w_i u_i / W,   W = sum_i N_i w_i,   grad u = (grad_xi u) J^-1.

Axis letters: p point, b Bernstein function, c component, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.block import bezier_coefficients
from iga.domain import Domain

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_POINTS = 4096
"""Points at a time: their control nets fit the cache."""


@dataclass(frozen=True, eq=False)
class Located:
    """Points of a solid: point k is at ``xi[k]`` (p, d) of element ``element[k]`` of block ``block[k]``, (p,) each."""

    domain: Domain
    block: Index
    element: Index
    xi: Array

    @property
    def x(self) -> Array:
        """Physical points (p, 3)."""
        return self.at(self.domain.points)

    def at(self, coefficients: Array) -> Array:
        """Values (p,) or (p, c) of a field with coefficients (n,) or (n, c)."""
        value = self._expand(coefficients.reshape(len(coefficients), -1), 0)[0]
        return value.reshape(len(self.xi), *coefficients.shape[1:])

    def gradient(self, coefficients: Array) -> Array:
        """Physical gradients (p, 3) or (p, c, 3), last axis the derivative."""
        flat = coefficients.reshape(len(coefficients), -1)
        slopes = self._expand(np.column_stack([self.domain.points, flat]), 1)[1]
        return (slopes[:, 3:] @ np.linalg.inv(slopes[:, :3])).reshape(len(self.xi), *coefficients.shape[1:], 3)

    def _expand(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """Values (p, c) and, with order 1, reference gradients (p, c, d); by the quotient rule where rational."""
        space = self.domain.space
        weights = np.ones((space.n, 1)) if space.weights is None else space.weights[:, None]
        lifted = np.column_stack([coefficients * weights, weights])
        value = np.empty((len(self.xi), lifted.shape[1]))
        slope = np.empty((len(self.xi), lifted.shape[1], self.xi.shape[1] if order else 0))
        for number in np.unique(self.block).tolist():
            block, own = space.blocks[number], np.flatnonzero(self.block == number)
            for rows in np.array_split(own, -(-len(own) // _POINTS)):
                net = bezier_coefficients(block, lifted, self.element[rows])
                table = block.basis.tabulate(self.xi[rows], order)
                value[rows] = np.einsum("pb,pbc->pc", table[0], net)
                if order:
                    slope[rows] = np.einsum("pbd,pbc->pcd", table[1], net)
        W, dW = value[:, -1:], slope[:, -1:]
        value = value[:, :-1] / W
        return value, (slope[:, :-1] - value[..., None] * dW) / W[..., None]
