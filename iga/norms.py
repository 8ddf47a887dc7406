r"""Norms of fields and of their distance to an exact solution.

    L2 = (int |u|^2)^(1/2),    H1 = (int |grad u|^2)^(1/2)    (the seminorm: that is what is called H1 here)

Axis letters: e element, q point, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from iga.chunk import chunks
from iga.domain import Domain, max_degree
from iga.forms import buffers, control_points, field_at, require_regular, site
from iga.frame import Frame, frames
from iga.parallel import ranges, run

Array = NDArray[np.float64]
Function = Callable[[Array], Array]


@dataclass(frozen=True)
class Errors:
    """Norms of the error and of the exact solution; H1 is the seminorm."""

    l2: float
    h1: float
    exact_l2: float
    exact_h1: float

    @property
    def relative_l2(self) -> float:
        """L2 error divided by the L2 norm of the exact solution."""
        return self.l2 / self.exact_l2 if self.exact_l2 else self.l2

    @property
    def relative_h1(self) -> float:
        """H1 error divided by the H1 seminorm of the exact solution."""
        return self.h1 / self.exact_h1 if self.exact_h1 else self.h1


def errors(
    domain: Domain, coefficients: Array, exact: Function, gradient: Function | None = None, points: int | None = None
) -> Errors:
    """Distance of a field to an exact solution.

    Parameters
    ----------
    coefficients : (N,) or (N, c).
    exact : physical points (..., 3) -> (...) or (..., c).
    gradient : physical points (..., 3) -> (..., 3) or (..., c, 3); without it the H1 entries are NaN.
    points : Gauss points per direction, by default highest degree + 3.
    """
    points = points or max_degree(domain) + 3
    sums = np.zeros(4)
    if domain.space.blocks and all(block.basis.cell.dim == 3 for block in domain.space.blocks):
        for number, f in enumerate(frames(domain, points)):
            one = partial(_block_errors, domain, f, number, coefficients, exact, gradient)
            sums += sum(run([partial(one, *part) for part in ranges(f.block.elements)]))
        return _roots(sums, gradient)
    for chunk in chunks(domain, points):
        u = np.asarray(exact(chunk.x))
        sums[0] += _square(chunk.at(coefficients) - u, chunk.dx)
        sums[2] += _square(u, chunk.dx)
        if gradient is not None:
            du = np.asarray(gradient(chunk.x))
            sums[1] += _square(chunk.gradient(coefficients) - du, chunk.dx)
            sums[3] += _square(du, chunk.dx)
    return _roots(sums, gradient)


def _block_errors(
    domain: Domain, f: Frame, number: int, coefficients: Array, exact: Function, gradient: Function | None, begin: int,
    end: int,
) -> Array:
    """Squares of the four norms on elements begin..end of a block, by compiled interpolation."""
    sums, work, control = np.zeros(4), buffers(f), control_points(domain)
    for lo in range(begin, end, f.size):
        at = site(f, number, lo, min(lo + f.size, end), control, work)
        x = at.x.swapaxes(1, 2)
        values, slopes = field_at(coefficients, at, gradient is not None)
        u = np.asarray(exact(x))
        sums[0] += _square(values - u, at.dx)
        sums[2] += _square(np.broadcast_to(u, values.shape), at.dx)
        if gradient is not None:
            require_regular(at)
            du = np.asarray(gradient(x))
            sums[1] += _square(slopes - du, at.dx)
            sums[3] += _square(np.broadcast_to(du, slopes.shape), at.dx)
    return sums


def _roots(sums: Array, gradient: Function | None) -> Errors:
    if gradient is None:
        sums[[1, 3]] = np.nan
    l2, h1, exact_l2, exact_h1 = np.sqrt(np.maximum(sums, 0.0))
    return Errors(float(l2), float(h1), float(exact_l2), float(exact_h1))


def _square(values: Array, dx: Array) -> float:
    """Integral of the squared length."""
    squares = (values.reshape(*dx.shape, -1) ** 2).sum(axis=-1)
    return float((squares * dx).sum())
