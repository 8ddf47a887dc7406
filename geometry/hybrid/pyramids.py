r"""A pyramid on every quadrilateral of a skin: how high, so that none touches another or the skin.

Everything here is straight: quadrilaterals are seen through their vertices. The apex lies over the centre c of the
vertices, at height h along the inward normal. A lateral face makes the angle atan(h / r) with the base, r the distance
of c from the edge. Of the dihedral angle phi at an edge each pyramid takes at most phi / 3, so a third stays for the
tetrahedra, and at most phi / 2 where the neighbour is a triangle:

    h <= min_edges r tan(min(phi share, 60 degrees)),      h <= h_0 sqrt(area).

Pyramids enlarged by ``MARGIN`` must not cut each other or the skin, apart from common vertices and edges; those that do
are lowered until none does (thin walls, sharp inner corners).

Axis letters: q quadrilateral, t triangle, v vertex, c component, k pair.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geometry.simplices.crossing import crossing_pairs
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

HEIGHT = 0.5
"""Largest height over the square root of the base's area."""
MARGIN = 1.5
"""By how much higher pyramids must be free of each other and of the skin: tetrahedra lie between them."""
_LOWER, _ROUNDS = 0.7, 30
"""Factor of heights that are too large, and how often: down to 2e-5 of the first."""
#: Corners of a quadrilateral around it, in the order of the reference cell's vertices (0,0), (0,1), (1,0), (1,1).
_AROUND = np.array([0, 2, 3, 1])


def apexes(vertices: Array, quads: Index, triangles: Index, faces: Sequence[str] = ()) -> tuple[Array, Array]:
    """Apex of a pyramid inside each quadrilateral of a closed surface.

    Parameters
    ----------
    vertices : (v, 3)
    quads : (q, 4) in the order of the reference cell's vertices; third coordinate outwards.
    triangles : (t, 3) turned outwards.
    faces : name of the CAD face of each quadrilateral, for messages.

    Returns
    -------
    apexes (q, 3) and heights (q,).

    Raises
    ------
    InputError : triangles of the skin cut each other, or pyramids do however low they are.
    """
    ring = quads[:, _AROUND]
    corner = vertices[ring]
    centre = corner.mean(axis=1)
    area_normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]) / 2.0
    area = np.linalg.norm(area_normal, axis=1)
    flat = np.flatnonzero(area <= 0.0)
    if len(flat):
        raise InputError(f"{_called(int(flat[0]), faces)} has no area between its vertices")
    inward = -area_normal / area[:, None]
    height = np.minimum(HEIGHT * np.sqrt(area), _by_angles(vertices, ring, triangles, centre, inward))
    skin = np.concatenate([triangles, ring[:, [0, 1, 2]], ring[:, [0, 2, 3]]])
    base = np.concatenate([np.full(len(triangles), -1), np.tile(np.arange(len(quads)), 2)])
    for _ in range(_ROUNDS):
        if not len(quads):
            break
        points = np.concatenate([vertices, centre + MARGIN * height[:, None] * inward])
        top = len(vertices) + np.arange(len(quads))
        lateral = lateral_triangles(quads, top)
        owner = np.concatenate([np.repeat(np.arange(len(quads)), 4), base])
        group = np.concatenate([np.zeros(len(lateral), dtype=np.int64), np.ones(len(skin), dtype=np.int64)])
        pairs = crossing_pairs(points, np.concatenate([lateral, skin]), owner, group)
        if not len(pairs):
            break
        low = np.unique(owner[pairs[group[pairs] == 0]])
        height[low] *= _LOWER
    else:
        raise InputError(
            f"no pyramid fits on {_called(int(low[0]), faces)} near {centre[low[0]].round(6).tolist()}: the solid is "
            "too thin there for the size of the skin's elements"
        )
    return centre + height[:, None] * inward, height


def _called(number: int, faces: Sequence[str]) -> str:
    """A quadrilateral in messages."""
    return f"quadrilateral {number} of the skin" + (f" ({faces[number]})" if faces else "")


def lateral_triangles(quads: Index, top: Index) -> Index:
    """Lateral faces of pyramids (4 q, 3), those of one pyramid together, turned into it.

    They and the skin's triangles are the boundary of the rest of the solid.
    """
    ring = quads[:, _AROUND]
    ends = np.stack([ring, np.roll(ring, -1, axis=1)], axis=2)
    return np.concatenate([ends, np.broadcast_to(top[:, None, None], (*ring.shape, 1))], axis=2).reshape(-1, 3)


def _by_angles(vertices: Array, ring: Index, triangles: Index, centre: Array, inward: Array) -> Array:
    """Heights (q,) that leave room for tetrahedra at the edges."""
    count = len(ring)
    normals = np.concatenate([-inward, _unit(np.cross(*_sides(vertices[triangles])))])
    middle = np.concatenate([centre, vertices[triangles].mean(axis=1)])
    starts = np.concatenate([ring.ravel(), triangles.ravel()])
    ends = np.concatenate([np.roll(ring, -1, axis=1).ravel(), np.roll(triangles, -1, axis=1).ravel()])
    owner = np.concatenate([np.repeat(np.arange(count), 4), count + np.repeat(np.arange(len(triangles)), 3)])
    key = np.minimum(starts, ends) * len(vertices) + np.maximum(starts, ends)
    order = np.argsort(key, kind="stable")
    if len(key) % 2 or not np.array_equal(key[order[::2]], key[order[1::2]]) or (
        len(key) > 2 and (key[order[1:-1:2]] == key[order[2::2]]).any()
    ):
        raise InputError("the skin is not closed: an edge does not belong to exactly two elements")
    other = np.empty(len(key), dtype=np.int64)
    other[order[::2]], other[order[1::2]] = owner[order[1::2]], owner[order[::2]]
    mine = slice(0, 4 * count)
    a, b = vertices[starts[mine]], vertices[ends[mine]]
    along = _unit(b - a)
    own, neighbour = owner[mine], other[mine]
    # Directions from the edge into either element; the angle between them measured through the inside.
    inner = _across(middle[own] - a, along)
    outer = _across(middle[neighbour] - a, along)
    cosine = np.clip((inner * outer).sum(axis=1), -1.0, 1.0)
    convex = (outer * normals[own]).sum(axis=1) <= 0.0
    angle = np.where(convex, np.arccos(cosine), 2.0 * np.pi - np.arccos(cosine))
    share = np.minimum(np.where(neighbour < count, angle / 3.0, angle / 2.0), np.pi / 3.0)
    reach = np.linalg.norm(np.cross(middle[own] - a, along), axis=1)
    return np.asarray((reach * np.tan(share)).reshape(count, 4).min(axis=1, initial=np.inf))


def _sides(corner: Array) -> tuple[Array, Array]:
    return corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]


def _unit(x: Array) -> Array:
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-300))


def _across(x: Array, along: Array) -> Array:
    return _unit(x - (x * along).sum(axis=1, keepdims=True) * along)
