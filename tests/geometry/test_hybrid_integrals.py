"""Volumes and areas of trimmed B-reps by Green's theorem."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.cad.integrals import closed_volume, integrals_of, strips_of, volume_spread
from geometry.cad.reading import read_cad
from geometry.hybrid.shapes import SHAPES

pytestmark = pytest.mark.skipif(importlib.util.find_spec("OCP") is None, reason="Open CASCADE is not installed")


def test_ball_is_known() -> None:
    found = integrals_of(SHAPES["ball"]())
    assert found.volume.sum() == pytest.approx(4.0 / 3.0 * np.pi, rel=1e-8)
    assert found.area.sum() == pytest.approx(4.0 * np.pi, rel=1e-8)
    assert np.abs(found.normal.sum(axis=0)).max() < 1e-8


@pytest.mark.parametrize("name", ["curved_box", "bracket", "curved_difference", "tetrapod"])
def test_shapes_agree_with_the_kernel(name: str) -> None:
    brep = SHAPES[name]()
    found = integrals_of(brep)
    assert found.volume.sum() == pytest.approx(brep.volume, rel=3e-7)
    assert found.area.sum() == pytest.approx(brep.area, rel=3e-7)
    assert volume_spread(brep, found) < 1e-6  # intersections are the kernel's, to 1e-7


def test_a_gap_shows() -> None:
    """A face moved outwards by a thousandth of a unit box: its normal is still there, its neighbours' ends are not."""
    brep = SHAPES["curved_box"](0.0)
    k = int(np.argmax([face.surface.control[..., 2].min() for face in brep.faces]))
    top = brep.faces[k]
    control = top.surface.control.copy()
    control[..., :2] = 0.5 + 1.001 * (control[..., :2] - 0.5)
    moved = replace(top, surface=replace(top.surface, control=control))
    gaping = replace(brep, faces=(*brep.faces[:k], moved, *brep.faces[k + 1 :]))
    assert volume_spread(brep, integrals_of(brep)) < 1e-12
    found, strips = integrals_of(gaping), strips_of(gaping)
    assert volume_spread(gaping, found) == pytest.approx(2e-3 * np.sqrt(3.0) / 6.0, rel=1e-2)
    # The strips lie in the plane of the lid and take back what it has too much.
    assert np.abs(found.normal.sum(axis=0) + strips.normal.sum(axis=0)).max() < 1e-12
    assert closed_volume(found, strips) == pytest.approx(1.0, abs=1e-12)


def test_moved_trimming_curves_leave_the_closed_volume() -> None:
    """Faces of plane surfaces trimmed elsewhere than at their edges: strips close them, whatever lies between."""
    brep = SHAPES["bracket"]()
    whole = closed_volume(integrals_of(brep), strips_of(brep))
    rng = np.random.default_rng(731)
    faces = []
    for face in brep.faces:
        if face.kind == "plane":
            larger = 1.0 + 1e-3 * rng.random()
            face = replace(face, loops=tuple(
                tuple(replace(c, curve=replace(c.curve, control=larger * c.curve.control)) for c in loop)
                for loop in face.loops
            ))  # fmt: skip
        faces.append(face)
    moved = replace(brep, faces=tuple(faces))
    found, strips = integrals_of(moved), strips_of(moved)
    assert np.linalg.norm(found.normal.sum(axis=0)) > 1e-5 * found.area.sum()
    assert np.linalg.norm(found.normal.sum(axis=0) + strips.normal.sum(axis=0)) < 1e-8 * found.area.sum()
    assert closed_volume(found, strips) == pytest.approx(whole, rel=1e-8)


@pytest.mark.parametrize(("file", "solid", "spread", "closed"), [
    ("wing_fuselage.step", 0, 1.4e-5, 6.2e-6), ("tail_turbine.stp", None, 4.3e-6, 7e-7),
    ("mainbody_back.stp", None, 2.4e-4, 1e-8), ("wrenchnut.stp", 0, 3.2e-5, 2e-8),
    ("featuretype.step", None, 1e-11, 1e-11),
])  # fmt: skip
def test_real_parts(data: Path, file: str, solid: int | None, spread: float, closed: float) -> None:
    """The kernel's volume lies within what gaps between faces leave open; strips close them."""
    brep = read_cad(data / "cad" / file, solid)
    found = integrals_of(brep)
    assert volume_spread(brep, found) < 1.1 * spread
    strips = strips_of(brep)
    both = replace(found, volume=np.array([brep.volume]), normal=np.concatenate([found.normal, strips.normal]))
    assert volume_spread(brep, both) < 1.1 * closed
    assert brep.volume == pytest.approx(closed_volume(found, strips), rel=max(spread, 1e-9))
    assert brep.volume == pytest.approx(found.volume.sum(), rel=max(spread, 1e-9))
