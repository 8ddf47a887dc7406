r"""Distortion of tensor-product elements at lattices of sample points, by sum factorisation, compiled.

Where an element's functions are products of functions of one variable, and so are its sample points, derivatives are
found one direction after the other,

    J[c, d, (l, m, r)] = sum_ijk T0[i, l] T1[j, m] T2[k, r] values[(i, j, k), c],

with T the values at the points, in direction d the slopes, and slopes of the energy go back the same way: some 7,000
multiplications for cubics at 3 x 3 x 3 points instead of 60,000 by tables of all functions at all points. One call does
many elements, so threads do not wait for each other's interpreter.

Axis letters: e element, i j k function by direction, l m r point by direction, c component, d reference dimension,
s distinct operator.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from iga.kernels.distortion import distortion
from iga.kernels.options import OPTIONS


@cache
def lattice_kernel(n: int, q: int) -> Callable[..., None]:
    """Kernel for n functions and q points in each direction, which are then constants of the compiled code.

    Its parameters are ``values`` (N, 3), ``dofs`` (e, n^3), in each direction values and slopes (s, n, q) of the
    functions at the points, ``pattern`` (e, 3), which of these, and what `distortion` has; it adds to ``gradient``.
    """

    @numba.njit(**OPTIONS)
    def kernel(
        values: Any, dofs: Any, V0: Any, S0: Any, V1: Any, S1: Any, V2: Any, S2: Any, pattern: Any, inverse: Any,
        delta: Any, power: Any, size: Any, weight: Any, gradient: Any, energy: Any, least: Any,
    ) -> None:
        J, D = np.empty((1, 3, 3, q * q * q)), np.empty((1, 3, 3, q * q * q))
        last, slope = np.empty((n * n, q)), np.empty((n * n, q))
        none, first, second = np.empty((n, q * q)), np.empty((n, q * q)), np.empty((n, q * q))
        for e in range(len(dofs)):
            v0, s0 = V0[pattern[e, 0]], S0[pattern[e, 0]]
            v1, s1 = V1[pattern[e, 1]], S1[pattern[e, 1]]
            v2, s2 = V2[pattern[e, 2]], S2[pattern[e, 2]]
            for c in range(3):
                for i in range(n * n):
                    for r in range(q):
                        last[i, r] = 0.0
                        slope[i, r] = 0.0
                    for k in range(n):
                        x = values[dofs[e, i * n + k], c]
                        for r in range(q):
                            last[i, r] += x * v2[k, r]
                            slope[i, r] += x * s2[k, r]
                for i in range(n):
                    for m in range(q):
                        for r in range(q):
                            a, b, f = 0.0, 0.0, 0.0
                            for j in range(n):
                                x = last[i * n + j, r]
                                a += v1[j, m] * x
                                b += s1[j, m] * x
                                f += v1[j, m] * slope[i * n + j, r]
                            none[i, m * q + r] = a
                            first[i, m * q + r] = b
                            second[i, m * q + r] = f
                for l in range(q):
                    for m in range(q * q):
                        a, b, f = 0.0, 0.0, 0.0
                        for i in range(n):
                            a += s0[i, l] * none[i, m]
                            b += v0[i, l] * first[i, m]
                            f += v0[i, l] * second[i, m]
                        J[0, c, 0, l * q * q + m] = a
                        J[0, c, 1, l * q * q + m] = b
                        J[0, c, 2, l * q * q + m] = f
            distortion(
                J, 0, inverse[e : e + 1], delta[e : e + 1], power, size, weight[e : e + 1], D, energy[e : e + 1],
                least[e : e + 1],
            )
            for c in range(3):
                for i in range(n):
                    for m in range(q * q):
                        a, b, f = 0.0, 0.0, 0.0
                        for l in range(q):
                            a += s0[i, l] * D[0, c, 0, l * q * q + m]
                            b += v0[i, l] * D[0, c, 1, l * q * q + m]
                            f += v0[i, l] * D[0, c, 2, l * q * q + m]
                        none[i, m] = a
                        first[i, m] = b
                        second[i, m] = f
                for i in range(n):
                    for j in range(n):
                        for r in range(q):
                            a, b = 0.0, 0.0
                            for m in range(q):
                                a += v1[j, m] * none[i, m * q + r] + s1[j, m] * first[i, m * q + r]
                                b += v1[j, m] * second[i, m * q + r]
                            last[i * n + j, r] = a
                            slope[i * n + j, r] = b
                for i in range(n * n):
                    for k in range(n):
                        a = 0.0
                        for r in range(q):
                            a += v2[k, r] * last[i, r] + s2[k, r] * slope[i, r]
                        gradient[dofs[e, i * n + k], c] += a

    return kernel
