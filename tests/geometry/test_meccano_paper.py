"""The paper's solids by the source: tetrahedra, T-splines and clamped splines on a cube, remedies, analysis on them."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import geometry
from geometry.layouts.blocks import cube, place
from geometry.meccano import Settings, domain_of, source
from geometry.meccano.bisection import kuhn, oriented, refine_all
from geometry.meccano.domain import bare
from geometry.meccano.fitting import greville_points
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.interpolation import interpolate
from geometry.meccano.paper import (
    Fit,
    apart,
    at_cells,
    boundary_triangles,
    fit,
    inner,
    judged,
    nodes_of,
    remedied,
    untangled,
)
from geometry.meccano.parametrisation import LEVELS, Parametrisation
from geometry.meccano.shapes import ball
from geometry.meccano.t_spline import t_spline
from geometry.meccano.tmesh import octree, refined, uniform
from geometry.simplices.surface import Surface, volume
from iga import InputError
from iga.assembly import volume as content
from iga.certificate import certify
from iga.domain import Domain, check
from iga.locate import places
from iga.progress import QUIET
from iga.store import load, save
from problems import elasticity
from problems.manufactured import solve_exact

FULL = 1 << LEVELS


@pytest.fixture(scope="module")
def solids() -> dict[str, Domain]:
    """The ball in both spaces, on the same octree, with one division of its surface."""
    surface = ball(8)
    mapping = source.map_of(surface, Settings(meccano="cube"), QUIET)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source, "map_of", lambda *_: mapping)
        return {
            space: domain_of(surface, Settings(meccano="cube", space=space, tolerance=0.03), "ball")
            for space in ("t-spline", "optimal")
        }


def test_report_of_the_stages(solids: dict[str, Domain]) -> None:
    for domain in solids.values():
        check(domain)
        report = domain.report
        assert report["tets"]["inverted"] == 0
        for stage in report["tets"]["stages"]:
            assert len(stage["sweeps"]) >= 1
            assert {"before", "after", "nodes", "tets"} <= set(stage)
        assert {"boundary_map", "tetrahedra", "octree", "interpolation", "remedy"} <= set(report["seconds"])
        assert report["distance"]["relative"] < 0.03
        assert report["refuted"]["after"] == int((certify(domain).verdict == -1).sum())
    one, two = (solids[space].report for space in ("t-spline", "optimal"))
    assert one["cells"] == two["cells"]
    assert one["between_spaces"] == pytest.approx(two["between_spaces"], rel=1e-6)
    assert 0 < one["between_spaces"]["relative"] < 0.05


def test_t_splines_interpolate_the_tetrahedra(solids: dict[str, Domain]) -> None:
    report = solids["t-spline"].report
    assert report["residual"] < 1e-12
    assert report["condition"] < 60
    triangles = boundary_triangles(solids["t-spline"])
    assert volume(Surface(*triangles)) == pytest.approx(content(solids["t-spline"], 8), rel=2e-2)


@pytest.mark.parametrize("space", ["t-spline", "optimal"])
def test_patch_test_and_files(solids: dict[str, Domain], space: str, tmp_path) -> None:
    save(solids[space], tmp_path / "solid.npz")
    domain = load(tmp_path / "solid.npz")
    solution = solve_exact(domain, "heat", "1+x-2*y+3*z", points=8 if space == "t-spline" else None)[0]
    assert solution.norms is not None
    assert solution.norms.h1 < 1e-8
    assert solution.log["weak"] == (space == "t-spline")


def test_displacements_are_imposed_weakly() -> None:
    own = t_spline(uniform(cube(), 1))
    x = own.anchors / FULL
    domain = bare(own, interpolate(own, x + 0.05 * np.sin(np.pi * x[:, [1, 2, 0]]))[0])
    solution = solve_exact(domain, "elasticity", "x+2*y;3*z-y;0.5*x", points=8)[0]
    assert solution.log["weak"]
    assert solution.norms is not None
    assert solution.norms.h1 < 1e-8
    with pytest.raises(InputError, match="value for each component"):
        elasticity.solve(elasticity.Elasticity(displacement={"side0": (0.0, None, 0.0)}), domain)
    with pytest.raises(InputError, match="move freely"):
        elasticity.solve(elasticity.Elasticity(traction={"side0": (1.0, 0.0, 0.0)}), domain)


@pytest.mark.parametrize("space", ["t-spline", "optimal"])
def test_both_ways_of_the_map(solids: dict[str, Domain], space: str) -> None:
    """From the meccano to the solid and back, and from the solid to the meccano and back."""
    domain, rng = solids[space], np.random.default_rng(5)
    inside = rng.uniform(-0.5, 0.5, (40, 3))
    found = domain.locate(inside)
    assert (found.element >= 0).all()
    assert np.abs(places(domain, found.block, found.element, found.xi) - inside).max() < 1e-9
    sizes = [block.elements for block in domain.space.blocks]
    block = rng.integers(0, len(sizes), 40)
    element, xi = rng.integers(0, np.array(sizes)[block]), rng.uniform(0.05, 0.95, (40, 3))
    back = domain.locate(places(domain, block, element, xi))
    assert (back.block == block).all()
    assert (back.element == element).all()
    assert np.abs(back.xi - xi).max() < 1e-6
    assert (domain.locate(np.full((1, 3), 3.0)).element == -1).all()
    with pytest.raises(InputError, match="no element"):
        places(domain, np.array([0]), np.array([-1]), xi[:1])


def test_refinement(solids: dict[str, Domain]) -> None:
    with pytest.raises(InputError, match="space=optimal"):
        geometry.refine(solids["t-spline"])
    finer = geometry.meccano.refine(solids["optimal"], cells=np.array([0]))
    assert content(finer, 5) == pytest.approx(content(solids["optimal"], 5), rel=1e-12)


def test_cells_are_judged() -> None:
    """Centres and Gauss points are judged cell by cell, whatever the elements are."""
    own = t_spline(refined(uniform(cube(), 2), np.array([0])))
    x = own.anchors / FULL
    tmesh = own.tmesh
    straight = Fit(tmesh, own, interpolate(own, x)[0])
    numbers, bad = judged(straight)
    assert not bad.any()
    assert numbers.negative_gauss == 0
    assert numbers.least > 0.8
    mirrored = Fit(tmesh, own, straight.points * [1.0, 1.0, -1.0])
    numbers, bad = judged(mirrored)
    assert bad.all()
    assert numbers.negative_gauss == numbers.negative_centre == numbers.cells
    space = hierarchy(tmesh)
    linear = Fit(tmesh, space, place(tmesh.blocks, *greville_points(space)))
    gap = apart(straight, linear)
    assert 0.0 < gap["rms"] < gap["largest"] < 0.08
    places, J = at_cells(linear, np.full((1, 3), 0.5))
    assert np.abs(places[:, 0] - (tmesh.corner + 0.5 * tmesh.size[:, None]) / FULL).max() < 1e-14
    sizes = (tmesh.size / FULL)[:, None, None]
    assert np.abs(J[:, 0] - sizes * np.eye(3)).max() < 1e-14
    assert np.abs(at_cells(straight, np.full((1, 3), 0.5))[1][:, 0] / sizes - np.eye(3)).max() < 0.3
    assert judged(linear)[0].volume == pytest.approx(1.0, abs=1e-13)
    assert 0 < inner(straight).sum() < own.space.n
    assert not inner(linear)[[0, -1]].any()


def folded_cube() -> Parametrisation:
    """Tetrahedra of the unit cube, one of their inner nodes far from where it belongs."""
    mesh = refine_all(kuhn(cube()), 6)
    tets, places_ = oriented(mesh)
    nodes = np.empty((len(mesh.ends), 3))
    nodes[tets] = places_ / FULL
    nodes[np.argmin(np.abs(nodes - 0.5).sum(axis=1))] = (1.0, 0.8, 0.9)
    return Parametrisation(mesh.blocks, tets, mesh.block, places_, nodes)


@pytest.mark.parametrize("kind", ["t-spline", "optimal"])
def test_remedies(kind: Literal["t-spline", "optimal"]) -> None:
    mapping = folded_cube()
    start = fit(kind, octree(mapping.blocks, *nodes_of(mapping)), mapping)
    best, history = remedied(kind, start, mapping, 2, 3000)
    assert history[0].negative_centre > 0
    assert history[0].cells < history[1].cells < history[2].cells
    assert judged(best)[0].negative_centre == min(row.negative_centre for row in history)
    assert len(remedied(kind, start, mapping, 2, history[0].cells)[1]) == 1
    # Moving inner control points mends this fold, which is not the boundary's; that stays bit by bit.
    mended = untangled(start)
    before, after = (certify(bare(own.space, own.points)).verdict for own in (start, mended))
    assert (before == -1).sum() > 0
    assert (after == 1).all()
    assert (mended.points[~inner(start)] == start.points[~inner(start)]).all()


def test_bad_settings() -> None:
    with pytest.raises(InputError, match="no pillowed form"):
        geometry.build("x.off", "meccano", meccano="pillowed", space="t-spline")
    with pytest.raises(InputError, match="measure"):
        geometry.build("x.off", "meccano", measure="area")
    with pytest.raises(InputError, match="remedy"):
        geometry.build("x.off", "meccano", remedy="hope")
