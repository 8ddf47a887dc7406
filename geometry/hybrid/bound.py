r"""Proved bounds of the distance from bicubic quadrilaterals to the rational surface that they approximate.

On a rectangle without inner knots the surface is S = X / W with polynomials X, W of degrees p, q. For any polynomial
map (u, v)(a, b) into the rectangle, a point P(a, b) of the quadrilateral is no farther from the surface than

    |P - S(u, v)| = |W P - X| / W    at (a, b).

With u and v of degree 5, through foot points at 6 x 6 places, numerator and denominator are polynomials, and their
Bernstein coefficients bound them. Two maps are tried: u(a), v(b), which suits surfaces of revolution and extrusion and
keeps degrees low, 5 p + 3 and 5 q + 3; and u(a, b), v(a, b), of degree 5 (p + q) + 3. Where a map leaves the rectangle
by rounding, S is the same rational piece continued.

Axis letters: e element, i j Bernstein function, q sample, c component.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Face
from geometry.cad.evaluation import surface_values
from iga.bernstein import bernstein
from iga.cells import LINE

Array = NDArray[np.float64]

MAP = 5
"""Degree of u and v."""
FEET = 0.5 * (1.0 - np.cos(np.pi * np.arange(MAP + 1) / MAP))
"""Where foot points are taken, in both directions."""
MOST = 18
"""Degree above which Bernstein coefficients lose too many digits."""


def distance_bound(face: Face, low: Array, high: Array, control: Array, feet: Array) -> Array | None:
    """Upper bounds (e,) of the distance of quadrilaterals to the surface of a face.

    Parameters
    ----------
    low, high : (e, 2) rectangles without inner knots.
    control : (e, 16, 3) control points, u along the first index.
    feet : (e, 36, 2) parameters of the foot points at ``FEET`` x ``FEET``.

    Returns
    -------
    None if the degree is too high.
    """
    p, q = face.surface.degree
    net = _piece(face, low, high)
    local = ((feet - low[:, None]) / (high - low)[:, None]).reshape(len(low), MAP + 1, MAP + 1, 2)
    found = []
    if MAP * max(p, q) + 3 <= MOST:
        apart = np.stack(np.broadcast_arrays(local[..., 0].mean(axis=2)[:, :, None],
                                             local[..., 1].mean(axis=1)[:, None]), axis=-1)
        found.append(_bound(net, control, apart, MAP * p + 3, MAP * q + 3))
    if MAP * (p + q) + 3 <= MOST:
        found.append(_bound(net, control, local, MAP * (p + q) + 3, MAP * (p + q) + 3))
    return np.asarray(np.min(found, axis=0)) if found else None


def _bound(net: Array, control: Array, feet: Array, m: int, n: int) -> Array:
    """Bound (e,) for one map through feet (e, 6, 6, 2) in the unit square; m, n: degrees of the numerator."""
    x, y = _nodes(m), _nodes(n)
    Lx, Ly = (_values(MAP, z) @ _to_bernstein(MAP, FEET) for z in (x, y))
    middle = control.mean(axis=1)
    local = (control - middle[:, None]).reshape(-1, 4, 4, 3)
    P = np.einsum("ai,bj,eijc->eabc", _values(3, x), _values(3, y), local, optimize=True)
    st = np.einsum("ai,bj,eijc->eabc", Lx, Ly, feet, optimize=True)
    s, t = (_values(net.shape[k + 1] - 1, st[..., k].ravel()).reshape(*st.shape[:3], -1) for k in range(2))
    S = np.einsum("eabi,eabj,eijc->eabc", s, t, net, optimize=True)
    W = S[..., 3]
    off = W[..., None] * P - (S[..., :3] - W[..., None] * middle[:, None, None])
    Tx, Ty = _to_bernstein(m, x), _to_bernstein(n, y)
    over = np.einsum("ia,jb,eabc->eijc", Tx, Ty, off, optimize=True)
    under = np.einsum("ia,jb,eab->eij", Tx, Ty, W, optimize=True)
    return np.asarray(np.linalg.norm(over, axis=-1).max(axis=(1, 2)) / under.min(axis=(1, 2)))


def _piece(face: Face, low: Array, high: Array) -> Array:
    """Homogeneous Bernstein coefficients (e, p + 1, q + 1, 4) of the surface on rectangles."""
    surface = face.surface
    p, q = surface.degree
    places = [(np.arange(d + 1) + 0.5) / (d + 1) for d in (p, q)]
    grid = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
    uv = low[:, None, None] + grid * (high - low)[:, None, None]
    w = np.ones(surface.control.shape[:2]) if surface.weights is None else surface.weights
    one = np.ones_like(w)
    ku, kv = surface.knots
    flat = np.ascontiguousarray(uv.reshape(-1, 2))
    x = surface_values(ku, kv, surface.control * w[..., None], one, flat)[:, 0]
    weight = surface_values(ku, kv, np.repeat(w[..., None], 3, axis=2), one, flat)[:, 0, :1]
    values = np.concatenate([x, weight], axis=1).reshape(len(low), p + 1, q + 1, 4)
    return np.asarray(np.einsum(
        "ia,jb,eabc->eijc", _to_bernstein(p, places[0]), _to_bernstein(q, places[1]), values, optimize=True
    ))  # fmt: skip


@cache
def _nodes(n: int) -> Array:
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * np.arange(n + 1) / n)))


def _values(degree: int, x: Array) -> Array:
    """Bernstein functions (q, degree + 1), for arguments a little outside [0, 1] as well."""
    return np.asarray(bernstein(LINE, degree).tabulate(x[:, None], 0)[0])


def _to_bernstein(degree: int, places: Array) -> Array:
    """Coefficients from values at places, on one line."""
    return np.asarray(np.linalg.inv(_values(degree, places)))
