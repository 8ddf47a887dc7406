r"""Element size along the edges of a solid, and how many pieces each edge gets.

At samples of every edge the wanted size is the least of

    a share of the diagonal;   SHORT * length of the edge;   TURN / curvature of the edge;
    ASPECT * TURN / curvature of the faces beside it;
    NEAR * distance to edges of the same face, FAR * distance to any other edge, that do not share a vertex.

The size elsewhere is h(x) = min_i (s_i + GRADE |x - x_i|) over all samples, which keeps neighbouring elements alike.

Axis letters: e edge, i sample, k sample on an edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.cad.brep import Brep, curve_points, curve_tangents, surface_frame

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

TURN = 0.8
"""Angle (radians) that an edge, or the normal of a face, may turn within one piece: eight pieces of a circle, of which
a cubic is off by 5e-6 of the radius.
"""
ASPECT = 3.0
"""How often as long as wide elements beside an edge may be: a face's largest curvature is mostly across its edge."""
NEAR = 1.5
"""Size over the distance to another edge of the same face: a triangle so much wider than high, one row of which lies
between them, has the quality 0.97.
"""
FAR = 2.5
"""Size over the distance to an edge of other faces: between walls elements may be flatter than on a face."""
SHORT = 1.25
"""Size over the length of an edge that is shorter than what is wanted: it stays one piece, also if sizes are rounded
down, and what is around it grows from there.
"""
GRADE = 0.5
"""Growth of sizes per distance: elements beside each other differ by half their size at most."""
WIDER, STEEP = 1.5, 1.0
"""Size at the sides of a boundary over their length, and its growth per distance: both larger than inside, because such
sides are shorter than wanted where they must be, and elements are to grow away from them.
"""
SAMPLES = 24
"""Samples of an edge: one that turns once around turns by a quarter of a radian from one to the next."""
BESIDE = 0.01
"""Share of the way from a pole to the middle of the parameters at which curvature is looked at instead."""


@dataclass(frozen=True, eq=False)
class Sizing:
    """Samples (i, 3) and the wanted size (i,) at each."""

    points: Array
    size: Array

    @cached_property
    def telling(self) -> tuple[Array, Array]:
        """Samples that set the size around them, sizes ascending; the others follow from these."""
        order = np.argsort(self.size, kind="stable")
        points, size = np.ascontiguousarray(self.points[order]), self.size[order]
        kept = _telling(points, size, GRADE)
        return points[kept], size[kept]


@njit(cache=True)
def _nearest(a: Any, edge: Any, segments: Any, owner: Any, share: Any, faces_of: Any, near: Any, far: Any) -> Any:
    """Least weighted distance from each sample to segments (s, 2, 3) of edges that share no vertex with its own."""
    result = np.full(len(a), np.inf)
    for i in range(len(a)):
        e = edge[i]
        for s in range(len(segments)):
            o = owner[s]
            if share[e, o]:
                continue
            d0, d1, d2 = (segments[s, 1, 0] - segments[s, 0, 0], segments[s, 1, 1] - segments[s, 0, 1],
                          segments[s, 1, 2] - segments[s, 0, 2])
            r0, r1, r2 = a[i, 0] - segments[s, 0, 0], a[i, 1] - segments[s, 0, 1], a[i, 2] - segments[s, 0, 2]
            t = min(1.0, max(0.0, (r0 * d0 + r1 * d1 + r2 * d2) / (d0 * d0 + d1 * d1 + d2 * d2 + 1e-300)))
            distance = np.sqrt((r0 - t * d0) ** 2 + (r1 - t * d1) ** 2 + (r2 - t * d2) ** 2)
            together = (
                faces_of[e, 0] == faces_of[o, 0] or faces_of[e, 0] == faces_of[o, 1]
                or faces_of[e, 1] == faces_of[o, 0] or faces_of[e, 1] == faces_of[o, 1]
            )
            result[i] = min(result[i], distance * (near if together else far))
    return result


@njit(cache=True)
def _graded(x: Any, points: Any, size: Any, grade: Any) -> Any:
    """Least size[j] + grade |x - points[j]| of each x; sizes ascend."""
    result = np.full(len(x), np.inf)
    for i in range(len(x)):
        for j in range(len(points)):
            room = (result[i] - size[j]) / grade
            if room <= 0.0:
                break
            d = (x[i, 0] - points[j, 0]) ** 2 + (x[i, 1] - points[j, 1]) ** 2 + (x[i, 2] - points[j, 2]) ** 2
            if d < room * room:
                result[i] = size[j] + grade * np.sqrt(d)
    return result


@njit(cache=True)
def _telling(points: Any, size: Any, grade: Any) -> Any:
    """Samples, of ascending sizes, from which no smaller one follows."""
    kept = np.zeros(len(points), dtype=np.int64)
    count = 0
    for i in range(len(points)):
        told = False
        for k in range(count):
            j = kept[k]
            room = (size[i] - size[j]) / grade
            d = (points[i, 0] - points[j, 0]) ** 2 + (points[i, 1] - points[j, 1]) ** 2
            if room * room >= d + (points[i, 2] - points[j, 2]) ** 2:
                told = True
                break
        if not told:
            kept[count] = i
            count += 1
    return kept[:count].copy()


def size_at(sizing: Sizing, x: Array) -> Array:
    """Wanted size (q,) at points (q, 3)."""
    points, size = sizing.telling
    return np.asarray(_graded(np.ascontiguousarray(x), points, size, GRADE))


def size_beside(points: Array, sides: Array, x: Array) -> Array:
    """Size (q,) at points (q, 3) of elements that fit to sides of given lengths (n,) at points (n, 3) of a boundary."""
    order = np.argsort(sides, kind="stable")
    points = np.ascontiguousarray(points[order])
    return np.asarray(_graded(np.ascontiguousarray(x), points, WIDER * sides[order], STEEP))


def normal_curvature(surface: Any, uv: Array) -> Array:
    """Largest absolute normal curvature (q,) of a surface at parameters, from differences of its unit normals."""
    extent = np.array([k[-1] - k[0] for k in surface.knots])
    step = 1e-5 * extent
    low, high = (np.array([k[i] for k in surface.knots]) for i in (0, -1))
    inside = np.clip(uv, low + step, high - step)
    # At a pole one derivative vanishes, and with it all that differences can tell: look beside it.
    middle = 0.5 * (low + high)
    inside += np.where(_at_pole(surface, inside, middle), BESIDE, 0.0)[:, None] * (middle - inside)
    _, du, dv = surface_frame(surface, inside)

    def unit(at: Array) -> Array:
        _, a, b = surface_frame(surface, at)
        n = np.cross(a, b)
        return np.asarray(n / (np.linalg.norm(n, axis=1)[:, None] + 1e-300))

    slopes = []
    for d in range(2):
        shift = np.zeros(2)
        shift[d] = step[d]
        slopes.append((unit(inside + shift) - unit(inside - shift)) / (2.0 * step[d]))
    J = np.stack([du, dv], axis=-1)
    first = np.einsum("qci,qcj->qij", J, J)
    second = np.einsum("qci,qcj->qij", J, np.stack(slopes, axis=-1))
    second = 0.5 * (second + np.swapaxes(second, 1, 2))
    scale = np.trace(first, axis1=1, axis2=2)[:, None, None] * 1e-9 * np.eye(2)
    shape = np.linalg.solve(first + scale, second)
    trace, det = np.trace(shape, axis1=1, axis2=2), np.linalg.det(shape)
    return np.asarray(0.5 * np.abs(trace) + np.sqrt(np.maximum(0.25 * trace**2 - det, 0.0)))


def _at_pole(surface: Any, uv: Array, middle: Array) -> Mask:
    """Where one of the two derivatives is a thousandth of what it is in the middle, or less."""
    here = np.linalg.norm(np.stack(surface_frame(surface, uv)[1:]), axis=-1)
    there = np.linalg.norm(np.stack(surface_frame(surface, middle[None])[1:]), axis=-1)
    return np.asarray((here < 1e-3 * there).any(axis=0))


def size_edges(brep: Brep, size: float) -> tuple[Sizing, list[Array]]:
    """Wanted sizes along all edges.

    Parameters
    ----------
    size : largest element, relative to the diagonal.

    Returns
    -------
    The samples, and for every edge the graded size (k,) at equally spaced parameters (empty if degenerate).
    """
    t = np.linspace(0.0, 1.0, SAMPLES)
    live = [e for e, edge in enumerate(brep.edges) if not edge.degenerate]
    place = {e: i for i, e in enumerate(live)}
    x = np.stack([curve_points(brep.edges[e].curve, t) for e in live])
    wanted = np.full((len(live), SAMPLES), size * brep.diagonal)
    for i, e in enumerate(live):
        T = curve_tangents(brep.edges[e].curve, t)
        T = T / (np.linalg.norm(T, axis=1)[:, None] + 1e-300)
        step = np.linalg.norm(np.diff(x[i], axis=0), axis=1) + 1e-300
        bend = np.linalg.norm(np.diff(T, axis=0), axis=1) / step
        curvature = np.maximum(np.append(bend, bend[-1]), np.insert(bend, 0, bend[0]))
        wanted[i] = np.minimum(wanted[i], TURN / (curvature + 1e-300))
        # A short edge is one piece, and what is around it must grow from there.
        wanted[i] = np.minimum(wanted[i], SHORT * step.sum())
        for f, k, j in brep.coedges_of[e]:
            face = brep.faces[f]
            if face.kind != "plane":
                beside = normal_curvature(face.surface, curve_points(face.loops[k][j].curve, t))
                wanted[i] = np.minimum(wanted[i], ASPECT * TURN / (beside + 1e-300))
    ends = np.array([brep.edges[e].vertices for e in live])
    share = (ends[:, None, :, None] == ends[None, :, None, :]).any(axis=(2, 3))
    faces = np.array([([f for f, _, _ in brep.coedges_of[e]] * 2)[:2] for e in live], dtype=np.int64)
    segments = np.stack([x[:, :-1], x[:, 1:]], axis=2).reshape(-1, 2, 3)
    owner = np.repeat(np.arange(len(live)), SAMPLES - 1)
    points = x.reshape(-1, 3)
    distance = _nearest(points, np.repeat(np.arange(len(live)), SAMPLES), segments, owner, share, faces, NEAR, FAR)
    floor = 1e-6 * brep.diagonal
    raw = Sizing(points, np.maximum(np.minimum(wanted.ravel(), distance), floor))
    graded = size_at(raw, points).reshape(len(live), SAMPLES)
    empty = np.empty(0)
    return Sizing(points, graded.ravel()), [graded[place[e]] if e in place else empty for e in range(len(brep.edges))]


def divide_edge(brep: Brep, edge: int, wanted: Array, least: int) -> Array:
    """Parameters (n + 1,) of the ends of an edge's pieces, equal in length measured by the wanted size."""
    t = np.linspace(0.0, 1.0, 16 * (SAMPLES - 1) + 1)
    x = curve_points(brep.edges[edge].curve, t)
    h = np.interp(0.5 * (t[1:] + t[:-1]), np.linspace(0.0, 1.0, SAMPLES), wanted)
    measure = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1) / h)])
    count = max(least, int(np.ceil(measure[-1] - 1e-9)))
    ends = np.interp(np.linspace(0.0, measure[-1], count + 1), measure, t)
    ends[0], ends[-1] = 0.0, 1.0
    return ends
