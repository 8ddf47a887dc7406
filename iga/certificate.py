r"""Certificates: whether every element is valid (det J > 0 everywhere on it), proved, and how far from it.

The Bernstein coefficients of det J (`iga.determinant`) enclose its minimum over an element from both sides: no value
lies below the smallest coefficient, and the coefficients at the vertices are values. Where the sign is not decided the
element is bisected. For rational maps det J = numerator / w^4, both raised to one degree, and the ratios of
coefficients enclose det J, because numerator - m w^4 has non-negative coefficients for the smallest ratio m.

Rounding. Bounds hold in floating point, and for every geometry whose control points (and weights) agree with the stored
ones to ``SLACK`` units of the last place of the largest coordinate in the domain. With A_f,c the largest |coefficient|
of component c of the f-th factor of the determinant, a coefficient is a weighted mean of sums whose terms add up in
absolute value to at most perm(A). If factors are wrong by at most D_f,c, and n roundings are made in sums and products,

    |computed - true| <= perm(A + D) - perm(A) + gamma_n perm(A + D),        gamma_n = n u / (1 - n u), u = 2^-53,
    D_f,c = (largest absolute row sum of the factor's matrix) * (slack_c + gamma_m max |P_c|)

(Higham, Accuracy and Stability of Numerical Algorithms, 3.1). Each bisection adds gamma_q max |coefficient| with q the
degree, halvings being means. Values within the bound of zero decide nothing: an element that is degenerate by
construction, where det J touches zero, has verdict 0 with bounds of about the rounding bound, and is counted apart.

det J is taken with respect to the reference coordinates of the element in [0, 1], also on knot spans of splines.
Axis letters: e element, b Bernstein function, k coefficient of det J, c component, v vertex, d reference dimension.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, LocalBasis
from iga.block import Patterns, bezier_coefficients, unity_defect
from iga.determinant import UNIT_ROUNDOFF, Array, Index, determinant, gamma, kernel_plan, splits
from iga.domain import Domain
from iga.errors import InputError
from iga.kernels.bisection import bisect
from iga.kernels.jacobian import L as LANES
from iga.kernels.jacobian import coefficients
from iga.parallel import ranges, run, threads
from iga.scaled_jacobian import scaled_jacobian

SLACK = 4.0
"""Units of the last place of the largest coordinate by which true control points may differ from the stored ones."""
SIGN_ALONE = 1e9
"""Tolerance of `certify` with which no bound is made sharper than the sign of det J needs."""
_CHUNK_BYTES = 32 * 2**20
"""Coefficients worked on at a time: what memory allows, however large the domain."""


@dataclass(frozen=True, eq=False)
class Witnesses:
    """Points where det J < 0, one for each refuted element.

    Attributes
    ----------
    block, element : (k,) block number, element number in the block.
    xi : (k, 3) reference point.
    det : (k,) det J there.
    x : (k, 3) the point in space.
    """

    block: Index
    element: Index
    xi: Array
    det: Array
    x: Array


@dataclass(frozen=True, eq=False)
class Certificate:
    """Enclosures of the minimum of det J over each element, blocks one after the other.

    Attributes
    ----------
    verdict : (e,) +1 certified (det J > 0 everywhere), -1 refuted (det J < 0 somewhere), 0 undecided.
    lower, upper : (e,) the minimum of det J lies between them.
    offsets : (blocks + 1,) elements of block i are offsets[i]:offsets[i + 1].
    witnesses : where refuted elements fail.
    degenerate : (e,) verdict 0 because the minimum is zero to within rounding: det J >= 0, touching zero. A hexahedron
        with a collapsed face, or with two edges in line at a vertex.
    """

    verdict: NDArray[np.int8]
    lower: Array
    upper: Array
    offsets: Index
    witnesses: Witnesses
    degenerate: NDArray[np.bool_]


def certify(domain: Domain, tolerance: float = 0.1, max_depth: int = 8, budget: int = 8000) -> Certificate:
    """Enclose the minimum of det J over every element from both sides.

    Every element is refined until its sign is decided; those that may hold the smallest determinant of the domain until
    that is known to the relative gap ``tolerance``.

    Parameters
    ----------
    domain : a solid; blocks of three-dimensional cells with Bernstein bases.
    tolerance : relative gap of the smallest determinant.
    max_depth : most halvings of an element in each direction.
    budget : most pieces of one element; what is left then counts with its bound.

    Raises
    ------
    InputError : a block is not three-dimensional, or tolerance or depth make no sense.
    """
    if not (tolerance > 0.0 and 0 <= max_depth <= 40 and budget >= 1):
        raise InputError(f"certify needs tolerance > 0, 0 <= max_depth <= 40 and budget >= 1, not {tolerance}, "
                         f"{max_depth}, {budget}")
    sizes = [block.elements for block in domain.space.blocks]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    enclosure = _Enclosure.empty(int(offsets[-1]))
    jobs = [_Job(domain, number, first) for number, first in enumerate(offsets[:-1].tolist()) if sizes[number]]
    for job in jobs:
        job.first_pass(enclosure)
        todo = np.flatnonzero(enclosure.undecided()[job.range]) if max_depth else np.empty(0, dtype=np.int64)
        job.refine(todo, -np.inf, np.inf, max_depth, budget, enclosure)
    if max_depth:
        _sharpen(jobs, enclosure, tolerance, max_depth, budget)
    verdict = np.where(enclosure.lower > 0.0, 1, np.where(enclosure.upper < 0.0, -1, 0)).astype(np.int8)
    degenerate = enclosure.touching() & (verdict == 0)
    witnesses = _witnesses(jobs, verdict, enclosure)
    return Certificate(verdict, enclosure.lower, enclosure.upper, offsets, witnesses, degenerate)


def summary(certificate: Certificate) -> dict[str, int | float | None]:
    """Counts of verdicts, and the enclosure of the smallest determinant of the domain (None if it has no elements).

    Every element is in one of four counts. ``degenerate`` are those whose minimum is zero to within rounding, proved
    from both sides: neither valid nor folded, such as a hexahedron with a collapsed face or a doubled control point.
    """
    verdict = certificate.verdict
    some = len(verdict) > 0
    return {
        "certified": int((verdict > 0).sum()),
        "refuted": int((verdict < 0).sum()),
        "undecided": int(((verdict == 0) & ~certificate.degenerate).sum()),
        "degenerate": int(certificate.degenerate.sum()),
        "min_det_lower": float(certificate.lower.min()) if some else None,
        "min_det_upper": float(certificate.upper.min()) if some else None,
    }


def worst(certificate: Certificate, count: int = 10) -> list[dict[str, int | float]]:
    """List the elements with the smallest lower bounds: block, element, verdict, lower, upper."""
    rows = np.argsort(certificate.lower, kind="stable")[:count]
    blocks = np.searchsorted(certificate.offsets, rows, side="right") - 1
    return [
        {
            "block": int(b), "element": int(e - certificate.offsets[b]), "verdict": int(certificate.verdict[e]),
            "lower": float(certificate.lower[e]), "upper": float(certificate.upper[e]),
        }
        for b, e in zip(blocks, rows)
    ]


def quality(domain: Domain, tolerance: float = 0.1, max_depth: int = 8) -> dict[str, Any]:
    """Certificate and scaled Jacobian in one dictionary, the ``quality`` of the command line.

    ``folds`` lists points where det J < 0, of at most ten refuted elements, the deepest folds first.
    """
    certificate = certify(domain, tolerance, max_depth)
    return {
        **summary(certificate), "folds": folds(certificate.witnesses), "scaled_jacobian": scaled_jacobian(domain),
    }


def folds(witnesses: Witnesses, count: int = 10) -> list[dict[str, Any]]:
    """Deepest folds: block, element, xi, x and det J of points where it is negative."""
    return [
        {
            "block": int(witnesses.block[k]), "element": int(witnesses.element[k]), "xi": witnesses.xi[k].tolist(),
            "x": witnesses.x[k].tolist(), "det": float(witnesses.det[k]),
        }
        for k in np.argsort(witnesses.det, kind="stable")[:count]
    ]


@dataclass(eq=False)
class _Enclosure:
    """What is known of each element so far: bounds, where ``upper`` is attained, and the rounding bound in either."""

    lower: Array
    upper: Array
    error: Array
    points: Array

    @classmethod
    def empty(cls, elements: int) -> _Enclosure:
        return cls(np.zeros(elements), np.zeros(elements), np.zeros(elements), np.zeros((elements, 3)))

    def touching(self) -> NDArray[np.bool_]:
        """The minimum is zero to within rounding (the bounds contain the rounding bound once more)."""
        return (self.upper <= 2.0 * self.error) & (self.lower >= -2.0 * self.error)

    def undecided(self) -> NDArray[np.bool_]:
        """Sign open, and not because the minimum touches zero."""
        return ~((self.lower > 0.0) | (self.upper < 0.0) | self.touching()) & np.isfinite(self.lower)


class _Job:
    """One block on its way through the passes."""

    def __init__(self, domain: Domain, number: int, first: int) -> None:
        block = domain.space.blocks[number]
        weights = domain.space.weights
        self.block, self.number, self.first = block, number, first
        self.basis = as_bernstein(block.basis)
        self.values = domain.points
        # Equal weights cancel where functions sum to one: the map is polynomial.
        rational = weights is not None and bool(np.ptp(weights[block.dofs]) > 0.0 or unity_defect(block)[0] > 1e-9)
        if weights is not None and rational:
            self.values = np.column_stack([weights, weights[:, None] * domain.points])
        self.rational = rational
        self.determinant = determinant(self.basis, rational)
        self.plan = kernel_plan(self.basis, rational)
        # The sums of an extraction have as many terms as functions act on the element.
        terms = 0 if block.extraction is None else block.n
        self.slack = (SLACK + 2.0 + 2.0 * terms) * UNIT_ROUNDOFF * np.abs(self.values).max(axis=0)
        self.degree = max(degree for _, degree in self.determinant.form.sizes)

    @property
    def range(self) -> slice:
        return slice(self.first, self.first + self.block.elements)

    def control_net(self, elements: Index | slice) -> Array:
        return np.ascontiguousarray(bezier_coefficients(self.block, self.values, elements))

    def _pieces(self, elements: Index, bytes_each: int) -> Iterator[Index]:
        per_element = 8 * self.block.n * self.values.shape[1] + bytes_each
        if isinstance(self.block.extraction, Patterns):
            per_element += 8 * self.block.n * self.block.basis.n
        step = max(2 * LANES, _CHUNK_BYTES // per_element)
        for start in range(0, len(elements), step):
            yield elements[start : start + step]

    def _coefficients(self, elements: Index, keep: bool) -> tuple[Array, Array, Array, Index, Array]:
        """Coefficients (e, k), those of w^4, bounds (e, 4), vertex (e,), relative rounding bound of w^4 (e,)."""
        P = self.control_net(elements)
        size = len(self.plan.used) if keep else 0
        numerator = np.empty((len(P), size))
        weight = np.empty((len(P), size if self.rational else 0))
        bounds, corner = np.empty((len(P), 4)), np.zeros((len(P),), dtype=np.int64)
        run([
            partial(coefficients, self.plan, P, self.slack, a, b, keep, numerator, weight, bounds, corner)
            for a, b in ranges(-(-len(P) // LANES))
        ])
        relative = np.zeros(len(P))
        if self.rational:
            thin = np.maximum(P[:, :, 0].min(axis=1), np.finfo(float).tiny)
            relative = self.plan.gammas[2] + 5.0 * self.slack[0] / thin
        return numerator, weight, bounds, corner, relative

    def first_pass(self, enclosure: _Enclosure) -> None:
        """Bounds from the coefficients of whole elements."""
        for elements in self._pieces(np.arange(self.block.elements), 0):
            _, _, bounds, corner, relative = self._coefficients(elements, False)
            points = self.determinant.vertices[corner]
            self._record(elements, bounds[:, 0], bounds[:, 1], bounds[:, 2], relative, points, enclosure)

    def refine(
        self, elements: Index, floor: float, tolerance: float, max_depth: int, budget: int, enclosure: _Enclosure
    ) -> None:
        """Bisect elements until the sign is decided and the bounds reach ``floor`` or the relative gap."""
        lines, pairs, corners = _splits(self.basis, self.rational)
        depth = max_depth * self.block.basis.cell.dim
        for some in self._pieces(elements, 16 * len(self.plan.used)):
            numerator, weight, start, _, relative = self._coefficients(some, True)
            growth = gamma(depth * self.degree)
            relative = relative + growth
            error = start[:, 2] + 2.0 * growth * start[:, 3]
            bounds, points = np.empty((len(some), 2)), np.empty((len(some), 3))
            tasks = min(threads(), len(some))
            run([
                partial(
                    bisect, numerator, weight, error, floor, tolerance, depth, budget, lines, pairs, corners,
                    self.determinant.vertices, first, tasks, bounds, points,
                )
                for first in range(tasks)
            ])
            self._record(some, bounds[:, 0], bounds[:, 1], error, relative, points, enclosure)

    def _record(
        self, elements: Index, least: Array, value: Array, error: Array, relative: Array, points: Array,
        enclosure: _Enclosure,
    ) -> None:
        rows = self.first + elements
        lower, upper = least - error, value + error
        lower = lower - 2.0 * relative * np.abs(lower)
        upper = upper + 2.0 * relative * np.abs(upper)
        # Overflow and weights that are not positive leave no bound.
        enclosure.lower[rows] = np.where(np.isnan(lower), -np.inf, lower)
        enclosure.upper[rows] = np.where(np.isnan(upper), np.inf, upper)
        enclosure.error[rows] = error
        enclosure.points[rows] = points


@cache
def _splits(basis: Bernstein, rational: bool) -> tuple[tuple[Index, Index, Index], Index, Index]:
    made = determinant(basis, rational)
    return splits(made.form, made.vertices)


def _sharpen(jobs: list[_Job], enclosure: _Enclosure, tolerance: float, max_depth: int, budget: int) -> None:
    """Refine the elements that compete for the smallest determinant until it is known to the relative gap."""
    done = np.zeros(len(enclosure.lower), dtype=bool)
    step = 2 * LANES
    while True:
        best = float(enclosure.upper.min(initial=np.inf))
        floor = best - tolerance * abs(best)
        low = np.isfinite(enclosure.lower) & (enclosure.lower < floor - 2.0 * enclosure.error)
        competing = np.flatnonzero(low & ~done)
        if not len(competing):
            return
        competing = competing[np.argsort(enclosure.lower[competing])[:step]]
        done[competing] = True
        for job in jobs:
            mine = competing[(competing >= job.range.start) & (competing < job.range.stop)]
            job.refine(mine - job.first, floor, tolerance, max_depth, budget, enclosure)
        step *= 2


def _witnesses(jobs: list[_Job], verdict: NDArray[np.int8], enclosure: _Enclosure) -> Witnesses:
    columns: list[list[Array]] = [[np.empty(0)], [np.empty(0)], [np.empty((0, 3))], [np.empty(0)], [np.empty((0, 3))]]
    for job in jobs:
        rows = job.first + np.flatnonzero(verdict[job.range] < 0)
        xi = enclosure.points[rows]
        if job.determinant.collapsed:
            xi = np.column_stack([xi[:, :2] * (1.0 - xi[:, 2:]), xi[:, 2]])
        for some in job._pieces(np.arange(len(rows)), 0):
            elements = rows[some] - job.first
            P = job.control_net(elements)
            B = job.basis.tabulate(xi[some], 0)[0]
            x = np.einsum("eb,ebc->ec", B, P)
            x = x[:, 1:] / x[:, :1] if job.rational else x
            values = (np.full(len(some), job.number), elements, xi[some], enclosure.upper[rows[some]], x)
            for column, value in zip(columns, values):
                column.append(value)
    block, element, xi, det, x = (np.concatenate(column) for column in columns)
    return Witnesses(block.astype(np.int64), element.astype(np.int64), xi, det, x)


def as_bernstein(basis: LocalBasis) -> Bernstein:
    """Return the basis if it is a Bernstein basis.

    Raises
    ------
    InputError : it is of another kind.
    """
    if not isinstance(basis, Bernstein):
        raise InputError(f"no certificate for the basis {type(basis).__name__}; only Bernstein bases enclose")
    return basis
