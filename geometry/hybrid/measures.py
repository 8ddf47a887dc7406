r"""What a skin is worth: distances, areas, volume, gaps, crossings and folds, and per face the share that is exact.

Axis letters: e element, k side, s sample on a side, c component.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep
from geometry.hybrid.assembling import Assembled, Part
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import BICUBIC
from geometry.hybrid.grid import count_intervals
from geometry.hybrid.sizing import Sizing
from geometry.hybrid.triangulation import SPLIT
from geometry.simplices.crossing import crossing_pairs
from iga.errors import InputError
from iga.quadrature import gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EXACT = 1e-12
"""Distance, relative to the diagonal, within which an element is the CAD surface."""
AIM, ORDER = 0.5, 1.0 / 3.5
"""Share of the tolerance that smaller elements are to reach, and how sizes follow distances."""
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
    distance, folded, owner, banded, bound = (
        np.concatenate([getattr(part, name) for part in made.parts])
        for name in ("distance", "folded", "owner", "banded", "bound")
    )
    areas = np.concatenate(area)
    exact = distance <= EXACT * brep.diagonal
    x = made.points[: made.vertices]
    straight = [(part.corners[:, [0, a, a + 1]], k) for part in made.parts for k, a in _halves(part)]
    triangles = np.concatenate([t for t, _ in straight])
    start = np.cumsum([0] + [len(part.corners) for part in made.parts])
    element = np.concatenate([
        start[n] + np.arange(len(part.corners)) for n, part in enumerate(made.parts) for _ in _halves(part)
    ])
    own = np.concatenate([
        np.where(part.block.basis is BICUBIC, start[n] + np.arange(len(part.corners)), -1)
        for n, part in enumerate(made.parts) for _ in _halves(part)
    ])
    pairs = crossing_pairs(x, triangles, own)
    corners = x[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    quality = 2.0 * np.sqrt(3.0) * flat / (sides**2).sum(axis=1)
    worst = int(distance.argmax())
    names = [face.name for face in brep.faces]
    report = {
        "elements": len(distance), "quadrilaterals": sum(len(m.quads) for m in meshes),
        "max_distance": float(distance.max() / brep.diagonal), "worst_face": names[int(owner[worst])],
        "exact_area_share": float(areas[exact].sum() / areas.sum()), "area": float(areas.sum()),
        "band_area": float(areas[banded].sum()), "volume": volume, "volume_error": abs(volume / brep.volume - 1.0),
        "watertight_gap": _gap(made) / brep.diagonal, "crossings": len(pairs), "folded": int(folded.sum()),
        "min_quality": float(quality.min()),
        "cad_faces_with_quadrilaterals": _per_face(
            brep, meshes, owner, areas, exact, banded, distance, bound
        ),
    }  # fmt: skip
    bad = folded.copy()
    bad[element[pairs.ravel()]] = True
    if bad.any():
        report["faulty_faces"] = sorted({names[f] for f in owner[bad].tolist()})
    reach = np.maximum(tolerance * brep.diagonal, 2.0 * _beside_edges(made, off))  # the edge is half way between faces
    failing = bad | (distance > reach)
    # What is nearly too far is held at its size, or the next mesh, where it may be larger, is too far there.
    some = failing | (distance > HOLD * reach)
    if not failing.any():
        some[:] = False
    shrink = np.clip((AIM * reach / (distance + 1e-300)) ** ORDER, 0.4, 1.0) / SPLIT
    shrink = np.where(bad, 0.5, np.where(failing, np.minimum(shrink, 0.6), shrink))
    longest = np.zeros(len(distance))
    np.maximum.at(longest, element, sides.max(axis=1))
    centre = np.zeros((len(distance), 3))
    np.add.at(centre, element, corners.mean(axis=1) / np.bincount(element)[element][:, None])
    wanted = longest * shrink
    cells: dict[int, float] = {}
    for n, part in enumerate(made.parts):
        if part.block.basis is BICUBIC:
            here = np.arange(start[n], start[n + 1])
            for e in here[failing[here]].tolist():
                cells[int(owner[e])] = min(cells.get(int(owner[e]), np.inf), float(wanted[e]))
    pieces = _pieces(made, bad | (failing & _between_curves(made)))
    return report, Finer(Sizing(centre[some], wanted[some]), cells, frozenset(owner[bad].tolist()), pieces)


def _sides(made: Assembled) -> tuple[Index, list[Index]]:
    """A number for each piece of an edge (s,) and for each side of the elements of each part (e, m)."""
    weight = np.array([made.vertices, 1])
    sides = [np.stack([part.corners, np.roll(part.corners, -1, axis=1)], axis=2) for part in made.parts]
    return np.sort(made.curves[:, :2], axis=1) @ weight, [np.sort(pair, axis=2) @ weight for pair in sides]


def _pieces(made: Assembled, some: NDArray[np.bool_]) -> Index:
    """Pieces of edges (k, 3) that are sides of some elements."""
    curves, sides = _sides(made)
    first = np.cumsum([len(own) for own in sides])[:-1]
    keys = [own[mine].ravel() for own, mine in zip(sides, np.split(some, first))]
    return made.curves[np.isin(curves, np.concatenate(keys))]


def _beside_edges(made: Assembled, off: Array) -> Array:
    """For each element (e,) the largest value of an edge at which it has a vertex, from those of all edges."""
    ends, edge = made.curves[:, :2], made.curves[:, 2]
    at = np.zeros(made.vertices)
    np.maximum.at(at, ends.ravel(), np.repeat(off[edge], 2))
    return np.concatenate([at[part.corners].max(axis=1, initial=0.0) for part in made.parts])


def _between_curves(made: Assembled) -> NDArray[np.bool_]:
    """Elements (e,) with two sides or more on edges, as at the tip of a face: only their pieces matter."""
    curves, sides = _sides(made)
    return np.concatenate([np.isin(own, curves).sum(axis=1) >= 2 for own in sides])


def _halves(part: Part) -> list[tuple[int, int]]:
    """Straight triangles (0, a, a + 1) of an element's corners."""
    return [(k, k + 1) for k in range(part.corners.shape[1] - 2)]


def _per_face(
    brep: Brep, meshes: list[FaceMesh], owner: Index, area: Array, exact: NDArray[np.bool_],
    banded: NDArray[np.bool_], distance: Array, bound: Array,
) -> list[dict[str, Any]]:  # fmt: skip
    rows = []
    for f, (face, made) in enumerate(zip(brep.faces, meshes)):
        if made.grid is None:
            continue
        mine = owner == f
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


def _gap(made: Assembled) -> float:
    """Largest distance between the two sides where elements meet, evaluated independently from both elements."""
    s = np.linspace(0.0, 1.0, 5)
    keys, traces = [], []
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
    key, trace = np.concatenate(keys), np.concatenate(traces)
    order = np.argsort(key, kind="stable")
    key, trace = key[order], trace[order]
    unique, counts = np.unique(key, return_counts=True)
    wrong = np.flatnonzero(counts != 2)
    if len(wrong):
        low, high = divmod(int(unique[wrong[0]]), made.vertices)
        raise InputError(f"mesh edge {low} - {high} has {counts[wrong[0]]} elements: the skin is not closed")
    return float(np.abs(trace[::2] - trace[1::2]).max())
