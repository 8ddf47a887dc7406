r"""Volume and area of a trimmed B-rep from its surfaces and trimming curves, by Green's theorem in parameter planes.

For a face with surface S over Omega and outward normal n = +-S_u x S_v

    V = sum 1/3 int (S - c) . n du dv,   A = sum int |n| du dv,   N = sum int n du dv,   int_Omega F = closed int P dv,
    P(u, v) = int_{u_0}^{u} F(s, v) ds,

by Gauss rules between knots; along trimming curves intervals are halved until their integrals change no more.

On a closed surface N = 0. Where a file's faces do not meet, N measures it: V depends on the centre c by N . dc / 3, so
no integral over such faces is known better than |N| D / 6 (c moved by half the diagonal D), whoever integrates it. What
lies between them is closed by ruled strips from the trimming curve S(c(t)) of each face to the edge C(t),

    x(s, t) = S(c(t)) + s (C(t) - S(c(t))),   s in [0, 1],

whose ends meet at the vertices; with them N = 0 and V is that of a closed body, about any centre.

Axis letters: f face, e edge, k interval, q point of a curve, s point on the way to it, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face, curve_points, curve_tangents, surface_frame

Array = NDArray[np.float64]

POINTS = 8
"""Gauss points on an interval."""
DEEPEST = 8
"""Most halvings of an interval."""
ENOUGH = 1e-9
"""Change of an interval's integral, relative to the face's largest, below which it is halved no more."""
_X, _W = np.polynomial.legendre.leggauss(POINTS)
_X, _W = 0.5 * (1.0 + _X), 0.5 * _W


@dataclass(frozen=True, eq=False)
class Integrals:
    """Integrals over faces, or strips: (f,) share in the volume about the middle of the vertices, (f,) area, (f, 3)
    normal.
    """

    volume: Array
    area: Array
    normal: Array


def integrals_of(brep: Brep) -> Integrals:
    """Integrals over all faces of a solid."""
    centre = brep.vertices.mean(axis=0)
    found = np.array([_face(face, centre) for face in brep.faces])
    return Integrals(found[:, 0], found[:, 1], found[:, 2:])


def strips_of(brep: Brep) -> Integrals:
    """Integrals over the strips at each edge (e,) that close what the faces leave open; zero at degenerate edges.

    The area is that of the strips, which may be folded: only its size says something.
    """
    centre = brep.vertices.mean(axis=0)
    found = np.array([_strips(brep, e, centre) for e in range(len(brep.edges))])
    return Integrals(found[:, 0], found[:, 1], found[:, 2:])


def closed_volume(found: Integrals, strips: Integrals) -> float:
    """Volume of the faces with the strips between them."""
    return float(found.volume.sum() + strips.volume.sum())


def volume_spread(brep: Brep, found: Integrals) -> float:
    """By how much the volume is undetermined because faces do not close, relative to it."""
    gap = float(np.linalg.norm(found.normal.sum(axis=0)))
    return gap * brep.diagonal / 6.0 / abs(float(found.volume.sum()))


def _face(face: Face, centre: Array) -> Array:
    """Volume, area and normal (5,) of a face."""
    coedges = [c for loop in face.loops for c in loop]
    start = float(min(c.curve.control[:, 0].min() for c in coedges))
    ends = [np.unique(c.curve.knots) for c in coedges]
    which = np.repeat(np.arange(len(coedges)), [len(t) - 1 for t in ends])
    a, b = np.concatenate([t[:-1] for t in ends]), np.concatenate([t[1:] for t in ends])

    def between(which: NDArray[np.int64], a: Array, b: Array) -> Array:
        """Integrals (k, 5) of P dv over intervals of coedges."""
        t = a[:, None] + (b - a)[:, None] * _X
        uv, slope = np.zeros((*t.shape, 2)), np.zeros(t.shape)
        for k in np.unique(which).tolist():
            own = which == k
            uv[own] = curve_points(coedges[k].curve, t[own].ravel()).reshape(-1, POINTS, 2)
            sign = -1.0 if coedges[k].reversed else 1.0
            slope[own] = sign * curve_tangents(coedges[k].curve, t[own].ravel())[:, 1].reshape(-1, POINTS)
        P = _inner(face, uv.reshape(-1, 2), start, centre).reshape(*t.shape, 5)
        return np.asarray(np.einsum("kq,kqi->ki", (b - a)[:, None] * _W * slope, P))

    whole = between(which, a, b)
    reach = float(np.linalg.norm(face.surface.control[..., :3] - centre, axis=-1).max())
    # A component may vanish on the whole face: all are measured by the area.
    scale = np.abs(whole[:, 1]).max() * np.array([reach / 3.0, 1.0, 1.0, 1.0, 1.0])
    total = np.zeros(5)
    for _ in range(DEEPEST):
        m = 0.5 * (a + b)
        halves = between(np.concatenate([which, which]), np.concatenate([a, m]), np.concatenate([m, b]))
        left, right = np.split(halves, 2)
        go = (np.abs(left + right - whole) > ENOUGH * scale + 1e-300).any(axis=1)
        total += (left + right)[~go].sum(axis=0)
        which = np.concatenate([which[go], which[go]])
        a, b = np.concatenate([a[go], m[go]]), np.concatenate([m[go], b[go]])
        whole = np.concatenate([left[go], right[go]])
        if not go.any():
            break
    total += whole.sum(axis=0)
    # Loops have the inside on their left in the parameter plane, whichever side of the surface is outside.
    signs = np.array([-1.0, 1.0, -1.0, -1.0, -1.0]) if face.reversed else np.ones(5)
    return np.asarray(signs * total)


def _strips(brep: Brep, number: int, centre: Array) -> Array:
    """Volume, area and normal (5,) of the strips between an edge and its faces."""
    edge, total = brep.edges[number], np.zeros(5)
    if edge.degenerate:
        return total
    for f, k, j in brep.coedges_of[number]:
        face, c = brep.faces[f], brep.faces[f].loops[k][j]
        ends = np.unique(np.concatenate([edge.curve.knots, c.curve.knots]))
        length = np.repeat(np.diff(ends), POINTS)
        t = np.repeat(ends[:-1], POINTS) + length * np.tile(_X, len(ends) - 1)
        x, du, dv = surface_frame(face.surface, curve_points(c.curve, t))
        slope = curve_tangents(c.curve, t)
        dx, way = du * slope[:, :1] + dv * slope[:, 1:], curve_points(edge.curve, t) - x
        turn = curve_tangents(edge.curve, t) - dx
        # The integrands are of degree two in s.
        at = np.array([0.5 - np.sqrt(1.0 / 12.0), 0.5 + np.sqrt(1.0 / 12.0)])[:, None, None]
        n = np.cross(way, dx + at * turn)
        F = np.stack([np.einsum("sqc,sqc->sq", x + at * way - centre, n) / 3.0, np.linalg.norm(n, axis=-1),
                      *np.moveaxis(n, -1, 0)])  # fmt: skip
        sign = -1.0 if c.reversed != face.reversed else 1.0
        signs = np.array([sign, 1.0, sign, sign, sign])
        total += signs * (0.5 * F.sum(axis=1) @ (length * np.tile(_W, len(ends) - 1)))
    return np.asarray(total)


def _inner(face: Face, uv: Array, start: float, centre: Array) -> Array:
    """P (q, 5) at parameters, by Gauss rules between knots."""
    lines = np.unique(face.surface.knots[0])
    edges = np.concatenate([[start], lines[lines > start], [np.inf]])
    total = np.zeros((len(uv), 5))
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist()):
        q = np.flatnonzero(uv[:, 0] > low)
        if not len(q):
            break
        length = np.minimum(uv[q, 0], high) - low
        s = low + length[:, None] * _X
        at = np.stack([s, np.broadcast_to(uv[q, 1, None], s.shape)], axis=-1).reshape(-1, 2)
        x, du, dv = surface_frame(face.surface, at)
        n = np.cross(du, dv)
        F = np.column_stack([np.einsum("qc,qc->q", x - centre, n) / 3.0, np.linalg.norm(n, axis=1), n])
        total[q] += length[:, None] * np.einsum("s,qsk->qk", _W, F.reshape(len(q), POINTS, 5))
    return total
