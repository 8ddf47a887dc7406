"""The cube benchmark gives the known errors in both modes."""

from __future__ import annotations

import numpy as np
import pytest

from iga.errors import InputError
from studies.bench_cube import AMPLITUDES, LAME, SHEAR, body_force, displacement, run


@pytest.mark.parametrize("mode", ["assembled", "matrix-free"])
def test_errors_and_iterations(mode: str) -> None:
    heat = run("heat", 3, 8, 1, mode)
    assert heat["ndofs"] == 9**3
    assert heat["l2_error"] == pytest.approx(1.505e-5, rel=0.001)
    assert heat["iterations"] <= 9
    elastic = run("elasticity", 2, 4, 2, mode)
    assert elastic["ndofs"] == 3 * 4**3
    assert elastic["iterations"] <= 25
    assert 0 < elastic["l2_error"] < 3e-3


def test_body_force_is_minus_the_divergence_of_stress() -> None:
    x = np.random.default_rng(3).random((5, 3))
    h = 1e-4
    D = np.zeros((5, 3, 3, 3))  # second derivatives of u_i in directions j, k
    for j in range(3):
        for k in range(3):
            a, b = h * np.eye(3)[j], h * np.eye(3)[k]
            D[:, :, j, k] = (
                displacement(x + a + b) - displacement(x + a - b) - displacement(x - a + b) + displacement(x - a - b)
            ) / (4 * h * h)
    expected = -(LAME + SHEAR) * np.einsum("njji->ni", D) - SHEAR * np.einsum("nijj->ni", D)
    np.testing.assert_allclose(body_force(x), expected, atol=1e-5 * np.abs(expected).max())
    assert len(AMPLITUDES) == 3


def test_bad_arguments() -> None:
    with pytest.raises(InputError, match="no benchmark problem"):
        run("flow", 2, 2, 1)
    with pytest.raises(InputError, match="mode"):
        run("heat", 2, 2, 1, "magic")
    with pytest.raises(InputError, match="at least 2"):
        run("heat", 1, 2, 1)
