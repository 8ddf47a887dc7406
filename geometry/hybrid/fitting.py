r"""Inner control points of elements on a face, and how far the elements are from its surface.

Boundary control points are given, and inner ones are moved along the normal of the surface, by least squares over the
distances at samples, which are measured by projection to the surface. Quadrilaterals between parameter lines of a
polynomial surface of degree three at most are its own Bezier patches, and need no fit.

Axis letters: e element, n control point, q or k sample, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Face, surface_frame
from geometry.hybrid.bound import FEET, distance_bound
from geometry.hybrid.chart import Chart, to_parameters
from geometry.hybrid.hbrep import polynomial_surface, tensor_rows
from geometry.hybrid.triangle import CUBIC, INNER
from iga.bernstein import Bernstein, bernstein
from iga.cells import QUADRILATERAL

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

BICUBIC = bernstein(QUADRILATERAL, 3)
INNER_QUAD = np.array([5, 6, 9, 10])
FREE = 0.0002
STIFF = 0.03
"""Share of moves along the surface that is allowed; the second where elements fold with the first."""
_PLACES = np.array([(a, b, 4 - a - b) for a in (1, 2) for b in (1, 2) if a + b < 4] + [(1.2, 1.4, 1.4)]) / 4.0
_CHECKS = np.array([(a, b, 6 - a - b) for a in range(7) for b in range(7 - a)]) / 6.0
_SQUARE = np.stack(np.meshgrid(*[np.array([0.15, 0.38, 0.62, 0.85])] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
_FEET = np.stack(np.meshgrid(FEET, FEET, indexing="ij"), axis=-1).reshape(-1, 2)
_SQUARE_CHECKS = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 7)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Control points (e, n, 3), largest sampled distance to the surface (e,), and whether elements fold (e,); a proved
    bound of the distance (e,) where there is one.
    """

    control: Array
    distance: Array
    folded: Mask
    bound: Array | None = None


def fit_triangles(face: Face, chart: Chart, q: Array, control: Array) -> Fitted:
    """Inner control point of cubic triangles; the one of quadratic precision to begin with.

    Where normals turn, distances can be lowered by moving along the surface too, which pays unless the element folds.

    Parameters
    ----------
    q : (e, 3, 2) corners in the chart, in the order of the control points.
    control : (e, 10, 3)
    """
    corner, side = (CUBIC.exponents == 3).any(axis=1), (CUBIC.exponents == 2).any(axis=1)
    start = control.copy()
    start[:, INNER] = 0.25 * control[:, side].sum(axis=1) - control[:, corner].sum(axis=1) / 6.0
    weights = _PLACES, _CHECKS
    uv = [to_parameters(chart, np.einsum("kv,evd->ekd", w, q).reshape(-1, 2)) for w in weights]
    return _fit(face, CUBIC, np.array([INNER]), _PLACES[:, 1:], _CHECKS[:, 1:], uv, start)


def fit_quads(face: Face, low: Array, high: Array, control: Array, exact: Array | None) -> Fitted:
    """Inner control points of bicubic quadrilaterals (e, 16, 3) between parameter lines.

    Parameters
    ----------
    low, high : (e, 2) their rectangles.
    exact : (e, 16, 3) Bezier points of the surface itself, if it has any; else a Coons patch begins.
    """
    start = control.copy()
    if exact is None:
        start[:, INNER_QUAD] = _coons(control.reshape(-1, 4, 4, 3)).reshape(-1, 16, 3)[:, INNER_QUAD]
    else:
        start[:, INNER_QUAD] = exact[:, INNER_QUAD]
    uv = [(low[:, None] + at * (high - low)[:, None]).reshape(-1, 2) for at in (_SQUARE, _SQUARE_CHECKS)]
    if exact is not None:
        return _measured(face, BICUBIC, _SQUARE_CHECKS, uv[1], start)
    made = _fit(face, BICUBIC, INNER_QUAD, _SQUARE, _SQUARE_CHECKS, uv, start)
    x = np.einsum("kn,enc->ekc", BICUBIC.tabulate(_FEET, 0)[0], made.control)
    at = (low[:, None] + _FEET * (high - low)[:, None]).reshape(-1, 2)
    feet = project(face, at, x.reshape(-1, 3))[0].reshape(len(low), -1, 2)
    return replace(made, bound=distance_bound(face, low, high, made.control, feet))


def measure_triangles(face: Face, chart: Chart, q: Array, control: Array) -> Fitted:
    """Distances of cubic triangles (e, 10, 3) as they are; ``q`` as in `fit_triangles`."""
    uv = to_parameters(chart, np.einsum("kv,evd->ekd", _CHECKS, q).reshape(-1, 2))
    return _measured(face, CUBIC, _CHECKS[:, 1:], uv, control)


def measure_quads(face: Face, low: Array, high: Array, control: Array) -> Fitted:
    """Distances of bicubic quadrilaterals (e, 16, 3) on rectangles (e, 2) as they are."""
    uv = (low[:, None] + _SQUARE_CHECKS * (high - low)[:, None]).reshape(-1, 2)
    return _measured(face, BICUBIC, _SQUARE_CHECKS, uv, control)


def bezier_nets(face: Face, low: Array, high: Array) -> Array | None:
    """Bezier points (e, 16, 3) of the surface on rectangles without inner knots; None unless they are bicubic."""
    surface = face.surface
    if surface.weights is not None or max(surface.degree) > 3:
        return None
    cubic = polynomial_surface(surface, 1e-12)
    A, dofs = tensor_rows(cubic.knots, low, high)
    return np.asarray(np.einsum("enb,enc->ebc", A, cubic.control.reshape(-1, 3)[dofs]))


def _coons(P: Array) -> Array:
    t = np.arange(4) / 3.0
    a, b = t[None, :, None, None], t[None, None, :, None]
    ruled = (1 - a) * P[:, :1] + a * P[:, 3:] + (1 - b) * P[:, :, :1] + b * P[:, :, 3:]
    corners = (1 - a) * ((1 - b) * P[:, :1, :1] + b * P[:, :1, 3:]) + a * ((1 - b) * P[:, 3:, :1] + b * P[:, 3:, 3:])
    return np.asarray(ruled - corners)


def _fit(
    face: Face, basis: Bernstein, inner: Index, places: Array, checks: Array, uv: list[Array], start: Array
) -> Fitted:
    made = _damped(face, basis, inner, places, checks, uv, start, FREE)
    again = np.flatnonzero(made.folded)
    if len(again):
        part = [own.reshape(len(start), -1, 2)[again].reshape(-1, 2) for own in uv]
        stiff = _damped(face, basis, inner, places, checks, part, start[again], STIFF)
        made.control[again], made.distance[again], made.folded[again] = stiff.control, stiff.distance, stiff.folded
    return made


def _damped(
    face: Face, basis: Bernstein, inner: Index, places: Array, checks: Array, uv: list[Array], start: Array,
    share: float,
) -> Fitted:  # fmt: skip
    control = start.copy()
    values = basis.tabulate(places, 0)[0]
    w = values[:, inner]
    m = len(inner)
    damping = np.kron(share * np.diag((w**2).sum(axis=0)), np.eye(3))
    at = uv[0]
    for _ in range(4):
        x = np.einsum("kn,enc->ekc", values, control)
        at, gap, normal = project(face, at, x.reshape(-1, 3))
        rows = np.einsum("ki,ekc->ekic", w, normal.reshape(x.shape)).reshape(len(x), len(w), 3 * m)
        A = np.einsum("eki,ekj->eij", rows, rows) + damping
        right = np.einsum("eki,ek->ei", rows, gap.reshape(x.shape[:2]))
        control[:, inner] += np.linalg.solve(A, right[..., None])[..., 0].reshape(-1, m, 3)
    return _measured(face, basis, checks, uv[1], control)


def _measured(face: Face, basis: Bernstein, checks: Array, uv: Array, control: Array) -> Fitted:
    values, gradients = basis.tabulate(checks, 1)
    x = np.einsum("kn,enc->ekc", values, control)
    _, gap, normal = project(face, uv, x.reshape(-1, 3))
    distance = np.abs(gap).reshape(x.shape[:2]).max(axis=1)
    J = np.einsum("knd,enc->ekcd", gradients, control)
    own = np.cross(J[..., 0], J[..., 1])
    normal = normal.reshape(own.shape)
    way = -1.0 if face.reversed and basis is CUBIC else 1.0
    cosine = np.einsum("ekc,ekc->ek", own, normal) * way
    size = np.linalg.norm(own, axis=-1).max(axis=1)
    folded = (cosine < 1e-3 * size[:, None]) & (normal != 0.0).any(axis=-1)
    return Fitted(control, distance, folded.any(axis=1))


def project(face: Face, uv: Array, x: Array, rounds: int = 4) -> tuple[Array, Array, Array]:
    """Foot points: parameters, signed distance along the unit normal of the surface, that normal (zero at poles)."""
    for _ in range(rounds):
        s, du, dv = surface_frame(face.surface, uv)
        J = np.stack([du, dv], axis=-1)
        metric = np.einsum("qci,qcj->qij", J, J)
        metric += 1e-12 * np.trace(metric, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        step = np.linalg.solve(metric, np.einsum("qci,qc->qi", J, x - s)[..., None])[..., 0]
        uv = uv + step
    s, du, dv = surface_frame(face.surface, uv)
    n = np.cross(du, dv)
    length = np.linalg.norm(n, axis=1)
    pole = length <= 1e-6 * np.median(length)
    n = np.where(pole[:, None], 0.0, n / (length[:, None] + 1e-300))
    away = np.einsum("qc,qc->q", n, x - s)
    return uv, -away, n
