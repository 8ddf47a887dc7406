r"""A domain whose shapes are improved: which control points may move, the energy they are moved by, what is certified.

The energy is the regularised mean ratio (`iga.distortion`) with springs (`iga.tether`). Its parameter delta makes it
finite on folded elements: for each connected group of elements the smallest delta for which h(sigma) >= EPSILON at the
worst sample point, delta = (EPSILON (EPSILON - sigma_min))^(1/2) where sigma_min < EPSILON, else 0, renewed as the
elements unfold (Escobar et al. 2003). Points where the certificate finds det J lowest become sample points.

Axis letters: e element, n function, m column of the constraint, q sample point, c component, d reference dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, coo_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components

from iga.block import Block, Extraction, Kronecker, Patterns, bezier_coefficients
from iga.cells import PYRAMID
from iga.certificate import SIGN_ALONE, certify
from iga.descent import descend
from iga.distortion import Batch, Lattice, evaluate, lattice_of, lattice_table, own_shapes, sample_points, tables_at
from iga.domain import Domain, Space, homogeneous
from iga.errors import InputError
from iga.tether import Tether, springs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

EPSILON = 0.05
"""Least h(sigma) that the regularisation leaves, relative to an ideal element."""
_EXTRA_WEIGHT = 0.2
"""Weight of an element's own sample point, beside one for all points of its lattice together."""
_FINE = 9
"""Points along an edge of the lattice on which undecided elements are searched for their lowest det J."""
_KEPT = 6
"""Most sample points of its own that an element has."""
_NEAR_APEX = 1.0 - 1e-6
"""Height of an own sample point of a pyramid whose det J is lowest at the apex."""
_RISE = 0.01
"""Share by which det S must rise at the worst point of a group for another, smaller delta to be worth a descent."""
_PORTION = 64
"""Elements searched at a time: their lattices take some megabytes."""


@dataclass(frozen=True, eq=False)
class Shaping:
    """A domain with what may move in it; columns are the constraint's, or functions where there is none.

    Attributes
    ----------
    domain : the domain at the start.
    inverse : (e, 3, 3) inverse Jacobian matrices of the ideal elements of each block.
    moves : (n, m) steps of control points from those of columns.
    open : (m,) columns that move free control points alone.
    around : (e, m) ones where a column moves an element.
    scale : (m,) size of the smallest element that a column moves.
    samples, power, size, tether : as in `iga.untangling.untangle`.
    extras : sample points of single elements, as elements (k,) and xi (k, 3), in the order in which they were found.
    """

    domain: Domain
    inverse: tuple[Array, ...]
    moves: csr_array
    open: Mask
    around: csr_array
    scale: Array
    samples: int
    power: float
    size: float = 0.0
    tether: Tether | None = None
    extras: tuple[tuple[Index, Array], ...] = ()

    @cached_property
    def offsets(self) -> Index:
        """(blocks + 1,) first element of each block in the numbering of all elements, and how many there are."""
        return np.concatenate([[0], np.cumsum([b.elements for b in self.domain.space.blocks])]).astype(np.int64)

    @property
    def elements(self) -> int:
        """Number of elements."""
        return int(self.offsets[-1])


def shaping(
    domain: Domain, free: Mask, shapes: Sequence[Array] | None, samples: int, power: float, size: float = 0.0,
    tether: Tether | None = None,
) -> Shaping:
    """What is needed to improve the shapes of a domain; parameters are those of `iga.untangling.untangle`.

    Raises
    ------
    InputError : ``free`` or ``shapes`` do not fit the domain, or an ideal element is flat.
    """
    space = domain.space
    if free.shape != (space.n,) or free.dtype != np.bool_:
        raise InputError(f"free must be {space.n} truth values, not {free.dtype} {free.shape}")
    shapes = own_shapes(domain) if shapes is None else shapes
    wanted = [(b.elements, 3, 3) for b in space.blocks]
    if [s.shape for s in shapes] != wanted:
        raise InputError(f"ideal shapes must be arrays {wanted}, not {[s.shape for s in shapes]}")
    T = space.constraint
    moves = csr_array(eye_array(space.n)) if T is None else csr_array(T)
    held = abs(moves).T @ (~free).astype(float) > 0.0
    lengths = np.concatenate([np.cbrt(np.abs(np.linalg.det(s))) for s in shapes] or [np.empty(0)])
    around = csr_array(abs(_incidence(space, len(lengths)) @ abs(moves)))
    around.data[:] = 1.0
    scale = np.full(moves.shape[1], np.inf)
    coo = around.tocoo()
    np.minimum.at(scale, coo.coords[1], lengths[coo.coords[0]])
    scale[~np.isfinite(scale)] = 1.0
    return Shaping(domain, _inverses(shapes), moves, ~held, around, scale, samples, power, size, tether)


def with_shapes(task: Shaping, shapes: Sequence[Array]) -> Shaping:
    """The same with other ideal elements (e, 3, 3) of each block."""
    return replace(task, inverse=_inverses(shapes))


def with_samples(task: Shaping, worst: tuple[Index, Array]) -> Shaping:
    """The same with further sample points, elements (k,) and xi (k, 3); the oldest ones of many are forgotten."""
    elements, xi = worst
    if not len(elements):
        return task
    return replace(task, extras=(*task.extras[-(_KEPT - 1) :], (elements, _off_apex(task, elements, xi))))


def touching(task: Shaping, elements: Mask) -> Mask:
    """Open columns (m,) that move some of the elements (e,)."""
    return task.open & np.asarray(task.around.T @ elements.astype(float) > 0.0)


def elements_of(task: Shaping, columns: Mask) -> Mask:
    """Elements (e,) that some of the columns (m,) move."""
    return np.asarray(task.around @ columns.astype(float) > 0.0)


def mask_of(task: Shaping, elements: Index) -> Mask:
    """Truth values (e,) of some elements, given by numbers."""
    mask = np.zeros(task.elements, dtype=bool)
    mask[elements] = True
    return mask


def grown(task: Shaping, elements: Mask, rings: int) -> Mask:
    """Elements (e,) with so many rings of neighbours."""
    for _ in range(rings):
        elements = elements | elements_of(task, touching(task, elements))
    return elements


def invalid_elements(
    task: Shaping, points: Array, elements: Index, depth: int
) -> tuple[Index, tuple[Index, Array]]:
    """Those of some elements that are not certified at control points (n, 3), and where det J is lowest in them.

    Parameters
    ----------
    depth : of the certificates.

    Returns
    -------
    Numbers of elements; elements (k,) and xi (k, 3) of the lowest points.
    """
    part, numbers = _part(task, points, elements)
    made = certify(part, tolerance=SIGN_ALONE, max_depth=depth)
    undecided = np.flatnonzero(made.verdict == 0)
    found = [numbers[made.offsets[made.witnesses.block] + made.witnesses.element]]
    xi = [made.witnesses.xi]
    for k in range(len(part.space.blocks)):
        mine = undecided[(undecided >= made.offsets[k]) & (undecided < made.offsets[k + 1])]
        if len(mine):
            found.append(numbers[mine])
            xi.append(_lowest(part, k, mine - made.offsets[k]))
    return numbers[made.verdict <= 0], (np.concatenate(found), np.concatenate(xi))


def _part(task: Shaping, points: Array, elements: Index) -> tuple[Domain, Index]:
    """Domain of some elements, and their numbers, blocks one after the other."""
    blocks, numbers = [], []
    for k, block in enumerate(task.domain.space.blocks):
        mine = elements[(elements >= task.offsets[k]) & (elements < task.offsets[k + 1])]
        if len(mine):
            blocks.append(_some(block, mine - task.offsets[k]))
            numbers.append(mine)
    space = replace(task.domain.space, blocks=tuple(blocks), constraint=None)
    return Domain(space, points), np.concatenate(numbers) if numbers else np.empty(0, dtype=np.int64)


def _off_apex(task: Shaping, elements: Index, xi: Array) -> Array:
    """Points (k, 3) of elements, those at the apex of a pyramid moved off it: its map has no Jacobian matrix there."""
    block = np.searchsorted(task.offsets, elements, side="right") - 1
    high = np.array([b.basis.cell is PYRAMID for b in task.domain.space.blocks])[block] & (xi[:, 2] >= _NEAR_APEX)
    near = xi.copy()
    near[high & (xi[:, 2] >= 1.0), :2] = 0.0
    near[high, 2] = _NEAR_APEX
    return near


def minimise(
    task: Shaping, points: Array, open_: Mask, seen: Index, iterations: int, repeats: int = 6, folds: bool = True
) -> tuple[Array, float]:
    """Steps of the columns (m, 3) by descent over the open ones, and the smallest det S at samples of ``seen``.

    Parameters
    ----------
    points : (n, 3) control points at the start.
    open_ : (m,) columns that move; at least one.
    seen : numbers of the elements whose energy counts: all that the open columns move.
    iterations : most descent steps for each value of delta.
    repeats : most values of delta.
    folds : whether elements may fold on the way; if not, only those are regularised that are folded at the start.
    """
    columns = np.flatnonzero(open_)
    group, groups = _groups(task, columns, seen)
    batches, used = _batches(task, seen, group)
    moves = csr_array(task.moves[used][:, columns])
    weights = task.domain.space.weights
    base = points[used]
    if weights is not None:
        own = weights[used][:, None]
        base, moves = np.column_stack([base * own, own]), csr_array(diags_array(own.ravel()) @ moves)
    back = csr_array(moves.T)
    values = base.copy()
    delta = np.zeros(groups)
    pull, soft = springs(task.tether, points, csr_array(task.moves[:, columns]), task.scale[columns])

    def energy(z: Array) -> tuple[float, Array]:
        step = _times(soft, z)
        values[:, :3] = base[:, :3] + moves @ step
        value, gradient, _, _ = evaluate(batches, values, delta, task.power, task.size)
        held, slope = pull(step)
        return value + held, _times(soft, back @ gradient + slope).ravel()

    def lowest(z: Array) -> Array:
        values[:, :3] = base[:, :3] + moves @ _times(soft, z)
        least = evaluate(batches, values, np.ones(groups), task.power)[3]
        low = np.full(groups, np.inf)
        for batch, own_least in zip(batches, least):
            np.minimum.at(low, batch.group, own_least)
        return low

    z = np.zeros(3 * len(columns))
    low = lowest(z)
    for _ in range(repeats):
        folded = low < (EPSILON if folds else 0.0)
        delta = np.where(folded, np.sqrt(EPSILON * np.where(folded, EPSILON - low, 0.0)), 0.0)
        z = descend(energy, z, iterations).x
        before, low = low, lowest(z)
        if not (delta > 0.0).any() or not (low > before + _RISE * np.abs(before)).any():
            break
    step = np.zeros((len(open_), 3))
    step[columns] = _times(soft, z)
    return step, float(low.min(initial=np.inf))


def _groups(task: Shaping, columns: Index, seen: Index) -> tuple[Index, int]:
    """Connected group of each element seen, joined by open columns, and how many there are."""
    part = task.around[seen][:, columns]
    label = connected_components(block_array([[None, part], [part.T, None]]), directed=False)[1][: len(seen)]
    found, group = np.unique(label, return_inverse=True)
    return group.astype(np.int64), len(found)


def _batches(task: Shaping, seen: Index, group: Index) -> tuple[list[Batch], Index]:
    """Elements seen with their sample points, and the functions (k,) on them, by which the batches are numbered."""
    space = task.domain.space
    place = np.full(task.elements, -1, dtype=np.int64)
    place[seen] = np.arange(len(seen))
    jobs: list[tuple[int, Index, Array | None]] = []
    for k, first in enumerate(task.offsets[:-1].tolist()):
        last = int(task.offsets[k + 1])
        mine = seen[(seen >= first) & (seen < last)]
        if len(mine):
            jobs.append((k, mine - first, None))
        for elements, xi in task.extras:
            here = np.flatnonzero((elements >= first) & (elements < last) & (place[elements] >= 0))
            if len(here):
                jobs.append((k, elements[here] - first, xi[here]))
    used = np.unique(np.concatenate([space.blocks[k].dofs[own].ravel() for k, own, _ in jobs]))
    number = np.full(space.n, -1, dtype=np.int64)
    number[used] = np.arange(len(used))
    rational = space.weights is not None
    made = []
    for k, own, own_xi in jobs:
        block = _some(space.blocks[k], own)
        basis = block.basis
        table: Array | Lattice
        if own_xi is None:
            products = None if rational else lattice_of(block, task.samples)
            table = lattice_table(basis, task.samples, rational) if products is None else products
        else:
            table = tables_at(basis, own_xi, rational)
        weight = np.full(len(own), 1.0 if own_xi is None else _EXTRA_WEIGHT)
        made.append(Batch(
            replace(block, dofs=number[block.dofs]), table, 4 if rational else 3,
            np.ascontiguousarray(task.inverse[k][own]), weight, group[place[task.offsets[k] + own]],
        ))
    return made, used


def _inverses(shapes: Sequence[Array]) -> tuple[Array, ...]:
    for k, own in enumerate(shapes):
        size = np.abs(own).max(axis=(1, 2), keepdims=True)
        flat = np.flatnonzero(~(np.abs(np.linalg.det(own / np.where(size > 0.0, size, 1.0))) > 0.0))
        if len(flat):
            raise InputError(f"the ideal shape of element {flat[0]} of block {k} is flat ({len(flat)} in all)")
    return tuple(np.asarray(np.linalg.inv(own)) for own in shapes)


def _times(units: Array, z: Array) -> Array:
    """Symmetric matrices (m, 3, 3) times vectors, (m, 3)."""
    return np.einsum("mij,mj->mi", units, z.reshape(-1, 3))


def _some(block: Block, elements: Index) -> Block:
    """Some elements of a block."""
    extraction: Extraction = block.extraction
    if isinstance(extraction, Patterns):
        extraction = Patterns(extraction.C, np.ascontiguousarray(extraction.pattern[elements]))
    elif isinstance(extraction, Kronecker):
        extraction = Kronecker(extraction.factors, np.ascontiguousarray(extraction.pattern[elements]))
    return Block(block.basis, block.dofs[elements], extraction)


def _incidence(space: Space, elements: int) -> csr_array:
    """(e, n), which functions act on which elements."""
    rows, columns, start = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)], 0
    for block in space.blocks:
        rows.append(np.repeat(np.arange(start, start + block.elements), block.n))
        columns.append(block.dofs.ravel())
        start += block.elements
    at = (np.concatenate(rows), np.concatenate(columns))
    return csr_array(coo_array((np.ones(len(at[0])), at), shape=(elements, space.n)))


def _lowest(domain: Domain, number: int, elements: Index) -> Array:
    """Points (e, 3) of a lattice of each element where det J is lowest."""
    block, values = domain.space.blocks[number], homogeneous(domain.space, domain.points)
    rational = domain.space.weights is not None
    grid = sample_points(block.basis.cell, _FINE)
    table = lattice_table(block.basis, _FINE, rational)
    low = [np.empty(0, dtype=np.int64)]
    for some in np.array_split(elements, -(-len(elements) // _PORTION)):
        net = bezier_coefficients(block, values, some).swapaxes(1, 2)
        J = (net @ table).reshape(*net.shape[:2], -1, len(grid))
        if rational:
            J = (J[:, :3, 1:] - J[:, :3, :1] / J[:, 3:, :1] * J[:, 3:, 1:]) / J[:, 3:, :1]
        low.append(np.linalg.det(np.moveaxis(J, 3, 1)).argmin(axis=1))
    return grid[np.concatenate(low)]
