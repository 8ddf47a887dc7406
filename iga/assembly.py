"""Assembly of matrices, vectors and integrals from integrands.

Unknown ``i*c + a`` is component a of function i. The built-in integrands over the volume go through compiled kernels
(`iga.forms`, `iga.frame`) into the sparsity of the space (`iga.sparsity`), on all threads. Any other integrand, and
everything on boundaries, is called chunk by chunk and added in coordinate form; `reference_matrix` and
`reference_vector` do this for all integrands. The result is a CSR matrix with sorted, unique entries.

Axis letters: e element, n function on the element, c component.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from iga.chunk import Chunk, chunks, facet_chunks
from iga.domain import Domain, Facets
from iga.errors import InputError
from iga.field import Coefficient, evaluate
from iga.forms import NotSymmetricError, buffers, control_points, known, site, source, terms
from iga.frame import Frame, Rows, add_matrices, distribute, frames
from iga.integrands import Elasticity, Load
from iga.kernels import pattern as kernels
from iga.parallel import ranges, run
from iga.sparsity import finish, sparsity

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Integrand = Callable[[Chunk], Array]
Boundary = str | list[str] | tuple[Facets, ...]

_TERMS = 10_000_000
"""Entries of element matrices that are summed at a time."""


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
    points : Gauss points per direction, by default `iga.chunk.default_points`.
    boundary : name, pattern, list of them, or facets.
    components : number c, by default the integrand's own.

    Returns
    -------
    (N*c, N*c)
    """
    c = int(getattr(integrand, "components", 1)) if components is None else components
    if boundary is None and known(integrand) and c == getattr(integrand, "components", 1) and _solid(domain):
        try:
            return _compiled_matrix(domain, integrand, points, c)
        except NotSymmetricError:
            pass
    return reference_matrix(domain, integrand, points, boundary, c)


def reference_matrix(
    domain: Domain, integrand: Integrand, points: int | None, boundary: Boundary | None, components: int
) -> csr_array:
    """Assemble a matrix by calling the integrand on every chunk; parameters as in `matrix`."""

    def parts() -> Iterator[tuple[Index, Array]]:
        for chunk in walk(domain, points, boundary):
            index = unknowns(chunk.dofs, components)
            yield index, _of_shape(integrand(chunk), (*index.shape, index.shape[1]), "(e, n*c, n*c)")

    return sum_of(parts(), domain.space.n * components)


def sum_of(parts: Iterable[tuple[Index, Array]], size: int) -> csr_array:
    """Matrix (size, size) of element matrices, given in parts as unknowns (e, m) and entries (e, m, m).

    Entries are summed whenever some millions have come together, so that memory holds the matrix, not all its terms.
    """
    total = csr_array((size, size))
    waiting: list[tuple[Array, Array, Array]] = []
    many = 0

    def summed() -> csr_array:
        values, rows, columns = (np.concatenate(some) for some in zip(*waiting))
        waiting.clear()
        return csr_array(total + coo_array((values, (rows, columns)), shape=(size, size)).tocsr())

    for index, local in parts:
        narrow = index.astype(np.int32 if size < 2**31 else np.int64)
        waiting.append((
            local.ravel(),
            np.broadcast_to(narrow[:, :, None], local.shape).ravel(),
            np.broadcast_to(narrow[:, None, :], local.shape).ravel(),
        ))
        many += local.size
        if many > max(_TERMS, total.nnz):
            total, many = summed(), 0
    return summed() if waiting else total


def vector(
    domain: Domain,
    integrand: Integrand,
    points: int | None = None,
    boundary: Boundary | None = None,
    components: int | None = None,
) -> Array:
    """Assemble a vector (N*c,) from an integrand that returns (e, n*c); parameters as in `matrix`."""
    c = int(getattr(integrand, "components", 1)) if components is None else components
    if boundary is None and type(integrand) is Load and c == integrand.components and _solid(domain):
        return _compiled_vector(domain, integrand, points)
    return reference_vector(domain, integrand, points, boundary, c)


def reference_vector(
    domain: Domain, integrand: Integrand, points: int | None, boundary: Boundary | None, components: int
) -> Array:
    """Assemble a vector by calling the integrand on every chunk; parameters as in `vector`."""
    c = components
    result = np.zeros(domain.space.n * c)
    for chunk in walk(domain, points, boundary):
        index = unknowns(chunk.dofs, c)
        local = _of_shape(integrand(chunk), index.shape, "(e, n*c)")
        result += np.bincount(index.ravel(), local.ravel(), len(result))
    return result


def _of_shape(local: Array, shape: tuple[int, ...], axes: str) -> Array:
    """What an integrand gave for a chunk, or `InputError` if that is no array of this shape."""
    if np.shape(local) != shape:
        given = f"an array of shape {np.shape(local)}" if isinstance(local, np.ndarray) else type(local).__name__
        raise InputError(f"an integrand gives {given} where {axes} = {shape} is needed")
    return local


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


def _solid(domain: Domain) -> bool:
    """Whether all cells are three-dimensional, as the kernels need."""
    return bool(domain.space.blocks) and all(block.basis.cell.dim == 3 for block in domain.space.blocks)


def _compiled_matrix(domain: Domain, integrand: Integrand, points: int | None, components: int) -> csr_array:
    """`matrix` of a known integrand over the volume.

    Each thread takes a run of elements. Rows that an earlier thread writes to as well are kept apart, at the end of the
    array of entries, and added when all are done, so that the result does not depend on timing.
    """
    space, c = domain.space, components
    pattern = sparsity(space)
    control = control_points(domain)
    length = np.diff(pattern.indptr)
    begin = c * c * pattern.indptr[:-1]
    all_frames = frames(domain, points, 8 if isinstance(integrand, Elasticity) else 1)
    parts = [ranges(f.block.elements) for f in all_frames]
    begins, extra = [], 0
    for f, runs in zip(all_frames, parts):
        taken = np.zeros(space.n, dtype=np.bool_)
        for number, (lo, hi) in enumerate(runs):
            own = begin
            if len(runs) > 1:
                used = np.zeros(space.n, dtype=np.bool_)
                kernels.touched(f.block.dofs[lo:hi], used)
                shared = np.flatnonzero(used & taken)
                taken |= used
                if number:
                    own = begin.copy()
                    sizes = c * c * length[shared]
                    ends = np.cumsum(sizes)
                    own[shared] = c * c * pattern.indptr[-1] + extra + ends - sizes
                    extra += int(ends[-1]) if len(ends) else 0
            begins.append(own)
    values = np.zeros(c * c * int(pattern.indptr[-1]) + extra)
    privates = iter(begins)
    for number, (f, runs) in enumerate(zip(all_frames, parts)):
        mine, slots = [next(privates) for _ in runs], pattern.slots[number]
        tasks = [
            partial(_add_run, domain, integrand, f, number, part, control, Rows(slots, own, length, c, values))
            for part, own in zip(runs, mine)
        ]
        run(tasks)
        for own in mine[1:]:
            kernels.merge(values, begin, c * c * length, own, 0, space.n)
    return finish(pattern, values, c)


def _add_run(
    domain: Domain, integrand: Integrand, f: Frame, block: int, part: tuple[int, int], control: Array, rows: Rows
) -> None:
    """Add the elements part[0]..part[1] of a block to a matrix."""
    work = buffers(f, pairs=isinstance(integrand, Elasticity))
    for lo in range(*part, f.size):
        hi = min(lo + f.size, part[1])
        at = site(f, block, lo, hi, control, work)
        for a, b, D in terms(integrand, at, work):
            add_matrices(f, lo, hi, D, a, b, rows)


def _compiled_vector(domain: Domain, integrand: Load, points: int | None) -> Array:
    """`vector` of a load over the volume; each thread adds to a vector of its own."""
    control = control_points(domain)

    def part(f: Frame, block: int, begin: int, end: int) -> Array:
        result = np.zeros((domain.space.n, integrand.components))
        work = buffers(f)
        for lo in range(begin, end, f.size):
            hi = min(lo + f.size, end)
            distribute(f, lo, hi, source(integrand, site(f, block, lo, hi, control, work)), result)
        return result

    total = np.zeros((domain.space.n, integrand.components))
    for block, f in enumerate(frames(domain, points)):
        for result in run([partial(part, f, block, *bounds) for bounds in ranges(f.block.elements)]):
            total += result
    return total.reshape(-1)
