r"""Bernstein bases of any degree on every reference cell.

    line            B_i^p(x) = binom(p, i) x^i (1-x)^(p-i)
    simplex         multinomial(p; a) prod_v lambda_v^a_v,  a = (a_0, ..), a_0 at the origin, descending lexicographic
    quadrilateral, hexahedron   products of lines, first direction slowest
    wedge           triangle times line, triangle slowest
    pyramid         B_i^{p-k}(a) B_j^{p-k}(b) B_k^p(c) with x = a(1-c), y = b(1-c), z = c; layers k slowest

The pyramid's functions are rational in (x, y, z) (Chan and Warburton 2016): non-negative, sum to one, tensor
Bernstein of degree p on the base and triangular Bernstein of degree p on the other four faces. Its gradients have no
limit at the apex (direction dependent); values do.

Axis letters: q point, n function, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from math import comb, factorial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from iga.cells import LINE, POINT, TRIANGLE, Cell
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class LocalBasis(Protocol):
    """What the rest of the core asks of the functions on one reference cell."""

    def __hash__(self) -> int:
        """Equal bases share tables."""

    @property
    def cell(self) -> Cell:
        """The reference cell."""

    @property
    def degree(self) -> tuple[int, ...]:
        """Degree, one number per independent direction."""

    @property
    def n(self) -> int:
        """Number of functions."""

    def tabulate(self, points: Array, order: int = 1) -> tuple[Array, ...]:
        """Values (q, n), gradients (q, n, d) and second derivatives (q, n, d, d) up to ``order``."""


@dataclass(frozen=True)
class Bernstein:
    """Bernstein basis on a cell; make it with `bernstein`.

    Attributes
    ----------
    cell : reference cell.
    degree : (p,) on line, simplices and pyramid, (p, q) on quadrilateral and wedge, (p, q, r) on hexahedron.
    """

    cell: Cell
    degree: tuple[int, ...]

    @cached_property
    def exponents(self) -> Index:
        """Multi-index of each function: barycentric on simplices, (i, j, k) else, (a0, a1, a2, k) on the wedge."""
        return _exponents(self.cell.name, self.degree)

    @property
    def n(self) -> int:
        """Number of functions."""
        return len(self.exponents)

    def tabulate(self, points: Array, order: int = 1) -> tuple[Array, ...]:
        """Tabulate functions and derivatives at reference points.

        Parameters
        ----------
        points : (q, d)
        order : highest derivative, 0 to 2.

        Returns
        -------
        values (q, n), then gradients (q, n, d), then second derivatives (q, n, d, d), up to ``order``.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        name = self.cell.name
        if name == "point":
            return (np.ones((len(points), 1)), np.zeros((len(points), 1, 0)))[: order + 1]
        if name in ("triangle", "tetrahedron"):
            return _simplex(points, self.exponents, self.degree[0], order)
        if name == "wedge":
            triangle = _simplex(points[:, :2], bernstein(TRIANGLE, self.degree[0]).exponents, self.degree[0], order)
            return _product(triangle, _simplex_line(points[:, 2:], self.degree[1], order), order)
        if name == "pyramid":
            return _pyramid(points, self.exponents, self.degree[0], order)
        table = _simplex_line(points[:, :1], self.degree[0], order)
        for d in range(1, self.cell.dim):
            table = _product(table, _simplex_line(points[:, d : d + 1], self.degree[d], order), order)
        return table


_DIRECTIONS = {"quadrilateral": 2, "hexahedron": 3, "wedge": 2}


@cache
def bernstein(cell: Cell, degree: int | tuple[int, ...]) -> Bernstein:
    """Bernstein basis of a cell; an integer degree is used in every direction.

    Raises
    ------
    InputError : the degree is negative or has the wrong number of entries for the cell.
    """
    directions = _DIRECTIONS.get(cell.name, 1)
    degrees = (degree,) * directions if isinstance(degree, int) else tuple(int(p) for p in degree)
    if len(degrees) != directions or min(degrees) < 0:
        raise InputError(f"degree {degree} does not fit a {cell.name}, which takes {directions} number(s) >= 0")
    return Bernstein(cell, degrees)


@cache
def _exponents(name: str, degree: tuple[int, ...]) -> Index:
    p = degree[0]
    rows: list[tuple[int, ...]]
    if name == "point":
        rows = [()]
    elif name == "triangle":
        rows = [(a, b, p - a - b) for a in range(p, -1, -1) for b in range(p - a, -1, -1)]
    elif name == "tetrahedron":
        rows = [
            (a, b, c, p - a - b - c)
            for a in range(p, -1, -1)
            for b in range(p - a, -1, -1)
            for c in range(p - a - b, -1, -1)
        ]
    elif name == "wedge":
        rows = [(*a, k) for a in _exponents("triangle", (p,)).tolist() for k in range(degree[1] + 1)]
    elif name == "pyramid":
        rows = [(i, j, k) for k in range(p + 1) for i in range(p - k + 1) for j in range(p - k + 1)]
    else:
        rows = [tuple(index) for index in np.ndindex(*(q + 1 for q in degree))]
    made = np.array(rows, dtype=np.int64)
    made.setflags(write=False)
    return made


def _powers(x: Array, p: int) -> Array:
    """x^0 .. x^p, (q, p+1)."""
    powers = np.ones((len(x), p + 1))
    np.multiply.accumulate(np.broadcast_to(x[:, None], (len(x), p)), axis=1, out=powers[:, 1:])
    return powers


def _monomials(barycentric: Array, exponents: Index, p: int) -> Array:
    """Multinomial(p; a) prod lambda^a, (q, n); functions with a negative exponent are zero."""
    if p < 0:
        return np.zeros((len(barycentric), len(exponents)))
    values = np.empty((len(barycentric), len(exponents)))
    values[:] = [factorial(p) / np.prod([float(factorial(e)) for e in a]) if min(a) >= 0 else 0.0 for a in
                 exponents.tolist()]
    for v in range(exponents.shape[1]):
        values *= _powers(barycentric[:, v], p)[:, np.clip(exponents[:, v], 0, p)]
    return values


def _simplex(points: Array, exponents: Index, p: int, order: int) -> tuple[Array, ...]:
    """Simplex basis; d/dx_i = p (B_{a - e_i} - B_{a - e_0}) in barycentric exponents."""
    d = points.shape[1]
    barycentric = np.column_stack([1.0 - points.sum(axis=1), points])
    table = [_monomials(barycentric, exponents, p)]
    unit = np.eye(d + 1, dtype=np.int64)
    if order >= 1:
        lower = np.stack([_monomials(barycentric, exponents - unit[v], p - 1) for v in range(d + 1)], axis=-1)
        table.append(p * (lower[..., 1:] - lower[..., :1]))
    if order >= 2:
        twice = np.empty((*table[0].shape, d + 1, d + 1))
        for v in range(d + 1):
            for w in range(v, d + 1):
                twice[..., v, w] = twice[..., w, v] = _monomials(barycentric, exponents - unit[v] - unit[w], p - 2)
        slopes = twice[..., 1:, :] - twice[..., :1, :]
        table.append(p * (p - 1) * (slopes[..., 1:] - slopes[..., :1]))
    return tuple(table)


def _simplex_line(points: Array, p: int, order: int) -> tuple[Array, ...]:
    exponents = np.column_stack([np.arange(p, -1, -1), np.arange(p + 1)])
    return _simplex(points, exponents, p, order)


def _outer(a: Array, b: Array) -> Array:
    """(q, n), (q, m) -> (q, n*m)."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def _product(a: tuple[Array, ...], b: tuple[Array, ...], order: int) -> tuple[Array, ...]:
    """Table of the product basis, functions of ``a`` slowest, coordinates of ``a`` first."""
    table = [_outer(a[0], b[0])]
    if order >= 1:
        da, db = a[1].shape[-1], b[1].shape[-1]
        table.append(
            np.stack(
                [_outer(a[1][..., i], b[0]) for i in range(da)] + [_outer(a[0], b[1][..., j]) for j in range(db)],
                axis=-1,
            )
        )
    if order >= 2:
        second = np.empty((*table[0].shape, da + db, da + db))
        for i in range(da):
            for j in range(da):
                second[..., i, j] = _outer(a[2][..., i, j], b[0])
            for j in range(db):
                second[..., i, da + j] = second[..., da + j, i] = _outer(a[1][..., i], b[1][..., j])
        for i in range(db):
            for j in range(db):
                second[..., da + i, da + j] = _outer(a[0], b[2][..., i, j])
        table.append(second)
    return tuple(table)


def _pyramid(points: Array, exponents: Index, p: int, order: int) -> tuple[Array, ...]:
    """Layer k is (1-z)^(k-p)-scaled: B_i^m(a) B_j^m(b) B_k^p(c), m = p - k, a = x/(1-z), b = y/(1-z), c = z.

    With P_i = binom(m, i) x^i (1-z-x)^(m-i), which is B_i^m(a) (1-z)^m, the function is
    P_i(x, z) P_j(y, z) B_k^p(z) / (1-z)^(2m) = binom(p, k) z^k P_i P_j (1-z)^(-m): differentiate that.
    """
    x, y, z = points.T
    h = 1.0 - z
    # At the apex the values tend to delta_{k,p}; take the limit along the axis a = b = 0.
    apex = h <= 1e-14
    h = np.where(apex, 1.0, h)
    x, y = np.where(apex, 0.0, x), np.where(apex, 0.0, y)
    q, n = len(points), len(exponents)
    values = np.empty((q, n))
    gradients = np.empty((q, n, 3))
    second = np.empty((q, n, 3, 3))
    k = exponents[:, 2]
    for layer in range(p + 1):
        rows = np.flatnonzero(k == layer)
        m = p - layer
        ab = _product(
            _simplex_line((x / h)[:, None], m, 2), _simplex_line((y / h)[:, None], m, 2), 2
        )
        line = _simplex_line(z[:, None], p, 2)
        c, dc, ddc = line[0][:, layer], line[1][:, layer, 0], line[2][:, layer, 0, 0]
        f, g, s = ab
        values[:, rows] = f * c[:, None]
        if order >= 1:
            # a_x = 1/h, a_z = a/h; likewise b.
            a, b, r = x / h, y / h, 1.0 / h
            fz = (g[..., 0] * a[:, None] + g[..., 1] * b[:, None]) * r[:, None]
            gradients[:, rows, 0] = g[..., 0] * (c * r)[:, None]
            gradients[:, rows, 1] = g[..., 1] * (c * r)[:, None]
            gradients[:, rows, 2] = fz * c[:, None] + f * dc[:, None]
        if order >= 2:
            r2 = (r * r)[:, None]
            a1, b1, r1, c1 = a[:, None], b[:, None], r[:, None], c[:, None]
            second[:, rows, 0, 0] = s[..., 0, 0] * r2 * c1
            second[:, rows, 1, 1] = s[..., 1, 1] * r2 * c1
            second[:, rows, 0, 1] = second[:, rows, 1, 0] = s[..., 0, 1] * r2 * c1
            for t, (own, other) in enumerate(((0, 1), (1, 0))):
                ua, ub = (a1, b1) if t == 0 else (b1, a1)
                mixed = (s[..., own, own] * ua + s[..., own, other] * ub + g[..., own]) * r2
                second[:, rows, t, 2] = second[:, rows, 2, t] = mixed * c1 + g[..., own] * r1 * dc[:, None]
            fzz = (
                s[..., 0, 0] * a1 * a1 + 2 * s[..., 0, 1] * a1 * b1 + s[..., 1, 1] * b1 * b1
                + 2 * (g[..., 0] * a1 + g[..., 1] * b1)
            ) * r2
            second[:, rows, 2, 2] = fzz * c1 + 2 * fz * dc[:, None] + f * ddc[:, None]
    values[apex] = (k == p).astype(float)
    return (values, gradients, second)[: order + 1]


def greville(basis: LocalBasis) -> Array:
    """Domain point of each function, (n, d): where its coefficient sits for the identity map."""
    name, p = basis.cell.name, basis.degree
    e = bernstein(basis.cell, p).exponents.astype(float)
    if name in ("triangle", "tetrahedron"):
        return e[:, 1:] / max(p[0], 1) if p[0] else np.full((1, basis.cell.dim), 1.0 / (basis.cell.dim + 1))
    if name == "wedge":
        plane = e[:, 1:3] / p[0] if p[0] else np.full((len(e), 2), 1.0 / 3.0)
        return np.column_stack([plane, e[:, 3] / p[1] if p[1] else np.full(len(e), 0.5)])
    if name == "pyramid":
        m = np.maximum(p[0] - e[:, 2], 1.0)
        c = e[:, 2] / max(p[0], 1)
        return np.column_stack([e[:, 0] / m * (1 - c), e[:, 1] / m * (1 - c), c])
    return np.where(np.array(p) > 0, e / np.maximum(p, 1), 0.5)


def functions_at(basis: LocalBasis, points: Array) -> Index:
    """Number of the function whose domain point is nearest to each reference point (m, d): (m,).

    At ``basis.cell.vertices`` these are the functions that are one at the vertices.
    """
    return np.abs(greville(basis)[None] - points[:, None]).max(axis=-1).argmin(axis=1)


@cache
def face_functions(basis: Bernstein, face: int) -> tuple[Bernstein, Index]:
    """Functions that do not vanish on a face.

    Returns
    -------
    The basis of the face, and (m,) local function numbers: entry l restricts to function l of the face basis.
    """
    cell, f = basis.cell, basis.cell.faces[face]
    p = basis.degree
    if f.cell in (POINT, TRIANGLE) or cell.name in ("triangle", "tetrahedron", "pyramid"):
        degree: tuple[int, ...] = (p[0],) * _DIRECTIONS.get(f.cell.name, 1)
    elif f.cell is LINE:
        degree = (p[int(np.argmax(np.abs(f.axes[:, 0])))],)
    elif cell.name == "wedge":
        degree = tuple(p[1] if f.axes[2, s] else p[0] for s in range(2))
    else:
        degree = tuple(p[int(np.argmax(np.abs(f.axes[:, s])))] for s in range(2))
    trace = bernstein(f.cell, degree)
    # Domain points of the face's functions, mapped into the cell, are domain points of the cell's functions.
    wanted = f.origin + greville(trace) @ f.axes.T
    distance = np.abs(greville(basis)[None] - wanted[:, None]).max(axis=-1)
    functions = distance.argmin(axis=1)
    if distance.min(axis=1).max() > 1e-9:
        raise InputError(f"degree {p} of a {cell.name} gives no basis on face {face}")
    functions.setflags(write=False)
    return trace, functions


def lagrange_to_bernstein(basis: LocalBasis, points: Array) -> Array:
    """Matrix from values at n unisolvent points (n, d) to Bernstein coefficients, (n, n).

    Raises
    ------
    InputError : the points do not determine the coefficients.
    """
    values = basis.tabulate(points, 0)[0]
    if values.shape[0] != values.shape[1] or np.linalg.cond(values) > 1e12:
        raise InputError(f"{len(points)} points do not determine the {basis.n} coefficients on a {basis.cell.name}")
    return np.asarray(np.linalg.inv(values), dtype=np.float64)


@cache
def elevation(basis: Bernstein, degree: tuple[int, ...]) -> Array:
    """Matrix (m, n) from coefficients to coefficients of the same function in a higher degree.

    Raises
    ------
    InputError : a degree would fall.
    """
    target = bernstein(basis.cell, degree)
    if any(new < old for new, old in zip(target.degree, basis.degree)):
        raise InputError(f"degree {basis.degree} cannot be elevated to {target.degree}")
    name = basis.cell.name
    if name in ("triangle", "tetrahedron"):
        return _elevate_simplex(basis.exponents, target.exponents, basis.degree[0], target.degree[0])
    if name == "wedge":
        plane = elevation(bernstein(TRIANGLE, basis.degree[0]), (target.degree[0],))
        line = elevation(bernstein(LINE, basis.degree[1]), (target.degree[1],))
        return np.asarray(np.kron(plane, line), dtype=np.float64)
    if name == "pyramid":
        return _elevate_pyramid(basis, target)
    matrix = np.ones((1, 1))
    for old, new in zip(basis.degree, target.degree):
        i, j = np.arange(old + 1), np.arange(new + 1)
        line = _elevate_simplex(np.column_stack([old - i, i]), np.column_stack([new - j, j]), old, new)
        matrix = np.asarray(np.kron(matrix, line), dtype=np.float64)
    return matrix


def _elevate_simplex(old: Index, new: Index, p: int, q: int) -> Array:
    """B_a^p = sum_b prod_v binom(b_v, a_v) / binom(q, p) B_b^q."""
    matrix = np.ones((len(new), len(old)))
    for v in range(old.shape[1]):
        table = np.array([[comb(b, a) for a in range(p + 1)] for b in range(q + 1)], dtype=float)
        matrix *= table[new[:, v][:, None], old[:, v][None, :]]
    return np.asarray(matrix / comb(q, p))


def _elevate_pyramid(basis: Bernstein, target: Bernstein) -> Array:
    """Rational pyramid: multiply by 1 = c + (1-c), each layer's (a, b) part raised by one where needed."""
    if basis.degree == target.degree:
        return np.eye(basis.n)
    p = basis.degree[0]
    step = bernstein(basis.cell, p + 1)
    index = {tuple(e): r for r, e in enumerate(step.exponents.tolist())}
    matrix = np.zeros((step.n, basis.n))
    for column, (i, j, k) in enumerate(basis.exponents.tolist()):
        # B_k^p(c) = (p+1-k)/(p+1) B_k^{p+1} + (k+1)/(p+1) B_{k+1}^{p+1}; the first keeps m+1, the second keeps m = p-k.
        matrix[index[i, j, k + 1], column] += (k + 1) / (p + 1)
        m = p - k
        for di in (0, 1):
            for dj in (0, 1):
                wi = (i + 1) / (m + 1) if di else (m + 1 - i) / (m + 1)
                wj = (j + 1) / (m + 1) if dj else (m + 1 - j) / (m + 1)
                matrix[index[i + di, j + dj, k], column] += wi * wj * (p + 1 - k) / (p + 1)
    return elevation(step, target.degree) @ matrix
