"""The paper's T-splines: local knots, the quotient, interpolation, exact elements, Figure 4, analysis on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.layouts.blocks import cube, place
from geometry.meccano.interpolation import blending, collocation, interpolate
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.t_spline import TSpline, boundaries, places_of, t_spline
from geometry.meccano.tmesh import TMesh, octree, refined, uniform
from iga.assembly import volume
from iga.block import bezier_coefficients, dense_extraction
from iga.certificate import certify
from iga.chunk import Chunk, facet_chunks
from iga.conditions import DependentTracesError, dirichlet
from iga.domain import Domain, Space, check
from iga.errors import InputError
from iga.exchange.bext import read_bext, write_bext
from iga.exchange.export import write_vtu
from iga.store import load, save
from problems.manufactured import solve_exact
from tests.geometry.meccano_shapes import polycube, ring, seven

FULL = 1 << LEVELS


def graded(dim: int, rounds: int, seed: int, level: int = 1) -> TMesh:
    tmesh = uniform(cube(dim), level, 1)
    rng = np.random.default_rng(seed)
    for _ in range(rounds):
        tmesh = refined(tmesh, rng.integers(0, tmesh.cells, 2))
    return tmesh


def knots_at(own: TSpline, *place: float) -> np.ndarray:
    at = int(np.flatnonzero((own.anchors == np.array(place) * FULL).all(axis=1))[0])
    return own.knots[at] / FULL


def square(fine: bool, centre: float) -> tuple[TSpline, np.ndarray]:
    """The test model of the paper's Figure 4: T-mesh and images of the anchors under the piecewise linear map."""
    nodes = np.array([[0.5, 0.5], [0.75, 0.75]])[: 1 + fine]
    own = t_spline(octree(cube(2), np.zeros(len(nodes), dtype=int), (nodes * FULL).astype(int)))
    x = own.anchors / FULL
    corner = np.where(x > 0.5, 1.0, 0.0)
    near = np.abs(x - corner)  # distances from the square's corner, 0 to 0.5
    # Triangle of the centre, the corner and the side's midpoint: barycentric coordinates.
    middle = 2 * near.min(axis=1, keepdims=True)
    edge = 2 * (near.max(axis=1, keepdims=True) - near.min(axis=1, keepdims=True))
    mid = np.where(near == near.max(axis=1, keepdims=True), 0.5, corner)
    image = np.where((corner == 1).all(axis=1, keepdims=True), 0.65, corner)
    return own, middle * centre + edge * mid + (1 - middle - edge) * image


def test_local_knots() -> None:
    own = t_spline(octree(cube(2), np.zeros(2, dtype=int), np.array([[FULL // 2] * 2, [3 * FULL // 4] * 2])))
    assert own.space.n == 14
    assert knots_at(own, 0.5, 0.5)[0].tolist() == [-0.5, 0, 0.5, 0.75, 1]
    assert knots_at(own, 0.75, 0.75)[0].tolist() == [0, 0.5, 0.75, 1, 1.25]
    assert knots_at(own, 0.0, 0.0)[0].tolist() == [-1, -0.5, 0, 0.5, 1]
    # From (0.75, 0.5) upwards the fine cells count, downwards the coarse one whose side the anchor lies on.
    assert knots_at(own, 0.75, 0.5)[1].tolist() == [-0.5, 0, 0.5, 0.75, 1]
    even = t_spline(uniform(cube(3), 2))
    expected = (even.anchors[..., None] + FULL // 4 * np.arange(-2, 3)).tolist()
    assert even.knots.tolist() == expected


@pytest.mark.parametrize("dim", [2, 3])
def test_sums_at_corners_of_uniform_meshes(dim: int) -> None:
    own = t_spline(uniform(cube(dim), 2))
    corners = cube(dim).cell.vertices
    assert np.abs(blending(own, corners).sum(axis=1) - (5 / 6) ** dim).max() < 1e-14
    inner = 0.25 + 0.5 * np.random.default_rng(3).random((50, dim))
    assert np.abs(blending(own, inner).sum(axis=1) - 1).max() < 1e-14


@pytest.mark.parametrize("dim", [2, 3])
def test_elements_carry_the_functions_exactly(dim: int) -> None:
    own = t_spline(graded(dim, 4, 5))
    rng = np.random.default_rng(7)
    assert np.prod((own.high - own.low) / FULL, axis=1).sum() == 1.0
    worst = 0.0
    for e in range(0, len(own.low), 3):
        number, element = own.element[e]
        block = own.space.blocks[number]
        xi = rng.random((5, dim))
        x = (own.low[e] + xi * (own.high[e] - own.low[e])) / FULL
        values = np.zeros((5, own.space.n))
        C = dense_extraction(block, np.array([element]))
        assert C is not None
        values[:, block.dofs[element]] = block.basis.tabulate(xi, 0)[0] @ C[0].T
        worst = max(worst, np.abs(values - blending(own, x)).max())
    assert worst < 1e-14


@pytest.mark.parametrize(("dim", "rounds", "least"), [(2, 5, 50), (3, 2, 100)])
def test_functions_are_twice_differentiable(dim: int, rounds: int, least: int) -> None:
    """Values and derivatives of all B_a and of S from the two elements that meet at a point of an inner face."""
    own = t_spline(graded(dim, rounds, 11))
    rng = np.random.default_rng(13)
    points = rng.random((own.space.n, 3))

    def derivatives(e: int, x: np.ndarray) -> list[np.ndarray]:
        """Orders 0, 1 and 2 of all functions, and of the components of S."""
        number, element = own.element[e]
        block, size = own.space.blocks[number], (own.high[e] - own.low[e]) / FULL
        table = block.basis.tabulate(((x - own.low[e] / FULL) / size)[None], 2)
        C = dense_extraction(block, np.array([element]))
        assert C is not None
        found = []
        for order, values in enumerate(table):
            full = np.zeros((own.space.n, dim**order))
            scale = [1 / size, np.multiply.outer(1 / size, 1 / size)][order - 1].ravel() if order else np.ones(1)
            full[block.dofs[element]] = C[0] @ values[0].reshape(block.basis.n, -1) * scale
            found.append(full)
        # S W = A: each derivative of S from those of A and W.
        (W, A), (W1, A1), (W2, A2) = ((full.sum(axis=0), points.T @ full) for full in found)
        S = A / W
        S1 = (A1 - S * W1) / W
        cross = np.einsum("ci,j->cij", S1, W1)
        S2 = (A2 - S * W2 - (cross + cross.swapaxes(1, 2)).reshape(3, -1)) / W
        return [*found, S, S1, S2]

    seen = 0
    for e in range(len(own.low)):
        for axis in range(dim):
            if own.low[e, axis] == 0:
                continue
            x = own.low[e] + rng.random(dim) * (own.high[e] - own.low[e])
            x[axis] = own.low[e, axis]
            below = x.copy()
            below[axis] -= 1
            other = int(np.flatnonzero(((own.low <= below) & (below < own.high)).all(axis=1))[0])
            for number, (here, there) in enumerate(zip(derivatives(e, x / FULL), derivatives(other, x / FULL))):
                assert np.abs(here - there).max() < 1e-10 * max(1.0, float(np.abs(here).max())), number
            seen += 1
    assert seen > least


@pytest.mark.parametrize("dim", [2, 3])
def test_the_sum_of_the_functions_never_vanishes(dim: int) -> None:
    """Its Bernstein coefficients, and so itself, are well above zero on every element of strongly graded meshes."""
    for seed in range(4):
        own = t_spline(graded(dim, 6 if dim == 2 else 3, seed))
        least = min(
            float(bezier_coefficients(block, np.ones((own.space.n, 1)))[..., 0].min()) for block in own.space.blocks
        )
        assert least > 0.4 if dim == 2 else least > 0.3


@pytest.mark.parametrize("dim", [2, 3])
def test_quotient_and_its_derivative(dim: int) -> None:
    own = t_spline(graded(dim, 3, 2))
    rng = np.random.default_rng(19)
    x = 0.01 + 0.98 * rng.random((20, dim))
    assert np.abs(collocation(own, x).sum(axis=1) - 1).max() < 1e-14
    points = np.zeros((own.space.n, 3))
    points[:, :dim] = rng.random((own.space.n, dim))
    domain = Domain(own.space, points)
    for e in range(0, len(own.low), 5):
        number, element = own.element[e]
        chunk = Chunk(domain, int(number), np.array([element]), np.full((1, dim), 0.4), np.ones(1))
        size = (own.high[e] - own.low[e]) / FULL
        at = own.low[e] / FULL + 0.4 * size
        for axis in range(dim):
            step = np.eye(dim)[axis] * 1e-5
            slope = (collocation(own, (at + step)[None]) - collocation(own, (at - step)[None])) @ points / 2e-5
            assert np.abs(chunk.J[0, 0, :, axis] / size[axis] - slope[0]).max() < 1e-7


@pytest.mark.parametrize(
    ("fine", "centre", "share", "least", "condition"),
    [
        (False, 0.38, 0.0374, -0.994, 4.6), (True, 0.38, 0.0027, -0.562, 6.9),
        (False, 0.5, 0.066, -0.994, 4.6), (True, 0.5, 0.014, -0.566, 6.9),
    ],
)
def test_figure_4(fine: bool, centre: float, share: float, least: float, condition: float) -> None:
    own, images = square(fine, centre)
    control, report = interpolate(own, images)
    assert report["condition"] == pytest.approx(condition, abs=0.05)
    assert report["residual"] < 1e-12
    domain = Domain(own.space, np.column_stack([control, np.zeros(len(control))]))
    negative, smallest, n = 0, 1.0, 400
    for e in range(len(own.low)):
        count = (own.high[e] - own.low[e]) * n // FULL
        grid = [(np.arange(m) + 0.5) / m for m in count]
        xi = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 2)
        number, element = own.element[e]
        J = Chunk(domain, int(number), np.array([element]), xi, np.ones(len(xi))).J[0]
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        scaled = det / np.linalg.norm(J[..., 0], axis=1) / np.linalg.norm(J[..., 1], axis=1)
        negative, smallest = negative + int((det < 0).sum()), min(smallest, float(scaled.min()))
    assert negative / n**2 == pytest.approx(share, abs=5e-4 if share > 0.05 else 5e-5 if share != 0.014 else 5e-4)
    assert smallest == pytest.approx(least, abs=5e-4)


def test_identity_deviates_to_first_order() -> None:
    """The quotient reproduces constants only (measured: 4.3e-2, 1.7e-2, 8.4e-3 on 2, 4, 8 cells per side)."""
    x = np.random.default_rng(23).random((20_000, 2))
    for level, expected in ((1, 4.3e-2), (2, 1.7e-2), (3, 8.4e-3)):
        own = t_spline(uniform(cube(2), level))
        control, _ = interpolate(own, own.anchors / FULL)
        assert np.abs(collocation(own, x) @ control - x).max() == pytest.approx(expected, rel=0.05)


def test_conditioning_is_harmless() -> None:
    even = t_spline(uniform(cube(3), 2))
    assert interpolate(even, even.anchors / FULL)[1]["condition"] == pytest.approx(17, abs=0.5)
    many = t_spline(graded(3, 5, 3, level=2))
    assert many.space.n > 300
    estimate = interpolate(many, many.anchors / FULL)[1]
    exact = np.linalg.cond(collocation(many, many.anchors / FULL).toarray())
    assert estimate["condition"] == pytest.approx(exact, rel=0.05)
    assert estimate["condition"] < 60
    assert estimate["residual"] < 1e-12


def solid(own: TSpline, amount: float = 0.1) -> Domain:
    block, xi = places_of(own, own.anchors)
    x = place(own.blocks, block, xi)
    control, _ = interpolate(own, x + amount * np.sin(np.pi * x[:, [1, 2, 0]]))
    return Domain(own.space, control, boundaries(own))


@pytest.mark.parametrize("blocks", [ring(), ring(4), polycube([(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)], 3)])
def test_polycubes(blocks: object) -> None:
    tmesh = refined(uniform(blocks, 1, 1), np.array([3, 20]))  # type: ignore[arg-type]
    own = t_spline(tmesh)
    domain = solid(own)
    check(domain)
    assert (certify(domain).verdict == 1).all()
    assert sorted(domain.boundaries) == sorted(f"side{k}" for k in range(len(tmesh.blocks.boundary_sides)))
    flux, content = np.zeros(3), 0.0
    for chunk in facet_chunks(domain, list(domain.boundaries), 8):
        flux += np.einsum("eqc,eq->c", chunk.normal, chunk.dx)
        content += float(np.einsum("eqc,eqc,eq->", chunk.x, chunk.normal, chunk.dx)) / 3
    assert np.abs(flux).max() < 1e-7
    assert content == pytest.approx(volume(domain, 8), rel=1e-6)


def test_analysis_on_t_splines() -> None:
    own = t_spline(refined(uniform(cube(), 1, 1), np.array([7])))
    domain = solid(own)
    check(domain)
    certificate = certify(domain)
    assert (certificate.verdict == 1).all()
    with pytest.raises(DependentTracesError, match="weakly"):
        dirichlet(domain, {"*": 0.0})
    solution = solve_exact(domain, "heat", "1+x-2*y+3*z", points=8)[0]
    assert solution.log["weak"]
    assert solution.norms is not None
    assert solution.norms.h1 < 1e-8


def test_files_keep_the_quotient(tmp_path: Path) -> None:
    domain = solid(t_spline(uniform(cube(), 1)))
    save(domain, tmp_path / "solid.npz")
    for again in (read_bext(write_bext(tmp_path / "solid.bext", domain)), load(tmp_path / "solid.npz")):
        check(again)
        assert volume(again) == pytest.approx(volume(domain), rel=1e-12)
    assert write_vtu(tmp_path / "solid.vtu", domain).is_file()


def test_certificate_sees_the_quotient() -> None:
    """det J of the rational map at the corner of a uniform mesh, where the functions sum to (5/6)^3."""
    own = t_spline(uniform(cube(), 1))
    domain = solid(own, 0.2)
    certificate = certify(domain, tolerance=1e-3)
    least = np.inf
    for number, block in enumerate(domain.space.blocks):
        xi = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        least = min(least, Chunk(domain, number, np.arange(block.elements), xi, np.ones(len(xi))).det.min())
    assert certificate.lower.min() <= least
    assert certificate.upper.min() == pytest.approx(least, rel=0.05)


def test_bad_input() -> None:
    with pytest.raises(InputError, match="no unit cube"):
        t_spline(uniform(seven(3), 1))
    own = t_spline(uniform(ring(), 1))
    with pytest.raises(InputError, match="point 1 lies outside"):
        blending(own, np.array([[0.1, 0.1, 0.1], [0.375, 0.375, 0.1]]))
    weights = np.full(own.space.n, 1.0)
    dark = tuple(
        replace(b, extraction=replace(b.extraction, C=b.extraction.C * 0.0))  # type: ignore[union-attr, type-var]
        for b in own.space.blocks
    )
    with pytest.raises(InputError, match="weight function"):
        check(Domain(Space(dark, own.space.n, weights), np.zeros((own.space.n, 3))))
