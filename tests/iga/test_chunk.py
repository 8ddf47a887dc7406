"""Chunks: volumes, normals, patch tests on every cell and on a mixed mesh, rational functions, extraction."""

from __future__ import annotations

import numpy as np
import pytest

from iga.assembly import integral, matrix, unknowns, vector, volume
from iga.bernstein import bernstein, elevation
from iga.block import Block, Kronecker, Patterns
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.chunk import Chunk, chunks, facet_chunks
from iga.conforming import bezier_domain, straight_domain
from iga.domain import Domain, Space, check
from iga.errors import InputError
from iga.field import Field
from iga.integrands import Diffusion, Elasticity, Load, Mass, Pressure, isotropic, strain
from iga.norms import errors
from tests.meshes import bend, box_complex, mixed_complex

CELLS3 = [TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID]
CASES = [(cell, p) for cell in CELLS3 for p in (1, 2, 3, 4)]


def curved(cell: Cell, degree: int, n: int = 1) -> Domain:
    """A bent box: control points moved, so the map is curved from degree two on."""
    mesh, points = box_complex(cell, n)
    flat = straight_domain(mesh, points, degree)
    return Domain(flat.space, bend(flat.points), flat.boundaries)


def residual(domain: Domain, points: int) -> tuple[float, float]:
    """Defect of K u - boundary flux for a linear temperature and a linear displacement, relative to the flux."""
    a, A = np.array([1.0, 2.0, -0.5]), np.random.default_rng(7).normal(size=(3, 3))
    D = isotropic(1.2, 0.7)
    s = D @ strain(A)
    S = np.array([[s[0], s[5], s[4]], [s[5], s[1], s[3]], [s[4], s[3], s[2]]])

    def flux(chunk: Chunk) -> np.ndarray:
        return ((chunk.dx * (1.3 * chunk.normal @ a))[:, None, :] @ chunk.N)[:, 0]

    def traction(chunk: Chunk) -> np.ndarray:
        return (chunk.N.swapaxes(1, 2) @ ((chunk.normal @ S) * chunk.dx[..., None])).reshape(len(chunk.elements), -1)

    heat = vector(domain, flux, points, "boundary")
    force = vector(domain, traction, points, "boundary", components=3)
    K = matrix(domain, Diffusion(1.3), points)
    E = matrix(domain, Elasticity(D), points)
    return (
        float(np.abs(K @ (domain.points @ a) - heat).max() / np.abs(heat).max()),
        float(np.abs(E @ (domain.points @ A.T).ravel() - force).max() / np.abs(force).max()),
    )


@pytest.mark.parametrize(("cell", "degree"), CASES)
def test_patch_on_curved_cells(cell: Cell, degree: int) -> None:
    # On curved pyramids div J^-T is not polynomial, so only a rule far beyond the default is exact to round-off.
    exact = (3 * degree) // 2 + 1 if cell is not PYRAMID else 3 * degree + 2
    heat, force = residual(curved(cell, degree), exact)
    assert heat < 1e-12
    assert force < 1e-12


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_patch_on_mixed_cells(degree: int) -> None:
    mesh, points = mixed_complex()
    heat, force = residual(straight_domain(mesh, points, degree), degree + 1)
    assert heat < 1e-12
    assert force < 1e-12


@pytest.mark.parametrize(("cell", "degree"), CASES)
def test_volume_by_the_divergence_theorem(cell: Cell, degree: int) -> None:
    domain = curved(cell, degree)
    faces = facet_chunks(domain, "boundary", 3 * degree)
    surface = sum(float((np.einsum("eqc,eqc->eq", c.x, c.normal) * c.dx).sum()) for c in faces)
    assert abs(volume(domain, 3 * degree) - surface / 3) < 1e-12


def test_matrices_are_symmetric_and_kill_constants() -> None:
    domain = curved(PYRAMID, 2)
    K, M = matrix(domain, Diffusion(np.diag([1.0, 2.0, 3.0]))), matrix(domain, Mass(2.0))
    assert abs(K - K.T).max() < 1e-13
    assert np.abs(K @ np.ones(K.shape[0])).max() < 1e-13
    assert np.abs(M @ np.ones(K.shape[0]) - vector(domain, Load(2.0))).max() < 1e-14


def test_coefficients_may_be_fields_functions_or_tensors() -> None:
    domain = curved(HEXAHEDRON, 2)
    k = Field(domain.space, 1.0 + domain.points[:, 0])
    by_field = matrix(domain, Diffusion(k))
    by_function = matrix(domain, Diffusion(lambda x: 1.0 + x[..., 0]))
    by_tensor = matrix(domain, Diffusion(lambda x: (1.0 + x[..., 0])[..., None, None] * np.eye(3)))
    assert abs(by_field - by_function).max() < 1e-12
    assert abs(by_tensor - by_function).max() < 1e-12
    coupled = matrix(domain, Mass(np.diag([2.0, 2.0, 2.0]), components=3))
    assert abs(coupled - matrix(domain, Mass(2.0, components=3))).max() < 1e-14


def test_pressure_on_a_closed_surface_has_no_resultant() -> None:
    domain = curved(WEDGE, 2)
    f = vector(domain, Pressure(3.0), boundary="boundary").reshape(-1, 3)
    assert np.abs(f.sum(axis=0)).max() < 1e-14


def test_weights_of_one_change_nothing_and_others_keep_the_patch() -> None:
    plain = curved(HEXAHEDRON, 2)
    n = plain.space.n
    same = Domain(Space(plain.space.blocks, n, np.full(n, 2.5)), plain.points, plain.boundaries)
    assert abs(matrix(same, Diffusion()) - matrix(plain, Diffusion())).max() < 1e-13
    weights = np.random.default_rng(13).uniform(0.8, 1.2, n)
    rational = Domain(Space(plain.space.blocks, n, weights), plain.points, plain.boundaries)
    for chunk in chunks(rational):
        assert np.abs(chunk.N.sum(axis=2) - 1).max() < 1e-13
        assert np.abs(chunk.at(rational.points) - chunk.x).max() < 1e-13
        assert np.abs(chunk.gradient(rational.points) - np.eye(3)).max() < 1e-11
    heat, _ = residual(rational, 14)
    assert heat < 1e-11


def test_extraction_kinds_agree() -> None:
    rng = np.random.default_rng(37)
    mesh, points = box_complex(HEXAHEDRON, 2)
    base = straight_domain(mesh, points, 2)
    block = base.space.blocks[0]
    factors = tuple(rng.dirichlet(np.ones(3), (2, 3)).swapaxes(1, 2) for _ in range(3))
    pattern = rng.integers(0, 2, (block.elements, 3))
    C = np.stack([
        np.kron(np.kron(factors[0][a], factors[1][b]), factors[2][c]) for a, b, c in pattern
    ])
    kronecker = Block(block.basis, block.dofs, Kronecker(factors, pattern))
    dense = Block(block.basis, block.dofs, Patterns(C, np.arange(block.elements)))
    made = [Domain(Space((b,), base.space.n), base.points) for b in (kronecker, dense)]
    for domain in made:
        check(domain)
    assert abs(volume(made[0]) - volume(made[1])) < 1e-13
    assert abs(matrix(made[0], Mass()) - matrix(made[1], Mass())).max() < 1e-13


def test_shared_pattern_extraction_is_a_change_of_basis() -> None:
    # Degree-one functions written on degree-three hexahedra: C is the transposed elevation matrix.
    mesh, points = box_complex(HEXAHEDRON, 2)
    low = straight_domain(mesh, points, 1)
    raise_ = elevation(bernstein(HEXAHEDRON, 1), (3, 3, 3))
    dofs = low.space.blocks[0].dofs
    block = Block(bernstein(HEXAHEDRON, 3), dofs, Patterns(raise_.T[None], np.zeros(len(dofs), dtype=np.int64)))
    high = Domain(Space((block,), low.space.n), low.points)
    assert abs(matrix(low, Diffusion(), 4) - matrix(high, Diffusion(), 4)).max() < 1e-13


@pytest.mark.parametrize(("cell", "degree"), [(c, p) for c, p in CASES if p < 4])
def test_norms_of_a_polynomial_of_the_space(cell: Cell, degree: int) -> None:
    mesh, points = box_complex(cell, 1)
    domain = straight_domain(mesh, points, degree)
    found = errors(domain, domain.points @ np.array([1.0, 2.0, 3.0]), lambda x: x @ np.array([1.0, 2.0, 3.0]),
                   lambda x: np.broadcast_to([1.0, 2.0, 3.0], x.shape))
    assert found.l2 < 1e-13
    assert found.h1 < 1e-12
    assert abs(found.exact_h1 - np.sqrt(14.0)) < 1e-12


def test_integral_keeps_the_shape_of_the_value() -> None:
    domain = curved(TETRAHEDRON, 2)
    moment = integral(domain, lambda x: x)
    assert moment.shape == (3,)
    assert abs(integral(domain) - volume(domain)) < 1e-15


def test_a_flat_element_is_named() -> None:
    mesh, points = box_complex(HEXAHEDRON, 1)
    points[:, 2] = 0.0
    with pytest.raises(InputError, match="element 0 of block 0 is degenerate"):
        matrix(straight_domain(mesh, points), Diffusion())


def test_unknown_boundaries_are_named() -> None:
    domain = curved(HEXAHEDRON, 1)
    with pytest.raises(InputError, match="no boundary is called 'bore'; there are: boundary"):
        next(facet_chunks(domain, "bore"))


def test_unknown_numbers_interleave_components() -> None:
    assert unknowns(np.array([[4, 7]]), 3).tolist() == [[12, 13, 14, 21, 22, 23]]


def test_bezier_domain_keeps_coefficients() -> None:
    mesh, points = box_complex(TETRAHEDRON, 1)
    domain = straight_domain(mesh, points, 3)
    again = bezier_domain(mesh, 3, [domain.points[b.dofs] for b in domain.space.blocks])
    assert np.array_equal(again.points, domain.points)
