"""Fields: coefficients over the functions of a space.

Geometry, temperature, displacement and conductivity are all fields. Axis letters: n function, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.chunk import Chunk
from iga.domain import Domain, Space
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Field:
    """A field u = sum_i u_i R_i with ``coefficients`` (n,) or (n, c) over the functions of ``space``."""

    space: Space
    coefficients: Array

    def __post_init__(self) -> None:
        if len(self.coefficients) != self.space.n:
            raise InputError(f"a field on {self.space.n} functions cannot have {len(self.coefficients)} coefficients")


Coefficient = float | Array | Field | Callable[[Array], Array]
"""A number, a constant array (tensor), a field, or a function of physical points (..., 3).

Where a tensor is wanted, a field has its entries row by row: 9 of a conductivity, 36 of a stiffness."""


def geometry(domain: Domain) -> Field:
    """Return the domain's map as a field with three components."""
    return Field(domain.space, domain.points)


def attribute(domain: Domain, name: str) -> Field:
    """Return an attribute of the domain as a field.

    Raises
    ------
    InputError : there is no such attribute; those that exist are listed.
    """
    if name not in domain.attributes:
        there = ", ".join(sorted(domain.attributes)) or "none"
        raise InputError(f"the domain has no attribute {name!r}; there are: {there}")
    return Field(domain.space, np.asarray(domain.attributes[name], dtype=float))


def evaluate(coefficient: Coefficient, chunk: Chunk) -> Array:
    """Values of a coefficient at the points of a chunk.

    Returns
    -------
    An array that broadcasts against (e, q, ...): numbers and constant tensors keep their shape.

    Raises
    ------
    InputError : a value is not finite; the element is named.
    """
    if isinstance(coefficient, Field):
        values = chunk.at(coefficient.coefficients)
    else:
        values = given(coefficient, chunk.x)
    require_finite(values, chunk.x, chunk.elements, chunk.block)
    return values


def given(coefficient: float | Array | Callable[[Array], Array], x: Array) -> Array:
    """Values of a number, constant array or function at points x (e, q, 3), to broadcast against (e, q, ...)."""
    if not callable(coefficient):
        return np.asarray(coefficient, dtype=float)
    values = np.asarray(coefficient(x), dtype=float)
    if values.shape[:2] != x.shape[:2] and values.shape != ():
        values = np.broadcast_to(values, (*x.shape[:2], *values.shape))
    return values


def as_tensors(values: Array, side: int) -> Array:
    """Values (e, q, side^2) of a field as matrices (e, q, side, side), those with one component as numbers (e, q)."""
    if values.ndim == 3 and values.shape[2] == 1:
        return values[:, :, 0]
    if values.ndim == 3 and values.shape[2] == side**2:
        return values.reshape(*values.shape[:2], side, side)
    return values


def require_finite(values: Array, x: Array, elements: Index, block: int) -> None:
    """Raise `InputError`, which names the place, unless values at points x (e, q, 3) of elements (e,) are finite."""
    finite = np.isfinite(values)
    if finite.all():
        return
    if values.shape[:2] != x.shape[:2]:
        raise InputError("a coefficient is not finite")
    e, q = np.argwhere(~finite)[0][:2]
    place = "({:g}, {:g}, {:g})".format(*x[e, q])
    raise InputError(f"a coefficient is not finite in element {elements[e]} of block {block} {place}")
