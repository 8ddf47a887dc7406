r"""Curvilinear triangles at trimming curves (Song and Cohen 2019, Section 3, with the choices of NOTES 3.1).

A triangle has its right-angle corner q0 inside the face, a leg of length l_x along xi to pa, a leg l_y along eta to pb,
and the cubic trimming segment from pa to pb opposite to q0. Barycentric coordinates (a, b, c) belong to pa, pb, q0.

    phi   plane triangle -> parameter plane, cubic, the identity on the legs, the segment on c = 0
    psi   plane triangle -> space, cubic, S on the legs; then x = psi(phi^-1(xi, eta)) replaces S

With P_ij the tensor Bezier points of S on the rectangle [q0, pa] x [q0, pb], (0, 0) at q0, coefficient (i, j) of psi
(exponent i of a, j of b) is

    selection     P_ij                                                       error O(h^2)
    twist         P_11 replaced by w P_11 + (1 - w)(P_10 + P_01 - P_00), w = 3/2   O(h^3) with straight phi
    correction    + 3 (k_x (P_10 - P_00) + k_y (P_01 - P_00)), k = displacement of phi_11 / legs, for blend phi

(blend: phi_11 displaced by (d_1 + d_2) / 4 with d_k the displacements of the curve's control points from its chord;
straight: not displaced). All are affine combinations, so the functions keep summing to one.

Exponents (i, j) follow `iga.bernstein` on the triangle with vertices (q0, pa, pb).
Axis letters: t triangle, n Bernstein function, c component.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein, greville, lagrange_to_bernstein
from iga.cells import TRIANGLE

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Phi = Literal["blend", "straight"]
Psi = Literal["selection", "twist", "correction"]

CUBIC = bernstein(TRIANGLE, 3)
IJ = CUBIC.exponents[:, 1:]
"""Exponents (10, 2) of a and b of each function."""
_ROWS = [tuple(row) for row in IJ.tolist()]
INNER = _ROWS.index((1, 1))
CORNER = np.array([_ROWS.index(ij) for ij in ((0, 0), (3, 0), (0, 3))])
"""Functions of the three corners."""
CURVE = np.array([_ROWS.index((3 - k, k)) for k in range(4)])
"""Functions of the trimming edge from pa to pb."""


def right_corner(start: Array, end: Array) -> Array:
    """Right-angle corners (s, 2) on the left of monotone pieces from start (s, 2) to end (s, 2)."""
    rising = ((end - start)[:, 0] * (end - start)[:, 1] > 0)[:, None]
    return np.where(rising, np.stack([start[:, 0], end[:, 1]], 1), np.stack([end[:, 0], start[:, 1]], 1))


def make_phi(q0: Array, curve: Array, kind: Phi = "blend") -> Array:
    """Control points (t, 10, 2) of phi.

    Parameters
    ----------
    q0 : (t, 2) right-angle corners.
    curve : (t, 4, 2) control points of the segments from pa to pb.
    """
    pa, pb = curve[:, 0], curve[:, 3]
    i, j = IJ[:, 0] / 3.0, IJ[:, 1] / 3.0
    control = q0[:, None] + i[:, None] * (pa - q0)[:, None] + j[:, None] * (pb - q0)[:, None]
    displaced = curve - control[:, CURVE]
    control[:, CURVE] = curve
    if kind == "blend":
        control[:, INNER] += 0.25 * (displaced[:, 1] + displaced[:, 2])
    return control


def jacobian_coefficients(phi: Array) -> Array:
    """Bernstein coefficients (t, 15) of degree 4 of det(d phi / d(a, b))."""
    points = greville(bernstein(TRIANGLE, 4))
    gradients = CUBIC.tabulate(points, 1)[1]
    J = np.einsum("qnd,tnc->tqcd", gradients, phi)
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    return np.asarray(det @ _quartic().T)


@cache
def _quartic() -> Array:
    basis = bernstein(TRIANGLE, 4)
    return lagrange_to_bernstein(basis, greville(basis))


def certified(phi: Array) -> NDArray[np.bool_]:
    """Whether det(d phi) > 0 inside each triangle (t,) is proved by its coefficients: none negative, not all zero.

    At pa and pb it may vanish: it does where the curve leaves along a leg, as a hole's does where it turns around.
    """
    legs = phi[:, CORNER[1]] - phi[:, CORNER[0]], phi[:, CORNER[2]] - phi[:, CORNER[0]]
    area = legs[0][:, 0] * legs[1][:, 1] - legs[0][:, 1] * legs[1][:, 0]
    det = jacobian_coefficients(phi) / np.where(area == 0.0, np.inf, area)[:, None]
    return np.asarray((det.min(axis=1) > -1e-9) & (det.max(axis=1) > 0.0))


def selection(phi: Array | None = None, kind: Psi = "selection") -> Array:
    """Matrices S (t, 16, 10), or one (16, 10) without phi: psi's coefficients from the tensor points P_ij.

    Parameters
    ----------
    phi : (t, 10, 2), needed for the correction.
    """
    S = np.zeros((16, 10))
    for n, (i, j) in enumerate(IJ.tolist()):
        S[4 * i + j, n] = 1.0
    if kind != "selection":
        S[:, INNER] = 0.0
        S[[5, 4, 1, 0], INNER] = 1.5, -0.5, -0.5, 0.5
    if kind != "correction":
        return S
    if phi is None:
        raise ValueError("the correction depends on phi")
    made = np.repeat(S[None], len(phi), axis=0)
    legs = np.stack([phi[:, CORNER[1]] - phi[:, CORNER[0]], phi[:, CORNER[2]] - phi[:, CORNER[0]]], axis=1)
    straight = phi[:, CORNER[0]] + (legs[:, 0] + legs[:, 1]) / 3.0
    displaced = phi[:, INNER] - straight
    kx, ky = displaced[:, 0] / legs[:, 0, 0], displaced[:, 1] / legs[:, 1, 1]
    made[:, 4, INNER] += 3.0 * kx
    made[:, 1, INNER] += 3.0 * ky
    made[:, 0, INNER] -= 3.0 * (kx + ky)
    return made


def triangle_map(control: Array, ab: Array) -> Array:
    """Points (t, q, c) of cubic triangles (t, 10, c) at (a, b), (q, 2)."""
    return np.asarray(np.einsum("qn,tnc->tqc", CUBIC.tabulate(ab, 0)[0], control))


def invert_phi(phi: Array, points: Array, rounds: int = 30) -> Array:
    """(a, b) (q, 2) of points (q, 2) in triangles (q, 10, 2), each its own, by Newton from the straight triangle."""
    o, pa, pb = (phi[:, v] for v in CORNER)
    M = np.stack([pa - o, pb - o], axis=-1)
    ab = np.linalg.solve(M, (points - o)[..., None])[..., 0]
    ab = np.clip(ab, 0.0, 1.0)
    for _ in range(rounds):
        values, gradients = CUBIC.tabulate(ab, 1)
        r = points - np.einsum("qn,qnc->qc", values, phi)
        J = np.einsum("qnd,qnc->qcd", gradients, phi)
        step = np.linalg.solve(J, r[..., None])[..., 0]
        ab = ab + np.clip(step, -0.3, 0.3)
        if np.abs(step).max() < 1e-15:
            break
    return np.asarray(ab)
