"""Conforming spaces: counts by Euler's formula, C0 traces across every pair of cells, boundaries."""

from __future__ import annotations

import numpy as np
import pytest

from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conforming import Complex, boundary, number, straight_domain
from iga.domain import check
from iga.errors import InputError
from tests.meshes import box_complex, mixed_complex

CELLS3 = [TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID]


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_count_on_a_box(degree: int) -> None:
    mesh, _ = box_complex(HEXAHEDRON, 3)
    assert number(mesh, degree)[1] == (3 * degree + 1) ** 3
    mesh, _ = box_complex(TETRAHEDRON, 2)
    assert number(mesh, degree)[1] == (2 * degree + 1) ** 3


def shuffled(mesh: Complex, seed: int) -> tuple[Complex, np.ndarray]:
    """Renumber the vertices at random, so that shared faces meet in all orientations."""
    order = np.random.default_rng(seed).permutation(mesh.vertices)
    return Complex(tuple((cell, order[v]) for cell, v in mesh.parts)), order


@pytest.mark.parametrize("seed", [3, 5, 11, 17, 23])
@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_random_coefficients_give_a_continuous_field(degree: int, seed: int) -> None:
    mesh, points = mixed_complex()
    mesh, order = shuffled(mesh, seed)
    moved = np.empty_like(points)
    moved[order] = points
    dofs, n = number(mesh, degree)
    field = np.random.default_rng(seed).normal(size=n)
    seen: dict[tuple[float, ...], float] = {}
    shared = 0
    for (cell, vertices), block in zip(mesh.parts, dofs):
        basis = bernstein(cell, degree)
        for face in cell.faces:
            # Points with the same physical place on a straight face: symmetric in its vertices.
            for mix in ((0.5, 0.3, 0.2), (0.2, 0.7, 0.1)):
                for roll in range(len(face.vertices)):
                    if len(face.vertices) == 3:
                        place = np.roll(mix, roll) @ cell.vertices[list(face.vertices)]
                    else:
                        s, t = [(mix[0], mix[1]), (mix[1], mix[0]), (1 - mix[0], mix[1]), (mix[1], 1 - mix[0])][roll]
                        place = face.origin + face.axes @ np.array([s, t])
                    x = bernstein(cell, 1).tabulate(place[None], 0)[0] @ moved[vertices]
                    u = (basis.tabulate(place[None], 0)[0] * field[block]).sum(axis=1)
                    for position, value in zip(x[:, 0], u):
                        key = tuple(np.round(position, 9))
                        if key in seen:
                            shared += 1
                            assert abs(seen[key] - value) < 1e-12
                        seen[key] = value
    assert shared > 10


@pytest.mark.parametrize("cell", CELLS3, ids=str)
def test_boundary_of_a_box_is_closed(cell: Cell) -> None:
    mesh, points = box_complex(cell, 2)
    domain = straight_domain(mesh, points)
    check(domain)
    facets = sum(len(f.elements) for f in boundary(mesh))
    assert facets == {"hexahedron": 24, "tetrahedron": 48, "pyramid": 24, "wedge": 32}[cell.name]


def test_three_cells_on_one_face_are_refused() -> None:
    vertices = np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 2, 5]])
    with pytest.raises(InputError, match="vertices 0, 1, 2 belongs to 3 cells"):
        boundary(Complex(((TETRAHEDRON, vertices),)))


def test_degree_zero_is_refused() -> None:
    with pytest.raises(InputError, match="degree 1"):
        number(mixed_complex()[0], 0)
