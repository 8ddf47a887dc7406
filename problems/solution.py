"""The result of a solve: coefficients, quantities that can be evaluated at points, and the log of how it was found.

A quantity is a function of a sample (a chunk of the domain, or located points): temperature, heat_flux, displacement,
strain, stress (6, Voigt order xx, yy, zz, yz, xz, xy), von_mises. Nothing is stored but the coefficients.

Axis letters: n function, c component, q point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from iga.assembly import matrix, vector
from iga.chunk import chunks
from iga.domain import Domain, max_degree
from iga.errors import InputError
from iga.integrands import Load, Mass
from iga.linear.solvers import solve as solve_linear
from iga.locate import locate
from iga.located import Located
from iga.norms import Errors
from iga.norms import errors as errors_of
from problems.data import Sample
from problems.formula import Formula

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Quantity:
    """Something to look at.

    Attributes
    ----------
    shape : () for a scalar, (3,) for a vector, (6,) for a Voigt tensor
    evaluate : gives the values (..., *shape) at a sample
    coefficients : (n,) or (n, c) if the quantity lies in the space
    """

    shape: tuple[int, ...]
    evaluate: Callable[[Sample], Array]
    coefficients: Array | None = None


def primary(coefficients: Array) -> Quantity:
    """Return the quantity that has these coefficients (n,) or (n, c)."""
    return Quantity(coefficients.shape[1:], lambda sample: sample.at(coefficients), coefficients)


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved problem.

    Attributes
    ----------
    domain : what it was solved on
    problem : "heat", "elasticity", ...
    coefficients : (n,) temperature or (n, 3) displacement
    quantities : by name; the first is the unknown itself
    log : functions, unknowns, assemble_s, solve_s, iterations, residual, solver, energy
    reactions : heat or force (3,) that each held boundary takes up
    norms : distance to an exact solution, where one is known
    times, history : (k,) and (k, n) of a transient solution
    """

    domain: Domain
    problem: str
    coefficients: Array
    quantities: Mapping[str, Quantity]
    log: Mapping[str, Any]
    reactions: Mapping[str, Any] = field(default_factory=dict)
    norms: Errors | None = None
    times: Array | None = None
    history: Array | None = None

    @property
    def fields(self) -> dict[str, Array]:
        """Coefficients of every quantity that lies in the space, by name."""
        return {name: q.coefficients for name, q in self.quantities.items() if q.coefficients is not None}

    @property
    def unknown(self) -> str:
        """Name of the unknown: "temperature" or "displacement"."""
        return next(iter(self.quantities))

    def quantity(self, name: str) -> Quantity:
        """Return a quantity by name, or say which exist."""
        if name not in self.quantities:
            raise InputError(f"the solution has no '{name}'; it has: {', '.join(self.quantities)}")
        return self.quantities[name]

    def probe(self, points: ArrayLike, name: str | None = None) -> Array:
        """Values at physical points (k, 3) of a quantity (the unknown by default): (k, *shape).

        Raises
        ------
        InputError
            Not three coordinates to a point, or a point lies outside the domain; it is named.
        """
        try:
            places = np.asarray(points, dtype=float).reshape(-1, 3)
        except (TypeError, ValueError):
            raise InputError("points to probe are rows of three numbers, (k, 3)") from None
        sample = located(self.domain, places)
        return self.quantity(name or self.unknown).evaluate(sample)

    def samples(self, name: str, points: int | None = None) -> Iterator[tuple[Array, Array, Array]]:
        """Walk over the quadrature points: physical points (e, q, 3), weights (e, q), values (e, q, *shape)."""
        quantity = self.quantity(name)
        for chunk in chunks(self.domain, points):
            yield chunk.x, chunk.dx, quantity.evaluate(chunk)

    def extrema(self, name: str, points: int | None = None) -> tuple[float, float]:
        """Smallest and largest value at the quadrature points; of the length, for vectors and tensors."""
        return self._extrema([name], points)[name]

    def _extrema(self, names: list[str], points: int | None = None) -> dict[str, tuple[float, float]]:
        """Extrema of several quantities in one walk."""
        bounds = dict.fromkeys(names, (np.inf, -np.inf))
        for chunk in chunks(self.domain, points):
            for name, (low, high) in bounds.items():
                quantity = self.quantity(name)
                value = quantity.evaluate(chunk)
                if quantity.shape:
                    value = np.linalg.norm(value.reshape(*value.shape[:2], -1), axis=-1)
                bounds[name] = min(low, float(value.min())), max(high, float(value.max()))
        return bounds

    def errors(
        self,
        exact: Formula | Callable[[Array], Array],
        gradient: Callable[[Array], Array] | None = None,
        points: int | None = None,
    ) -> Errors:
        """Distance of the unknown to an exact solution; a formula's gradient need not be given."""
        if gradient is None and isinstance(exact, Formula):
            gradient = exact.gradient()
        return errors_of(self.domain, self.coefficients, exact, gradient, points)

    def compared(self, exact: Formula, points: int | None = None, t: float | None = None) -> Solution:
        """Return the solution with its norms: the distance to an exact formula (at time t, by default the last)."""
        if exact.shape != self.coefficients.shape[1:]:
            raise InputError(
                f"exact solution '{exact.text}' has {len(exact.expressions)} formulas; {self.unknown} needs "
                f"{int(np.prod(self.coefficients.shape[1:], dtype=int))}"
            )
        t = t if t is not None else (0.0 if self.times is None else float(self.times[-1]))
        minimum = None if points is None else max(points, max_degree(self.domain) + 3)
        return replace(self, norms=self.errors(exact.at(t), exact.gradient().at(t), minimum))

    def summary(self) -> dict[str, Any]:
        """Return the numbers that ``iga solve --json`` prints; norms are None where no exact solution is known.

        ``h1_error`` is the L2 norm of the error's gradient and ``relative_h1_error`` divides it by that of the exact
        gradient. ``extrema`` are over the quadrature points (inside elements): of values, and of lengths for vectors.
        """
        e = self.norms
        shown = [name for name in ("temperature", "displacement", "von_mises") if name in self.quantities]
        return {
            "problem": self.problem,
            **{
                name: self.log.get(name)
                for name in ("functions", "unknowns", "assemble_s", "solve_s", "iterations", "residual")
            },
            "l2_error": e.l2 if e else None,
            "h1_error": e.h1 if e else None,
            "relative_l2_error": e.relative_l2 if e else None,
            "relative_h1_error": e.relative_h1 if e else None,
            "energy": self.log.get("energy"),
            "extrema": {name: list(bounds) for name, bounds in self._extrema(shown).items()},
            **{
                name: self.log[name]
                for name in ("solver", "preconditioner", "scheme", "steps", "eigenvalues")
                if name in self.log
            },
            "reactions": {name: np.asarray(value).tolist() for name, value in self.reactions.items()},
        }

    def error_of(self, name: str, exact: Callable[[Array], Array], points: int | None = None) -> tuple[float, float]:
        """L2 distance of any quantity to its exact value (..., *shape), and the L2 norm of the latter."""
        error = size = 0.0
        for x, dx, value in self.samples(name, points):
            expected = np.asarray(exact(x)).reshape(*dx.shape, -1)
            error += float((((value.reshape(expected.shape) - expected) ** 2).sum(axis=-1) * dx).sum())
            size += float(((expected**2).sum(axis=-1) * dx).sum())
        return float(np.sqrt(error)), float(np.sqrt(size))

    def coefficients_of(self, name: str) -> Array:
        """Coefficients (n,) or (n, c) of a quantity: its own, or those of its L2 projection into the space."""
        quantity = self.quantity(name)
        if quantity.coefficients is not None:
            return quantity.coefficients
        width = int(np.prod(quantity.shape, dtype=int))
        M = matrix(self.domain, Mass())
        columns = []
        for c in range(width):

            def load(chunk: Any, c: int = c) -> Array:
                value = quantity.evaluate(chunk).reshape(*chunk.dx.shape, width)[..., c]
                return Load(value)(chunk)

            columns.append(solve_linear(M, vector(self.domain, load, components=1), domain=self.domain)[0])
        return np.stack(columns, axis=-1).reshape(-1, *quantity.shape)

    def pictured(self) -> dict[str, Any]:
        """Return what a picture or a file of the solution shows: coefficients, or functions of samples, by name."""
        return {name: q.evaluate if q.coefficients is None else q.coefficients for name, q in self.quantities.items()}

    def plot(self, name: str | None = None, path: str | Path | None = None, **options: Any) -> NDArray[np.uint8]:
        """Draw a quantity on the solid, off screen, into a PNG file if told; options as `plot_field` has."""
        from iga.pictures.plot import plot_field  # needs a graphics library, which a solve does not

        quantity = self.quantity(name or self.unknown)
        values = quantity.evaluate if quantity.coefficients is None else quantity.coefficients
        return plot_field(self.domain, values, name or self.unknown, path, **options)


# --- located points --------------------------------------------------------------------------------------------------


def located(domain: Domain, points: Array) -> Located:
    """Find physical points (k, 3) in the domain.

    Raises
    ------
    InputError
        A point lies outside the domain; it is named.
    """
    found = locate(domain, points)
    outside = np.flatnonzero(found.element < 0)
    if len(outside):
        where = ", ".join(f"{v:g}" for v in points[outside[0]])
        raise InputError(f"point {outside[0]} at ({where}) lies outside the solid; move it inside")
    return Located(domain, found.block, found.element, found.xi)
