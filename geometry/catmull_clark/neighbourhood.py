r"""Neighbourhoods of cells, classed by connectivity.

The limit on a cell depends on the cells that share a vertex with it and on nothing else, and the matrices that
evaluate it depend on how these are connected, not on where they are. Two cells whose neighbourhoods are connected alike
share all matrices, so neighbourhoods are brought into a canonical order and classed.

Order and class come from colour refinement with 64-bit hashes: the eight vertices of the cell are coloured by their
number in the cell (and their kind), then every vertex repeatedly takes up the colours of the cells around it, and each
cell's view of it (its neighbours within the cell). A neighbourhood whose first cell is numbered has no symmetry left,
so the colours separate its vertices after a few rounds; sorting by colour is a canonical order, and the sum of all
colours is the class. Which of the 24 rotations numbers the cell is itself chosen from colours started without numbers,
so that classes do not depend on the file's numbering.

Axis letters: e cell, p pair of a cell and one of its neighbourhood, s slot (vertex of one cell's neighbourhood).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark.topology import CREASE, EDGES, FACES, Topology, incidence
from iga.cells import HEXAHEDRON
from iga.errors import InputError

Index = NDArray[np.int64]
Colours = NDArray[np.uint64]

_CHUNK = 2048
"""Neighbourhoods at a time."""
_ROUNDS = 24
"""Rounds of colour refinement after which vertices that still look alike are refused."""


def _rotations() -> Index:
    """The 24 proper rotations of the cube as permutations of its vertices, (24, 8)."""
    corners = HEXAHEDRON.vertices.astype(int)
    made = []
    for axes in permutations(range(3)):
        for flips in np.ndindex(2, 2, 2):
            R = np.zeros((3, 3))
            R[range(3), axes] = [1 - 2 * f for f in flips]
            if np.linalg.det(R) > 0:
                moved = corners[:, axes] ^ np.array(flips)
                made.append(moved @ np.array([4, 2, 1]))
    return np.array(made, dtype=np.int64)


ROTATIONS = _rotations()
_FACE_SETS = [frozenset(f) for f in FACES.tolist()]
# Face k of the turned cell is face TURNED_FACES[r, k] of the cell as numbered in the mesh.
TURNED_FACES = np.array([[_FACE_SETS.index(frozenset(r[f].tolist())) for f in FACES] for r in ROTATIONS])
_NEIGHBOURS = np.array([[b if a == v else a for a, b in EDGES.tolist() if v in (a, b)] for v in range(8)])


@dataclass(frozen=True, eq=False)
class Classes:
    """Cells of a mesh classed by neighbourhood.

    Attributes
    ----------
    rotation : (e,) number of the rotation that turns each cell into the frame of its class.
    label : (e,) class of each cell.
    representative : (k,) one cell of each class.
    size : (k,) vertices of its neighbourhood.
    """

    rotation: Index
    label: Index
    representative: Index
    size: Index


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Neighbourhoods of several cells side by side, without common vertices.

    Attributes
    ----------
    cells : (e,) the cells.
    owner, member : (p,) position in ``cells`` and the cell of its neighbourhood.
    slots : (p, 8) slot numbers of each member's vertices, as numbered in the mesh.
    vertex : (s,) vertex of the mesh in each slot; slots of one cell follow each other in canonical order.
    start : (e+1,) first slot of each cell.
    rotation : (e,)
    signature : (e,) hash of the class.
    """

    cells: Index
    owner: Index
    member: Index
    slots: Index
    vertex: Index
    start: Index
    rotation: Index
    signature: Colours


def _mix(x: Colours) -> Colours:
    """Scramble 64 bits (splitmix64 finaliser)."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)), dtype=np.uint64)


def _seed(values: Index) -> Colours:
    return _mix(_mix(values.astype(np.uint64)))


def neighbourhoods(topology: Topology, cells: Index, turn: bool = True) -> Neighbourhood:
    """Canonically ordered neighbourhoods of some cells; see the module docstring.

    Parameters
    ----------
    turn : whether to turn cells into the frame of their class; if not, cells are of one class only if they are alike as
        numbered in the mesh.
    """
    t = topology
    near = incidence(t.hexes[cells], t.vertices) @ t.cells_of_vertex
    owner = np.repeat(np.arange(len(cells)), np.diff(near.indptr))
    member = near.indices.astype(np.int64)
    keys = owner[:, None] * t.vertices + t.hexes[member]
    unique, slots = np.unique(keys, return_inverse=True)
    slots = slots.reshape(keys.shape)
    of_slot, vertex = np.divmod(unique, t.vertices)
    root = np.searchsorted(unique, np.arange(len(cells))[:, None] * t.vertices + t.hexes[cells])
    gather = _Gather(t, slots, member, root)
    kind = t.vertex_kind[t.hexes[cells]].astype(np.int64)

    colour = np.full(len(unique), _seed(np.array([1]))[0], dtype=np.uint64)
    colour[root] = _seed(10 + kind)
    rotation = np.zeros(len(cells), dtype=np.int64)
    if turn:
        for _ in range(3):
            colour = gather.refine(colour)
        rotation = _smallest(colour[root])
    turned = np.take_along_axis(root, ROTATIONS[rotation], axis=1)
    colour = np.full(len(unique), _seed(np.array([1]))[0], dtype=np.uint64)
    colour[turned] = _seed(100 + 8 * np.take_along_axis(kind, ROTATIONS[rotation], axis=1) + np.arange(8))
    for step in range(_ROUNDS):
        colour = gather.refine(colour)
        if step < 2:
            continue
        order = np.lexsort((colour, of_slot))
        same = (of_slot[order][1:] == of_slot[order][:-1]) & (colour[order][1:] == colour[order][:-1])
        if not same.any():
            break
    else:
        raise InputError(f"the cells around element {cells[of_slot[order][:-1][same][0]]} cannot be told apart")
    start = np.searchsorted(of_slot, np.arange(len(cells) + 1))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    signature = _mix(np.add.reduceat(_mix(colour), start[:-1]) + np.diff(start).astype(np.uint64))
    return Neighbourhood(cells, owner, member, place[slots], vertex[order], start, rotation, signature)


class _Gather:
    """Index arrays of one set of neighbourhoods, set up once for all rounds of refinement."""

    def __init__(self, t: Topology, slots: Index, member: Index, root: Index) -> None:
        self.slots = slots
        self.order = np.argsort(slots.ravel(), kind="stable")
        count = np.bincount(slots.ravel())
        self.first = np.concatenate([[0], np.cumsum(count)[:-1]])
        # Crease edges of the mesh at the root's vertices, as pairs of slots.
        is_root = np.zeros(len(count), dtype=bool)
        is_root[root] = True
        ends = slots[:, EDGES]
        touching = is_root[ends].any(axis=2) & (t.edge_kind[t.hex_edges[member]] == CREASE)
        pairs = np.unique(np.sort(ends[touching], axis=1), axis=0)
        both = np.concatenate([pairs, pairs[:, ::-1]])
        self.one: Index = both[:, 0]
        self.two: Index = both[:, 1]

    def refine(self, colour: Colours) -> Colours:
        """One round: take up the views of all cells around, and the far ends of creases."""
        own = _mix(colour)[self.slots]
        beside = own[:, _NEIGHBOURS[:, 0]] + own[:, _NEIGHBOURS[:, 1]] + own[:, _NEIGHBOURS[:, 2]]
        whole = _mix(own.sum(axis=1, dtype=np.uint64))
        view = _mix(whole[:, None] + np.uint64(3) * beside)
        total = np.add.reduceat(view.ravel()[self.order], self.first)
        if len(self.one):
            np.add.at(total, self.two, _mix(colour[self.one] ^ np.uint64(0x5DEECE66D)))
        return _mix(np.uint64(5) * colour + total)


def _smallest(colours: Colours) -> Index:
    """Rotation that brings the colours (e, 8) of a cell's vertices into the smallest lexicographic order."""
    candidates = colours[:, ROTATIONS]
    alive = np.ones(candidates.shape[:2], dtype=bool)
    top = np.uint64(0xFFFFFFFFFFFFFFFF)
    for v in range(8):
        values = np.where(alive, candidates[:, :, v], top)
        alive &= values == values.min(axis=1, keepdims=True)
    return alive.argmax(axis=1)


def walk(topology: Topology, cells: Index) -> Iterator[Neighbourhood]:
    """Neighbourhoods of cells, some thousand at a time."""
    for start in range(0, len(cells), _CHUNK):
        yield neighbourhoods(topology, cells[start : start + _CHUNK])


def classify(topology: Topology) -> tuple[Classes, list[Index]]:
    """Class all cells of a mesh.

    Returns
    -------
    The classes, and for each class the vertices (members, size) of its cells' neighbourhoods in canonical order; the
    members are ``numpy.flatnonzero(label == k)``.
    """
    cells = np.arange(len(topology.hexes))
    rotation = np.empty(len(cells), dtype=np.int64)
    signature = np.empty(len(cells), dtype=np.uint64)
    vertex, count = [], []
    for part in walk(topology, cells):
        rotation[part.cells], signature[part.cells] = part.rotation, part.signature
        vertex.append(part.vertex)
        count.append(np.diff(part.start))
    vertices, counts = np.concatenate(vertex), np.concatenate(count)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    _, representative, label = np.unique(signature, return_index=True, return_inverse=True)
    size = counts[representative]
    bad = np.flatnonzero(counts != size[label])
    if len(bad):
        raise InputError(f"the neighbourhood of element {bad[0]} is confused with another (hash collision)")
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(label))[:-1])
    dofs = [vertices[starts[g][:, None] + np.arange(n)] for g, n in zip(groups, size.tolist())]
    return Classes(rotation, label, representative, size), dofs
