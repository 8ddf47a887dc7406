r"""The analysis space of a Catmull-Clark solid, and the domain on it.

Functions are one for each control point. Elements are the pieces of `pieces`, with the cell of the control mesh as
their parent. Regular cells carry products of univariate cubic B-splines, stored as Kronecker factors; where a cell's
end lies on the boundary the missing control point is the natural P_-1 = 2 P_0 - P_1, which *is* the boundary rule:

    inside   (b0 .. b3) from (P_-1, P_0, P_1, P_2)
    natural  (b0 .. b3) from (P_0, P_1, P_2): b0 = P_0, b1 = (2 P_0 + P_1)/3, ..

All other pieces share dense patterns by class of neighbourhood.

Axis letters: e element, n function, b Bernstein function, k pattern.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.catmull_clark.neighbourhood import TURNED_FACES, Classes, classify
from geometry.catmull_clark.pieces import pieces_of
from geometry.catmull_clark.topology import SMOOTH, Topology
from iga.bernstein import bernstein
from iga.block import Block, Kronecker, Patterns
from iga.cells import HEXAHEDRON
from iga.domain import Domain, Facets, Provenance, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CUBIC = bernstein(HEXAHEDRON, 3)
_INSIDE = np.array([[1, 0, 0, 0], [4, 4, 2, 1], [1, 2, 4, 4], [0, 0, 0, 1]]) / 6.0
_NATURAL = np.array([[6, 4, 2, 1], [0, 2, 4, 4], [0, 0, 0, 1]]) / 6.0
_LINEAR = np.array([[3, 2, 1, 0], [0, 1, 2, 3]]) / 3.0
LINES = {(False, False): _INSIDE, (True, False): _NATURAL, (False, True): _NATURAL[::-1, ::-1], (True, True): _LINEAR}
"""Extraction of the univariate natural cubic spline on one interval, by which ends are boundary."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Facets of one block: element and mesh face for each local face."""

    elements: list[Index]
    faces: list[Index]


def build_space(topology: Topology, depth: int) -> tuple[Space, dict[str, tuple[Facets, ...]], dict[str, Any]]:
    """Analysis space of a mesh with kinds set.

    Parameters
    ----------
    depth : how often irregular cells are subdivided before they are closed.

    Returns
    -------
    The space, its named boundaries ("boundary", or "face_1", "face_2", .. between creases), and numbers for the report.
    """
    classes, dofs = classify(topology)
    pieces = pieces_of(topology, classes.representative, depth)
    regular = topology.regular_hexes[classes.representative]
    members = _members(classes)
    blocks: list[Block] = []
    sides: list[Sides] = []
    irregular: dict[int, list[tuple[int, int, Index]]] = {}
    for p, k in enumerate(pieces.owner.tolist()):
        if regular[k]:
            block = _regular_block(topology, classes, members[k], dofs[k], k, pieces.C[p])
            if block is not None:
                blocks.append(block)
                sides.append(_sides(topology, classes, [(members[k], pieces.low[p], pieces.high[p])]))
                continue
        rows = np.flatnonzero((pieces.C[p] != 0.0).any(axis=1))
        irregular.setdefault(len(rows), []).append((p, k, rows))
    for n in sorted(irregular):
        parts = irregular[n]
        count = [len(members[k]) for _, k, _ in parts]
        C = np.stack([pieces.C[p][rows] for p, _, rows in parts])
        block = Block(
            CUBIC,
            np.ascontiguousarray(np.concatenate([dofs[k][:, rows] for _, k, rows in parts])),
            Patterns(C, np.repeat(np.arange(len(parts)), count)),
            np.concatenate([members[k] for _, k, _ in parts]),
        )
        blocks.append(block)
        sides.append(_sides(topology, classes, [(members[k], pieces.low[p], pieces.high[p]) for p, k, _ in parts]))
    share = np.prod(pieces.high - pieces.low, axis=1)
    in_class = np.bincount(classes.label, minlength=len(classes.size))
    report = {
        "depth": depth,
        "cells": len(topology.hexes),
        "irregular_cells": int((~topology.regular_hexes).sum()),
        "neighbourhoods": len(classes.size),
        "patterns": len(pieces.C),
        "closed_pieces": int(in_class[pieces.owner[pieces.closed]].sum()),
        "closed_share": float((share * pieces.closed * in_class[pieces.owner]).sum() / len(topology.hexes)),
    }
    return Space(tuple(blocks), topology.vertices), _named(topology, sides), report


def _members(classes: Classes) -> list[Index]:
    """Cells of each class."""
    order = np.argsort(classes.label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(classes.label, minlength=len(classes.size)))[:-1])


def _regular_block(
    topology: Topology, classes: Classes, cells: Index, dofs: Index, k: int, C: Array
) -> Block | None:
    """Product block of a regular class; None if its extraction is no such product (never seen, so kept dense)."""
    cell = classes.representative[k]
    outer = topology.face_kind[topology.hex_faces[cell, TURNED_FACES[classes.rotation[cell]]]] == SMOOTH
    factors = [LINES[bool(outer[2 * d]), bool(outer[2 * d + 1])] for d in range(3)]
    product = np.kron(np.kron(factors[0], factors[1]), factors[2])
    if product.shape != C.shape:
        return None
    distance = np.abs(product[:, None] - C[None]).max(axis=2)
    order = distance.argmin(axis=1)
    if distance.min(axis=1).max() > 1e-13 or len(np.unique(order)) != len(order):
        return None
    pattern = np.zeros((len(cells), 3), dtype=np.int64)
    extraction = Kronecker(tuple(f[None] for f in factors), pattern)
    return Block(CUBIC, np.ascontiguousarray(dofs[:, order]), extraction, cells)


def _sides(topology: Topology, classes: Classes, parts: list[tuple[Index, Array, Array]]) -> Sides:
    """Boundary facets of the elements of a block, made of pieces (cells, low, high)."""
    elements: list[list[Index]] = [[] for _ in range(6)]
    faces: list[list[Index]] = [[] for _ in range(6)]
    start = 0
    for cells, low, high in parts:
        for side in range(6):
            axis, end = divmod(side, 2)
            if (high[axis] == 1.0) if end else (low[axis] == 0.0):
                number = topology.hex_faces[cells, TURNED_FACES[classes.rotation[cells], side]]
                outer = np.flatnonzero(topology.face_kind[number] == SMOOTH)
                elements[side].append(start + outer)
                faces[side].append(number[outer])
        start += len(cells)
    empty = np.zeros(0, dtype=np.int64)
    return Sides([np.concatenate([empty, *e]) for e in elements], [np.concatenate([empty, *f]) for f in faces])


def boundary_patches(topology: Topology) -> Index:
    """Patch number of each face (f,): pieces of the boundary between creases, by size; -1 inside."""
    outer = topology.boundary_faces
    edges = topology.face_edges[outer].ravel()
    owner = np.repeat(outer, 4)
    order = np.argsort(edges, kind="stable")
    pairs = owner[order].reshape(-1, 2)
    joined = pairs[topology.edge_kind[edges[order][::2]] == SMOOTH]
    f = len(topology.faces)
    label = connected_components(coo_array((np.ones(len(joined)), joined.T), shape=(f, f)), directed=False)[1]
    found, first, inverse, count = np.unique(label[outer], return_index=True, return_inverse=True, return_counts=True)
    rank = np.empty(len(found), dtype=np.int64)
    rank[np.lexsort((first, -count))] = np.arange(len(found))
    patch = np.full(f, -1, dtype=np.int64)
    patch[outer] = rank[inverse]
    return patch


def _named(topology: Topology, sides: list[Sides]) -> dict[str, tuple[Facets, ...]]:
    patch = boundary_patches(topology)
    count = int(patch.max()) + 1
    found: list[list[Facets]] = [[] for _ in range(count)]
    for block, side in enumerate(sides):
        for face in range(6):
            label = patch[side.faces[face]]
            order = np.argsort(label, kind="stable")
            for run in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
                if len(run):
                    found[label[run[0]]].append(Facets(block, face, np.sort(side.elements[face][run])))
    names = ["boundary"] if count == 1 else [f"face_{k + 1}" for k in range(count)]
    return {name: tuple(facets) for name, facets in zip(names, found)}


def build_domain(
    topology: Topology,
    points: Array,
    depth: int,
    attributes: Mapping[str, Array] | None = None,
    provenance: Provenance | None = None,
    report: Mapping[str, Any] | None = None,
) -> Domain:
    """Domain of the limit volume of control points (v, 3).

    Parameters
    ----------
    attributes : control values (v,) or (v, k).
    provenance : source, input and parameters; the connectivity is added to its arrays.
    """
    space, boundaries, numbers = build_space(topology, depth)
    origin = provenance or Provenance()
    arrays = {
        **origin.arrays,
        "hexes": topology.hexes,
        "vertex_kind": topology.vertex_kind,
        "creases": topology.edges[topology.edge_kind < SMOOTH],
    }
    return Domain(
        space, points, boundaries, attributes or {}, replace(origin, arrays=arrays), {**numbers, **(report or {})}
    )
