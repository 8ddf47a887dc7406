"""Compiled assembly against the reference that calls integrands chunk by chunk: every cell, degree and extraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iga.assembly import matrix, reference_matrix, reference_vector, vector
from iga.block import Block, Kronecker, Patterns, dense_extraction
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conforming import straight_domain
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.field import Field
from iga.frame import specialised
from iga.integrands import Diffusion, Elasticity, Load, Mass, isotropic
from iga.operator import operator
from iga.parallel import limited
from tests.meshes import bend, box_complex, mixed_complex
from tests.splines import cube

rng = np.random.default_rng(7)
TENSOR = (lambda A: A @ A.T + np.eye(3))(rng.normal(size=(3, 3)))
VOIGT = (lambda A: A @ A.T + np.eye(6))(rng.normal(size=(6, 6)))


def curved(cell: Cell, degree: int) -> Domain:
    mesh, points = box_complex(cell, 2 if cell is HEXAHEDRON else 1)
    flat = straight_domain(mesh, points, degree)
    return replace(flat, points=bend(flat.points))


def weighted(domain: Domain) -> Domain:
    weights = 1.0 + 0.4 * np.random.default_rng(11).random(domain.space.n)
    return replace(domain, space=replace(domain.space, weights=weights))


def patterned(domain: Domain, extra: int = 0) -> Domain:
    """The same space with dense extraction, and ``extra`` functions on each element that are splits of the first."""
    blocks, n = [], domain.space.n
    for block in domain.space.blocks:
        C = dense_extraction(block, slice(None))
        C = np.broadcast_to(np.eye(block.n), (block.elements, block.n, block.n)).copy() if C is None else C
        dofs = block.dofs
        for k in range(extra):
            C = np.concatenate([C, 0.3 * C[:, :1]], axis=1)
            C[:, 0] *= 0.7
            dofs = np.column_stack([dofs, n + k + np.zeros(block.elements, np.int64)])
        blocks.append(Block(block.basis, dofs, Patterns(C, np.arange(block.elements))))
    points = np.concatenate([domain.points, np.tile(domain.points[:1], (extra, 1))])
    return Domain(Space(tuple(blocks), n + extra), points)


def shuffled(domain: Domain) -> Domain:
    """The same domain with functions numbered at random."""
    order = np.random.default_rng(13).permutation(domain.space.n)
    blocks = tuple(replace(b, dofs=order[b.dofs]) for b in domain.space.blocks)
    points = np.empty_like(domain.points)
    points[order] = domain.points
    weights = domain.space.weights
    if weights is not None:
        weights = weights[np.argsort(order)]
    return Domain(Space(blocks, domain.space.n, weights), points)


def forms(domain: Domain) -> list:
    field = Field(domain.space, 1.0 + np.random.default_rng(3).random(domain.space.n))
    return [
        Diffusion(1.7),
        Diffusion(TENSOR),
        Diffusion(lambda x: 1.0 + x[..., 0] ** 2),
        Diffusion(lambda x: TENSOR * (1.0 + x[..., 1, None, None] ** 2)),
        Diffusion(field),
        Mass(2.0),
        Mass(lambda x: 1.0 + x[..., 2] ** 2, components=2),
        Elasticity(isotropic(1.2, 0.7)),
        Elasticity(VOIGT),
        Elasticity(lambda x: VOIGT * (1.0 + x[..., 0, None, None] ** 2)),
    ]


def compare(domain: Domain, integrands: list | None = None, points: int | None = None) -> None:
    for integrand in integrands or forms(domain):
        K = matrix(domain, integrand, points)
        R = reference_matrix(domain, integrand, points, None, integrand.components)
        assert abs(K - R).max() <= 1e-12 * abs(R).max(), integrand
        assert abs(K - K.T).max() <= 1e-15 * abs(R).max()
        assert K.has_canonical_format
    for load in (
        Load(2.0),
        Load(lambda x: np.sin(3 * x[..., 0]) + x[..., 1]),
        Load(lambda x: x * 2.0, components=3),
        Load(np.array([1.0, 2.0, 3.0]), components=3),
        Load(Field(domain.space, domain.points), components=3),
    ):
        f = vector(domain, load, points)
        r = reference_vector(domain, load, points, None, load.components)
        np.testing.assert_allclose(f, r, rtol=0, atol=1e-12 * abs(r).max())


@pytest.mark.parametrize(("cell", "p"), [(c, p) for c in (TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID) for p in (1, 2, 3)])
def test_cells_and_degrees(cell: Cell, p: int) -> None:
    domain = curved(cell, p)
    compare(domain, forms(domain) if p < 3 else forms(domain)[3::4])


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID])
def test_rational_functions(cell: Cell) -> None:
    compare(weighted(curved(cell, 2)))


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON, WEDGE])
def test_dense_extraction(cell: Cell) -> None:
    domain = patterned(curved(cell, 2), extra=2)
    compare(domain)
    compare(weighted(domain), forms(domain)[1::3])


@pytest.mark.parametrize("p", [(1, 1, 1), (2, 2, 2), (3, 3, 3), (2, 3, 1)])
def test_splines(p: tuple[int, int, int]) -> None:
    domain = cube(p, (3, 4, 2))
    assert isinstance(domain.space.blocks[0].extraction, Kronecker)
    compare(domain, forms(domain) if p[0] < 3 else forms(domain)[::3])
    compare(weighted(domain), forms(domain)[3::4], points=5)


def test_any_numbering_of_functions() -> None:
    compare(shuffled(weighted(cube((2, 2, 2), (3, 3, 3)))))
    mesh, points = mixed_complex()
    compare(shuffled(straight_domain(mesh, points, 2)), [Diffusion(TENSOR), Elasticity(VOIGT)])


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON])
def test_an_element_with_one_function_twice(cell: Cell) -> None:
    """Degenerate elements name a function several times; entries of both places meet on the diagonal."""
    domain = curved(cell, 2)
    merged = np.arange(domain.space.n)
    merged[domain.space.blocks[0].dofs[0, 1]] = domain.space.blocks[0].dofs[0, 0]
    merged = np.unique(merged, return_inverse=True)[1]
    blocks = tuple(replace(b, dofs=merged[b.dofs]) for b in domain.space.blocks)
    points = np.zeros((merged.max() + 1, 3))
    points[merged] = domain.points
    compare(Domain(Space(blocks, len(points)), points))


def test_kernels_compiled_for_the_sizes_agree() -> None:
    domain = cube((2, 2, 2), (3, 3, 3))
    with specialised():
        compare(domain)
        compare(weighted(domain), forms(domain)[1::3])


def test_threads_change_rounding_only() -> None:
    domain = shuffled(cube((2, 2, 2), (5, 4, 4)))
    for integrand in (Diffusion(TENSOR), Elasticity(VOIGT)):
        with limited(1):
            one = matrix(domain, integrand)
        for count in (2, 3):
            with limited(count):
                several, again = matrix(domain, integrand), matrix(domain, integrand)
            assert abs(one - several).max() <= 1e-13 * abs(one).max()
            assert (several.data == again.data).all()


def test_a_form_without_symmetry_takes_the_reference() -> None:
    domain = cube((2, 2, 2), (2, 2, 2))
    tensor = np.array([[2.0, 1.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 1.0]])
    K = matrix(domain, Diffusion(tensor))
    assert abs(K - K.T).max() > 0.01
    rho = np.array([[2.0, 0.5], [0.5, 1.0]])
    coupled = matrix(domain, Mass(rho, components=2))
    np.testing.assert_allclose(coupled.toarray(), np.kron(matrix(domain, Mass(1.0)).toarray(), rho), atol=1e-14)


@pytest.mark.parametrize(("form", "tensor"), [(Diffusion, TENSOR), (Elasticity, VOIGT)])
def test_fields_of_tensors_have_their_entries_row_by_row(form: type, tensor: np.ndarray) -> None:
    domain = cube((2, 2, 2), (2, 2, 2))
    field = Field(domain.space, np.tile(tensor.ravel(), (domain.space.n, 1)))
    K = matrix(domain, form(tensor))
    x = np.random.default_rng(67).normal(size=K.shape[0])
    by_chunks = reference_matrix(domain, form(field), None, None, K.shape[0] // domain.space.n)
    for found in (matrix(domain, form(field)), operator(domain, form(field)), by_chunks):
        assert np.abs(found @ x - K @ x).max() < 1e-12 * np.abs(K @ x).max()


def test_integrands_of_wrong_shapes_are_told() -> None:
    domain = curved(HEXAHEDRON, 1)
    for given, words in (
        (lambda chunk: np.ones((3, 3)), r"shape \(3, 3\) where \(e, n\*c, n\*c\) = \(\d+, 8, 8\) is needed"),
        (lambda chunk: None, "gives NoneType where"),
    ):
        with pytest.raises(InputError, match=words):
            matrix(domain, given)
    with pytest.raises(InputError, match=r"shape \(4,\) where \(e, n\*c\) = \(\d+, 24\) is needed"):
        vector(domain, lambda chunk: np.ones(4), components=3)


def test_bad_data_is_named() -> None:
    domain = cube((2, 2, 2), (2, 2, 2))
    with pytest.raises(InputError, match=r"not finite in element 4 of block 0 \(0\.5\d*, 0\.\d*, 0\.\d*\)$"):
        matrix(domain, Diffusion(lambda x: np.where(x[..., 0] > 0.5, np.nan, 1.0)))
    flat = replace(domain, points=domain.points * [1.0, 1.0, 0.0])
    with pytest.raises(InputError, match="element 0 of block 0 is degenerate"):
        matrix(flat, Diffusion())
