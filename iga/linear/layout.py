"""Where unknowns live: what a domain tells the solvers of them, and the coarse spaces that follow.

Axis letters: n function, c component, e element, m unknown of an element or mode, v function of degree one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, kron

from iga.domain import Domain
from iga.errors import InputError
from iga.linear.coarse_space import (
    COARSER,
    CoarseSpace,
    degree_one,
    linear_prolongation,
    on_aggregates,
    rigid_motions,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Layout:
    """What is known of the unknowns.

    Attributes
    ----------
    components : c, unknowns of each function.
    points : (n, 3) control points of the functions, or None.
    domain : whose functions they are, or None.
    rows : (n,) functions of the domain that are the free coefficients of a constrained space; None for all.
    """

    components: int = 1
    points: Array | None = None
    domain: Domain | None = None
    rows: Index | None = None

    def modes(self, n: int) -> Array:
        """Functions without energy, (n*c, m)."""
        if self.components == 3 and self.points is not None:
            return rigid_motions(self.points)
        return np.tile(np.eye(self.components), (n // self.components, 1))

    def prolongation(self) -> csr_array | None:
        """From degree one to the free coefficients, for one component."""
        if self.domain is None:
            return None
        W = linear_prolongation(self.domain.space)
        return W if W is None or self.rows is None else csr_array(W[self.rows])

    def elements(self, held: Mask) -> list[Index]:
        """Free unknowns (e, m) of each block's elements, counted without the held ones; -1 for those and for slaves."""
        assert self.domain is not None
        c = self.components
        number = np.where(held, -1, np.cumsum(~held) - 1)
        if self.rows is not None:
            all_numbers = np.full((self.domain.space.n, c), -1, dtype=np.int64)
            all_numbers[self.rows] = number.reshape(-1, c)
        else:
            all_numbers = number.reshape(-1, c)
        return [all_numbers[block.dofs].reshape(block.elements, -1) for block in self.domain.space.blocks]


def layout_of(domain: Domain | None, constraint: csr_array | None, n: int) -> Layout:
    """Layout of n unknowns of a domain, or of the free coefficients of a constraint.

    Raises
    ------
    InputError : the number does not fit the domain.
    """
    if domain is None:
        return Layout()
    if constraint is None:
        components = n // domain.space.n
        if components * domain.space.n != n:
            raise InputError(f"{n} unknowns do not fit the {domain.space.n} functions of the domain")
        return Layout(components, domain.points, domain)
    # A free coefficient is usually the coefficient of one function: the row of T with a single one.
    T = csr_array(constraint)
    T.eliminate_zeros()
    single = np.flatnonzero(np.diff(T.indptr) == 1)
    single = single[np.abs(T.data[T.indptr[single]] - 1.0) < 1e-12]
    rows = np.full(T.shape[1], -1, dtype=np.int64)
    rows[T.indices[T.indptr[single]]] = single
    components = n // T.shape[1]
    if (rows < 0).any():
        return Layout(components)
    return Layout(components, domain.points[rows], domain, rows)


def coarse_space(layout: Layout, W: csr_array, held: Mask, modes: Array) -> CoarseSpace:
    """Degree-one functions where they are few (W for one component), else modes (N, m) on aggregates of elements."""
    if COARSER * W.shape[1] <= W.shape[0]:
        return degree_one(_inside(W, layout.components, held), modes[~held])
    return on_aggregates(modes[~held], layout.elements(held))


def _inside(W: csr_array, c: int, held: Mask) -> csr_array:
    """Prolongation to the free unknowns from the vertex functions that vanish at all held ones."""
    W = csr_array(kron(W, eye_array(c), format="csr")) if c > 1 else W
    touched = np.zeros(W.shape[1], dtype=bool)
    touched[W[np.flatnonzero(held)].indices] = True
    W = W[np.flatnonzero(~held)]
    present = np.zeros(W.shape[1], dtype=bool)
    present[W.indices] = True
    return csr_array(W[:, np.flatnonzero(present & ~touched)])
