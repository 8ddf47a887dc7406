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

Arrays are indexed flat inside the kernels, so that the compiler sees constant distances between them and vectorises
(three times faster than with several subscripts).

Axis letters: e element, q point, n function on the element, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from iga.kernels.options import OPTIONS
from iga.kernels.scatter import scatter_general, scatter_symmetric

Array = NDArray[np.float64]
Sizes = tuple[int, int, int, int, int, int]


def products(T: Array) -> Array:
    """Products of one-dimensional functions: (k, 2, q, n) to (k, 4, q, n*n)."""
    k, _, q, n = T.shape
    return np.ascontiguousarray(np.einsum("kaqi,kbqj->kabqij", T, T).reshape(k, 4, q, n * n))


@cache
def places(n1: int, n2: int, n3: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Where in an element matrix entries (i, j), i <= j, are left, row by row.

    Returns
    -------
    by `symmetric` : (n (n+1)/2,). Pairs of each direction vary slowest to fastest, in the first only those i1 <= j1.
    by `general` : (2, n (n+1)/2), of entries (i, j) and (j, i). The same with all pairs.
    """
    i1, i2, i3 = np.unravel_index(np.arange(n1 * n2 * n3), (n1, n2, n3))
    i, j = np.triu_indices(n1 * n2 * n3)
    first = i1[i] * n1 - i1[i] * (i1[i] - 1) // 2 + i1[j] - i1[i]
    half = (first * n2 * n2 + i2[i] * n2 + i2[j]) * n3 * n3 + i3[i] * n3 + i3[j]
    full = [
        ((i1[r] * n1 + i1[s]) * n2 * n2 + i2[r] * n2 + i2[s]) * n3 * n3 + i3[r] * n3 + i3[s]
        for r, s in ((i, j), (j, i))
    ]
    return half.astype(np.int32), np.stack(full).astype(np.int32)


@cache
def interpolate(literal: Sizes) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, dofs, coefficients (N, c), result (e, c, 4, q))``."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, dofs, coefficients, result):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m, q, components = n2 * n3, q1 * q2 * q3, coefficients.shape[1]
        A, B, C, number, x = T1.reshape(-1), T2.reshape(-1), T3.reshape(-1), dofs.reshape(-1), coefficients.reshape(-1)
        out = result.reshape(-1)
        u = np.empty(n1 * m)
        V = np.empty(2 * q1 * m)
        W = np.empty(3 * q2 * n3)
        z = np.empty(2 * n3 * q3)
        for e in range(dofs.shape[0]):
            k1, k2, k3 = pattern[e, 0] * 2 * q1 * n1, pattern[e, 1] * 2 * q2 * n2, pattern[e, 2] * 2 * q3 * n3
            for s in range(2):
                for k in range(n3):
                    for p in range(q3):
                        z[(s * n3 + k) * q3 + p] = C[k3 + (s * q3 + p) * n3 + k]
            for c in range(components):
                for k in range(n1 * m):
                    u[k] = x[number[e * n1 * m + k] * components + c]
                for a in range(q1):
                    for k in range(m):
                        s0 = 0.0
                        s1 = 0.0
                        for i in range(n1):
                            s0 += A[k1 + a * n1 + i] * u[i * m + k]
                            s1 += A[k1 + (q1 + a) * n1 + i] * u[i * m + k]
                        V[a * m + k] = s0
                        V[(q1 + a) * m + k] = s1
                for a in range(q1):
                    for b in range(q2):
                        for k in range(n3):
                            s00 = 0.0
                            s01 = 0.0
                            s10 = 0.0
                            for j in range(n2):
                                s00 += B[k2 + b * n2 + j] * V[a * m + j * n3 + k]
                                s01 += B[k2 + (q2 + b) * n2 + j] * V[a * m + j * n3 + k]
                                s10 += B[k2 + b * n2 + j] * V[(q1 + a) * m + j * n3 + k]
                            W[b * n3 + k] = s00
                            W[(q2 + b) * n3 + k] = s01
                            W[(2 * q2 + b) * n3 + k] = s10
                    for b in range(q2):
                        at = (e * components + c) * 4 * q + (a * q2 + b) * q3
                        for p in range(q3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            s3 = 0.0
                            for k in range(n3):
                                t = z[k * q3 + p]
                                s0 += t * W[b * n3 + k]
                                s1 += t * W[(2 * q2 + b) * n3 + k]
                                s2 += t * W[(q2 + b) * n3 + k]
                                s3 += z[(n3 + k) * q3 + p] * W[b * n3 + k]
                            out[at + p] = s0
                            out[at + q + p] = s1
                            out[at + 2 * q + p] = s2
                            out[at + 3 * q + p] = s3

    return kernel


@cache
def distribute(literal: Sizes) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, dofs, scale (e, n), r (e, c, 1 or 4, q), vector (N, c))``."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, dofs, scale, r, vector):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m, q, components, channels = n2 * n3, q1 * q2 * q3, r.shape[1], r.shape[2]
        A, B, C, number, f = T1.reshape(-1), T2.reshape(-1), T3.reshape(-1), dofs.reshape(-1), r.reshape(-1)
        y, factor = vector.reshape(-1), scale.reshape(-1)
        V = np.empty(2 * q1 * m)
        W = np.empty(3 * q2 * n3)
        u = np.empty(n1 * m)
        for e in range(dofs.shape[0]):
            k1, k2, k3 = pattern[e, 0] * 2 * q1 * n1, pattern[e, 1] * 2 * q2 * n2, pattern[e, 2] * 2 * q3 * n3
            for c in range(components):
                for a in range(q1):
                    for b in range(q2):
                        at = (e * components + c) * channels * q + (a * q2 + b) * q3
                        if channels == 4:
                            for k in range(n3):
                                s0 = 0.0
                                s1 = 0.0
                                s2 = 0.0
                                for p in range(q3):
                                    t = C[k3 + p * n3 + k]
                                    s0 += t * f[at + p] + C[k3 + (q3 + p) * n3 + k] * f[at + 3 * q + p]
                                    s1 += t * f[at + 2 * q + p]
                                    s2 += t * f[at + q + p]
                                W[b * n3 + k] = s0
                                W[(q2 + b) * n3 + k] = s1
                                W[(2 * q2 + b) * n3 + k] = s2
                        else:
                            for k in range(n3):
                                s0 = 0.0
                                for p in range(q3):
                                    s0 += C[k3 + p * n3 + k] * f[at + p]
                                W[b * n3 + k] = s0
                                W[(q2 + b) * n3 + k] = 0.0
                                W[(2 * q2 + b) * n3 + k] = 0.0
                    for j in range(n2):
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            for b in range(q2):
                                t = B[k2 + b * n2 + j]
                                s0 += t * W[b * n3 + k] + B[k2 + (q2 + b) * n2 + j] * W[(q2 + b) * n3 + k]
                                s1 += t * W[(2 * q2 + b) * n3 + k]
                            V[a * m + j * n3 + k] = s0
                            V[(q1 + a) * m + j * n3 + k] = s1
                for i in range(n1):
                    for k in range(m):
                        s = 0.0
                        for a in range(q1):
                            s += A[k1 + a * n1 + i] * V[a * m + k] + A[k1 + (q1 + a) * n1 + i] * V[(q1 + a) * m + k]
                        u[i * m + k] = s
                at = e * n1 * m
                for k in range(n1 * m):
                    y[number[at + k] * components + c] += u[k] * factor[at + k]

    return kernel


@numba.njit(inline="always", **OPTIONS)
def load(target, source):
    """Copy an array."""
    for k in range(len(target)):
        target[k] = source[k]


@cache
def symmetric(literal: Sizes) -> Callable[..., None]:
    """Kernel for one component pair (a, a), symmetric D (e, 10, q); see `scatter_symmetric` for the other arguments."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(
        sizes, P1, P2, P3, pattern, D, place, offset, table, dofs, scale, scaled, begin, length, c, a, twice, values
    ):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m1, m2, m3 = n1 * n1, n2 * n2, n3 * n3
        q, S, R = q1 * q2 * q3, q1 * q2 * m3, q1 * m2 * m3
        d = D.reshape(-1)
        # Copies of the tables of the element at hand: at fixed places, the loops below compile to better code.
        A1, A2, A3 = np.empty(4 * q1 * m1), np.empty(4 * q2 * m2), np.empty(4 * q3 * m3)
        F = np.empty(7 * S)
        E = np.empty(4 * R)
        K = np.empty(n1 * (n1 + 1) // 2 * m2 * m3)
        for e in range(D.shape[0]):
            load(A1, P1[pattern[e, 0]].reshape(-1))
            load(A2, P2[pattern[e, 1]].reshape(-1))
            load(A3, P3[pattern[e, 2]].reshape(-1))
            for x in range(q1):
                for y in range(q2):
                    o = e * 10 * q + (x * q2 + y) * q3
                    f = (x * q2 + y) * m3
                    for k in range(m3):
                        s11 = 0.0
                        s12 = 0.0
                        s10 = 0.0
                        s22 = 0.0
                        s20 = 0.0
                        s02 = 0.0
                        s00 = 0.0
                        for z in range(q3):
                            t0, t1 = A3[z * m3 + k], A3[(q3 + z) * m3 + k]
                            t2, t3 = A3[(2 * q3 + z) * m3 + k], A3[(3 * q3 + z) * m3 + k]
                            s00 += d[o + z] * t0 + d[o + 3 * q + z] * (t1 + t2) + d[o + 9 * q + z] * t3
                            s10 += d[o + q + z] * t0 + d[o + 6 * q + z] * t1
                            s20 += d[o + 2 * q + z] * t0 + d[o + 8 * q + z] * t1
                            s02 += d[o + 2 * q + z] * t0 + d[o + 8 * q + z] * t2
                            s11 += d[o + 4 * q + z] * t0
                            s12 += d[o + 5 * q + z] * t0
                            s22 += d[o + 7 * q + z] * t0
                        F[f + k] = s11
                        F[S + f + k] = s12
                        F[2 * S + f + k] = s10
                        F[3 * S + f + k] = s22
                        F[4 * S + f + k] = s20
                        F[5 * S + f + k] = s02
                        F[6 * S + f + k] = s00
            for x in range(q1):
                f = x * q2 * m3
                for j in range(m2):
                    g = (x * m2 + j) * m3
                    for k in range(m3):
                        s11 = 0.0
                        s10 = 0.0
                        s00 = 0.0
                        for y in range(q2):
                            t0, t1 = A2[y * m2 + j], A2[(q2 + y) * m2 + j]
                            t2, t3 = A2[(2 * q2 + y) * m2 + j], A2[(3 * q2 + y) * m2 + j]
                            h = f + y * m3 + k
                            s11 += t0 * F[h]
                            s10 += t1 * F[S + h] + t0 * F[2 * S + h]
                            s00 += t3 * F[3 * S + h] + t2 * F[4 * S + h] + t1 * F[5 * S + h] + t0 * F[6 * S + h]
                        E[g + k] = s00
                        E[R + g + k] = s10
                        E[3 * R + g + k] = s11
                # Type 01 is type 10 with the two functions exchanged.
                for i2 in range(n2):
                    for j2 in range(n2):
                        g = (x * m2 + i2 * n2 + j2) * m3
                        h = (x * m2 + j2 * n2 + i2) * m3
                        for i3 in range(n3):
                            for j3 in range(n3):
                                E[2 * R + g + i3 * n3 + j3] = E[R + h + j3 * n3 + i3]
            g = 0
            for i1 in range(n1):
                for j1 in range(i1, n1):
                    m = i1 * n1 + j1
                    for k in range(m2 * m3):
                        s = 0.0
                        for x in range(q1):
                            h = x * m2 * m3 + k
                            s += (
                                A1[m + x * m1] * E[h]
                                + A1[m + (q1 + x) * m1] * E[2 * R + h]
                                + A1[m + (2 * q1 + x) * m1] * E[R + h]
                                + A1[m + (3 * q1 + x) * m1] * E[3 * R + h]
                            )
                        K[g + k] = s
                    g += m2 * m3
            scatter_symmetric(K, place, offset[table[e]], dofs[e], scale[e], scaled, begin, length, c, a, twice, values)

    return kernel


@cache
def general(literal: Sizes) -> Callable[..., None]:
    """Kernel for component pairs (a, b) and (b, a) at once, any D (e, 16, q); otherwise as `symmetric`."""
    l1, l2, l3, l4, l5, l6 = literal

    @numba.njit(**OPTIONS)
    def kernel(
        sizes, P1, P2, P3, pattern, D, place, offset, table, dofs, scale, scaled, begin, length, c, a, b, twice, values
    ):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        m1, m2, m3 = n1 * n1, n2 * n2, n3 * n3
        q, S, R = q1 * q2 * q3, q1 * q2 * m3, q1 * m2 * m3
        d = D.reshape(-1)
        # Copies of the tables of the element at hand: at fixed places, the loops below compile to better code.
        A1, A2, A3 = np.empty(4 * q1 * m1), np.empty(4 * q2 * m2), np.empty(4 * q3 * m3)
        F = np.empty(9 * S)
        E = np.empty(4 * R)
        K = np.empty(m1 * m2 * m3)
        for e in range(D.shape[0]):
            load(A1, P1[pattern[e, 0]].reshape(-1))
            load(A2, P2[pattern[e, 1]].reshape(-1))
            load(A3, P3[pattern[e, 2]].reshape(-1))
            for x in range(q1):
                for y in range(q2):
                    o = e * 16 * q + (x * q2 + y) * q3
                    f = (x * q2 + y) * m3
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
                            t0, t1 = A3[z * m3 + k], A3[(q3 + z) * m3 + k]
                            t2, t3 = A3[(2 * q3 + z) * m3 + k], A3[(3 * q3 + z) * m3 + k]
                            s00 += (
                                d[o + z] * t0 + d[o + 3 * q + z] * t1 + d[o + 12 * q + z] * t2 + d[o + 15 * q + z] * t3
                            )
                            s10 += d[o + 4 * q + z] * t0 + d[o + 7 * q + z] * t1
                            s01 += d[o + q + z] * t0 + d[o + 13 * q + z] * t2
                            s20 += d[o + 8 * q + z] * t0 + d[o + 11 * q + z] * t1
                            s02 += d[o + 2 * q + z] * t0 + d[o + 14 * q + z] * t2
                            s11 += d[o + 5 * q + z] * t0
                            s12 += d[o + 6 * q + z] * t0
                            s21 += d[o + 9 * q + z] * t0
                            s22 += d[o + 10 * q + z] * t0
                        F[f + k] = s11
                        F[S + f + k] = s12
                        F[2 * S + f + k] = s10
                        F[3 * S + f + k] = s22
                        F[4 * S + f + k] = s20
                        F[5 * S + f + k] = s02
                        F[6 * S + f + k] = s00
                        F[7 * S + f + k] = s21
                        F[8 * S + f + k] = s01
            for x in range(q1):
                f = x * q2 * m3
                for j in range(m2):
                    g = (x * m2 + j) * m3
                    for k in range(m3):
                        s11 = 0.0
                        s10 = 0.0
                        s01 = 0.0
                        s00 = 0.0
                        for y in range(q2):
                            t0, t1 = A2[y * m2 + j], A2[(q2 + y) * m2 + j]
                            t2, t3 = A2[(2 * q2 + y) * m2 + j], A2[(3 * q2 + y) * m2 + j]
                            h = f + y * m3 + k
                            s11 += t0 * F[h]
                            s10 += t1 * F[S + h] + t0 * F[2 * S + h]
                            s01 += t2 * F[7 * S + h] + t0 * F[8 * S + h]
                            s00 += t3 * F[3 * S + h] + t2 * F[4 * S + h] + t1 * F[5 * S + h] + t0 * F[6 * S + h]
                        E[g + k] = s00
                        E[R + g + k] = s01
                        E[2 * R + g + k] = s10
                        E[3 * R + g + k] = s11
            for m in range(m1):
                g = m * m2 * m3
                for k in range(m2 * m3):
                    s = 0.0
                    for x in range(q1):
                        h = x * m2 * m3 + k
                        s += (
                            A1[m + x * m1] * E[h]
                            + A1[m + (q1 + x) * m1] * E[R + h]
                            + A1[m + (2 * q1 + x) * m1] * E[2 * R + h]
                            + A1[m + (3 * q1 + x) * m1] * E[3 * R + h]
                        )
                    K[g + k] = s
            scatter_general(
                K, place[0], K, place[1], offset[table[e]], dofs[e], scale[e], scaled, begin, length, c, a, b, twice,
                values,
            )

    return kernel
