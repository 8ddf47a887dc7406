"""Domains of meccano solids: boundaries by side, and what refinement needs, kept in the provenance.

Axis letters: n function, c leaf cell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.meccano import t_spline, traces
from geometry.meccano.collocation import prolongation
from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.settings import NAME
from geometry.meccano.t_spline import TSpline
from geometry.meccano.tmesh import from_arrays, refined, to_arrays
from iga.domain import Domain, Facets, Provenance
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def bare(space: Hierarchy | TSpline, points: Array) -> Domain:
    """Domain of control points (n, 3): boundaries "boundary" and "side0", "side1", .. (rows of ``boundary_sides``)."""
    sides = t_spline.boundaries(space) if isinstance(space, TSpline) else traces.boundaries(space)
    merged: dict[tuple[int, int], list[Index]] = {}
    for facets in sides.values():
        for f in facets:
            merged.setdefault((f.block, f.face), []).append(f.elements)
    whole = tuple(Facets(b, k, np.unique(np.concatenate(e))) for (b, k), e in sorted(merged.items()))
    return Domain(space.space, points, {"boundary": whole, **sides})


def build_domain(
    space: Hierarchy | TSpline, points: Array, provenance: Provenance, report: Mapping[str, Any] | None = None,
    attributes: Mapping[str, Array] | None = None,
) -> Domain:
    """`bare` with what refinement needs, where it came from and what is said of it."""
    arrays = {**provenance.arrays, **to_arrays(space.tmesh)}
    if isinstance(space, Hierarchy):
        arrays["degree"] = np.array(space.degree)
    return replace(
        bare(space, points), attributes=attributes or {}, provenance=replace(provenance, arrays=arrays),
        report=report or {},
    )


def stored_space(domain: Domain) -> Hierarchy:
    """The space of a domain from what it carries.

    Raises
    ------
    InputError : the domain does not carry a T-mesh, or not the one of its space.
    """
    arrays = domain.provenance.arrays
    if domain.provenance.source == NAME and "degree" not in arrays and "cell_level" in arrays:
        raise InputError(
            "the paper's T-splines on finer T-meshes do not contain those on coarser ones, so the solid cannot be "
            "refined as it is; build it with a smaller tolerance, or with space=optimal"
        )
    if domain.provenance.source != NAME or "degree" not in arrays:
        raise InputError("the domain carries no T-mesh of hierarchical splines")
    space = hierarchy(from_arrays(arrays), int(np.asarray(arrays["degree"])))
    if space.space.n != domain.space.n:
        raise InputError(f"the stored T-mesh has {space.space.n} functions, the domain {domain.space.n}")
    return space


def refine_domain(domain: Domain, cells: Index | None = None, reach: int = 1) -> Domain:
    """Split cells, all by default, with so many neighbours around them; the solid stays exactly as it is.

    Raises
    ------
    InputError : see `stored_space`; or cell numbers out of range.
    """
    own = stored_space(domain)
    if cells is not None:
        cells = np.asarray(cells)
        bad = cells[(cells < 0) | (cells >= own.tmesh.cells)] if cells.dtype != np.bool_ else cells[:0]
        if len(bad):
            raise InputError(f"there is no cell {bad[0]} among {own.tmesh.cells} cells")
    finer = hierarchy(refined(own.tmesh, cells, reach=0 if cells is None else reach), own.degree)
    T = prolongation(own, finer)
    attributes = {name: np.asarray(T @ values) for name, values in domain.attributes.items()}
    return build_domain(finer, T @ domain.points, domain.provenance, {}, attributes)
