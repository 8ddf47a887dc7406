r"""Dirichlet conditions, imposed strongly by L2 projection onto the boundary functions.

Over the facets with data g, and over the functions that do not vanish there, min |sum_i u_i R_i - g| in L2; one
joint projection for all boundaries, so a function at an edge where boundaries meet gets one value. Fields of the space
are reproduced exactly. Weak conditions are in `iga.nitsche`.

Axis letters: e element, n function, k fixed unknown, c component.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix, vector
from iga.bernstein import Bernstein, face_functions
from iga.block import distinct_extractions
from iga.domain import Domain, Facets, facets_of
from iga.errors import InputError
from iga.field import Coefficient, Field
from iga.integrands import Load, Mass
from iga.linear.factorization import factorize

Array = NDArray[np.float64]
Index = NDArray[np.int64]
VANISHING = 1e-12
"""Extraction coefficients up to which a function has no trace on a face: those of functions with a trace are larger."""
MASSLESS = 1e-12
"""Mass of a trace, in the largest one, up to which its facets have collapsed: rounding is all that is left."""
RECOVERED = 1e-4
"""Error with which coefficients of order one come back from their loads; dependent functions miss them altogether."""

Value = Any
"""A number, a vector (c,), a function of x (..., 3), a `Field`, or a tuple with one of these or None per component."""


class DependentTracesError(InputError):
    """Values cannot be prescribed strongly: functions with a trace on the boundary are dependent there."""


def dirichlet(
    domain: Domain, data: Mapping[str, Value], components: int = 1, points: int | None = None
) -> tuple[Index, Array]:
    """Coefficients fixed by boundary values.

    Parameters
    ----------
    data : for boundaries, by name or pattern, what the solution equals there: a number, a function of x (..., 3) with
        values (...) or (..., c), a vector (c,), a `Field`, or a tuple with an entry per component, None for a free one.
        Where boundaries overlap, the later entry holds.
    components : number c of components of the solution.
    points : Gauss points per direction, by default `iga.chunk.default_points`.

    Returns
    -------
    unknowns : (k,) ascending numbers i*c + a; of free coefficients i if the space has a constraint.
    values : (k,)

    Raises
    ------
    InputError : a name matches no boundary or an empty one, or a value does not fit the components.
    DependentTracesError : traces are dependent, as those of unclamped splines are; use `iga.nitsche.nitsche`.
    """
    pieces: list[list[tuple[tuple[Facets, ...], Coefficient]]] = [[] for _ in range(components)]
    claimed: list[dict[tuple[int, int], NDArray[np.bool_]]] = [{} for _ in range(components)]
    for name, value in reversed(list(data.items())):
        facets = facets_of(domain, name)
        for a, own in enumerate(by_component(name, value, components)):
            if own is None:
                continue
            rest = unclaimed(domain, facets, claimed[a])
            if rest:
                pieces[a].append((rest, own))
    factors: dict[bytes, tuple[csr_array, Index, Callable[[Array], Array], Index]] = {}
    found: list[tuple[Index, Array]] = []
    for a in range(components):
        if not pieces[a]:
            continue
        facets = tuple(f for rest, _ in pieces[a] for f in rest)
        key = b"".join(np.array([f.block, f.face, *f.elements]).tobytes() for f in sorted(facets, key=_place))
        if key not in factors:
            factors[key] = _trace_space(domain, facets, points)
        T, free, solve, massless = factors[key]
        load = np.zeros(domain.space.n)
        for rest, own in pieces[a]:
            load += vector(domain, Load(own), points, rest)
        values = solve(T.T @ load)
        if len(massless):
            values[massless] = _at_points(domain, T, massless, pieces[a])
        found.append((free * components + a, values))
    if not found:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    numbers, fixed = np.concatenate([n for n, _ in found]), np.concatenate([v for _, v in found])
    order = np.argsort(numbers)
    return numbers[order], fixed[order]


def trace_functions(domain: Domain, facets: tuple[Facets, ...]) -> Index:
    """Functions that do not vanish on given facets, ascending."""
    touched = np.zeros(domain.space.n, dtype=bool)
    for f in facets:
        block = domain.space.blocks[f.block]
        basis = block.basis
        assert isinstance(basis, Bernstein)
        C, pattern = distinct_extractions(block)
        traced = np.abs(C[:, :, face_functions(basis, f.face)[1]]).max(axis=2) > VANISHING
        touched[block.dofs[f.elements][traced[pattern[f.elements]]]] = True
    return np.flatnonzero(touched)


def by_component(name: str, value: Value, components: int) -> list[Coefficient | None]:
    """Scalar coefficient of each component, None where it is free."""
    if isinstance(value, tuple | list):
        if len(value) != components:
            raise InputError(f"boundary {name!r}: {len(value)} values for {components} components")
        return list(value)
    if isinstance(value, Field):
        coefficients = value.coefficients
        if coefficients.ndim == 1:
            return [value] * components
        if coefficients.shape[1] != components:
            raise InputError(f"boundary {name!r}: a field with {coefficients.shape[1]} values, {components} needed")
        return [Field(value.space, np.ascontiguousarray(coefficients[:, a])) for a in range(components)]
    if callable(value):
        return [_component(name, value, a, components) for a in range(components)]
    constant = np.asarray(value, dtype=float)
    if constant.shape not in ((), (components,)):
        raise InputError(f"boundary {name!r}: a value of shape {constant.shape} for {components} components")
    return [float(v) for v in np.broadcast_to(constant, (components,))]


def _component(name: str, value: Callable[[Array], Array], a: int, components: int) -> Callable[[Array], Array]:
    def one(x: Array) -> Array:
        result = np.asarray(value(x), dtype=float)
        if result.shape == (*x.shape[:-1], components):
            return result[..., a]
        if components > 1 and result.shape == (components,):
            return np.broadcast_to(result[a], x.shape[:-1])
        if result.shape in ((), x.shape[:-1]):
            return np.broadcast_to(result, x.shape[:-1])
        raise InputError(f"boundary {name!r}: the function returns {result.shape} for points {x.shape}")

    return one


def _place(f: Facets) -> tuple[int, int]:
    return f.block, f.face


def unclaimed(
    domain: Domain, facets: tuple[Facets, ...], claimed: dict[tuple[int, int], NDArray[np.bool_]]
) -> tuple[Facets, ...]:
    """Facets that are not claimed yet, by masks (e,) of blocks and faces; they are then."""
    rest = []
    for f in facets:
        mask = claimed.setdefault(_place(f), np.zeros(domain.space.blocks[f.block].elements, dtype=bool))
        own = f.elements[~mask[f.elements]]
        mask[own] = True
        if len(own):
            rest.append(Facets(f.block, f.face, own))
    return tuple(rest)


def _trace_space(
    domain: Domain, facets: tuple[Facets, ...], points: int | None
) -> tuple[csr_array, Index, Callable[[Array], Array], Index]:
    """Projection onto the traces on facets.

    Returns
    -------
    T (n, k) from the k free coefficients with a trace to all coefficients, their numbers (k,), the solver of the mass
    matrix, and the numbers among k whose trace has no area (facets collapsed to points or lines).
    """
    n = domain.space.n
    traced = trace_functions(domain, facets)
    if domain.space.constraint is None:
        free = traced
        T = csr_array((np.ones(len(free)), (free, np.arange(len(free)))), shape=(n, len(free)))
    else:
        constraint = csr_array(domain.space.constraint)
        rows = constraint[traced]
        free = np.unique(rows.indices[np.abs(rows.data) > 1e-14]).astype(np.int64)
        T = csr_array(constraint[:, free])
    M = csr_array(T.T @ csr_array(matrix(domain, Mass(), points, facets) @ T))
    d = M.diagonal()
    some = d > MASSLESS * d.max(initial=0.0)
    kept = np.flatnonzero(some)
    own = csr_array(M[kept][:, kept])
    try:
        factor = factorize(own, symmetric=True)
        # A factorization may step over a pivot that is zero but for rounding; coefficients do not come back then.
        sample = np.random.default_rng(7).standard_normal(len(kept))
        dependent = bool(np.abs(factor(own @ sample) - sample).max(initial=0.0) > RECOVERED)
    except InputError:
        dependent = True
    if dependent:
        raise DependentTracesError(
            "functions with a trace on the boundary are dependent there, as those of unclamped splines are: "
            "values can only be imposed weakly"
        )

    def solve(load: Array) -> Array:
        values = np.zeros(len(free))
        values[kept] = factor(load[kept])
        return values

    return T, free, solve, np.flatnonzero(~some)


def _at_points(
    domain: Domain, T: csr_array, massless: Index, pieces: list[tuple[tuple[Facets, ...], Coefficient]]
) -> Array:
    """Data at the control points of functions whose trace has no area, from the piece that holds them."""
    where = np.asarray(abs(T[:, massless]).argmax(axis=0)).ravel()
    values = np.zeros(len(massless))
    for facets, own in reversed(pieces):
        mine = np.isin(where, trace_functions(domain, facets))
        if isinstance(own, Field):
            values[mine] = own.coefficients[where[mine]]
        elif callable(own):
            values[mine] = np.broadcast_to(own(domain.points[where[mine]][None]), (1, int(mine.sum())))[0]
        else:
            values[mine] = own
    return values
