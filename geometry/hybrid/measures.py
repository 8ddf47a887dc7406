r"""What a skin is worth: distances, areas, volume, gaps, crossings and folds, and per face the share that is exact.

Axis letters: e element, k side, s sample on a side, c component.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face, curve_points, winding
from geometry.hybrid.assembling import Assembled
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import BICUBIC
from geometry.hybrid.grid import ALONG
from geometry.hybrid.sizing import Sizing
from geometry.hybrid.triangulation import SPLIT
from geometry.simplices.crossing import crossing_pairs
from iga.errors import InputError
from iga.quadrature import gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

EXACT = 1e-12
"""Distance, relative to the diagonal, within which an element is the CAD surface."""
AIM, ORDER = 0.5, 1.0 / 3.5
"""Share of the tolerance that smaller elements are to reach, and how sizes follow distances, which fall with the third
to the fourth power of sizes."""
LEAST, MOST, HALF = 0.4, 0.6, 0.5
"""Shares of an element's size: the least asked for at once, because far from the limit sizes and distances follow no
power; the most asked for where it is too far, so that rounds come to an end; that of one that folds or is cut."""
HOLD = 0.15
"""Share of the tolerance from which on elements must not grow."""

_AROUND = {
    3: np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]), 4: np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
}
"""Corners in the reference cell, in the order of `Part.corners`."""


@dataclass(frozen=True, eq=False)
class Finer:
    """Where elements must be smaller: places and sizes, and the largest cell of some faces' grids; faces that fold or
    are cut, and the pieces of edges (k, 3), as in `Assembled.curves`, beside their elements that do, or that
    are too far and lie between two pieces.
    """

    sizing: Sizing
    cells: dict[int, float]
    faulty: frozenset[int]
    pieces: Index


def measure(
    brep: Brep, made: Assembled, meshes: list[FaceMesh], tolerance: float, off: Array
) -> tuple[dict[str, Any], Finer]:
    """Report of a skin (see `skin.build_skin`), and where elements must be smaller.

    Parameters
    ----------
    tolerance : wanted distance, relative to the diagonal.
    off : distance of each edge from its faces, that no element beside it can do away with.
    """
    straight = _straight(made)
    pairs = crossing_pairs(made.points[: made.vertices], straight.corners, straight.patch)
    table = _Elements(*(
        np.concatenate([getattr(part, name) for part in made.parts])
        for name in ("distance", "folded", "owner", "banded", "bound")
    ))
    bad = table.folded.copy()
    bad[straight.element[pairs.ravel()]] = True
    report = _report(brep, made, meshes, table, straight, pairs, bad)
    reach = np.maximum(tolerance * brep.diagonal, 2.0 * beside_edges(made, off))  # the edge is half way between faces
    return report, _finer(made, table, straight, bad, reach)


@dataclass(frozen=True, eq=False)
class _Elements:
    """The columns of all parts (e,), one part after the other; see `assembling.Part`."""

    distance: Array
    folded: Mask
    owner: Index
    banded: Mask
    bound: Array


@dataclass(frozen=True, eq=False)
class _Straight:
    """Straight triangles (t, 3) between the vertices of elements, the element (t,) of each, and the same (t,) for those
    of quadrilaterals, whose two halves are one patch, but -1 for others; lengths of their sides (t, 3), centres (t, 3)
    and shapes (t,), 1 for equilateral ones.
    """

    corners: Index
    element: Index
    patch: Index
    sides: Array
    centre: Array
    quality: Array


def _straight(made: Assembled) -> _Straight:
    start = np.cumsum([0] + [len(part.corners) for part in made.parts])
    triangles, element, patch = [], [], []
    for part, first in zip(made.parts, start.tolist()):
        numbers = first + np.arange(len(part.corners))
        for a in range(1, part.corners.shape[1] - 1):
            triangles.append(part.corners[:, [0, a, a + 1]])
            element.append(numbers)
            patch.append(numbers if part.block.basis is BICUBIC else np.full(len(numbers), -1))
    corners = np.concatenate(triangles)
    x = made.points[corners]
    sides = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=-1)
    double = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    quality = 2.0 * np.sqrt(3.0) * double / (sides**2).sum(axis=1)
    return _Straight(corners, np.concatenate(element), np.concatenate(patch), sides, x.mean(axis=1), quality)


def _integrals(made: Assembled) -> tuple[Array, float]:
    """Area of each element (e,), and the volume inside."""
    area, volume = [], 0.0
    middle = made.points.mean(axis=0)
    for part in made.parts:
        rule = gauss(part.block.basis.cell, 5)
        values, gradients = part.block.basis.tabulate(rule.points, 1)
        local = made.points[part.block.dofs]
        X = np.einsum("kn,enc->ekc", values, local)
        J = np.einsum("knd,enc->ekcd", gradients, local)
        normal = np.cross(J[..., 0], J[..., 1])
        volume += float(np.einsum("k,ekc,ekc->", rule.weights, X - middle, normal)) / 3.0
        area.append(np.einsum("k,ek->e", rule.weights, np.linalg.norm(normal, axis=-1)))
    return np.concatenate(area), volume


def _report(
    brep: Brep, made: Assembled, meshes: list[FaceMesh], table: _Elements, straight: _Straight, pairs: Index, bad: Mask
) -> dict[str, Any]:
    """Numbers of a skin of which some straight triangles (k, 2) cross, and elements fold or are cut (e,)."""
    areas, volume = _integrals(made)
    distance = table.distance
    exact = distance <= EXACT * brep.diagonal
    names = [face.name for face in brep.faces]
    report = {
        "elements": len(distance), "quadrilaterals": sum(len(m.quads) for m in meshes),
        "max_distance": float(distance.max() / brep.diagonal), "worst_face": names[table.owner[distance.argmax()]],
        "exact_area_share": float(areas[exact].sum() / areas.sum()), "area": float(areas.sum()),
        "band_area": float(areas[table.banded].sum()), "volume": volume,
        "volume_error": abs(volume / brep.volume - 1.0), "watertight_gap": _gap(made, names) / brep.diagonal,
        "crossings": len(pairs), "folded": int(table.folded.sum()), "min_quality": float(straight.quality.min()),
        "cad_faces_with_quadrilaterals": _per_face(brep, meshes, table, areas, exact),
    }  # fmt: skip
    if bad.any():
        report["faulty_faces"] = sorted({names[f] for f in table.owner[bad].tolist()})
    return report


def _finer(made: Assembled, table: _Elements, straight: _Straight, bad: Mask, reach: Array) -> Finer:
    """Where elements must be smaller: those that fold or are cut (e,), and those that are farther than their ``reach``
    (e,) from the CAD surfaces.
    """
    distance, owner = table.distance, table.owner
    failing = bad | (distance > reach)
    # What is nearly too far is held at its size, or the next mesh, where it may be larger, is too far there.
    some = failing | (distance > HOLD * reach)
    if not failing.any():
        some[:] = False
    shrink = np.clip((AIM * reach / (distance + 1e-300)) ** ORDER, LEAST, 1.0) / SPLIT
    shrink = np.where(bad, HALF, np.where(failing, np.minimum(shrink, MOST), shrink))
    longest = np.zeros(len(distance))
    np.maximum.at(longest, straight.element, straight.sides.max(axis=1))
    centre = np.zeros((len(distance), 3))
    np.add.at(centre, straight.element, straight.centre / np.bincount(straight.element)[straight.element][:, None])
    wanted = longest * shrink
    bicubic = np.repeat([part.block.basis is BICUBIC for part in made.parts], [len(p.corners) for p in made.parts])
    least = np.full(int(owner.max()) + 1, np.inf)
    np.minimum.at(least, owner[failing & bicubic], wanted[failing & bicubic])
    cells = {int(f): float(least[f]) for f in np.flatnonzero(np.isfinite(least))}
    pieces = _pieces(made, bad | (failing & _between_curves(made)))
    return Finer(Sizing(centre[some], wanted[some]), cells, frozenset(owner[bad].tolist()), pieces)


def _sides(made: Assembled) -> tuple[Index, list[Index]]:
    """A number for each piece of an edge (s,) and for each side of the elements of each part (e, m)."""
    weight = np.array([made.vertices, 1])
    sides = [np.stack([part.corners, np.roll(part.corners, -1, axis=1)], axis=2) for part in made.parts]
    return np.sort(made.curves[:, :2], axis=1) @ weight, [np.sort(pair, axis=2) @ weight for pair in sides]


def _pieces(made: Assembled, some: Mask) -> Index:
    """Pieces of edges (k, 3) that are sides of some elements."""
    curves, sides = _sides(made)
    first = np.cumsum([len(own) for own in sides])[:-1]
    keys = [own[mine].ravel() for own, mine in zip(sides, np.split(some, first))]
    return made.curves[np.isin(curves, np.concatenate(keys))]


def beside_edges(made: Assembled, off: Array) -> Array:
    """For each element (e,) the largest value of an edge at which it has a vertex, from those of all edges."""
    ends, edge = made.curves[:, :2], made.curves[:, 2]
    at = np.zeros(made.vertices)
    np.maximum.at(at, ends.ravel(), np.repeat(off[edge], 2))
    return np.concatenate([at[part.corners].max(axis=1, initial=0.0) for part in made.parts])


def _between_curves(made: Assembled) -> Mask:
    """Elements (e,) with two sides or more on edges, as at the tip of a face: only their pieces matter."""
    curves, sides = _sides(made)
    return np.concatenate([np.isin(own, curves).sum(axis=1) >= 2 for own in sides])


def _per_face(
    brep: Brep, meshes: list[FaceMesh], table: _Elements, area: Array, exact: Mask
) -> list[dict[str, Any]]:
    """A row for each face with quadrilaterals, from areas and exactness of elements (e,)."""
    distance, banded, bound = table.distance, table.banded, table.bound
    rows = []
    for f, (face, made) in enumerate(zip(brep.faces, meshes)):
        if made.grid is None:
            continue
        mine = table.owner == f
        total = float(area[mine].sum())
        rows.append({
            "face": face.name, "kind": face.kind, "quadrilaterals": len(made.quads), "triangles": len(made.triangles),
            **count_intervals(face), "area": total, "band_area": float(area[mine & banded].sum()),
            "exact_share": float(area[mine & exact].sum() / total),
            "distance_outside_band": float(distance[mine & ~banded].max(initial=0.0) / brep.diagonal),
        })
        e, n = np.flatnonzero(mine), len(made.quads)  # quadrilaterals first
        if made.polar is not None:
            first = n + made.first_polar
            polar_area = area[e[first : first + len(made.polar.side)]].sum()
            rows[-1] |= {"polar": len(made.polar.side), "polar_area": float(polar_area)}
        if made.band is not None:
            t = len(made.band.segment)
            banded_area = area[e[n - len(made.band.low) : n]].sum() + area[e[n : n + t]].sum()
            rows[-1] |= {
                "right_triangles": t, "rectangles": len(made.band.low), "without_right_triangle": made.band.without,
                "omega_banded": float(banded_area / total),
            }  # fmt: skip
        proved = bound[mine & ~np.isnan(bound)]
        if len(proved) and len(proved) == len(made.quads):
            rows[-1]["proved_distance"] = float(proved.max() / brep.diagonal)
    return rows


def count_intervals(face: Face) -> dict[str, int]:
    """How many knot intervals of a face are interior, trimmed (crossed or touched by a curve) and exterior."""
    lines = [np.unique(k) for k in face.surface.knots]
    met = np.zeros(tuple(len(x) - 1 for x in lines), dtype=bool)
    t = np.linspace(0.0, 1.0, 1 + 64 * max(8, *met.shape))
    for loop in face.loops:
        for c in loop:
            p = curve_points(c.curve, t)
            hit = [
                (p[:, d, None] >= x[:-1] - ALONG * np.ptp(x)) & (p[:, d, None] <= x[1:] + ALONG * np.ptp(x))
                for d, x in enumerate(lines)
            ]
            met |= (hit[0].T.astype(np.float64) @ hit[1].astype(np.float64)) > 1.0  # a point alone does not count
    middles = [0.5 * (x[1:] + x[:-1]) for x in lines]
    inside = winding(face, np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)).reshape(met.shape)
    return {
        "interior": int((inside & ~met).sum()), "trimmed": int(met.sum()), "exterior": int((~inside & ~met).sum())
    }


def _gap(made: Assembled, names: list[str]) -> float:
    """Largest distance between the two sides where elements meet, evaluated independently from both elements.

    Raises
    ------
    InputError : a mesh edge does not have two elements, with the CAD faces of those that it has.
    """
    s = np.linspace(0.0, 1.0, 5)
    keys, traces, owners = [], [], []
    for part in made.parts:
        basis, local = part.block.basis, made.points[part.block.dofs]
        m = part.corners.shape[1]
        around = _AROUND[m]
        for k in range(m):
            path = around[k] + s[:, None] * (around[(k + 1) % m] - around[k])
            x = np.einsum("sn,enc->esc", basis.tabulate(path, 0)[0], local)
            a, b = part.corners[:, k], part.corners[:, (k + 1) % m]
            keys.append(np.minimum(a, b) * made.vertices + np.maximum(a, b))
            traces.append(np.where((a > b)[:, None, None], x[:, ::-1], x))
            owners.append(part.owner)
    key, trace = np.concatenate(keys), np.concatenate(traces)
    order = np.argsort(key, kind="stable")
    key, trace = key[order], trace[order]
    unique, counts = np.unique(key, return_counts=True)
    wrong = np.flatnonzero(counts != 2)
    if len(wrong):
        there = np.unique(np.concatenate(owners)[order][key == unique[wrong[0]]])
        raise InputError(
            f"a mesh edge has {counts[wrong[0]]} elements, on {', '.join(names[f] for f in there)}, where a closed "
            f"skin has two"
        )
    return float(np.abs(trace[::2] - trace[1::2]).max())
