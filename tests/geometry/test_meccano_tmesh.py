"""T-meshes: the octree rule, grading, equal levels across block sides, point location."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.layouts.blocks import cube, place
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.tmesh import (
    DEPTH,
    TMesh,
    cells_at,
    from_arrays,
    octree,
    on_side,
    refined,
    to_arrays,
    transitions,
    uniform,
)
from iga.errors import InputError
from tests.geometry.meccano_shapes import polycube, ring, seven

FULL = 1 << LEVELS


def volume(tmesh: TMesh) -> np.ndarray:
    return np.bincount(tmesh.block, 0.5 ** (tmesh.dim * tmesh.level), len(tmesh.blocks.corners))


def inside(tmesh: TMesh, block: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Cells (pairs) that contain a node in their open interior, by trying all."""
    low, high = tmesh.corner[:, None], (tmesh.corner + tmesh.size[:, None])[:, None]
    return (tmesh.block[:, None] == block) & ((places > low) & (places < high)).all(axis=2)


def kuhn_nodes(dim: int, bisections: int, seed: int) -> np.ndarray:
    """Nodes of a random local refinement by newest-vertex bisection with conforming closure, in units of 2^-LEVELS."""
    from itertools import permutations

    tets = []
    for order in permutations(range(dim)):
        path = np.zeros((dim + 1, dim), dtype=int)
        for k, axis in enumerate(order):
            path[k + 1 :, axis] = FULL
        tets.append((tuple(map(tuple, path.tolist())), dim))
    around: dict[tuple, set] = {}
    mesh: set = set()
    rng = np.random.default_rng(seed)

    def add(tet: tuple) -> None:
        mesh.add(tet)
        for v in tet[0]:
            around.setdefault(v, set()).add(tet)

    for tet in tets:
        add(tet)

    def bisect(tet: tuple) -> None:
        vertices, tag = tet
        edge = {vertices[0], vertices[tag]}
        while True:
            shared = around[vertices[0]] & around[vertices[tag]]
            unfit = [other for other in shared if {other[0][0], other[0][other[1]]} != edge]
            if not unfit:
                break
            bisect(min(unfit))
        for other in shared:
            mesh.remove(other)
            for v in other[0]:
                around[v].remove(other)
            x, k = other
            z = tuple((a + b) // 2 for a, b in zip(x[0], x[k]))
            after = k - 1 or dim
            add(((*x[:k], z, *x[k + 1 :]), after))
            add(((*x[1 : k + 1], z, *x[k + 1 :]), after))

    for _ in range(bisections):
        if rng.random() < 0.7:
            bisect(min(mesh, key=lambda t: (max(abs(sum(x) - (dim + 1) * FULL // 5) for x in zip(*t[0])), t)))
        else:
            bisect(sorted(mesh)[int(rng.integers(len(mesh)))])
    return np.unique([v for tet in mesh for v in tet[0]], axis=0)


@pytest.mark.parametrize("dim", [2, 3])
def test_octree_of_a_bisected_mesh(dim: int) -> None:
    nodes = kuhn_nodes(dim, 40, 7)
    zero = np.zeros(len(nodes), dtype=int)
    tmesh = octree(cube(dim), zero, nodes)
    assert np.allclose(volume(tmesh), 1.0, rtol=0, atol=0)
    assert not inside(tmesh, zero, nodes).any()
    assert tmesh.level.max() >= 4
    # Every node is a vertex, and each split was needed: the parent of every cell has a node inside.
    vertices = tmesh.corner[:, None] + tmesh.size[:, None, None] * cube(dim).cell.vertices.astype(int)
    known = {tuple(v) for v in vertices.reshape(-1, dim).tolist()}
    assert all(tuple(v) in known for v in nodes.tolist())
    parents = TMesh(tmesh.blocks, tmesh.block, tmesh.level - 1, tmesh.corner & ~(2 * tmesh.size - 1)[:, None])
    assert inside(parents, zero, nodes).any(axis=1).all()
    # Neighbours differ by a factor of two, and at most one vertex lies inside a face or an edge of a cell.
    corner, size = tmesh.corner, tmesh.size
    points = np.array(sorted(known))
    low, high = corner[:, None], (corner + size[:, None])[:, None]
    within, below, above = (points > low) & (points < high), points == low, points == high
    strictly = within.sum(axis=2)
    closed = (within | below | above).all(axis=2)
    for inner in (dim - 1, dim - 2) if dim == 3 else (1,):
        cells, vertex = np.nonzero(closed & (strictly == inner))
        sides = np.column_stack([cells, below[cells, vertex], above[cells, vertex]])
        assert np.unique(sides, axis=0, return_counts=True)[1].max() == 1


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2, 3]), st.integers(0, 3))
def test_refinement_keeps_grading_and_equal_levels(seed: int, dim: int, grading: int) -> None:
    rng = np.random.default_rng(seed)
    blocks = seven(dim, seed)
    tmesh = uniform(blocks, 1, grading)
    for _ in range(3):
        marked = rng.integers(0, tmesh.cells, 2)
        finer = refined(tmesh, marked)
        found = cells_at(finer, tmesh.block, (tmesh.corner + tmesh.size[:, None] / 2) / FULL)
        assert (finer.level[found][marked] > tmesh.level[marked]).all()
        assert (finer.level[found] >= tmesh.level).all()
        tmesh = finer
    assert (volume(tmesh) == 1.0).all()
    # Equal cells across sides.
    A, t = transitions(blocks)
    for block, side in np.argwhere(blocks.across[:, :, 0] >= 0).tolist():
        own = on_side(tmesh, block, side)
        other = on_side(tmesh, *blocks.across[block, side].tolist())
        sets = []
        for cells, move in ((own, True), (other, False)):
            ends = np.stack([tmesh.corner[cells], tmesh.corner[cells] + tmesh.size[cells, None]], axis=1)
            if move:
                ends = ends @ A[block, side].T + FULL * t[block, side]
            axis = int(blocks.across[block, side, 1]) // 2 if dim == 3 else None
            if dim == 2:
                axis = int(np.flatnonzero(np.ptp(blocks.cell.vertices[list(
                    blocks.cell.faces[int(blocks.across[block, side, 1])].vertices)], axis=0) == 0)[0])
            ends = np.delete(np.sort(ends, axis=1), axis, axis=2)
            sets.append(np.unique(ends.reshape(len(cells), -1), axis=0))
        assert np.array_equal(sets[0], sets[1])
    # Grading inside blocks, by all pairs of cells: around a parent all cells within g of its size are as large at most.
    if grading:
        size = 2 * tmesh.size
        low = tmesh.corner & ~(size - 1)[:, None]
        reach_low, reach_high = low - grading * size[:, None], low + (1 + grading) * size[:, None]
        near = (tmesh.block[:, None] == tmesh.block) & (
            (tmesh.corner + tmesh.size[:, None] > reach_low[:, None]) & (tmesh.corner < reach_high[:, None])
        ).all(axis=2)
        assert (np.where(near, tmesh.size, 0) <= size[:, None]).all()


def test_transitions_agree_with_the_picture() -> None:
    for blocks in (seven(3, 4), ring(9), polycube([(0, 0), (1, 0), (1, 1)], 3)):
        A, t = transitions(blocks)
        s = np.random.default_rng(5).random((6, blocks.dim - 1))
        for block, side in np.argwhere(blocks.across[:, :, 0] >= 0).tolist():
            face = blocks.cell.faces[side]
            xi = face.origin + s @ face.axes.T
            there = np.full(6, blocks.across[block, side, 0])
            moved = xi @ A[block, side].T + t[block, side]
            assert np.abs(place(blocks, np.full(6, block), xi) - place(blocks, there, moved)).max() < 1e-12


def test_cells_are_found_and_stored() -> None:
    tmesh = refined(refined(uniform(ring(2), 1, 2), np.array([3, 40])), np.array([11]))
    rng = np.random.default_rng(11)
    block, xi = rng.integers(0, 8, 500), rng.random((500, 3))
    cells = cells_at(tmesh, block, xi)
    low = tmesh.corner[cells] / FULL
    assert (tmesh.block[cells] == block).all()
    assert ((xi >= low) & (xi < low + 0.5 ** tmesh.level[cells, None])).all()
    again = from_arrays(to_arrays(tmesh))
    assert np.array_equal(again.code, tmesh.code)
    assert again.grading == 2
    broken = to_arrays(tmesh) | {"cell_level": tmesh.level + 1}
    with pytest.raises(InputError, match="do not fill"):
        from_arrays(broken)


def test_bad_input() -> None:
    with pytest.raises(InputError, match="node 1 lies outside"):
        octree(cube(), np.zeros(2, dtype=int), np.array([[1, 1, 1], [1, FULL + 1, 1]]))
    with pytest.raises(InputError, match=f"the finest level is {DEPTH}"):
        octree(cube(), np.zeros(1, dtype=int), np.array([[1, 1, 1]]))
    with pytest.raises(InputError, match="more than the limit"):
        refined(uniform(cube(), 3), limit=1000)


def test_a_hundred_thousand_cells_take_about_a_second() -> None:
    begin = time.process_time()
    tmesh = uniform(cube(), 3, 3)
    for _ in range(3):
        centre = (tmesh.corner + tmesh.size[:, None] / 2) / FULL
        near = np.abs(np.linalg.norm(centre - 0.5, axis=1) - 0.4) < 1.2 * tmesh.size / FULL
        tmesh = refined(tmesh, near)
    assert tmesh.cells > 60_000
    assert time.process_time() - begin < 3.0
