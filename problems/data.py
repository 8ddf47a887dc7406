"""Data of a problem: values on the domain and on its named boundaries.

A datum is a number, a tuple of numbers and formulas (one per component, None where nothing is prescribed), a
:class:`~problems.formula.Formula`, a function of points x (..., 3), or a :class:`~iga.field.Field`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from iga.domain import Domain
from iga.errors import InputError
from iga.field import Field
from problems.formula import Formula

Array: TypeAlias = NDArray[np.float64]
Function: TypeAlias = Callable[[Array], Array]
Datum: TypeAlias = "float | Array | Formula | Function | Field | Sequence[float | Formula | None]"


class Sample(Protocol):
    """Points on the domain where fields can be evaluated; a :class:`~iga.chunk.Chunk` is one."""

    @property
    def x(self) -> Array:
        """Physical points (..., 3)."""

    def at(self, coefficients: Array) -> Array:
        """Values (...) or (..., c) of a field with coefficients (n,) or (n, c)."""

    def gradient(self, coefficients: Array) -> Array:
        """Physical gradients (..., 3) or (..., c, 3)."""


def freeze(datum: Any, t: float = 0.0) -> Any:
    """Return the datum at time t in the form that integrands take: number, array, function of x, or field."""
    if isinstance(datum, Formula):
        if datum.is_constant:
            value = datum(np.zeros(3))
            return float(value) if datum.shape == () else value
        return datum.at(t)
    if isinstance(datum, tuple | list):
        parts = [freeze(0.0 if part is None else part, t) for part in datum]
        if any(isinstance(part, Field) for part in parts):
            raise InputError("single components cannot be attributes here; give one attribute with all of them")
        if not any(callable(part) for part in parts):
            return np.array(parts, dtype=float)
        return lambda x: np.stack(
            [np.broadcast_to(part(x) if callable(part) else part, np.shape(x)[:-1]) for part in parts], axis=-1
        )
    return datum


def depends_on_time(datum: Any) -> bool:
    """Whether a datum changes with t."""
    if isinstance(datum, tuple | list):
        return any(depends_on_time(part) for part in datum)
    return isinstance(datum, Formula) and datum.depends_on_time


def values(datum: Any, sample: Sample, shape: tuple[int, ...]) -> Array:
    """Return a frozen datum of the given shape at all points of a sample, (..., *shape)."""
    if isinstance(datum, Field):
        flat = datum.coefficients.reshape(len(datum.coefficients), -1)
        value = sample.at(flat)
        return value[..., 0] if shape == () else value.reshape(*value.shape[:-1], *shape)
    value = np.asarray(datum(sample.x) if callable(datum) else datum, dtype=float)
    return np.broadcast_to(value, sample.x.shape[:-1] + shape)


def resolve(domain: Domain, data: Mapping[str, Any], what: str) -> dict[str, Any]:
    """Return the datum of each boundary from data by name or shell pattern; a name given in full beats a pattern.

    Raises
    ------
    InputError
        A name or pattern matches no boundary (those that exist are listed), or two patterns claim one boundary.
    """
    found: dict[str, tuple[str, Any]] = {}
    for pattern, datum in data.items():
        matched = [name for name in domain.boundaries if name == pattern or fnmatchcase(name, pattern)]
        if not matched:
            there = ", ".join(sorted(domain.boundaries)) or "none"
            raise InputError(f"{what}: no boundary is called '{pattern}'; there are: {there}")
        for name in matched:
            if name in found and found[name][0] != name and pattern != name:
                raise InputError(f"{what}: boundary '{name}' is matched by both '{found[name][0]}' and '{pattern}'")
            if name not in found or pattern == name:
                found[name] = (pattern, datum)
    return {name: datum for name, (_, datum) in found.items()}


def exclude(first: Mapping[str, Any], second: Mapping[str, Any], names: tuple[str, str]) -> None:
    """Raise if one boundary carries two conditions that exclude each other."""
    both = sorted(set(first) & set(second))
    if both:
        raise InputError(f"boundary '{both[0]}' has both a {names[0]} and a {names[1]}; give one of them")
