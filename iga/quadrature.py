r"""Quadrature rules on every reference cell, from Gauss-Jacobi products in collapsed coordinates.

With n points per direction a rule is exact

    line, quadrilateral, hexahedron   for degree 2n-1 in each variable (family "Q")
    triangle, tetrahedron             for total degree 2n-1 (family "P")
    wedge                             for total degree 2n-1 in (x, y) times degree 2n-1 in z (family "PQ")
    pyramid                           for degree 2n-1 in each of a, b, c where x = a(1-c), y = b(1-c), z = c: all
                                      polynomials of degree 2n-1 and all products of two rational Bernstein functions
                                      of degree n-1 (family "collapsed")

Weights are positive and points are inside the cell. Axis letters: q point, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import prod

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_jacobi

from iga.cells import Cell
from iga.errors import InputError

Array = NDArray[np.float64]

FAMILIES = {
    "point": "Q", "line": "Q", "quadrilateral": "Q", "hexahedron": "Q", "triangle": "P", "tetrahedron": "P",
    "wedge": "PQ", "pyramid": "collapsed",
}

MOST = 40**3
"""Points in one element: more than degree 30, the highest of the readers, needs."""


@dataclass(frozen=True, eq=False)
class Quadrature:
    """A rule on a reference cell.

    Attributes
    ----------
    cell : reference cell.
    points, weights : (q, d) and (q,); weights sum to the cell's volume.
    n : Gauss points in each direction.
    degree : exactness in each direction (2n-1), in the sense of ``family`` (module docstring).
    factors : for line, quadrilateral and hexahedron the one-dimensional (points, weights) of each direction.
    """

    cell: Cell
    points: Array
    weights: Array
    n: tuple[int, ...]
    degree: tuple[int, ...]
    family: str
    factors: tuple[tuple[Array, Array], ...] | None


@cache
def gauss_jacobi(n: int, alpha: int) -> tuple[Array, Array]:
    """Gauss rule on [0, 1] for the weight (1-x)^alpha: points and weights, (n,) each."""
    x, w = roots_jacobi(n, float(alpha), 0.0)
    points, weights = 0.5 * (x + 1.0), w * 0.5 ** (alpha + 1)
    points.setflags(write=False)
    weights.setflags(write=False)
    return points, weights


@cache
def gauss(cell: Cell, n: int | tuple[int, ...]) -> Quadrature:
    """Rule with n Gauss points per direction (see the module docstring for what it is exact).

    Parameters
    ----------
    cell : any reference cell.
    n : one number, or one per reference direction.

    Raises
    ------
    InputError : n < 1, the wrong number of entries, or more than `MOST` points.
    """
    counts = (n,) * cell.dim if isinstance(n, int) else tuple(int(m) for m in n)
    if len(counts) != cell.dim:
        raise InputError(f"{len(counts)} numbers of Gauss points do not fit a {cell.name} of dimension {cell.dim}")
    if min(counts, default=1) < 1 or prod(counts) > MOST:
        raise InputError(
            f"{' x '.join(map(str, counts))} Gauss points in a {cell.name}: each direction needs one, "
            f"and an element takes {MOST} at most"
        )
    powers = {"triangle": (1, 0), "tetrahedron": (2, 1, 0), "wedge": (1, 0, 0), "pyramid": (0, 0, 2)}
    alphas = powers.get(cell.name, (0,) * cell.dim)
    factors = tuple(gauss_jacobi(m, a) for m, a in zip(counts, alphas))
    grids = np.meshgrid(*(f[0] for f in factors), indexing="ij")
    points = np.stack([g.ravel() for g in grids], axis=-1) if factors else np.zeros((1, 0))
    weights = np.ones(1)
    for f in factors:
        weights = np.multiply.outer(weights, f[1]).reshape(-1)
    if cell.name in ("triangle", "tetrahedron"):
        # Collapse: x1 = u1, x2 = (1-u1) u2, x3 = (1-u1)(1-u2) u3.
        rest = np.cumprod(np.column_stack([np.ones(len(points)), 1.0 - points[:, :-1]]), axis=1)
        points = points * rest
    elif cell.name == "wedge":
        points = np.column_stack([points[:, 0], (1.0 - points[:, 0]) * points[:, 1], points[:, 2]])
    elif cell.name == "pyramid":
        points = np.column_stack([points[:, :2] * (1.0 - points[:, 2:]), points[:, 2]])
    family, degree = FAMILIES[cell.name], tuple(2 * m - 1 for m in counts)
    points.setflags(write=False)
    weights.setflags(write=False)
    return Quadrature(cell, points, weights, counts, degree, family, factors if family == "Q" else None)
