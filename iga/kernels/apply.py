r"""Matrix-free products: y += K x element by element, without the matrix.

At each point the four numbers g_s = sum_i d_s N_i x_i of each component (s = 0 the function, 1..3 the reference
derivatives) turn into r_s by the form, and f_i = sum_q sum_s d_s N_i r_s goes back. Forms come in three kinds:

    GRADIENT     r_s = sum_t D_st g_t, s, t = 1..3                D symmetric, 6 numbers: 11 12 13 22 23 33
    FULL         the same with s, t = 0..3                        D symmetric, 10 numbers: 00 01 02 03 11 ...
    ELASTICITY   r = dx J^-1 sigma, sigma = C : (g J^-1)          10 numbers: J^-1 row by row, weight det J
                 rational: g -> (g_s - g_0 dW_s / W) / W          14 numbers: and W, dW / W

On hexahedra one kernel does all of it slice by slice of the first direction, so that only the numbers at the points
are read from memory. Axis letters: e element, q point, n function on the element, c component, s channel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numba
import numpy as np

from iga.kernels.options import OPTIONS
from iga.kernels.tensor import Sizes, load

GRADIENT, FULL, ELASTICITY = 0, 1, 2


@numba.njit(inline="always", **OPTIONS)
def _symmetric(D, at, Q, g, r, first, q, full):
    """Channels r of one component from g at q points.

    D is flat, its numbers Q apart from place ``at`` on; so are g and r, their channels q apart from place ``first`` on.
    """
    if full:
        for p in range(q):
            g0, g1, g2, g3 = g[first + p], g[first + q + p], g[first + 2 * q + p], g[first + 3 * q + p]
            r[first + p] = D[at + p] * g0 + D[at + Q + p] * g1 + D[at + 2 * Q + p] * g2 + D[at + 3 * Q + p] * g3
            r[first + q + p] = (
                D[at + Q + p] * g0 + D[at + 4 * Q + p] * g1
                + D[at + 5 * Q + p] * g2 + D[at + 6 * Q + p] * g3
            )
            r[first + 2 * q + p] = (
                D[at + 2 * Q + p] * g0 + D[at + 5 * Q + p] * g1
                + D[at + 7 * Q + p] * g2 + D[at + 8 * Q + p] * g3
            )
            r[first + 3 * q + p] = (
                D[at + 3 * Q + p] * g0 + D[at + 6 * Q + p] * g1
                + D[at + 8 * Q + p] * g2 + D[at + 9 * Q + p] * g3
            )
    else:
        for p in range(q):
            g1, g2, g3 = g[first + q + p], g[first + 2 * q + p], g[first + 3 * q + p]
            r[first + q + p] = D[at + p] * g1 + D[at + Q + p] * g2 + D[at + 2 * Q + p] * g3
            r[first + 2 * q + p] = D[at + Q + p] * g1 + D[at + 3 * Q + p] * g2 + D[at + 4 * Q + p] * g3
            r[first + 3 * q + p] = D[at + 2 * Q + p] * g1 + D[at + 4 * Q + p] * g2 + D[at + 5 * Q + p] * g3


@numba.njit(inline="always", **OPTIONS)
def _elastic(D, at, Q, rational, C, point, one, g, r, first, q):
    """Channels r of three components from g, arrays as in `_symmetric`; C (1 or Q, 6, 6) stiffness from ``point`` on.

    ``one`` if the stiffness is the same at all points.
    """
    for p in range(q):
        a0, a1, a2 = D[at + p], D[at + Q + p], D[at + 2 * Q + p]
        b0, b1, b2 = D[at + 3 * Q + p], D[at + 4 * Q + p], D[at + 5 * Q + p]
        c0, c1, c2 = D[at + 6 * Q + p], D[at + 7 * Q + p], D[at + 8 * Q + p]
        dx = D[at + 9 * Q + p]
        u1, u2, u3 = g[first + q + p], g[first + 2 * q + p], g[first + 3 * q + p]
        v1, v2, v3 = g[first + 5 * q + p], g[first + 6 * q + p], g[first + 7 * q + p]
        w1, w2, w3 = g[first + 9 * q + p], g[first + 10 * q + p], g[first + 11 * q + p]
        if rational:
            f = 1.0 / D[at + 10 * Q + p]
            s1, s2, s3 = D[at + 11 * Q + p], D[at + 12 * Q + p], D[at + 13 * Q + p]
            u1, u2, u3 = (u1 - g[first + p] * s1) * f, (u2 - g[first + p] * s2) * f, (u3 - g[first + p] * s3) * f
            v1 = (v1 - g[first + 4 * q + p] * s1) * f
            v2 = (v2 - g[first + 4 * q + p] * s2) * f
            v3 = (v3 - g[first + 4 * q + p] * s3) * f
            w1 = (w1 - g[first + 8 * q + p] * s1) * f
            w2 = (w2 - g[first + 8 * q + p] * s2) * f
            w3 = (w3 - g[first + 8 * q + p] * s3) * f
            dx *= f
        ux, uy, uz = u1 * a0 + u2 * b0 + u3 * c0, u1 * a1 + u2 * b1 + u3 * c1, u1 * a2 + u2 * b2 + u3 * c2
        vx, vy, vz = v1 * a0 + v2 * b0 + v3 * c0, v1 * a1 + v2 * b1 + v3 * c1, v1 * a2 + v2 * b2 + v3 * c2
        wx, wy, wz = w1 * a0 + w2 * b0 + w3 * c0, w1 * a1 + w2 * b1 + w3 * c1, w1 * a2 + w2 * b2 + w3 * c2
        M = C[0 if one else point + p]
        e3, e4, e5 = vz + wy, uz + wx, uy + vx
        xx = (M[0, 0] * ux + M[0, 1] * vy + M[0, 2] * wz + M[0, 3] * e3 + M[0, 4] * e4 + M[0, 5] * e5) * dx
        yy = (M[1, 0] * ux + M[1, 1] * vy + M[1, 2] * wz + M[1, 3] * e3 + M[1, 4] * e4 + M[1, 5] * e5) * dx
        zz = (M[2, 0] * ux + M[2, 1] * vy + M[2, 2] * wz + M[2, 3] * e3 + M[2, 4] * e4 + M[2, 5] * e5) * dx
        yz = (M[3, 0] * ux + M[3, 1] * vy + M[3, 2] * wz + M[3, 3] * e3 + M[3, 4] * e4 + M[3, 5] * e5) * dx
        xz = (M[4, 0] * ux + M[4, 1] * vy + M[4, 2] * wz + M[4, 3] * e3 + M[4, 4] * e4 + M[4, 5] * e5) * dx
        xy = (M[5, 0] * ux + M[5, 1] * vy + M[5, 2] * wz + M[5, 3] * e3 + M[5, 4] * e4 + M[5, 5] * e5) * dx
        u1, u2, u3 = xx * a0 + xy * a1 + xz * a2, xx * b0 + xy * b1 + xz * b2, xx * c0 + xy * c1 + xz * c2
        v1, v2, v3 = xy * a0 + yy * a1 + yz * a2, xy * b0 + yy * b1 + yz * b2, xy * c0 + yy * c1 + yz * c2
        w1, w2, w3 = xz * a0 + yz * a1 + zz * a2, xz * b0 + yz * b1 + zz * b2, xz * c0 + yz * c1 + zz * c2
        r[first + q + p] = u1
        r[first + 2 * q + p] = u2
        r[first + 3 * q + p] = u3
        r[first + 5 * q + p] = v1
        r[first + 6 * q + p] = v2
        r[first + 7 * q + p] = v3
        r[first + 9 * q + p] = w1
        r[first + 10 * q + p] = w2
        r[first + 11 * q + p] = w3
        if rational:
            r[first + p] = -(u1 * s1 + u2 * s2 + u3 * s3)
            r[first + 4 * q + p] = -(v1 * s1 + v2 * s2 + v3 * s3)
            r[first + 8 * q + p] = -(w1 * s1 + w2 * s2 + w3 * s3)
        else:
            r[first + p] = 0.0
            r[first + 4 * q + p] = 0.0
            r[first + 8 * q + p] = 0.0


@numba.njit(**OPTIONS)
def flux_symmetric(D, g, r):
    """Channels r (e, c, 4, q) from g with symmetric D (e, 6 or 10, q), every component alike."""
    _, numbers, q = D.shape
    flat, given, out = D.reshape(-1), g.reshape(-1), r.reshape(-1)
    for e in range(g.shape[0]):
        for c in range(g.shape[1]):
            if numbers == 6:
                r[e, c, 0] = 0.0
            _symmetric(flat, e * numbers * q, q, given, out, (e * g.shape[1] + c) * 4 * q, q, numbers == 10)


@numba.njit(**OPTIONS)
def flux_elastic(D, C, g, r):
    """Channels r (e, 3, 4, q) from g with D (e, 10 or 14, q) and stiffness C (1 or e, 1 or q, 6, 6)."""
    _, numbers, q = D.shape
    flat, given, out = D.reshape(-1), g.reshape(-1), r.reshape(-1)
    for e in range(g.shape[0]):
        M = C[e if C.shape[0] > 1 else 0]
        _elastic(flat, e * numbers * q, q, numbers == 14, M, 0, len(M) == 1, given, out, e * 12 * q, q)


@cache
def product(literal: Sizes, kind: int) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, D (e, s, q), C, dofs, x (N, c), y (N, c))`` for a form of some kind."""
    l1, l2, l3, l4, l5, l6 = literal
    value = kind != GRADIENT

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, D, C, dofs, x, y):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        components, numbers = x.shape[1], D.shape[1]
        m, q, Q = n2 * n3, q2 * q3, q1 * q2 * q3
        flat, given, result, number = D.reshape(-1), x.reshape(-1), y.reshape(-1), dofs.reshape(-1)
        # Copies of the tables of the element at hand: at fixed places, the loops below compile to better code.
        A1, A2, A3, B3 = np.empty(2 * q1 * n1), np.empty(2 * q2 * n2), np.empty(2 * q3 * n3), np.empty(2 * n3 * q3)
        u = np.empty(n1 * m)
        V = np.empty(components * 2 * q1 * m)
        Y = np.empty(components * 2 * q1 * m)
        W = np.empty(3 * q2 * n3)
        g = np.zeros(components * 4 * q)
        r = np.empty(components * 4 * q)
        for e in range(dofs.shape[0]):
            load(A1, T1[pattern[e, 0]].reshape(-1))
            load(A2, T2[pattern[e, 1]].reshape(-1))
            load(A3, T3[pattern[e, 2]].reshape(-1))
            for s in range(2):
                for k in range(n3):
                    for z in range(q3):
                        B3[(s * n3 + k) * q3 + z] = A3[(s * q3 + z) * n3 + k]
            for c in range(components):
                for k in range(n1 * m):
                    u[k] = given[number[e * n1 * m + k] * components + c]
                v = c * 2 * q1 * m
                for a in range(q1):
                    for k in range(m):
                        s0 = 0.0
                        s1 = 0.0
                        for i in range(n1):
                            s0 += A1[a * n1 + i] * u[i * m + k]
                            s1 += A1[(q1 + a) * n1 + i] * u[i * m + k]
                        V[v + a * m + k] = s0
                        V[v + (q1 + a) * m + k] = s1
            for a in range(q1):
                for c in range(components):
                    v = c * 2 * q1 * m + a * m
                    for b in range(q2):
                        for k in range(n3):
                            s00 = 0.0
                            s01 = 0.0
                            s10 = 0.0
                            for j in range(n2):
                                s00 += A2[b * n2 + j] * V[v + j * n3 + k]
                                s01 += A2[(q2 + b) * n2 + j] * V[v + j * n3 + k]
                                s10 += A2[b * n2 + j] * V[v + q1 * m + j * n3 + k]
                            W[b * n3 + k] = s00
                            W[(q2 + b) * n3 + k] = s01
                            W[(2 * q2 + b) * n3 + k] = s10
                    for b in range(q2):
                        f = c * 4 * q + b * q3
                        for z in range(q3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            s3 = 0.0
                            for k in range(n3):
                                t = B3[k * q3 + z]
                                if value:
                                    s0 += t * W[b * n3 + k]
                                s1 += t * W[(2 * q2 + b) * n3 + k]
                                s2 += t * W[(q2 + b) * n3 + k]
                                s3 += B3[(n3 + k) * q3 + z] * W[b * n3 + k]
                            if value:
                                g[f + z] = s0
                            g[f + q + z] = s1
                            g[f + 2 * q + z] = s2
                            g[f + 3 * q + z] = s3
                at = e * numbers * Q + a * q
                if kind == ELASTICITY:
                    M = C[e if C.shape[0] > 1 else 0]
                    _elastic(flat, at, Q, numbers == 14, M, a * q, len(M) == 1, g, r, 0, q)
                else:
                    for c in range(components):
                        _symmetric(flat, at, Q, g, r, c * 4 * q, q, value)
                for c in range(components):
                    for b in range(q2):
                        f = c * 4 * q + b * q3
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            for z in range(q3):
                                t = A3[z * n3 + k]
                                if value:
                                    s0 += t * r[f + z]
                                s0 += A3[(q3 + z) * n3 + k] * r[f + 3 * q + z]
                                s1 += t * r[f + 2 * q + z]
                                s2 += t * r[f + q + z]
                            W[b * n3 + k] = s0
                            W[(q2 + b) * n3 + k] = s1
                            W[(2 * q2 + b) * n3 + k] = s2
                    v = c * 2 * q1 * m + a * m
                    for j in range(n2):
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            for b in range(q2):
                                t = A2[b * n2 + j]
                                s0 += t * W[b * n3 + k] + A2[(q2 + b) * n2 + j] * W[(q2 + b) * n3 + k]
                                s1 += t * W[(2 * q2 + b) * n3 + k]
                            Y[v + j * n3 + k] = s0
                            Y[v + q1 * m + j * n3 + k] = s1
            for c in range(components):
                v = c * 2 * q1 * m
                for i in range(n1):
                    for k in range(m):
                        s = 0.0
                        for a in range(q1):
                            s += A1[a * n1 + i] * Y[v + a * m + k] + A1[(q1 + a) * n1 + i] * Y[v + (q1 + a) * m + k]
                        u[i * m + k] = s
                for k in range(n1 * m):
                    result[number[e * n1 * m + k] * components + c] += u[k]

    return kernel
