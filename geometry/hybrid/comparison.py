r"""What refinement of a volume leaves as it was, in numbers.

With x_c and x_f the maps of a coarse and a fine volume of one solid, sample points of the fine elements have the
coordinates xi_c = x_c^-1(x_f(xi_f)) in the coarse ones, and

    skin            largest distance between the two skins, relative to the diagonal
    skin_map        largest residual of an affine fit of xi_c as a function of xi_f on an element of the skin
    inside_map      the same on cells
    skin_crossing, inside_crossing   share of fine elements that lie in several coarse ones
    nested          largest residual of a random function of the coarse space, fitted by the fine functions on each
                    cell, relative to the function

A map that is kept has residuals of rounding; spaces are nested where the last number is.

Axis letters: e element, q point, c component.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from iga.block import bezier_coefficients
from iga.cells import Cell
from iga.domain import Domain
from iga.locate import Location, Tree, locate, tree
from iga.located import Located

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Preserved:
    """What refinement left as it was; see the module docstring. NaN: no element lies in one coarse element."""

    skin: float
    skin_map: float
    inside_map: float
    skin_crossing: float
    inside_crossing: float
    nested: float


def preserved(coarse: Domain, fine: Domain, elements: int = 60, seed: int = 20196) -> Preserved:
    """Compare two volumes of one solid at random points.

    Parameters
    ----------
    elements : at most so many cells and elements of the skin are compared.
    """
    random = np.random.default_rng(seed)
    diagonal = float(np.linalg.norm(np.ptp(coarse.points, axis=0)))
    boxes = tree(coarse)
    samples = _skin_points(fine, elements, random)
    where = locate(coarse, np.concatenate([x for x, _ in samples]), nearest=True, boxes=boxes)
    back = locate(fine, np.concatenate([x for x, _ in _skin_points(coarse, elements, random)]), nearest=True)
    apart = max(float(where.distance.max()), float(back.distance.max()))
    skin_map, skin_crossing = _affine_fit(samples, where)
    field = random.standard_normal((coarse.space.n, 1))
    inside, crossing, nested = _in_cells(coarse, fine, boxes, field, elements, random)
    return Preserved(apart / diagonal, skin_map, inside, skin_crossing, crossing, nested)


def _pick(sizes: list[int], count: int, random: np.random.Generator) -> list[Index]:
    """At most ``count`` of all elements of some blocks, block by block."""
    total = sum(sizes)
    chosen = np.sort(random.choice(total, min(count, total), replace=False))
    ends = np.cumsum([0, *sizes])
    return [chosen[(chosen >= a) & (chosen < b)] - a for a, b in pairwise(ends)]


def _inner(cell: Cell, count: int, random: np.random.Generator) -> Array:
    """Points well inside a cell."""
    share = 0.9 * random.dirichlet(np.ones(len(cell.vertices)), count) + 0.1 / len(cell.vertices)
    return np.asarray(share @ cell.vertices)


def _skin_points(domain: Domain, count: int, random: np.random.Generator) -> list[tuple[Array, Array]]:
    """Points (q, 3) in space of some facets, and their coordinates (q, 2) on the facet."""
    facets = [f for own in domain.boundaries.values() for f in own]
    found = []
    for f, chosen in zip(facets, _pick([len(f.elements) for f in facets], count, random)):
        block = domain.space.blocks[f.block]
        face = block.basis.cell.faces[f.face]
        s = _inner(face.cell, 12, random)
        values = block.basis.tabulate(face.origin + s @ face.axes.T, 0)[0]
        net = bezier_coefficients(block, domain.points, f.elements[chosen])
        found += [(x, s) for x in values @ net]
    return found


def _affine_fit(samples: list[tuple[Array, Array]], where: Location) -> tuple[float, float]:
    """Largest residual of affine fits of the located coordinates, and the share of samples in several elements.

    Parameters
    ----------
    samples : of each fine element or facet, points (q, 3) and their own coordinates (q, d).
    where : all these points in the coarse volume, one sample after the other.
    """
    worst, crossing, at = np.nan, 0, 0
    for x, s in samples:
        rows = slice(at, at + len(x))
        at += len(x)
        if len(set(zip(where.block[rows].tolist(), where.element[rows].tolist()))) > 1:
            crossing += 1
        else:
            worst = np.fmax(worst, _affine_residual(s, where.xi[rows]))
    return float(worst), crossing / len(samples)


def _in_cells(
    coarse: Domain, fine: Domain, boxes: Tree, field: Array, count: int, random: np.random.Generator
) -> tuple[float, float, float]:
    worst, nested, crossing, total, largest = np.nan, 0.0, 0.0, 0, float(np.abs(field).max())
    for block, chosen in zip(fine.space.blocks, _pick([b.elements for b in fine.space.blocks], count, random)):
        if not len(chosen):
            continue
        s = _inner(block.basis.cell, 2 * block.basis.n, random)
        values = block.basis.tabulate(s, 0)[0]
        net = bezier_coefficients(block, fine.points, chosen)
        x = np.asarray(values @ net)
        where = locate(coarse, x.reshape(-1, 3), nearest=True, boxes=boxes)
        wanted = Located(coarse, where.block, where.element, where.xi).at(field).reshape(len(chosen), -1)
        off = wanted - wanted @ np.linalg.pinv(values).T @ values.T
        nested = max(nested, float(np.abs(off).max()))
        residual, share = _affine_fit([(own, s) for own in x], where)
        worst = np.fmax(worst, residual)
        crossing += share * len(chosen)
        total += len(chosen)
    return float(worst), crossing / total, nested / largest


def _affine_residual(s: Array, xi: Array) -> float:
    A = np.column_stack([np.ones(len(s)), s])
    return float(np.abs(A @ np.linalg.lstsq(A, xi, rcond=None)[0] - xi).max())
