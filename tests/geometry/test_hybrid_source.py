"""The source "hybrid": settings, CAD in, volume out, refinement after saving."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import geometry
from geometry.hybrid.settings import Settings, parse
from iga.certificate import certify
from iga.domain import check, counts
from iga.errors import InputError
from iga.store import load, save
from problems.manufactured import solve_exact

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("netgen") is None or importlib.util.find_spec("OCP") is None,
    reason="the extra for CAD is not installed",
)


def test_settings_from_texts():
    assert parse({}) == Settings()
    made = parse({"solid": "2", "layers": "4", "omega": "0.75", "subdivide": "auto", "size": 0.1})
    assert (made.solid, made.layers, made.omega, made.subdivide, made.size) == (2, 4, 0.75, None, 0.1)
    for bad, message in (
        ({"colour": "red"}, "no parameter 'colour'"), ({"layers": "many"}, "layers must be a whole number"),
        ({"layers": 2.5}, "whole number"), ({"size": 3}, "from 0.0001 to 1, not 3"),
        ({"degree": 2}, "from 3 to 8, not 2"),
    ):
        with pytest.raises(InputError, match=message):
            parse(bad)


@pytest.fixture(scope="module")
def box():
    return geometry.build("curved_box", "hybrid", size=0.6, tolerance=1e-3, subdivide=0)


def test_shape_becomes_a_volume(box, tmp_path):
    check(box)
    assert (certify(box).verdict > 0).all()
    assert counts(box).keys() == {"tetrahedron"}
    assert len(box.boundaries) == 6
    assert box.report["volume_error"] < 1e-4
    assert box.report["watertight_gap"] < 1e-12
    assert box.report["distance"]["relative"] < 1e-3
    answer = solve_exact(box, "elasticity", "x+2*y;3*z-y;x-y+z")[1]
    assert answer["relative_h1_error"] < 1e-12
    save(box, tmp_path / "box.npz")
    one, two = geometry.refine(box, 1, 1), geometry.refine(load(tmp_path / "box.npz"), 1, 1)
    assert np.array_equal(one.points, two.points)
    assert one.space.blocks[0].basis.degree == (4,)
    assert one.space.blocks[0].elements == 8 * box.space.blocks[0].elements


def test_layers_from_cad():
    made = geometry.build("curved_box", "hybrid", size=0.6, tolerance=1e-3, layers=3, subdivide=0)
    assert counts(made).keys() == {"tetrahedron", "wedge"}
    assert (certify(made).verdict > 0).all()


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "model.obj"
    path.write_text("v 0 0 0\n")
    assert not geometry.sources()["hybrid"].reads(path)
    with pytest.raises(InputError, match="not a CAD file; STEP"):
        geometry.build(path, "hybrid")
    cube = geometry.build("cube", "nurbs")
    with pytest.raises(InputError, match="made by nurbs"):
        geometry.sources()["hybrid"].refine(cube)


@pytest.mark.long
@pytest.mark.parametrize(("file", "volume"), [
    ("block_through_hole", 74032.79), ("block_torus_fillet3", 94036.06), ("two_elliptical_edges", 81317.44),
])
def test_real_parts_are_certified(data, file, volume):
    domain = geometry.build(data / "cad" / f"{file}.step", "hybrid")
    assert (certify(domain).verdict > 0).all()
    assert domain.report["cad_volume"] == pytest.approx(volume, rel=1e-6)
    assert domain.report["volume_error"] < 1e-6
