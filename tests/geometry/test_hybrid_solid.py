"""HB-rep of solids: revised B-splines and trim functions on whole skins."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

import geometry
from geometry.cad.brep import Brep, curve_points, surface_points
from geometry.hybrid import shapes
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import project
from geometry.hybrid.layers import complete_with_layers
from geometry.hybrid.numbering import numbering, skin_rows
from geometry.hybrid.reporting import column_condition
from geometry.hybrid.sealing import Sealed
from geometry.hybrid.shell import shell_of
from geometry.hybrid.skin import Skin, build_skin
from geometry.hybrid.splining import Splined, splined
from geometry.hybrid.subdividing import subdivided
from geometry.hybrid.volume import complete, fill_skin
from iga.block import bezier_coefficients
from iga.cells import HEXAHEDRON
from iga.certificate import certify
from iga.domain import check
from problems import solve_exact

Array = NDArray[np.float64]


@cache
def built(name: str = "curved_difference") -> tuple[Brep, Skin, Sealed, Splined, tuple[FaceMesh, ...]]:
    """A skin with everything that went into it."""
    brep = shapes.SHAPES[name]()
    skin = build_skin(brep, 0.2, 1e-4, kind="hb-rep")
    assert skin.sealed is not None
    return brep, skin, skin.sealed, skin.sealed.solid, skin.sealed.meshes


def functions_at(sealed: Sealed, part: int, places: Array) -> tuple[Array, Array]:
    """Values (e, q, n) of all functions on the elements of a part, and their sums over n."""
    block = sealed.made.parts[part].block
    values = block.basis.tabulate(places, 0)[0]
    M = sealed.M.toarray()[block.dofs]
    found = np.einsum("qb,ebn->eqn", values, M)
    return found, found.sum(axis=2)


def test_functions_sum_to_one() -> None:
    _, skin, sealed, _, _ = built()
    at = np.random.default_rng(1).dirichlet(np.ones(3), 9)[:, :2]
    for part in range(2):
        assert np.abs(functions_at(sealed, part, at)[1] - 1.0).max() < 1e-12
    assert skin.report["hb_rep"]["unity_error"] < 1e-12


def test_only_trim_functions_live_on_trimming_curves() -> None:
    """Sides of elements on CAD edges, found by the vertices alone; revised functions are evaluated there."""
    _, _, sealed, _, _ = built()
    made = sealed.made
    pairs = {tuple(sorted(row)) for row in made.curves[:, :2].tolist()}
    s = np.linspace(0.0, 1.0, 7)[:, None]
    around = {3: np.array([(0, 0), (1, 0), (0, 1)]), 4: np.array([(0, 0), (1, 0), (1, 1), (0, 1)])}
    met = 0
    for number, part in enumerate(made.parts):
        m = part.corners.shape[1]
        for k in range(m):
            ends = np.sort(part.corners[:, [k, (k + 1) % m]], axis=1)
            mine = np.array([tuple(row) in pairs for row in ends.tolist()])
            if not mine.any():
                continue
            met += int(mine.sum())
            a, b = around[m][k], around[m][(k + 1) % m]
            values = functions_at(sealed, number, a + s * (b - a))[0][mine]
            assert np.abs(values[..., sealed.trim :]).max() < 1e-12
            assert (np.abs(values[..., : sealed.trim]) > 1e-12).sum(axis=(1, 2)).min() >= 4
    assert met == 2 * len(pairs)


def test_outside_the_band_functions_and_surface_are_the_splines() -> None:
    brep, _, sealed, solid, meshes = built()
    s = np.linspace(0.0, 1.0, 4)
    at = np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1).reshape(-1, 2)
    part = sealed.made.parts[0]
    values = functions_at(sealed, 0, at)[0]
    for f, mesh in enumerate(meshes):
        assert solid.apart[f] == 0.0
        mine = np.flatnonzero(part.owner == f)
        order = at[:, ::-1] if brep.faces[f].reversed else at
        uv = mesh.low[:, None] + order * (mesh.high - mesh.low)[:, None]
        inner = ~part.banded[mine]
        x = values[mine][inner] @ sealed.points
        on = surface_points(brep.faces[f].surface, uv[inner].reshape(-1, 2)).reshape(x.shape)
        assert np.abs(x - on).max(initial=0.0) < 1e-12 * brep.diagonal
        # Functions: those of the face alone, positive, and as many as B-splines on an interval.
        own = np.unique(sealed.numbers[f][sealed.numbers[f] >= 0])  # type: ignore[index]
        there = np.abs(values[mine][inner]).max(axis=1, initial=0.0) > 1e-13
        assert (there.sum(axis=1) == 16).all()
        assert not np.delete(there, own, axis=1).any()
    assert sum(int((~part.banded).sum()) for part in sealed.made.parts[:1]) > 10


def test_both_sides_of_a_curve_share_coefficients() -> None:
    brep, skin, sealed, _, _ = built()
    assert skin.report["watertight_gap"] < 1e-12
    ends = sealed.made.points[np.unique(sealed.made.curves[:, :2])]
    # The coefficients of trim functions are control points of the curves, so vertices are on them.
    tree = np.abs(ends[:, None] - sealed.points[None, : sealed.trim]).max(axis=2).min(axis=1)
    assert tree.max() == 0.0
    assert skin.report["max_distance"] < 1e-4
    assert skin.report["exact_area_share"] > 0.75
    assert abs(skin.report["volume"] / brep.volume - 1.0) < 1e-5


def test_functions_are_independent() -> None:
    _, skin, sealed, _, _ = built()
    found = column_condition(sealed)
    assert max(found.values()) < 1e6
    assert column_condition(sealed, dense=0) == pytest.approx(found, rel=1e-6)  # as faces with many functions
    told = skin.report["hb_rep"]
    assert told["trim"] + told["revised"] + told["b_splines"] + told["own"] == skin.space.n
    assert told["own"] == 0
    assert not told["c0_faces"]
    curves = sealed.made.curves  # two coefficients inside each piece, and one at each end
    assert told["trim"] == 2 * len(curves) + len(np.unique(curves[:, :2]))


def test_volume_has_the_skin_for_boundary() -> None:
    """The boundary of the volume is the HB-rep, coefficient for coefficient, and cells are certified."""
    skin = build_skin(shapes.curved_box(), 0.6, 1e-3, kind="hb-rep")
    shell = subdivided(shell_of(skin))
    domain = complete(shell)
    check(domain)
    assert (certify(domain, 1e9).verdict == 1).all()
    mesh = fill_skin(shell).mesh
    numbers = numbering(mesh, shell, 3)
    rows = skin_rows(shell, numbers)
    for block, own in zip(shell.space.blocks, numbers.skin):
        assert np.abs((rows @ shell.points)[own] - bezier_coefficients(block, shell.points)).max() < 1e-12
    assert np.array_equal(domain.points[: shell.space.n], shell.points)


def test_splines_without_the_mask_come_near_the_curves() -> None:
    """What trim functions add to the B-splines of a face is small on the CAD surface, and nothing for constants."""
    brep, skin, sealed, _, _ = built()
    assert sealed.adjust.shape[1] == skin.space.n
    assert np.abs(sealed.adjust @ np.ones(skin.space.n)).max() < 1e-11
    assert len(np.unique(sealed.adjust.indices[sealed.adjust.indices < sealed.trim])) > 0.3 * sealed.trim
    off = np.linalg.norm(sealed.adjust @ skin.points, axis=1) / brep.diagonal
    assert np.quantile(off, 0.5) < 1e-2


def test_layers_have_hexahedra_of_splines() -> None:
    """Tensor products of the skin's functions and B-splines inwards, on hexahedra below quadrilaterals."""
    skin = build_skin(shapes.curved_box(), 0.6, 1e-3, kind="hb-rep")
    shell = shell_of(skin)
    domain = complete_with_layers(shell, 3, 0.4, way="straight")
    check(domain)
    assert "layers_dropped" not in domain.report
    assert (certify(domain, 1e9).verdict == 1).all()
    hexes = [b for b in domain.space.blocks if b.basis.cell is HEXAHEDRON]
    assert sum(b.elements for b in hexes) == skin.report["quadrilaterals"] > 6
    # Four layers of the skin's functions.
    assert len(np.unique(np.concatenate([b.dofs.ravel() for b in hexes]))) == 4 * shell.space.n
    answer = solve_exact(domain, "elasticity", "x+2*y;3*z-y;x-y+z")[1]
    assert answer["relative_h1_error"] < 1e-10


@pytest.mark.long
@pytest.mark.parametrize("name", ["block_through_hole", "two_elliptical_edges"])
def test_rational_parts_become_volumes(data: Path, name: str) -> None:
    """Weights do not enter: cylinders are replaced within a proved bound; flat faces are exact."""
    domain = geometry.build(data / "cad" / f"{name}.step", "hybrid", skin="hb-rep")
    report = domain.report
    assert report["skin"] == "hb-rep"
    assert (certify(domain, 1e9).verdict == 1).all()
    told = report["hb_rep"]
    assert told["unity_error"] < 1e-12
    assert told["on_curves"] < 1e-12
    assert report["watertight_gap"] < 1e-12
    assert report["distance"]["relative"] < 2e-5
    assert report["volume_error"] < 1e-5
    assert report["exact_area_share"] > 0.7
    assert told["replaced"]
    assert all(row["proved"] and row["distance"] < 1e-5 for row in told["replaced"].values())
    assert solve_exact(domain, "heat", "x+2*y-z")[1]["relative_h1_error"] < 1e-8


@pytest.mark.long
def test_balls_are_splines_at_their_poles() -> None:
    """A ball: two faces with two poles and a seam, and no C0 functions of triangles alone."""
    brep = shapes.ball()
    skin = build_skin(brep, 0.2, 1e-4, kind="hb-rep")
    told = skin.report["hb_rep"]
    assert skin.report["folded"] == skin.report["crossings"] == 0
    assert skin.report["watertight_gap"] < 1e-12
    assert told["unity_error"] < 1e-12
    assert told["revised"] + told["b_splines"] > 100
    assert told["own"] == 0
    assert abs(skin.report["volume"] / (4.0 / 3.0 * np.pi) - 1.0) < 1e-4


def test_a_tetrapod_needs_few_elements() -> None:
    """Sizes at its seams are those of the capsules, not of the splines that replace them."""
    skin = build_skin(shapes.tetrapod(), 0.2, 1e-3, kind="hb-rep")
    assert skin.report["folded"] == skin.report["crossings"] == 0
    assert not skin.report["cad_faces_without_band"]
    assert skin.report["max_distance"] < 1e-3
    assert skin.report["elements"] < 600
    assert skin.report["hb_rep"]["unity_error"] < 1e-12


def test_weights_of_a_cylinder_are_replaced_within_a_proved_bound() -> None:
    """The bound against distances at random parameters."""
    brep = shapes.bracket()
    solid = splined(brep, 1e-3)
    met = 0
    for f, (old, new) in enumerate(zip(brep.faces, solid.brep.faces)):
        if old.surface.weights is None:
            assert solid.apart[f] == 0.0
            continue
        assert new.surface.weights is None
        assert new.surface.degree == (3, 3)
        t = np.linspace(0.0, 1.0, 19)
        curves, carried = ([curve_points(c.curve, t) for loop in face.loops for c in loop] for face in (old, new))
        outline = np.concatenate(carried)
        apart = surface_points(old.surface, np.concatenate(curves)) - surface_points(new.surface, outline)
        assert np.linalg.norm(apart, axis=1).max() <= solid.apart[f]  # curves go with the surface's parameters
        uv = outline.min(axis=0) + np.random.default_rng(f).uniform(0, 1, (200, 2)) * np.ptp(outline, axis=0)
        x = surface_points(new.surface, uv)
        assert solid.proved[f]
        assert np.abs(project(old, uv, x)[1]).max() <= solid.apart[f] < 1e-3 * brep.diagonal
        met += 1
    assert met > 5


@pytest.mark.parametrize("share", [0.0, 0.9, 2.0])
def test_gaps_leave_less_of_the_tolerance_to_replaced_surfaces(share: float) -> None:
    """Half of what the gaps leave of the tolerance, and a twentieth of it at least."""
    brep = shapes.bracket()
    tolerance = 1e-4
    gaps = np.full(len(brep.edges), share * tolerance * brep.diagonal)
    apart = splined(brep, tolerance, gaps).apart / (tolerance * brep.diagonal)
    allowed = max(0.5 * (1.0 - share), 0.05)
    assert 0.0 < apart.max() <= 1.01 * allowed
