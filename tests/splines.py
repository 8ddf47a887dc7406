"""B-spline cubes for tests of kernels, independent of the geometry sources."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from iga.bernstein import bernstein
from iga.block import Block, Kronecker
from iga.cells import HEXAHEDRON, LINE
from iga.domain import Domain, Facets, Space


def open_knots(p: int, breaks: np.ndarray) -> np.ndarray:
    return np.concatenate([np.full(p, breaks[0]), breaks, np.full(p, breaks[-1])])


def bezier_operators(p: int, breaks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct extraction operators (k, p+1, p+1) of maximal smoothness splines and pattern (spans,)."""
    knots = open_knots(p, breaks)
    local = (np.arange(p + 1) + 0.5) / (p + 1)
    B = bernstein(LINE, p).tabulate(local[:, None], 0)[0]
    operators = []
    for s in range(len(breaks) - 1):
        x = breaks[s] + local * (breaks[s + 1] - breaks[s])
        N = BSpline.design_matrix(x, knots, p).toarray()[:, s : s + p + 1]
        operators.append(np.linalg.solve(B, N).T)
    _, first, pattern = np.unique(np.round(operators, 9), axis=0, return_index=True, return_inverse=True)
    return np.stack(operators)[first], pattern.reshape(-1)


def greville(p: int, breaks: np.ndarray) -> np.ndarray:
    knots = open_knots(p, breaks)
    return np.stack([knots[i + 1 : i + 1 + p].mean() for i in range(len(knots) - p - 1)])


def cube(p: tuple[int, int, int], n: tuple[int, int, int], warp: float = 0.3, breaks=None) -> Domain:
    """Unit cube of maximal smoothness B-splines with an interior map; the six sides are named x0 ... z1."""
    breaks = [np.linspace(0.0, 1.0, m + 1) for m in n] if breaks is None else breaks
    factors, patterns, dofs1, coordinates = [], [], [], []
    for d in range(3):
        C, pattern = bezier_operators(p[d], breaks[d])
        factors.append(C)
        patterns.append(pattern)
        dofs1.append(np.arange(n[d])[:, None] + np.arange(p[d] + 1))
        coordinates.append(greville(p[d], breaks[d]))
    size = [len(c) for c in coordinates]
    e = np.stack([g.ravel() for g in np.meshgrid(*[np.arange(m) for m in n], indexing="ij")], axis=1)
    a, b, c = (dofs1[d][e[:, d]] for d in range(3))
    dofs = ((a[:, :, None, None] * size[1] + b[:, None, :, None]) * size[2] + c[:, None, None, :]).reshape(len(e), -1)
    pattern = np.stack([patterns[d][e[:, d]] for d in range(3)], axis=1)
    block = Block(bernstein(HEXAHEDRON, p), dofs.astype(np.int64), Kronecker(tuple(factors), pattern.astype(np.int64)))
    X = np.stack([g.ravel() for g in np.meshgrid(*coordinates, indexing="ij")], axis=1)
    g = 4 * np.prod(X * (1 - X), axis=1)
    points = X + warp * g[:, None] * np.array([1.0, -1.0, 2.0 / 3.0])
    sides = {}
    for d in range(3):
        for end in (0, 1):
            where = np.flatnonzero(e[:, d] == (n[d] - 1) * end)
            sides["xyz"[d] + str(end)] = (Facets(0, 2 * d + end, where),)
    return Domain(Space((block,), int(np.prod(size))), points, sides)
