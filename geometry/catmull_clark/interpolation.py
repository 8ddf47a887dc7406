r"""Control meshes whose limit volume passes through given vertices.

With M the limit matrix, interpolation asks for M P = V. Its rows for corners, creases, the boundary and the interior
depend on the same and earlier groups only (nothing inside influences the boundary), so each group is solved with the
earlier ones fixed.

* `pia`: v <- v + w (V - M v), the progressive-iterative approximation of Xie et al. 2020, eqs. (10), (11), boundary
  first; w = 1 is the paper's, w up to 1.8 is faster.
* `conjugate`: the same fixed point by conjugate gradients. D M is symmetric positive definite with D = 27 times the
  number of cells inside, N (N+5) on the boundary and 6 on creases.
* `direct`: one sparse factorisation per group, the reference.
* `push_back`: eqs. (5)-(9). The result lives on the once refined connectivity and interpolates by construction.
* `through_butterfly`: the points of one level of the interpolating scheme of `butterfly`, then PIA through all of them,
  on the once refined connectivity. The scheme's own limit is no polynomial; this volume shares its points of one level.

On a smooth closed boundary whose vertices all have three boundary faces (the surface of a cube, so of a single block
or of the seven-block ball) M is singular: its null vector alternates by parity, and only data without that component
can be interpolated by the first three. `singular_pieces` finds it.

Axis letters: v vertex, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from geometry.catmull_clark.butterfly import butterfly
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import CORNER, CREASE, INTERIOR, SMOOTH, Topology
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Parameter = float | Array

TOLERANCE = 1e-14
"""Interpolation error, relative to the size of the mesh: rounding."""


@dataclass(frozen=True, eq=False)
class Interpolation:
    """An interpolating control mesh.

    Attributes
    ----------
    topology : connectivity of the control mesh; the given vertices come first in it.
    values : (v', c) control values.
    error : largest distance of a limit point from its vertex, over the diagonal of the given values.
    history : for each group solved by iteration ("boundary", "interior", ..) the residual after each step, as error.
    singular : vertices of boundary pieces on which the limit matrix is singular.
    """

    topology: Topology
    values: Array
    error: float
    history: dict[str, Array]
    singular: Index

    @property
    def factor(self) -> float:
        """Convergence factor of the slowest group, measured over the last ten steps; 0 if nothing was iterated."""
        factors = [
            float((h[-1] / h[-11]) ** 0.1) for h in self.history.values() if len(h) > 11 and h[-1] > 0 and h[-11] > 0
        ]
        return max(factors, default=0.0)


_GROUPS = ((CREASE, "creases"), (SMOOTH, "boundary"), (INTERIOR, "interior"))


def singular_pieces(topology: Topology) -> Index:
    """Vertices of smooth closed boundary pieces whose vertices all have three boundary faces."""
    outer = np.unique(topology.face_edges[topology.boundary_faces])
    ends = topology.edges[outer]
    n = topology.vertices
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    outside = topology.vertex_kind != INTERIOR
    fine = outside & ((topology.boundary_valence != 3) | (topology.vertex_kind != SMOOTH))
    bad = np.ones(n, dtype=bool)
    bad[label[fine]] = False
    return np.flatnonzero(outside & bad[label])


def symmetriser(topology: Topology) -> Array:
    """Diagonal D (v,) such that D M is symmetric."""
    N = topology.boundary_valence
    scale = np.choose(topology.vertex_kind, [1.0, 6.0, N * (N + 5.0), 27.0 * topology.vertex_cells])
    return np.asarray(scale, dtype=np.float64)


def diagonal(values: Array) -> float:
    """Length of the diagonal of the box around values (v, c); 1 if they are all equal."""
    return float(np.linalg.norm(np.ptp(values, axis=0))) or 1.0


def _finish(
    topology: Topology, values: Array, given: Array, history: dict[str, Array], limit: csr_array | None = None
) -> Interpolation:
    limit = limit_matrix(topology) if limit is None else limit
    error = float(np.abs((limit @ values)[: len(given)] - given).max()) / diagonal(given)
    return Interpolation(topology, values, error, history, singular_pieces(topology))


def plain(topology: Topology, given: Array) -> Interpolation:
    """Use the vertices (v, c) themselves as control points: the approximating limit."""
    return _finish(topology, given, given, {})


def pia(
    topology: Topology, given: Array, relaxation: float = 1.0, tolerance: float = TOLERANCE, iterations: int = 3000
) -> Interpolation:
    """Progressive-iterative approximation, group by group.

    Parameters
    ----------
    given : (v, c) vertices to interpolate.
    relaxation : w in (0, 2).
    tolerance : stop when the residual, relative to the diagonal, is below this or has stopped falling.

    Raises
    ------
    InputError : the relaxation factor lies outside (0, 2).
    """
    if not 0.0 < relaxation < 2.0:
        raise InputError(f"the relaxation factor of PIA must lie between 0 and 2, not {relaxation:g}")

    def sweep(A: csr_array, b: Array, x: Array, scale: Array, size: float) -> tuple[Array, Array]:
        history = []
        best = np.inf
        since = 0
        for _ in range(iterations):
            residual = b - A @ x
            history.append(float(np.abs(residual).max()) / size)
            since = 0 if history[-1] < 0.99 * best else since + 1
            best = min(best, history[-1])
            if history[-1] <= tolerance or since > 40:
                break
            x = x + relaxation * residual
        return x, np.array(history)

    return _by_group(topology, given, sweep)


def conjugate(
    topology: Topology, given: Array, tolerance: float = TOLERANCE, iterations: int = 1000
) -> Interpolation:
    """Conjugate gradients on the symmetric form D M, all components at once; parameters as in `pia`."""

    def sweep(A: csr_array, b: Array, x: Array, scale: Array, size: float) -> tuple[Array, Array]:
        history = []
        r = b - A @ x
        p = r.copy()
        rho = np.einsum("vc,v,vc->c", r, scale, r)
        best, since, kept = np.inf, 0, x
        for _ in range(iterations):
            history.append(float(np.abs(r).max()) / size)
            since = 0 if history[-1] < best else since + 1
            if history[-1] < best:
                best, kept = history[-1], x
            if best <= tolerance or since > 40 or not rho.any():
                break
            q = A @ p
            curve = np.einsum("vc,v,vc->c", p, scale, q)
            alpha = np.divide(rho, curve, out=np.zeros_like(rho), where=curve > 0)
            x = x + alpha * p
            r = r - alpha * q
            new = np.einsum("vc,v,vc->c", r, scale, r)
            p = r + np.divide(new, rho, out=np.zeros_like(rho), where=rho > 0) * p
            rho = new
        return kept, np.array(history)

    return _by_group(topology, given, sweep)


def direct(topology: Topology, given: Array) -> Interpolation:
    """Sparse factorisation of each group; on a singular boundary the interpolating solution of least change.

    Raises
    ------
    InputError : the limit matrix is singular and the data cannot be interpolated (see the module docstring).
    """
    bad = singular_pieces(topology)

    def solve(A: csr_array, b: Array, x: Array, scale: Array, size: float) -> tuple[Array, Array]:
        if len(bad) and len(b) <= len(bad):
            return np.linalg.lstsq(A.toarray(), b - A @ x, rcond=1e-12)[0] + x, np.zeros(0)
        return splu(A.tocsc()).solve(b), np.zeros(0)

    result = _by_group(topology, given, solve)
    if len(bad) and result.error > 1e-9:
        raise InputError(
            f"all vertices of the boundary around vertex {bad[0]} have three boundary faces, where only symmetric data "
            "can be interpolated directly: use interpolate=pushback or features=auto"
        )
    return result


Sweep = Callable[[csr_array, Array, Array, Array, float], tuple[Array, Array]]


def _by_group(topology: Topology, given: Array, sweep: Sweep) -> Interpolation:
    """Solve M x = given for creases, boundary and interior in turn, with the earlier groups fixed."""
    M = limit_matrix(topology)
    scale = symmetriser(topology)
    size = diagonal(given)
    values = given.copy()
    history = {}
    known = topology.vertex_kind == CORNER
    for kind, name in _GROUPS:
        group = np.flatnonzero(topology.vertex_kind == kind)
        if not len(group):
            continue
        rows = M[group]
        right = given[group] - rows[:, np.flatnonzero(known)] @ values[known]
        values[group], steps = sweep(rows[:, group], right, values[group], scale[group], size)
        if len(steps):
            history[name] = steps
        known[group] = True
    return _finish(topology, values, given, history, M)


def push_back(
    topology: Topology, given: Array, lam: Parameter = 0.25, mu: Parameter = 0.125, gamma: Parameter = 0.0625
) -> Interpolation:
    """Push-back construction on the once refined connectivity, eqs. (5)-(9).

    Parameters
    ----------
    given : (v, c).
    lam, mu, gamma : shape parameters in (0, 1), numbers or one per edge, face, cell.

    Raises
    ------
    InputError : a parameter lies outside (0, 1) or has the wrong length.
    """
    lam = _parameter("lambda", lam, len(topology.edges), "edge")
    mu = _parameter("mu", mu, len(topology.faces), "face")
    gamma = _parameter("gamma", gamma, len(topology.hexes), "cell")
    fine, S = subdivide(topology)
    v, m, f = topology.vertices, len(topology.edges), len(topology.faces)
    delta = given - (S[:v] @ given)
    values = np.empty((S.shape[0], given.shape[1]))
    values[v : v + m] = given[topology.edges].mean(axis=1) + lam * delta[topology.edges].sum(axis=1)
    values[v + m : v + m + f] = given[topology.faces].mean(axis=1) + 2.0 * mu * delta[topology.faces].sum(axis=1)
    values[v + m + f :] = given[topology.hexes].mean(axis=1) + 2.0 * gamma * delta[topology.hexes].sum(axis=1)
    # No two old vertices are neighbours in the refined mesh: each limit mask has one unknown.
    limit = limit_matrix(fine)
    mask = limit[:v]
    own = mask.diagonal()
    values[:v] = 0.0
    values[:v] = (given - mask @ values) / own[:, None]
    return _finish(fine, values, given, {}, limit)


def through_butterfly(topology: Topology, given: Array, relaxation: float = 1.0) -> Interpolation:
    """PIA through the points of one level of the butterfly scheme; the given vertices (v, c) are among them."""
    fine, S = butterfly(topology)
    return pia(fine, S @ given, relaxation)


def _parameter(name: str, value: Parameter, count: int, entity: str) -> Array:
    values = np.asarray(value, dtype=float)
    if values.ndim and values.shape != (count,):
        raise InputError(f"{name} needs one number, or one for each {entity} ({count}), not {values.shape}")
    if values.ndim:
        bad = np.flatnonzero(~((values > 0) & (values < 1)))
        if len(bad):
            raise InputError(f"{name} of {entity} {bad[0]} is {values[bad[0]]:g}; it must lie between 0 and 1")
    elif not 0 < float(values) < 1:
        raise InputError(f"{name} must lie between 0 and 1, not {float(values):g}")
    return np.broadcast_to(values.reshape(-1, 1), (count, 1))
