"""Assembly of matrices, vectors and integrals from integrands.

Unknown ``i*c + a`` is component a of function i. Local arrays are added in coordinate form chunk by chunk; the result
is a CSR matrix with sorted, unique entries.

Axis letters: e element, n function on the element, c component.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from iga.chunk import Chunk, chunks, facet_chunks
from iga.domain import Domain, Facets
from iga.field import Coefficient, evaluate

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Integrand = Callable[[Chunk], Array]
Boundary = str | list[str] | tuple[Facets, ...]


def walk(domain: Domain, points: int | None, boundary: Boundary | None) -> Iterator[Chunk]:
    """Chunks of the volume, or of a boundary if one is given."""
    return chunks(domain, points) if boundary is None else facet_chunks(domain, boundary, points)


def unknowns(dofs: Index, components: int) -> Index:
    """Unknown numbers (..., n*c) of functions (..., n)."""
    return (dofs[..., None] * components + np.arange(components)).reshape(*dofs.shape[:-1], -1)


def matrix(
    domain: Domain,
    integrand: Integrand,
    points: int | None = None,
    boundary: Boundary | None = None,
    components: int | None = None,
) -> csr_array:
    """Assemble a matrix over the volume, or over named boundaries.

    Parameters
    ----------
    integrand : returns (e, n*c, n*c) for a chunk.
    points : Gauss points per direction, by default degree + 1.
    boundary : name, pattern, list of them, or facets.
    components : number c, by default the integrand's own.

    Returns
    -------
    (N*c, N*c)
    """
    c = int(getattr(integrand, "components", 1)) if components is None else components
    size = domain.space.n * c
    rows, columns, values = [], [], []
    for chunk in walk(domain, points, boundary):
        local = integrand(chunk)
        index = unknowns(chunk.dofs, c)
        rows.append(np.broadcast_to(index[:, :, None], local.shape).ravel())
        columns.append(np.broadcast_to(index[:, None, :], local.shape).ravel())
        values.append(local.ravel())
    if not rows:
        return csr_array((size, size))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(size, size)).tocsr()


def vector(
    domain: Domain,
    integrand: Integrand,
    points: int | None = None,
    boundary: Boundary | None = None,
    components: int | None = None,
) -> Array:
    """Assemble a vector (N*c,) from an integrand that returns (e, n*c); parameters as in `matrix`."""
    c = int(getattr(integrand, "components", 1)) if components is None else components
    result = np.zeros(domain.space.n * c)
    for chunk in walk(domain, points, boundary):
        local = integrand(chunk)
        result += np.bincount(unknowns(chunk.dofs, c).ravel(), local.ravel(), len(result))
    return result


def integral(
    domain: Domain, value: Coefficient = 1.0, points: int | None = None, boundary: Boundary | None = None
) -> Array:
    """Integral of a coefficient over the volume or named boundaries, with the coefficient's own shape."""
    total: Array = np.zeros(())
    for chunk in walk(domain, points, boundary):
        values = evaluate(value, chunk)
        if values.ndim < 2 or values.shape[:2] != chunk.dx.shape:
            values = np.broadcast_to(values, (*chunk.dx.shape, *values.shape))
        total = total + np.tensordot(chunk.dx, values, axes=([0, 1], [0, 1]))
    return total


def volume(domain: Domain, points: int | None = None) -> float:
    """Signed volume of the solid."""
    return float(sum(chunk.dx.sum() for chunk in chunks(domain, points)))
