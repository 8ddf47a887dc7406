r"""Compiled kernel of the Jacobian certificate: Bernstein coefficients of det J of many elements, and their error.

Products of polynomials are convolutions of scaled Bernstein coefficients. Elements are worked on 32 side by side in the
last axis (the lanes, after the components), so that each step of a convolution is vector instructions. Coefficients of
a product live in a padded box in which positions add, so no table of index pairs is needed.

Axis letters: e element, b Bernstein coefficient of the map, k coefficient of det J, c homogeneous component, f factor,
l lane, v vertex.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from iga.kernels.options import OPTIONS, PLAIN

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# No reordering of sums: the rounding bound counts the operations as they are written.
STRICT: dict[str, Any] = {**OPTIONS, "fastmath": {"contract", "nsz"}}

# Number of lanes: wide enough that loops over lanes are vectorised, small enough that work arrays stay in cache.
L = 32
TILE = 8
"""Rows of each factor in a tile of a product of minors."""


class Plan(NamedTuple):
    """A determinant plan in plain arrays; `iga.certificate` fills it from `iga.determinant`.

    Attributes
    ----------
    components : 3 (polynomial map) or 4 (rational map, weight first).
    rows : factor f has the rows rows[f]:rows[f + 1]; the last factor of a rational plan is the weight.
    start, column, value : all rows of the scaled factor matrices, compressed.
    unscale : (rows,) one over the scale of each row.
    offset : (rows,) position of each row in the box of the product it enters first.
    boxes : entries of the boxes of the left, right, square and final products.
    left, right, square : (n, 2) used positions in the box of the first two factors, of the last two, of w^2, and where
        they add in the final box.
    first : (rows of the first factor,) positions in the final box (polynomial plans).
    low : (n,) used positions of the determinant before it is raised to the form of w^4.
    raising, raising_value : positions and scaled coefficients of the constant one by which it is raised.
    used, factor : (k,) used positions in the final box, and what takes scaled to plain coefficients.
    weight_factor : (k,) the same for w^4.
    row_sum : (f,) largest absolute row sum of each factor matrix.
    scale : constant in front of the determinant.
    gammas : relative rounding bounds of factors, of products, of w^4.
    corners : (v,) coefficient at each vertex.
    """

    components: int
    rows: Index
    start: Index
    column: Index
    value: Array
    unscale: Array
    offset: Index
    boxes: Index
    left: Index
    right: Index
    square: Index
    first: Index
    low: Index
    raising: Index
    raising_value: Array
    used: Index
    factor: Array
    weight_factor: Array
    row_sum: Array
    scale: float
    gammas: Array
    corners: Index


@njit(**STRICT)
def _control_net(plan, P, first, net):
    """Control points of a group of elements, lanes last, moved so that the element lies about the origin."""
    for l in range(L):
        e = min(first + l, P.shape[0] - 1)
        if plan.components == 3:
            for c in range(3):
                x = 0.5 * (P[e, 0, c] + P[e, -1, c])
                for b in range(P.shape[1]):
                    net[b, c * L + l] = P[e, b, c] - x
        else:
            for c in range(1, 4):
                x = 0.5 * (P[e, 0, c] / P[e, 0, 0] + P[e, -1, c] / P[e, -1, 0])
                for b in range(P.shape[1]):
                    net[b, c * L + l] = P[e, b, c] - x * P[e, b, 0]
            for b in range(P.shape[1]):
                net[b, l] = P[e, b, 0]


@njit(**STRICT)
def _factors(plan, net, F, size):
    """Apply the factor matrices: F (rows, c, l), and size (f, c, l), the largest |coefficient| of each factor."""
    components = plan.components
    size[:] = 0.0
    for f in range(len(plan.rows) - 1):
        for r in range(plan.rows[f], plan.rows[f + 1]):
            F[r, :] = 0.0
            for entry in range(plan.start[r], plan.start[r + 1]):
                b, v = plan.column[entry], plan.value[entry]
                for c in range(components):
                    for l in range(L):
                        F[r, c * L + l] += v * net[b, c * L + l]
            for c in range(components):
                for l in range(L):
                    size[f, c * L + l] = max(size[f, c * L + l], abs(F[r, c * L + l]) * plan.unscale[r])


@njit(**STRICT)
def _determinant3(plan, F, cross, result):
    """Scaled coefficients of det[A, B, C]: cross product of the last two, then the dot product with the first."""
    cross[:] = 0.0
    result[:] = 0.0
    for i in range(plan.rows[1], plan.rows[2]):
        for j in range(plan.rows[2], plan.rows[3]):
            k = plan.offset[i] + plan.offset[j]
            for l in range(L):
                cross[k, l] += F[i, L + l] * F[j, 2 * L + l] - F[i, 2 * L + l] * F[j, L + l]
                cross[k, L + l] += F[i, 2 * L + l] * F[j, l] - F[i, l] * F[j, 2 * L + l]
                cross[k, 2 * L + l] += F[i, l] * F[j, L + l] - F[i, L + l] * F[j, l]
    for u in range(len(plan.right)):
        j, base = plan.right[u, 0], plan.right[u, 1]
        for i in range(plan.rows[1]):
            k = base + plan.first[i]
            for l in range(L):
                result[k, l] += (
                    F[i, l] * cross[j, l] + F[i, L + l] * cross[j, L + l] + F[i, 2 * L + l] * cross[j, 2 * L + l]
                )


@njit(**STRICT)
def _minors(F, a0, a1, b1, offset, minors):
    """Two by two minors 01, 02, 03, 12, 13, 23 of rows a0:a1 and a1:b1."""
    minors[:] = 0.0
    for i in range(a0, a1):
        for j in range(a1, b1):
            k = offset[i] + offset[j]
            for l in range(L):
                minors[k, l] += F[i, l] * F[j, L + l] - F[i, L + l] * F[j, l]
                minors[k, L + l] += F[i, l] * F[j, 2 * L + l] - F[i, 2 * L + l] * F[j, l]
                minors[k, 2 * L + l] += F[i, l] * F[j, 3 * L + l] - F[i, 3 * L + l] * F[j, l]
                minors[k, 3 * L + l] += F[i, L + l] * F[j, 2 * L + l] - F[i, 2 * L + l] * F[j, L + l]
                minors[k, 4 * L + l] += F[i, L + l] * F[j, 3 * L + l] - F[i, 3 * L + l] * F[j, L + l]
                minors[k, 5 * L + l] += F[i, 2 * L + l] * F[j, 3 * L + l] - F[i, 3 * L + l] * F[j, 2 * L + l]


@njit(**STRICT)
def _determinant4(plan, F, left, right, low, result):
    """Scaled coefficients of det[A, B, C, D], Laplace expansion in the first two, raised to the form of w^4."""
    _minors(F, plan.rows[0], plan.rows[1], plan.rows[2], plan.offset, left)
    _minors(F, plan.rows[2], plan.rows[3], plan.rows[4], plan.offset, right)
    low[:] = 0.0
    result[:] = 0.0
    # Tiles of both factors stay in the first-level cache.
    for tile in range(0, len(plan.left), TILE):
        for other in range(0, len(plan.right), TILE):
            for u in range(tile, min(tile + TILE, len(plan.left))):
                i, base = plan.left[u, 0], plan.left[u, 1]
                for v in range(other, min(other + TILE, len(plan.right))):
                    j = plan.right[v, 0]
                    k = base + plan.right[v, 1]
                    for l in range(L):
                        low[k, l] += (
                            left[i, l] * right[j, 5 * L + l] - left[i, L + l] * right[j, 4 * L + l]
                            + left[i, 2 * L + l] * right[j, 3 * L + l] + left[i, 3 * L + l] * right[j, 2 * L + l]
                            - left[i, 4 * L + l] * right[j, L + l] + left[i, 5 * L + l] * right[j, l]
                        )
    for u in range(len(plan.low)):
        j = plan.low[u]
        for i in range(len(plan.raising)):
            k, v = j + plan.raising[i], plan.raising_value[i]
            for l in range(L):
                result[k, l] += v * low[j, l]


@njit(**STRICT)
def _fourth_power(plan, F, square, result):
    """Scaled coefficients of w^4."""
    square[:] = 0.0
    result[:] = 0.0
    for i in range(plan.rows[4], plan.rows[5]):
        for j in range(plan.rows[4], plan.rows[5]):
            k = plan.offset[i] + plan.offset[j]
            for l in range(L):
                square[k, l] += F[i, l] * F[j, l]
    for u in range(len(plan.square)):
        i, base = plan.square[u, 0], plan.square[u, 1]
        for v in range(len(plan.square)):
            j = plan.square[v, 0]
            k = base + plan.square[v, 1]
            for l in range(L):
                result[k, l] += square[i, l] * square[j, l]


@njit(**PLAIN)
def _permanent(plan, size, l):
    """Permanent of the factors' sizes: no coefficient of the determinant has terms that sum to more."""
    if plan.components == 3:
        total = 0.0
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            minor = size[1, b * L + l] * size[2, c * L + l] + size[1, c * L + l] * size[2, b * L + l]
            total += size[0, a * L + l] * minor
        return total
    total = 0.0
    for a in range(4):
        for b in range(4):
            if a != b:
                c = 0
                while c in (a, b):
                    c += 1
                d = 6 - a - b - c
                minor = size[2, c * L + l] * size[3, d * L + l] + size[2, d * L + l] * size[3, c * L + l]
                total += size[0, a * L + l] * size[1, b * L + l] * minor
    return total


@njit(**PLAIN)
def _error(plan, net, size, slack, l):
    """Bound of |computed - true coefficient| for all maps with control points within ``slack`` of the given ones."""
    exact = _permanent(plan, size, l)
    for c in range(plan.components):
        largest = 0.0
        for b in range(net.shape[0]):
            largest = max(largest, abs(net[b, c * L + l]))
        for f in range(plan.components):
            size[f, c * L + l] += plan.row_sum[f] * (slack[c] + plan.gammas[0] * largest)
    grown = _permanent(plan, size, l)
    return plan.scale * ((grown - exact) + plan.gammas[1] * grown)


@njit(**PLAIN)
def coefficients(plan, P, slack, first_group, last_group, keep, numerator, weight, bounds, corner):
    """Bernstein coefficients of det J, or of its numerator and of w^4, and the bounds they give.

    Parameters
    ----------
    plan : Plan
    P : (e, b, c) control points; homogeneous (w, wx, wy, wz) if the plan is rational.
    slack : (c,) how far the true control points may be from the given ones.
    first_group, last_group : which groups of L elements this call works on.
    keep : whether to store coefficients in ``numerator`` (e, k) and ``weight`` (e, k or 0).
    bounds : (e, 4) result: smallest coefficient ratio (-inf where a weight coefficient is not positive), smallest value
        at a vertex, error bound of either, largest |ratio|.
    corner : (e,) result: the vertex with the smallest value.
    """
    elements = P.shape[0]
    rational = plan.components == 4
    rows = plan.rows[-1]
    net = np.empty((P.shape[1], plan.components * L))
    F = np.empty((rows, plan.components * L))
    size = np.empty((len(plan.rows) - 1, plan.components * L))
    left = np.empty((plan.boxes[0], 6 * L))
    right = np.empty((plan.boxes[1], (6 if rational else 3) * L))
    square = np.empty((plan.boxes[2], L))
    low = np.empty((plan.boxes[3] if rational else 0, L))
    result = np.empty((plan.boxes[3], L))
    power = np.empty((plan.boxes[3] if rational else 0, L))
    for group in range(first_group, last_group):
        first = group * L
        _control_net(plan, P, first, net)
        _factors(plan, net, F, size)
        if rational:
            _determinant4(plan, F, left, right, low, result)
            _fourth_power(plan, F, square, power)
        else:
            _determinant3(plan, F, right, result)
        for l in range(min(L, elements - first)):
            e = first + l
            least, largest, thin = np.inf, 0.0, np.inf
            for k in range(len(plan.used)):
                value = result[plan.used[k], l] * plan.factor[k]
                if keep:
                    numerator[e, k] = value
                if rational:
                    below = power[plan.used[k], l] * plan.weight_factor[k]
                    thin = min(thin, below)
                    if keep:
                        weight[e, k] = below
                    value = value / below if below > 0.0 else -np.inf
                # Written so that a NaN ends up in the bound.
                least = value if not (value >= least) else least
                largest = abs(value) if not (abs(value) <= largest) else largest
            lowest = np.inf
            for v in range(len(plan.corners)):
                k = plan.corners[v]
                value = result[plan.used[k], l] * plan.factor[k]
                if rational:
                    value /= power[plan.used[k], l] * plan.weight_factor[k]
                if value < lowest:
                    lowest = value
                    corner[e] = v
            error = _error(plan, net, size, slack, l)
            if rational:
                error /= thin
            bounds[e, 0] = least
            bounds[e, 1] = lowest
            bounds[e, 2] = error
            bounds[e, 3] = largest
