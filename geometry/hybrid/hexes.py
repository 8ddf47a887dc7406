r"""Volumes with their tetrahedra turned into hexahedra, four for each, exactly (`geometry.tet_to_hex`).

With T the coefficients of a tetrahedron and M_m the matrix of its sub-hexahedron m, the hexahedra have P_m = M_m T: the
same solid, and C0 functions of degree (d, d, d) of their own. Where tetrahedra touch cells that stay (pyramids and
wedges), these see a triangle where hexahedra have three quadrilaterals. There the hexahedra take the functions of the
triangle: with N_i the function of the tetrahedron,

    N_i = sum_b (M_m)[b, i] B_b,

so the rows of M for the B_b that live on the touching faces, edges and vertices give the extraction, and the space is
conforming.

Axis letters: e tetrahedron, m sub-hexahedron, b Bernstein function, n function, f face, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.refinement import Bezier, bezier_of, domain_of, from_columns
from geometry.tet_to_hex import hex_matrices
from geometry.tet_to_hex_mesh import FACES, hex_facets, hex_vertices
from iga.bernstein import bernstein, face_functions
from iga.block import Block
from iga.cells import HEXAHEDRON, TETRAHEDRON, Cell
from iga.conforming import Complex, entity_keys, number
from iga.domain import Domain, Facets, Space, grouped_facets

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def with_hexes(domain: Domain) -> Domain:
    """Turn all tetrahedra of a hybrid volume into four hexahedra each.

    Functions become C0 Bernstein functions on all cells. Facets of tetrahedra become three facets.
    """
    old = bezier_of(domain)
    cells = [cell for cell, _ in old.mesh.parts]
    if TETRAHEDRON not in cells:
        return domain
    t = cells.index(TETRAHEDRON)
    rest = [k for k in range(len(cells)) if k != t]
    tets, degree = old.mesh.parts[t][1], old.degree
    kept, count = number(Complex(tuple(old.mesh.parts[k] for k in rest)), degree) if rest else ([], 0)
    corners = hex_vertices(tets)
    (dofs,), total = number(Complex(((HEXAHEDRON, corners),)), degree)
    M, free = _rows(old, t, rest, kept, count, dofs, total)
    values = np.empty((count + int(free.sum()), old.coefficients[t].shape[2]))
    for k, own in zip(rest, kept):
        values[own] = old.coefficients[k]
    fine = np.matmul(hex_matrices(degree)[None], old.coefficients[t][:, None]).reshape(len(dofs), -1, values.shape[1])
    place = np.cumsum(free) - 1 + count
    inner = free[dofs]
    values[place[dofs[inner]]] = fine[inner]

    blocks = [Block(bernstein(cells[k], degree), own) for k, own in zip(rest, kept)]
    arrays = {f"corners{i}": old.mesh.parts[k][1] for i, k in enumerate(rest)}
    where = np.empty((len(dofs), 2), dtype=np.int64)
    for block, elements in blocks_of(bernstein(HEXAHEDRON, degree), dofs, M):
        where[elements] = np.column_stack([np.full(len(elements), len(blocks)), np.arange(len(elements))])
        arrays[f"corners{len(blocks)}"] = corners[elements]
        arrays[f"tets{len(blocks)}"] = elements
        blocks.append(block)
    named = {name: _facets(own, t, rest, where) for name, own in old.facets.items()}
    points, weights, attributes = from_columns(domain, values)
    origin = domain.provenance
    others = {k: v for k, v in origin.arrays.items() if not k.startswith(("corners", "tets"))}
    return Domain(
        Space(tuple(blocks), len(points), weights), points, named, attributes,
        replace(origin, arrays={**others, **arrays}), {**domain.report, "converted_tets": len(tets)},
    )


def has_hexes(domain: Domain) -> bool:
    """Whether tetrahedra of a domain were turned into hexahedra."""
    return any(key.startswith("tets") for key in domain.provenance.arrays)


def with_tets(domain: Domain) -> Domain:
    """Take back what `with_hexes` did: the same map, with C0 Bernstein functions."""
    arrays = domain.provenance.arrays
    groups = {k: np.asarray(arrays[f"tets{k}"]) for k in range(len(domain.space.blocks)) if f"tets{k}" in arrays}
    total = sum(len(own) for own in groups.values())
    plain = bezier_of(domain)
    degree = plain.degree
    matrices = hex_matrices(degree)
    h = next(k for k, (cell, _) in enumerate(plain.mesh.parts) if cell is HEXAHEDRON)
    sizes = [b.elements if b.basis.cell is HEXAHEDRON else 0 for b in domain.space.blocks]
    start = np.cumsum(sizes) - sizes
    place = np.concatenate([start[k] + np.arange(len(own)) for k, own in groups.items()])
    order = np.empty(total, dtype=np.int64)
    order[np.concatenate(list(groups.values()))] = place
    values = plain.coefficients[h][order].reshape(total // 4, -1, plain.coefficients[h].shape[2])
    back = np.linalg.pinv(matrices.reshape(-1, matrices.shape[2]))
    tets = np.ascontiguousarray(plain.mesh.parts[h][1][order][:, 0].reshape(-1, 4))
    stay = np.setdiff1d(np.arange(len(plain.mesh.parts[h][1])), order)
    parts: list[tuple[Cell, Index]] = []
    coefficients: list[Array] = []
    number_of = np.full((len(plain.mesh.parts), 1 + max(len(v) for _, v in plain.mesh.parts), 2), -1, dtype=np.int64)
    for k, (cell, vertices) in enumerate(plain.mesh.parts):
        own = stay if k == h else np.arange(len(vertices))
        if len(own):
            number_of[k, own] = np.column_stack([np.full(len(own), len(parts)), np.arange(len(own))])
            parts.append((cell, vertices[own]))
            coefficients.append(plain.coefficients[k][own])
    number_of[h, order, 0] = len(parts)
    number_of[h, order, 1] = np.arange(total)
    parts.append((TETRAHEDRON, tets))
    coefficients.append(np.matmul(back, values))
    facets = {}
    for name, own in plain.facets.items():
        to = number_of[own[:, 0], own[:, 1]]
        tet = to[:, 0] == len(parts) - 1
        mine = to[tet, 1]
        table = np.full((4, 6), -1)
        for face in range(4):
            for hexahedron, on in hex_facets(np.array([[0, face]])):
                table[hexahedron, on] = face
        pairs = np.unique(np.column_stack([mine // 4, table[mine % 4, own[tet, 2]]]), axis=0)
        facets[name] = np.concatenate([
            np.column_stack([to[~tet], own[~tet, 2]]),
            np.column_stack([np.full(len(pairs), len(parts) - 1), pairs]),
        ])
    report = {k: v for k, v in domain.report.items() if k != "converted_tets"}
    made = Bezier(Complex(tuple(parts)), degree, tuple(coefficients), facets)
    return domain_of(replace(domain, report=report), made, {})


def _rows(
    old: Bezier, t: int, rest: list[int], kept: list[Index], count: int, dofs: Index, total: int
) -> tuple[csr_array, Mask]:
    """M (hexahedral Bernstein functions, all functions), and which of its rows are functions of their own."""
    degree = old.degree
    free = np.ones(total, dtype=bool)
    rows, columns, entries = [], [], []
    if rest:
        shared, place = _shared(old, t, rest, kept)
        matrices = hex_matrices(degree)
        seen = np.zeros(total, dtype=bool)
        for faces, functions in _entities(degree):
            mine = np.flatnonzero(shared[faces])
            if not len(mine):
                continue
            for m, b in zip(*np.nonzero(functions)):
                row = dofs[4 * mine + m, b]
                first = np.unique(row, return_index=True)[1]
                first = first[~seen[row[first]]]
                seen[row[first]] = True
                weight = np.flatnonzero(matrices[m, b])
                rows.append(np.repeat(row[first], len(weight)))
                columns.append(place[mine[first]][:, weight].ravel())
                entries.append(np.tile(matrices[m, b, weight], len(first)))
        free = ~seen
    own = np.flatnonzero(free)
    rows.append(own)
    columns.append(count + np.arange(len(own)))
    entries.append(np.ones(len(own)))
    at = (np.concatenate(rows), np.concatenate(columns))
    if (at[1] < 0).any():
        raise AssertionError("functions on faces between tetrahedra and other cells")
    M = coo_array((np.concatenate(entries), at), shape=(total, count + len(own)))
    return csr_array(M.tocsr()), free


def _shared(
    old: Bezier, t: int, rest: list[int], kept: list[Index]
) -> tuple[dict[frozenset[int], Mask], Index]:
    """For each entity of the tetrahedron, by the faces that hold it, which elements share it with other cells (e,);
    and the other cells' functions (e, n) that are the tetrahedra's, -1 where there is none.
    """
    tets, vertices = old.mesh.parts[t][1], old.mesh.vertices
    others = [old.mesh.parts[k] for k in rest]
    shared: dict[frozenset[int], Mask] = {}
    corner = np.concatenate([own.ravel() for _, own in others])
    used = np.zeros(vertices, dtype=bool)
    used[corner] = True
    for v in range(4):
        shared[frozenset({0, 1, 2, 3} - {v})] = used[tets[:, v]]
    edges = np.concatenate([own[:, cell.edges].reshape(-1, 2) for cell, own in others])
    triangles = np.concatenate([
        own[:, np.array([f.vertices for f in cell.faces if len(f.vertices) == 3], dtype=np.int64).reshape(-1, 3)]
        .reshape(-1, 3) for cell, own in others
    ])
    for ends, there in ((TETRAHEDRON.edges, edges), (FACES, triangles)):
        mine = tets[:, ends]
        keys = entity_keys(np.concatenate([mine.reshape(-1, ends.shape[1]), there]), vertices)
        own_keys = keys[: mine.shape[0] * mine.shape[1]]
        hit = np.isin(own_keys, keys[len(own_keys) :]).reshape(mine.shape[:2])
        for k, own in enumerate(ends.tolist()):
            shared[frozenset({0, 1, 2, 3} - set(own))] = hit[:, k]
    everywhere, n = number(old.mesh, old.degree)
    to = np.full(n, -1, dtype=np.int64)
    for k, own in zip(rest, kept):
        to[everywhere[k]] = own
    return shared, to[everywhere[t]]


def _entities(degree: int) -> list[tuple[frozenset[int], NDArray[np.bool_]]]:
    """Entities of a tetrahedron, by the faces that hold them, with the hexahedral functions (m, b) on them."""
    basis = bernstein(HEXAHEDRON, degree)
    on = np.zeros((4, 4, basis.n), dtype=bool)
    for face in range(4):
        for m, f in hex_facets(np.array([[0, face]])):
            on[face, m, face_functions(basis, int(f))[1]] = True
    sets = [frozenset({0, 1, 2, 3} - {v}) for v in range(4)]
    sets += [frozenset({0, 1, 2, 3} - set(e)) for e in [*TETRAHEDRON.edges.tolist(), *FACES.tolist()]]
    return [(s, np.asarray(on[list(s)].all(axis=0))) for s in sets]


def _facets(own: Index, t: int, rest: list[int], where: Index) -> tuple[Facets, ...]:
    """Facets of blocks from (part, element, face)."""
    rows = [np.column_stack([np.full(0, 0)] * 3)]
    for i, k in enumerate(rest):
        mine = own[own[:, 0] == k]
        rows.append(np.column_stack([np.full(len(mine), i), mine[:, 1:]]))
    mine = own[own[:, 0] == t]
    if len(mine):
        made = hex_facets(mine[:, 1:])
        rows.append(np.column_stack([where[made[:, 0]], made[:, 1]]))
    return grouped_facets(np.concatenate(rows))
