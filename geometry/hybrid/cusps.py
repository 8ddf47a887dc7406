r"""Corners of faces at which two edges leave in the same direction.

At such a corner the two tangents of any element are parallel, so det J = 0 there, whatever the element: no volume with
det J > 0 has this boundary. The angle inside the face is

    alpha = pi - (turn from the arriving to the leaving tangent about the normal),

and where it is 0 up to rounding, which 2 pi (a slit outside the face) is too, a point between the edges decides.

Axis letters: c component.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Coedge, curve_points, curve_tangents, surface_frame, winding
from iga.errors import InputError

Array = NDArray[np.float64]

SHARPEST = 2e-3
"""Least angle (radians) inside a face."""


def cusps(brep: Brep) -> Iterator[tuple[int, int, int, Array]]:
    """Face, the edges before and after, and the place of each corner without an angle."""
    for f, face in enumerate(brep.faces):
        for loop in face.loops:
            live = [c for c in loop if not brep.edges[c.edge].degenerate]
            for before, after in zip([live[-1], *live], live):
                if before is after:
                    continue
                arriving, leaving = _tangent(brep, before, True), _tangent(brep, after, False)
                at = curve_points(after.curve, np.array([1.0 if after.reversed else 0.0]))
                x, du, dv = surface_frame(face.surface, at)
                normal = np.cross(du, dv)[0]
                size = np.linalg.norm(normal)
                if size <= 1e-9 * np.linalg.norm(du) * np.linalg.norm(dv):
                    continue  # a pole
                turn = np.arctan2(np.dot(np.cross(arriving, leaving), normal / size), np.dot(arriving, leaving))
                if np.pi - abs(turn) < SHARPEST and _between(brep, f, before, after):
                    yield f, before.edge, after.edge, x[0]


def refuse_cusps(brep: Brep, where: str) -> None:
    """Refuse a solid with a face that has a corner without an angle.

    Raises
    ------
    InputError : naming the face, the edges and the place.
    """
    for f, before, after, x in cusps(brep):
        place = ", ".join(f"{c:.6g}" for c in x)
        raise InputError(
            f"{where}: {brep.faces[f].name} has a cusp at ({place}): its edges {before} and {after} leave in the same "
            f"direction there, and no element with a positive Jacobian fits between; cut the corner off"
        )


def _tangent(brep: Brep, c: Coedge, at_end: bool) -> Array:
    """Unit tangent of an edge in space, along the loop, where the loop arrives or leaves."""
    t = np.array([0.0 if c.reversed == at_end else 1.0])
    d = curve_tangents(brep.edges[c.edge].curve, t)[0] * (-1.0 if c.reversed else 1.0)
    return np.asarray(d / (np.linalg.norm(d) + 1e-300))


def _between(brep: Brep, face: int, before: Coedge, after: Coedge) -> bool:
    """Whether what lies between two edges near their common corner is inside the face."""
    s = np.linspace(0.0, 0.2, 201)
    back = curve_points(before.curve, s if before.reversed else 1.0 - s)
    ahead = curve_points(after.curve, 1.0 - s if after.reversed else s)
    far = [np.linalg.norm(p - p[0], axis=1) for p in (back, ahead)]
    # At equal distances from the corner, half way from one edge to the other.
    reach = 0.5 * min(far[0][-1], far[1][-1])
    a, b = (p[int(np.abs(d - reach).argmin())] for p, d in zip((back, ahead), far))
    return bool(winding(brep.faces[face], 0.5 * (a + b)[None])[0])
