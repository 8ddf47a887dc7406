r"""Trimmed boundary representation of one solid, as plain arrays.

    face   x = S(u, v), a B-spline or NURBS surface (`geometry.patch.Patch` with two directions), trimmed by loops
    loop   closed chain of coedges; a coedge is an edge with its curve c(t) in the parameter plane of the face
    edge   C(t) in space, t in [0, 1], shared by the two faces that it separates:  S_1(c_1(t)) ~ C(t) ~ S_2(c_2(t))

Curves are piecewise polynomials fitted to a tolerance (`fit_curve`); their parameter is that of the edge on both sides.
Loops run with the inside of the face on their left in the (u, v) plane, the outer loop first.

Axis letters: q point, n control point, c component, v vertex.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.cad.evaluation import curve_values, surface_values
from geometry.knots import evaluation
from geometry.patch import Patch
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

MAX_PIECES = 4096
"""Most pieces of one curve: one that wants more is not smooth."""
OFF = 5e-4
"""Largest distance, relative to the diagonal, of an edge from its faces."""
SHORT = 1.0 / 300.0
"""Share of a curve below which a piece is short."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Polynomial spline curve on [0, 1].

    Attributes
    ----------
    knots : (n + degree + 1,), each end repeated degree + 1 times.
    control : (n, c) control points, c = 2 in a parameter plane and 3 in space.
    """

    knots: Array
    control: Array

    @property
    def degree(self) -> int:
        """Polynomial degree."""
        return len(self.knots) - len(self.control) - 1


def curve_points(curve: Curve, t: Array) -> Array:
    """Points (q, c) of a curve at parameters (q,)."""
    return np.asarray(curve_values(curve.knots, curve.control, np.asarray(t, dtype=float), False))


def curve_tangents(curve: Curve, t: Array) -> Array:
    """Derivatives (q, c) of a curve at parameters (q,)."""
    return np.asarray(curve_values(curve.knots, curve.control, np.asarray(t, dtype=float), True))


@dataclass(frozen=True, eq=False)
class Edge:
    """A curve in space between two vertices.

    Attributes
    ----------
    curve : C(t); all control points equal where the edge is degenerate (the pole of a sphere).
    vertices : numbers of the vertices at t = 0 and t = 1.
    tolerance : the distance within which the CAD kernel vouches for the edge.
    degenerate : the edge is a point in space.
    """

    curve: Curve
    vertices: tuple[int, int]
    tolerance: float
    degenerate: bool


@dataclass(frozen=True, eq=False)
class Coedge:
    """An edge in a loop of a face.

    Attributes
    ----------
    edge : its number.
    reversed : the loop runs through the edge from t = 1 to t = 0.
    curve : c(t) in the parameter plane, in the edge's own direction.
    """

    edge: int
    reversed: bool
    curve: Curve


@dataclass(frozen=True, eq=False)
class Face:
    """A trimmed surface.

    Attributes
    ----------
    surface : S(u, v) on a rectangle that holds the loops.
    loops : coedges in order, the outer loop first.
    reversed : S_u x S_v points into the solid.
    kind : what the CAD file calls the surface (plane, cylinder, ...).
    name : name from the file, or "face_N" with the number N of the face in the file; pieces of a closed face share it.
    colour : "#rrggbb" or "".
    """

    surface: Patch
    loops: tuple[tuple[Coedge, ...], ...]
    reversed: bool
    kind: str
    name: str
    colour: str = ""


@dataclass(frozen=True, eq=False)
class Brep:
    """A solid bounded by trimmed surfaces, closed and oriented: every edge that is not degenerate has two coedges.

    Attributes
    ----------
    vertices : (v, 3)
    edges, faces : see their types.
    name : name of the solid, or "".
    volume, area : as the CAD kernel integrates them: the volume to about 1e-6, the area to 2e-4 on long thin faces.
    """

    vertices: Array
    edges: tuple[Edge, ...]
    faces: tuple[Face, ...]
    name: str
    volume: float
    area: float

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the box around all edge curves and vertices."""
        points = np.concatenate([self.vertices, *(e.curve.control for e in self.edges)])
        return float(np.linalg.norm(np.ptp(points, axis=0)))

    @cached_property
    def coedges_of(self) -> tuple[tuple[tuple[int, int, int], ...], ...]:
        """For each edge its uses: (face, loop, place in the loop)."""
        uses: list[list[tuple[int, int, int]]] = [[] for _ in self.edges]
        for f, face in enumerate(self.faces):
            for k, loop in enumerate(face.loops):
                for i, coedge in enumerate(loop):
                    uses[coedge.edge].append((f, k, i))
        return tuple(map(tuple, uses))


def surface_points(surface: Patch, uv: Array) -> Array:
    """Points (q, 3) of a surface at parameters (q, 2)."""
    return surface_frame(surface, uv)[0]


def surface_frame(surface: Patch, uv: Array) -> tuple[Array, Array, Array]:
    """Points and the two tangents of a surface at parameters (q, 2), each (q, 3)."""
    weights = np.ones(surface.control.shape[:2]) if surface.weights is None else surface.weights
    ku, kv = surface.knots
    frame = surface_values(ku, kv, surface.control, weights, np.ascontiguousarray(uv, dtype=float))
    return frame[:, 0], frame[:, 1], frame[:, 2]


def fit_curve(
    points: Callable[[Array], Array], tolerance: float, degree: int = 5, breaks: Array | None = None,
    enough: float = 0.0,
) -> Curve:  # fmt: skip
    """Piecewise polynomial through points of a curve, halved until it is within a tolerance.

    Each piece interpolates at Chebyshev-Lobatto parameters, so pieces join without a gap, and is checked half way
    between them.

    Parameters
    ----------
    points : function from parameters (q,) in [0, 1] to points (q, c).
    tolerance : largest distance at equal parameters.
    breaks : ends of the pieces to begin with, from 0 to 1; where the curve is less smooth.
    enough : larger tolerance that short pieces may have, where halving does not help (corners, noise).

    Raises
    ------
    InputError : more than 4096 pieces are needed.
    """
    k = np.arange(degree + 1)
    nodes = 0.5 * (1.0 - np.cos(np.pi * k / degree))
    between = 0.5 * (1.0 - np.cos(np.pi * (k[:-1] + 0.5) / degree))
    to_bernstein = np.linalg.inv(_bernstein(degree, nodes))
    check = _bernstein(degree, between) @ to_bernstein
    todo = list(pairwise([0.0, 1.0] if breaks is None else breaks.tolist()))
    done: list[tuple[float, float, Array]] = []
    while todo:
        low = np.array([a for a, _ in todo])[:, None]
        high = np.array([b for _, b in todo])[:, None]
        at = low + (high - low) * np.concatenate([nodes, between])
        at[:, degree] = high[:, 0]
        x = points(at.ravel()).reshape(len(todo), len(nodes) + len(between), -1)
        error = np.linalg.norm(check @ x[:, : degree + 1] - x[:, degree + 1 :], axis=-1).max(axis=1)
        again = []
        for i, (a, b) in enumerate(todo):
            if error[i] <= tolerance or (error[i] <= enough and b - a < SHORT):
                control = to_bernstein @ x[i, : degree + 1]
                control[0], control[-1] = x[i, 0], x[i, degree]
                done.append((a, b, control))
            else:
                again += [(a, 0.5 * (a + b)), (0.5 * (a + b), b)]
        if len(done) + len(again) > MAX_PIECES:
            raise InputError(f"a curve needs more than {MAX_PIECES} pieces to be met within {tolerance:.1e}")
        todo = again
    done.sort(key=lambda piece: piece[0])
    knots = np.concatenate([[0.0], *(np.full(degree, a) for a, _, _ in done), np.full(degree + 1, 1.0)])
    return Curve(knots, np.concatenate([done[0][2][:1], *(control[1:] for _, _, control in done)]))


def _bernstein(degree: int, t: Array) -> Array:
    knots = np.repeat([0.0, 1.0], degree + 1)
    return evaluation(knots, degree, t).values


def winding(face: Face, uv: Array) -> Mask:
    """Whether points (q, 2) of the parameter plane lie inside the loops: crossings of the ray towards +u."""
    t = np.linspace(0.0, 1.0, 65)
    rings = []
    for loop in face.loops:
        rings.append(np.concatenate([curve_points(c.curve, t[::-1] if c.reversed else t)[:-1] for c in loop]))
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    p, q = uv[:, None, 1], uv[:, None, 0]
    crossed = (start[:, 1] > p) != (end[:, 1] > p)
    rise = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    at = start[:, 0] + (p - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return np.asarray((crossed & (at > q)).sum(axis=1) % 2 == 1)


def sealing_gap(brep: Brep, samples: int = 9) -> Array:
    """Largest distance of each edge (e,) between its curve and the curves on its faces, at equal parameters."""
    t = np.linspace(0.0, 1.0, samples)
    gap = np.zeros(len(brep.edges))
    for face in brep.faces:
        for loop in face.loops:
            for coedge in loop:
                on = surface_points(face.surface, curve_points(coedge.curve, t))
                apart = np.linalg.norm(on - curve_points(brep.edges[coedge.edge].curve, t), axis=1).max()
                gap[coedge.edge] = max(gap[coedge.edge], apart)
    return gap


def check_brep(brep: Brep, where: str) -> None:
    """Refuse a boundary that is not closed, whose loops have gaps, or whose edges lie off their faces.

    Raises
    ------
    InputError : naming the edge or face.
    """
    for number, (edge, uses) in enumerate(zip(brep.edges, brep.coedges_of)):
        if edge.degenerate:
            continue
        if len(uses) != 2:
            names = ", ".join(sorted({brep.faces[f].name for f, _, _ in uses})) or "no face"
            raise InputError(
                f"{where}: edge {number} has {len(uses)} faces ({names}) where a closed solid has two; "
                f"the shell is open or branches there"
            )
        ways = {brep.faces[f].loops[k][i].reversed ^ brep.faces[f].reversed for f, k, i in uses}
        if len(ways) != 2:
            raise InputError(f"{where}: the faces on both sides of edge {number} are oriented against each other")
    for face in brep.faces:
        scale = np.array([np.ptp(k) for k in face.surface.knots])
        for loop in face.loops:
            ends = [(c.curve.control[-1], c.curve.control[0]) if c.reversed else (c.curve.control[0],
                    c.curve.control[-1]) for c in loop]
            for (_, end), (start, _) in zip(ends, ends[1:] + ends[:1]):
                if (np.abs(end - start) > 1e-3 * scale).any():
                    raise InputError(f"{where}: {face.name} has a loop with a gap at (u, v) = {end.round(6).tolist()}")
    gap = sealing_gap(brep)
    worst = int(gap.argmax()) if len(gap) else 0
    if len(gap) and gap[worst] > OFF * brep.diagonal:
        names = " and ".join(brep.faces[f].name for f, _, _ in brep.coedges_of[worst])
        raise InputError(
            f"{where}: edge {worst} lies {gap[worst]:.2g} off {names}, {gap[worst] / brep.diagonal:.1e} of the "
            f"diagonal where {OFF:g} is allowed"
        )
