"""The analysis space: exact evaluation, pieces, continuity, domains."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from geometry.catmull_clark.domain import CUBIC, LINES, build_domain
from geometry.catmull_clark.evaluation import evaluate
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.neighbourhood import ROTATIONS, classify
from geometry.catmull_clark.pieces import pieces_of
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import FACES, Topology
from iga.assembly import integral, matrix, volume
from iga.block import Kronecker
from iga.cells import HEXAHEDRON
from iga.chunk import chunks, facet_chunks
from iga.domain import all_facets, check
from iga.errors import InputError
from iga.integrands import Diffusion

MESHES = {"box": box(3, 2, 4), "ball": ball(), "fan 3": fan(3), "fan 5": fan(5), "cross 5": cross_of_tetrahedra(5)}


def _topology(name: str, features: str = "none") -> tuple[np.ndarray, Topology]:
    mesh = hex_mesh(*MESHES[name])
    return mesh.points, with_features(mesh.topology, mesh.points, features)


def _random(topology: Topology, count: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, len(topology.hexes), count), rng.random((count, 3))


def test_univariate_extraction_is_the_natural_spline() -> None:
    x = np.linspace(0, 1, 9)
    B = CUBIC.tabulate(np.column_stack([x, 0 * x, 0 * x]), 0)[0].reshape(9, 4, 4, 4)[:, :, 0, 0]
    inside = np.stack([BSpline.basis_element(np.arange(-3 + i, 2 + i))(x) for i in range(4)], axis=1)
    inside[-1, 0] = 0.0  # the right end of a support counts to the next interval
    np.testing.assert_allclose(B @ LINES[False, False].T, inside, atol=1e-15)
    natural = inside[:, 1:] + inside[:, :1] * np.array([2.0, -1.0, 0.0])
    np.testing.assert_allclose(B @ LINES[True, False].T, natural, atol=1e-15)


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", MESHES)
def test_functions_sum_to_one_and_derivatives_fit(name: str, features: str) -> None:
    _, t = _topology(name, features)
    cells, xi = _random(t, 60)
    xi = 0.02 + 0.96 * xi
    found = evaluate(t, cells, xi)
    assert (found.level >= 0).all()
    assert found.values.data.min() >= -1e-15
    np.testing.assert_allclose(found.values.sum(axis=1), 1.0, atol=1e-14)
    for part in found.gradients:
        np.testing.assert_allclose(part.sum(axis=1), 0.0, atol=1e-12)
    for part in found.second:
        np.testing.assert_allclose(part.sum(axis=1), 0.0, atol=1e-11)
    u = np.random.default_rng(9).standard_normal(t.vertices)
    h = 1e-5
    for d in range(3):
        step = h * np.eye(3)[d]
        ahead, behind = evaluate(t, cells, xi + step), evaluate(t, cells, xi - step)
        np.testing.assert_allclose((ahead.values - behind.values) @ u / (2 * h), found.gradients[d] @ u, atol=1e-6)
        same = (ahead.level == found.level) & (behind.level == found.level)
        slope = ((ahead.gradients[d] - behind.gradients[d]) @ u / (2 * h))[same]
        np.testing.assert_allclose(slope, (found.second[d] @ u)[same], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("name", MESHES)
def test_special_points_are_limit_masks(name: str) -> None:
    """Corners give the masks of vertices, cell centres the mask of the new cell point."""
    _, t = _topology(name)
    cells = np.arange(len(t.hexes))
    fine, S = subdivide(t)
    centres = (limit_matrix(fine) @ S)[-len(cells):]
    found = evaluate(t, cells, np.full((len(cells), 3), 0.5)).values
    assert abs(found - centres).max() < 1e-14
    limit = limit_matrix(t)
    for v, corner in enumerate(HEXAHEDRON.vertices):
        found = evaluate(t, cells, np.tile(corner, (len(cells), 1))).values
        assert abs(found - limit[t.hexes[:, v]]).max() < 1e-13


def test_subdivision_keeps_the_limit() -> None:
    """Functions of a level are those of the next one combined by the subdivision matrix."""
    _, t = _topology("cross 5")
    fine, S = subdivide(t)
    cells, xi = _random(t, 40)
    step = (xi >= 0.5).astype(int)
    children = 8 * cells + step @ np.array([4, 2, 1])
    coarse, finer = evaluate(t, cells, xi), evaluate(fine, children, 2 * xi - step)
    assert abs(coarse.values - finer.values @ S).max() < 1e-14
    assert abs(coarse.gradients[0] - 2 * finer.gradients[0] @ S).max() < 1e-12


def test_edge_type_cells_are_products() -> None:
    """Next to a straight extraordinary edge the functions are (plane) x (cubic B-splines along the edge)."""
    points, t = _topology("fan 5")
    corners = points[t.hexes]
    middle = np.flatnonzero((corners[:, :, 2].min(axis=1) == 1) & (np.abs(corners).min(axis=(1, 2)) == 0))
    xi = np.tile([[0.3, 0.2, 0.4]], (len(middle), 1))
    row = evaluate(t, middle[:1], xi[:1]).values.toarray()[0]
    layers = np.array([row[points[:, 2] == z] for z in range(4)])
    assert np.linalg.svd(layers, compute_uv=False)[1] < 1e-15
    line = np.array([BSpline.basis_element(np.arange(-3 + i, 2 + i))(0.4) for i in range(4)])
    assert min(np.abs(layers.sum(axis=1) - line).max(), np.abs(layers.sum(axis=1) - line[::-1]).max()) < 1e-15


class _Field:
    """A field on the pieces of a mesh, at points of cells (tests only: slow and simple)."""

    def __init__(self, t: Topology, depth: int) -> None:
        self.classes, self.dofs = classify(t)
        self.pieces = pieces_of(t, self.classes.representative, depth)
        self.members = [np.flatnonzero(self.classes.label == k) for k in range(len(self.dofs))]

    def row(self, cell: int, xi: np.ndarray, vertices: int) -> tuple[np.ndarray, bool]:
        """Coefficients of the value at a point, and whether it lies on a closure."""
        k = self.classes.label[cell]
        corners = HEXAHEDRON.vertices[ROTATIONS[self.classes.rotation[cell]]]
        A = (corners[[4, 2, 1]] - corners[0]).T
        eta = A.T @ (xi - corners[0])
        mine = np.flatnonzero(self.pieces.owner == k)
        inside = (self.pieces.low[mine] <= eta).all(axis=1) & (eta <= self.pieces.high[mine]).all(axis=1)
        p = mine[np.flatnonzero(inside)[0]]
        low, high = self.pieces.low[p], self.pieces.high[p]
        values = self.pieces.C[p] @ CUBIC.tabulate(((eta - low) / (high - low))[None], 0)[0][0]
        row = np.zeros(vertices)
        np.add.at(row, self.dofs[k][np.flatnonzero(self.members[k] == cell)[0]], values)
        return row, bool(self.pieces.closed[p])


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", MESHES)
def test_pieces_are_the_limit_outside_the_closures(name: str, features: str) -> None:
    _, t = _topology(name, features)
    field = _Field(t, 2)
    cells, xi = _random(t, 80, seed=3)
    exact = evaluate(t, cells, xi).values.toarray()
    seen = 0
    for p in range(len(cells)):
        row, closed = field.row(int(cells[p]), xi[p], t.vertices)
        assert abs(row.sum() - 1) < 1e-13
        if not closed:
            np.testing.assert_allclose(row, exact[p], atol=1e-13)
            seen += 1
    assert seen > 40


@pytest.mark.parametrize("depth", [0, 1, 2])
@pytest.mark.parametrize("name", ["ball", "fan 3", "cross 5"])
def test_pieces_are_continuous_across_faces(name: str, depth: int) -> None:
    _, t = _topology(name)
    field = _Field(t, depth)
    rng = np.random.default_rng(21)
    inner = np.flatnonzero(t.face_cells == 2)
    for face in rng.choice(inner, min(len(inner), 12), replace=False):
        rows = [field.row(cell, xi, t.vertices)[0] for cell, xi in _on_both_sides(t, face, rng.random(2))]
        np.testing.assert_allclose(rows[0], rows[1], atol=1e-13)


def _on_both_sides(t: Topology, face: int, s: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """One point of an interior face as seen from its two cells."""
    # bilinear weights of the face's vertices, in the order of the mesh's face, make the same point on both
    weight = dict(zip(t.faces[face].tolist(), np.outer([1 - s[0], s[0]], [1 - s[1], s[1]]).ravel()))
    found = []
    for cell, side in zip(*np.nonzero(t.hex_faces == face)):
        quad = t.hexes[cell][FACES[side]]
        xi = sum(weight[v] * HEXAHEDRON.vertices[c] for v, c in zip(quad.tolist(), FACES[side]))
        found.append((int(cell), np.asarray(xi)))
    return found


@pytest.mark.parametrize("features", ["none", "auto"])
@pytest.mark.parametrize("name", ["box", "fan 3", "fan 5", "cross 5"])
def test_the_limit_is_continuous_across_faces(name: str, features: str) -> None:
    """Every function has the same value at a point of an interior face, whichever cell it is evaluated in."""
    _, t = _topology(name, features)
    rng = np.random.default_rng(22)
    inner = np.flatnonzero(t.face_cells == 2)
    pairs = [_on_both_sides(t, f, 0.02 + 0.96 * rng.random(2)) for f in rng.choice(inner, min(len(inner), 30), False)]
    values = []
    for side in (0, 1):
        cells, xi = (np.array(part) for part in zip(*[pair[side] for pair in pairs]))
        values.append(evaluate(t, cells, xi).values.toarray())
    np.testing.assert_allclose(values[0], values[1], atol=1e-12)


def test_rings_are_not_cut_along_a_straight_edge() -> None:
    points, t = _topology("fan 5")
    classes, _ = classify(t)
    pieces = pieces_of(t, classes.representative, 2)
    inner = (points[t.hexes[classes.representative]][:, :, 2].min(axis=1) == 1) & (
        np.abs(points[t.hexes[classes.representative]]).sum(axis=2).min(axis=1) <= 2
    )
    touching = inner & (np.abs(points[t.hexes[classes.representative]][:, :, :2]).sum(axis=2).min(axis=1) == 0)
    counts = np.bincount(pieces.owner)[touching]
    assert (counts == 7).all()  # three quarters on each of two levels and the closure


def test_classes_do_not_depend_on_numbering() -> None:
    points, cells = box(5, 5, 5)
    rng = np.random.default_rng(13)
    shuffled = np.take_along_axis(cells, ROTATIONS[rng.integers(0, 24, len(cells))], axis=1)
    t = with_features(hex_mesh(points, shuffled).topology, points)
    assert len(classify(t)[0].size) == 4  # inside, face, edge, corner


@pytest.mark.parametrize("features", ["none", "auto"])
def test_box_is_the_tensor_product_spline(features: str) -> None:
    points, cells = box(5, 4, 4)
    t = with_features(hex_mesh(points, cells).topology, points, features)
    domain = build_domain(t, points, 1)
    check(domain)
    assert any(isinstance(block.extraction, Kronecker) for block in domain.space.blocks)
    if features == "auto":
        assert all(isinstance(block.extraction, Kronecker) for block in domain.space.blocks)
        assert sorted(domain.boundaries) == [f"face_{k}" for k in range(1, 7)]
        assert abs(volume(domain) - 80.0) < 1e-11
        for chunk in chunks(domain):
            np.testing.assert_allclose(chunk.det, 1.0, atol=1e-13)  # natural splines reproduce the identity


def _natural(n: int) -> tuple[BSpline, np.ndarray]:
    """Uniform cubic B-splines on [0, n] and the matrix that folds the two outer ones in (P_-1 = 2 P_0 - P_1)."""
    fold = np.eye(n + 3)[:, 1:-1]
    fold[0, :2] = fold[-1, -1:-3:-1] = 2.0, -1.0
    return BSpline(np.arange(-3.0, n + 4.0), np.eye(n + 3), 3), fold


def test_regular_meshes_have_the_spline_space() -> None:
    """Values, gradients and stiffness matrix are those of tricubic B-splines with natural ends, to 1e-13."""
    n = (4, 3, 5)
    points, cells = box(*n)
    t = with_features(hex_mesh(points, cells).topology, points)
    cells_at, xi = _random(t, 50)
    found = evaluate(t, cells_at, xi)
    x = points[t.hexes[cells_at, 0]] + xi
    splines = [_natural(k) for k in n]
    for d, part in ((None, found.values), *enumerate(found.gradients)):
        lines = [B(x[:, a], nu=int(a == d)) @ fold for a, (B, fold) in enumerate(splines)]
        expected = np.einsum("pi,pj,pk->pijk", *lines).reshape(len(x), -1)
        np.testing.assert_allclose(part.toarray(), expected, atol=1e-13)
    mass, stiff = [], []
    at, weight = np.polynomial.legendre.leggauss(4)
    for k, (B, fold) in zip(n, splines):
        s = (np.arange(k)[:, None] + 0.5 + at / 2).ravel()
        w = np.tile(weight / 2, k)
        values, slopes = B(s) @ fold, B(s, nu=1) @ fold
        mass.append(values.T @ (w[:, None] * values))
        stiff.append(slopes.T @ (w[:, None] * slopes))
    whole = sum(
        np.kron(np.kron(*[(stiff if a == d else mass)[a] for a in (0, 1)]), (stiff if d == 2 else mass)[2])
        for d in range(3)
    )
    K = matrix(build_domain(t, points, 1), Diffusion(1.0)).toarray()
    np.testing.assert_allclose(K, whole, atol=1e-13)


@pytest.mark.parametrize("depth", [0, 1])
@pytest.mark.parametrize("name", ["ball", "fan 5", "cross 5"])
def test_domains_pass_the_patch_test_and_the_divergence_theorem(name: str, depth: int) -> None:
    points, t = _topology(name)
    domain = build_domain(t, points, depth, {"heat": points @ [1.0, 2.0, -1.0]})
    check(domain)
    u = domain.attributes["heat"]
    K = matrix(domain, Diffusion(1.0), points=5)
    inside = t.vertex_kind == 3
    np.testing.assert_allclose((K @ u)[inside], 0.0, atol=1e-11)
    np.testing.assert_allclose(K @ np.ones(len(u)), 0.0, atol=1e-12)
    outward = sum(
        float((chunk.dx * np.einsum("eqc,eqc->eq", chunk.x, chunk.normal)).sum()) / 3
        for chunk in facet_chunks(domain, all_facets(domain), points=6)
    )
    inner = float(integral(domain, 1.0, points=6))
    assert abs(outward / inner - 1) < 1e-10


def test_published_volume_of_the_ball() -> None:
    points, t = _topology("ball")
    volumes = [volume(build_domain(t, points, depth), 5) for depth in (0, 1, 2)]
    assert abs(volumes[2] - 2.6204) < 2e-3
    assert abs(volumes[2] - volumes[1]) < 0.5 * abs(volumes[1] - volumes[0])


def test_points_outside_are_refused() -> None:
    _, t = _topology("ball")
    with pytest.raises(InputError, match="point 1"):
        evaluate(t, np.array([0, 0]), np.array([[0.5, 0.5, 0.5], [0.5, 1.5, 0.5]]))
