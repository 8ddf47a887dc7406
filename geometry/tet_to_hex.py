r"""Exact conversion of Bezier tetrahedra to Bezier hexahedra: one matrix per degree and sub-hexahedron.

A tetrahedron of degree n with coefficients T_a, a = (a0, a1, a2, a3) barycentric exponents (a0 at the origin), becomes

    one degenerate hexahedron of degree (n, n, n)        P = M T       (Theorem 1)
    four regular hexahedra of degree (n, n, n)           P_m = M_m T   (Theorem 3), m = 0..3 the vertex they keep

**Theorem 1.** psi^-1 : x = r, y = (1-r) s, z = (1-r)(1-s) t maps the cube to the tetrahedron and turns B_a into
B_i^n(r) B_j^{n-i}(s) B_k^{n-i-j}(t), (i, j, k) = (a1, a2, a3). The rows of M raise the last two factors to degree n.
The Jacobian determinant is (1-r)^2 (1-s): face r = 1 collapses to a point, face s = 1 to a line.

**Theorem 3.** The sub-hexahedron at vertex m with the other vertices p, q, o along r, s, t has as corners the vertex m,
the midpoints of its edges, the centroids of its faces and that of the tetrahedron, so each barycentric coordinate is a
trilinear function lambda(r, s, t). Column a of M_m holds multinomial(n; a) prod_v lambda_v^{a_v} in Bernstein form.
Powers are multiplied as scaled Bernstein coefficients (coefficient times binomials) by convolution: nothing is
subtracted, entries are >= 0, every row sums to one, so applying M_m takes convex combinations.

Source: Xu, Jin, Xiao, Wu, Mourrain, Rabczuk, "Exact conversion from Bezier tetrahedra to Bezier hexahedra", 2018,
theorems 1 and 3, equations (5)-(14) with their misprints corrected (the third row of (7), the ranges of (5) and (6)).

Axis letters: e tetrahedron, m sub-hexahedron, n tetrahedral coefficient, b hexahedral coefficient, c component.
"""

from __future__ import annotations

from functools import cache, partial
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein, elevation
from iga.cells import HEXAHEDRON, LINE, TETRAHEDRON
from iga.errors import InputError
from iga.parallel import ranges, run

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: For vertex m: the vertices p, q, o that lie along r, s, t of its sub-hexahedron (positively oriented).
AXES = ((1, 2, 3), (3, 2, 0), (1, 3, 0), (2, 1, 0))

#: Tetrahedra converted by one matrix product; bounds what a thread touches at a time.
_CHUNK = 1024


def degree_of(count: int) -> int:
    """Degree n of a tetrahedron with ``count`` = (n+1)(n+2)(n+3)/6 coefficients.

    Raises
    ------
    InputError : no degree has that many coefficients.
    """
    degree = 0
    while comb(degree + 3, 3) < count:
        degree += 1
    if comb(degree + 3, 3) != count or count < 1:
        raise InputError(f"{count} coefficients per tetrahedron fit no degree (4, 10, 20, 35, ... are needed)")
    return degree


@cache
def degenerate_matrix(degree: int) -> Array:
    """Matrix M of Theorem 1, ((n+1)^3, C(n+3, 3)), for degree n >= 1."""
    n = _checked(degree)
    raised = [elevation(bernstein(LINE, low), (n,)) for low in range(n + 1)]
    matrix = np.zeros((n + 1, n + 1, n + 1, comb(n + 3, 3)))
    for column, (_, i, j, k) in enumerate(bernstein(TETRAHEDRON, n).exponents.tolist()):
        matrix[i, :, :, column] = np.outer(raised[n - i][:, j], raised[n - i - j][:, k])
    return _frozen(matrix.reshape((n + 1) ** 3, -1))


@cache
def hex_matrices(degree: int) -> Array:
    """Matrices M_m of Theorem 3, (4, (n+1)^3, C(n+3, 3)), for degree n >= 1; m is the vertex that each keeps."""
    n = _checked(degree)
    exponents = bernstein(TETRAHEDRON, n).exponents
    first = _first_matrix(n, exponents)
    place = {tuple(a): column for column, a in enumerate(exponents.tolist())}
    matrices = np.empty((4, *first.shape))
    for m, others in enumerate(AXES):
        # Relabelling (0, 1, 2, 3) -> (m, p, q, o) turns M_0 into M_m: a permutation of its columns.
        columns = [place[tuple(a)] for a in exponents[:, [m, *others]].tolist()]
        matrices[m] = first[:, columns]
    return _frozen(matrices)


def _first_matrix(n: int, exponents: Index) -> Array:
    """M_0: products of the powers of the four trilinear barycentric coordinates."""
    powers = []
    for v in range(4):
        linear = _barycentric_corners()[:, v].reshape(2, 2, 2)
        power = [np.ones((1, 1, 1))]
        for _ in range(n):
            power.append(_convolve(power[-1], linear))
        powers.append(power)
    line = np.array([comb(n, i) for i in range(n + 1)], dtype=float)
    scale = line[:, None, None] * line[:, None] * line
    # Products of the powers of coordinates 0, 1 and of 2, 3, each pair once, then one convolution per function.
    pairs = [
        {(a, b): _convolve(powers[v][a], powers[w][b]) for a in range(n + 1) for b in range(n + 1 - a)}
        for v, w in ((0, 1), (2, 3))
    ]
    matrix = np.empty(((n + 1) ** 3, len(exponents)))
    for column, (a, b, c, d) in enumerate(exponents.tolist()):
        multinomial = factorial(n) // (factorial(a) * factorial(b) * factorial(c) * factorial(d))
        product = _convolve(pairs[0][a, b], pairs[1][c, d])
        matrix[:, column] = (multinomial * product / scale).reshape(-1)
    return matrix


@cache
def _barycentric_corners() -> Array:
    """Barycentric coordinates (8, 4) of the corners of sub-hexahedron 0: 1/|S| on S = {0} and the axes in use."""
    held = np.column_stack([np.ones(8), HEXAHEDRON.vertices])
    return held / held.sum(axis=1, keepdims=True)


def _convolve(a: Array, b: Array) -> Array:
    """Product of two polynomials in scaled Bernstein form."""
    made = np.zeros(tuple(p + q - 1 for p, q in zip(a.shape, b.shape)))
    if a.size < b.size:
        a, b = b, a
    for i, j, k in np.ndindex(*b.shape):
        made[i : i + a.shape[0], j : j + a.shape[1], k : k + a.shape[2]] += b[i, j, k] * a
    return made


def tets_to_hexes(coefficients: Array, out: Array | None = None) -> Array:
    """Convert Bezier tetrahedra into four hexahedra each (Theorem 3).

    Parameters
    ----------
    coefficients : (e, C(n+3, 3), c) Bernstein coefficients, positively oriented; homogeneous ones if rational.
    out : (e, 4, (n+1)^3, c) contiguous array to write to.

    Returns
    -------
    (e, 4, (n+1)^3, c) Bernstein coefficients of the hexahedra, index (i*(n+1)+j)*(n+1)+k along r, s, t.

    Raises
    ------
    InputError : the number of coefficients fits no degree.
    """
    matrices = hex_matrices(degree_of(np.shape(coefficients)[1]))
    made = _apply(matrices.reshape(-1, matrices.shape[-1]), coefficients, out)
    return made.reshape(made.shape[0], 4, -1, made.shape[2])


def tets_to_degenerate_hexes(coefficients: Array, out: Array | None = None) -> Array:
    """Convert Bezier tetrahedra (e, C(n+3, 3), c) into one degenerate hexahedron each, (e, (n+1)^3, c) (Theorem 1)."""
    return _apply(degenerate_matrix(degree_of(np.shape(coefficients)[1])), coefficients, out)


def _apply(matrix: Array, coefficients: Array, out: Array | None) -> Array:
    """``matrix @ coefficients[e]`` for all e, in chunks that threads share (the products release the interpreter)."""
    coefficients = np.ascontiguousarray(coefficients, dtype=float)
    shape = (len(coefficients), len(matrix), coefficients.shape[2])
    made = np.empty(shape) if out is None else out.reshape(shape)

    def convert(begin: int, end: int) -> None:
        for start in range(begin * _CHUNK, min(end * _CHUNK, len(coefficients)), _CHUNK):
            part = slice(start, start + _CHUNK)
            np.matmul(matrix, coefficients[part], out=made[part])

    run([partial(convert, *part) for part in ranges(-(-len(coefficients) // _CHUNK))])
    return made


def hex_to_tet_points(points: Array) -> Array:
    """The map phi of Theorem 3: points (q, 3) of the cube to reference points (4, q, 3) in the tetrahedron."""
    values = bernstein(HEXAHEDRON, 1).tabulate(points, 0)[0] @ _barycentric_corners()
    made = np.empty((4, len(values), 4))
    for m, others in enumerate(AXES):
        made[m][:, [m, *others]] = values
    return made[..., 1:]


def degenerate_to_tet_points(points: Array) -> Array:
    """The map psi^-1 of Theorem 1: points (q, 3) of the cube to reference points (q, 3) in the tetrahedron."""
    r, s, t = np.asarray(points, dtype=float).T
    return np.column_stack([r, (1 - r) * s, (1 - r) * (1 - s) * t])


def _checked(degree: int) -> int:
    if degree < 1:
        raise InputError(f"degree {degree} cannot be converted, it must be at least 1")
    return int(degree)


def _frozen(matrix: Array) -> Array:
    matrix.setflags(write=False)
    return matrix
