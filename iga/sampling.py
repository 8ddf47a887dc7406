"""Exact values of geometry and fields at chosen reference points of many elements, and subdivisions of cells.

A field on an element is ``u = sum_b w_b u_b B_b / sum_b w_b B_b`` with its Bernstein coefficients u_b and weights w_b
(all one where the space has none), so sampling is one matrix product per block.

Axis letters: m sampled element, q point, b Bernstein function, c component, d reference dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.block import Block, bezier_coefficients
from iga.cells import Cell
from iga.domain import Domain, Space, homogeneous
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PORTION = 1 << 18
"""Points evaluated at once."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Reference points of some elements of one block; offers the names a `Chunk` offers for the same things.

    Attributes
    ----------
    domain : what is sampled.
    block : block number.
    elements : (m,) element numbers in the block.
    points : (q, 3) reference points.
    """

    domain: Domain
    block: int
    elements: Index
    points: Array

    @cached_property
    def x(self) -> Array:
        """Places (m, q, 3)."""
        return self.at(self.domain.points)

    @cached_property
    def J(self) -> Array:
        """Jacobian dx_i/dxi_j (m, q, 3, 3)."""
        return self.reference_gradient(self.domain.points)

    def at(self, coefficients: Array, space: Space | None = None) -> Array:
        """Values of a field with coefficients (n,) or (n, c): (m, q) or (m, q, c)."""
        space = space or self.domain.space
        values, weights = weighted_coefficients(space, self.block, coefficients, self.elements)
        B = space.blocks[self.block].basis.tabulate(self.points, 0)[0]
        found = B @ values
        if weights is not None:
            found /= (weights @ B.T)[..., None]
        return found[..., 0] if coefficients.ndim == 1 else found

    def gradient(self, coefficients: Array, space: Space | None = None) -> Array:
        """Physical gradients (m, q, 3) or (m, q, c, 3), last axis the direction.

        Where the geometry is degenerate (a collapsed edge, a pyramid's apex) the result is not finite.
        """
        local = self.reference_gradient(coefficients, space)
        determinant = np.linalg.det(self.J)
        J = np.where(determinant[..., None, None] == 0.0, np.eye(3), self.J)
        found = local @ np.linalg.inv(J)
        found[determinant == 0.0] = np.nan
        return found[..., 0, :] if coefficients.ndim == 1 else found

    def reference_gradient(self, coefficients: Array, space: Space | None = None) -> Array:
        """Gradients (m, q, c, 3) with respect to reference coordinates."""
        space = space or self.domain.space
        values, weights = weighted_coefficients(space, self.block, coefficients, self.elements)
        B, dB = space.blocks[self.block].basis.tabulate(self.points, 1)
        q, b, d = dB.shape
        slopes = (dB.transpose(0, 2, 1).reshape(q * d, b) @ values).reshape(len(values), q, d, -1)
        if weights is not None:
            W = (weights @ B.T)[..., None]
            dW = (weights @ dB.transpose(1, 0, 2).reshape(b, q * d)).reshape(len(values), q, d)
            u = (B @ values) / W
            slopes = (slopes - dW[..., None] * u[:, :, None, :]) / W[..., None]
        return np.swapaxes(slopes, 2, 3)


Quantity = Array | Callable[[Samples], Array]


def bounding_box(domain: Domain) -> Array:
    """Lowest and highest coordinates (2, 3) of the vertices of all elements; control points may lie far outside."""
    found = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    for number, block in enumerate(domain.space.blocks):
        for start in range(0, block.elements, PORTION):
            elements = np.arange(start, min(start + PORTION, block.elements))
            x = Samples(domain, number, elements, block.basis.cell.vertices).x.reshape(-1, 3)
            found = np.array([np.minimum(found[0], x.min(axis=0)), np.maximum(found[1], x.max(axis=0))])
    return found


def weighted_coefficients(
    space: Space, block: int, coefficients: Array, elements: Index | slice = slice(None)
) -> tuple[Array, Array | None]:
    """Bernstein coefficients of a field times weights (m, b, c), and the weights (m, b) or None where they are one.

    Raises
    ------
    InputError : the field has not one coefficient for each function.
    """
    if len(coefficients) != space.n:
        raise InputError(f"a field has {len(coefficients)} coefficients for {space.n} functions")
    flat = coefficients.reshape(space.n, -1)
    own: Block = space.blocks[block]
    if space.weights is None:
        return bezier_coefficients(own, flat, elements), None
    both = bezier_coefficients(own, homogeneous(space, flat), elements)
    return both[..., :-1], both[..., -1]


def evaluate(quantity: Quantity, space: Space, samples: Samples) -> Array:
    """Values (m, q, c) of a field given by coefficients, or of a function of `Samples`; a scalar has c = 1.

    Raises
    ------
    InputError : the function does not return one value for each element and point.
    """
    if isinstance(quantity, np.ndarray):
        return samples.at(quantity.reshape(len(quantity), -1), space)
    shape = (len(samples.elements), len(samples.points))
    values = np.asarray(quantity(samples), dtype=float)
    if values.shape[:2] != shape:
        raise InputError(f"a function of samples returned an array {values.shape}; it must begin with {shape}")
    return values.reshape(*shape, -1)


def evaluate_block(quantity: Quantity, space: Space, domain: Domain, block: int, points: Array) -> Array:
    """Values (e, q, c) on all elements of a block, found in portions that bound the memory in use."""
    elements = np.arange(domain.space.blocks[block].elements)
    step = max(1, PORTION // len(points))
    portions = [elements[start : start + step] for start in range(0, max(len(elements), 1), step)]
    return np.concatenate([evaluate(quantity, space, Samples(domain, block, own, points)) for own in portions])


def named_quantities(domain: Domain, fields: Mapping[str, Any]) -> dict[str, tuple[Quantity, Space]]:
    """Fields by name as (coefficients or function, space).

    Parameters
    ----------
    fields : coefficients (n,) or (n, c), anything with ``coefficients`` and ``space``, or a function of `Samples`.

    Raises
    ------
    InputError : a field that is none of these, does not fit its space, or is not finite.
    """
    found: dict[str, tuple[Quantity, Space]] = {}
    for name, field in fields.items():
        space = getattr(field, "space", domain.space)
        quantity = getattr(field, "coefficients", field)
        if callable(quantity):
            found[name] = quantity, domain.space
            continue
        quantity = np.asarray(quantity, dtype=float)
        if quantity.ndim not in (1, 2) or len(quantity) != space.n:
            raise InputError(f"field {name!r} has shape {quantity.shape}; its space has {space.n} functions")
        if not np.isfinite(quantity).all():
            raise InputError(f"field {name!r} is not finite at function {np.argwhere(~np.isfinite(quantity))[0][0]}")
        if [b.elements for b in space.blocks] != [b.elements for b in domain.space.blocks]:
            raise InputError(f"field {name!r} lives on other elements than the domain")
        found[name] = quantity, space
    return found


@cache
def subdivision(cell: Cell, n: int) -> tuple[Array, Index]:
    """Cut a cell into straight cells of its own kind, n along each edge.

    A pyramid is cut in its collapsed coordinates (a, b, c): hexahedra, and pyramids in the layer at the apex.

    Returns
    -------
    Points (q, d) and corners (k, v) of the sub-cells in the cell's own vertex order; for a pyramid (k, 8) corners of
    hexahedra, those at the apex with four equal ones.
    """
    if cell.name in ("line", "quadrilateral", "hexahedron", "pyramid"):
        return _grid(cell, n)
    if cell.name == "wedge":
        flat, triangles = _simplex(2, n)
        q = np.arange(n + 1)
        points = np.column_stack([np.repeat(flat, n + 1, axis=0), np.tile(q / n, len(flat))])
        low = (triangles[:, None, :] * (n + 1) + q[:-1, None]).reshape(-1, 3)
        return points, np.stack([low, low + 1], axis=-1).reshape(-1, 6)
    return _simplex(cell.dim, n)


def _grid(cell: Cell, n: int) -> tuple[Array, Index]:
    """`subdivision` of a line, quadrilateral, hexahedron or pyramid."""
    d = cell.dim
    number = np.arange((n + 1) ** d).reshape((n + 1,) * d)
    points = np.stack(np.meshgrid(*[np.arange(n + 1) / n] * d, indexing="ij"), axis=-1).reshape(-1, d)
    corners = [number[tuple(slice(s, n + s) for s in shift)].ravel() for shift in np.ndindex(*(2,) * d)]
    cells = np.stack(corners, axis=-1)
    if cell.name == "pyramid":
        c = points[:, 2:]
        points = np.column_stack([points[:, :2] * (1.0 - c), c])
    return points, cells


def _simplex(d: int, n: int) -> tuple[Array, Index]:
    """Freudenthal's subdivision of the ordered simplex n >= t_1 >= .. >= t_d >= 0, mapped to the reference simplex."""
    corners = np.stack(np.meshgrid(*[np.arange(n)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    chains = []
    for order in permutations(range(d)):
        steps = np.zeros((d + 1, d), dtype=np.int64)
        for k, axis in enumerate(order):
            steps[k + 1 :, axis] += 1
        chains.append(corners[:, None, :] + steps)
    ordered = np.concatenate(chains)
    ordered = ordered[(np.diff(ordered, axis=-1) <= 0).all(axis=(1, 2))]
    lattice, cells = np.unique(ordered.reshape(-1, d), axis=0, return_inverse=True)
    cells = cells.reshape(-1, d + 1)
    points = -np.diff(np.column_stack([lattice, np.zeros(len(lattice))]), axis=1) / n
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    mirrored = np.linalg.det(edges) < 0
    cells[mirrored, -2:] = cells[mirrored, -2:][:, ::-1]
    return points, cells
