r"""A second space on the same mesh, of optimal order: splines where the limit is one, free Bezier functions elsewhere.

Catmull-Clark functions lose order twice: the boundary rule makes every function a natural spline across the boundary
(second normal derivative zero), and near extraordinary edges the functions reproduce few polynomials. Both sit in
a zone: cells that touch the boundary, and irregular cells. There this space has the tricubic Bernstein functions
themselves, C0 between cells. Elsewhere (the core) the B-splines N_v stay, cut off in the zone:

    free functions      Bernstein functions of the C0 complex whose point lies on no core cell,
    spline functions    N_v truncated: only its Bezier coefficients at points on core cells,

so that all sum to one, all are C0, the core keeps its C2 splines, and on the zone every tricubic polynomial (away from
its interface) is in the space. Functions are independent: each N_v kept acts on a core cell, where tricubic B-splines
are independent. Where the core has no cell this is the C0 tricubic space.

The geometry is the limit volume on regular cells and, on irregular cells of the *input* mesh, their tricubic closure:
it stays fixed under refinement (closures are split by de Casteljau, not subdivided anew). Subdividing them anew would
keep the shape of the cells around an extraordinary edge self-similar, hence curved at every level, and cap the order at
h^2 in H1; on a fixed map uniform refinement has order h^3 in H1 and h^4 in L2. So spaces are nested up to the zone,
which gets thinner.

Axis letters: e cell, r Bezier point of the complex, v control point, b Bernstein function.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from geometry.catmull_clark.domain import CUBIC, LINES, boundary_patches
from geometry.catmull_clark.lattice import Rows, bezier_matrix, bezier_rows
from geometry.catmull_clark.neighbourhood import ROTATIONS, TURNED_FACES, walk
from geometry.catmull_clark.pieces import pieces_of
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import INTERIOR, SMOOTH, Topology
from iga.block import Block, Kronecker, Patterns
from iga.domain import Domain, Facets, Provenance, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

_HALF = np.array([[8, 0, 0, 0], [4, 4, 0, 0], [2, 4, 2, 0], [1, 3, 3, 1]]) / 8.0
_HALVES = (_HALF, _HALF[::-1, ::-1])
_SPLIT = np.stack(
    [np.kron(np.kron(_HALVES[i], _HALVES[j]), _HALVES[k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
)
_STRIDE = np.array([16, 4, 1])


def _lattice_turns() -> Index:
    """For each rotation the Bernstein functions of the cell as numbered, in the order of the turned cell, (24, 64)."""
    grid = np.array(list(np.ndindex(4, 4, 4)))
    corners = np.array(list(np.ndindex(2, 2, 2)))
    made = []
    for turn in ROTATIONS:
        origin = corners[turn[0]]
        axes = corners[turn[[4, 2, 1]]] - origin
        made.append((3 * origin + grid @ axes) @ _STRIDE)
    return np.array(made)


_TURNS = _lattice_turns()


def core_cells(topology: Topology, regular: Flags) -> Flags:
    """Cells that keep their splines: regular ones (ancestors too, ``regular``) without a boundary vertex."""
    inner = (topology.vertex_kind == INTERIOR)[topology.hexes].all(axis=1)
    return regular & topology.regular_hexes & inner


def build_optimal(
    topology: Topology,
    control: Array,
    levels: int,
    attributes: Mapping[str, slice],
    provenance: Provenance,
    report: Mapping[str, Any],
) -> Domain:
    """Domain of the space after ``levels`` refinements of the input mesh.

    Parameters
    ----------
    topology : the input mesh with its kinds.
    control : (v, 3 + ..) control points, and control values of attributes in the columns ``attributes``.
    """
    rows = bezier_rows(topology)
    net = (bezier_matrix(topology, rows) @ control)[rows.cells]
    regular = topology.regular_hexes
    fine, values = topology, control
    for _ in range(levels):
        fine, S = subdivide(fine)
        values = S @ values
        net = (_SPLIT[None] @ net[:, None]).reshape(-1, 64, control.shape[1])
        regular = np.repeat(regular, 8)
        rows = bezier_rows(fine)
    core = core_cells(fine, regular)
    matrix = bezier_matrix(fine, rows, np.flatnonzero(core))
    touched = np.zeros(len(rows.kind), dtype=bool)
    touched[rows.cells[core]] = True
    spline = np.zeros(fine.vertices, dtype=bool)
    spline[matrix[np.flatnonzero(touched)].indices] = True
    used = np.zeros(len(rows.kind), dtype=bool)
    used[rows.cells] = True
    free = used & ~touched
    number_spline = np.cumsum(spline) - 1
    number_free = int(spline.sum()) + np.cumsum(free) - 1
    coefficients = np.empty((len(rows.kind), control.shape[1]))
    coefficients[rows.cells] = net
    points = np.concatenate([values[spline], coefficients[free]])
    blocks, cells = _blocks(fine, rows, matrix, core, touched, number_spline, number_free)
    numbers = {
        "cells": len(fine.hexes), "core_cells": int(core.sum()), "spline_functions": int(spline.sum()),
        "free_functions": int(free.sum()), "levels": levels,
    }
    carried = {
        key: np.ascontiguousarray(points[:, at] if at.stop - at.start > 1 else points[:, at.start])
        for key, at in attributes.items()
    }
    arrays: dict[str, NDArray[Any]] = {
        "hexes": topology.hexes, "vertex_kind": topology.vertex_kind, "control": control,
        "creases": topology.edges[topology.edge_kind < SMOOTH],
        "columns": np.array([[at.start, at.stop] for at in attributes.values()], dtype=np.int64).reshape(-1, 2),
    }
    return Domain(
        Space(tuple(blocks), len(points)), np.ascontiguousarray(points[:, :3]), _boundaries(fine, cells), carried,
        replace(provenance, arrays=arrays), {**report, **numbers},
    )


def _blocks(
    t: Topology, rows: Rows, matrix: csr_array, core: Flags, touched: Flags, spline: Index, free: Index
) -> tuple[list[Block], list[tuple[Index, Index]]]:
    """Blocks, and for each the cells and the rotation in which they are stored."""
    blocks: list[Block] = []
    stored: list[tuple[Index, Index]] = []
    mask = touched[rows.cells]
    alone = np.flatnonzero(~mask.any(axis=1))
    if len(alone):
        blocks.append(Block(CUBIC, free[rows.cells[alone]], None, alone))
        stored.append((alone, np.zeros(len(alone), dtype=np.int64)))
    inside = np.flatnonzero(core)
    if len(inside):
        dofs, turn = _lattices(t, inside)
        pattern = np.zeros((len(inside), 3), dtype=np.int64)
        factor = LINES[False, False][None]
        blocks.append(Block(CUBIC, spline[dofs], Kronecker((factor,) * 3, pattern), inside))
        stored.append((inside, turn))
    mixed = np.flatnonzero(mask.any(axis=1) & ~core)
    if len(mixed):
        _mixed(t, rows, matrix, mixed, mask, spline, free, blocks, stored)
    return blocks, stored


def _lattices(t: Topology, cells: Index) -> tuple[Index, Index]:
    """The 64 vertices around core cells in lattice order (e, 64), and the rotation of each cell in that order."""
    C = pieces_of(t, cells[:1], 0).C[0]
    line = LINES[False, False]
    product = np.kron(np.kron(line, line), line)
    order = np.abs(product[:, None] - C[None]).max(axis=2).argmin(axis=1)
    parts = list(walk(t, cells))  # core cells have one class
    vertex = np.concatenate([part.vertex.reshape(-1, 64) for part in parts])
    return np.ascontiguousarray(vertex[:, order]), np.concatenate([part.rotation for part in parts])


def _mixed(
    t: Topology, rows: Rows, matrix: csr_array, mixed: Index, mask: Flags, spline: Index, free: Index,
    blocks: list[Block], stored: list[tuple[Index, Index]],
) -> None:
    """Zone cells that touch the core: some Bernstein functions are free, the others follow the splines."""
    rotation, signature, vertices, count = [], [], [], []
    for part in walk(t, mixed):
        turned = np.take_along_axis(mask[part.cells], _TURNS[part.rotation], axis=1)
        bits = np.packbits(turned, axis=1).view(np.uint64)[:, 0]
        signature.append(part.signature ^ (bits * np.uint64(0x9E3779B97F4A7C15)))
        rotation.append(part.rotation)
        vertices.append(part.vertex)
        count.append(np.diff(part.start))
    turn, vertex, size = np.concatenate(rotation), np.concatenate(vertices), np.concatenate(count)
    start = np.concatenate([[0], np.cumsum(size)[:-1]])
    _, first, label = np.unique(np.concatenate(signature), return_index=True, return_inverse=True)
    order = np.argsort(label, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(label))[:-1])
    lattice = np.take_along_axis(rows.cells[mixed], _TURNS[turn], axis=1)
    groups: dict[int, list[tuple[Array, Index, Index]]] = {}
    place = np.full(t.vertices, -1, dtype=np.int64)
    for k, some in enumerate(members):
        one = int(first[k])
        around = vertex[start[one] : start[one] + size[one]]
        place[around] = np.arange(len(around))
        own = mask[mixed[one]][_TURNS[turn[one]]]
        table = np.zeros((len(around), 64))
        part = matrix[lattice[one][own]].tocoo()
        r, v = part.coords
        table[place[v], np.flatnonzero(own)[r]] = part.data
        keep = np.flatnonzero((table != 0.0).any(axis=1))
        C = np.concatenate([table[keep], np.eye(64)[~own]])
        dofs = np.concatenate(
            [spline[vertex[start[some][:, None] + keep]], free[lattice[some][:, ~own]]], axis=1
        )
        groups.setdefault(len(C), []).append((C, dofs, some))
    for n in sorted(groups):
        parts = groups[n]
        some = np.concatenate([p[2] for p in parts])
        pattern = np.repeat(np.arange(len(parts)), [len(p[2]) for p in parts])
        C = np.stack([p[0] for p in parts])
        dofs = np.ascontiguousarray(np.concatenate([p[1] for p in parts]))
        blocks.append(Block(CUBIC, dofs, Patterns(C, pattern), mixed[some]))
        stored.append((mixed[some], turn[some]))


def _boundaries(t: Topology, stored: list[tuple[Index, Index]]) -> dict[str, tuple[Facets, ...]]:
    """Named boundaries, as for the subdivision space."""
    patch = boundary_patches(t)
    count = int(patch.max()) + 1
    found: list[list[Facets]] = [[] for _ in range(count)]
    for block, (cells, turn) in enumerate(stored):
        for face in range(6):
            number = t.hex_faces[cells, TURNED_FACES[turn, face]]
            label = patch[number]
            outer = np.flatnonzero(label >= 0)
            order = outer[np.argsort(label[outer], kind="stable")]
            for run in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
                if len(run):
                    found[label[run[0]]].append(Facets(block, face, np.sort(run)))
    names = ["boundary"] if count == 1 else [f"face_{k + 1}" for k in range(count)]
    return {name: tuple(facets) for name, facets in zip(names, found)}

