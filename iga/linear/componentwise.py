r"""A preconditioner for elasticity that needs no matrix of it: that of the Laplacian, for each component alone.

    K ~ L x I_c,      c_1 v^T (L x I_c) v <= v^T K v <= c_2 v^T (L x I_c) v,

with c_2 the largest eigenvalue of the stiffness and c_1 half the smallest over Korn's constant, which is one where the
whole boundary is held (Gustafsson and Lindskog, Numerical Linear Algebra with Applications 5, 1998). A matrix of one
component has a ninth of the entries, so that with an operator (`iga.operator`) a system takes a tenth of the memory of
its assembled matrix. Slender bodies that are held at one end, and materials that hardly change their volume, take many
iterations: they are for the assembled matrix and its rigid motions.

Axis letters: n function, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iga.assembly import matrix
from iga.domain import Domain
from iga.integrands import Diffusion
from iga.linear.preconditioners import Preconditioner
from iga.linear.solvers import preconditioner_for, submatrix

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def componentwise(domain: Domain, held: Mask, points: int | None = None) -> Preconditioner:
    """Preconditioner on the unknowns that are not held.

    Parameters
    ----------
    held : (n, c) which unknowns are held; of each component at least one.
    points : Gauss points per direction.
    """
    L = matrix(domain, Diffusion(), points)
    parts: dict[bytes, Preconditioner] = {}
    for mask in np.ascontiguousarray(held.T):
        if mask.tobytes() not in parts:
            free = np.flatnonzero(~mask)
            parts[mask.tobytes()] = preconditioner_for(submatrix(L, free), mask.copy(), domain)
    each = [(~mask, parts[mask.tobytes()]) for mask in np.ascontiguousarray(held.T)]

    def apply(r: Array) -> Array:
        given = np.zeros(held.shape)
        given[~held] = r
        found = np.zeros(held.shape)
        for c, (free, part) in enumerate(each):
            found[free, c] = part(given[free, c])
        return np.asarray(found[~held])

    return Preconditioner(f"{each[0][1].name}, by components", apply)
