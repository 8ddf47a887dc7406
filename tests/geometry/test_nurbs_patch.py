"""One patch: exact refinement, derivatives, reversal, faces, splitting, checks."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.patch import (
    Patch,
    bisect,
    derivatives,
    elevate,
    evaluate,
    face_of,
    grid_evaluate,
    insert,
    make_patch,
    reverse,
    signed_volume,
    split,
)
from iga.errors import InputError


def wild(rational: bool = True) -> Patch:
    """A patch with unequal degrees, repeated knots and random control points."""
    rng = np.random.default_rng(77)
    inner = ([0.3, 0.3, 0.7], [0.2, 0.5, 0.5, 0.5], [0.4])
    knots = [np.sort(np.concatenate([np.zeros(p + 1), k, np.ones(p + 1)])) for p, k in zip((2, 3, 1), inner)]
    shape = tuple(len(t) - p - 1 for t, p in zip(knots, (2, 3, 1)))
    weights = rng.uniform(0.5, 2, size=shape) if rational else None
    return make_patch(knots, rng.normal(size=(*shape, 3)), weights, "wild")


POINTS = np.vstack([np.zeros(3), np.ones(3), np.full(3, 0.5), np.random.default_rng(5).uniform(size=(300, 3))])


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("how", ["elevate", "elevate one", "bisect", "insert", "k"])
def test_refinement_is_exact(how: str, rational: bool) -> None:
    patch = wild(rational)
    finer = {
        "elevate": lambda: elevate(patch, 2),
        "elevate one": lambda: elevate(patch, (0, 0, 4)),
        "bisect": lambda: bisect(patch, 2),
        "insert": lambda: insert(patch, 1, np.array([0.1, 0.1, 0.1, 0.9])),
        "k": lambda: bisect(elevate(patch, 1)),
    }[how]()
    x, J = derivatives(patch, POINTS)
    y, K = derivatives(finer, POINTS)
    assert np.abs(x - y).max() < 1e-13 * np.abs(x).max()
    assert np.abs(J - K).max() < 1e-12 * np.abs(J).max()


def test_derivatives_against_differences() -> None:
    patch = wild()
    u = np.clip(POINTS[3:], 0.01, 0.99)
    _, J = derivatives(patch, u)
    for d in range(3):
        step = np.zeros(3)
        step[d] = 1e-6
        assert np.abs((evaluate(patch, u + step) - evaluate(patch, u - step)) / 2e-6 - J[..., d]).max() < 1e-6


def test_grid_evaluation_agrees() -> None:
    patch, axes = wild(), [np.array([0.0, 0.4]), np.array([0.1, 0.5, 1.0]), np.array([0.7])]
    x, J = grid_evaluate(patch, axes)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    y, K = derivatives(patch, points)
    assert np.allclose(x.reshape(-1, 3), y, atol=1e-14)
    assert np.allclose(J.reshape(-1, 3, 3), K, atol=1e-12)


def test_reverse_face_and_split() -> None:
    patch = wild()
    x = evaluate(patch, POINTS)
    assert np.allclose(evaluate(reverse(patch, 1), POINTS * [1, -1, 1] + [0, 1, 0]), x, atol=1e-14)
    for face in range(6):
        axis, side = divmod(face, 2)
        on = POINTS.copy()
        on[:, axis] = side
        rest = np.delete(POINTS, axis, axis=1)
        assert np.allclose(evaluate(face_of(patch, face), rest), evaluate(patch, on), atol=1e-14)
    for knot in (0.5, 0.3):
        low, high = split(patch, 0, knot)
        assert np.allclose(evaluate(low, POINTS * [knot, 1, 1]), evaluate(patch, POINTS * [knot, 1, 1]), atol=1e-14)
        upper = POINTS * [1 - knot, 1, 1] + [knot, 0, 0]
        assert np.allclose(evaluate(high, upper), evaluate(patch, upper), atol=1e-14)


def test_unclamped_ends_are_clamped() -> None:
    rng = np.random.default_rng(9)
    knots = [np.arange(8.0), np.array([0, 0, 1, 1.0]), np.array([0, 0, 2, 2.0])]
    control = rng.normal(size=(5, 2, 2, 3))
    clamped = make_patch(knots, control, None, "open")
    u = rng.uniform(size=(50, 3)) * [3, 1, 2] + [2, 0, 0]
    assert np.allclose(evaluate(clamped, u), evaluate(Patch(tuple(knots), control), u), atol=1e-13)
    assert clamped.knots[0].tolist() == [2, 2, 2, 3, 4, 5, 5, 5]


def test_signed_volume_sees_the_mirror() -> None:
    knots = (np.array([0, 0, 1, 1.0]),) * 3
    cube = Patch(knots, np.stack(np.meshgrid([0, 1.0], [0, 2.0], [0, 3.0], indexing="ij"), axis=-1))
    assert signed_volume(cube) == pytest.approx(6)
    assert signed_volume(reverse(cube, 2)) == pytest.approx(-6)


@pytest.mark.parametrize(
    ("what", "value", "said"),
    [("control", np.nan, r"control point \(1, 0, 1\)"), ("weights", 0.0, "weight"), ("weights", -1.0, "positive"),
     ("weights", np.nan, "weight"), ("control", 1e200, "1e150")],
)
def test_bad_numbers_are_refused(what: str, value: float, said: str) -> None:
    knots = [np.array([0, 0, 1, 1.0])] * 3
    arrays = {"control": np.zeros((2, 2, 2, 3)), "weights": np.ones((2, 2, 2))}
    arrays[what][1, 0, 1] = value
    with pytest.raises(InputError, match=said):
        make_patch(knots, arrays["control"], arrays["weights"], "file.xml, patch 2")
