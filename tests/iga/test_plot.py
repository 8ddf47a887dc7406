"""Skins are exact; pictures show something where a machine can draw, and say so in one line where it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE
from iga.conforming import Complex, boundary, straight_domain
from iga.domain import Domain
from iga.errors import InputError
from iga.pictures import plot
from iga.pictures.picture import compose, trimmed
from iga.pictures.skin import Cut, plane_of, tessellate
from iga.sampling import bounding_box


def grid(n=3, degree=2):
    """Cube [-1, 1]^3 of n^3 hexahedra with six named sides, gently bent by a quadratic map."""
    number = np.arange((n + 1) ** 3).reshape((n + 1,) * 3)
    corners = [number[i : n + i, j : n + j, k : n + k].ravel() for i, j, k in np.ndindex(2, 2, 2)]
    vertices = np.stack(np.meshgrid(*[np.linspace(-1, 1, n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    made = straight_domain(Complex(((HEXAHEDRON, np.stack(corners, axis=-1)),)), vertices, degree)
    sides = ("west", "east", "south", "north", "bottom", "top")
    named = {name: tuple(f for f in made.boundaries["boundary"] if f.face == k) for k, name in enumerate(sides)}
    return Domain(made.space, made.points, named)


def area(skin):
    a, b, c = (skin.points[skin.triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_skin_of_a_cube():
    domain = grid()
    skin = tessellate(domain, domain.points[:, 0], pieces=2)
    assert abs(area(skin).sum() - 24.0) < 1e-12
    assert set(skin.part) == set(range(6))
    np.testing.assert_allclose(skin.values, skin.points[:, 0], atol=1e-13)
    outward = np.abs(skin.points).max(axis=1)
    assert np.allclose((skin.normals * skin.points).sum(axis=1), outward)


@pytest.mark.parametrize(("smooth", "height"), [(False, 1.0 / 3.0), (True, 0.1)])
def test_cut_opens_a_closed_solid(smooth, height):
    domain = grid()
    plane = plane_of(domain, Cut("z", origin=(0.0, 0.0, 0.1), smooth=smooth))
    skin = tessellate(domain, plane=plane, pieces=2)
    assert abs(skin.points[:, 2].max() - height) < 1e-6
    assert abs(area(skin).sum() - (8.0 + 8.0 * (1.0 + height))) < 1e-4
    assert abs(area(skin)[skin.part == -1].sum() - 4.0) < 1e-5
    assert all(np.isfinite(line).all() for line in skin.lines)
    corners = skin.points[skin.triangles]
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned = (winding * skin.normals[skin.triangles[:, 0]]).sum(axis=1)
    assert (turned[skin.part == -1] > 0).all()


def test_cuts_go_through_the_middle_of_the_solid_not_of_its_control_points():
    """B-splines that a trimmed solid uses have control points far outside it."""
    domain = grid(1)
    points = domain.points.copy()
    points[(points == [0.0, 0.0, 1.0]).all(axis=1), 2] += 30.0
    far = Domain(domain.space, points, domain.boundaries)
    np.testing.assert_allclose(bounding_box(far), [[-1.0] * 3, [1.0] * 3], atol=1e-14)
    np.testing.assert_allclose(plane_of(far, "z").origin, 0.0, atol=1e-14)


def test_all_cells_without_named_boundaries():
    v = np.array([*np.ndindex(2, 2, 2)], dtype=float)
    v = np.vstack([v, [0.5, 0.5, 1.8], [1.7, 0.0, 0.0], [1.7, 1.0, 0.0], [0.5, 1.6, 1.2]])
    mesh = Complex(
        (
            (HEXAHEDRON, np.array([[0, 1, 2, 3, 4, 5, 6, 7]])),
            (PYRAMID, np.array([[1, 3, 5, 7, 8]])),
            (WEDGE, np.array([[4, 6, 5, 7, 9, 10]])),
            (TETRAHEDRON, np.array([[7, 3, 8, 11]])),
        )
    )
    made = straight_domain(mesh, v, 2)
    named = tessellate(made, pieces=3)
    unnamed = tessellate(Domain(made.space, made.points), pieces=3)
    assert sum(len(f.elements) for f in boundary(mesh)) == len(unnamed.triangles) // 9 - 6
    assert abs(area(named).sum() - area(unnamed).sum()) < 1e-12
    assert set(unnamed.part) == {-1}


def test_wrong_cuts_and_fields_are_told():
    domain = grid(1, 1)
    with pytest.raises(InputError, match="along x, y or z"):
        plane_of(domain, "w")
    with pytest.raises(InputError, match="three numbers"):
        plane_of(domain, Cut((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="takes all elements away"):
        tessellate(domain, plane=plane_of(domain, Cut("x", origin=(-9.0, 0.0, 0.0))))
    with pytest.raises(InputError, match="field 'T' has shape"):
        plot.plot_field(domain, np.zeros(2), "T")
    with pytest.raises(InputError, match="three coefficients"):
        plot.plot_field(domain, np.zeros(8), "T", warp=np.zeros((8, 2)))
    with pytest.raises(InputError, match="field 'T' has no finite value"):
        plot.plot_field(domain, lambda s: np.full(s.x.shape[:2], np.nan), "T")
    for limits in ((1.0, 0.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(InputError, match="the lower one first"):
            plot.plot_field(domain, np.zeros(8), "T", limits=limits)
    for origin in ((0.0, np.nan, 0.0), (0.0, 0.0)):
        with pytest.raises(InputError, match="a point with three coordinates"):
            plane_of(domain, Cut("x", origin))
    with pytest.raises(InputError, match="three numbers"):
        plane_of(domain, Cut((np.inf, 0.0, 0.0)))
    with pytest.raises(InputError, match="view is three numbers"):
        plot.plot_domain(domain, view=(np.inf, 0.0, 0.0))
    with pytest.raises(InputError, match="at least one pixel"):
        plot.plot_domain(domain, size=0)


@pytest.mark.parametrize("fields", [False, True])
def test_smooth_cuts_beside_a_solid(fields):
    """They take all of it or nothing."""
    domain = grid(1, 1)
    values = domain.points[:, 0].copy() if fields else None
    with pytest.raises(InputError, match="takes all elements away"):
        tessellate(domain, values, plane=plane_of(domain, Cut("x", (-9.0, 0.0, 0.0), smooth=True)))
    skin = tessellate(domain, values, plane=plane_of(domain, Cut("x", (9.0, 0.0, 0.0), smooth=True)), pieces=2)
    assert abs(area(skin).sum() - 24.0) < 1e-5
    assert (skin.part >= 0).all()


def test_machine_that_cannot_draw_says_so(monkeypatch):
    monkeypatch.setattr(plot, "window_kind", lambda: "")
    with pytest.raises(InputError, match="install libegl1"):
        plot.plot_domain(grid(1, 1))


def test_names_of_a_legend_have_colours_of_their_own():
    """And none of them is used again where the legend has ended."""
    assert len({plot._part_colour(k, 30) for k in range(plot.LEGEND + 4)}) == plot.LEGEND + 4
    first = {plot._part_colour(k, 30) for k in range(plot.LEGEND)}
    assert first.isdisjoint(plot._part_colour(k, 30) for k in range(plot.LEGEND, 30))


def test_trimmed():
    picture = np.full((40, 50, 3), 255, dtype=np.uint8)
    assert trimmed(picture).shape == picture.shape
    picture[10:20, 30:32] = 0
    assert trimmed(picture, 2).shape == (14, 6, 3)


@pytest.fixture(scope="module")
def drawing():
    if not plot.can_draw():
        pytest.skip("this machine has neither EGL nor OSMesa, so nothing can be drawn")


def test_pictures_show_the_domain(drawing, tmp_path):
    domain = grid()
    path = tmp_path / "cube.png"
    picture = plot.plot_domain(domain, path, size=300)
    assert path.read_bytes()[:4] == b"\x89PNG"
    assert 0.3 < (picture < 250).any(axis=-1).mean() < 0.95
    solid = picture[:, :250].reshape(-1, 3)
    assert len(np.unique(solid // 8, axis=0)) > 30
    plain = plot.plot_domain(domain, size=300, edges=False, names=False)
    assert plain.shape[1] < picture.shape[1]


def test_pictures_of_fields(drawing, tmp_path):
    domain = grid()
    u = domain.points[:, 0] * domain.points[:, 2] + 2.0
    moved = np.column_stack([0 * u, 0 * u, u])
    path = tmp_path / "u.png"
    picture = plot.plot_field(
        domain, u, "temperature", path, unit="K", warp=moved, cut=Cut((1.0, -1.0, 0.0), smooth=True), size=300
    )
    assert path.stat().st_size > 5000
    assert picture.shape[2] == 3
    constant = plot.plot_field(domain, np.ones(domain.space.n), "one", size=200, edges=False)
    flux = plot.plot_field(domain, lambda s: s.gradient(u), "flux", size=200, title="flux", cut="y")
    assert constant.size > 0
    assert flux.size > 0


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("cut", [None, "x", "-y", "z"])
def test_up_axis_points_up(up, cut):
    domain = grid()
    skin = tessellate(domain, pieces=2)
    axis = plot._axis(up)
    direction = plot._direction(plane_of(domain, cut), None, up)
    upward, box = plot._frame(skin.points, direction, axis)
    assert upward @ axis > 0.1
    assert abs(upward @ direction) < 1e-14
    assert abs(np.linalg.norm(upward) - 1.0) < 1e-14
    assert (box[1] > box[0]).all()
    if cut is not None:
        assert direction @ plane_of(domain, cut).normal > 0.5


@pytest.mark.parametrize("names", [3, 14])
def test_flat_pictures_have_room_for_all_names(names):
    """The boxes of all colours are in the legend, also where the solid is lower than its names."""
    colours = [f"#{40 + 10 * k:02x}00ff" for k in range(names)]
    flat = np.full((30, 400, 3), 100, dtype=np.uint8)
    made = compose(flat, None, legend=[(f"side_{k}", colour) for k, colour in enumerate(colours)])
    for colour in colours:
        wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (made == wanted).all(axis=-1).sum() > 300, colour
    assert (made == 100).all(axis=-1).sum() > 0.9 * 30 * 400


def test_unknown_up_axis_is_refused():
    with pytest.raises(InputError, match="up is x, y or z"):
        plot.plot_domain(grid(), up="w")
