"""Strategies of refinement: what each keeps, in numbers."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import geometry
from geometry.hybrid.comparison import preserved
from geometry.hybrid.refinement import refine
from geometry.hybrid.shell import Shell
from geometry.hybrid.subdividing import refined, subdivided
from geometry.hybrid.volume import complete
from iga.bernstein import bernstein
from iga.block import bezier_coefficients
from iga.certificate import certify
from iga.domain import counts
from iga.errors import InputError
from tests.geometry.hybrid_skins import ball, bend, spline_box

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("netgen") is None or importlib.util.find_spec("OCP") is None,
    reason="the extra for CAD is not installed",
)
SETTINGS = {"size": 0.6, "tolerance": 1e-3, "subdivide": 0, "refine": 1}
ROUNDING = 1e-11


def built(strategy: str, layers: int = 0):
    made = geometry.build("curved_box", "hybrid", **SETTINGS, strategy=strategy, layers=layers)
    assert (certify(made).verdict > 0).all()
    assert made.report["strategy"] == strategy
    return made, made.report["preserved"]


def test_cutting_every_cell_keeps_everything():
    made, kept = built("kept", 3)
    assert set(counts(made)) == {"tetrahedron", "wedge"}
    assert all(kept[key] < ROUNDING for key in ("skin", "skin_map", "inside_map", "nested"))
    assert kept["skin_crossing"] == kept["inside_crossing"] == 0.0


@pytest.mark.long
def test_filling_anew_keeps_the_skin_alone():
    for strategy in ("recomputed", "layers"):
        _, kept = built(strategy)
        assert kept["skin"] < ROUNDING
        assert kept["skin_map"] < ROUNDING
        assert kept["skin_crossing"] == 0.0
        assert kept["inside_crossing"] > 0.0
        assert kept["nested"] > 1e-3


@pytest.mark.long
def test_layers_cut_after_tracing_are_nested_where_layers_are():
    made, kept = built("layers", 3)
    again, anew = built("recomputed", 3)
    assert set(counts(made)) == set(counts(again)) == {"tetrahedron", "wedge"}
    assert kept["skin_map"] < ROUNDING
    assert anew["skin_map"] < ROUNDING
    assert kept["nested"] < anew["nested"]
    assert kept["inside_crossing"] < anew["inside_crossing"]


@pytest.mark.long
def test_building_from_a_finer_b_rep_comes_nearer():
    made, kept = built("trimmed")
    coarse = geometry.build("curved_box", "hybrid", **{**SETTINGS, "refine": 0})
    assert made.report["distance"]["relative"] < 0.3 * coarse.report["distance"]["relative"]
    assert 1e-6 < kept["skin"] < 1e-3
    with pytest.raises(InputError, match="strategy must be one of"):
        geometry.build("curved_box", "hybrid", strategy="magic")


def test_a_volume_with_pyramids_changes_only_in_them():
    coarse = complete(spline_box(1, 2, warp=bend))
    kept = preserved(coarse, refine(coarse))
    assert kept.skin < ROUNDING
    assert kept.skin_map < ROUNDING
    assert 0.0 < kept.inside_map < 0.1


def test_cut_skins_have_more_functions_on_the_same_surface():
    for skin in (spline_box(2, 3, warp=bend), ball(2, 3, (True,) * 6)):
        field = np.random.default_rng(1).standard_normal((skin.space.n, 2))
        plain = subdivided(skin)
        fine, values = refined(skin, field)
        assert isinstance(fine, Shell)
        assert fine.space.n > skin.space.n
        for a, b in zip(plain.space.blocks, fine.space.blocks):
            assert b.basis == bernstein(b.basis.cell, b.basis.degree)
            assert np.abs(bezier_coefficients(a, skin.points) - bezier_coefficients(b, fine.points)).max() < 1e-13
            assert np.abs(bezier_coefficients(a, field) - bezier_coefficients(b, values)).max() < 1e-12
