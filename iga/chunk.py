r"""Chunks: what an integrand sees of about a hundred elements at once.

At the points q of a rule on elements e of one block, with N = C B the functions and P their control points,

    x = sum_i R_i P_i,   J = dx/dxi,   dx = weight det J,   G = grad_xi R J^-1,
    R_i = w_i N_i / W, W = sum_j w_j N_j    (R = N where the space has no weights).

Quantities are computed when first asked for and live only as long as the chunk: nothing is stored for a whole mesh.
det J keeps its sign, so a folded element contributes negative volume.

Axis letters: e element of the chunk, q point, n function on the element, b Bernstein function, d reference dimension,
c component.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import LocalBasis
from iga.block import dense_extraction, to_bezier
from iga.cells import Cell
from iga.domain import Domain, Facets, facets_of
from iga.errors import InputError
from iga.quadrature import Quadrature, gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SIZE = 128
"""Elements per chunk: what fits the cache (measured three times faster than 1024)."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some elements of one block, or some facets, at the points of a rule.

    Attributes
    ----------
    domain, block, elements : where the elements are; ``elements`` is (e,).
    points, weights : (q, d) reference points in the cell and (q,) weights, of the facet for facets.
    rule : the rule that points and weights came from, on the cell or on the facet's own reference cell.
    face : local face number, or -1 inside.
    tabulated : Bernstein values and gradients at the points, if they are known already.
    """

    domain: Domain
    block: int
    elements: Index
    points: Array
    weights: Array
    rule: Quadrature | None = None
    face: int = -1
    tabulated: tuple[Array, Array] | None = None

    @property
    def basis(self) -> LocalBasis:
        """Bernstein basis of the block."""
        return self.domain.space.blocks[self.block].basis

    @property
    def n(self) -> int:
        """Functions on each element."""
        return self.domain.space.blocks[self.block].n

    @cached_property
    def dofs(self) -> Index:
        """Function numbers, (e, n)."""
        return self.domain.space.blocks[self.block].dofs[self.elements]

    @cached_property
    def table(self) -> tuple[Array, Array]:
        """Bernstein values (q, b) and gradients (q, b, d)."""
        return self.tabulated or _tabulate(self.basis, self.points)

    @cached_property
    def control(self) -> Array:
        """Bernstein coefficients of (w x, w), (e, b, 4), or of x, (e, b, 3), if there are no weights."""
        weights, local = self.domain.space.weights, self.domain.points[self.dofs]
        if weights is not None:
            own = weights[self.dofs][..., None]
            local = np.concatenate([local * own, own], axis=2)
        return to_bezier(self.domain.space.blocks[self.block], local, self.elements)

    @cached_property
    def _map(self) -> tuple[Array, Array, Array | None, Array | None]:
        """x, J, W and grad_xi W."""
        values, gradients = self.table
        e, q, d = len(self.elements), len(self.points), gradients.shape[2]
        x = values @ self.control
        flat = gradients.transpose(0, 2, 1).reshape(q * d, -1)
        slopes = (flat @ self.control).reshape(e, q, d, -1).swapaxes(2, 3)
        if self.domain.space.weights is None:
            return x, slopes, None, None
        W, dW = x[..., 3], slopes[..., 3, :]
        x = x[..., :3] / W[..., None]
        return x, (slopes[..., :3, :] - x[..., None] * dW[..., None, :]) / W[..., None, None], W, dW

    @property
    def x(self) -> Array:
        """Physical points, (e, q, 3)."""
        return self._map[0]

    @property
    def J(self) -> Array:
        """Jacobian matrices dx_c/dxi_d, (e, q, 3, d)."""
        return self._map[1]

    @cached_property
    def cofactors(self) -> Array:
        """Cofactor matrices of J, (e, q, 3, 3): det J times the inverse transposed."""
        a, b, c = self.J[..., 0], self.J[..., 1], self.J[..., 2]
        return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)

    @cached_property
    def det(self) -> Array:
        """Det J with its sign, (e, q)."""
        return np.einsum("eqc,eqc->eq", self.J[..., 0], self.cofactors[..., 0])

    @cached_property
    def inverse(self) -> Array:
        """J^-1, (e, q, d, 3).

        Raises
        ------
        InputError : det J is zero at a point of an element, which is named.
        """
        bad = np.argwhere(self.det == 0)
        if len(bad):
            where = ", ".join(f"{v:.3g}" for v in self.points[bad[0, 1]])
            raise InputError(f"element {self.elements[bad[0, 0]]} of block {self.block} is degenerate at ({where})")
        return self.cofactors.swapaxes(2, 3) / self.det[..., None, None]

    @cached_property
    def dx(self) -> Array:
        """Weights times det J in the volume, times the area element on facets, (e, q)."""
        if self.face < 0:
            return self.weights * self.det
        return self.weights * np.linalg.norm(self._area, axis=-1)

    @cached_property
    def _area(self) -> Array:
        """Outward normal times area element on a facet, (e, q, 3)."""
        if self.face < 0:
            raise InputError("normals exist on facets only")
        axes = self.basis.cell.faces[self.face].axes
        tangents = self.J @ axes
        return np.cross(tangents[..., 0], tangents[..., 1])

    @cached_property
    def normal(self) -> Array:
        """Outward unit normals on facets, (e, q, 3)."""
        return self._area / np.linalg.norm(self._area, axis=-1, keepdims=True)

    @cached_property
    def _extraction(self) -> Array | None:
        """Transposed operators C^T, (e, b, n); None for the identity."""
        C = dense_extraction(self.domain.space.blocks[self.block], self.elements)
        return None if C is None else C.swapaxes(1, 2)

    @cached_property
    def N(self) -> Array:
        """Values of the functions, (1 or e, q, n)."""
        values, C = self.table[0], self._extraction
        N = values[None] if C is None else values @ C
        weights, W = self.domain.space.weights, self._map[2]
        return N if weights is None or W is None else N * (weights[self.dofs][:, None, :] / W[..., None])

    @cached_property
    def _slopes(self) -> Array:
        """Reference gradients of the functions, (1 or e, q, n, d)."""
        gradients, C = self.table[1], self._extraction
        q, b, d = gradients.shape
        if C is None:
            dN = gradients[None]
        else:  # one product for all directions, on contiguous rows
            flat = gradients.transpose(0, 2, 1).reshape(q * d, b)
            dN = (flat @ C).reshape(len(C), q, d, -1).swapaxes(2, 3)
        weights, W, dW = self.domain.space.weights, self._map[2], self._map[3]
        if weights is None or W is None or dW is None:
            return dN
        scale = weights[self.dofs][:, None, :] / W[..., None]
        return dN * scale[..., None] - self.N[..., None] * (dW / W[..., None])[:, :, None, :]

    @cached_property
    def G(self) -> Array:
        """Physical gradients of the functions, (e, q, n, 3)."""
        return self._slopes @ self.inverse

    def at(self, coefficients: Array) -> Array:
        """Values at the points of a field with coefficients (N,) or (N, c): (e, q) or (e, q, c)."""
        values = self.table[0] @ self._bezier(coefficients)
        W = self._map[2] if self.domain.space.weights is not None else None
        if W is not None:
            values /= W[..., None]
        return values[..., 0] if coefficients.ndim == 1 else values

    def gradient(self, coefficients: Array) -> Array:
        """Physical gradients at the points: (e, q, 3), or (e, q, c, 3) with last axis the derivative."""
        values, gradients = self.table
        local = self._bezier(coefficients)
        e, q, d = len(self.elements), len(self.points), gradients.shape[2]
        flat = gradients.transpose(0, 2, 1).reshape(q * d, -1)
        slopes = (flat @ local).reshape(e, q, d, -1).swapaxes(2, 3)
        W, dW = self._map[2], self._map[3]
        if W is not None and dW is not None:
            u = (values @ local) / W[..., None]
            slopes = (slopes - u[..., None] * dW[..., None, :]) / W[..., None, None]
        slopes = slopes @ self.inverse
        return slopes[..., 0, :] if coefficients.ndim == 1 else slopes

    def _bezier(self, coefficients: Array) -> Array:
        """Bernstein coefficients (e, b, c) of a field, times the weights."""
        local = coefficients[self.dofs].reshape(*self.dofs.shape, -1)
        weights = self.domain.space.weights
        if weights is not None:
            local = local * weights[self.dofs][..., None]
        return to_bezier(self.domain.space.blocks[self.block], local, self.elements)


def default_points(domain: Domain, block: int) -> tuple[int, ...]:
    r"""Gauss points per reference direction where none are asked for.

    Degree + 1, and more where that would not integrate ``cof J grad N`` exactly, so that linear fields pass the patch
    test to round-off on every polynomial map of hexahedra, wedges and tetrahedra: on a hexahedron whose map has degree
    g <= p in a direction, that integrand has degree 2g + p - 1 there. Rational maps and pyramids get degree + 1.
    """
    basis = domain.space.blocks[block].basis
    p, cell = basis.degree, basis.cell
    if cell.name == "hexahedron":
        degrees = p if domain.space.weights is not None or max(p) < 3 else domain.map_degrees[block]
        extra = 0 if domain.space.weights is not None else 1
        return tuple(max(q + 1, extra * (g + (q + 1) // 2)) for q, g in zip(p, degrees))
    if cell.name == "wedge":
        return (max(p[0] + 1, (3 * p[0]) // 2),) * 2 + (max(p[1] + 1, (3 * p[1] + 1) // 2),)
    if cell.name == "tetrahedron":
        return (max(p[0] + 1, (3 * p[0] - 1) // 2),) * 3
    return tuple(q + 1 for q in p) if len(p) == cell.dim else (p[0] + 1,) * cell.dim


def rule_for(domain: Domain, block: int, points: int | None, face: int = -1) -> Quadrature:
    """Gauss rule of a block's cell, or of one of its faces, with ``points`` per direction or `default_points`."""
    cell = domain.space.blocks[block].basis.cell
    counts = (points,) * cell.dim if points is not None else default_points(domain, block)
    if face < 0:
        return gauss(cell, counts)
    return gauss(cell.faces[face].cell, tuple(_along(cell, face, counts)))


def _along(cell: Cell, face: int, counts: tuple[int, ...]) -> Iterator[int]:
    """Points along each axis of a face: the most of any cell direction that the axis runs in."""
    for axis in cell.faces[face].axes.T:
        yield max(count for count, step in zip(counts, axis) if step)


def _tabulate(basis: LocalBasis, points: Array) -> tuple[Array, Array]:
    values, gradients = basis.tabulate(points, 1)
    return values, gradients


def chunks(
    domain: Domain, points: int | None = None, size: int = SIZE, rules: tuple[Quadrature, ...] | None = None
) -> Iterator[Chunk]:
    """Walk over all elements.

    Parameters
    ----------
    points : Gauss points per direction, by default `default_points`.
    size : elements per chunk.
    rules : a rule for each block, in place of Gauss rules.
    """
    for number, block in enumerate(domain.space.blocks):
        rule = rules[number] if rules else rule_for(domain, number, points)
        table = _tabulate(block.basis, rule.points)
        for start in range(0, block.elements, size):
            elements = np.arange(start, min(start + size, block.elements))
            yield Chunk(domain, number, elements, rule.points, rule.weights, rule, tabulated=table)


def facet_chunks(
    domain: Domain, boundary: str | list[str] | tuple[Facets, ...], points: int | None = None, size: int = SIZE
) -> Iterator[Chunk]:
    """Walk over the facets of boundaries given by name or pattern, or as facets.

    Raises
    ------
    InputError : a name matches no boundary.
    """
    facets: tuple[Facets, ...]
    if isinstance(boundary, tuple):
        facets = boundary
    else:
        facets = facets_of(domain, boundary)
    for f in facets:
        basis = domain.space.blocks[f.block].basis
        rule = rule_for(domain, f.block, points, f.face)
        face = basis.cell.faces[f.face]
        inside = face.origin + rule.points @ face.axes.T
        table = _tabulate(basis, inside)
        for start in range(0, len(f.elements), size):
            yield Chunk(domain, f.block, f.elements[start : start + size], inside, rule.weights, rule, f.face, table)
