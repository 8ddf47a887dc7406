r"""A mesh of Bezier tetrahedra: connectivity, Bernstein coefficients, named boundary facets, and the checks on them.

Orientation is settled by topology, not one tetrahedron at a time: two tetrahedra on a shared face must see it from
opposite sides, which fixes all signs of a connected part up to one, and that one is chosen so that the part's volume is
positive. Tetrahedra whose vertices were merely listed the other way round are turned; one that is folded over its
neighbour stays negative, so that the certificate refutes it instead of the fold being hidden.

Axis letters: e tetrahedron, n coefficient, f facet, v vertex of the tetrahedron, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.tet_to_hex import degree_of
from geometry.tet_to_hex_mesh import FACES
from iga.bernstein import bernstein, functions_at
from iga.cells import TETRAHEDRON
from iga.conforming import entity_keys
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A tetrahedron with a smaller determinant than this times its longest edge cubed has no volume.
_FLAT = 1e-13

#: Larger coordinates are refused with those that are not finite: their volumes would overflow.
LARGEST = 1e90


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Bezier tetrahedra that meet face to face.

    Attributes
    ----------
    vertices : (e, 4) vertex numbers, all of 0..v-1 in use, the reference cell's order.
    coefficients : (e, C(n+3, 3), 3) Bernstein coefficients.
    boundaries : for each name (f, 2): tetrahedron and local face.
    report : what was found while reading and checking.
    """

    vertices: Index
    coefficients: Array
    boundaries: Mapping[str, Index]
    report: Mapping[str, Any] = field(default_factory=dict)

    @property
    def degree(self) -> int:
        """Degree n."""
        return degree_of(self.coefficients.shape[1])


def corner_columns(degree: int) -> Index:
    """Positions (4,) of the coefficients at the vertices."""
    return functions_at(bernstein(TETRAHEDRON, degree), TETRAHEDRON.vertices)


def checked_mesh(
    vertices: Index,
    coefficients: Array,
    groups: Mapping[str, Index] | None = None,
    report: Mapping[str, Any] | None = None,
) -> TetMesh:
    """Check tetrahedra, orient them and name their boundary.

    Parameters
    ----------
    vertices : (e, 4) node numbers, any non-negative integers.
    coefficients : (e, C(n+3, 3), 3) Bernstein coefficients.
    groups : names and vertex triples (f, 3) of boundary triangles; what they leave over is called "boundary".
    report : entries to start the mesh's report with.

    Raises
    ------
    InputError : no tetrahedra, coordinates that are not finite, a vertex twice in a tetrahedron, a tetrahedron given
        twice, one without volume, a face with more than two tetrahedra. Numbers in messages count from 0.
    """
    vertices = np.asarray(vertices, dtype=np.int64)
    coefficients = np.asarray(coefficients, dtype=float)
    if vertices.ndim != 2 or vertices.shape[1] != 4 or not len(vertices):
        raise InputError("there are no tetrahedra")
    degree = degree_of(coefficients.shape[1])
    _check_simple(vertices, coefficients)
    used, compact = np.unique(vertices, return_inverse=True)
    compact = np.asarray(compact, dtype=np.int64).reshape(-1, 4)
    determinant = straight_determinants(coefficients)
    _check_volume(determinant, coefficients)

    sides, lone = _pair_faces(compact, used)
    flip, parts, folded = _orient(compact, determinant, sides)
    swap = swap_columns(degree)
    compact = np.where(flip[:, None], compact[:, [0, 3, 2, 1]], compact)
    if flip.any():
        coefficients = coefficients.copy()
        coefficients[flip] = coefficients[flip][:, swap]
    # Exchanging vertices 1 and 3 exchanges the faces opposite to them, and keeps the diagonal of red refinement.
    lone[:, 1] = np.where(flip[lone[:, 0]] & (lone[:, 1] % 2 == 1), 4 - lone[:, 1], lone[:, 1])

    entries: dict[str, Any] = {**(report or {}), "oriented": int(flip.sum()), "parts": parts}
    if folded:
        entries["folded"] = folded
    crowded = _crowded_edges(compact, lone)
    if len(crowded):
        a, b = used[crowded[0]]
        entries["non_manifold_edges"] = f"{len(crowded)}, the first between vertices {a} and {b}"
    boundaries = _name_boundary(compact, used, lone, groups or {}, entries)
    return TetMesh(np.ascontiguousarray(compact), coefficients, boundaries, entries)


def _crowded_edges(vertices: Index, lone: Index) -> Index:
    """Edges (k, 2) with more than two boundary triangles: there the solid touches itself."""
    triangles = vertices[lone[:, :1], FACES[lone[:, 1]]]
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    return edges[count > 2]


def straight_determinants(coefficients: Array) -> Array:
    """Six times the signed volume of the tetrahedra through the vertices, (e,)."""
    corners = coefficients[:, corner_columns(degree_of(coefficients.shape[1]))]
    return np.linalg.det(corners[:, 1:] - corners[:, :1])


def swap_columns(degree: int) -> Index:
    """Positions of the coefficients after vertices 1 and 3 change places."""
    exponents = bernstein(TETRAHEDRON, degree).exponents
    place = {tuple(a): k for k, a in enumerate(exponents.tolist())}
    return np.array([place[tuple(a)] for a in exponents[:, [0, 3, 2, 1]].tolist()], dtype=np.int64)


def _check_simple(vertices: Index, coefficients: Array) -> None:
    if coefficients.ndim != 3 or coefficients.shape[0] != len(vertices) or coefficients.shape[2] != 3:
        raise InputError(f"{len(vertices)} tetrahedra do not fit coefficients of shape {coefficients.shape}")
    bad = np.flatnonzero(~(np.abs(coefficients) <= LARGEST).all(axis=(1, 2)))
    if len(bad):
        raise InputError(f"tetrahedron {bad[0]} has a coordinate that is no number up to {LARGEST:g}")
    ordered = np.sort(vertices, axis=1)
    twice = ordered[:, 1:] == ordered[:, :-1]
    bad = np.flatnonzero(twice.any(axis=1))
    if len(bad):
        node = ordered[bad[0], 1:][twice[bad[0]]][0]
        raise InputError(f"tetrahedron {bad[0]} has vertex {node} twice; remove it or repair its connectivity")
    rank = np.lexsort(ordered.T[::-1])
    same = np.flatnonzero((ordered[rank[1:]] == ordered[rank[:-1]]).all(axis=1))
    if len(same):
        first, second = sorted((int(rank[same[0]]), int(rank[same[0] + 1])))
        raise InputError(f"tetrahedra {first} and {second} have the same four vertices; remove one of them")


def _check_volume(determinant: Array, coefficients: Array) -> None:
    corners = coefficients[:, corner_columns(degree_of(coefficients.shape[1]))]
    edges = corners[:, TETRAHEDRON.edges[:, 1]] - corners[:, TETRAHEDRON.edges[:, 0]]
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1))
    bad = np.flatnonzero(~(np.abs(determinant) > _FLAT * longest**3))
    if len(bad):
        raise InputError(f"tetrahedron {bad[0]} has no volume: its vertices lie in a plane ({len(bad)} such in all)")


def _pair_faces(vertices: Index, names: Index) -> tuple[Index, Index]:
    """Pairs (k, 2, 2) of (tetrahedron, face) that share one; those (f, 2) that are alone."""
    corners = vertices[:, FACES].reshape(-1, 3)
    key = entity_keys(corners, int(vertices.max()) + 1)
    rank = np.argsort(key, kind="stable")
    ordered = key[rank]
    start = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    count = np.diff(np.concatenate([start, [len(ordered)]]))
    if count.max() > 2:
        at = rank[start[np.argmax(count > 2)]]
        named = ", ".join(str(v) for v in sorted(names[corners[at]].tolist()))
        raise InputError(
            f"the face with vertices {named} belongs to {int(count[count > 2][0])} tetrahedra (non-manifold); "
            "at most two can share a face"
        )
    double = start[count == 2]
    sides = np.stack([rank[double], rank[double + 1]], axis=1)
    single = np.sort(rank[start[count == 1]])
    return np.stack(np.divmod(sides, 4), axis=-1), np.stack(np.divmod(single, 4), axis=-1)


def _orient(vertices: Index, determinant: Array, sides: Index) -> tuple[NDArray[np.bool_], int, int]:
    """Which tetrahedra to turn, the number of parts, and how many tetrahedra stay negative."""
    e = len(vertices)
    one, two = sides[:, 0], sides[:, 1]
    opposite = _odd(vertices[one[:, 0, None], FACES[one[:, 1]]]) != _odd(vertices[two[:, 0, None], FACES[two[:, 1]]])
    # Every tetrahedron twice, as it is (0..e-1) and turned (e..2e-1): neighbours that agree link equal states.
    a, b = one[:, 0], two[:, 0]
    shift = np.where(opposite, 0, e)
    rows = np.concatenate([a, a + e])
    columns = np.concatenate([b + shift, (b + e - shift)])
    link = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * e, 2 * e))
    states, label = connected_components(link, directed=False)
    parts = connected_components(coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(e, e)), directed=False)[0]
    as_is, turned = label[:e], label[e:]
    if (as_is == turned).any():
        # A one-sided part cannot be oriented by topology; fall back on each tetrahedron's own sign.
        return determinant < 0, int(parts), 0
    # The volume of a state: positive contributions from tetrahedra taken as they are, negative from turned ones.
    volume = np.bincount(as_is, determinant, states) - np.bincount(turned, determinant, states)
    flip = volume[as_is] < 0
    folded = int((np.where(flip, -determinant, determinant) < 0).sum())
    return flip, int(parts), folded


def _odd(triples: Index) -> NDArray[np.bool_]:
    """Whether sorting each triple (f, 3) takes an odd permutation."""
    a, b, c = triples.T
    return ((a > b) ^ (a > c)) ^ (b > c)


def _name_boundary(
    vertices: Index, names: Index, lone: Index, groups: Mapping[str, Index], report: dict[str, Any]
) -> dict[str, Index]:
    """Facets of each group by matching vertex triples, the rest as "boundary"; counts go to the report."""
    total = len(names)
    triples = vertices[lone[:, 0, None], FACES[lone[:, 1]]]
    known = np.sort(triples, axis=1)
    result: dict[str, Index] = {}
    free = np.ones(len(lone), dtype=bool)
    stray = 0
    empty = []
    for name, nodes in groups.items():
        place = np.minimum(np.searchsorted(names, nodes), total - 1)
        inside = (names[place] == nodes).all(axis=1)
        wanted = np.sort(place[inside], axis=1)
        found, missing = _match(known, wanted)
        stray += int((~inside).sum()) + missing
        if len(found):
            result[name] = lone[found]
            free[found] = False
        else:
            empty.append(name)
    if free.any():
        rest = lone[free]
        result["boundary"] = np.concatenate([result["boundary"], rest]) if "boundary" in result else rest
    if stray:
        report["triangles_off_boundary"] = stray
    if empty:
        report["empty_groups"] = ", ".join(empty)
    return result


def _match(known: Index, wanted: Index) -> tuple[Index, int]:
    """Rows of ``known`` that occur in ``wanted`` (sorted triples), and how many rows of ``wanted`` do not occur."""
    if not len(wanted):
        return np.zeros(0, dtype=np.int64), 0
    both, inverse = np.unique(np.concatenate([known, wanted]), axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    asked = np.zeros(len(both), dtype=bool)
    there = np.zeros(len(both), dtype=bool)
    asked[inverse[len(known) :]] = True
    there[inverse[: len(known)]] = True
    return np.flatnonzero(asked[inverse[: len(known)]]), int((~there[inverse[len(known) :]]).sum())
