"""Scaled Jacobians: one on ideal cells, counts of negative ones, and single elements."""

from __future__ import annotations

import numpy as np
import pytest

from iga.bernstein import bernstein
from iga.cells import CELLS, HEXAHEDRON, PYRAMID, WEDGE
from iga.scaled_jacobian import least_of_elements, scaled_jacobian
from tests.meshes import discontinuous

IDEAL = {
    "tetrahedron": np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0.5, np.sqrt(1 / 12), np.sqrt(2 / 3)]]),
    "hexahedron": HEXAHEDRON.vertices,
    "wedge": WEDGE.vertices @ np.array([[1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 0, 1]]),
    "pyramid": PYRAMID.vertices @ np.array([[1, 0, 0], [0, 1, 0], [0.5, 0.5, np.sqrt(0.5)]]),
}


@pytest.mark.parametrize("name", sorted(IDEAL))
def test_ideal_cells_have_scaled_jacobian_one(name):
    random = np.random.default_rng(53)
    turn, _ = np.linalg.qr(random.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    basis = bernstein(CELLS[name], 1)
    ideal = scaled_jacobian(discontinuous(basis, (3.0 * IDEAL[name] @ turn + 1.0)[None]))
    assert ideal["min"] == pytest.approx(1.0, abs=1e-12)
    assert ideal["mean"] == pytest.approx(1.0, abs=1e-12)
    noisy = IDEAL[name] + 0.2 * random.standard_normal((50, *IDEAL[name].shape))
    assert scaled_jacobian(discontinuous(basis, noisy))["mean"] < 1.0


def test_counts_of_negative_cells():
    basis = bernstein(HEXAHEDRON, 1)
    good = HEXAHEDRON.vertices
    flat = good * [1.0, 1.0, -1.0]
    sheared = good @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [3.0, 0.0, 1.0]])
    answer = scaled_jacobian(discontinuous(basis, np.stack([good, flat, sheared, good])))
    assert answer["cells_negative_gauss"] == 1
    assert answer["cells_negative_centre"] == 1
    assert answer["share_below_half"] == 0.5
    assert answer["min"] == pytest.approx(-1.0)


def test_scaled_jacobians_of_elements_agree_with_their_summary():
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    basis = bernstein(HEXAHEDRON, 1)
    corners = HEXAHEDRON.vertices.astype(float)
    leaning = corners + corners[:, 2:] * np.array([1.0, 0.0, 0.0])
    domain = discontinuous(basis, np.stack([corners @ turn.T, leaning @ turn.T]))
    least = least_of_elements(domain)
    assert least == pytest.approx([1.0, np.sqrt(0.5)], abs=1e-12)
    assert scaled_jacobian(domain)["min"] == pytest.approx(least.min(), abs=1e-15)
