r"""Tricubic B-splines with open knots at the boundary, on the cells of a hex mesh around which it is a product.

Per direction a cell sees one of three things at each end: the boundary itself (knots 0 0 0 | ..), the boundary one cell
further (-1 -1 0 | ..), or neither (-2 -1 0 | ..). With f the polar form of the spline, its coefficients are

    at the boundary       f(0,0,0) = P_0,  f(0,0,1) = (2 P_0 + P_1)/3,  then f(0,1,2) = P_1, f(1,2,3) = P_2, ..

so that each boundary vertex stands for two functions in the direction that leaves the boundary, 2^k where k directions
do (creases, corners). Such a function is named by its vertex and the set of directions in which it is the second; a
direction is known by the neighbour it leads to.

A cell is taken if its vertices are regular and, in each direction, the outer layer of control points around it is
alike: all of it on a boundary that this direction leaves, or none.

Axis letters: e cell, v vertex, n function, d direction, b Bernstein function.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark.domain import LINES
from geometry.catmull_clark.neighbourhood import TURNED_FACES, walk
from geometry.catmull_clark.pieces import pieces_of
from geometry.catmull_clark.topology import SMOOTH, Topology

Array = NDArray[np.float64]
Index = NDArray[np.int64]

END, NEXT, INSIDE = 0, 1, 2
_LEFT = {END: (0, 0, 0), NEXT: (-1, -1, 0), INSIDE: (-2, -1, 0)}


def _polar(arguments: tuple[int, ...]) -> list[float]:
    """Polar forms of 1, x, x^2, x^3 at three arguments."""
    return [sum(float(np.prod(some)) for some in combinations(arguments, k)) / comb(3, k) for k in range(4)]


def _line(left: int, right: int) -> Array:
    """Bezier coefficients (4, 4) of the four B-splines on [0, 1]."""
    knots = [*_LEFT[left], *(1 - k for k in reversed(_LEFT[right]))]
    spline = np.array([_polar(tuple(knots[i : i + 3])) for i in range(4)])
    bezier = np.array([_polar((0,) * (3 - j) + (1,) * j) for j in range(4)])
    return np.linalg.solve(spline.T, bezier.T)


LINES_OPEN = np.stack([_line(left, right) for left in range(3) for right in range(3)])
"""Extraction (9, 4, 4) of the four functions on one interval, by 3 left + right."""


@dataclass(frozen=True, eq=False)
class OpenSplines:
    """Splines on the core.

    Attributes
    ----------
    cells, turn : (e,) cells of the core, and the rotation in which each is stored.
    functions : (e, 64) numbers of the functions on each cell.
    pattern : (e, 3) rows of `LINES_OPEN`.
    values : (n, c) coefficients of the limit volume (and attributes).
    """

    cells: Index
    turn: Index
    functions: Index
    pattern: Index
    values: Array

    def coefficients(self, lattice: Index, wanted: Index, turned: Index) -> tuple[Index, Index, Array]:
        """Bezier coefficients at some Bezier points of the core, as positions in ``wanted``, functions and values.

        Parameters
        ----------
        lattice : (e, 64) Bezier points of the core's cells, as numbered in the mesh; ``turned`` (e, 64) turns them.
        wanted : (r,) Bezier points, each on some core cell.
        """
        points = np.take_along_axis(lattice, turned, axis=1).ravel()
        found, first = np.unique(points, return_index=True)
        one, b = np.divmod(first[np.searchsorted(found, wanted)], 64)
        place = np.stack([b // 16, b // 4 % 4, b % 4], axis=1)
        line = [LINES_OPEN[self.pattern[one, d], :, place[:, d]] for d in range(3)]
        table = np.einsum("ri,rj,rk->rijk", *line).reshape(-1, 64)
        row, function = np.nonzero(table)
        return row, self.functions[one[row], function], table[row, function]


def open_splines(t: Topology, candidates: Index, values: Array) -> OpenSplines:
    """Open splines on those of the regular cells given around which the mesh is a product.

    Parameters
    ----------
    values : (v, c) control values.
    """
    cells, turns, names, patterns, control = [], [], [], [], []
    look = _Edges(t)
    for some, turn, lattice in _lattices(t, candidates):
        ends = np.stack([_end(t, look, turn, some, lattice, d, side) for d in range(3) for side in (0, 1)], axis=1)
        for code in np.unique(ends, axis=0):
            if (code < 0).any():
                continue
            mine = np.flatnonzero((ends == code).all(axis=1))
            name, coefficients = _functions(look, lattice[mine], code.reshape(3, 2), values)
            cells.append(some[mine])
            turns.append(turn[mine])
            names.append(name)
            patterns.append(np.tile(3 * code[::2] + code[1::2], (len(mine), 1)))
            control.append(coefficients)
    empty = np.zeros(0, dtype=np.int64)
    name = np.concatenate([np.zeros((0, 64), dtype=np.int64), *names])
    _, first, inverse = np.unique(name, return_index=True, return_inverse=True)
    flat = np.concatenate([np.zeros((0, values.shape[1])), *control])
    return OpenSplines(
        np.concatenate([empty, *cells]), np.concatenate([empty, *turns]), inverse.reshape(-1, 64).astype(np.int64),
        np.concatenate([np.zeros((0, 3), dtype=np.int64), *patterns]), flat[first],
    )


class _Edges:
    """Kinds of edges by their vertices, and the neighbours to which directions off the boundary lead."""

    def __init__(self, t: Topology) -> None:
        self.t = t
        self.keys = t.edges[:, 0] * t.vertices + t.edges[:, 1]
        both = np.concatenate([t.edges, t.edges[:, ::-1]])
        kind = np.concatenate([t.edge_kind, t.edge_kind])
        leaves = (kind > t.vertex_kind[both[:, 0]]) & t.regular_vertices[both[:, 0]]
        pairs = both[leaves]
        pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        start = np.searchsorted(pairs[:, 0], np.arange(t.vertices))
        self.inward = np.full((t.vertices, 3), -1, dtype=np.int64)
        self.inward[pairs[:, 0], np.arange(len(pairs)) - start[pairs[:, 0]]] = pairs[:, 1]

    def leaves(self, vertex: Index, towards: Index) -> NDArray[np.bool_]:
        """Whether the edge leaves the boundary that the vertex lies on."""
        ends = np.sort(np.stack([vertex, towards], axis=-1), axis=-1)
        edge = np.searchsorted(self.keys, ends[..., 0] * self.t.vertices + ends[..., 1])
        return np.asarray(self.t.edge_kind[edge] > self.t.vertex_kind[vertex])

    def bit(self, vertex: Index, towards: Index) -> Index:
        """Bit of a direction among those that leave the boundary at a regular vertex."""
        return np.asarray(1 << (self.inward[vertex] == towards[..., None]).argmax(axis=-1), dtype=np.int64)


def _lattices(t: Topology, candidates: Index) -> list[tuple[Index, Index, Index]]:
    """Cells by class: cells (e,), rotations (e,), control points in lattice order (e, n0, n1, n2), turned."""
    parts = list(walk(t, candidates))
    if not parts:
        return []
    signature = np.concatenate([part.signature for part in parts])
    turn = np.concatenate([part.rotation for part in parts])
    vertex = np.concatenate([part.vertex for part in parts])
    size = np.concatenate([np.diff(part.start) for part in parts])
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    made = []
    for name in np.unique(signature):
        mine = np.flatnonzero(signature == name)
        cell = candidates[mine[0]]
        outer = t.face_kind[t.hex_faces[cell, TURNED_FACES[turn[mine[0]]]]] == SMOOTH
        lines = [LINES[bool(outer[2 * d]), bool(outer[2 * d + 1])] for d in range(3)]
        product = np.kron(np.kron(lines[0], lines[1]), lines[2])
        C = pieces_of(t, np.array([cell]), 0).C[0]
        if product.shape != C.shape:
            continue
        distance = np.abs(product[:, None] - C[None]).max(axis=2)
        order = distance.argmin(axis=1)
        if distance.min(axis=1).max() > 1e-13 or len(np.unique(order)) != len(order):
            continue  # no product after all: left to the zone
        lattice = vertex[start[mine][:, None] + order].reshape(-1, *(len(line) for line in lines))
        made.append((candidates[mine], turn[mine], lattice))
    return made


def _end(t: Topology, look: _Edges, turn: Index, cells: Index, lattice: Index, d: int, side: int) -> Index:
    """What each cell sees at one end of direction d, (e,); -1 if its outer layer is not alike."""
    layers = np.moveaxis(lattice, d + 1, 1)
    outer, inner = (layers[:, -1], layers[:, -2]) if side else (layers[:, 0], layers[:, 1])
    leaves = look.leaves(outer, inner).reshape(len(cells), -1)
    regular = t.regular_vertices[outer].reshape(len(cells), -1)
    boundary = t.face_kind[t.hex_faces[cells, TURNED_FACES[turn, 2 * d + side]]] == SMOOTH
    alike = (leaves & regular).all(axis=1)
    return np.where(
        boundary, np.where(alike, END, -1), np.where(alike, NEXT, np.where(leaves.any(axis=1), -1, INSIDE))
    ).astype(np.int64)


def _functions(look: _Edges, lattice: Index, ends: Index, values: Array) -> tuple[Index, Array]:
    """Names (e, 64) and coefficients (64 e, c) of the functions on cells that see the same ends (3, 2)."""
    place: list[Index] = []
    second: list[Index] = []  # the lattice point that a second function leans to, or its own
    for d in range(3):
        n = lattice.shape[d + 1]
        at = {END: [(0, 0), (0, 1)], NEXT: [(0, 1)], INSIDE: [(0, 0)]}[int(ends[d, 0])]
        at += [(inner, inner) for inner in range(1, n - 1)]
        at += {END: [(n - 1, n - 2), (n - 1, n - 1)], NEXT: [(n - 1, n - 2)], INSIDE: [(n - 1, n - 1)]}[int(ends[d, 1])]
        place.append(np.array([a for a, _ in at]))
        second.append(np.array([b for _, b in at]))
    i, j, k = np.ix_(*place)
    vertex = lattice[:, i, j, k]
    name = 8 * vertex
    x = values[lattice]
    for d in range(3):
        moved = place.copy()
        moved[d] = second[d]
        i, j, k = np.ix_(*moved)
        other = lattice[:, i, j, k]
        name = name + np.where(other != vertex, look.bit(vertex, other), 0)
        x = np.moveaxis(x, d + 1, -1)
        x = np.moveaxis((2.0 * x[..., place[d]] + x[..., second[d]]) / 3.0, -1, d + 1)
    return name.reshape(-1, 64), x.reshape(-1, values.shape[1])
