"""Conversion of Bezier tetrahedra to hexahedra: the numbers of the paper and its identities."""

from __future__ import annotations

import time
from fractions import Fraction
from itertools import permutations
from math import comb, factorial

import numpy as np
import pytest

from geometry.tet_to_hex import (
    AXES,
    degenerate_matrix,
    degenerate_to_tet_points,
    degree_of,
    hex_matrices,
    hex_to_tet_points,
    tets_to_degenerate_hexes,
    tets_to_hexes,
)
from iga.bernstein import bernstein, elevation, greville
from iga.cells import HEXAHEDRON, LINE, TETRAHEDRON
from iga.errors import InputError
from iga.quadrature import gauss

DEGREES = range(1, 9)


def tet_exponents(n: int) -> list[tuple[int, ...]]:
    return [tuple(a) for a in bernstein(TETRAHEDRON, n).exponents.tolist()]


@pytest.mark.parametrize(
    ("degree", "nonzeros", "squares"),
    [(1, 20, 3.75), (2, 144, 7.399594907407), (3, 631, 11.805852184203), (4, 2058, 16.863075564630)],
)
def test_matrices_have_the_published_numbers(degree, nonzeros, squares):
    for matrix in hex_matrices(degree):
        assert matrix.shape == ((degree + 1) ** 3, comb(degree + 3, 3))
        assert np.count_nonzero(matrix) == nonzeros
        assert (matrix**2).sum() == pytest.approx(squares, abs=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_matrices_take_convex_combinations(degree):
    for matrix in (*hex_matrices(degree), degenerate_matrix(degree)):
        assert matrix.min() >= 0
        assert np.abs(matrix.sum(axis=1) - 1).max() < 1e-15


def test_rows_of_the_quadratic_matrix():
    rows = hex_matrices(2)[0].reshape(3, 3, 3, 10)
    place = {a: k for k, a in enumerate(tet_exponents(2))}
    middle, end = rows[1, 1, 1], rows[2, 2, 2]
    assert middle[place[2, 0, 0, 0]] == pytest.approx(3 / 16, abs=1e-16)
    for v in range(1, 4):
        mixed = tuple(int(w in (0, v)) for w in range(4))
        pure = tuple(2 * int(w == v) for w in range(4))
        assert middle[place[mixed]] == pytest.approx(3 / 16, abs=1e-16)
        assert middle[place[pure]] == 0
    for v, w in ((1, 2), (1, 3), (2, 3)):
        assert middle[place[tuple(int(x in (v, w)) for x in range(4))]] == pytest.approx(1 / 12, abs=1e-16)
    for a, k in place.items():
        assert end[k] == pytest.approx(1 / 16 if max(a) == 2 else 1 / 8, abs=1e-16)


def rational_hex_matrix(n: int, m: int) -> dict[tuple[int, ...], dict[tuple[int, int, int], Fraction]]:
    """M_m in exact arithmetic: polynomials as dictionaries of scaled Bernstein coefficients."""

    def multiply(p, q):
        made: dict[tuple[int, int, int], Fraction] = {}
        for a, x in p.items():
            for b, y in q.items():
                key = (a[0] + b[0], a[1] + b[1], a[2] + b[2])
                made[key] = made.get(key, Fraction(0)) + x * y
        return made

    coordinates = []
    for v in range(4):
        linear = {}
        for corner in np.ndindex(2, 2, 2):
            on = {m} | {axis for axis, used in zip(AXES[m], corner) if used}
            linear[corner] = Fraction(int(v in on), len(on))
        coordinates.append(linear)
    columns = {}
    for a in tet_exponents(n):
        product = {(0, 0, 0): Fraction(factorial(n))}
        for v in range(4):
            for _ in range(a[v]):
                product = multiply(product, coordinates[v])
        scale = np.prod([factorial(x) for x in a])
        columns[a] = {k: x / int(scale) / (comb(n, k[0]) * comb(n, k[1]) * comb(n, k[2])) for k, x in product.items()}
    return columns


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("m", range(4))
def test_matrix_equals_exact_rationals(degree, m):
    matrix = hex_matrices(degree)[m].reshape(*(degree + 1,) * 3, -1)
    for column, entries in enumerate(rational_hex_matrix(degree, m).values()):
        for place, value in entries.items():
            got = Fraction(float(matrix[(*place, column)]))
            assert abs(got - value) <= value * Fraction(1, 10**15)


def literal_hex(n: int, m: int, coefficients: np.ndarray) -> np.ndarray:
    """Equations (12) and (13) as printed, with the constraints x1+x2=j and y1+z1+y2+z2=k put back."""
    exponents = tet_exponents(n)
    corners = {}
    for number, (r, s, t) in enumerate(
        [(1, 0, 1), (1, 0, 0), (1, 1, 1), (1, 1, 0), (0, 0, 1), (0, 0, 0), (0, 1, 1), (0, 1, 0)], start=1
    ):
        on = {m} | {axis for axis, used in zip(AXES[m], (r, s, t)) if used}
        corners[number] = np.array([float(v in on) / len(on) for v in range(4)])

    def polar(multiplicities: dict[int, int]) -> np.ndarray:
        values = {a: coefficients[k] for k, a in enumerate(exponents)}
        degree = n
        for number, times in multiplicities.items():
            for _ in range(times):
                degree -= 1
                values = {
                    a: sum(
                        corners[number][v] * values[tuple(x + (w == v) for w, x in enumerate(a))] for v in range(4)
                    )
                    for a in tet_exponents(degree)
                }
        return values[0, 0, 0, 0]

    made = np.zeros((n + 1, n + 1, n + 1, coefficients.shape[1]))
    for i, j in np.ndindex(n + 1, n + 1):
        for x1 in range(max(0, j - n + i), min(i, j) + 1):
            x2 = j - x1
            for y1, z1, y2, z2 in np.ndindex(x1 + 1, i - x1 + 1, x2 + 1, n - i - x2 + 1):
                k = y1 + z1 + y2 + z2
                weight = comb(i, x1) * comb(n - i, x2) / comb(n, j)
                weight *= comb(x1, y1) * comb(i - x1, z1) * comb(x2, y2) * comb(n - i - x2, z2) / comb(n, k)
                made[i, j, k] += weight * polar(
                    {3: y1, 4: x1 - y1, 1: z1, 2: i - x1 - z1, 7: y2, 8: x2 - y2, 5: z2, 6: n - i - x2 - z2}
                )
    return made.reshape(-1, coefficients.shape[1])


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_matrix_equals_the_literal_sums(degree):
    T = np.random.default_rng(17).standard_normal((1, comb(degree + 3, 3), 2))
    for m in range(4):
        assert np.abs(literal_hex(degree, m, T[0]) - tets_to_hexes(T)[0, m]).max() < 1e-14


@pytest.mark.parametrize("degree", DEGREES)
def test_hexes_are_the_tetrahedron(degree):
    random = np.random.default_rng(31 + degree)
    T = random.standard_normal((2, comb(degree + 3, 3), 3))
    points = random.random((10_000, 3))
    values = bernstein(HEXAHEDRON, degree).tabulate(points, 0)[0]
    tet = bernstein(TETRAHEDRON, degree)
    scale = np.abs(T).max()
    hexes = tets_to_hexes(T)
    for m, where in enumerate(hex_to_tet_points(points)):
        assert np.abs(values @ hexes[:, m] - tet.tabulate(where, 0)[0] @ T).max() < 1e-14 * scale
    single = tets_to_degenerate_hexes(T)
    exact = tet.tabulate(degenerate_to_tet_points(points), 0)[0] @ T
    assert np.abs(values @ single - exact).max() < 1e-14 * scale


@pytest.mark.parametrize("degree", range(1, 6))
def test_theorem_one_by_single_elevation_steps(degree):
    """Equations (5) and (6) with 'elevate from degree n-i-j to n' and 'from n-i to n', one corrected step at a time."""

    def step(m: int) -> np.ndarray:
        matrix = np.zeros((m + 2, m + 1))
        for q in range(m + 2):
            if q > 0:
                matrix[q, q - 1] = q / (m + 1)
            if q <= m:
                matrix[q, q] = 1 - q / (m + 1)
        return matrix

    n = degree
    T = np.random.default_rng(43).standard_normal((len(tet_exponents(n)),))
    by_index = {a[1:]: T[k] for k, a in enumerate(tet_exponents(n))}
    P = np.zeros((n + 1, n + 1, n + 1))
    for i in range(n + 1):
        Q = np.zeros((n - i + 1, n + 1))
        for j in range(n - i + 1):
            column = np.array([by_index[i, j, k] for k in range(n - i - j + 1)])
            for m in range(n - i - j, n):
                column = step(m) @ column
            Q[j] = column
        for m in range(n - i, n):
            Q = step(m) @ Q
        P[i] = Q
    assert np.abs(P.reshape(-1) - degenerate_matrix(n) @ T).max() < 1e-14
    made = np.eye(1)
    for m in range(n):
        made = step(m) @ made
    assert np.allclose(made, elevation(bernstein(LINE, 0), (n,)), atol=1e-15)


def test_degenerate_hex_collapses_one_face_to_a_point_and_one_to_a_line():
    T = np.random.default_rng(5).standard_normal((1, 20, 3))
    P = tets_to_degenerate_hexes(T).reshape(4, 4, 4, 3)
    assert np.ptp(P[3].reshape(-1, 3), axis=0).max() == 0
    assert np.ptp(P[:, 3], axis=1).max() < 1e-15
    assert np.ptp(P[:3, :3], axis=2).max() > 0.1


def test_volumes_add_up():
    random = np.random.default_rng(7)
    for n in range(1, 6):
        T = greville(bernstein(TETRAHEDRON, n))[None] + 0.05 / n * random.standard_normal((1, comb(n + 3, 3), 3))
        rule = gauss(TETRAHEDRON, (3 * n) // 2 + 1)
        tet = np.linalg.det(np.einsum("qbd,ebc->eqcd", bernstein(TETRAHEDRON, n).tabulate(rule.points)[1], T))
        rule6 = gauss(HEXAHEDRON, (3 * n + 1) // 2 + 1)
        slopes = bernstein(HEXAHEDRON, n).tabulate(rule6.points)[1]
        hexes = np.linalg.det(np.einsum("qbd,ebc->eqcd", slopes, tets_to_hexes(T)[0]))
        single = np.linalg.det(np.einsum("qbd,ebc->eqcd", slopes, tets_to_degenerate_hexes(T)))
        volume = float(tet[0] @ rule.weights)
        assert (hexes @ rule6.weights).sum() == pytest.approx(volume, rel=1e-13)
        assert float(single[0] @ rule6.weights) == pytest.approx(volume, rel=1e-13)


def test_jacobian_of_the_map_is_bounded_away_from_zero():
    """27 Bernstein coefficients of det d(phi) in [1/108, 1/8]; corner values 1/8, 1/18, 1/48, 1/108."""
    lattice = greville(bernstein(HEXAHEDRON, 2))
    slopes = bernstein(HEXAHEDRON, 1).tabulate(lattice, 1)[1]
    corners = hex_to_tet_points(HEXAHEDRON.vertices)
    for m in range(4):
        values = np.linalg.det(np.einsum("qbd,bc->qcd", slopes, corners[m]))
        coefficients = np.linalg.solve(bernstein(HEXAHEDRON, 2).tabulate(lattice, 0)[0], values)
        assert coefficients.min() >= 1 / 108 - 1e-15
        assert coefficients.max() <= 1 / 8 + 1e-15
        at_corner = values[[int(np.flatnonzero((lattice == v).all(axis=1))[0]) for v in HEXAHEDRON.vertices]]
        on = HEXAHEDRON.vertices.sum(axis=1).astype(int)
        assert np.allclose(at_corner, np.array([1 / 8, 1 / 18, 1 / 48, 1 / 108])[on], atol=1e-15)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_neighbours_share_control_points_in_every_numbering(order):
    """Two tets on a face, the second numbered in each of 24 ways: the same points on the three faces, one to one."""
    n = 4
    random = np.random.default_rng(61)
    exponents = bernstein(TETRAHEDRON, n).exponents
    first = random.standard_normal((len(exponents), 3))
    on_face = exponents[:, 3] == 0
    second = np.where(on_face[:, None], first, random.standard_normal(first.shape))
    place = {tuple(a): k for k, a in enumerate(exponents.tolist())}
    # The second tetrahedron with vertex v listed at position order[v].
    renumbered = np.empty_like(second)
    for k, a in enumerate(exponents.tolist()):
        b = [0, 0, 0, 0]
        for v in range(4):
            b[order[v]] = a[v]
        renumbered[place[tuple(b)]] = second[k]
    one, two = tets_to_hexes(first[None])[0], tets_to_hexes(renumbered[None])[0]
    grid_one = one.reshape(4, n + 1, n + 1, n + 1, 3)
    grid_two = two.reshape(4, n + 1, n + 1, n + 1, 3)
    for m in range(3):
        face_one = np.take(grid_one[m], 0, axis=AXES[m].index(3))
        other = order[m]
        face_two = np.take(grid_two[other], 0, axis=AXES[other].index(order[3]))
        # The two remaining axes of each hexahedron, named by the vertices they lead to.
        names_one = [order[v] for v in AXES[m] if v != 3]
        names_two = [v for v in AXES[other] if v != order[3]]
        if names_one != names_two:
            face_two = face_two.swapaxes(0, 1)
        assert np.abs(face_one - face_two).max() <= 1e-15 * np.abs(first).max()


def test_inner_faces_of_one_tetrahedron_coincide():
    n = 5
    T = np.random.default_rng(23).standard_normal((1, comb(n + 3, 3), 3))
    hexes = tets_to_hexes(T)[0].reshape(4, n + 1, n + 1, n + 1, 3)
    for a in range(4):
        for b in range(a):
            first = np.take(hexes[a], n, axis=AXES[a].index(b))
            second = np.take(hexes[b], n, axis=AXES[b].index(a))
            if [v for v in AXES[a] if v != b] != [v for v in AXES[b] if v != a]:
                second = second.swapaxes(0, 1)
            assert np.abs(first - second).max() < 5e-15


def test_chunks_and_threads_change_nothing():
    T = np.random.default_rng(3).standard_normal((5000, 10, 3))
    out = np.empty((5000, 4, 27, 3))
    made = tets_to_hexes(T, out)
    assert np.shares_memory(made, out)
    assert np.array_equal(made[[0, 2500, 4999]], np.concatenate([tets_to_hexes(T[k : k + 1]) for k in (0, 2500, 4999)]))


def test_wrong_numbers_of_coefficients_are_refused():
    assert [degree_of(comb(n + 3, 3)) for n in range(1, 12)] == list(range(1, 12))
    with pytest.raises(InputError, match="11 coefficients"):
        tets_to_hexes(np.zeros((2, 11, 3)))
    with pytest.raises(InputError, match="degree 0"):
        hex_matrices(0)


@pytest.mark.long
def test_speed_of_conversion():
    """250,000 cubic tetrahedra (a quarter of a million-tet mesh), processor time so that other load does not count."""
    T = np.random.default_rng(3).standard_normal((250_000, 20, 3))
    out = np.ones((250_000, 4, 64, 3))  # touched, so that the kernel has given its pages
    hex_matrices(3)
    start = time.process_time()
    tets_to_hexes(T, out)
    assert time.process_time() - start < 3.0
