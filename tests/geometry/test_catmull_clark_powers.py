"""Evaluation by powers of local subdivision matrices against step-by-step subdivision and known limits."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from geometry.catmull_clark.evaluation import evaluate
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.powers import EIGEN, RINGS, SQUARED, power_of
from geometry.catmull_clark.shapes import ball, cross_of_tetrahedra, fan
from geometry.catmull_clark.topology import EDGES, Topology
from iga.cells import HEXAHEDRON

MESHES = {"ball": ball(), "fan 3": fan(3), "fan 5": fan(5), "fan 8": fan(8), "cross 5": cross_of_tetrahedra(5)}


@cache
def _topology(name: str, features: str) -> tuple[np.ndarray, Topology]:
    mesh = hex_mesh(*MESHES[name])
    return mesh.points, with_features(mesh.topology, mesh.points, features)


def _near(t: Topology, kind: str, distance: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points at a distance from extraordinary vertices or edges."""
    rng = np.random.default_rng(17)
    if kind == "vertex":
        cells, v = np.nonzero(~t.regular_vertices[t.hexes])
        corner = HEXAHEDRON.vertices[v]
        away = 1.0 - 2.0 * corner
        xi = corner + away * distance * np.maximum(rng.random(corner.shape), 0.1)
    else:
        cells, e = np.nonzero(~t.regular_edges[t.hex_edges])
        a, b = HEXAHEDRON.vertices[EDGES[e]].swapaxes(0, 1)
        away = (1.0 - 2.0 * a) * (a == b)
        along = (b - a) * (0.1 + 0.8 * rng.random((len(e), 1)))
        xi = a + along + away * distance * np.maximum(rng.random(a.shape), 0.1)
    some = rng.permutation(len(cells))[:count]
    return cells[some], xi[some]


@pytest.mark.parametrize(("name", "features"), [
    ("ball", "none"), ("ball", "auto"), ("fan 3", "none"), ("fan 5", "auto"), ("cross 5", "none"), ("cross 5", "auto"),
    pytest.param("fan 5", "none", marks=pytest.mark.long), pytest.param("fan 8", "none", marks=pytest.mark.long),
    pytest.param("fan 8", "auto", marks=pytest.mark.long),
])
def test_powers_equal_deep_rings(name: str, features: str) -> None:
    """Values to 1e-12; derivatives too, apart from the rounding of the rings, which doubles each level and order."""
    _, t = _topology(name, features)
    for kind in ("vertex", "edge"):
        for levels in (6, 14):
            cells, xi = _near(t, kind, 0.5**levels, 6)
            rings, powers = evaluate(t, cells, xi, steps=19), evaluate(t, cells, xi)
            assert (rings.way == RINGS).all()
            assert (powers.way > RINGS).any()
            np.testing.assert_array_equal(rings.level, powers.level)
            assert abs(rings.values - powers.values).max() < 1e-12
            for order, pairs in ((1, (rings.gradients, powers.gradients)), (2, (rings.second, powers.second))):
                scale = max(1.0, max(abs(part).max() for part in pairs[1]))
                allowed = 1e-12 * scale + 32.0 * np.finfo(float).eps * 2.0 ** (order * rings.level.max())
                assert max(abs(a - b).max() for a, b in zip(*pairs)) < allowed


def test_both_ways_are_taken() -> None:
    """Edges have eigenvectors, a vertex whose edges all have valence three has none (a Jordan block): squares."""
    t = _topology("ball", "none")[1]
    ways = evaluate(t, *_near(t, "edge", 1e-6, 20)).way
    assert (ways == EIGEN).any()
    assert (evaluate(t, *_near(t, "vertex", 1e-6, 20)).way == SQUARED).any()


@pytest.mark.parametrize("name", MESHES)
def test_no_distance_is_too_small(name: str) -> None:
    """At 2^-300 of an extraordinary vertex there is no rounding but that of the last steps."""
    t = _topology(name, "none")[1]
    # Only distances from the corner at the origin can be that small in floating point.
    cells = np.flatnonzero(~t.regular_vertices[t.hexes[:, 0]])[:12]
    assert len(cells)
    found = evaluate(t, cells, np.ldexp(np.full((len(cells), 3), 0.7), -300))
    assert (found.level > 299).all()
    assert abs(found.values - limit_matrix(t)[t.hexes[cells, 0]]).max() < 1e-13
    for part in found.gradients:
        assert np.isfinite(part.data).all()
        assert abs(part.sum(axis=1)).max() <= 1e-12 * max(1.0, abs(part).max())


@pytest.mark.parametrize(("m", "eigenvalue"), [(3, 0.4101), (5, 0.5500), (6, 0.5797)])
def test_gradients_at_edges_scale_with_the_subdominant_eigenvalue(m: int, eigenvalue: float) -> None:
    """Published in the notes on the paper: derivatives across the edge behave like (2 lambda)^m."""
    points, cells = fan(m)
    t = with_features(hex_mesh(points, cells).topology, points)
    corners = points[t.hexes]
    touching = np.abs(corners[:, :, :2]).sum(axis=2).min(axis=1) == 0
    inner = np.flatnonzero((corners[:, :, 2].min(axis=1) == 1) & touching)
    on = np.abs(corners[inner[0], :, :2]).sum(axis=1) == 0
    a, b = HEXAHEDRON.vertices[on]
    away = (1.0 - 2.0 * a) * (a == b)
    far, near = (a + 0.4 * (b - a) + away * np.array([0.7, 0.6, 0.5]) * 0.5**k for k in (20, 24))
    found = evaluate(t, inner[[0, 0]], np.array([far, near]))
    d = int(np.flatnonzero(a == b)[0])
    size = np.sqrt(found.gradients[d].power(2).sum(axis=1))
    assert abs((size[1] / size[0]) ** 0.25 / 2 - eigenvalue) < 1e-4


def test_on_the_edge_itself() -> None:
    """Values and derivatives along a straight extraordinary edge exist there; those across are not a number."""
    points, cells = fan(5)
    t = with_features(hex_mesh(points, cells).topology, points)
    corners = points[t.hexes]
    touching = np.abs(corners[:, :, :2]).sum(axis=2).min(axis=1) == 0
    inner = np.flatnonzero((corners[:, :, 2].min(axis=1) == 1) & touching)
    on = np.abs(corners[inner[0], :, :2]).sum(axis=1) == 0
    a, b = HEXAHEDRON.vertices[on]
    axis = int(np.flatnonzero(a != b)[0])
    away = (1.0 - 2.0 * a) * (a == b)
    place = a + 0.3 * (b - a)
    exact = evaluate(t, inner[[0]], place[None])
    close = evaluate(t, inner[[0]], (place + 1e-15 * away)[None])
    assert exact.level[0] == -1
    assert close.level[0] > 45
    assert abs(exact.values - close.values).max() < 1e-12
    assert abs(exact.gradients[axis] - close.gradients[axis]).max() < 1e-11
    assert abs(exact.second[axis] - close.second[axis]).max() < 1e-11
    assert np.isnan(exact.gradients[(axis + 1) % 3].data).all()


def test_powers_of_a_matrix() -> None:
    """With and without eigenvectors, less the part that constants give."""
    rng = np.random.default_rng(23)
    good = rng.random((6, 6))
    good /= good.sum(axis=1, keepdims=True)
    lower = np.tril(np.ones((4, 4)))
    block = lower / lower.sum(axis=1, keepdims=True) * 0.5
    block[:, 0] += 0.5
    jordan = np.array([[1.0, 0, 0], [0.5, 0.5, 0], [0.0, 0.5, 0.5]])
    for A, way in ((good, EIGEN), (jordan, SQUARED)):
        power = power_of(A)
        assert power.way == way
        rows = rng.standard_normal((10, 3, len(A)))
        made = power.times(rows, np.array([1, 4, 9]))
        for p, m in enumerate((1, 4, 9)):
            whole = rows[:, p] @ np.linalg.matrix_power(A, m)
            np.testing.assert_allclose(made[:, p] + rows[:, p].sum(axis=1)[:, None] * power.limit, whole, atol=1e-12)
