"""Gluing: every orientation, different knots and degrees, closed patches, weights, and what is refused."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from geometry.nurbs.domain import build_domain, from_arrays, to_arrays
from geometry.nurbs.multipatch import Multipatch, glue, number, refined
from geometry.nurbs.shapes import cylinder, fichera, thick_ring, torus
from geometry.patch import Patch, bisect, elevate, insert, make_patch, reverse
from iga.assembly import volume
from iga.domain import check
from iga.errors import InputError


def brick(low: tuple[float, float, float], high: tuple[float, float, float], degree: int = 1) -> Patch:
    knots = (np.array([0, 0, 1, 1.0]),) * 3
    axes = [np.array([a, b], dtype=float) for a, b in zip(low, high)]
    return elevate(Patch(knots, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)), degree - 1)


def bend(patch: Patch) -> Patch:
    """Move control points by a smooth map, the same for coincident points."""
    x, y, z = np.moveaxis(patch.control, -1, 0)
    moved = np.stack([x + 0.1 * np.sin(2 * y + z), y + 0.1 * np.sin(x - z), z + 0.1 * x * y], axis=-1)
    return Patch(patch.knots, moved, patch.weights)


def turn(patch: Patch, axes: tuple[int, ...], flips: tuple[int, ...]) -> Patch:
    weights = None if patch.weights is None else patch.weights.transpose(axes)
    turned = Patch(tuple(patch.knots[a] for a in axes), patch.control.transpose(*axes, 3), weights)
    for d in range(3):
        if flips[d]:
            turned = reverse(turned, d)
    return turned


def euler(multipatch: Multipatch) -> int:
    """Euler characteristic of the control net as a complex of cubes, glued functions being one vertex."""
    nets, n = number(multipatch)
    cells, faces, edges = 0, [], []
    for net in nets:
        cells += int(np.prod(np.array(net.shape) - 1))
        for d in range(3):
            a = np.moveaxis(net, d, 0)
            edges.append(np.stack([a[:-1].ravel(), a[1:].ravel()], axis=-1))
            faces.append(np.stack([a[:, i, j].ravel() for i, j in (
                (np.s_[:-1], np.s_[:-1]), (np.s_[:-1], np.s_[1:]), (np.s_[1:], np.s_[:-1]), (np.s_[1:], np.s_[1:]))],
                axis=-1))
    sizes = [len(np.unique(np.sort(np.concatenate(x), axis=1), axis=0)) for x in (edges, faces)]
    return n - sizes[0] + sizes[1] - cells


ALL_TURNS = list(product(permutations(range(3)), product((0, 1), repeat=3)))


@pytest.mark.parametrize(("axes", "flips"), ALL_TURNS[::5])
def test_two_patches_in_every_orientation(axes: tuple[int, ...], flips: tuple[int, ...]) -> None:
    """Degrees (2, 3, 1) and unsymmetric knots, so that only the right orientation fits."""
    one = insert(insert(elevate(brick((0, 0, 0), (1, 1, 1)), (1, 2, 0)), 1, np.array([0.3])), 2, np.array([0.25]))
    two = insert(insert(elevate(brick((1, 0, 0), (3, 1, 1)), (1, 2, 0)), 1, np.array([0.3])), 2, np.array([0.25]))
    made = glue([bend(one), turn(bend(two), axes, flips)])
    assert len(made.interfaces) == 1
    left = sum(flips) % 2 == 1
    odd = axes in ((0, 2, 1), (1, 0, 2), (2, 1, 0))
    assert made.turned == ((1,) if left != odd else ())
    shared = one.control.shape[1] * one.control.shape[2]
    assert number(made)[1] == one.control[..., 0].size + two.control[..., 0].size - shared
    domain = build_domain(made, "two", {})
    check(domain)
    assert euler(made) == 1
    alone = sum(volume(build_domain(glue([p]), "one", {}), 6) for p in (bend(one), bend(two)))
    assert volume(domain, 6) == pytest.approx(alone, rel=1e-13)


def test_different_knots_and_degrees_are_made_to_match() -> None:
    """A row of three: what the first and last have reaches all, through the middle one."""
    first = insert(brick((0, 0, 0), (1, 1, 1), 2), 1, np.array([1 / 3]))
    middle = brick((1, 0, 0), (2, 1, 1))
    last = bisect(brick((2, 0, 0), (3, 1, 1)))
    above = elevate(brick((0, 0, 1), (1, 1, 2)), (0, 0, 2))
    made = glue([first, middle, turn(last, (1, 2, 0), (0, 1, 0)), above])
    assert len(made.interfaces) == 3
    domain = build_domain(made, "row", {})
    check(domain)
    assert volume(domain) == pytest.approx(4, rel=1e-13)
    assert [p.degree[1] for p in made.patches[:2]] == [2, 2]
    assert [p.elements[1] for p in (made.patches[0], made.patches[1], made.patches[3])] == [3, 3, 3]
    assert made.patches[3].degree == (2, 2, 3)
    assert made.gap < 1e-14


def test_functions_are_shared_around_edges_by_topology() -> None:
    """Four bricks around an edge share it; without one of the four the chain still closes; without two it does not."""
    bricks = [brick((i, j, 0), (i + 1, j + 1, 1)) for i in (0, 1) for j in (0, 1)]
    assert number(glue(bricks))[1] == 18
    assert number(glue(bricks[:3]))[1] == 16
    apart = glue([bricks[0], bricks[3]])
    assert (len(apart.interfaces), number(apart)[1]) == (0, 16)


@pytest.mark.parametrize(
    ("made", "functions", "interfaces", "characteristic"),
    [
        (thick_ring(angle=360), 32, 1, 0),
        (torus(angle=360), 136, 13, 0),
        (torus(angle=270), 119, 8, 1),
        (cylinder(), 34, 8, 1),
        (fichera(), 26, 9, 1),
    ],
    ids=["closed ring", "closed torus", "open torus", "cylinder", "fichera"],
)
def test_counts_of_glued_shapes(made: Multipatch, functions: int, interfaces: int, characteristic: int) -> None:
    assert (number(made)[1], len(made.interfaces)) == (functions, interfaces)
    assert euler(made) == characteristic
    finer = refined(made, 1, 1)
    assert euler(finer) == characteristic
    domain = build_domain(finer, "", {})
    check(domain)
    again = build_domain(from_arrays(to_arrays(finer)), "", {})
    assert np.array_equal(again.points, domain.points)
    assert list(again.boundaries) == list(domain.boundaries)


def test_weights_with_another_factor_are_scaled() -> None:
    rng = np.random.default_rng(3)
    one, two = brick((0, 0, 0), (1, 1, 1), 2), brick((1, 0, 0), (2, 1, 1), 2)
    w = rng.uniform(0.7, 1.4, size=(5, 3, 3))
    a = make_patch(list(one.knots), one.control, w[:3], "a")
    b = make_patch(list(two.knots), two.control, 3.7 * w[2:], "b")
    made = glue([a, b])
    assert np.allclose(made.patches[1].weights[0], made.patches[0].weights[2], rtol=1e-14)
    plain = glue([a, brick((-1, 0, 0), (0, 1, 1))]) if np.ptp(w[0]) < 1e-6 else None
    assert plain is None


def test_rational_next_to_polynomial() -> None:
    w = np.ones((3, 1, 1)) * np.array([1, 0.8, 1.2])[:, None, None] * np.ones((3, 2, 2))
    one = elevate(brick((0, 0, 0), (1, 1, 1)), (1, 0, 0))
    made = glue([make_patch(list(one.knots), one.control, w, "a"), brick((-1, 0, 0), (0, 1, 1))])
    domain = build_domain(made, "", {})
    check(domain)
    assert domain.space.weights is not None
    assert volume(domain, 8) == pytest.approx(2, rel=1e-9)


def test_lens_is_not_glued_shut() -> None:
    """Two half rings share the corners of their inner faces, which are nevertheless different surfaces."""
    half = thick_ring(angle=180).patches[0]
    other = Patch(half.knots, half.control * np.array([-1.0, -1.0, 1.0]), half.weights)
    made = glue([half, other])
    assert len(made.interfaces) == 2
    assert euler(made) == 0


@pytest.mark.parametrize(
    ("patches", "said"),
    [
        ([brick((0, 0, 0), (1, 1, 1))] * 2, "patch 0 face x0"),
        ([brick((0, 0, 0), (1, 1, 1))] * 3, "at most two patches"),
        (
            [brick((0, 0, 0), (1, 1, 1)), brick((1, 0, 0), (2, 0.5, 1)), brick((1, 0.5, 0), (2, 1, 1))],
            "patch 1 face x0",
        ),
        ([brick((0, 0, 0), (0, 1, 1))], "no volume"),
    ],
    ids=["twice", "three times", "hanging", "flat"],
)
def test_what_cannot_be_glued_is_refused(patches: list[Patch], said: str) -> None:
    with pytest.raises(InputError, match=said):
        glue(patches, where="file")


def test_another_parametrisation_of_the_same_face_is_refused() -> None:
    one, two = brick((0, 0, 0), (1, 1, 1), 2), brick((1, 0, 0), (2, 1, 1), 2)
    moved = two.control.copy()
    moved[0, 1, :, 1] += 0.1
    with pytest.raises(InputError, match="patch 0 face x1 and patch 1 face x0 are one surface"):
        glue([one, Patch(two.knots, moved)])


def test_collapsed_faces_are_no_boundary() -> None:
    """A solid cylinder of one patch whose inner face is its axis."""
    ring = thick_ring(angle=90).patches[0]
    control = ring.control.copy()
    control[0, ..., :2] = 0
    made = glue([Patch(ring.knots, control, ring.weights)])
    assert made.collapsed == ((0, 0),)
    domain = build_domain(made, "wedge", {})
    check(domain)
    assert domain.report["collapsed_faces"] == ["patch 0 face x0"]
    assert list(domain.boundaries) == ["x1", "y0", "y1", "z0", "z1"]
    assert volume(domain, 8) == pytest.approx(np.pi, rel=1e-6)
    assert from_arrays(to_arrays(made)).collapsed == made.collapsed
