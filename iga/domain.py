"""Spaces and domains: what a geometry source produces and everything else consumes.

A `Space` is blocks of elements over one global set of functions. With weights w the functions are rational,

    R_i = w_i N_i / sum_j w_j N_j,

and because the weights define the functions they belong to the space. A `Domain` is a space with a control point for
each function, so that the solid is x = sum_i R_i P_i, and with names for parts of its boundary.

Axis letters: n global function, e element, f facet, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.block import Block, Kronecker, Patterns, bezier_coefficients, unity_defect
from iga.errors import InputError

if TYPE_CHECKING:
    from iga.locate import Location

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Space:
    """Functions on blocks of elements.

    Attributes
    ----------
    blocks : elements grouped by cell, degree and number of functions.
    n : number of functions.
    weights : (n,) positive weights of rational functions, or None.
    constraint : (n, n_free) matrix T that gives all coefficients from free ones (hanging nodes, glue), or None.
    """

    blocks: tuple[Block, ...]
    n: int
    weights: Array | None = None
    constraint: csr_array | None = None

    @property
    def elements(self) -> int:
        """Number of elements of all blocks."""
        return sum(block.elements for block in self.blocks)


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of one kind: local face ``face`` of ``elements`` (f,) in block number ``block``."""

    block: int
    face: int
    elements: Index


@dataclass(frozen=True, eq=False)
class Provenance:
    """Where a domain came from, and what its source needs to refine it.

    Attributes
    ----------
    source : name of the geometry source, or "" for a domain made by hand.
    input : name of the file it was built from, or "".
    parameters : settings of the build.
    arrays : the source's own data (a hex mesh, knot vectors, ...), saved with the domain.
    """

    source: str = ""
    input: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Domain:
    """A solid: a space with control points and named boundaries.

    Attributes
    ----------
    space : the functions, which carry both geometry and solution.
    points : (n, 3) control points.
    boundaries : facets of each named part of the boundary; parts may overlap.
    attributes : coefficients (n,) or (n, k) of fields given with the geometry, such as a graded material.
    provenance : the source and its data.
    report : what the source has to say about the build (numbers and short texts).
    """

    space: Space
    points: Array
    boundaries: Mapping[str, tuple[Facets, ...]] = field(default_factory=dict)
    attributes: Mapping[str, Array] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.points.shape != (self.space.n, 3):
            raise InputError(f"{self.space.n} functions need {self.space.n} control points, not {self.points.shape}")
        for name in ("boundaries", "attributes", "report"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def plot(self, path: str | Path | None = None, **options: Any) -> NDArray[np.uint8]:
        """Draw the solid off screen, into a PNG file if told; options of `iga.pictures.plot.plot_domain`."""
        from iga.pictures.plot import plot_domain  # needs a graphics library, which nothing else here does

        return plot_domain(self, path, **options)

    def locate(self, points: Array, **options: Any) -> Location:
        """Elements and reference coordinates of points (p, 3); options of `iga.locate.locate`.

        The other way, the place of reference points, is `iga.locate.places`.
        """
        from iga.locate import locate  # which needs the certificate's tools, and they need this file

        return locate(self, points, **options)

    @cached_property
    def map_degrees(self) -> tuple[tuple[int, ...], ...]:
        """Degree of the map in each direction of each block, which may be less than that of its functions.

        Found on hexahedra from vanishing differences of Bernstein coefficients; other cells give their own degree.
        """
        return tuple(_map_degree(block, self.points) for block in self.space.blocks)


def _map_degree(block: Block, points: Array) -> tuple[int, ...]:
    if block.basis.cell.name != "hexahedron":
        return block.basis.degree
    found = [1] * 3
    scale = 1e-12 * float(np.abs(points).max(initial=0.0))
    for start in range(0, block.elements, 4096):
        control = bezier_coefficients(block, points, slice(start, start + 4096))
        grid = control.reshape(len(control), *(p + 1 for p in block.basis.degree), 3)
        for d, p in enumerate(block.basis.degree):
            while found[d] < p and np.abs(np.diff(grid, n=found[d] + 1, axis=d + 1)).max(initial=0.0) > scale:
                found[d] += 1
    return tuple(found)


def facets_of(domain: Domain, names: str | list[str] | tuple[str, ...]) -> tuple[Facets, ...]:
    """Facets of the boundaries that match a name or shell pattern (``"face_*"``), each facet once.

    Raises
    ------
    InputError : a name matches no boundary, or only empty ones.
    """
    found: dict[str, tuple[Facets, ...]] = {}
    for pattern in [names] if isinstance(names, str) else names:
        matched = {n: f for n, f in domain.boundaries.items() if fnmatchcase(n, pattern)}
        if not matched:
            there = ", ".join(sorted(domain.boundaries)) or "none"
            raise InputError(f"no boundary is called {pattern!r}; there are: {there}")
        found |= matched
    merged: dict[tuple[int, int], list[Index]] = {}
    for facets in found.values():
        for f in facets:
            merged.setdefault((f.block, f.face), []).append(f.elements)
    result = tuple(Facets(b, k, np.unique(np.concatenate(e))) for (b, k), e in sorted(merged.items()))
    if not sum(len(f.elements) for f in result):
        raise InputError(f"boundary {names!r} has no facets")
    return result


def grouped_facets(table: Index) -> tuple[Facets, ...]:
    """Facets by block and local face, from rows (f, 3) of block, element and local face in any order."""
    kinds = np.unique(table[:, [0, 2]], axis=0)
    return tuple(
        Facets(int(b), int(f), np.sort(table[(table[:, 0] == b) & (table[:, 2] == f), 1])) for b, f in kinds
    )


def all_facets(domain: Domain) -> tuple[Facets, ...]:
    """Facets of all named boundaries, each once."""
    return facets_of(domain, list(domain.boundaries)) if domain.boundaries else ()


def homogeneous(space: Space, columns: Array) -> Array:
    """Coefficients (n, c) of fields u as they are, or (w u, w), (n, c+1), where the space is rational."""
    if space.weights is None:
        return columns
    return np.column_stack([columns * space.weights[:, None], space.weights])


def with_report(domain: Domain, **entries: Any) -> Domain:
    """Return the domain with entries added to its report."""
    return replace(domain, report={**domain.report, **entries})


def counts(domain: Domain) -> dict[str, int]:
    """Number of elements of each cell, by cell name."""
    result: dict[str, int] = {}
    for block in domain.space.blocks:
        result[block.basis.cell.name] = result.get(block.basis.cell.name, 0) + block.elements
    return result


def max_degree(domain: Domain) -> int:
    """Highest degree of any block in any direction."""
    return max(max(block.basis.degree) for block in domain.space.blocks)


def check(domain: Domain) -> None:
    """Check a domain's arrays against each other in time linear in its size.

    Raises
    ------
    InputError : the first thing that is wrong, by name: non-finite control points, weights that are not positive, dof
        or pattern numbers out of range, functions on no element, extraction that does not sum to one (of rational
        functions: a sum of weighted functions that is not positive), facets out of range.
    """
    space = domain.space
    bad = np.flatnonzero(~np.isfinite(domain.points).all(axis=1))
    if len(bad):
        raise InputError(f"control point {bad[0]} is not finite")
    if space.weights is not None:
        if space.weights.shape != (space.n,):
            raise InputError(f"{space.n} functions need {space.n} weights, not {space.weights.shape}")
        bad = np.flatnonzero(~(space.weights > 0))
        if len(bad):
            raise InputError(f"weight {bad[0]} is {space.weights[bad[0]]:g}; weights must be positive")
    used = np.zeros(space.n, dtype=bool)
    for number, block in enumerate(space.blocks):
        _check_block(number, block, space.n)
        _check_sum(number, block, space.weights)
        used[block.dofs] = True
    if space.constraint is None and not used.all():
        raise InputError(f"function {np.flatnonzero(~used)[0]} acts on no element")
    for name, facets in domain.boundaries.items():
        for f in facets:
            if not 0 <= f.block < len(space.blocks):
                raise InputError(f"boundary {name!r} names block {f.block} of {len(space.blocks)}")
            block = space.blocks[f.block]
            if not 0 <= f.face < len(block.basis.cell.faces):
                raise InputError(f"boundary {name!r} names face {f.face} of a {block.basis.cell.name}")
            if len(f.elements) and not (f.elements.min() >= 0 and f.elements.max() < block.elements):
                raise InputError(f"boundary {name!r} names an element outside block {f.block}")
    for name, values in domain.attributes.items():
        if len(values) != space.n:
            raise InputError(f"attribute {name!r} has {len(values)} coefficients for {space.n} functions")


def _check_block(number: int, block: Block, n: int) -> None:
    if block.elements and not (block.dofs.min() >= 0 and block.dofs.max() < n):
        raise InputError(f"block {number}: function numbers lie outside 0..{n - 1}")
    extraction = block.extraction
    operators: list[tuple[Array, Index]] = []
    if isinstance(extraction, Patterns):
        operators = [(extraction.C, extraction.pattern)]
    elif isinstance(extraction, Kronecker):
        operators = [(f, extraction.pattern[:, d]) for d, f in enumerate(extraction.factors)]
    for C, pattern in operators:
        if len(pattern) != block.elements:
            raise InputError(f"block {number}: {len(pattern)} extraction patterns for {block.elements} elements")
        if len(pattern) and not (pattern.min() >= 0 and pattern.max() < len(C)):
            raise InputError(f"block {number}: extraction pattern numbers lie outside 0..{len(C) - 1}")


def _check_sum(number: int, block: Block, weights: Array | None) -> None:
    """Functions sum to one; those of rational spaces do by the quotient, if the weight function is positive."""
    off, pattern = unity_defect(block)
    if off <= 1e-9:
        return
    if weights is None:
        raise InputError(f"block {number}: extraction pattern {pattern} does not sum to one ({off:.1e})")
    for start in range(0, block.elements, 4096):
        least = bezier_coefficients(block, weights[:, None], slice(start, start + 4096))[..., 0].min(axis=1)
        if not (least > 0.0).all():
            element = start + int(np.nanargmin(least))
            raise InputError(
                f"block {number}: the weight function has the coefficient {least.min():.1e} on element {element}; "
                "rational functions need positive ones"
            )
