"""Scattering of ready local vectors.

Axis letters: e element, n function on the element, c component.
"""

from __future__ import annotations

import numba

from iga.kernels.options import OPTIONS


@numba.njit(**OPTIONS)
def add_vectors(local, dofs, scale, vector):
    """vector[dofs[e, i], c] += scale[e, i] local[e, c, i]."""
    for e in range(dofs.shape[0]):
        for c in range(local.shape[1]):
            for i in range(dofs.shape[1]):
                vector[dofs[e, i], c] += scale[e, i] * local[e, c, i]
