r"""Sum factorisation on hexahedra whose functions are products of one-dimensional ones.

On an element with functions N_i = f_i1(xi_1) g_i2(xi_2) h_i3(xi_3), points q = (q1, q2, q3) and d_0 the identity,
d_1..d_3 the derivatives in the reference directions, the kernels compute

    interpolate    u_s(q) = sum_i d_s N_i(q) u_i,                        s = 0..3
    distribute     f_i   += sum_q sum_s d_s N_i(q) r_s(q)                (its transpose)
    symmetric      K_ij  += sum_q sum_st D_st(q) d_s N_i(q) d_t N_j(q)   D symmetric, 10 numbers: st = 00 01 02 03 11 ..
    general        the same with D any 4 x 4 matrix, 16 numbers row by row

one direction at a time (Antolin, Buffa, Calabro, Martinelli, Sangalli 2015, doi:10.1016/j.cma.2014.12.013). The
terms of D are gathered by what they need of the directions still to come: 16 contractions along the third direction,
7 (or 9) along the second and 4 along the first, whatever D is. The form in (N, dN) with 4 x 4 coefficients carries
diffusion, reaction and rational functions alike.

Tables: ``T`` (k, 2, q, n) values and derivatives of the k distinct sets of one-dimensional functions, ``P``
(k, 4, q, n*n) their products, type 2 a + b for derivative a of the first and b of the second factor; ``pattern``
(e, 3) says which. A kernel is compiled for each (n1, n2, n3, q1, q2, q3).

Axis letters: e element, q point, n function on the element, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from iga.kernels.options import OPTIONS

Array = NDArray[np.float64]
Sizes = tuple[int, int, int, int, int, int]


def products(T: Array) -> Array:
    """Products of one-dimensional functions: (k, 2, q, n) to (k, 4, q, n*n)."""
    k, _, q, n = T.shape
    return np.ascontiguousarray(np.einsum("kaqi,kbqj->kabqij", T, T).reshape(k, 4, q, n * n))


@cache
def places(n1: int, n2: int, n3: int, symmetric: bool) -> NDArray[np.int32]:
    """Where a kernel leaves entry (i, j) of an element matrix: pairs of each direction vary slowest to fastest.

    With ``symmetric`` only pairs i1 <= j1 are computed and (i, j) may stand for (j, i).
    """
    n = n1 * n2 * n3
    i1, i2, i3 = np.unravel_index(np.arange(n), (n1, n2, n3))
    pair = [np.add.outer(i * m, i) for i, m in ((i1, n1), (i2, n2), (i3, n3))]
    place = (pair[0] * n2 * n2 + pair[1]) * n3 * n3 + pair[2]
    if symmetric:
        place = np.where(i1[:, None] <= i1[None, :], place, place.T)
    return np.ascontiguousarray(place.astype(np.int32))


@cache
def interpolate(literal: Sizes) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, dofs, coefficients (N, c), result (e, c, 4, q))``."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, dofs, coefficients, result):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        u = np.empty((n1, n2 * n3))
        V = np.empty((2, q1, n2 * n3))
        W = np.empty((3, q2, n3))
        for e in range(dofs.shape[0]):
            k1, k2, k3 = pattern[e, 0], pattern[e, 1], pattern[e, 2]
            for c in range(coefficients.shape[1]):
                out = result[e, c]
                for i in range(n1):
                    for k in range(n2 * n3):
                        u[i, k] = coefficients[dofs[e, i * n2 * n3 + k], c]
                for a in range(q1):
                    for k in range(n2 * n3):
                        s0 = 0.0
                        s1 = 0.0
                        for i in range(n1):
                            s0 += T1[k1, 0, a, i] * u[i, k]
                            s1 += T1[k1, 1, a, i] * u[i, k]
                        V[0, a, k] = s0
                        V[1, a, k] = s1
                for a in range(q1):
                    for b in range(q2):
                        for k in range(n3):
                            s00 = 0.0
                            s01 = 0.0
                            s10 = 0.0
                            for j in range(n2):
                                s00 += T2[k2, 0, b, j] * V[0, a, j * n3 + k]
                                s01 += T2[k2, 1, b, j] * V[0, a, j * n3 + k]
                                s10 += T2[k2, 0, b, j] * V[1, a, j * n3 + k]
                            W[0, b, k] = s00
                            W[1, b, k] = s01
                            W[2, b, k] = s10
                    for b in range(q2):
                        at = (a * q2 + b) * q3
                        for c3 in range(q3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            s3 = 0.0
                            for k in range(n3):
                                s0 += T3[k3, 0, c3, k] * W[0, b, k]
                                s1 += T3[k3, 0, c3, k] * W[2, b, k]
                                s2 += T3[k3, 0, c3, k] * W[1, b, k]
                                s3 += T3[k3, 1, c3, k] * W[0, b, k]
                            out[0, at + c3] = s0
                            out[1, at + c3] = s1
                            out[2, at + c3] = s2
                            out[3, at + c3] = s3

    return kernel


@cache
def distribute(literal: Sizes) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, dofs, scale (e, n), r (e, c, 1 or 4, q), vector (N, c))``."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, dofs, scale, r, vector):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        V = np.empty((2, q1, n2 * n3))
        W = np.empty((3, q2, n3))
        slopes = r.shape[2] == 4
        for e in range(dofs.shape[0]):
            k1, k2, k3 = pattern[e, 0], pattern[e, 1], pattern[e, 2]
            for c in range(r.shape[1]):
                for a in range(q1):
                    for b in range(q2):
                        at = (a * q2 + b) * q3
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            if slopes:
                                for c3 in range(q3):
                                    t = T3[k3, 0, c3, k]
                                    s0 += t * r[e, c, 0, at + c3] + T3[k3, 1, c3, k] * r[e, c, 3, at + c3]
                                    s1 += t * r[e, c, 2, at + c3]
                                    s2 += t * r[e, c, 1, at + c3]
                            else:
                                for c3 in range(q3):
                                    s0 += T3[k3, 0, c3, k] * r[e, c, 0, at + c3]
                            W[0, b, k] = s0
                            W[1, b, k] = s1
                            W[2, b, k] = s2
                    for j in range(n2):
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            for b in range(q2):
                                s0 += T2[k2, 0, b, j] * W[0, b, k] + T2[k2, 1, b, j] * W[1, b, k]
                                s1 += T2[k2, 0, b, j] * W[2, b, k]
                            V[0, a, j * n3 + k] = s0
                            V[1, a, j * n3 + k] = s1
                for i in range(n1):
                    for k in range(n2 * n3):
                        s = 0.0
                        for a in range(q1):
                            s += T1[k1, 0, a, i] * V[0, a, k] + T1[k1, 1, a, i] * V[1, a, k]
                        vector[dofs[e, i * n2 * n3 + k], c] += s * scale[e, i * n2 * n3 + k]

    return kernel


@cache
def symmetric(literal: Sizes) -> Callable[..., None]:
    """Kernel for one component pair (a, a), symmetric D (e, 10, q); see `scatter_symmetric` for the other arguments."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(
        sizes, P1, P2, P3, pattern, D, place, order, offset, table, dofs, scale, begin, length, c, a, twice, values
    ):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m1, m2, m3 = n1 * n1, n2 * n2, n3 * n3
        F = np.empty((7, q1, q2, m3))
        E = np.empty((4, q1, m2, m3))
        K = np.empty((m1, m2 * m3))
        flat = E.reshape((4, q1, m2 * m3))
        for e in range(D.shape[0]):
            A1, A2, A3 = P1[pattern[e, 0]], P2[pattern[e, 1]], P3[pattern[e, 2]]
            d = D[e]
            for x in range(q1):
                for y in range(q2):
                    at = (x * q2 + y) * q3
                    for k in range(m3):
                        s11 = 0.0
                        s12 = 0.0
                        s10 = 0.0
                        s22 = 0.0
                        s20 = 0.0
                        s02 = 0.0
                        s00 = 0.0
                        for z in range(q3):
                            t0, t1, t2, t3 = A3[0, z, k], A3[1, z, k], A3[2, z, k], A3[3, z, k]
                            s00 += d[0, at + z] * t0 + d[3, at + z] * (t1 + t2) + d[9, at + z] * t3
                            s10 += d[1, at + z] * t0 + d[6, at + z] * t1
                            s20 += d[2, at + z] * t0 + d[8, at + z] * t1
                            s02 += d[2, at + z] * t0 + d[8, at + z] * t2
                            s11 += d[4, at + z] * t0
                            s12 += d[5, at + z] * t0
                            s22 += d[7, at + z] * t0
                        F[0, x, y, k] = s11
                        F[1, x, y, k] = s12
                        F[2, x, y, k] = s10
                        F[3, x, y, k] = s22
                        F[4, x, y, k] = s20
                        F[5, x, y, k] = s02
                        F[6, x, y, k] = s00
            for x in range(q1):
                for j in range(m2):
                    for k in range(m3):
                        s11 = 0.0
                        s10 = 0.0
                        s00 = 0.0
                        for y in range(q2):
                            t0, t1, t2, t3 = A2[0, y, j], A2[1, y, j], A2[2, y, j], A2[3, y, j]
                            s11 += t0 * F[0, x, y, k]
                            s10 += t1 * F[1, x, y, k] + t0 * F[2, x, y, k]
                            s00 += t3 * F[3, x, y, k] + t2 * F[4, x, y, k] + t1 * F[5, x, y, k] + t0 * F[6, x, y, k]
                        E[0, x, j, k] = s00
                        E[1, x, j, k] = s10
                        E[3, x, j, k] = s11
                # Type 01 is type 10 with the two functions exchanged.
                for i2 in range(n2):
                    for j2 in range(n2):
                        for i3 in range(n3):
                            for j3 in range(n3):
                                E[2, x, i2 * n2 + j2, i3 * n3 + j3] = E[1, x, j2 * n2 + i2, j3 * n3 + i3]
            for i1 in range(n1):
                for j1 in range(i1, n1):
                    m = i1 * n1 + j1
                    for k in range(m2 * m3):
                        s = 0.0
                        for x in range(q1):
                            s += (
                                A1[0, x, m] * flat[0, x, k]
                                + A1[1, x, m] * flat[2, x, k]
                                + A1[2, x, m] * flat[1, x, k]
                                + A1[3, x, m] * flat[3, x, k]
                            )
                        K[m, k] = s
            scatter_symmetric(
                K.reshape(m1 * m2 * m3), place, order[table[e]], offset[table[e]], dofs[e], scale[e], begin, length, c,
                a, twice, values,
            )

    return kernel


@cache
def general(literal: Sizes) -> Callable[..., None]:
    """Kernel for component pairs (a, b) and (b, a) at once, any D (e, 16, q); otherwise as `symmetric`."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(
        sizes, P1, P2, P3, pattern, D, place, order, offset, table, dofs, scale, begin, length, c, a, b, twice, values
    ):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m1, m2, m3 = n1 * n1, n2 * n2, n3 * n3
        F = np.empty((9, q1, q2, m3))
        E = np.empty((4, q1, m2, m3))
        K = np.empty((m1, m2 * m3))
        flat = E.reshape((4, q1, m2 * m3))
        for e in range(D.shape[0]):
            A1, A2, A3 = P1[pattern[e, 0]], P2[pattern[e, 1]], P3[pattern[e, 2]]
            d = D[e]
            for x in range(q1):
                for y in range(q2):
                    at = (x * q2 + y) * q3
                    for k in range(m3):
                        s11 = 0.0
                        s12 = 0.0
                        s10 = 0.0
                        s21 = 0.0
                        s01 = 0.0
                        s22 = 0.0
                        s20 = 0.0
                        s02 = 0.0
                        s00 = 0.0
                        for z in range(q3):
                            t0, t1, t2, t3 = A3[0, z, k], A3[1, z, k], A3[2, z, k], A3[3, z, k]
                            s00 += d[0, at + z] * t0 + d[3, at + z] * t1 + d[12, at + z] * t2 + d[15, at + z] * t3
                            s10 += d[4, at + z] * t0 + d[7, at + z] * t1
                            s01 += d[1, at + z] * t0 + d[13, at + z] * t2
                            s20 += d[8, at + z] * t0 + d[11, at + z] * t1
                            s02 += d[2, at + z] * t0 + d[14, at + z] * t2
                            s11 += d[5, at + z] * t0
                            s12 += d[6, at + z] * t0
                            s21 += d[9, at + z] * t0
                            s22 += d[10, at + z] * t0
                        F[0, x, y, k] = s11
                        F[1, x, y, k] = s12
                        F[2, x, y, k] = s10
                        F[3, x, y, k] = s22
                        F[4, x, y, k] = s20
                        F[5, x, y, k] = s02
                        F[6, x, y, k] = s00
                        F[7, x, y, k] = s21
                        F[8, x, y, k] = s01
            for x in range(q1):
                for j in range(m2):
                    for k in range(m3):
                        s11 = 0.0
                        s10 = 0.0
                        s01 = 0.0
                        s00 = 0.0
                        for y in range(q2):
                            t0, t1, t2, t3 = A2[0, y, j], A2[1, y, j], A2[2, y, j], A2[3, y, j]
                            s11 += t0 * F[0, x, y, k]
                            s10 += t1 * F[1, x, y, k] + t0 * F[2, x, y, k]
                            s01 += t2 * F[7, x, y, k] + t0 * F[8, x, y, k]
                            s00 += t3 * F[3, x, y, k] + t2 * F[4, x, y, k] + t1 * F[5, x, y, k] + t0 * F[6, x, y, k]
                        E[0, x, j, k] = s00
                        E[1, x, j, k] = s01
                        E[2, x, j, k] = s10
                        E[3, x, j, k] = s11
            for m in range(m1):
                for k in range(m2 * m3):
                    s = 0.0
                    for x in range(q1):
                        s += (
                            A1[0, x, m] * flat[0, x, k]
                            + A1[1, x, m] * flat[1, x, k]
                            + A1[2, x, m] * flat[2, x, k]
                            + A1[3, x, m] * flat[3, x, k]
                        )
                    K[m, k] = s
            scatter_general(
                K.reshape(m1 * m2 * m3), place, order[table[e]], offset[table[e]], dofs[e], scale[e], begin, length, c,
                a, b, twice, values,
            )

    return kernel


@numba.njit(**OPTIONS)
def scatter_symmetric(K, place, order, offset, dofs, scale, begin, length, c, a, twice, values):
    """Add a symmetric element matrix to the entries row <= column of components (a, a).

    Parameters
    ----------
    K, place : the matrix, and where in it entry (i, j) is, (n, n).
    order, offset : slots of the element (`iga.sparsity.Slots`).
    dofs, scale : (n,) function numbers and factors of the functions.
    begin, length : (N,) first entry of each row with c components, and number of functions in it.
    twice : whether the element may have one function twice.
    """
    n = len(dofs)
    t = 0
    for i in range(n):
        first = order[i]
        row = dofs[first]
        start = begin[row] + a * c * length[row] + a
        factor = scale[first]
        for j in range(i, n):
            second = order[j]
            values[start + c * offset[t]] += K[place[first, second]] * factor * scale[second]
            t += 1
        if twice:
            for j in range(i + 1, n):
                second = order[j]
                if dofs[second] != row:
                    break
                values[start + c * offset[t - n + i]] += K[place[second, first]] * factor * scale[second]


@numba.njit(**OPTIONS)
def scatter_general(K, place, order, offset, dofs, scale, begin, length, c, a, b, twice, values):
    """Add an element matrix of components (a, b) there and its transpose to (b, a), rows <= columns only."""
    n = len(dofs)
    t = 0
    for i in range(n):
        first = order[i]
        row = dofs[first]
        start = begin[row] + a * c * length[row] + b
        other = begin[row] + b * c * length[row] + a
        factor = scale[first]
        for j in range(i, n):
            second = order[j]
            product = factor * scale[second]
            values[start + c * offset[t]] += K[place[first, second]] * product
            values[other + c * offset[t]] += K[place[second, first]] * product
            t += 1
        if twice:
            for j in range(i + 1, n):
                second = order[j]
                if dofs[second] != row:
                    break
                product = factor * scale[second]
                values[start + c * offset[t - n + i]] += K[place[second, first]] * product
                values[other + c * offset[t - n + i]] += K[place[first, second]] * product


@numba.njit(**OPTIONS)
def scatter_matrices(K, place, order, offset, table, dofs, scale, begin, length, c, a, b, twice, values):
    """Scatter ready element matrices, (e, n*n): symmetric ones of components (a, a), or of (a, b) with a < b."""
    for e in range(dofs.shape[0]):
        k = table[e]
        if a == b:
            scatter_symmetric(K[e], place, order[k], offset[k], dofs[e], scale[e], begin, length, c, a, twice, values)
        else:
            scatter_general(K[e], place, order[k], offset[k], dofs[e], scale[e], begin, length, c, a, b, twice, values)
