"""The source "meccano" end to end on small surfaces: validity, distance, refinement, files, bad input."""

from __future__ import annotations

import numpy as np
import pytest

import geometry
from geometry.meccano import Settings, domain_of
from geometry.meccano.shapes import ball, star
from iga import InputError
from iga.assembly import volume
from iga.certificate import certify, summary
from iga.domain import check
from iga.locate import locate
from iga.store import load, save


@pytest.fixture(scope="module")
def solid():
    return domain_of(ball(16), Settings(max_cells=500, tolerance=0.01, smoothing=1), "ball")


def test_ball_is_certified_and_near(solid):
    check(solid)
    made = summary(certify(solid))
    assert made["certified"] == sum(b.elements for b in solid.space.blocks)
    distance = solid.report["distance"]
    assert distance["relative"] < 0.01
    assert volume(solid, 5) == pytest.approx(solid.report["surface_volume"], rel=5e-3)
    assert solid.report["cells"] == made["certified"]
    assert solid.report["uncertified_cells"] == []
    assert {"surface", "boundary_map", "solid"} & set(solid.report["seconds"])


def test_boundaries_cover_the_surface(solid):
    names = set(solid.boundaries)
    assert names == {"boundary", *(f"side{k}" for k in range(6))}
    parts = [sum(len(f.elements) for f in solid.boundaries[f"side{k}"]) for k in range(6)]
    assert sum(len(f.elements) for f in solid.boundaries["boundary"]) == sum(parts)


def test_refinement_keeps_the_solid_also_through_a_file(solid, tmp_path):
    save(solid, tmp_path / "solid.npz")
    loaded = load(tmp_path / "solid.npz")
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 3))
    before = locate(solid, points)
    assert (before.element >= 0).all()
    cells = np.array([0, 5])
    for finer in (geometry.refine(loaded), geometry.meccano.refine(loaded, cells=cells)):
        check(finer)
        assert finer.space.n > solid.space.n
        assert volume(finer, 5) == pytest.approx(volume(solid, 5), rel=1e-12)
        assert set(finer.boundaries) == set(solid.boundaries)
        assert (certify(finer).verdict == 1).all()
    again = geometry.meccano.refine(geometry.meccano.refine(loaded, cells=cells), cells=np.array([3]))
    assert volume(again, 5) == pytest.approx(volume(solid, 5), rel=1e-12)


@pytest.mark.long
def test_bumps_need_more_cells():
    made = domain_of(star(24), Settings(max_cells=1500, tolerance=0.001, smoothing=0, off="keep"), "star")
    assert (certify(made).verdict == 1).all()
    assert made.report["cells"] > 448
    assert made.report["distance"]["relative"] < 0.006


def test_bad_settings_and_surfaces_are_refused(solid, tmp_path):
    with pytest.raises(InputError, match="no parameter"):
        geometry.build(tmp_path / "x.off", "meccano", wrong=1)
    with pytest.raises(InputError, match="tolerance"):
        geometry.build(tmp_path / "x.off", "meccano", tolerance="-1")
    with pytest.raises(InputError, match="meccano must be one of"):
        geometry.build(tmp_path / "x.off", "meccano", meccano="ball")
    with pytest.raises(InputError, match="too many"):
        domain_of(ball(8), Settings(max_cells=6))
    with pytest.raises(InputError, match="elevated"):
        geometry.refine(solid, elevate=1)
    with pytest.raises(InputError, match="no cell"):
        geometry.meccano.refine(solid, cells=np.array([10**6]))
    whole = ball(4)
    lines = [f"OFF\n{len(whole.points)} {len(whole.triangles) - 1} 0"]
    lines += [" ".join(map(str, p)) for p in whole.points.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in whole.triangles[1:].tolist()]
    (tmp_path / "open.off").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="not closed"):
        geometry.build(tmp_path / "open.off", "meccano")
