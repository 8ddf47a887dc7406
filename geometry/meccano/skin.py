r"""The boundary of a solid on a T-mesh: its facets, and sample points on them.

A facet is a face of a leaf cell on a boundary side of the meccano. A point of it is u in [0, 1]^2; with the lowest
corner and the size of the cell, s = corner + size u are the coordinates of the side and xi = origin + axes s those of
the block.

Axis letters: f facet, q sample point of each facet, n function of the space.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.meccano.collocation import collocation
from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.tmesh import on_side
from geometry.meccano.traces import functions_on
from iga.cells import HEXAHEDRON

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ORIGIN = np.array([face.origin for face in HEXAHEDRON.faces])
_AXES = np.array([face.axes for face in HEXAHEDRON.faces])


@dataclass(frozen=True, eq=False)
class Skin:
    """Facets of the boundary; make it with `skin_of`.

    Attributes
    ----------
    space : the space and its mesh.
    side : (f,) boundary side, a row of ``blocks.boundary_sides``, ascending.
    face : (f,) local face.
    cell : (f,) leaf cell.
    corner, size : (f, 2) and (f,), s = corner + size u.
    functions : (m,) functions that do not vanish on the boundary.
    """

    space: Hierarchy
    side: Index
    face: Index
    cell: Index
    corner: Array
    size: Array
    functions: Index

    @cached_property
    def _known(self) -> dict[tuple[bytes, tuple[int, int]], csr_array]:
        """Matrices that `values_at` has made."""
        return {}


def skin_of(space: Hierarchy) -> Skin:
    """All boundary facets of a space."""
    tmesh = space.tmesh
    sides = tmesh.blocks.boundary_sides
    cells = [on_side(tmesh, block, side) for block, side in sides.tolist()]
    side, cell = np.repeat(np.arange(len(sides)), [len(own) for own in cells]), np.concatenate(cells)
    face = sides[side, 1]
    corner = np.einsum("fds,fd->fs", _AXES[face], tmesh.corner[cell] / 2.0**LEVELS)
    return Skin(space, side, face, cell, corner, tmesh.size[cell] / 2.0**LEVELS, functions_on(space))


def side_coordinates(skin: Skin, u: Array) -> tuple[Index, Array]:
    """Boundary sides (f q,) and coordinates s (f q, 2) of the points u (q, 2) of all facets."""
    s = skin.corner[:, None] + skin.size[:, None, None] * u
    return np.repeat(skin.side, len(u)), s.reshape(-1, 2)


def places_on(skin: Skin, u: Array) -> tuple[Index, Array]:
    """Blocks (f q,) and xi (f q, 3) of the points u (q, 2) of all facets."""
    return places_on_sides(skin, *side_coordinates(skin, u))


def places_on_sides(skin: Skin, side: Index, s: Array) -> tuple[Index, Array]:
    """Blocks (q,) and xi (q, 3) of coordinates s (q, 2) of boundary sides (q,)."""
    block, face = skin.space.tmesh.blocks.boundary_sides[side].T
    return block, _ORIGIN[face] + np.einsum("qds,qs->qd", _AXES[face], s)


def values_at(skin: Skin, u: Array, order: tuple[int, int] = (0, 0)) -> csr_array:
    """Matrix (f q, n) that gives a field, or its derivatives along u, at points u (q, 2) of all facets; kept."""
    key = (u.tobytes(), order)
    if key not in skin._known:
        skin._known[key] = _values_at(skin, u, order)
    return skin._known[key]


def outward(skin: Skin, points: Array, u: Array) -> Array:
    """Unit normals (f q, 3) at points u (q, 2) of all facets; zero where a facet is degenerate."""
    normals = np.cross(values_at(skin, u, (1, 0)) @ points, values_at(skin, u, (0, 1)) @ points)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _values_at(skin: Skin, u: Array, order: tuple[int, int]) -> csr_array:
    tmesh, count = skin.space.tmesh, len(u)
    side, s = side_coordinates(skin, u)
    block, face = tmesh.blocks.boundary_sides[side].T
    xi = _ORIGIN[face] + np.einsum("qds,qs->qd", _AXES[face], s)
    scale = np.repeat(skin.size ** sum(order), count)
    made = csr_array((len(side), skin.space.n))
    for number in np.unique(face).tolist():
        own = np.flatnonzero(face == number)
        derivative = tuple(int(k) for k in _AXES[number] @ np.array(order))
        rows = collocation(skin.space, block[own], xi[own], derivative)
        place = csr_array((scale[own], (own, np.arange(len(own)))), shape=(len(side), len(own)))
        made = made + place @ rows
    return made


def values_on(skin: Skin, facet: Index, u: Array) -> csr_array:
    """Matrix (k, n) that gives a field at points u (k, 2) of facets (k,)."""
    s = skin.corner[facet] + skin.size[facet, None] * u
    xi = _ORIGIN[skin.face[facet]] + np.einsum("kds,ks->kd", _AXES[skin.face[facet]], s)
    return collocation(skin.space, skin.space.tmesh.block[skin.cell[facet]], xi)


def facet_rule(points: int) -> Array:
    """Midpoints (q, 2) of a facet cut into ``points`` by ``points``."""
    line = (np.arange(points) + 0.5) / points
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
