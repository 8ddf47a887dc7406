"""Refinement without a source: same solid, same fields, nested spaces, on every cell that has children."""

from __future__ import annotations

import numpy as np
import pytest

from iga.assembly import integral, volume
from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conforming import Complex, boundary, straight_domain
from iga.domain import Domain, Space, check
from iga.errors import InputError
from iga.field import Field
from iga.refinement import children, complex_of, refine, refine_coefficients, subdivision
from tests.meshes import bend, box_complex, mixed_complex


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON, WEDGE], ids=str)
@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_children_are_the_parent(cell: Cell, degree: int) -> None:
    rng = np.random.default_rng(47)
    basis = bernstein(cell, degree)
    parent = rng.normal(size=(3, basis.n, 2))
    fine = refine_coefficients(basis, parent).reshape(3, -1, basis.n, 2)
    points = rng.dirichlet(np.ones(len(cell.vertices)), 20) @ cell.vertices
    linear = bernstein(cell, 1).tabulate(points, 0)[0]
    for k, corners in enumerate(children(cell)):
        inside = basis.tabulate(linear @ corners, 0)[0] @ parent
        assert np.abs(basis.tabulate(points, 0)[0] @ fine[:, k] - inside).max() < 1e-13
    matrices = subdivision(basis)
    assert np.abs(matrices.sum(axis=2) - 1).max() < 1e-14
    assert matrices.min() >= 0
    assert np.abs(np.einsum("kij,ejc->ekic", matrices, parent) - fine).max() < 1e-13


def prisms_and_bricks() -> tuple[Complex, np.ndarray]:
    """The mixed mesh without its pyramids."""
    mesh, points = mixed_complex()
    return Complex(tuple(part for part in mesh.parts if part[0] is not PYRAMID)), points


@pytest.mark.parametrize("rational", [False, True], ids=["polynomial", "rational"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_solid_fields_and_boundaries_stay(degree: int, rational: bool) -> None:
    mesh, points = prisms_and_bricks()
    keep = np.unique(np.concatenate([v.ravel() for _, v in mesh.parts]))
    renumber = np.full(len(points), -1)
    renumber[keep] = np.arange(len(keep))
    mesh = Complex(tuple((cell, renumber[v]) for cell, v in mesh.parts))
    flat = straight_domain(mesh, points[keep], degree)
    rng = np.random.default_rng(43)
    weights = rng.uniform(0.9, 1.1, flat.space.n) if rational else None
    k = rng.normal(size=(flat.space.n, 2))
    domain = Domain(Space(flat.space.blocks, flat.space.n, weights), bend(0.3 * flat.points), flat.boundaries, {"k": k})
    fine = refine(domain, levels=2, elevate=1)
    check(fine)
    assert [b.elements for b in fine.space.blocks] == [64 * b.elements for b in domain.space.blocks]
    assert abs(volume(fine, 9) - volume(domain, 14)) < 1e-13
    for where in (None, "boundary"):
        before = integral(domain, Field(domain.space, k), 14, where)
        after = integral(fine, Field(fine.space, fine.attributes["k"]), 9, where)
        assert np.abs(after - before).max() < 1e-11
    assert {(f.block, f.face, len(f.elements)) for f in boundary(complex_of(fine))} == {
        (f.block, f.face, len(f.elements)) for f in fine.boundaries["boundary"]
    }


def test_counts_of_a_box() -> None:
    for cell in (TETRAHEDRON, HEXAHEDRON, WEDGE):
        fine = refine(straight_domain(*box_complex(cell, 1), 2), 2)
        assert fine.space.n == 9**3


def test_pyramids_elevate_but_do_not_refine() -> None:
    domain = straight_domain(*mixed_complex(), 1)
    assert abs(volume(refine(domain, 0, 2)) - volume(domain)) < 1e-14
    with pytest.raises(InputError, match="pyramid cannot be refined"):
        refine(domain)


def test_what_would_take_all_memory_is_refused() -> None:
    domain = straight_domain(*box_complex(HEXAHEDRON, 1), 2)
    with pytest.raises(InputError, match="levels=20, elevate=1 needs 7e"):
        refine(domain, 20, 1)
    with pytest.raises(InputError, match="gives degree 40"):
        refine(domain, 0, 38)
