"""Subdivision rules, limit masks and interpolation against independent statements of them."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.catmull_clark import interpolation
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan, tetrahedron
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import Topology
from iga.errors import InputError

MESHES = {
    "box": box(3, 3, 4), "ball": ball(), "fan 3": fan(3), "fan 5": fan(5), "fan 6": fan(6),
    "tetrahedron": tetrahedron(), "cross 4": cross_of_tetrahedra(4), "cross 5": cross_of_tetrahedra(5),
}


def _topology(name: str, features: str = "none") -> tuple[np.ndarray, Topology]:
    points, cells = MESHES[name]
    mesh = hex_mesh(points, cells)
    return mesh.points, with_features(mesh.topology, mesh.points, features)


def test_regular_interior_weights() -> None:
    points, cells = box(2, 2, 2)
    t = hex_mesh(points, cells).topology
    row = subdivide(t)[1][[13]].toarray()[0]
    distance = np.abs(points - 1.0).sum(axis=1).astype(int)
    np.testing.assert_allclose(row, np.array([27 / 64, 9 / 128, 3 / 256, 1 / 512])[distance], atol=1e-16)


@pytest.mark.parametrize("name", MESHES)
def test_rules_as_printed(name: str) -> None:
    """Eqs. (1) to (3) entity by entity, with the edge average weighted by valence; Catmull-Clark on the boundary."""
    _, t = _topology(name)
    x = np.random.default_rng(11).standard_normal((t.vertices, 3))
    new = subdivide(t)[1] @ x
    v, m, f = t.vertices, len(t.edges), len(t.faces)
    centre, face, middle = x[t.hexes].mean(axis=1), x[t.faces].mean(axis=1), x[t.edges].mean(axis=1)
    np.testing.assert_allclose(new[v + m + f :], centre, atol=1e-14)
    for k in range(f):
        cells = np.flatnonzero((t.hex_faces == k).any(axis=1))
        expected = (centre[cells].sum(axis=0) + 2 * face[k]) / 4 if len(cells) == 2 else face[k]
        np.testing.assert_allclose(new[v + m + k], expected, atol=1e-14)
    outer = t.face_cells == 1
    for k in range(m):
        cells, faces = np.flatnonzero((t.hex_edges == k).any(axis=1)), np.flatnonzero((t.face_edges == k).any(axis=1))
        if outer[faces].any():
            expected = (middle[k] + face[faces[outer[faces]]].mean(axis=0)) / 2
        else:
            expected = (centre[cells].mean(axis=0) + 2 * face[faces].mean(axis=0) + middle[k]) / 4
        np.testing.assert_allclose(new[v + k], expected, atol=1e-14)
    for k in range(v):
        cells, faces = np.flatnonzero((t.hexes == k).any(axis=1)), np.flatnonzero((t.faces == k).any(axis=1))
        edges = np.flatnonzero((t.edges == k).any(axis=1))
        if outer[faces].any():
            faces = faces[outer[faces]]
            N = len(faces)
            edges = edges[np.isin(edges, t.face_edges[faces])]
            expected = (face[faces].mean(axis=0) + 2 * middle[edges].mean(axis=0) + (N - 3) * x[k]) / N
        else:
            E = np.average(middle[edges], axis=0, weights=t.edge_cells[edges])
            expected = (centre[cells].mean(axis=0) + 3 * face[faces].mean(axis=0) + 3 * E + x[k]) / 8
        np.testing.assert_allclose(new[k], expected, atol=1e-14)


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", MESHES)
def test_limit_masks_hold_at_every_level(name: str, features: str) -> None:
    _, t = _topology(name, features)
    x = np.random.default_rng(5).standard_normal((t.vertices, 2))
    limit = limit_matrix(t) @ x
    for _ in range(2):
        fine, S = subdivide(t)
        np.testing.assert_allclose(np.asarray(S.sum(axis=1)).ravel(), 1.0, atol=1e-14)
        x = S @ x
        np.testing.assert_allclose((limit_matrix(fine) @ x)[: len(limit)], limit, atol=3e-15)
        t = fine


@pytest.mark.parametrize("name", ["ball", "fan 5", "cross 5"])
def test_limit_masks_are_limits(name: str) -> None:
    """The star of a vertex, subdivided forty times by its own local matrix, shrinks to the masked point."""
    _, t = _topology(name, "none")
    limit = limit_matrix(t)
    fine, S = subdivide(t)
    for k in range(t.vertices):
        star = np.unique(t.hexes[(t.hexes == k).any(axis=1)])
        # The star's vertices map to the points of the refined star: match them by walking from the vertex.
        near = np.unique(fine.hexes[(fine.hexes == k).any(axis=1)])
        A = S[near][:, star].toarray()
        assert abs(A.sum(axis=1) - 1).max() < 1e-14
        # entity of each refined point -> the vertex of the coarse star that lies across it from k
        v, m, f = t.vertices, len(t.edges), len(t.faces)
        across = np.empty(len(near), dtype=int)
        for i, p in enumerate(near):
            if p == k:
                across[i] = k
            elif p < v + m:
                across[i] = t.edges[p - v].sum() - k
            elif p < v + m + f:
                quad = t.faces[p - v - m]
                across[i] = quad[3 - np.flatnonzero(quad == k)[0]]
            else:
                cell = t.hexes[p - v - m - f]
                across[i] = cell[7 - np.flatnonzero(cell == k)[0]]
        order = np.searchsorted(star, across)
        local = np.zeros((len(star), len(star)))
        local[order] = A
        power = np.linalg.matrix_power(local, 60)
        np.testing.assert_allclose(power[np.searchsorted(star, k)], limit[[k]].toarray()[0][star], atol=1e-13)


def test_extrusion_gives_a_product() -> None:
    """A prism's weights are those of its cross-section times 1/8, 6/8, 1/8."""
    points, t = _topology("fan 5")
    centre = int(np.flatnonzero(np.abs(points - [0, 0, 1]).max(axis=1) < 1e-9)[0])
    row = subdivide(t)[1][[centre]].toarray()[0]
    layers = np.array([row[np.abs(points[:, 2] - z) < 1e-9] for z in range(3)])
    np.testing.assert_allclose(layers.sum(axis=1), [1 / 8, 6 / 8, 1 / 8], atol=1e-15)
    np.testing.assert_allclose(layers / layers.sum(axis=1, keepdims=True), layers[[0, 0, 0]] * 8, atol=1e-15)


def test_subdivided_kinds_are_those_of_the_boundary() -> None:
    points, t = _topology("box", "auto")
    fine, S = subdivide(t)
    again = with_features(hex_mesh(S @ points, fine.hexes).topology, S @ points, "auto")
    for name in ("vertex_kind", "edge_kind", "face_kind"):
        np.testing.assert_array_equal(getattr(fine, name), getattr(again, name))


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", ["box", "fan 5", "cross 5"])
def test_all_methods_interpolate(name: str, features: str) -> None:
    points, t = _topology(name, features)
    given = points + 0.05 * np.random.default_rng(3).standard_normal(points.shape)
    made = {
        "direct": interpolation.direct(t, given), "pia": interpolation.pia(t, given),
        "fast": interpolation.pia(t, given, 1.7), "conjugate": interpolation.conjugate(t, given),
        "pushed": interpolation.push_back(t, given), "varied": interpolation.push_back(t, given, 0.5, 0.3, 0.01),
    }
    for result in made.values():
        assert result.error < 2e-14
        limit = limit_matrix(result.topology) @ result.values
        np.testing.assert_allclose(limit[: len(given)], given, atol=1e-12)
    for name in ("pia", "fast", "conjugate"):
        np.testing.assert_allclose(made[name].values, made["direct"].values, atol=1e-11)
    assert 0.5 < made["pia"].factor < 0.99
    assert len(made["fast"].history["interior"]) < len(made["pia"].history["interior"])


def test_all_valence_three_boundary_is_told() -> None:
    points, t = _topology("ball")
    assert interpolation.singular_pieces(t).tolist() == list(range(8, 16))
    assert interpolation.pia(t, points).error < 1e-13  # symmetric data converge
    assert interpolation.direct(t, points).error < 1e-13
    moved = points.copy()
    moved[8] += 0.1
    stuck = interpolation.pia(t, moved)
    limit = limit_matrix(t) @ stuck.values
    np.testing.assert_allclose(np.abs(limit - moved)[8:].max(), 0.1 / 8, rtol=1e-3)
    with pytest.raises(InputError, match="three boundary faces"):
        interpolation.direct(t, moved)
    assert interpolation.push_back(t, moved).error < 1e-14
    assert not len(interpolation.singular_pieces(_topology("ball", "auto")[1]))


def test_parameters_are_checked() -> None:
    points, t = _topology("ball")
    with pytest.raises(InputError, match="lambda must lie between 0 and 1"):
        interpolation.push_back(t, points, lam=1.0)
    with pytest.raises(InputError, match="gamma of cell 2"):
        interpolation.push_back(t, points, gamma=np.array([0.1, 0.1, -1, 0.1, 0.1, 0.1, 0.1]))
    with pytest.raises(InputError, match="for each face"):
        interpolation.push_back(t, points, mu=np.full(3, 0.5))
    with pytest.raises(InputError, match="relaxation"):
        interpolation.pia(t, points, 2.0)


def test_published_iteration_counts() -> None:
    """7-block ball with symmetric data: 39 boundary and 55 interior steps to 1e-12."""
    points, t = _topology("ball")
    history = interpolation.pia(t, points, tolerance=1e-12 / interpolation.diagonal(points)).history
    assert abs(len(history["boundary"]) - 39) <= 2
    assert abs(len(history["interior"]) - 55) <= 2
