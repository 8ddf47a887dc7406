"""Sets of voxels with a solid's topology: what shape they are, how much of each is inside, layers that become one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.layouts.blocks import polycube
from geometry.layouts.frame import frame_of
from geometry.layouts.isotopy import deforms
from geometry.layouts.merging import MOST, merged
from geometry.layouts.orientation import orientation
from geometry.layouts.topology import topology
from geometry.layouts.voxels import Voxels, place, shares
from geometry.simplices.surface import Surface, volume
from iga.errors import InputError
from tests.surfaces import body, box, torus


def ring(holes: int) -> np.ndarray:
    """A bar of voxels with holes through it."""
    inside = np.ones((2 * holes + 1, 3, 1), dtype=bool)
    inside[1::2, 1] = False
    return inside


@pytest.mark.parametrize("holes", [0, 1, 2, 5])
def test_topology_counts_holes(holes: int) -> None:
    found = topology(ring(holes))
    assert (found.pinched, found.parts, found.outsides, found.genus) == (0, 1, 1, holes)
    assert found.faces == len(polycube(np.argwhere(ring(holes))).boundary_sides)


def test_topology_sees_pinches_parts_and_cavities() -> None:
    edge = np.zeros((2, 2, 1), dtype=bool)
    edge[0, 0] = edge[1, 1] = True
    assert topology(edge).pinched == 2
    corner = np.zeros((2, 2, 2), dtype=bool)
    corner[0, 0, 0] = corner[1, 1, 1] = True
    assert topology(corner).pinched == 1
    assert topology(corner).parts == 2
    hollow = np.ones((3, 3, 3), dtype=bool)
    hollow[1, 1, 1] = False
    assert topology(hollow).outsides == 2


@given(st.lists(st.booleans(), min_size=27, max_size=27))
@settings(max_examples=60, deadline=None)
def test_topology_agrees_with_the_blocks(bits: list[bool]) -> None:
    inside = np.array(bits).reshape(3, 3, 3)
    found = topology(inside)
    try:
        frame = frame_of(polycube(np.argwhere(inside)))
    except InputError:
        assert found.pinched > 0 or found.parts != 1
    else:
        assert (found.pinched, found.parts) == (0, 1)
        assert found.faces == len(frame.sides)
        if found.outsides == 1:
            assert found.genus == frame.genus


def test_voxels_deform_only_into_voxels_that_lie_alike() -> None:
    fine = np.ones((4, 4, 4), dtype=bool)
    frame = np.kron(np.pad(ring(2), ((1, 1), (1, 1), (1, 1))), fine)
    shifted = np.roll(frame, (1, 2, 0), axis=(0, 1, 2))
    assert deforms(frame, shifted)
    filled = np.kron(np.pad(np.ones((5, 3, 1), dtype=bool), 1), fine)
    assert not deforms(frame, filled)
    # The same genus with a hole in another place.
    one = np.kron(np.pad(ring(3), 1), fine)
    other = one.copy()
    one[8:12, 8:12, 4:8] = True
    other[16:20, 8:12, 4:8] = True
    assert topology(one).genus == topology(other).genus == 2
    assert not deforms(one, other)


def test_shares_of_a_box_are_exact() -> None:
    # Sides across the first axis anywhere, the others half-way between lines.
    low, high = np.array([0.7123, 1.0, 1 + 1 / 6]), np.array([3.2, 2.5, 3.0])
    found = shares(box(low, high), np.eye(3), np.zeros(3), 1.0, (5, 4, 4))
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in (5, 4, 4)), indexing="ij"), axis=-1)
    exact = np.clip(np.minimum(cells + 1, high) - np.maximum(cells, low), 0, None).prod(axis=-1)
    assert np.abs(found - exact).max() < 1e-12


def test_shares_add_up_to_the_volume() -> None:
    surface = torus()
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    errors = []
    for n in (17, 34, 68):
        found = shares(surface, rotation, np.full(3, -1.7), 3.4 / n, (n, n, n))
        assert found.min() > -1e-12
        assert found.max() < 1 + 1e-12
        errors.append(abs(found.sum() * (3.4 / n) ** 3 / volume(surface) - 1))
    assert errors[0] < 1e-3
    assert errors[-1] < 5e-5


def test_layers_of_voxels_become_one() -> None:
    surface = body(
        [(i, j, 0) for i in range(3) for j in range(3) if (i, j) != (1, 1)], [0, 5, 7, 12], [0, 4, 8, 12], [0, 1]
    )
    inside = np.pad(np.ones((12, 12, 1), dtype=bool), 1)
    inside[6:8, 5:9] = False
    x, y, z = (np.arange(-1.0, n - 0.5) for n in inside.shape)
    fewer, other = merged(surface, Voxels(np.argwhere(inside), np.eye(3), (x, y, z)))
    # Layers that are alike cost nothing.
    assert other["mismatch"] < 1e-9
    assert other["voxels"] + other["boundary_sides"] <= MOST < inside.sum() + topology(inside).faces
    assert frame_of(polycube(fewer.cells)).genus == 1
    # Volume by places of the voxels: no more is missing or too much than the report says.
    sides = np.prod([np.diff(line)[fewer.cells[:, d]] for d, line in enumerate(fewer.planes)], axis=0)
    assert abs(sides.sum() / volume(surface) - 1) <= other["mismatch"] + 1e-9
    assert place(fewer, fewer.cells + 1).max() < 14.0


def test_orientation_finds_the_axes_of_a_turned_box() -> None:
    surface = box(np.zeros(3), np.array([3.0, 2.0, 1.0]))
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    found = orientation(Surface(surface.points @ turn.T, surface.triangles))
    assert np.abs(np.abs(found @ turn) - np.eye(3)).max() < 1e-3
