r"""Control points of the triangles beside trimming curves as combinations of a face's B-spline coefficients.

phi maps a triangle to a chart of the face, F is the face's surface over the chart, psi maps to space; phi and psi are
cubic, and psi(phi^-1) stands for F (Song and Cohen 2019, Section 3, whose chart is the parameter plane). With the
corner q_i, the step d_ij = phi_ij - q_i to the next coefficient of phi on the side to corner j (a third of the side's
velocity), and e_i = phi_111 - q_i,

    psi_i   = F(q_i)
    psi_ij  = F(q_i) + F'(q_i) d_ij                            beside corner i on the side to corner j
    psi_111 = mean_i  F(q_i) + F'(q_i) e_i + 3/2 F''(q_i)[d_ij, d_ik]

the last from d_j d_k psi = d_j d_k (F o phi) at corner i. On a triangle with legs along parameter lines and the corner
q0 alone this is the twist with its correction of `triangle.selection`; taking all three corners, and sides in any
direction, it holds for every triangle. On a parameter line without knots the psi_ij are exactly the Bezier points of
the surface, so triangles join the rectangles beside them. phi_111 is that of quadratic precision, which at a trimming
curve is the blend of NOTES 3.1. The rules are affine: rows sum to one.

A side or a triangle that knot lines cross spans more than the corners' jets tell of, and at a narrow interval, where
the surface curls, these grow beyond all bounds. There psi is the cubic that meets F at the images of its ten domain
points (four on a side), whose rows are bounded, whatever the knots.

Here derivatives are taken with respect to the parameters: with those D, D2 of the parameters over the chart,
F' d = S' (D d) and F''[d, e] = S''[D d, D e] + S' D2[d, e].

Axis letters: q point, n B-spline on it, t triangle, i j k corner, d parameter direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.hbrep import DEGREE
from geometry.hybrid.triangle import CUBIC
from geometry.knots import blossom, find_spans
from iga.bernstein import greville, lagrange_to_bernstein

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

OTHERS = np.array([(1, 2), (2, 0), (0, 1)])
"""The corners j, k that follow corner i."""
_TOWARDS = 1e-6
"""Share of the way to another point by which a point moves to choose the knot interval beside it."""
_ON = 1e-9
"""Share of a step within which a knot counts as at its end."""
DOMAIN_POINTS = greville(CUBIC)
_MEETING = lagrange_to_bernstein(CUBIC, DOMAIN_POINTS)
_MEETING[np.abs(_MEETING) < 1e-12] = 0.0


@dataclass(frozen=True, eq=False)
class Jets:
    """Values and derivatives of bicubic B-splines at points.

    Attributes
    ----------
    dofs : (q, 16) numbers of the B-splines.
    value, first, second : (q, 16), (q, 16, 2) and (q, 16, 2, 2).
    """

    dofs: Index
    value: Array
    first: Array
    second: Array


def jets(knots: tuple[Array, ...], uv: Array, towards: Array) -> Jets:
    """B-splines at points (q, 2), on the knot intervals that lie ``towards`` other points (q, 2)."""
    line = []
    for d in range(2):
        x, t = uv[:, d], knots[d]
        spans = find_spans(t, DEGREE, x + _TOWARDS * (towards[:, d] - x))
        h = t[spans + 1] - t[spans]
        f = [
            blossom(t, DEGREE, spans, np.stack([x + h * (k < m) for k in range(DEGREE)], axis=1)).values
            for m in range(3)
        ]
        slope, bend = 3.0 * (f[1] - f[0]) / h[:, None], 6.0 * (f[2] - 2.0 * f[1] + f[0]) / (h**2)[:, None]
        line.append((spans - DEGREE, f[0], slope, bend))
    (i, a, da, dda), (j, b, db, ddb) = line
    steps = np.arange(DEGREE + 1)
    columns = len(knots[1]) - DEGREE - 1
    dofs = ((i[:, None, None] + steps[:, None]) * columns + j[:, None, None] + steps).reshape(len(uv), 16)

    def product(x: Array, y: Array) -> Array:
        return np.asarray(np.einsum("qn,qm->qnm", x, y).reshape(len(x), 16))

    mixed = product(da, db)
    second = np.stack([product(dda, b), mixed, mixed, product(a, ddb)], axis=-1).reshape(len(uv), 16, 2, 2)
    return Jets(dofs, product(a, b), np.stack([product(da, b), product(a, db)], axis=-1), second)


def vertex_rows(knots: tuple[Array, ...], uv: Array, towards: Array) -> tuple[Array, Index]:
    """Rows (q, 16) of S(u_i), and their B-splines."""
    found = jets(knots, uv, towards)
    return found.value, found.dofs


def side_rows(knots: tuple[Array, ...], uv: Array, towards: Array, step: Array) -> tuple[Array, Index]:
    """Rows (q, 16) of psi_ij from corners (q, 2), the corners that the sides go to, and steps (q, 2)."""
    found = jets(knots, uv, towards)
    return found.value + np.einsum("qnd,qd->qn", found.first, step), found.dofs


def phi_of(q: Array, steps: Array) -> Array:
    """Inner coefficient (t, 2) of phi from corners (t, 3, 2) and steps (t, 3, 2, 2) to the two corners that follow."""
    sides = (q[:, :, None] + steps).sum(axis=(1, 2))
    return np.asarray(0.25 * sides - q.sum(axis=1) / 6.0)


def inner_rows(knots: tuple[Array, ...], uv: Array, steps: Array, inwards: Array) -> tuple[Array, Index]:
    """Rows (t, 48) of psi_111, and their B-splines, those of the three corners one after the other.

    Parameters
    ----------
    uv, steps : corners (t, 3, 2) in the parameter plane, and D d_ij (t, 3, 2, 2).
    inwards : (t, 3, 2) D e_i + 3/2 D2[d_ij, d_ik].
    """
    middle = uv.mean(axis=1)
    rows, dofs = [], []
    for i in range(3):
        found = jets(knots, uv[:, i], middle)
        row = found.value + np.einsum("qnd,qd->qn", found.first, inwards[:, i])
        row += 1.5 * np.einsum("qnde,qd,qe->qn", found.second, steps[:, i, 0], steps[:, i, 1])
        rows.append(row / 3.0)
        dofs.append(found.dofs)
    return np.concatenate(rows, axis=1), np.concatenate(dofs, axis=1)


def crossing(knots: tuple[Array, ...], uv: Array) -> Mask:
    """Whether the boxes of points (t, k, 2) hold knot lines between their ends."""
    low, high = uv.min(axis=1), uv.max(axis=1)
    found = np.zeros(len(uv), dtype=bool)
    for d in range(2):
        room = _ON * (high[:, d] - low[:, d]) + 1e-14 * float(np.ptp(knots[d]))
        first = np.searchsorted(knots[d], low[:, d] + room)
        found |= first < np.searchsorted(knots[d], high[:, d] - room)
    return found


def meeting_rows(knots: tuple[Array, ...], uv: Array) -> tuple[Array, Index]:
    """Rows (t, 10, k) of the cubics that meet S at the images (t, 10, 2) of their domain points, and their B-splines
    (t, k); rows of functions on a side need no other points than those on the side.
    """
    found = jets(knots, uv.reshape(-1, 2), uv.reshape(-1, 2))
    rows = np.einsum("bp,tpn->tbpn", _MEETING, found.value.reshape(*uv.shape[:2], 16))
    k = 16 * uv.shape[1]
    return rows.reshape(len(uv), len(_MEETING), k), found.dofs.reshape(len(uv), k)
