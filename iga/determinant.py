r"""Bernstein form of the Jacobian determinant on every reference cell, as a plan of products.

The determinant of a polynomial map x = sum_b P_b B_b is the product of three polynomials, the columns of J,

    det J = det[x_r, x_s, x_t].

For a rational map x = X / w let H = (w, X) be its homogeneous form. Subtracting x times the first column shows

    det J = det[H, H_r, H_s, H_t] / w^4.

On a simplex (or a factor of a product cell) of degree n, H = sum_v lambda_v H_v with shifts H_v of degree n-1, whose
coefficients are H_v[a] = H[a + e_v], and H_{xi_v} = n (H_v - H_0). Because the determinant is alternating,

    tetrahedron   det[H, H_r, H_s, H_t] = n^3 det[H_0, H_1, H_2, H_3]
    wedge         = n^2 det[H_0, H_1, H_2, H_t]                      (shifts in the triangle)
    hexahedron    = p   det[H_0, H_1, H_s, H_t]                      (shifts in the first direction)

On the pyramid x = a(1-c), y = b(1-c), z = c the map is polynomial in (a, b, c) and x_a, x_b vanish at the apex with a
factor 1-c. That factor divides out layer by layer, since (d-k) B_k^d(c) = d (1-c) B_k^{d-1}(c) (binomials only):

    U = x_a / (1-c) = d sum_{k<d} B_k^{d-1}(c) sum_ij (P_{i+1,j,k} - P_{i,j,k}) B_i^{d-1-k}(a) B_j^{d-k}(b)

and V = x_b / (1-c) likewise. Then det J = det[U, V, x_c] (the terms a U + b V that the chain rule adds to x_c drop
out), a polynomial in (a, b, c) whose values at c = 1 are the limits of det J at the apex along all directions (a, b).

Every factor is a linear map of the control points; products are convolutions of scaled coefficients (coefficient times
multinomials), so nothing is subtracted beyond what the determinant itself subtracts. A plan holds the maps, where the
products land, and the rounding constants.

A form is a product of simplices, each with its degree: hexahedron three lines, wedge triangle and line, pyramid three
lines in (a, b, c). Axis letters: b Bernstein coefficient, k coefficient of a product, v vertex, d reference dimension.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import factorial, prod

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, bernstein, elevation
from iga.cells import CELLS, LINE
from iga.errors import InputError
from iga.kernels.jacobian import Plan

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Sizes = tuple[tuple[int, int], ...]  # (number of barycentric coordinates, degree) of each simplex factor

UNIT_ROUNDOFF = 2.0**-53


@dataclass(frozen=True, eq=False)
class Form:
    """Bernstein form on a product of simplices.

    Attributes
    ----------
    sizes : (barycentric coordinates, degree) of each simplex factor.
    exponents : (k, sum of barycentric coordinates), simplices in descending lexicographic order, first factor slowest.
    scale : (k,) products of multinomials; coefficient times scale are the scaled coefficients.
    """

    sizes: Sizes
    exponents: Index
    scale: Array

    @property
    def n(self) -> int:
        """Number of coefficients."""
        return len(self.exponents)


@cache
def form(sizes: Sizes) -> Form:
    """Form of the given sizes."""
    exponents = np.zeros((1, 0), dtype=np.int64)
    scale = np.ones(1)
    for coordinates, degree in sizes:
        parts = _compositions(degree, coordinates)
        weight = np.array([factorial(degree) // prod(map(factorial, part)) for part in parts], dtype=float)
        rows = np.array(parts, dtype=np.int64)
        exponents = np.hstack([np.repeat(exponents, len(rows), axis=0), np.tile(rows, (len(exponents), 1))])
        scale = np.outer(scale, weight).ravel()
    return Form(sizes, exponents, scale)


def _compositions(degree: int, parts: int) -> list[tuple[int, ...]]:
    if parts == 1:
        return [(degree,)]
    return [(a, *rest) for a in range(degree, -1, -1) for rest in _compositions(degree - a, parts - 1)]


def product_form(*forms: Form) -> Form:
    """Form of a product: degrees add."""
    factors = zip(*(f.sizes for f in forms))
    return form(tuple((group[0][0], sum(size[1] for size in group)) for group in factors))


def box_offsets(factor: Form, box: Form) -> Index:
    """Position of each exponent of ``factor`` in the padded box of ``box``, (k,); positions add in products."""
    position = np.zeros(factor.n, dtype=np.int64)
    column = 0
    for coordinates, degree in box.sizes:
        for c in range(1, coordinates):
            position = position * (degree + 1) + factor.exponents[:, column + c]
        column += coordinates
    return position


def box_size(box: Form) -> int:
    """Entries of the padded box: (degree + 1) per barycentric coordinate but the first of each simplex."""
    return prod((degree + 1) ** (coordinates - 1) for coordinates, degree in box.sizes)


@dataclass(frozen=True, eq=False)
class Factor:
    """One factor of the determinant: coefficients ``matrix`` (k, b) @ P in ``form``."""

    form: Form
    matrix: Array


@dataclass(frozen=True, eq=False)
class Determinant:
    """How det J (polynomial map) or its numerator (rational map) follows from control points.

    Attributes
    ----------
    factors : three (polynomial) or four (rational) factors; the determinant of their columns times ``scale``.
    weight : the weight function w as a factor, or None for polynomial maps.
    scale : constant.
    vertices : (v, d) reference cell of the form, collapsed coordinates for the pyramid.
    collapsed : whether form coordinates are the pyramid's (a, b, c).
    """

    factors: tuple[Factor, ...]
    weight: Factor | None
    scale: float
    vertices: Array
    collapsed: bool

    @property
    def form(self) -> Form:
        """Form of the result: of the product of the factors, raised to that of w^4 if there is one."""
        if self.weight is not None:
            return product_form(*(self.weight.form,) * 4)
        return product_form(*(f.form for f in self.factors))


@cache
def determinant(basis: Bernstein, rational: bool) -> Determinant:
    """Plan for maps with a Bernstein basis on a three-dimensional cell.

    Raises
    ------
    InputError : the cell is not three-dimensional, or a degree is zero.
    """
    name, degree = basis.cell.name, basis.degree
    if basis.cell.dim != 3 or min(degree) < 1:
        raise InputError(f"no volume determinant on a {name} of degree {degree}; solids need degree 1 at least")
    vertices = basis.cell.vertices
    if name == "pyramid":
        factors, weight = _pyramid(degree[0])
        cube = CELLS["hexahedron"].vertices
        if rational:
            return Determinant(factors[:4], weight, float(degree[0]), cube, True)
        return Determinant(factors[2:], None, 1.0, cube, True)
    sizes = {
        "tetrahedron": lambda: ((4, degree[0]),),
        "wedge": lambda: ((3, degree[0]), (2, degree[1])),
        "hexahedron": lambda: tuple((2, p) for p in degree),
    }[name]()
    whole = form(sizes)
    slopes = [
        _slope(whole, group, v) for group, (coordinates, _) in enumerate(sizes) for v in range(1, coordinates)
    ]
    if not rational:
        return Determinant(tuple(slopes), None, 1.0, vertices, False)
    first, n = sizes[0]
    shifts = [_shift(whole, 0, v) for v in range(first)]
    weight = Factor(whole, np.eye(whole.n))
    return Determinant((*shifts, *slopes[first - 1 :]), weight, float(n) ** (first - 1), vertices, False)


def _shift(whole: Form, group: int, v: int) -> Factor:
    """H_v of simplex factor ``group``: the coefficients at a + e_v."""
    sizes = list(whole.sizes)
    sizes[group] = (sizes[group][0], sizes[group][1] - 1)
    lower = form(tuple(sizes))
    column = sum(s[0] for s in whole.sizes[:group]) + v
    wanted = lower.exponents.copy()
    wanted[:, column] += 1
    position = {tuple(row): k for k, row in enumerate(whole.exponents.tolist())}
    matrix = np.zeros((lower.n, whole.n))
    matrix[np.arange(lower.n), [position[tuple(row)] for row in wanted.tolist()]] = 1.0
    return Factor(lower, matrix)


def _slope(whole: Form, group: int, v: int) -> Factor:
    """Derivative by the v-th coordinate of simplex factor ``group``: n (H_v - H_0)."""
    high, low = _shift(whole, group, v), _shift(whole, group, 0)
    return Factor(high.form, whole.sizes[group][1] * (high.matrix - low.matrix))


def _raise_line(p: int, q: int) -> Array:
    """Bernstein coefficients of degree p to degree q on a line, (q+1, p+1)."""
    return elevation(bernstein(LINE, p), (q,))


def _pyramid(d: int) -> tuple[tuple[Factor, ...], Factor]:
    """Factors Q0, Q1 (H = (1-c) Q0 + c Q1), U, V, H_c and the weight, as tensor forms in (a, b, c)."""
    basis = bernstein(CELLS["pyramid"], d)
    count = basis.n
    first = [int(np.flatnonzero(basis.exponents[:, 2] == k)[0]) for k in range(d + 1)]

    def layer(k: int) -> Array:
        """Selection of layer k as a tensor (i, j, b)."""
        m = d - k + 1
        select = np.zeros((m * m, count))
        select[np.arange(m * m), first[k] + np.arange(m * m)] = 1.0
        return select.reshape(m, m, count)

    def stack(layers: list[Array], da: int, db: int) -> Factor:
        """Raise each layer to (da, db) and stack along c."""
        raised = [
            np.einsum("ri,sj,ijb->rsb", _raise_line(x.shape[0] - 1, da), _raise_line(x.shape[1] - 1, db), x)
            for x in layers
        ]
        shape = form(((2, da), (2, db), (2, len(layers) - 1)))
        return Factor(shape, np.stack(raised, axis=2).reshape(shape.n, count))

    low = [layer(k) for k in range(d)]
    high = [layer(k + 1) for k in range(d)]
    up = [np.einsum("ri,sj,ijb->rsb", _raise_line(d - k - 1, d - k), _raise_line(d - k - 1, d - k), high[k])
          for k in range(d)]
    factors = (
        stack(low, d, d),
        stack(high, d - 1, d - 1),
        stack([d * (x[1:] - x[:-1]) for x in low], d - 1, d),
        stack([d * (x[:, 1:] - x[:, :-1]) for x in low], d, d - 1),
        stack([d * (u - x) for u, x in zip(up, low)], d, d),
    )
    return factors, stack([*low, layer(d)], d, d)


def splits(shape: Form, vertices: Array) -> tuple[tuple[Index, Index, Index], Index, Index]:
    """Bisections of a form's cell: along each line direction, or each edge of a simplex factor.

    Parameters
    ----------
    shape : form of the polynomial.
    vertices : (v, d) the cell's vertices, local functions of degree one in order.

    Returns
    -------
    lines : (entries, start of each line, first line of each direction). De Casteljau runs along these coefficient rows.
    pairs : (directions, 4, 2) vertex pairs whose midpoint is the new vertex, padded with -1.
    corners : (v,) coefficient at each vertex.
    """
    linear = form(tuple((coordinates, 1) for coordinates, _ in shape.sizes))
    degree = np.concatenate([np.full(c, p) for c, p in shape.sizes])
    position = {tuple(row): k for k, row in enumerate(shape.exponents.tolist())}
    corners = np.array([position[tuple(row)] for row in (linear.exponents * degree).tolist()], dtype=np.int64)
    if len(corners) != len(vertices):
        raise InputError(f"{len(vertices)} vertices for a form with {len(corners)} corners")
    entries: list[int] = []
    starts = [0]
    firsts = [0]
    pairs = []
    column = 0
    for coordinates, _ in shape.sizes:
        for i in range(column, column + coordinates):
            for j in range(i + 1, column + coordinates):
                rest = np.delete(shape.exponents, [i, j], axis=1)
                _, line = np.unique(rest, axis=0, return_inverse=True)
                order = np.lexsort((shape.exponents[:, j], line.ravel()))
                entries += order.tolist()
                starts += (starts[-1] + np.cumsum(np.bincount(line.ravel()))).tolist()
                firsts.append(len(starts) - 1)
                mine = np.flatnonzero(linear.exponents[:, i])
                moved = linear.exponents[mine].copy()
                moved[:, [i, j]] = moved[:, [j, i]]
                other = [int(np.flatnonzero((linear.exponents == row).all(axis=1))[0]) for row in moved]
                pair = np.full((4, 2), -1, dtype=np.int64)
                pair[: len(mine)] = np.column_stack([mine, other])
                pairs.append(pair)
        column += coordinates
    lines = (np.array(entries, dtype=np.int64), np.array(starts, dtype=np.int64), np.array(firsts, dtype=np.int64))
    return lines, np.stack(pairs), corners


def gamma(n: int) -> float:
    """Bound n u / (1 - n u) of the relative error of n roundings."""
    return n * UNIT_ROUNDOFF / (1.0 - n * UNIT_ROUNDOFF)


@cache
def kernel_plan(basis: Bernstein, rational: bool) -> Plan:
    """Arrays of the determinant plan for the kernels, with the rounding constants of its sums."""
    made = determinant(basis, rational)
    factors = [*made.factors, made.weight] if made.weight is not None else [*made.factors]
    final = made.form
    product = product_form(*(f.form for f in made.factors))
    last = made.factors[-2:]
    right = product_form(last[0].form, last[1].form)
    left = product_form(factors[0].form, factors[1].form) if rational else factors[0].form
    square = product_form(final, final) if made.weight is None else product_form(made.weight.form, made.weight.form)
    halves = [left, left, right, right, square] if rational else [left, right, right]
    matrices = [f.form.scale[:, None] * f.matrix for f in factors]
    counts = [int((m != 0.0).sum(axis=1).max()) for m in matrices]
    stacked = np.concatenate(matrices)
    filled = stacked != 0.0
    used = box_offsets(final, final)
    raising = form(tuple((c, p - q) for (c, p), (_, q) in zip(final.sizes, product.sizes)))

    def both(shape: Form) -> Index:
        return np.column_stack([box_offsets(shape, shape), box_offsets(shape, final)])

    def most(a: Form, b: Form, ab: Form) -> int:
        """Most pairs of coefficients that meet in one coefficient of the product."""
        meet = np.bincount((box_offsets(a, ab)[:, None] + box_offsets(b, ab)).ravel(), minlength=box_size(ab))
        return int(meet.max())

    rows = max(counts) + 2
    if rational:
        sums = 2 * max(most(factors[0].form, factors[1].form, left), most(factors[2].form, factors[3].form, right))
        sums += 6 * most(left, right, product) + most(product, raising, final)
        weight_sums = most(factors[4].form, factors[4].form, square) + most(square, square, final)
    else:
        sums = 2 * most(factors[1].form, factors[2].form, right) + 3 * most(left, right, product)
        weight_sums = 0
    _, _, corners = splits(final, made.vertices)
    boxes = [box_size(left) if rational else 0, box_size(right), box_size(square) if rational else 0, box_size(final)]
    return Plan(
        components=4 if rational else 3,
        rows=np.concatenate([[0], np.cumsum([len(m) for m in matrices])]).astype(np.int64),
        start=np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int64),
        column=np.nonzero(filled)[1].astype(np.int64),
        value=stacked[filled],
        unscale=1.0 / np.concatenate([f.form.scale for f in factors]),
        offset=np.concatenate([box_offsets(f.form, half) for f, half in zip(factors, halves)]),
        boxes=np.array(boxes, dtype=np.int64),
        left=both(left),
        right=both(right),
        square=both(square) if rational else np.zeros((0, 2), dtype=np.int64),
        first=box_offsets(factors[0].form, final),
        low=box_offsets(product, final),
        raising=box_offsets(raising, final),
        raising_value=raising.scale,
        used=used,
        factor=made.scale / final.scale,
        weight_factor=1.0 / final.scale,
        row_sum=np.array([np.abs(f.matrix).sum(axis=1).max() for f in factors]),
        scale=made.scale,
        gammas=np.array([gamma(2 * rows), gamma(sums + 4 * rows + 20), gamma(weight_sums + 4 * rows + 20)]),
        corners=corners,
    )
