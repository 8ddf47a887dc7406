r"""Distortion of the elements of a domain, as an energy of its control points with its gradient.

    E(P) = sum_e v_e mean_q (eta(J_e(xi_q) T_e^-1)^p + size g(J_e(xi_q) T_e^-1))

with the regularised mean ratio eta and the measure of size g (`iga.kernels.distortion`) at sample points xi_q of every
element, the Jacobian matrices T_e of the ideal elements and weights v_e. Gradients go back through the extraction by
its transpose, so they are exact for any domain, rational or not.

Axis letters: e element, q sample point, n function, b Bernstein function, c component, d reference dimension, s channel
(the three derivatives, for rational maps the value before them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import LocalBasis, bernstein, functions_at
from iga.block import Block, Kronecker, Patterns, bezier_coefficients
from iga.cells import HEXAHEDRON, LINE, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.domain import Domain
from iga.kernels import distortion as kernel
from iga.kernels.lattice import lattice_kernel
from iga.parallel import ranges, run

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CHUNK = 64
"""Elements worked on at a time: their derivatives fit the cache."""
_PORTION = 4096
"""Elements whose Bezier nets are held at a time."""
_SLENDER = 1e-3
"""Least side of an ideal element over its longest: collapsed edges of an element still get a regular ideal."""

_NEAR_APEX = 0.98
"""Height of the topmost sample points of a pyramid; at the apex itself its map has no Jacobian matrix."""

_IDEAL = {
    "hexahedron": np.eye(3),
    "tetrahedron": np.array([[1.0, 0.5, 0.5], [0.0, np.sqrt(0.75), np.sqrt(1.0 / 12.0)], [0.0, 0.0, np.sqrt(2 / 3)]]),
    "wedge": np.array([[1.0, 0.5, 0.0], [0.0, np.sqrt(0.75), 0.0], [0.0, 0.0, 1.0]]),
    "pyramid": np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, np.sqrt(0.5)]]),
}
"""Columns are the derivatives of the ideal cell of unit edges."""
_EDGES: dict[str, tuple[list[int], ...]] = {
    "hexahedron": tuple(
        [k for k, (a, b) in enumerate(HEXAHEDRON.edges) if HEXAHEDRON.vertices[a, d] != HEXAHEDRON.vertices[b, d]]
        for d in range(3)
    ),
    "tetrahedron": (list(range(6)),) * 3,
    "wedge": (list(range(3, 9)), list(range(3, 9)), [0, 1, 2]),
    "pyramid": (list(range(4)), list(range(4)), list(range(8))),
}
"""Edges whose mean length scales each column of the ideal cell."""


@cache
def sample_points(cell: Cell, n: int) -> Array:
    """Lattice (q, 3) with n points along each edge of a cell, boundary included (of the pyramid, the apex nearly)."""
    line = np.linspace(0.0, 1.0, n)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    if cell is TETRAHEDRON:
        grid = grid[grid.sum(axis=1) <= 1.0 + 1e-12]
    elif cell is WEDGE:
        grid = grid[grid[:, :2].sum(axis=1) <= 1.0 + 1e-12]
    elif cell is PYRAMID:
        c = _NEAR_APEX * grid[:, 2:]
        grid = np.concatenate([grid[:, :2] * (1.0 - c), c], axis=1)
    grid.setflags(write=False)
    return grid


def own_shapes(domain: Domain) -> tuple[Array, ...]:
    """Ideal elements of the domain's own edge lengths: Jacobian matrices (e, 3, 3) for each block.

    The straight, right-angled hexahedron with the mean lengths of the four edges in each direction, the regular
    tetrahedron, and what lies between them for wedge and pyramid.
    """
    made = []
    for block in domain.space.blocks:
        cell = block.basis.cell
        at = functions_at(block.basis, cell.vertices)
        corners = np.concatenate([
            bezier_coefficients(block, domain.points, slice(a, a + _PORTION))[:, at]
            for a in range(0, max(block.elements, 1), _PORTION)
        ])
        ends = corners[:, cell.edges]
        length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
        scale = np.stack([length[:, list(edges)].mean(axis=1) for edges in _EDGES[cell.name]], axis=1)
        scale = np.maximum(scale, _SLENDER * scale.max(axis=1, keepdims=True))
        made.append(_IDEAL[cell.name] * scale[:, None, :])
    return tuple(made)


@dataclass(frozen=True, eq=False)
class Lattice:
    """Lattice of sample points of tensor-product functions, for each direction.

    Attributes
    ----------
    values, slopes : (s, n, q) of the functions of each distinct operator at the points.
    """

    values: tuple[Array, ...]
    slopes: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Batch:
    """Elements of one block and their sample points.

    Attributes
    ----------
    block : the elements, with functions numbered as in the values that `evaluate` gets.
    table : (b, s q) values and derivatives of the Bernstein functions at points that all elements share, (e, b, s q) at
        points of their own, or a lattice of products.
    channels : s, 3 or 4.
    inverse : (e, 3, 3) inverse Jacobian matrices of the ideal elements.
    weight : (e,)
    group : (e,) which number of ``delta`` regularises each element.
    """

    block: Block
    table: Array | Lattice
    channels: int
    inverse: Array
    weight: Array
    group: Index


def table_at(basis: LocalBasis, points: Array, rational: bool) -> Array:
    """Table (b, s q) of a basis at shared points (q, 3)."""
    values, slopes = basis.tabulate(points, 1)
    rows = [slopes[..., d] for d in range(3)]
    return np.ascontiguousarray(np.concatenate([values, *rows] if rational else rows).T)


@cache
def lattice_table(basis: LocalBasis, n: int, rational: bool) -> Array:
    """`table_at` of the lattice with n points along each edge (`sample_points`)."""
    table = table_at(basis, sample_points(basis.cell, n), rational)
    table.setflags(write=False)
    return table


def lattice_of(block: Block, n: int) -> Lattice | None:
    """The lattice with n points along each edge as products; None where a block has not the same in each direction."""
    extraction = block.extraction
    if not isinstance(extraction, Kronecker) or len({F.shape[1:] for F in extraction.factors}) > 1:
        return None
    p = extraction.factors[0].shape[2] - 1
    values, slopes = bernstein(LINE, p).tabulate(np.linspace(0.0, 1.0, n)[:, None], 1)
    made = [[np.ascontiguousarray(F @ T.T) for F in extraction.factors] for T in (values, slopes[..., 0])]
    return Lattice(tuple(made[0]), tuple(made[1]))


def tables_at(basis: LocalBasis, points: Array, rational: bool) -> Array:
    """Tables (e, b, s) of a basis at one point (e, 3) of each element."""
    values, slopes = basis.tabulate(points, 1)
    return np.ascontiguousarray(np.concatenate([values[..., None], slopes], axis=2) if rational else slopes)


def evaluate(
    batches: Sequence[Batch], values: Array, delta: Array, power: float, size: float = 0.0
) -> tuple[float, Array, list[Array], list[Array]]:
    """Energy of batches and its gradient.

    Parameters
    ----------
    values : (n, 3) control points, or (n, 4) homogeneous ones (w x, w) of rational maps.
    delta : (g,) regularisation of each group of elements.
    power : p.
    size : factor of the measure of size.

    Returns
    -------
    energy, gradient (n, 3) by the first three columns of ``values``, and for each batch the energy and the smallest
    det S of each of its elements.
    """
    energies = [np.empty(b.block.elements) for b in batches]
    least = [np.empty(b.block.elements) for b in batches]
    parts = ranges(sum(b.block.elements for b in batches))
    gradients = [np.zeros((len(values), 3)) for _ in parts]

    def work(first: int, last: int, gradient: Array) -> None:
        start = 0
        for k, batch in enumerate(batches):
            low, high = max(first - start, 0), min(last - start, batch.block.elements)
            if isinstance(batch.table, Lattice):
                own = slice(low, max(low, high))
                _lattice(batch, batch.table, own, values, delta, power, size, gradient, energies[k][own], least[k][own])
                low = high
            for a in range(low, high, CHUNK):
                own = slice(a, min(a + CHUNK, high))
                _chunk(batch, own, values, delta, power, size, gradient, energies[k][own], least[k][own])
            start += batch.block.elements

    run([partial(work, a, b, g) for (a, b), g in zip(parts, gradients)])
    return float(sum(e.sum() for e in energies)), sum(gradients[1:], gradients[0]), energies, least


def _lattice(
    batch: Batch, lattice: Lattice, own: slice, values: Array, delta: Array, power: float, size: float, gradient: Array,
    energy: Array, least: Array,
) -> None:
    extraction = batch.block.extraction
    assert isinstance(extraction, Kronecker)
    factors = [T for pair in zip(lattice.values, lattice.slopes) for T in pair]
    lattice_kernel(*lattice.values[0].shape[1:])(
        values, batch.block.dofs[own], *factors, extraction.pattern[own], batch.inverse[own], delta[batch.group[own]],
        power, size, batch.weight[own], gradient, energy, least,
    )


def _chunk(
    batch: Batch, own: slice, values: Array, delta: Array, power: float, size: float, gradient: Array, energy: Array,
    least: Array,
) -> None:
    """Add to the gradient (n, 3) what some elements of a batch give; fill their energy (e,) and smallest det S (e,)."""
    assert isinstance(batch.table, np.ndarray)
    block, shared = batch.block, batch.table.ndim == 2
    dofs, extraction = block.dofs[own], block.extraction
    e, c, b = len(dofs), values.shape[1], block.basis.n
    net = np.empty((e, c, b))
    if extraction is None:
        kernel.collect(values, dofs, net)
    elif isinstance(extraction, Patterns):
        kernel.collect_patterns(values, dofs, extraction.C, extraction.pattern[own], net)
    else:
        kernel.collect_products(values, dofs, *_three(extraction), extraction.pattern[own], net)
    table = batch.table if shared else batch.table[own]
    J = (net.reshape(e * c, b) @ table if shared else net @ table).reshape(e, c, batch.channels, -1)
    D = np.empty_like(J)
    rational = batch.channels == 4
    if rational:
        kernel.divide(J)
    kernel.distortion(
        J, batch.channels - 3, batch.inverse[own], delta[batch.group[own]], power, size, batch.weight[own], D,
        energy, least,
    )
    if rational:
        kernel.undivide(J, D)
    back = np.swapaxes(table, -1, -2)
    slope = (D.reshape(e * c, -1) @ back if shared else D.reshape(e, c, -1) @ back).reshape(e, c, b)
    if extraction is None:
        kernel.scatter(slope, dofs, gradient)
    elif isinstance(extraction, Patterns):
        kernel.scatter_patterns(slope, dofs, extraction.C, extraction.pattern[own], gradient)
    else:
        kernel.scatter_products(slope, dofs, *_three(extraction), extraction.pattern[own], gradient)


def _three(extraction: Kronecker) -> tuple[Array, Array, Array]:
    """Factors of the three directions."""
    a, b, c = extraction.factors
    return a, b, c
