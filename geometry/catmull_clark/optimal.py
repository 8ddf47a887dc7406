r"""A second space on the same mesh, of optimal order: open splines where the limit is one, Bezier functions elsewhere.

Catmull-Clark functions lose order twice: the boundary rule makes every function a natural spline across the boundary
(second normal derivative zero), and near extraordinary edges the functions reproduce few polynomials.

At the boundary the knots are opened: of the cubic B-splines on a half line with the fourfold end knot,

    N_0 = B_0 + 2/3 B_1,   N_1 = 1/3 B_1 + B_2,   N_i = B_(i+1),

the left sides being the natural ones of the subdivision rule, so one more function per boundary vertex (three on
creases, seven at corners, as products) contains them and every cubic. `open_splines` has them on the core, the cells
around which the mesh is a product. The rest, the irregular zone, has the tricubic Bernstein functions themselves, C0
between cells:

    free functions      Bernstein functions of the C0 complex whose point lies on no core cell,
    spline functions    open B-splines truncated: only their Bezier coefficients at points on core cells,

so that all sum to one, all are C0, the core keeps its C2 splines, and on the zone every tricubic polynomial (away from
its interface) is in the space. Functions are independent: each spline kept acts on a core cell, where tricubic
B-splines are independent. Where the core has no cell this is the C0 tricubic space.

The geometry is the limit volume on regular cells and, on irregular cells of the *input* mesh, their tricubic closure:
it stays fixed under refinement (closures are split by de Casteljau, not subdivided anew). Subdividing them anew would
keep the shape of the cells around an extraordinary edge self-similar, hence curved at every level, and cap the order at
h^2 in H1; on a fixed map uniform refinement has order h^3 in H1 and h^4 in L2. So spaces are nested up to the zone,
which gets thinner.

Axis letters: e cell, r Bezier point of the complex, n spline function, b Bernstein function, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark.domain import CUBIC, boundary_patches
from geometry.catmull_clark.lattice import Rows, bezier_matrix, bezier_rows
from geometry.catmull_clark.neighbourhood import ROTATIONS, TURNED_FACES
from geometry.catmull_clark.open_splines import LINES_OPEN, OpenSplines, open_splines
from geometry.catmull_clark.pieces import SPLIT
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import SMOOTH, Topology
from iga.block import Block, Kronecker, Patterns
from iga.domain import Domain, Facets, Provenance, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

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
        net = (SPLIT[None] @ net[:, None]).reshape(-1, 64, control.shape[1])
        regular = np.repeat(regular, 8)
        rows = bezier_rows(fine)
    splines = open_splines(fine, np.flatnonzero(regular & fine.regular_hexes), values)
    touched = np.zeros(len(rows.kind), dtype=bool)
    touched[rows.cells[splines.cells]] = True
    used = np.zeros(len(rows.kind), dtype=bool)
    used[rows.cells] = True
    free = used & ~touched
    number_free = len(splines.values) + np.cumsum(free) - 1
    coefficients = np.empty((len(rows.kind), control.shape[1]))
    coefficients[rows.cells] = net
    points = np.concatenate([splines.values, coefficients[free]])
    blocks, cells = _blocks(fine, rows, splines, touched, number_free)
    numbers = {
        "cells": len(fine.hexes), "core_cells": len(splines.cells), "spline_functions": len(splines.values),
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
    t: Topology, rows: Rows, splines: OpenSplines, touched: Flags, free: Index
) -> tuple[list[Block], list[tuple[Index, Index]]]:
    """Blocks, and for each the cells and the rotation in which they are stored."""
    blocks: list[Block] = []
    stored: list[tuple[Index, Index]] = []
    mask = touched[rows.cells]
    alone = np.flatnonzero(~mask.any(axis=1))
    if len(alone):
        blocks.append(Block(CUBIC, free[rows.cells[alone]], None, alone))
        stored.append((alone, np.zeros(len(alone), dtype=np.int64)))
    if len(splines.cells):
        extraction = Kronecker((LINES_OPEN,) * 3, splines.pattern)
        blocks.append(Block(CUBIC, splines.functions, extraction, splines.cells))
        stored.append((splines.cells, splines.turn))
    core = np.zeros(len(t.hexes), dtype=bool)
    core[splines.cells] = True
    mixed = np.flatnonzero(mask.any(axis=1) & ~core)
    if len(mixed):
        for some, block in _mixed(rows, splines, mixed, mask[mixed], free):
            blocks.append(block)
            stored.append((some, np.zeros(len(some), dtype=np.int64)))
    return blocks, stored


def _mixed(rows: Rows, splines: OpenSplines, mixed: Index, mask: Flags, free: Index) -> list[tuple[Index, Block]]:
    """Zone cells that touch the core: some Bernstein functions are free, the others follow the splines.

    Cells whose splines have the same Bezier coefficients share a pattern; functions are ordered by a hash of theirs.
    """
    cell, b = np.nonzero(mask)
    lattice, turned = rows.cells[splines.cells], _TURNS[splines.turn]
    row, function, value = splines.coefficients(lattice, rows.cells[mixed][mask], turned)
    cell, b = cell[row], b[row]
    n = len(splines.values)
    key = _mix(np.rint(value * 1e9).astype(np.int64).astype(np.uint64) * np.uint64(64) + b.astype(np.uint64))
    pair, inverse = np.unique(cell * n + function, return_inverse=True)
    hashed = np.zeros(len(pair), dtype=np.uint64)
    np.add.at(hashed, inverse, key)
    owner = pair // n
    order = np.lexsort((hashed, owner))
    count = np.bincount(owner, minlength=len(mixed))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    place = np.empty(len(pair), dtype=np.int64)
    place[order] = np.arange(len(pair)) - start[owner[order]]
    slot = place[inverse]  # of each coefficient among the splines of its cell
    bits = np.packbits(mask, axis=1).view(np.uint64)[:, 0]
    signature = _mix(bits) ^ np.uint64(0x9E3779B97F4A7C15)
    np.add.at(signature, cell, _mix(key + _mix(slot.astype(np.uint64))))
    _, first, label = np.unique(signature, return_index=True, return_inverse=True)
    made: dict[int, list[tuple[Array, Index, Index]]] = {}
    by_cell = np.argsort(cell, kind="stable")
    ends = np.searchsorted(cell[by_cell], np.arange(len(mixed) + 1))
    members = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])
    for k, some in enumerate(members):
        one = int(first[k])
        mine = by_cell[ends[one] : ends[one + 1]]
        table = np.zeros((count[one], 64))
        table[slot[mine], b[mine]] = value[mine]
        own = ~mask[one]
        C = np.concatenate([table, np.eye(64)[own]])
        splines_of = pair[order[start[some][:, None] + np.arange(count[one])]] % n
        dofs = np.concatenate([splines_of, free[rows.cells[mixed[some]][:, own]]], axis=1)
        made.setdefault(len(C), []).append((C, dofs, some))
    found = []
    for size in sorted(made):
        parts = made[size]
        some = np.concatenate([p[2] for p in parts])
        pattern = np.repeat(np.arange(len(parts)), [len(p[2]) for p in parts])
        dofs = np.ascontiguousarray(np.concatenate([p[1] for p in parts]))
        found.append((mixed[some], Block(CUBIC, dofs, Patterns(np.stack([p[0] for p in parts]), pattern), mixed[some])))
    return found


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scramble 64 bits (splitmix64 finaliser)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)), dtype=np.uint64)


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

