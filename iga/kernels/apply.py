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
from iga.kernels.tensor import Sizes

GRADIENT, FULL, ELASTICITY = 0, 1, 2


@numba.njit(inline="always", **OPTIONS)
def _symmetric(D, at, g, r, q, full):
    """Channels r of one component from g at q points, D from point ``at`` on."""
    if full:
        for p in range(q):
            g0, g1, g2, g3 = g[0, p], g[1, p], g[2, p], g[3, p]
            r[0, p] = D[0, at + p] * g0 + D[1, at + p] * g1 + D[2, at + p] * g2 + D[3, at + p] * g3
            r[1, p] = D[1, at + p] * g0 + D[4, at + p] * g1 + D[5, at + p] * g2 + D[6, at + p] * g3
            r[2, p] = D[2, at + p] * g0 + D[5, at + p] * g1 + D[7, at + p] * g2 + D[8, at + p] * g3
            r[3, p] = D[3, at + p] * g0 + D[6, at + p] * g1 + D[8, at + p] * g2 + D[9, at + p] * g3
    else:
        for p in range(q):
            g1, g2, g3 = g[1, p], g[2, p], g[3, p]
            r[1, p] = D[0, at + p] * g1 + D[1, at + p] * g2 + D[2, at + p] * g3
            r[2, p] = D[1, at + p] * g1 + D[3, at + p] * g2 + D[4, at + p] * g3
            r[3, p] = D[2, at + p] * g1 + D[4, at + p] * g2 + D[5, at + p] * g3


@numba.njit(inline="always", **OPTIONS)
def _elastic(D, at, C, one, g, r, q):
    """Channels r (3, 4, q) of three components from g; C (1 or Q, 6, 6) stiffness, ``one`` if the same everywhere."""
    rational = D.shape[0] == 14
    for p in range(q):
        a0, a1, a2 = D[0, at + p], D[1, at + p], D[2, at + p]
        b0, b1, b2 = D[3, at + p], D[4, at + p], D[5, at + p]
        c0, c1, c2 = D[6, at + p], D[7, at + p], D[8, at + p]
        dx = D[9, at + p]
        u1, u2, u3 = g[0, 1, p], g[0, 2, p], g[0, 3, p]
        v1, v2, v3 = g[1, 1, p], g[1, 2, p], g[1, 3, p]
        w1, w2, w3 = g[2, 1, p], g[2, 2, p], g[2, 3, p]
        if rational:
            f = 1.0 / D[10, at + p]
            s1, s2, s3 = D[11, at + p], D[12, at + p], D[13, at + p]
            u1, u2, u3 = (u1 - g[0, 0, p] * s1) * f, (u2 - g[0, 0, p] * s2) * f, (u3 - g[0, 0, p] * s3) * f
            v1, v2, v3 = (v1 - g[1, 0, p] * s1) * f, (v2 - g[1, 0, p] * s2) * f, (v3 - g[1, 0, p] * s3) * f
            w1, w2, w3 = (w1 - g[2, 0, p] * s1) * f, (w2 - g[2, 0, p] * s2) * f, (w3 - g[2, 0, p] * s3) * f
            dx *= f
        ux, uy, uz = u1 * a0 + u2 * b0 + u3 * c0, u1 * a1 + u2 * b1 + u3 * c1, u1 * a2 + u2 * b2 + u3 * c2
        vx, vy, vz = v1 * a0 + v2 * b0 + v3 * c0, v1 * a1 + v2 * b1 + v3 * c1, v1 * a2 + v2 * b2 + v3 * c2
        wx, wy, wz = w1 * a0 + w2 * b0 + w3 * c0, w1 * a1 + w2 * b1 + w3 * c1, w1 * a2 + w2 * b2 + w3 * c2
        M = C[0 if one else at + p]
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
        r[0, 1, p] = u1
        r[0, 2, p] = u2
        r[0, 3, p] = u3
        r[1, 1, p] = v1
        r[1, 2, p] = v2
        r[1, 3, p] = v3
        r[2, 1, p] = w1
        r[2, 2, p] = w2
        r[2, 3, p] = w3
        if rational:
            r[0, 0, p] = -(u1 * s1 + u2 * s2 + u3 * s3)
            r[1, 0, p] = -(v1 * s1 + v2 * s2 + v3 * s3)
            r[2, 0, p] = -(w1 * s1 + w2 * s2 + w3 * s3)
        else:
            r[0, 0, p] = 0.0
            r[1, 0, p] = 0.0
            r[2, 0, p] = 0.0


@numba.njit(**OPTIONS)
def flux_symmetric(D, g, r):
    """Channels r (e, c, 4, q) from g with symmetric D (e, 6 or 10, q), every component alike."""
    full = D.shape[1] == 10
    for e in range(g.shape[0]):
        for c in range(g.shape[1]):
            if not full:
                r[e, c, 0] = 0.0
            _symmetric(D[e], 0, g[e, c], r[e, c], g.shape[3], full)


@numba.njit(**OPTIONS)
def flux_elastic(D, C, g, r):
    """Channels r (e, 3, 4, q) from g with D (e, 10 or 14, q) and stiffness C (1 or e, 1 or q, 6, 6)."""
    for e in range(g.shape[0]):
        _elastic(D[e], 0, C[e if C.shape[0] > 1 else 0], C.shape[1] == 1, g[e], r[e], g.shape[3])


@cache
def product(literal: Sizes, kind: int) -> Callable[..., None]:
    """Kernel ``(sizes, T1, T2, T3, pattern, D (e, s, q), C, dofs, x (N, c), y (N, c))`` for a form of some kind."""
    l1, l2, l3, l4, l5, l6 = literal
    value = kind != GRADIENT

    @numba.njit(**OPTIONS)
    def kernel(sizes, T1, T2, T3, pattern, D, C, dofs, x, y):
        n1, n2, n3 = l1 or sizes[0], l2 or sizes[1], l3 or sizes[2]
        q1, q2, q3 = l4 or sizes[3], l5 or sizes[4], l6 or sizes[5]
        components = x.shape[1]
        m = n2 * n3
        u = np.empty((n1, m))
        V = np.empty((components, 2, q1, m))
        Y = np.empty((components, 2, q1, m))
        W = np.empty((3, q2 * n3))
        g = np.empty((components, 4, q2 * q3))
        r = np.empty((components, 4, q2 * q3))
        for e in range(dofs.shape[0]):
            A1, A2, A3 = T1[pattern[e, 0]], T2[pattern[e, 1]], T3[pattern[e, 2]]
            for c in range(components):
                for i in range(n1):
                    for k in range(m):
                        u[i, k] = x[dofs[e, i * m + k], c]
                for a in range(q1):
                    for k in range(m):
                        s0 = 0.0
                        s1 = 0.0
                        for i in range(n1):
                            s0 += A1[0, a, i] * u[i, k]
                            s1 += A1[1, a, i] * u[i, k]
                        V[c, 0, a, k] = s0
                        V[c, 1, a, k] = s1
            for a in range(q1):
                for c in range(components):
                    for b in range(q2):
                        for k in range(n3):
                            s00 = 0.0
                            s01 = 0.0
                            s10 = 0.0
                            for j in range(n2):
                                s00 += A2[0, b, j] * V[c, 0, a, j * n3 + k]
                                s01 += A2[1, b, j] * V[c, 0, a, j * n3 + k]
                                s10 += A2[0, b, j] * V[c, 1, a, j * n3 + k]
                            W[0, b * n3 + k] = s00
                            W[1, b * n3 + k] = s01
                            W[2, b * n3 + k] = s10
                    for b in range(q2):
                        for z in range(q3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            s3 = 0.0
                            for k in range(n3):
                                if value:
                                    s0 += A3[0, z, k] * W[0, b * n3 + k]
                                s1 += A3[0, z, k] * W[2, b * n3 + k]
                                s2 += A3[0, z, k] * W[1, b * n3 + k]
                                s3 += A3[1, z, k] * W[0, b * n3 + k]
                            g[c, 0, b * q3 + z] = s0
                            g[c, 1, b * q3 + z] = s1
                            g[c, 2, b * q3 + z] = s2
                            g[c, 3, b * q3 + z] = s3
                at = a * q2 * q3
                if kind == ELASTICITY:
                    _elastic(D[e], at, C[e if C.shape[0] > 1 else 0], C.shape[1] == 1, g, r, q2 * q3)
                else:
                    for c in range(components):
                        _symmetric(D[e], at, g[c], r[c], q2 * q3, value)
                for c in range(components):
                    for b in range(q2):
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            s2 = 0.0
                            for z in range(q3):
                                s0 += A3[1, z, k] * r[c, 3, b * q3 + z]
                                if value:
                                    s0 += A3[0, z, k] * r[c, 0, b * q3 + z]
                                s1 += A3[0, z, k] * r[c, 2, b * q3 + z]
                                s2 += A3[0, z, k] * r[c, 1, b * q3 + z]
                            W[0, b * n3 + k] = s0
                            W[1, b * n3 + k] = s1
                            W[2, b * n3 + k] = s2
                    for j in range(n2):
                        for k in range(n3):
                            s0 = 0.0
                            s1 = 0.0
                            for b in range(q2):
                                s0 += A2[0, b, j] * W[0, b * n3 + k] + A2[1, b, j] * W[1, b * n3 + k]
                                s1 += A2[0, b, j] * W[2, b * n3 + k]
                            Y[c, 0, a, j * n3 + k] = s0
                            Y[c, 1, a, j * n3 + k] = s1
            for c in range(components):
                for i in range(n1):
                    for k in range(m):
                        s = 0.0
                        for a in range(q1):
                            s += A1[0, a, i] * Y[c, 0, a, k] + A1[1, a, i] * Y[c, 1, a, k]
                        u[i, k] = s
                for i in range(n1):
                    for k in range(m):
                        y[dofs[e, i * m + k], c] += u[i, k]

    return kernel
