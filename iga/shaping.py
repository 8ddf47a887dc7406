r"""A domain whose shapes are improved: which control points may move, the energy they are moved by, what is certified.

The energy is the regularised mean ratio (`iga.distortion`) with springs (`iga.tether`). Its parameter delta makes it
finite on folded elements: for each connected group of elements the smallest delta for which h(sigma) >= EPSILON at the
worst sample point, delta = (EPSILON (EPSILON - sigma_min))^(1/2) where sigma_min < EPSILON, else 0, renewed as the
elements unfold (Escobar et al. 2003). Points where the certificate finds det J lowest become sample points.

Axis letters: e element, n function, m column of the constraint, q sample point, c component, d reference dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, coo_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components

from iga.block import Block, Extraction, Kronecker, Patterns, bezier_coefficients
from iga.certificate import Witnesses, certify
from iga.descent import descend
from iga.distortion import Batch, evaluate, lattice_table, own_shapes, sample_points, tables_at
from iga.domain import Domain, Space
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


class Shaping:
    """A domain with what may move in it.

    Parameters are those of `iga.untangling.untangle`; columns are the
    constraint's, or functions where there is none.
    """

    def __init__(
        self, domain: Domain, free: Mask, shapes: Sequence[Array] | None, samples: int, power: float,
        size: float = 0.0, tether: Tether | None = None,
    ) -> None:
        space = domain.space
        if free.shape != (space.n,) or free.dtype != np.bool_:
            raise InputError(f"free must be {space.n} truth values, not {free.dtype} {free.shape}")
        shapes = own_shapes(domain) if shapes is None else shapes
        wanted = [(b.elements, 3, 3) for b in space.blocks]
        if [s.shape for s in shapes] != wanted:
            raise InputError(f"ideal shapes must be arrays {wanted}, not {[s.shape for s in shapes]}")
        self.domain, self.samples, self.power, self.size, self.tether = domain, samples, power, size, tether
        self.shape(shapes)
        self.offsets = np.concatenate([[0], np.cumsum([b.elements for b in space.blocks])]).astype(np.int64)
        self.elements = int(self.offsets[-1])
        T = space.constraint
        self.moves: csr_array = csr_array(eye_array(space.n)) if T is None else csr_array(T)
        held = abs(self.moves).T @ (~free).astype(float) > 0.0
        self.columns = self.moves.shape[1]
        self.open: Mask = ~held
        lengths = np.concatenate([np.cbrt(np.abs(np.linalg.det(s))) for s in shapes] or [np.empty(0)])
        incidence = _incidence(space, self.elements)
        # Elements by the columns that move them, and the size of the smallest element that a column moves.
        self.around: csr_array = csr_array(abs(incidence @ abs(self.moves)))
        self.around.data[:] = 1.0
        self.scale = np.full(self.columns, np.inf)
        coo = self.around.tocoo()
        np.minimum.at(self.scale, coo.coords[1], lengths[coo.coords[0]])
        self.scale[~np.isfinite(self.scale)] = 1.0
        self.extras: list[tuple[Index, Array]] = []

    def shape(self, shapes: Sequence[Array]) -> None:
        """Take other ideal elements."""
        self.inverse = [np.linalg.inv(s) for s in shapes]

    def touching(self, elements: Mask) -> Mask:
        """Open columns that move some of the elements."""
        return self.open & np.asarray(self.around.T @ elements.astype(float) > 0.0)

    def elements_of(self, columns: Mask) -> Mask:
        """Elements that some of the columns move."""
        return np.asarray(self.around @ columns.astype(float) > 0.0)

    def mask(self, elements: Index) -> Mask:
        """Truth values (e,) of some elements."""
        mask = np.zeros(self.elements, dtype=bool)
        mask[elements] = True
        return mask

    def mended(self, points: Array, step: Array, open_: Mask, seen: Index, depth: int, repairs: int) -> Array:
        """Steps of the columns after untangling what they leave invalid."""
        for _ in range(repairs):
            invalid, worst = self.check(points + self.moves @ step, seen, depth)
            if not len(invalid):
                break
            self.add(worst)
            near = open_ & self.touching(self.mask(invalid))
            moved = points + self.moves @ step
            step = step + self.minimise(moved, near, np.flatnonzero(self.elements_of(near)), 15, 3)[0]
        return step

    def advanced(self, points: Array, step: Array, seen: Index, depth: int) -> tuple[Array, int]:
        """Points moved by steps of the columns, less of them around invalid elements, and the number of those."""
        share = np.ones(self.columns)
        invalid, worst = self.check(points + self.moves @ step, seen, depth)
        self.add(worst)
        count = len(invalid)
        while len(invalid):
            back = self.touching(self.mask(invalid))
            share[back] = np.where(share[back] > 0.2, 0.5 * share[back], 0.0)
            # Elements not seen are broken from the start: they never become valid, and need not.
            near = seen[self.elements_of(back)[seen]]
            invalid, _ = self.check(points + self.moves @ (share[:, None] * step), near, depth)
        return points + self.moves @ (share[:, None] * step), count

    def grown(self, elements: Mask, rings: int) -> Mask:
        """Elements with so many rings of neighbours."""
        for _ in range(rings):
            elements = elements | self.elements_of(self.touching(elements))
        return elements

    def check(self, points: Array, elements: Index, depth: int) -> tuple[Index, tuple[Index, Array]]:
        """Elements that are not certified, and (element, xi) of points where det J is lowest in them."""
        part, numbers = self._part(points, elements)
        made = certify(part, tolerance=1e9, max_depth=depth)
        invalid = numbers[made.verdict <= 0]
        return invalid, self._worst(part, made.witnesses, numbers, made.offsets, np.flatnonzero(made.verdict == 0))

    def _worst(
        self, part: Domain, witnesses: Witnesses, numbers: Index, offsets: Index, undecided: Index
    ) -> tuple[Index, Array]:
        found = [numbers[offsets[witnesses.block] + witnesses.element]]
        xi = [witnesses.xi]
        for k in range(len(part.space.blocks)):
            mine = undecided[(undecided >= offsets[k]) & (undecided < offsets[k + 1])]
            if not len(mine):
                continue
            found.append(numbers[mine])
            xi.append(_lowest(part, k, mine - offsets[k]))
        return np.concatenate(found), np.concatenate(xi)

    def _part(self, points: Array, elements: Index) -> tuple[Domain, Index]:
        """Domain of some elements, and their numbers, blocks one after the other."""
        blocks, numbers = [], []
        for k, block in enumerate(self.domain.space.blocks):
            mine = elements[(elements >= self.offsets[k]) & (elements < self.offsets[k + 1])]
            if len(mine):
                blocks.append(_some(block, mine - self.offsets[k]))
                numbers.append(mine)
        space = replace(self.domain.space, blocks=tuple(blocks), constraint=None)
        return Domain(space, points), np.concatenate(numbers) if numbers else np.empty(0, dtype=np.int64)

    def add(self, worst: tuple[Index, Array]) -> None:
        """Remember sample points (element, xi)."""
        if len(worst[0]):
            near = np.array([self._off_apex(e, x) for e, x in zip(*worst)])
            self.extras = [*self.extras[-(_KEPT - 1) :], (worst[0], near)]

    def _off_apex(self, element: int, xi: Array) -> Array:
        block = int(np.searchsorted(self.offsets, element, side="right")) - 1
        if self.domain.space.blocks[block].basis.cell.name != "pyramid" or xi[2] < 1.0 - 1e-6:
            return xi
        return np.array([*(xi[:2] if xi[2] < 1.0 else np.zeros(2)), 1.0 - 1e-6])

    def minimise(
        self, points: Array, open_: Mask, seen: Index, iterations: int, repeats: int = 6, folds: bool = True
    ) -> tuple[Array, float]:
        """Steps of the columns (m, 3) by descent over the open ones, and the smallest det S at samples of ``seen``.

        Parameters
        ----------
        folds : whether elements may fold on the way; if not, only those are regularised that are folded at the start.
        """
        columns = np.flatnonzero(open_)
        group, groups = self._groups(columns, seen)
        batches, used = self._batches(seen, group)
        moves = csr_array(self.moves[used][:, columns])
        weights = self.domain.space.weights
        base = points[used]
        if weights is not None:
            own = weights[used][:, None]
            base, moves = np.column_stack([base * own, own]), csr_array(diags_array(own.ravel()) @ moves)
        back = csr_array(moves.T)
        values = base.copy()
        delta = np.zeros(groups)
        pull, soft = springs(self.tether, points, csr_array(self.moves[:, columns]), self.scale[columns])

        def energy(z: Array) -> tuple[float, Array]:
            step = _times(soft, z)
            values[:, :3] = base[:, :3] + moves @ step
            value, gradient, _, _ = evaluate(batches, values, delta, self.power, self.size)
            held, slope = pull(step)
            return value + held, _times(soft, back @ gradient + slope).ravel()

        def lowest(z: Array) -> Array:
            values[:, :3] = base[:, :3] + moves @ _times(soft, z)
            least = evaluate(batches, values, np.ones(groups), self.power)[3]
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
            if not (delta > 0.0).any() or not (low > before + 0.01 * np.abs(before)).any():
                break
        step = np.zeros((self.columns, 3))
        step[columns] = _times(soft, z)
        return step, float(low.min(initial=np.inf))

    def _groups(self, columns: Index, seen: Index) -> tuple[Index, int]:
        """Connected group of each element seen, joined by open columns, and how many there are."""
        part = self.around[seen][:, columns]
        label = connected_components(block_array([[None, part], [part.T, None]]), directed=False)[1][: len(seen)]
        found, group = np.unique(label, return_inverse=True)
        return group.astype(np.int64), len(found)

    def _batches(self, seen: Index, group: Index) -> tuple[list[Batch], Index]:
        space = self.domain.space
        place = np.full(self.elements, -1, dtype=np.int64)
        place[seen] = np.arange(len(seen))
        jobs: list[tuple[int, Index, Array | None]] = []
        for k, first in enumerate(self.offsets[:-1].tolist()):
            last = int(self.offsets[k + 1])
            mine = seen[(seen >= first) & (seen < last)]
            if len(mine):
                jobs.append((k, mine - first, None))
            for elements, xi in self.extras:
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
            if own_xi is None:
                table = lattice_table(basis, self.samples, rational)
            else:
                table = tables_at(basis, own_xi, rational)
            weight = np.full(len(own), 1.0 if own_xi is None else _EXTRA_WEIGHT)
            made.append(Batch(
                replace(block, dofs=number[block.dofs]), table, 4 if rational else 3,
                np.ascontiguousarray(self.inverse[k][own]), weight, group[place[self.offsets[k] + own]],
            ))
        return made, used


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
    block, values, weights = domain.space.blocks[number], domain.points, domain.space.weights
    if weights is not None:
        values = np.column_stack([values * weights[:, None], weights])
    grid = sample_points(block.basis.cell, _FINE)
    table = lattice_table(block.basis, _FINE, weights is not None)
    low = [np.empty(0, dtype=np.int64)]
    for some in np.array_split(elements, -(-len(elements) // 64)):
        net = bezier_coefficients(block, values, some).swapaxes(1, 2)
        J = (net @ table).reshape(*net.shape[:2], -1, len(grid))
        if weights is not None:
            J = (J[:, :3, 1:] - J[:, :3, :1] / J[:, 3:, :1] * J[:, 3:, 1:]) / J[:, 3:, :1]
        low.append(np.linalg.det(np.moveaxis(J, 3, 1)).argmin(axis=1))
    return grid[np.concatenate(low)]
