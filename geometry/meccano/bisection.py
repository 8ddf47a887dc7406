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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks, place
from geometry.meccano.kernels_bisection import LEVEL, SIMPLICES, bisect, enter, place_between
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
    m, n = len(mesh.tets), len(mesh.ends)
    room, nodes = 2 * m + 64, 2 * n + 64
    tets, tag = _with_room(mesh.tets, room), _with_room(mesh.tag, room)
    block, places = _with_room(mesh.block, room), _with_room(mesh.places, room)
    fresh, todo = np.zeros(room, dtype=bool), _with_room(np.asarray(marked, dtype=bool), room)
    ends, touched = _with_room(mesh.ends, nodes), np.zeros(nodes, dtype=bool)
    keys, values = _table(nodes)
    count = np.array([m, n])
    while status := bisect(tets, tag, block, places, ends, fresh, todo, touched, keys, values, count):
        if status == LEVEL:
            raise InputError(
                f"the mesh of the meccano needs elements finer than 2^-{LEVELS} of a block; ask for a larger tolerance"
            )
        if status == SIMPLICES:
            if room > most:
                break
            room *= 2
            tets, tag = _with_room(tets, room), _with_room(tag, room)
            block, places = _with_room(block, room), _with_room(places, room)
            fresh, todo = _with_room(fresh, room), _with_room(todo, room)
        else:
            nodes *= 2
            ends, touched = _with_room(ends, nodes), _with_room(touched, nodes)
            keys, values = _table(nodes)
            enter(keys, values, ends, n, count[1])
    m, n = count.tolist()
    if status or m > most:
        raise InputError(f"the mesh of the meccano needs more than {most} elements; ask for a larger tolerance")
    made = BisectedMesh(
        mesh.blocks, tets[:m].copy(), tag[:m].copy(), block[:m].copy(), places[:m].copy(), ends[:n].copy()
    )
    return made, fresh[:m].copy()


def _with_room(array: NDArray[Any], room: int) -> NDArray[Any]:
    larger = np.zeros((room, *array.shape[1:]), dtype=array.dtype)
    larger[: len(array)] = array
    return larger


def _table(entries: int) -> tuple[Index, Index]:
    """Keys and values of an empty table that has twice the room."""
    size = 1 << int(2 * entries).bit_length()
    return np.full(size, -1, dtype=np.int64), np.empty(size, dtype=np.int64)


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


def picture(mesh: BisectedMesh) -> Array:
    """Vertices (m, d + 1, d) of all simplices in the straight picture of the meccano: the ideal shapes.

    Raises
    ------
    InputError : the picture folds a simplex.
    """
    m, size, d = mesh.places.shape
    x = place(mesh.blocks, np.repeat(mesh.block, size), mesh.places.reshape(-1, d) / FULL).reshape(m, size, d)
    own = np.linalg.det((mesh.places[:, 1:] - mesh.places[:, :1]) / FULL)
    det = np.linalg.det(x[:, 1:] - x[:, :1])
    if (folded := np.flatnonzero(det * own <= 0.0)).size:
        block = mesh.block[folded[0]]
        raise InputError(f"the straight picture of the meccano folds in block {block}; give its corners other places")
    return x


def place_new(mesh: BisectedMesh, nodes: Array) -> Array:
    """Positions (n', c) of all nodes from those (n, c) of a mesh that it refines, by that one's linear map."""
    result = np.empty((len(mesh.ends), nodes.shape[1]))
    result[: len(nodes)] = nodes
    place_between(result, mesh.ends, len(nodes))
    return result


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
