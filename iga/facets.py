"""Facets on the outside of a solid: those that boundaries name, and those that nothing names.

Axis letters: e element, f facet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from iga.domain import Domain, Facets
from iga.sampling import Samples

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

COINCIDENT = 1e-8
"""Distance of the centres of a facet that two elements share, in sizes of the solid: far more than rounding."""


def named(domain: Domain, keep: list[Mask] | None = None) -> list[tuple[int, Facets]]:
    """Facets of kept elements on named boundaries, each once: with the number of the first name that holds it."""
    taken: dict[tuple[int, int], Index] = {}
    found = []
    for part, facets in enumerate(domain.boundaries.values()):
        for f in facets:
            before = taken.get((f.block, f.face), np.empty(0, dtype=np.int64))
            elements = np.setdiff1d(f.elements, before)
            taken[f.block, f.face] = np.union1d(before, elements)
            if keep is not None:
                elements = elements[keep[f.block][elements]]
            if len(elements):
                found.append((part, Facets(f.block, f.face, elements)))
    return found


def exposed(domain: Domain, keep: list[Mask] | None = None) -> list[Facets]:
    """Facets of kept elements that no other kept element shares and no boundary names, matched by their centres.

    Parameters
    ----------
    keep : for each block (e,) which elements are there; all by default.
    """
    keep = [np.ones(block.elements, dtype=bool) for block in domain.space.blocks] if keep is None else keep
    kinds = [
        (number, k, np.flatnonzero(keep[number]))
        for number, block in enumerate(domain.space.blocks)
        for k in range(len(block.basis.cell.faces))
    ]
    centres = []
    for number, k, elements in kinds:
        face = domain.space.blocks[number].basis.cell.faces[k]
        middle = face.origin + face.axes @ face.cell.centre
        centres.append(Samples(domain, number, elements, middle[None]).x[:, 0])
    places = np.concatenate(centres)
    if not len(places):
        return []
    scale = float(np.ptp(domain.points, axis=0).max()) or 1.0
    single = np.ones(len(places), dtype=bool)
    single[cKDTree(places).query_pairs(COINCIDENT * scale, output_type="ndarray").ravel()] = False
    claimed: dict[tuple[int, int], list[Index]] = {}
    for _, f in named(domain, keep):
        claimed.setdefault((f.block, f.face), []).append(f.elements)
    found, at = [], 0
    for number, k, elements in kinds:
        own = elements[single[at : at + len(elements)]]
        at += len(elements)
        own = np.setdiff1d(own, np.concatenate(claimed.get((number, k), [np.empty(0, dtype=np.int64)])))
        if len(own):
            found.append(Facets(number, k, own))
    return found
