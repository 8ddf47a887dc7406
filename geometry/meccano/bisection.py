"""Newest-vertex bisection of a meccano: conforming, nested simplicial meshes on dyadic nodes.

A simplex is an ordered list of vertices (x_0, .., x_d) with tag k and the refinement edge x_0 x_k, midpoint z;

    (x_0, .., x_{k-1}, z, x_{k+1}, .., x_d)   and   (x_1, .., x_k, z, x_{k+1}, .., x_d)

are its children, with tag k - 1, or d after 1 (Kossaczky 1994; Maubach 1995). The closure bisects, as long as there is
one, every simplex that has an edge with a node on it; the result is the smallest conforming refinement.

Two starts, for which this ends. `kuhn`, for one block: d! paths along the edges from corner 0 to the opposite one.
`coloured`, for any blocks: 2^d d! simplices (corner, edge midpoint, side centre, block centre) per block, which meet
across any gluing because the order of vertices is by dimension.

Axis letters: m simplex, v its vertex, n node, d dimension, t boundary facet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from geometry.meccano.blocks import Blocks
from geometry.meccano.parametrisation import LEVELS
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FULL = 1 << LEVELS


@dataclass(frozen=True, eq=False)
class BisectedMesh:
    """A conforming simplicial mesh of a meccano.

    Attributes
    ----------
    blocks : the meccano.
    tets : (m, d + 1) node numbers, in the order that bisection needs.
    tag : (m,) position of the refinement edge's end.
    block : (m,) block of each simplex.
    places : (m, d + 1, d) integer coordinates of its vertices in that block, over 2^LEVELS.
    ends : (n, 2) the nodes between which a node was put; -1, -1 for nodes of the start. Ends come before their node.
    """

    blocks: Blocks
    tets: Index
    tag: Index
    block: Index
    places: Index
    ends: Index

    @cached_property
    def facets(self) -> BoundaryFacets:
        """Facets on the boundary of the meccano."""
        return _boundary_facets(self)

    @cached_property
    def on_boundary(self) -> NDArray[np.bool_]:
        """(n,) nodes on the boundary of the meccano."""
        inside = np.zeros(len(self.ends), dtype=bool)
        inside[self.facets.nodes] = True
        return inside


@dataclass(frozen=True, eq=False)
class BoundaryFacets:
    """Facets of simplices on the boundary.

    Attributes
    ----------
    tet : (t,) the simplex.
    side : (t,) row of ``blocks.boundary_sides``.
    nodes : (t, d) node numbers, outward by the right-hand rule in positive blocks.
    s : (t, d, d - 1) their coordinates on the side, in [0, 1].
    """

    tet: Index
    side: Index
    nodes: Index
    s: Array


def kuhn(blocks: Blocks) -> BisectedMesh:
    """The start of the paper for one block: 6 tetrahedra (2 triangles).

    Raises
    ------
    InputError : the meccano has several blocks.
    """
    if len(blocks.corners) != 1:
        raise InputError(f"a meccano of {len(blocks.corners)} blocks needs the coloured start")
    d = blocks.dim
    paths = np.zeros((len(list(permutations(range(d)))), d + 1, d), dtype=np.int64)
    for row, order in enumerate(permutations(range(d))):
        for step, axis in enumerate(order):
            paths[row, step + 1 :, axis] = 1
    tets = blocks.corners[0][paths @ (1 << np.arange(d)[::-1])]
    return _started(blocks, tets, np.zeros(len(tets), dtype=np.int64), paths * FULL, len(blocks.places))


def coloured(blocks: Blocks) -> BisectedMesh:
    """The start for any meccano: 48 tetrahedra (8 triangles) per block."""
    d, cell, count = blocks.dim, blocks.cell, len(blocks.corners)
    # A face of the block, of any dimension, is a word over {0, 1, 2} per axis; 2 stands for the whole interval.
    words = np.array(list(np.ndindex(*(3,) * d)))
    held = ((words[:, None] == 2) | (words[:, None] == cell.vertices[None])).all(axis=2)  # (3^d, 2^d)
    number = np.empty((count, len(words)), dtype=np.int64)
    nodes = len(blocks.places)
    for size in range(d + 1):
        rows = np.flatnonzero((words == 2).sum(axis=1) == size)
        own = np.stack([np.flatnonzero(held[row]) for row in rows])
        keys = np.sort(blocks.corners[:, own], axis=2).reshape(count * len(rows), -1)
        if size == 0:
            number[:, rows] = keys.reshape(count, len(rows))
            continue
        unique, inverse = np.unique(keys, axis=0, return_inverse=True)
        number[:, rows] = nodes + inverse.reshape(count, len(rows))
        nodes += len(unique)
    flags = []
    for corner in np.ndindex(*(2,) * d):
        for order in permutations(range(d)):
            word = list(corner)
            flag = [tuple(word)]
            for axis in order:
                word[axis] = 2
                flag.append(tuple(word))
            flags.append(flag)
    chosen = np.array(flags)  # (2^d d!, d + 1, d)
    tets = number[:, chosen @ (3 ** np.arange(d)[::-1])].reshape(-1, d + 1)
    place = np.array([0, FULL, FULL // 2])[chosen]
    block = np.repeat(np.arange(count), len(chosen))
    return _started(blocks, tets, block, np.tile(place, (count, 1, 1)), nodes)


def _started(blocks: Blocks, tets: Index, block: Index, places: Index, nodes: int) -> BisectedMesh:
    tag = np.full(len(tets), blocks.dim, dtype=np.int64)
    return BisectedMesh(blocks, tets, tag, block, places, np.full((nodes, 2), -1, dtype=np.int64))


def refine(
    mesh: BisectedMesh, marked: NDArray[np.bool_], most: int = 4_000_000
) -> tuple[BisectedMesh, NDArray[np.bool_]]:
    """Bisect the marked simplices and what conformity asks for.

    Parameters
    ----------
    marked : (m,)
    most : most simplices of the result.

    Returns
    -------
    The finer mesh; simplices that stay keep their number. And (m',) which simplices are new.

    Raises
    ------
    InputError : the result would have more than ``most`` simplices, or nodes finer than 2^-LEVELS.
    """
    made = _refine(mesh.tets, mesh.tag, mesh.block, mesh.places, mesh.ends, marked, most)
    status, tets, tag, block, places, ends, fresh = made
    if status == 1:
        raise InputError(f"the mesh of the meccano needs more than {most} elements; ask for a larger tolerance")
    if status == 2:
        raise InputError(
            f"the mesh of the meccano needs elements finer than 2^-{LEVELS} of a block; ask for a larger tolerance"
        )
    return BisectedMesh(mesh.blocks, tets.copy(), tag.copy(), block.copy(), places.copy(), ends.copy()), fresh.copy()


def refine_all(mesh: BisectedMesh, times: int = 1) -> BisectedMesh:
    """Bisect all simplices, ``times`` times."""
    for _ in range(times):
        mesh = refine(mesh, np.ones(len(mesh.tets), dtype=bool))[0]
    return mesh


def oriented(mesh: BisectedMesh) -> tuple[Index, Index]:
    """Node numbers (m, d + 1) and places (m, d + 1, d), the last two vertices swapped where a simplex is negative."""
    edges = (mesh.places[:, 1:] - mesh.places[:, :1]) / FULL
    swap = np.flatnonzero(np.linalg.det(edges) < 0.0)
    tets, places = mesh.tets.copy(), mesh.places.copy()
    tets[swap, -2:] = tets[swap, :-3:-1]
    places[swap, -2:] = places[swap, :-3:-1]
    return tets, places


def place_new(mesh: BisectedMesh, nodes: Array) -> Array:
    """Positions (n', c) of all nodes from those (n, c) of a mesh that it refines, by that one's linear map."""
    result = np.empty((len(mesh.ends), nodes.shape[1]))
    result[: len(nodes)] = nodes
    _place_new(result, mesh.ends, len(nodes))
    return result


@njit(cache=True)
def _place_new(nodes, ends, first):  # type: ignore[no-untyped-def]
    for n in range(first, len(ends)):
        for c in range(nodes.shape[1]):
            nodes[n, c] = 0.5 * (nodes[ends[n, 0], c] + nodes[ends[n, 1], c])


def _boundary_facets(mesh: BisectedMesh) -> BoundaryFacets:
    cell, d = mesh.blocks.cell, mesh.blocks.dim
    sides = mesh.blocks.boundary_sides
    row = np.full((len(mesh.blocks.corners), len(cell.faces)), -1, dtype=np.int64)
    row[sides[:, 0], sides[:, 1]] = np.arange(len(sides))
    tet, side, nodes, s = [], [], [], []
    for number, face in enumerate(cell.faces):
        axis = int(np.flatnonzero((face.axes == 0).all(axis=1))[0])
        on = mesh.places[..., axis] == int(face.origin[axis]) * FULL
        found = np.flatnonzero((on.sum(axis=1) == d) & (row[mesh.block, number] >= 0))
        vertex = np.argsort(~on[found], axis=1, kind="stable")[:, :d]
        place = np.take_along_axis(mesh.places[found], vertex[..., None], axis=1) / FULL
        own = (place - face.origin) @ face.axes
        node = np.take_along_axis(mesh.tets[found], vertex, axis=1)
        flip = np.flatnonzero(np.linalg.det(own[:, 1:] - own[:, :1]) < 0.0)
        node[flip, -2:] = node[flip, -2:][:, ::-1]
        own[flip, -2:] = own[flip, -2:][:, ::-1]
        tet.append(found)
        side.append(row[mesh.block[found], number])
        nodes.append(node)
        s.append(own)
    return BoundaryFacets(np.concatenate(tet), np.concatenate(side), np.concatenate(nodes), np.concatenate(s))


@njit(cache=True)
def _slot(keys, key):  # type: ignore[no-untyped-def]
    """Where a key is, or should go, in an open-addressing table whose size is a power of two."""
    mask = np.uint64(len(keys) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)
    at &= mask
    while keys[at] != -1 and keys[at] != key:
        at = (at + np.uint64(1)) & mask
    return at


@njit(cache=True)
def _key(a, b):  # type: ignore[no-untyped-def]
    return (min(a, b) << 32) | max(a, b)


@njit(cache=True)
def _grown(array, size):  # type: ignore[no-untyped-def]
    larger = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    larger[: len(array)] = array
    return larger


@njit(cache=True)
def _refine(tets0, tag0, block0, places0, ends0, marked, most):  # type: ignore[no-untyped-def]
    m, n, d = len(tets0), len(ends0), tets0.shape[1] - 1
    size, limit = 2 * m + 64, 2 * n + 64
    tets, tag, block, places = _grown(tets0, size), _grown(tag0, size), _grown(block0, size), _grown(places0, size)
    ends = _grown(ends0, limit)
    fresh = np.zeros(size, dtype=np.bool_)
    touched = np.zeros(limit, dtype=np.bool_)  # ends of split edges
    keys, values = np.full(1024, -1, dtype=np.int64), np.empty(1024, dtype=np.int64)
    held = 0
    status = 0
    first = True
    while True:
        bisected = 0
        t = 0
        stop = m if first else 0
        while t < m:
            # The first pass takes the marked ones, later passes those with a node on an edge.
            if first:
                split = t < stop and marked[t]
            else:
                split = False
                for i in range(d + 1):
                    if touched[tets[t, i]]:
                        for j in range(i):
                            if touched[tets[t, j]]:
                                key = _key(tets[t, i], tets[t, j])
                                if keys[_slot(keys, key)] == key:
                                    split = True
            if not split:
                t += 1
                continue
            bisected += 1
            if m + 1 > most:
                status = 1
                break
            if m + 1 > size:
                size *= 2
                tets, places = _grown(tets, size), _grown(places, size)
                tag, block = _grown(tag, size), _grown(block, size)
                larger = np.zeros(size, dtype=np.bool_)
                larger[:m] = fresh[:m]
                fresh = larger
            k = tag[t]
            a, b = tets[t, 0], tets[t, k]
            key = _key(a, b)
            at = _slot(keys, key)
            if keys[at] == key:
                z = values[at]
            else:
                if n + 1 > limit:
                    limit *= 2
                    ends = _grown(ends, limit)
                    larger = np.zeros(limit, dtype=np.bool_)
                    larger[:n] = touched[:n]
                    touched = larger
                z = n
                n += 1
                ends[z, 0], ends[z, 1] = a, b
                touched[z] = False
                touched[a] = touched[b] = True
                keys[at], values[at] = key, z
                held += 1
                if 2 * held > len(keys):
                    old, was = keys, values
                    keys, values = np.full(4 * len(old), -1, dtype=np.int64), np.empty(4 * len(old), dtype=np.int64)
                    for i in range(len(old)):
                        if old[i] != -1:
                            at = _slot(keys, old[i])
                            keys[at], values[at] = old[i], was[i]
            # Second child at the end, first child in place.
            for i in range(d + 1):
                tets[m, i] = tets[t, i]
                for c in range(d):
                    places[m, i, c] = places[t, i, c]
            for c in range(d):
                twice = places[t, 0, c] + places[t, k, c]
                if twice & 1:
                    status = 2
                middle = twice >> 1
                for i in range(k):
                    places[m, i, c] = places[t, i + 1, c]
                places[m, k, c] = middle
                places[t, k, c] = middle
            for i in range(k):
                tets[m, i] = tets[t, i + 1]
            tets[m, k] = z
            tets[t, k] = z
            tag[t] = tag[m] = k - 1 if k > 1 else d
            block[m] = block[t]
            fresh[t] = fresh[m] = True
            m += 1
            if first:
                t += 1
        if status or (not first and bisected == 0):
            break
        first = False
    return status, tets[:m], tag[:m], block[:m], places[:m], ends[:n], fresh[:m]
