"""Meccanos: gluing, polycubes and pillows."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.layouts.blocks import Blocks, boundary_corners, cube, pillowed, place, polycube
from iga.bernstein import bernstein
from iga.block import Block
from iga.certificate import certify
from iga.domain import Domain, Space
from iga.errors import InputError

SHAPES = {
    "cube": [(0, 0, 0)],
    "bar": [(0, 0, 0), (1, 0, 0), (2, 0, 0)],
    "L": [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
    "U": [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (2, 1, 0)],
    "ring": [(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)],
    "step": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1)],
    "corner": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "plate": [(x, y, 0) for x in range(3) for y in range(3)] + [(1, 1, 1)],
    "bend": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)],  # boundary sides at a corner look at each other
    "notch": [(x, y, z) for x in range(2) for y in range(2) for z in range(2) if x + y + z < 3],
}
FLAT = {"square": [(0, 0)], "L": [(0, 0), (1, 0), (0, 1)], "ring": [v[:2] for v in SHAPES["ring"]]}


def _solid(blocks: Blocks) -> Domain:
    return Domain(Space((Block(bernstein(blocks.cell, 1), blocks.corners),), len(blocks.places)), blocks.places)


def _corner_quality(blocks: Blocks) -> float:
    """Smallest scaled Jacobian at corners of blocks."""
    gradients = bernstein(blocks.cell, 1).tabulate(blocks.cell.vertices, 1)[1]
    jacobians = np.einsum("qvd,kvc->kqcd", gradients, blocks.places[blocks.corners])
    return float((np.linalg.det(jacobians) / np.linalg.norm(jacobians, axis=2).prod(axis=2)).min())


def _side_points(blocks: Blocks, sides: np.ndarray, s: np.ndarray) -> np.ndarray:
    block, side = blocks.boundary_sides[sides].T
    origin = np.array([face.origin for face in blocks.cell.faces])[side]
    axes = np.array([face.axes for face in blocks.cell.faces])[side]
    return place(blocks, block, origin + np.einsum("qds,qs->qd", axes, s))


@pytest.mark.parametrize("name", SHAPES)
def test_pillowed_polycubes_are_valid(name: str) -> None:
    blocks = polycube(np.array(SHAPES[name]))
    made = pillowed(blocks)
    assert certify(_solid(blocks)).verdict.min() == 1
    assert certify(_solid(made)).verdict.min() == 1
    assert _corner_quality(made) > 0.45
    outer = np.array([(made.across[k, :, 0] < 0).sum() for k in range(len(made.corners))])
    assert outer.max() == 1
    assert len(made.corners) == len(blocks.corners) + len(blocks.boundary_sides)


@pytest.mark.parametrize("name", [*SHAPES, *(f"flat {n}" for n in FLAT)])
def test_boundary_sides_keep_order_and_coordinates(name: str) -> None:
    blocks = polycube(np.array(FLAT[name[5:]] if name.startswith("flat") else SHAPES[name]))
    made = pillowed(blocks)
    rng = np.random.default_rng(3)
    sides = rng.integers(0, len(blocks.boundary_sides), 50)
    s = rng.random((50, blocks.dim - 1))
    np.testing.assert_array_equal(boundary_corners(made), boundary_corners(blocks))
    back = Blocks(made.corners, np.concatenate([blocks.places, made.places[len(blocks.places) :]]))
    np.testing.assert_allclose(_side_points(back, sides, s), _side_points(blocks, sides, s), atol=1e-14)


@pytest.mark.parametrize("name", FLAT)
def test_pillowed_squares_are_valid(name: str) -> None:
    made = pillowed(polycube(np.array(FLAT[name])))
    assert _corner_quality(made) > 0.4  # bilinear: the smallest determinant is at a corner


def test_pillowed_cube_is_the_seven_block_ball() -> None:
    made = pillowed(cube())
    assert made.corners.shape == (7, 8)
    np.testing.assert_allclose(made.places[made.corners[0]], 0.3 + 0.4 * cube().places, atol=1e-15)


def test_across_is_an_involution() -> None:
    made = pillowed(polycube(np.array(SHAPES["ring"])))
    k, f = np.nonzero(made.across[..., 0] >= 0)
    there = made.across[k, f]
    np.testing.assert_array_equal(made.across[there[:, 0], there[:, 1]], np.column_stack([k, f]))


@pytest.mark.parametrize(
    ("voxels", "words"),
    [
        ([(0, 0, 0), (1, 1, 0)], "share no side"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 1), (1, 1, 1), (2, 0, 0), (2, 1, 0), (2, 1, 1)], "along the edge"),
        ([(0, 0, 0), (0, 0, 0)], "twice"),
        ([], "k > 0"),
    ],
)
def test_bad_voxels_are_refused(voxels: list[tuple[int, ...]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        polycube(np.array(voxels))


def test_blocks_that_touch_at_a_vertex_are_refused() -> None:
    full = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
    inside = [v for v in full if v not in [(1, 1, 1), (0, 0, 0)]]  # two cavities' corners meet at (1, 1, 1)
    with pytest.raises(InputError, match="vertex"):
        polycube(np.array(inside))
    square = [(x, y) for x in range(3) for y in range(3) if (x, y) not in [(1, 1), (0, 0)]]
    with pytest.raises(InputError, match="vertex"):
        polycube(np.array(square))


@pytest.mark.parametrize("share", [0.0, 0.5, float("nan")])
def test_bad_share_is_refused(share: float) -> None:
    with pytest.raises(InputError, match="share"):
        pillowed(cube(), share)
