r"""Geometry and coefficients at Gauss points.

From the interpolated control points (`iga.kernels.tensor.interpolate`; homogeneous ones for rational functions)

    x, J = dx/dxi, J^-1, det J,        x = (sum w P N) / W,  dx = (d(sum w P N) - x dW) / W,

and from those the 4 x 4 coefficients of a form in (N, dN): with kappa the physical tensor of the form,

    D_st = weight det J sum_ef (J^-1)_se kappa_ef (J^-1)_tf,     s, t = 1..3.

Rational functions R = w N / W have grad R = w (dN / W - N dW / W^2), so that with g = dW / W

    D_st / W^2,   D_0t = -sum_s g_s D_st / W^2,   D_00 = sum_st g_s g_t D_st / W^2 + rho weight det J / W^2,

where rho is the coefficient of the mass term.

Axis letters: e element, q point, s, t = 0 (function itself), 1..3 (reference derivatives), c component.
"""

from __future__ import annotations

import numba

from iga.kernels.options import OPTIONS


@numba.njit(**OPTIONS)
def geometry(u, weights, x, inverse, dx, W, g):
    """Points, inverse Jacobian matrices and weights times det J.

    Parameters
    ----------
    u : (e, 3 or 4, 4, q) interpolated x, or (w x, w).
    weights : (q,) of the rule.
    x, inverse, dx, W, g : filled, (e, 3, q), (e, 9, q) row by row (reference direction first), (e, q), (e, q),
        (e, 3, q); W and g for rational functions only.

    Returns
    -------
    Number of the first element with det J = 0 at a point, or -1.
    """
    degenerate = -1
    rational = u.shape[1] == 4
    for e in range(u.shape[0]):
        for q in range(u.shape[3]):
            x0, x1, x2 = u[e, 0, 0, q], u[e, 1, 0, q], u[e, 2, 0, q]
            a0, a1, a2 = u[e, 0, 1, q], u[e, 0, 2, q], u[e, 0, 3, q]
            b0, b1, b2 = u[e, 1, 1, q], u[e, 1, 2, q], u[e, 1, 3, q]
            c0, c1, c2 = u[e, 2, 1, q], u[e, 2, 2, q], u[e, 2, 3, q]
            if rational:
                v = 1.0 / u[e, 3, 0, q]
                g0, g1, g2 = u[e, 3, 1, q] * v, u[e, 3, 2, q] * v, u[e, 3, 3, q] * v
                x0 *= v
                x1 *= v
                x2 *= v
                a0, a1, a2 = a0 * v - x0 * g0, a1 * v - x0 * g1, a2 * v - x0 * g2
                b0, b1, b2 = b0 * v - x1 * g0, b1 * v - x1 * g1, b2 * v - x1 * g2
                c0, c1, c2 = c0 * v - x2 * g0, c1 * v - x2 * g1, c2 * v - x2 * g2
                W[e, q] = u[e, 3, 0, q]
                g[e, 0, q] = g0
                g[e, 1, q] = g1
                g[e, 2, q] = g2
            x[e, 0, q] = x0
            x[e, 1, q] = x1
            x[e, 2, q] = x2
            # Row of J: a (x), b (y), c (z) by reference direction 0..2; cofactors give the inverse.
            m00, m01, m02 = b1 * c2 - b2 * c1, c1 * a2 - c2 * a1, a1 * b2 - a2 * b1
            m10, m11, m12 = b2 * c0 - b0 * c2, c2 * a0 - c0 * a2, a2 * b0 - a0 * b2
            m20, m21, m22 = b0 * c1 - b1 * c0, c0 * a1 - c1 * a0, a0 * b1 - a1 * b0
            det = a0 * m00 + b0 * m01 + c0 * m02
            if det == 0.0 and degenerate < 0:
                degenerate = e
            f = 1.0 / det
            inverse[e, 0, q] = m00 * f
            inverse[e, 1, q] = m01 * f
            inverse[e, 2, q] = m02 * f
            inverse[e, 3, q] = m10 * f
            inverse[e, 4, q] = m11 * f
            inverse[e, 5, q] = m12 * f
            inverse[e, 6, q] = m20 * f
            inverse[e, 7, q] = m21 * f
            inverse[e, 8, q] = m22 * f
            dx[e, q] = weights[q] * det
    return degenerate


@numba.njit(**OPTIONS)
def scalar_tensor(inverse, dx, k, D):
    """Symmetric D (e, 10, q) of an isotropic tensor k (e or 1, q or 1)."""
    ke, kq = k.shape[0] > 1, k.shape[1] > 1
    for e in range(dx.shape[0]):
        m = inverse[e]
        for q in range(dx.shape[1]):
            f = dx[e, q] * k[e if ke else 0, q if kq else 0]
            a0, a1, a2 = m[0, q], m[1, q], m[2, q]
            b0, b1, b2 = m[3, q], m[4, q], m[5, q]
            c0, c1, c2 = m[6, q], m[7, q], m[8, q]
            D[e, 0, q] = 0.0
            D[e, 1, q] = 0.0
            D[e, 2, q] = 0.0
            D[e, 3, q] = 0.0
            D[e, 4, q] = f * (a0 * a0 + a1 * a1 + a2 * a2)
            D[e, 5, q] = f * (a0 * b0 + a1 * b1 + a2 * b2)
            D[e, 6, q] = f * (a0 * c0 + a1 * c1 + a2 * c2)
            D[e, 7, q] = f * (b0 * b0 + b1 * b1 + b2 * b2)
            D[e, 8, q] = f * (b0 * c0 + b1 * c1 + b2 * c2)
            D[e, 9, q] = f * (c0 * c0 + c1 * c1 + c2 * c2)


@numba.njit(**OPTIONS)
def symmetric_tensor(inverse, dx, k, D):
    """Symmetric D (e, 10, q) of a symmetric tensor k (e or 1, q or 1, 6): xx, xy, xz, yy, yz, zz."""
    ke, kq = k.shape[0] > 1, k.shape[1] > 1
    for e in range(dx.shape[0]):
        m = inverse[e]
        for q in range(dx.shape[1]):
            t = k[e if ke else 0, q if kq else 0]
            f = dx[e, q]
            xx, xy, xz, yy, yz, zz = f * t[0], f * t[1], f * t[2], f * t[3], f * t[4], f * t[5]
            a0, a1, a2 = m[0, q], m[1, q], m[2, q]
            b0, b1, b2 = m[3, q], m[4, q], m[5, q]
            c0, c1, c2 = m[6, q], m[7, q], m[8, q]
            D[e, 0, q] = 0.0
            D[e, 1, q] = 0.0
            D[e, 2, q] = 0.0
            D[e, 3, q] = 0.0
            u, v, w = xx * a0 + xy * a1 + xz * a2, xy * a0 + yy * a1 + yz * a2, xz * a0 + yz * a1 + zz * a2
            D[e, 4, q] = u * a0 + v * a1 + w * a2
            D[e, 5, q] = u * b0 + v * b1 + w * b2
            D[e, 6, q] = u * c0 + v * c1 + w * c2
            u, v, w = xx * b0 + xy * b1 + xz * b2, xy * b0 + yy * b1 + yz * b2, xz * b0 + yz * b1 + zz * b2
            D[e, 7, q] = u * b0 + v * b1 + w * b2
            D[e, 8, q] = u * c0 + v * c1 + w * c2
            u, v, w = xx * c0 + xy * c1 + xz * c2, xy * c0 + yy * c1 + yz * c2, xz * c0 + yz * c1 + zz * c2
            D[e, 9, q] = u * c0 + v * c1 + w * c2


@numba.njit(**OPTIONS)
def any_tensor(inverse, dx, k, D):
    """D (e, 16, q) of any tensor k (e or 1, q or 1, 9), row by row."""
    ke, kq = k.shape[0] > 1, k.shape[1] > 1
    for e in range(dx.shape[0]):
        m = inverse[e]
        for q in range(dx.shape[1]):
            t = k[e if ke else 0, q if kq else 0]
            f = dx[e, q]
            for s in range(4):
                D[e, s, q] = 0.0
                D[e, 4 * s, q] = 0.0
            for s in range(3):
                a0, a1, a2 = f * m[3 * s, q], f * m[3 * s + 1, q], f * m[3 * s + 2, q]
                u = a0 * t[0] + a1 * t[3] + a2 * t[6]
                v = a0 * t[1] + a1 * t[4] + a2 * t[7]
                w = a0 * t[2] + a1 * t[5] + a2 * t[8]
                for r in range(3):
                    D[e, 5 + 4 * s + r, q] = u * m[3 * r, q] + v * m[3 * r + 1, q] + w * m[3 * r + 2, q]


@numba.njit(**OPTIONS)
def mass(dx, rho, D):
    """Symmetric D (e, 10, q) of a mass term with coefficient rho (e or 1, q or 1)."""
    ke, kq = rho.shape[0] > 1, rho.shape[1] > 1
    for e in range(dx.shape[0]):
        for q in range(dx.shape[1]):
            D[e, 0, q] = dx[e, q] * rho[e if ke else 0, q if kq else 0]
            for s in range(1, 10):
                D[e, s, q] = 0.0


@numba.njit(**OPTIONS)
def rational_symmetric(W, g, D):
    """Turn symmetric D of a form in (R, dR) into that in (w N, w dN), in place."""
    for e in range(W.shape[0]):
        d = D[e]
        for q in range(W.shape[1]):
            f = 1.0 / (W[e, q] * W[e, q])
            a, b, c = g[e, 0, q], g[e, 1, q], g[e, 2, q]
            xx, xy, xz = d[4, q] * f, d[5, q] * f, d[6, q] * f
            yy, yz, zz = d[7, q] * f, d[8, q] * f, d[9, q] * f
            u, v, w = xx * a + xy * b + xz * c, xy * a + yy * b + yz * c, xz * a + yz * b + zz * c
            d[0, q] = d[0, q] * f + a * u + b * v + c * w
            d[1, q] = -u
            d[2, q] = -v
            d[3, q] = -w
            d[4, q] = xx
            d[5, q] = xy
            d[6, q] = xz
            d[7, q] = yy
            d[8, q] = yz
            d[9, q] = zz


@numba.njit(**OPTIONS)
def rational_any(W, g, D):
    """Turn D (e, 16, q) of a form in (R, dR), without terms in R, into that in (w N, w dN), in place."""
    for e in range(W.shape[0]):
        d = D[e]
        for q in range(W.shape[1]):
            f = 1.0 / (W[e, q] * W[e, q])
            a, b, c = g[e, 0, q], g[e, 1, q], g[e, 2, q]
            for s in range(5, 16):
                d[s, q] *= f
            u, v, w = (
                a * d[5, q] + b * d[9, q] + c * d[13, q],
                a * d[6, q] + b * d[10, q] + c * d[14, q],
                a * d[7, q] + b * d[11, q] + c * d[15, q],
            )
            d[0, q] = d[0, q] * f + u * a + v * b + w * c
            d[1, q] = -u
            d[2, q] = -v
            d[3, q] = -w
            d[4, q] = -(d[5, q] * a + d[6, q] * b + d[7, q] * c)
            d[8, q] = -(d[9, q] * a + d[10, q] * b + d[11, q] * c)
            d[12, q] = -(d[13, q] * a + d[14, q] * b + d[15, q] * c)
