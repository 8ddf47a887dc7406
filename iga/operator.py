r"""Matrix-free operators: the built-in forms as linear maps, with the signature of their assembly.

    K = operator(domain, Diffusion(k));   y = K @ x;   K.diagonal()

What is kept is the form at the Gauss points (6 numbers a point for diffusion, 10 for elasticity, a few more for
rational functions), nothing per pair of functions: a tricubic spline element needs 3 kB, its row of a matrix 4 kB. A
product is one pass over the elements on all threads, by sum factorisation on hexahedra (`iga.kernels.apply`) and matrix
products elsewhere. Unknown ``i*c + a`` is component a of function i.

Axis letters: e element, q point, n function on the element, c component, s number kept at a point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.assembly import Integrand
from iga.domain import Domain
from iga.errors import InputError
from iga.field import as_tensors
from iga.forms import (
    NotSymmetricError,
    Site,
    buffers,
    constant,
    control_points,
    evaluate,
    known,
    require_regular,
    require_symmetric,
    site,
    terms,
)
from iga.frame import Frame, add_diagonals, distribute, frames, interpolate
from iga.integrands import Elasticity, Mass
from iga.kernels import apply
from iga.parallel import ranges, run

Array = NDArray[np.float64]

PRODUCTS = 4
"""Products with an operator that are worth compiling for, compared with assembling the matrix once."""


@dataclass(frozen=True, eq=False)
class Part:
    """One block's share: ``D`` (e, s, q) of a form of some ``kind``, and stiffness (1 or e, 1 or q, 6, 6)."""

    frame: Frame
    kind: int
    D: Array
    stiffness: Array


@dataclass(frozen=True, eq=False)
class Operator:
    """A symmetric linear map given by a form; make it with `operator`.

    Attributes
    ----------
    domain, integrand, points : the form and where it is integrated.
    components : number c.
    parts : the form at the Gauss points of each block.
    """

    domain: Domain
    integrand: Integrand
    points: int | None
    components: int
    parts: tuple[Part, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(N c, N c)."""
        n = self.domain.space.n * self.components
        return n, n

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of entries."""
        return np.dtype(np.float64)

    def __matmul__(self, x: Array) -> Array:
        """Product with a vector (N c,)."""
        if x.shape != self.shape[1:]:
            raise InputError(f"an operator {self.shape} cannot be applied to {x.shape}")
        c, weights = self.components, self.domain.space.weights
        values = np.ascontiguousarray(x, dtype=float).reshape(-1, c)
        if weights is not None:
            values = values * weights[:, None]
        result = np.zeros_like(values)
        for part in self.parts:
            for contribution in run([partial(_apply, part, values, *p) for p in ranges(part.frame.block.elements)]):
                result += contribution
        if weights is not None:
            result *= weights[:, None]
        return result.reshape(-1)

    def matvec(self, x: Array) -> Array:
        """Product with a vector, under the name that SciPy's ``aslinearoperator`` looks for."""
        return self @ x.reshape(-1)

    def diagonal(self) -> Array:
        """Diagonal of the matrix, (N c,)."""
        return diagonal(self.domain, self.integrand, self.points)


def operator(
    domain: Domain, integrand: Integrand, points: int | None = None, components: int | None = None
) -> Operator:
    """Make the operator of a built-in form (diffusion, elasticity, mass) over the volume.

    Parameters
    ----------
    integrand : its coefficients must be symmetric.
    points : Gauss points per direction, by default `iga.chunk.default_points`.
    components : number c, by default the integrand's own.

    Raises
    ------
    InputError : not a built-in form, or one that is not symmetric.
    """
    c = int(getattr(integrand, "components", 1))
    if not known(integrand) or components not in (None, c):
        raise InputError("matrix-free operators exist for diffusion, elasticity and mass; assemble other integrands")
    control = control_points(domain)
    parts = []
    for number, f in enumerate(frames(domain, points, PRODUCTS * c)):
        kind, numbers = _kind(integrand, f)
        D = np.empty((f.block.elements, numbers, f.q))
        fill = partial(_fill, domain, integrand, f, number, kind, control, D)
        try:
            stiffness = run([partial(fill, *part) for part in ranges(f.block.elements)])
        except NotSymmetricError:
            raise InputError("matrix-free operators need symmetric coefficients; assemble this form instead") from None
        joined = stiffness[0] if kind != apply.ELASTICITY or constant(integrand) else np.concatenate(stiffness)
        parts.append(Part(f, kind, D, joined))
    return Operator(domain, integrand, points, c, tuple(parts))


def _kind(integrand: Integrand, f: Frame) -> tuple[int, int]:
    """Kind of the form and how many numbers it keeps at a point."""
    if isinstance(integrand, Elasticity):
        return apply.ELASTICITY, 10 if f.rational is None else 14
    if isinstance(integrand, Mass) or f.rational is not None:
        return apply.FULL, 10
    return apply.GRADIENT, 6


def _fill(
    domain: Domain, integrand: Integrand, f: Frame, number: int, kind: int, control: Array, D: Array, begin: int,
    end: int,
) -> Array:
    """Set D on elements begin..end of a block; returns their stiffness, (1, 1, 6, 6) if constant or unused."""
    work = buffers(f)
    found = []
    for lo in range(begin, end, f.size):
        hi = min(lo + f.size, end)
        at = site(f, number, lo, hi, control, work)
        if kind == apply.ELASTICITY:
            assert isinstance(integrand, Elasticity)
            require_regular(at)
            found.append(_stiffness(integrand, at))
            D[lo:hi, :9] = at.inverse
            D[lo:hi, 9] = at.dx
            if f.rational is not None:
                D[lo:hi, 10] = at.W
                D[lo:hi, 11:] = at.g
            continue
        # Components of a mass are alike: the first term is all of them.
        _, _, first = next(iter(terms(integrand, at, work)))
        D[lo:hi] = first[:, 4:] if kind == apply.GRADIENT else first
    if not found:
        return np.zeros((1, 1, 6, 6))
    return found[0] if constant(integrand) else np.concatenate(found)


def _stiffness(integrand: Elasticity, at: Site) -> Array:
    """Stiffness at the points of a site, (1, 1, 6, 6) or (m, q, 6, 6)."""
    values = as_tensors(evaluate(integrand.stiffness, at), 6)
    require_symmetric(values)
    return np.ascontiguousarray(values if values.ndim == 4 else values[None, None])


def _apply(part: Part, x: Array, begin: int, end: int) -> Array:
    """Product of elements begin..end of a block with all of x, (N, c)."""
    f, C = part.frame, part.stiffness
    y = np.zeros_like(x)
    if f.factored and f.dense is None:
        own = C if len(C) == 1 else C[begin:end]
        apply.product(f.literal, part.kind)(
            f.sizes, *f.tables, f.pattern[begin:end], part.D[begin:end], own, f.block.dofs[begin:end], x, y
        )
        return y
    m, c = f.size, x.shape[1]
    g, r = np.empty((m, c, 4, f.q)), np.empty((m, c, 4, f.q))
    for lo in range(begin, end, m):
        hi = min(lo + m, end)
        given = interpolate(f, lo, hi, x, g)
        out = r[: hi - lo]
        if part.kind == apply.ELASTICITY:
            apply.flux_elastic(part.D[lo:hi], C if len(C) == 1 else C[lo:hi], given, out)
        else:
            apply.flux_symmetric(part.D[lo:hi], given, out)
        distribute(f, lo, hi, out, y, weighted=False)
    return y


def diagonal(domain: Domain, integrand: Integrand, points: int | None = None) -> Array:
    """Diagonal (N c,) of the matrix of a built-in form, without the matrix."""
    control = control_points(domain)
    c = int(getattr(integrand, "components", 1))

    def some(f: Frame, number: int, begin: int, end: int) -> Array:
        result = np.zeros((domain.space.n, c))
        work = buffers(f, pairs=c > 1)
        for lo in range(begin, end, f.size):
            hi = min(lo + f.size, end)
            for a, b, D in terms(integrand, site(f, number, lo, hi, control, work), work):
                if a == b:
                    add_diagonals(f, lo, hi, D, result[:, a : a + 1])
        return result

    total = np.zeros((domain.space.n, c))
    for number, f in enumerate(frames(domain, points)):
        for found in run([partial(some, f, number, *part) for part in ranges(f.block.elements)]):
            total += found
    return total.reshape(-1)
