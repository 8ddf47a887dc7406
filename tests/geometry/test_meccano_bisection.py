"""Newest-vertex bisection of meccanos."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from geometry.layouts.blocks import Blocks, cube, pillowed, place, polycube
from geometry.meccano.bisection import FULL, BisectedMesh, coloured, kuhn, oriented, place_new, refine, refine_all
from iga.errors import InputError

RING = polycube(np.array([(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)]))
STARTS = {
    "kuhn 2": kuhn(cube(2)),
    "kuhn 3": kuhn(cube()),
    "coloured 2": coloured(cube(2)),
    "coloured 3": coloured(cube()),
    "pillowed 2": coloured(pillowed(cube(2))),
    "pillowed 3": coloured(pillowed(cube())),
    "ring": coloured(pillowed(RING)),
}


def _positions(mesh: BisectedMesh) -> np.ndarray:
    """Nodes in the straight picture, checked to be the same from all simplices."""
    _, size, d = mesh.places.shape
    x = place(mesh.blocks, np.repeat(mesh.block, size), mesh.places.reshape(-1, d) / FULL)
    nodes = np.zeros((len(mesh.ends), d))
    nodes[mesh.tets.ravel()] = x
    np.testing.assert_allclose(nodes[mesh.tets.ravel()], x, atol=1e-12)
    return nodes


def _check_conforming(mesh: BisectedMesh) -> None:
    """No node lies on the middle of an edge of a simplex that does not have it; no facet is in three simplices."""
    d = mesh.blocks.dim
    pairs = np.array(list(combinations(range(d + 1), 2)))
    edges = np.unique(np.sort(mesh.tets[:, pairs].reshape(-1, 2), axis=1), axis=0)
    split = np.sort(mesh.ends[mesh.ends[:, 0] >= 0], axis=1)
    assert len(np.unique(split, axis=0)) == len(split)
    both = np.unique(np.concatenate([edges, split]), axis=0)
    assert len(both) == len(edges) + len(split)
    facets = np.sort(np.concatenate([np.delete(mesh.tets, i, axis=1) for i in range(d + 1)]), axis=1)
    members = np.unique(facets, axis=0, return_counts=True)[1]
    assert members.max() <= 2
    assert (members == 1).sum() == len(mesh.facets.tet)


def _volume(mesh: BisectedMesh) -> float:
    _, places = oriented(mesh)
    det = np.linalg.det((places[:, 1:] - places[:, :1]) / FULL)
    assert det.min() > 0
    return float(det.sum()) / (6 if mesh.blocks.dim == 3 else 2)


@pytest.mark.parametrize(("times", "tets", "nodes"), [(0, 6, 8), (1, 12, 9), (2, 24, 15), (3, 48, 27), (6, 384, 125)])
def test_global_bisections_of_the_cube(times: int, tets: int, nodes: int) -> None:
    mesh = refine_all(kuhn(cube()), times)
    assert (len(mesh.tets), len(mesh.ends)) == (tets, nodes)


@pytest.mark.parametrize("name", STARTS)
def test_local_refinement_is_conforming_and_nested(name: str) -> None:
    mesh = STARTS[name]
    rng = np.random.default_rng(7)
    blocks = len(mesh.blocks.corners)
    kept = _positions(mesh)
    for _ in range(12):
        marked = rng.random(len(mesh.tets)) < min(0.5, 5 / len(mesh.tets))
        finer, fresh = refine(mesh, marked)
        assert fresh[np.flatnonzero(marked)].all()
        old = np.flatnonzero(~fresh)
        np.testing.assert_array_equal(finer.tets[old], mesh.tets[old])
        mesh = finer
        _check_conforming(mesh)
        assert _volume(mesh) == pytest.approx(blocks, abs=1e-12)
        nodes = _positions(mesh)
        np.testing.assert_allclose(nodes[: len(kept)], kept, atol=1e-14)
        kept = nodes
    assert len(mesh.tets) > 20


@pytest.mark.parametrize("name", ["kuhn 3", "coloured 3"])
def test_three_similarity_classes(name: str) -> None:
    mesh = STARTS[name]
    rng = np.random.default_rng(11)
    for _ in range(15):
        mesh, _ = refine(mesh, rng.random(len(mesh.tets)) < 4 / len(mesh.tets))
    ends = mesh.places[:, [i for i, _ in combinations(range(4), 2)]]
    others = mesh.places[:, [j for _, j in combinations(range(4), 2)]]
    lengths = np.sort(((ends - others) ** 2).sum(axis=2), axis=1)
    assert len(np.unique(lengths / lengths[:, :1], axis=0)) == 3


@pytest.mark.parametrize("name", STARTS)
def test_boundary_facets_cover_the_sides_once_and_look_outwards(name: str) -> None:
    mesh = STARTS[name]
    rng = np.random.default_rng(2)
    for _ in range(6):
        mesh, _ = refine(mesh, rng.random(len(mesh.tets)) < 0.1)
    d, facets, blocks = mesh.blocks.dim, mesh.facets, mesh.blocks
    edges = facets.s[:, 1:] - facets.s[:, :1]
    area = np.linalg.det(edges) / (2 if d == 3 else 1)
    assert area.min() > 0
    np.testing.assert_allclose(np.bincount(facets.side, area), 1.0, atol=1e-12)
    x = _positions(mesh)[facets.nodes]
    apex = _positions(mesh)[mesh.tets[facets.tet]].mean(axis=1)
    if d == 3:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    else:
        normal = np.column_stack([x[:, 1, 1] - x[:, 0, 1], x[:, 0, 0] - x[:, 1, 0]])
    assert (np.einsum("td,td->t", normal, x[:, 0] - apex) > 0).all()
    block, side = blocks.boundary_sides[facets.side].T
    origin = np.array([face.origin for face in blocks.cell.faces])[side]
    axes = np.array([face.axes for face in blocks.cell.faces])[side]
    for v in range(d):
        xi = origin + np.einsum("tds,ts->td", axes, facets.s[:, v])
        np.testing.assert_allclose(place(blocks, block, xi), x[:, v], atol=1e-12)


def test_new_nodes_are_placed_by_the_coarser_map() -> None:
    coarse = refine_all(STARTS["kuhn 3"], 3)
    fine, _ = refine(coarse, np.arange(len(coarse.tets)) % 5 == 0)
    linear = _positions(coarse) @ np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 3.0], [2.0, 0.0, 1.0]]) + 1.0
    np.testing.assert_allclose(
        place_new(fine, linear), _positions(fine) @ np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 3.0], [2.0, 0.0, 1.0]]) + 1.0,
        atol=1e-14,
    )


def test_bounds_are_kept() -> None:
    with pytest.raises(InputError, match="more than 60 elements"):
        refine(refine_all(kuhn(cube()), 3), np.ones(48, dtype=bool), most=60)


def test_several_blocks_need_the_coloured_start() -> None:
    with pytest.raises(InputError, match="coloured"):
        kuhn(pillowed(cube()))


def test_nodes_too_fine_are_refused() -> None:
    mesh = kuhn(cube(2))
    for _ in range(40):
        mesh, _ = refine(mesh, np.arange(len(mesh.tets)) == 0)
    with pytest.raises(InputError, match="finer than"):
        refine(mesh, np.arange(len(mesh.tets)) == 0)


def test_shared_corners_have_one_node() -> None:
    blocks = Blocks(RING.corners, RING.places)
    mesh = coloured(blocks)
    assert len(mesh.ends) == len(np.unique(_positions(mesh).round(9), axis=0))
