r"""Edges and vertices of a file moved to where its faces meet.

CAD files give an edge C(t) within a tolerance of its two faces, and often on one of them alone, so a skin through C
stays off the other by as much as the file says. With signed distances d_f along the unit normals n_f of the faces at
the feet of a point x, the point is moved by the shortest step that puts it on all tangent planes,

    x <- x + N^T (N N^T + DAMP^2 I)^-1 d,      N = rows n_f,

a few times: to the intersection of the faces where they cross, half way between them where they touch. Edges that end
beside their vertices, as files allow and blends do, are first moved by a linear function of t so that they end there.

Axis letters: q point, f face, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Curve, Edge, curve_points, fit_curve
from geometry.hybrid.fitting import project
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DAMP = 0.1
"""Sine of the angle between faces below which they count as touching."""
ROUNDS = 3
"""Steps to the faces: each leaves a hundredth of the distance where these cross at a right angle, by `DAMP`."""
NEAR = 1e-7
"""Distance, relative to the diagonal, of an edge from its faces that is left as it is."""
FIT, ENOUGH = 1e-8, 1e-6
"""Distances, relative to the diagonal, of the new curve from its points, the second for short pieces."""
SAMPLES = 33
"""Samples of an edge at which its distance is measured."""
ENDS = np.array([0.0, 1.0])


def edge_distances(brep: Brep, samples: int = SAMPLES) -> Array:
    """Largest sampled distance (e,) of each edge from its faces, along their normals; zero for degenerate edges."""
    t = np.linspace(0.0, 1.0, samples)
    found = np.zeros(len(brep.edges))
    for e, edge in enumerate(brep.edges):
        if not edge.degenerate:
            _, gap, _ = _feet(brep, brep.coedges_of[e], curve_points(edge.curve, t), t)
            found[e] = np.abs(gap).max(initial=0.0)
    return found


def met(brep: Brep, off: Array) -> Brep:
    """The solid with the edges that lie off their faces, and the vertices at their ends, moved to both faces, and edges
    ended at their vertices.

    Parameters
    ----------
    off : (e,) as `edge_distances` gives it.
    """
    wrong = np.flatnonzero(off > NEAR * brep.diagonal).tolist()
    vertices = brep.vertices.copy()
    uses: dict[int, list[tuple[int, int, int]]] = {}
    places: dict[int, list[float]] = {}
    for e, edge in enumerate(brep.edges):
        if not edge.degenerate:
            for end, v in enumerate(edge.vertices):
                uses.setdefault(v, []).extend(brep.coedges_of[e])
                places.setdefault(v, []).extend([float(end)] * len(brep.coedges_of[e]))
    for v in sorted({v for e in wrong for v in brep.edges[e].vertices}):
        ends = np.array(places[v])
        x = vertices[v][None]
        for _ in range(ROUNDS):
            x = x + closing_moves(*_vertex_feet(brep, uses[v], x, ends))
        vertices[v] = x[0]
    edges = list(brep.edges)
    for e, edge in enumerate(edges):
        away = brep.vertices[list(edge.vertices)] - curve_points(edge.curve, ENDS)
        if e in wrong or (not edge.degenerate and np.linalg.norm(away, axis=1).max() > NEAR * brep.diagonal):
            edges[e] = _moved(brep, e, away)
    return replace(brep, edges=tuple(edges), vertices=vertices)


def _moved(brep: Brep, number: int, away: Array) -> Edge:
    """An edge on its faces, its ends moved by ``away`` (2, 3)."""
    edge, uses = brep.edges[number], brep.coedges_of[number]

    def points(t: Array) -> Array:
        x = curve_points(edge.curve, t) + (1.0 - t)[:, None] * away[0] + t[:, None] * away[1]
        for _ in range(ROUNDS):
            x = x + closing_moves(*_feet(brep, uses, x, t)[1:])
        return x

    breaks = np.unique(edge.curve.knots)
    try:
        curve: Curve = fit_curve(points, FIT * brep.diagonal, breaks=breaks, enough=ENOUGH * brep.diagonal)
    except InputError:  # its points do not lie on a curve: stay with what the file says
        return edge
    return replace(edge, curve=curve)


def _feet(brep: Brep, uses: tuple[tuple[int, int, int], ...], x: Array, t: Array) -> tuple[Array, Array, Array]:
    """Parameters (f, q, 2), signed distances (f, q) and normals (f, q, 3) of the feet of points of an edge at t."""
    found = []
    for f, k, j in uses:
        face = brep.faces[f]
        found.append(project(face, curve_points(face.loops[k][j].curve, t), x))
    uv, gap, normal = (np.stack(own) for own in zip(*found))
    return uv, gap, normal


def _vertex_feet(brep: Brep, uses: list[tuple[int, int, int]], x: Array, ends: Array) -> tuple[Array, Array]:
    """Signed distances (f, 1) and normals (f, 1, 3) of one point from the faces around a vertex."""
    found = [_feet(brep, (use,), x, np.array([end]))[1:] for use, end in zip(uses, ends.tolist())]
    return np.concatenate([gap for gap, _ in found]), np.concatenate([normal for _, normal in found])


def closing_moves(gap: Array, normal: Array) -> Array:
    """Shortest damped moves (q, 3) that close signed distances (f, q) along normals (f, q, 3)."""
    N, d = np.swapaxes(normal, 0, 1), gap.T
    A = np.einsum("qfc,qgc->qfg", N, N) + DAMP**2 * np.eye(N.shape[1])
    return np.asarray(np.einsum("qfc,qf->qc", N, np.linalg.solve(A, d[..., None])[..., 0]))
