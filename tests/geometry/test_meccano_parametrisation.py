"""Volumetric parametrisations of solids with a closed-form boundary map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from geometry.layouts.blocks import Blocks, boundary_corners, cube, pillowed, place, polycube
from geometry.meccano.adaptation import adapt, boundary_nodes, facet_distances
from geometry.meccano.bisection import coloured, kuhn, oriented, picture, refine, refine_all
from geometry.meccano.parametrisation import Parametrisation, image, locate
from geometry.meccano.volume import parametrise
from geometry.simplices.relocation import ideal_gradients, quality
from iga.errors import InputError

Onto = Callable[[np.ndarray, np.ndarray], np.ndarray]
RING = polycube(np.array([(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)]))


def ball(x: np.ndarray) -> np.ndarray:
    return x


def bumpy(x: np.ndarray) -> np.ndarray:
    radius = 1.0 + 0.35 * np.sin(4 * x[:, :1]) * np.cos(5 * x[:, 1:2]) * np.cos(3 * x[:, -1:])
    return x * radius * np.array([1.0, 0.7, 1.6])[: x.shape[1]]


def radial(blocks: Blocks, shape: Callable[[np.ndarray], np.ndarray]) -> Onto:
    """The boundary of a cube (square) pushed onto a star-shaped one, angles almost uniform."""
    sides, cell = blocks.boundary_sides, blocks.cell
    origin = np.array([face.origin for face in cell.faces])
    axes = np.array([face.axes for face in cell.faces])
    centre = blocks.places[np.unique(boundary_corners(blocks))].mean(axis=0)

    def onto(side: np.ndarray, s: np.ndarray) -> np.ndarray:
        block, face = sides[side].T
        x = place(blocks, block, origin[face] + np.einsum("qds,qs->qd", axes[face], s))
        x = np.tan(0.5 * np.pi * (x - centre))
        return shape(x / np.linalg.norm(x, axis=1, keepdims=True))

    return onto


def _graded(blocks: Blocks, seed: int = 6) -> Parametrisation:
    mesh = coloured(blocks)
    rng = np.random.default_rng(seed)
    for _ in range(8):
        mesh, _ = refine(mesh, rng.random(len(mesh.tets)) < 0.15)
    tets, places = oriented(mesh)
    nodes = np.zeros((len(mesh.ends), blocks.dim))
    nodes[mesh.tets.ravel()] = picture(mesh).reshape(-1, blocks.dim)
    return Parametrisation(blocks, tets, mesh.block, places, nodes)


@pytest.mark.parametrize("blocks", [cube(2), cube(), RING, pillowed(cube()), pillowed(cube(2))])
def test_image_and_locate_are_inverse(blocks: Blocks) -> None:
    made = _graded(blocks)
    rng = np.random.default_rng(8)
    block = rng.integers(0, len(blocks.corners), 2000)
    xi = rng.random((2000, blocks.dim))
    xi[::5] = np.round(4 * xi[::5]) / 4  # on corners, edges and sides of cells
    x = image(made, block, xi)
    if len(blocks.corners) == 1 or blocks is RING:
        np.testing.assert_allclose(x, place(blocks, block, xi), atol=1e-14)
    found, there = locate(made, x)
    assert found.min() >= 0
    np.testing.assert_allclose(image(made, found, there), x, atol=1e-12)
    inside = np.arange(2000) % 5 > 0
    np.testing.assert_array_equal(found[inside], block[inside])
    np.testing.assert_allclose(there[inside], xi[inside], atol=1e-12)


def test_points_outside() -> None:
    made = _graded(RING)
    found, xi = locate(made, np.array([[1.5, 1.5, 0.5], [0.5, 0.5, 0.5], [0.5, 0.5, 1.01]]))
    np.testing.assert_array_equal(found, [-1, 0, -1])
    np.testing.assert_array_equal(np.isnan(xi).any(axis=1), [True, False, True])
    with pytest.raises(InputError, match="not in block 2"):
        image(made, np.array([1, 2]), np.array([[0.5, 0.5, 0.5], [0.5, 1.5, 0.5]]))


def test_distances_fall_as_fast_as_they_should() -> None:
    blocks = cube()
    onto = radial(blocks, ball)
    found = []
    for times in (6, 9, 12):
        mesh = refine_all(kuhn(blocks), times)
        nodes = np.zeros((len(mesh.ends), 3))
        number, where = boundary_nodes(mesh, onto)
        nodes[number] = where
        rows = np.arange(len(mesh.facets.tet))
        found.append([facet_distances(mesh, onto, nodes, rows, m).max() for m in ("volume", "distance")])  # type: ignore[arg-type]
    rates = np.log2(np.array(found[:-1]) / np.array(found[1:]))
    np.testing.assert_allclose(rates[-1], [4.0, 2.0], atol=0.15)
    assert found[-1][1] < 5e-3


@pytest.mark.parametrize("measure", ["volume", "distance"])
def test_adapting_reaches_the_tolerance(measure: str) -> None:
    blocks = pillowed(cube())
    onto = radial(blocks, bumpy)
    tolerance = {"volume": 1e-4, "distance": 2e-2}[measure]
    mesh, distance = adapt(refine_all(coloured(blocks), 3), onto, tolerance, measure)  # type: ignore[arg-type]
    assert tolerance / 3 < distance <= tolerance
    nodes = np.zeros((len(mesh.ends), 3))
    number, where = boundary_nodes(mesh, onto)
    nodes[number] = where
    again = facet_distances(mesh, onto, nodes, np.arange(len(mesh.facets.tet)), measure)  # type: ignore[arg-type]
    assert again.max() == pytest.approx(distance, rel=1e-12)
    areas = np.linalg.det(mesh.facets.s[:, 1:] - mesh.facets.s[:, :1])
    assert areas.max() >= 4 * areas.min()  # it is local


def test_too_small_tolerance_is_refused() -> None:
    with pytest.raises(InputError, match="more than 5000 elements; ask for a larger tolerance"):
        parametrise(cube(), radial(cube(), ball), 1e-9, most=5000)


@pytest.mark.parametrize(("name", "start"), [("cube", "kuhn"), ("pillowed", "coloured")])
def test_bumpy_solid(name: str, start: str) -> None:
    blocks = cube() if name == "cube" else pillowed(cube())
    onto = radial(blocks, bumpy)
    made, stages = parametrise(blocks, onto, 2e-5, start=start)  # type: ignore[arg-type]
    assert stages[-1].after == 0
    assert stages[0].before > 0  # there was something to untangle
    assert stages[-1].least > {"cube": 0.2, "pillowed": 0.08}[name]
    edges = made.nodes[made.tets[:, 1:]] - made.nodes[made.tets[:, :1]]
    det = np.linalg.det(edges)
    assert det.min() > 0
    rng = np.random.default_rng(9)
    block = rng.integers(0, len(blocks.corners), 3000)
    xi = rng.random((3000, 3))
    found, there = locate(made, image(made, block, xi))
    np.testing.assert_array_equal(found, block)
    np.testing.assert_allclose(there, xi, atol=1e-9)
    u, w = np.linspace(0, np.pi, 401), np.linspace(0, 2 * np.pi, 801)  # volume by the trapezoidal rule on the sphere
    u, w = (0.5 * (u[1:] + u[:-1]))[:, None], (0.5 * (w[1:] + w[:-1]))[None]
    x = np.stack([np.sin(u) * np.cos(w), np.sin(u) * np.sin(w), np.cos(u) + 0 * w], axis=-1).reshape(-1, 3)
    radius = 1.0 + 0.35 * np.sin(4 * x[:, 0]) * np.cos(5 * x[:, 1]) * np.cos(3 * x[:, 2])
    exact = 1.12 * (radius**3 / 3 * np.sin(u + 0 * w).ravel()).sum() * (np.pi / 400) * (2 * np.pi / 800)
    assert det.sum() / 6 == pytest.approx(exact, rel=0.01)


def test_flower_in_the_plane() -> None:
    blocks = pillowed(cube(2))
    made, stages = parametrise(blocks, radial(blocks, bumpy), 1e-4, levels=2)
    assert stages[-1].after == 0
    mesh_quality = quality(made.tets, ideal_gradients(made.nodes[made.tets]), made.nodes)
    assert mesh_quality.least == pytest.approx(1.0)
    edges = made.nodes[made.tets[:, 1:]] - made.nodes[made.tets[:, :1]]
    angle = np.linspace(0, 2 * np.pi, 4001)
    curve = bumpy(np.column_stack([np.cos(angle), np.sin(angle)]))
    area = 0.5 * (curve[:-1, 0] * curve[1:, 1] - curve[1:, 0] * curve[:-1, 1]).sum()
    assert np.linalg.det(edges).sum() / 2 == pytest.approx(area, rel=5e-3)
