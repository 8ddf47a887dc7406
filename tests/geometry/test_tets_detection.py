"""Theorem 2 as a detector, and groups of four hexahedra turned back into their tetrahedron."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.tet_to_hex import degenerate_matrix, tets_to_degenerate_hexes, tets_to_hexes
from geometry.tets.detection import cube_symmetries, hex_groups_to_tets, hexes_to_tets, symmetry_faces, symmetry_sign
from geometry.tets.mesh import straight_determinants
from geometry.tets.shapes import ball
from iga.bernstein import bernstein, greville
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.errors import InputError


def bent_tets(count: int, degree: int, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((count, degenerate_matrix(degree).shape[1], 3))
    return greville(bernstein(TETRAHEDRON, degree)) + 0.04 * noise


@pytest.mark.parametrize("degree", range(1, 9))
def test_converted_tets_are_found_in_all_48_positions(degree):
    tets = bent_tets(48, degree, 11 * degree)
    symmetries = cube_symmetries(degree)
    assert len(np.unique(symmetries, axis=0)) == 48
    # Undo symmetry k on hexahedron k: the detector has to find it again.
    hexes = np.stack([tets_to_degenerate_hexes(tets)[k][np.argsort(symmetries[k])] for k in range(48)])
    found = hexes_to_tets(hexes)
    assert found.found.all()
    assert found.residual.max() < 1e-14
    for k in range(48):
        assert found.point_face[k] == symmetry_faces(k)[1]
        assert found.line_face[k] == symmetry_faces(k)[3]
        if symmetry_sign(k) > 0:
            assert np.abs(found.coefficients[k] - tets[k]).max() < 1e-13
    assert np.array_equal(np.sign(straight_determinants(found.coefficients)), [symmetry_sign(k) for k in range(48)])


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_a_perturbed_first_slice_is_rejected(degree):
    """The condition on slice i = 0, which the printed range leaves out."""
    hexes = tets_to_degenerate_hexes(bent_tets(1, degree, 5))
    scale = np.linalg.norm(np.ptp(hexes[0], axis=0))
    # Row s = 0 of the slice is free (a curve of degree n); the rows after it must be of degree n - j.
    for b in range(degree + 1, (degree + 1) ** 2):
        changed = hexes.copy()
        changed[0, b, 1] += 1e-3
        found = hexes_to_tets(changed)
        assert not found.found[0]
        assert 5e-5 < found.residual[0] * scale < 1e-3


def test_regular_hexes_are_not_tets():
    hexes = greville(bernstein(HEXAHEDRON, 3)) + 0.05 * np.random.default_rng(3).standard_normal((40, 64, 3))
    found = hexes_to_tets(hexes)
    assert not found.found.any()
    assert (found.residual > 0.05).all()
    assert (found.point_face == -1).all()


def test_a_loose_tolerance_accepts_noise():
    hexes = tets_to_degenerate_hexes(bent_tets(6, 3, 29))
    noisy = hexes + 1e-6 * np.random.default_rng(31).standard_normal(hexes.shape)
    assert not hexes_to_tets(noisy).found.any()
    assert hexes_to_tets(noisy, tolerance=1e-4).found.all()


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 6, 8])
def test_groups_of_four_are_put_together_again(degree):
    mesh = ball(0 if degree > 4 else 1, degree)
    random = np.random.default_rng(100 + degree)
    hexes = tets_to_hexes(mesh.coefficients).reshape(-1, (degree + 1) ** 3, 3)
    order = random.permutation(len(hexes))
    turn = cube_symmetries(degree)[random.integers(48, size=len(hexes))]
    mixed = np.take_along_axis(hexes, turn[:, :, None], axis=1)[order]
    odd_one = greville(bernstein(HEXAHEDRON, degree)) + 0.02 * random.standard_normal((3, (degree + 1) ** 3, 3))
    groups, tets, residual = hex_groups_to_tets(np.concatenate([mixed, odd_one]))
    assert len(groups) == len(mesh.vertices)
    assert residual.max() < 1e-13
    assert np.array_equal(np.sort(groups.ravel()), np.arange(len(hexes)))
    for row, tet in zip(groups, tets):
        parents = order[row] // 4
        assert (parents == parents[0]).all()
        # The vertices may come back in another order; the set of coefficients is the same.
        assert np.abs(np.sort(tet, axis=0) - np.sort(mesh.coefficients[parents[0]], axis=0)).max() < 1e-12


def test_three_of_four_are_no_tetrahedron():
    hexes = tets_to_hexes(bent_tets(5, 3, 37)).reshape(-1, 64, 3)
    groups, tets, residual = hex_groups_to_tets(np.delete(hexes, 7, axis=0))
    assert len(groups) == len(tets) == len(residual) == 4
    assert hex_groups_to_tets(hexes[:3])[0].shape == (0, 4)


def test_coefficients_that_are_no_cube_are_refused():
    with pytest.raises(InputError, match="63"):
        hexes_to_tets(np.zeros((2, 63, 3)))
