r"""Forms: the built-in integrands as coefficients at Gauss points.

Diffusion, elasticity and mass are all sums of

    K_ij^ab = int sum_ef d_e R_i kappa^ab_ef d_f R_j + rho^ab R_i R_j,

component a of the first and b of the second function, so in reference coordinates they differ only in a symmetric 4 x 4
matrix D of coefficients for each pair a = b, and any 4 x 4 matrix for each pair a < b (the pair b, a is its transpose).
`terms` gives these for a chunk of elements; assembly and matrix-free operators take them from there.

Axis letters: e element, q point, c component, v Voigt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.chunk import Chunk
from iga.domain import Domain, homogeneous
from iga.errors import InputError
from iga.field import Coefficient, Field, as_tensors, given, require_finite
from iga.frame import Frame, interpolate
from iga.integrands import VOIGT, Diffusion, Elasticity, Load, Mass, are_tensors
from iga.kernels import metric

Array = NDArray[np.float64]
Integrand = Callable[[Chunk], Array]


@dataclass(frozen=True, eq=False)
class Site:
    """A run of elements of one block seen at Gauss points; arrays are valid until the next site is made.

    Attributes
    ----------
    frame : functions at the points.
    block, lo, hi : number of the block, and elements lo..hi of it.
    x, inverse, dx : (m, 3, q) points, (m, 9, q) inverse Jacobian matrices row by row, (m, q) weights times det J.
    W, g : (m, q) sum of the weights and (m, 3, q) its reference gradient over it; meaningful for rational functions.
    degenerate : first element with det J = 0 at a point, or -1.
    """

    frame: Frame
    block: int
    lo: int
    hi: int
    x: Array
    inverse: Array
    dx: Array
    W: Array
    g: Array
    degenerate: int


@dataclass(frozen=True, eq=False)
class Buffers:
    """Work arrays for the sites of one frame; one set for each thread."""

    u: Array
    x: Array
    inverse: Array
    dx: Array
    W: Array
    g: Array
    symmetric: Array
    any: Array


def buffers(f: Frame, pairs: bool = False) -> Buffers:
    """Allocate work arrays for chunks of a frame; ``pairs`` if forms couple components."""
    m, q = f.size, f.q
    rational = f.rational is not None
    return Buffers(
        np.empty((m, 4 if rational else 3, 4, q)), np.empty((m, 3, q)), np.empty((m, 9, q)), np.empty((m, q)),
        np.empty((m if rational else 0, q)), np.empty((m if rational else 0, 3, q)), np.empty((m, 10, q)),
        np.empty((m if pairs else 0, 16, q)),
    )


def control_points(domain: Domain) -> Array:
    """Control points (N, 3), or homogeneous ones (w x, w), (N, 4), of a rational space."""
    return np.ascontiguousarray(homogeneous(domain.space, domain.points), dtype=float)


def site(f: Frame, block: int, lo: int, hi: int, control: Array, work: Buffers) -> Site:
    """Geometry of elements lo..hi at the points of a frame; ``control`` from `control_points`."""
    m = hi - lo
    u = interpolate(f, lo, hi, control, work.u)
    W, g = work.W[:m], work.g[:m]
    degenerate = metric.geometry(u, f.weights, work.x[:m], work.inverse[:m], work.dx[:m], W, g)
    return Site(f, block, lo, hi, work.x[:m], work.inverse[:m], work.dx[:m], W, g, int(degenerate))


def evaluate(coefficient: Coefficient, at: Site) -> Array:
    """Values of a coefficient at the points of a site, as `iga.field.evaluate` gives them.

    Raises
    ------
    InputError : a value is not finite; the element is named.
    """
    x = at.x.swapaxes(1, 2)
    values = field_at(coefficient.coefficients, at)[0] if isinstance(coefficient, Field) else given(coefficient, x)
    require_finite(values, x, np.arange(at.lo, at.hi), at.block)
    return values


def field_at(coefficients: Array, at: Site, slopes: bool = False) -> tuple[Array, Array]:
    """Values (m, q) of a field with coefficients (N,), or (m, q, c) with (N, c), at the points of a site.

    With ``slopes`` also physical gradients (m, q, 3) or (m, q, c, 3); without, the second array is empty.
    """
    single = coefficients.ndim == 1
    u = coefficients.reshape(len(coefficients), -1)
    if at.frame.rational is not None:
        u = u * at.frame.rational[:, None]
    found = interpolate(at.frame, at.lo, at.hi, np.ascontiguousarray(u, dtype=float))
    if at.frame.rational is not None:
        found = found / at.W[:, None, None]
        found[:, :, 1:] -= found[:, :, :1] * at.g[:, None]
    values = found[:, :, 0].swapaxes(1, 2)
    gradient = np.zeros(0)
    if slopes:
        m, q = at.dx.shape
        gradient = np.einsum("mcsq,msxq->mqcx", found[:, :, 1:], at.inverse.reshape(m, 3, 3, q))
        gradient = gradient[:, :, 0] if single else gradient
    return (values[..., 0] if single else values), gradient


def known(integrand: object) -> bool:
    """Whether an integrand is one of the forms here (a subclass or a user's own is not)."""
    return type(integrand) in (Diffusion, Elasticity, Mass)


def constant(integrand: object) -> bool:
    """Whether a known form has the same coefficient everywhere."""
    coefficient = _coefficient(integrand)
    return not isinstance(coefficient, Field) and not callable(coefficient)


def _coefficient(integrand: object) -> Coefficient:
    if isinstance(integrand, Diffusion):
        return integrand.conductivity
    if isinstance(integrand, Elasticity):
        return integrand.stiffness
    assert isinstance(integrand, Mass)
    return integrand.density


class NotSymmetricError(Exception):
    """The form has a coefficient that is not symmetric, or couples components in a way the kernels do not have."""


def terms(integrand: object, at: Site, work: Buffers) -> Iterator[tuple[int, int, Array]]:
    """Coefficients of a known form, pair of components by pair.

    Yields
    ------
    (a, b, D) : components a <= b; D (m, 10, q) where a = b, else (m, 16, q). D is valid until the next pair.

    Raises
    ------
    NotSymmetricError : a coefficient that the symmetric kernels cannot take.
    InputError : det J = 0 at a point where a gradient is needed; the element is named.
    """
    m = at.hi - at.lo
    values = as_tensors(evaluate(_coefficient(integrand), at), 6 if isinstance(integrand, Elasticity) else 3)
    if isinstance(integrand, Mass):
        if values.ndim and values.shape not in (at.dx.shape, (1, 1)):
            raise NotSymmetricError
        D = work.symmetric[:m]
        metric.mass(at.dx, _points(values, ()), D)
        if at.frame.rational is not None:
            metric.rational_symmetric(at.W, at.g, D)
        for a in range(integrand.components):
            yield a, a, D
        return
    require_regular(at)
    if isinstance(integrand, Diffusion):
        if are_tensors(values):
            require_symmetric(values)
            yield from _pairs(values[..., None, :, None, :], 1, at, work)
            return
        D = work.symmetric[:m]
        metric.scalar_tensor(at.inverse, at.dx, _points(values, ()), D)
        if at.frame.rational is not None:
            metric.rational_symmetric(at.W, at.g, D)
        yield 0, 0, D
        return
    require_symmetric(values)
    yield from _pairs(_full(values), 3, at, work)


def require_regular(at: Site) -> None:
    """Raise `InputError` with the element's number if det J = 0 at a point of a site."""
    if at.degenerate >= 0:
        raise InputError(
            f"element {at.lo + at.degenerate} of block {at.block} is degenerate (zero Jacobian) at a Gauss point"
        )


def require_symmetric(values: Array) -> None:
    """Raise `NotSymmetricError` unless matrices (..., k, k) are symmetric, up to rounding of their formulas."""
    if np.abs(values - values.swapaxes(-1, -2)).max() > 1e-13 * np.abs(values).max():
        raise NotSymmetricError


def _pairs(kappa: Array, components: int, at: Site, work: Buffers) -> Iterator[tuple[int, int, Array]]:
    """Terms of kappa (..., c, 3, c, 3), indices a e b f."""
    m = at.hi - at.lo
    for a in range(components):
        for b in range(a, components):
            k = kappa[..., a, :, b, :]
            if a == b:
                D = work.symmetric[:m]
                upper = k[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
                metric.symmetric_tensor(at.inverse, at.dx, _points(upper, (6,)), D)
                if at.frame.rational is not None:
                    metric.rational_symmetric(at.W, at.g, D)
            else:
                D = work.any[:m]
                metric.any_tensor(at.inverse, at.dx, _points(k.reshape(*k.shape[:-2], 9), (9,)), D)
                if at.frame.rational is not None:
                    metric.rational_any(at.W, at.g, D)
            yield a, b, D


_VOIGT_OF = np.zeros((3, 3), np.int64)
for _v, (_i, _j) in enumerate(VOIGT):
    _VOIGT_OF[_i, _j] = _VOIGT_OF[_j, _i] = _v


def _full(D: Array) -> Array:
    """Stiffness tensor (..., 3, 3, 3, 3) of Voigt matrices (..., 6, 6)."""
    return D[..., _VOIGT_OF[:, :, None, None], _VOIGT_OF[None, None, :, :]]


def _points(values: Array, tail: tuple[int, ...]) -> Array:
    """Values as (e or 1, q or 1, *tail), contiguous."""
    lead = values.ndim - len(tail)
    return np.ascontiguousarray(values if lead == 2 else values.reshape(1, 1, *tail), dtype=float)


def source(integrand: Load, at: Site) -> Array:
    """Values of a load times dx, (m, c, 1, q)."""
    m, q = at.dx.shape
    s = evaluate(integrand.source, at)
    c = integrand.components
    if c == 1 and s.shape != (m, q, 1):
        s = np.broadcast_to(s, (m, q))[..., None]
    result = np.broadcast_to(s, (m, q, c)).transpose(0, 2, 1) * at.dx[:, None]
    if at.frame.rational is not None:
        result = result / at.W[:, None]
    return np.ascontiguousarray(result)[:, :, None]
