r"""What is left of smoothness when two C1 Bezier tetrahedra become hexahedra (Proposition 5).

Two tetrahedra share the face of vertices 0, 1, 2; the fourth vertex W of the second has barycentric coordinates
w = (w0, w1, w2, w3), w3 < 0, in the first. Their polynomials S1, S2 join with continuous first derivatives if and only
if (Farin 1986)

    T2[a0, a1, a2, 0] = T1[a0, a1, a2, 0],
    T2[a0, a1, a2, 1] = sum_v w_v T1[(a0, a1, a2, 0) + e_v],     a0 + a1 + a2 = n - 1.

The hexahedra X1 = S1 o phi1 and X2 = S2 o phi2 then agree on the shared faces, and their derivatives agree after the
change of parameters: with D1, D2 the hexahedral maps of the two straight reference tetrahedra and d the direction
across,

    dX2/dd = alpha dX1/dd + beta dX1/ds + gamma dX1/dt,     (alpha, beta, gamma) = (grad D1)^-1 dD2/dd,

the same three functions for every component: G1. It is not C1 in (r, s, t): dX2/dd + dX1/dd does not vanish.

Source: Xu et al. 2018, proposition 5. Axis letters: m sub-hexahedron, q point, n coefficient, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.tet_to_hex import AXES, degree_of, tets_to_hexes
from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Continuity:
    """Largest jumps over the three shared hexahedral faces, relative to the largest value or derivative there.

    Attributes
    ----------
    trace : jump of the values.
    g1 : jump of the derivative across the face after the change of parameters.
    c1 : jump of the derivative across the face in the hexahedra's own parameters.
    """

    trace: float
    g1: float
    c1: float


def c1_pair(degree: int, seed: int, components: int = 3) -> tuple[Array, Array, Array]:
    """Coefficients (C, c) of two tetrahedra that join C1, otherwise random, and the apex w (4,) of the second.

    The second tetrahedron has the vertices 0, 1, 2 of the first and the apex as its vertex 3.
    """
    random = np.random.default_rng(seed)
    apex = np.array([0.4, 0.5, 0.6, -0.5]) + np.append(0.2 * random.random(3), 0.0)
    apex[3] = 1 - apex[:3].sum()
    exponents = bernstein(TETRAHEDRON, degree).exponents
    place = {tuple(a): k for k, a in enumerate(exponents.tolist())}
    first = random.standard_normal((len(exponents), components))
    second = random.standard_normal(first.shape)
    unit = np.eye(4, dtype=np.int64)
    for k, a in enumerate(exponents.tolist()):
        if a[3] == 0:
            second[k] = first[k]
        elif a[3] == 1:
            second[k] = sum(apex[v] * first[place[tuple(a - unit[3] + unit[v])]] for v in range(4))
    return first, second, apex


def face_continuity(first: Array, second: Array, apex: Array, points: Array) -> Continuity:
    """Jumps between the hexahedra of two tetrahedra on their shared face.

    Parameters
    ----------
    first, second : (C, c) Bernstein coefficients; the shared face is opposite to vertex 3 of both.
    apex : (4,) barycentric coordinates of the second's vertex 3 in the first.
    points : (q, 2) points of the unit square at which to measure.

    Raises
    ------
    InputError : the apex lies on the same side of the face as the first tetrahedron.
    """
    if not apex[3] < 0:
        raise InputError(f"the apex lies on the side of the first tetrahedron (last coordinate {apex[3]:g}, not < 0)")
    n = degree_of(len(first))
    reference = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    other = reference.copy()
    other[3] = apex @ reference
    maps = tets_to_hexes(np.stack([reference, other]))
    hexes = tets_to_hexes(np.stack([first, second]))
    trace = g1 = c1 = 0.0
    value_scale = slope_scale = 0.0
    for m in range(3):
        across = AXES[m].index(3)
        where = np.insert(np.asarray(points, dtype=float), across, 0.0, axis=1)
        values, slopes = bernstein(HEXAHEDRON, n).tabulate(where, 1)
        X = np.einsum("qb,tbc->tqc", values, hexes[:, m])
        dX = np.einsum("qbd,tbc->tqcd", slopes, hexes[:, m])
        dD = np.einsum("qbd,tbc->tqcd", bernstein(HEXAHEDRON, 1).tabulate(where, 1)[1], maps[:, m])
        change = np.linalg.solve(dD[0], dD[1][..., across, None])
        expected = (dX[0] @ change)[..., 0]
        trace = max(trace, float(np.abs(X[1] - X[0]).max()))
        g1 = max(g1, float(np.abs(dX[1][..., across] - expected).max()))
        c1 = max(c1, float(np.abs(dX[1][..., across] + dX[0][..., across]).max()))
        value_scale = max(value_scale, float(np.abs(X).max()))
        slope_scale = max(slope_scale, float(np.abs(dX).max()))
    return Continuity(trace / value_scale, g1 / slope_scale, c1 / slope_scale)
