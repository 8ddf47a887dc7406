"""Surfaces by name are closed, oriented outwards, and approach the solids they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.meccano.shapes import SHAPES, ball, torus
from geometry.simplices.surface import checked_surface, genus, volume


@pytest.mark.parametrize("name", SHAPES)
def test_is_a_closed_surface(name: str) -> None:
    surface = SHAPES[name]()
    checked, _ = checked_surface(surface.points, surface.triangles)
    assert np.array_equal(checked.triangles, surface.triangles)  # nothing had to be turned round
    assert genus(checked) == (name == "torus")


def test_volumes_converge_at_second_order() -> None:
    for exact, made in (
        (4.0 * np.pi / 3.0, [volume(ball(n)) for n in (8, 16, 32)]),
        (2.0 * np.pi**2 * 0.4**2, [volume(torus(n, n // 2)) for n in (16, 32, 64)]),
    ):
        error = exact - np.array(made)
        assert (error > 0.0).all()  # inscribed
        assert np.log2(error[:-1] / error[1:]) == pytest.approx([2.0, 2.0], abs=0.1)
        assert error[-1] < 0.03 * exact
