"""Shapes from code: volumes and areas in closed form, certificates, names, patch tests, rates."""

from __future__ import annotations

import inspect
import time

import numpy as np
import pytest

from geometry.nurbs import source
from geometry.nurbs.shapes import SHAPES, bench_cube, hollow_sphere_octant, thick_ring, torus
from geometry.nurbs.source import build, refine
from geometry.patch import evaluate
from iga.assembly import integral, matrix, vector, volume
from iga.certificate import certify, summary
from iga.chunk import Chunk
from iga.conditions import dirichlet
from iga.domain import Domain, all_facets, check
from iga.errors import InputError
from iga.integrands import Diffusion, Load
from iga.linear.solvers import solve
from iga.norms import errors

PI = np.pi
# name, parameters, volume, areas of named boundaries
CASES = [
    ("box", {"length": 2.0, "width": 3.0, "degree": 2}, 6, {"x0": 3, "x1": 3, "y0": 2, "z1": 6}),
    ("cube", {"side": 2.0}, 8, {"x0": 4, "x1": 4, "y0": 4, "y1": 4, "z0": 4, "z1": 4}),
    ("thick_ring", {"height": 3.0}, 2.25 * PI, {"inner": 1.5 * PI, "outer": 3 * PI, "start": 3, "z0": 0.75 * PI}),
    ("thick_ring", {"angle": 300}, 2.5 * PI, {"inner": 5 / 3 * PI, "start": 1, "end": 1}),
    ("thick_ring", {"angle": 360}, 3 * PI, {"inner": 2 * PI, "outer": 4 * PI, "z0": 3 * PI, "z1": 3 * PI}),
    ("hollow_sphere_octant", {}, 7 / 6 * PI, {"inner": PI / 2, "outer": 2 * PI, "x0": 0.75 * PI, "y0": 0.75 * PI}),
    ("ball", {"radius": 2.0}, 32 / 3 * PI, {"sphere": 16 * PI}),
    ("cylinder", {"radius": 2.0, "height": 3.0}, 12 * PI, {"outer": 12 * PI, "z0": 4 * PI, "z1": 4 * PI}),
    ("torus", {"angle": 90}, PI**2 / 4, {"outer": PI**2, "start": PI / 4, "end": PI / 4}),
    ("torus", {"angle": 360, "major": 3.0, "minor": 1.0}, 6 * PI**2, {"outer": 12 * PI**2}),
    ("plate_with_hole", {"thickness": 2.0}, 32 - PI / 2, {"hole": PI, "x0": 6, "x1": 8, "y0": 6, "z0": 16 - PI / 4}),
    ("fichera", {}, 7, {"reentrant": 3, "x0": 4, "x1": 3, "y0": 4, "y1": 3, "z0": 4, "z1": 3}),
    ("bench_cube", {"degree": 3, "elements": 2}, 1, {"x0": 1, "x1": 1, "y0": 1, "y1": 1, "z0": 1, "z1": 1}),
]
IDS = [f"{name} {i}" for i, (name, *_) in enumerate(CASES)]


@pytest.mark.parametrize(("name", "parameters", "size", "areas"), CASES, ids=IDS)
def test_measures_names_and_certificates(name: str, parameters: dict, size: float, areas: dict[str, float]) -> None:
    for refinement in ({}, {"refine": 1, "elevate": 1}):
        domain = build(name, **parameters, **refinement)
        check(domain)
        points = 8 if domain.space.weights is None else 12
        assert volume(domain, points) == pytest.approx(size, rel=1e-11)
        found = summary(certify(domain))
        assert found["undecided"] == found["refuted"] == 0
    assert set(areas) <= set(domain.boundaries)
    assert not [n for n in domain.boundaries if n.startswith("patch")]
    for boundary, area in areas.items():
        assert float(integral(domain, points=14, boundary=boundary)) == pytest.approx(area, rel=1e-10)
    assert domain.report["parts"] == 1


def test_all_shapes_are_covered() -> None:
    assert {name for name, *_ in CASES} == set(SHAPES)


def test_points_lie_on_their_surfaces() -> None:
    u = np.random.default_rng(23).uniform(size=(200, 3))
    for patch in hollow_sphere_octant(1.0, 2.5).patches:
        x = evaluate(patch, u)
        assert np.abs(np.linalg.norm(x, axis=1) - (1 + 1.5 * u[:, 0])).max() < 1e-14
        assert (x >= -1e-15).all()
    x = evaluate(thick_ring(angle=200).patches[0], u)
    assert np.abs(np.hypot(x[:, 0], x[:, 1]) - (1 + u[:, 0])).max() < 1e-14
    for patch in torus(angle=360).patches[1:]:
        x = evaluate(patch, np.column_stack([np.ones(200), u[:, 1:]]))
        assert np.abs(np.hypot(np.hypot(x[:, 0], x[:, 1]) - 2, x[:, 2]) - 0.5).max() < 1e-14


def test_bench_cube_is_the_stated_map() -> None:
    u = np.random.default_rng(41).uniform(size=(200, 3))
    g = 4 * np.prod(u * (1 - u), axis=1)
    for degree, elements in ((2, 1), (3, 5), (5, 3)):
        (patch,) = bench_cube(degree, elements).patches
        assert patch.degree == (degree,) * 3
        assert patch.control.shape == (*(degree + elements,) * 3, 3)
        assert np.abs(evaluate(patch, u) - u - g[:, None] * [0.3, -0.3, 0.2]).max() < 1e-14
    with pytest.raises(InputError, match="degree 1"):
        bench_cube(1, 4)


def test_large_bench_cube_is_fast() -> None:
    start = time.process_time()
    domain = build("bench_cube", degree=3, elements=64)
    assert time.process_time() - start < 3
    assert domain.space.n == 67**3
    assert [f.shape for f in domain.space.blocks[0].extraction.factors] == [(5, 4, 4)] * 3  # type: ignore[union-attr]


@pytest.mark.parametrize(("name", "parameters"), [(n, p) for n, p, *_ in CASES], ids=IDS)
def test_patch_test(name: str, parameters: dict) -> None:
    """K u = flux for linear u, function by function: fails if faces are glued wrongly or facets are missing."""
    domain = build(name, **parameters, refine=1)
    a = np.array([1.0, 2.0, -0.5])

    def flux(chunk: Chunk) -> np.ndarray:
        return ((chunk.dx * (chunk.normal @ a))[:, None, :] @ chunk.N)[:, 0]

    points = 7 if domain.space.weights is None else 10
    force = vector(domain, flux, points, list(domain.boundaries))
    assert np.abs(matrix(domain, Diffusion(), points) @ (domain.points @ a) - force).max() < 1e-9 * np.abs(force).max()
    assert sum(len(f.elements) for f in all_facets(domain)) == sum(
        len(f.elements) for parts in domain.boundaries.values() for f in parts
    )


def exact(x: np.ndarray) -> np.ndarray:
    return np.sin(1.3 * x[..., 0]) * np.cos(x[..., 1]) * np.exp(0.5 * x[..., 2])


def gradient(x: np.ndarray) -> np.ndarray:
    a, b, c = 1.3 * x[..., 0], x[..., 1], np.exp(0.5 * x[..., 2])
    return np.stack([1.3 * np.cos(a) * np.cos(b) * c, -np.sin(a) * np.sin(b) * c, 0.5 * np.sin(a) * np.cos(b) * c], -1)


def error(domain: Domain, points: int) -> np.ndarray:
    K = matrix(domain, Diffusion(), points)
    f = vector(domain, Load(lambda x: (1.3**2 + 1.0 - 0.25) * exact(x)), points)
    u, _ = solve(K, f, fixed=dirichlet(domain, {"*": exact}, points=points))
    found = errors(domain, u, exact, gradient, points + 1)
    return np.array([found.relative_l2, found.relative_h1])


@pytest.mark.parametrize(
    ("name", "degree", "start", "levels", "cap"),
    [
        ("cube", 1, 4, 3, 2e-3),
        ("bench_cube", 2, 3, 3, 1e-4),
        ("bench_cube", 3, 3, 3, 1e-5),
        pytest.param("bench_cube", 4, 2, 3, 1e-6, marks=pytest.mark.long),
        pytest.param("bench_cube", 5, 2, 3, 1e-6, marks=pytest.mark.long),
        ("cylinder", 2, 0, 4, 1e-4),
        pytest.param("hollow_sphere_octant", 4, 0, 4, 1e-6, marks=pytest.mark.long),
    ],
)
def test_rates(name: str, degree: int, start: int, levels: int, cap: float) -> None:
    """L2 rate p + 1, H1 rate p, of B-splines p = 1..5 and rational solids (higher while levels are coarse)."""
    if start:
        found = [error(build(name, degree=degree, elements=start * 2**k), degree + 1) for k in range(levels)]
    else:
        domains = [build(name, degree=degree)]
        for _ in range(levels - 1):
            domains.append(refine(domains[-1]))
        found = [error(d, degree + 2) for d in domains]
    rates = np.log2(found[-2] / found[-1])
    assert found[-1][0] < cap
    assert abs(rates[0] - degree - 1) < 0.1 or rates[0] > degree + 1
    assert abs(rates[1] - degree) < 0.1 or rates[1] > degree


@pytest.mark.parametrize(
    ("name", "parameters", "said"),
    [
        ("thick_ring", {"inner": 2.0, "outer": 1.0}, "outer - inner is -1"),
        ("thick_ring", {"angle": 400.0}, "400 degrees"),
        ("cube", {"side": 0.0}, "side|length is 0"),
        ("cube", {"degree": 0}, "degree 0"),
        ("cube", {"elements": 100000}, "elements"),
        ("cube", {"elements": "1e3"}, "1000 elements in each direction need 8e\\+09 table entries; take less"),
        ("cube", {"radius": 1.0}, "no parameter 'radius'; there are: elevate, degree, refine"),
        ("cube", {"degree": "three"}, "degree must be a whole number from 0 to 30, not 'three'"),
        ("torus", {"major": float("nan")}, "major must be a number, not nan"),
        ("cylinder", {"core": 1.0}, "core is 1"),
        ("fichera", {"refine": 40}, "refine=40"),
        ("fichera", {"elevate": -1}, "elevate must be a whole number from 0 on, not -1"),
        ("fichera", {"refine": 12, "elevate": 3}, "take less"),
    ],
)
def test_bad_parameters_are_named(name: str, parameters: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        build(name, **parameters)


def test_every_shape_and_its_measures_are_explained() -> None:
    explained = {line.split()[0]: line for line in (source.__doc__ or "").splitlines() if line.startswith("    ")}
    for name, maker in SHAPES.items():
        for key, measure in inspect.signature(maker).parameters.items():
            assert f"{key}={measure.default:g}" in explained[name]
