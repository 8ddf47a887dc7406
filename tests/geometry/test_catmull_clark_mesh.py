"""Reading and checking hexahedral meshes, their topology and features."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import geometry.catmull_clark as source
from geometry.catmull_clark.features import smooth_folds, with_features
from geometry.catmull_clark.mesh import hex_mesh, read_hexes
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan, tetrahedron
from geometry.catmull_clark.topology import MIRROR, build_topology
from iga.cells import HEXAHEDRON
from iga.certificate import certify
from iga.errors import FormatError, InputError


@pytest.mark.parametrize("made", [box(2, 3, 4), ball(), fan(5), tetrahedron(), cross_of_tetrahedra(5)])
def test_topology_satisfies_euler(made: tuple[np.ndarray, np.ndarray]) -> None:
    t = hex_mesh(*made).topology
    assert t.vertices - len(t.edges) + len(t.faces) - len(t.hexes) == 1
    inside = t.vertex_kind == 3
    total = np.bincount(t.edges.ravel(), np.repeat(t.edge_cells, 2), t.vertices)
    np.testing.assert_array_equal(total[inside], 6 * (t.vertex_edges[inside] - 2))
    np.testing.assert_array_equal(np.sort(t.hexes[:, :1] * 0 + t.hex_edges, axis=1)[:, 0] >= 0, True)


def test_regular_entities_of_a_box() -> None:
    points, cells = box(4, 3, 5)
    t = hex_mesh(points, cells).topology
    edges = {kind: int((t.regular_vertices & (t.vertex_kind == kind)).sum()) for kind in (3, 2)}
    assert edges == {3: 3 * 2 * 4, 2: 2 * (3 * 2 + 3 * 4 + 2 * 4)}
    sharp = with_features(t, points)
    assert sharp.regular_hexes.all()
    assert np.bincount(sharp.vertex_kind).tolist() == [8, 4 * (3 + 2 + 4), 52, 24]
    assert len(smooth_folds(t))
    assert not len(smooth_folds(sharp))


def test_concave_edges_are_creases_but_irregular() -> None:
    points, cells = box(2, 2, 2)
    t = hex_mesh(points, cells[1:]).topology  # a corner cube is missing
    sharp = with_features(t, points)
    assert (sharp.vertex_kind[np.flatnonzero(t.boundary_valence == 3)] == 0).all()
    assert not sharp.regular_hexes.all()


def test_features_given_or_by_angle() -> None:
    points, cells = box(2, 2, 2)
    t = hex_mesh(points, cells).topology
    assert (with_features(t, points, "none").vertex_kind >= 2).all()
    assert (with_features(t, points, 91.0).vertex_kind >= 2).all()
    assert (with_features(t, points, 89.0).vertex_kind == 0).sum() == 8
    one = with_features(t, points, (np.array([[0, 1], [1, 2]]), np.array([0, 2])))
    assert one.vertex_kind[[0, 1, 2]].tolist() == [0, 1, 0]
    with pytest.raises(InputError, match="between vertices 0 and 13"):
        with_features(t, points, (np.array([[0, 13]]), np.array([], dtype=int)))
    with pytest.raises(InputError, match="corner vertex 13"):
        with_features(t, points, (np.zeros((0, 2), dtype=int), np.array([13])))
    with pytest.raises(InputError, match="features"):
        with_features(t, points, "sharp")


def test_mirrored_cells_are_turned_but_inverted_ones_are_kept() -> None:
    points, cells = box(2, 2, 2)
    mesh = hex_mesh(points, cells[:, MIRROR])
    assert mesh.mirrored == 8
    np.testing.assert_array_equal(mesh.topology.hexes, cells)
    mixed = cells.copy()
    mixed[3] = cells[3][MIRROR]
    assert hex_mesh(points, mixed).mirrored == 1
    points = points.copy()
    points[13] = [3.0, 3.0, 3.0]  # the inner vertex leaves the box: cells invert, none is turned
    assert hex_mesh(points, cells).mirrored == 0


def _refused(points: np.ndarray, cells: np.ndarray, match: str, **more: object) -> None:
    with pytest.raises(InputError, match=match) as caught:
        hex_mesh(points, np.asarray(cells), **more)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_refusals_name_the_entity() -> None:
    points, cells = box(2, 2, 2)
    _refused(points, cells[:0], "no hexahedra")
    _refused(points, np.where(cells == 26, 27, cells), "element 7 names a vertex outside 0..26")
    _refused(points, np.where(cells == 26, 22, cells), "element 7 repeats a vertex")
    _refused(points, np.concatenate([cells, cells[2:3, MIRROR]]), "elements 2 and 8 have the same vertices")
    bad = points.copy()
    bad[5, 1] = np.nan
    _refused(bad, cells, "vertex 5 is not finite")
    _refused(points, cells[[0, 6]], "edge between vertices .* 4 boundary faces")
    _refused(points, cells[[0, 7]], "the cells at vertex 13 do not form one piece")
    swapped = cells.copy()
    swapped[0] = swapped[0][[0, 1, 3, 2, 4, 5, 7, 6]]
    _refused(points, swapped, "element")
    _refused(points, cells, "attribute 'heat' has 3 values for 27 vertices", attributes={"heat": np.zeros(3)})
    third = np.concatenate([cells, [[*cells[0][:4], 27, 28, 29, 30]]])
    more = np.concatenate([points, points[:4] + 9.0])
    third[-1] = [cells[0][4], cells[0][5], cells[0][6], cells[0][7], 27, 28, 29, 30]
    _refused(more, third, "belongs to 3 cells")


# One test for each kind of bad input, from a file, as a user meets it.


def _file(path: Path, points: np.ndarray, cells: np.ndarray) -> Path:
    meshio.write(path, meshio.Mesh(points, [("hexahedron", np.asarray(cells)[:, np.array(HEXAHEDRON.vtk)])]))
    return path


def _said(path: Path, **settings: object) -> str:
    """The one line with which a build is refused; it names the file."""
    with pytest.raises(InputError) as caught:
        source.build(path, **settings)
    line = str(caught.value)
    assert "\n" not in line
    assert path.name in line
    return line


def test_bad_input_cells_that_are_no_hexahedra(tmp_path: Path) -> None:
    points, cells = box(2, 1, 1)
    path = tmp_path / "mixed.vtk"
    wedge = cells[1][[0, 2, 4, 1, 3, 5]]
    blocks = [("hexahedron", cells[:1, np.array(HEXAHEDRON.vtk)]), ("wedge", wedge[None])]
    meshio.write(path, meshio.Mesh(points, blocks))
    assert "holds 1 wedges; this source needs a mesh of linear hexahedra only" in _said(path)


def test_bad_input_hanging_nodes(tmp_path: Path) -> None:
    coarse, one = box(1, 1, 1)
    fine, eight = box(2, 2, 2)
    points = np.concatenate([2.0 * coarse, fine + np.array([2.0, 0.0, 0.0])])
    keep, back = np.unique(points, axis=0, return_inverse=True)
    cells = back.ravel()[np.concatenate([one, eight + 8])]
    said = _said(_file(tmp_path / "hanging.vtk", keep, cells))
    found = re.search(r"vertex (\d+) hangs in the middle of the edge between vertices (\d+) and (\d+)", said)
    assert found is not None
    vertex, a, b = (keep[int(number)] for number in found.groups())
    np.testing.assert_allclose(vertex, (a + b) / 2)


def test_bad_input_edges_with_too_many_boundary_faces(tmp_path: Path) -> None:
    """Three wings around an edge: two faces of each."""
    points, cells = fan(6, layers=1, rings=1)
    said = _said(_file(tmp_path / "wings.vtk", points, cells[::2]))
    a, b = np.flatnonzero(np.abs(points[:, :2]).sum(axis=1) < 1e-12).tolist()
    assert f"the edge between vertices {a} and {b} has 6 boundary faces" in said


def test_bad_input_faces_of_three_cells(tmp_path: Path) -> None:
    """Only so can an edge have three boundary faces: each cell brings two, each face between two cells takes two."""
    points, cells = box(2, 1, 1)
    far = points[cells[1][4:]] + np.array([0.0, 3.0, 0.0])
    third = np.concatenate([cells[1][:4], len(points) + np.arange(4)])
    path = _file(tmp_path / "three.vtk", np.concatenate([points, far]), np.concatenate([cells, third[None]]))
    shared = ", ".join(map(str, np.sort(cells[1][:4]).tolist()))
    assert f"the face with vertices {shared} belongs to 3 cells" in _said(path)


def test_bad_input_solids_that_touch_at_an_edge(tmp_path: Path) -> None:
    points, cells = box(2, 2, 1)
    said = _said(_file(tmp_path / "edge.vtk", points, cells[[0, 3]]))
    a, b = np.flatnonzero((points[:, :2] == 1.0).all(axis=1)).tolist()
    assert f"the edge between vertices {a} and {b} has 4 boundary faces; the solid touches itself there" in said


def test_bad_input_solids_that_touch_at_a_vertex(tmp_path: Path) -> None:
    points, cells = box(2, 2, 2)
    said = _said(_file(tmp_path / "vertex.vtk", points, cells[[0, 7]]))
    assert "the cells at vertex 13 do not form one piece" in said


def test_bad_input_attributes_of_the_wrong_length() -> None:
    """No file format of meshio can hold one, so it comes from arrays."""
    points, cells = box(1, 1, 2)
    _refused(points, cells, "attribute 'density' has 11 values for 12 vertices", attributes={"density": np.ones(11)})


@pytest.mark.parametrize(("key", "value"), [("lambda", "0"), ("lambda", "1"), ("lambda", "-0.2"), ("mu", "1.5")])
def test_bad_input_shape_parameters(key: str, value: str) -> None:
    with pytest.raises(InputError, match=f"^{key} must be a number above 0 and below 1, .*, not '{value}'$"):
        source.build("box", interpolate="pushback", **{key: value})


def test_bad_input_shape_parameters_of_one_entity() -> None:
    points, cells = box(1, 1, 2)
    lam = np.full(20, 0.25)
    lam[7] = 1.25
    with pytest.raises(InputError, match=r"^lambda of edge 7 is 1\.25; it must lie between 0 and 1$"):
        source.domain_of(hex_mesh(points, cells), source.Settings(interpolate="pushback", lam=lam))


def test_inverted_hexahedra_are_built_and_told() -> None:
    """Not refused: the certificate refutes them, each with a point."""
    points, cells = box(3, 3, 3)
    points[np.flatnonzero((points == [1, 1, 1]).all(axis=1))] = [7.0, 7.0, 7.0]
    domain = source.domain_of(hex_mesh(points, cells), source.Settings(interpolate="none"))
    found = certify(domain)
    assert (found.verdict < 0).any()
    assert len(found.witnesses.element) == (found.verdict < 0).sum()


def test_unused_vertices_keep_their_numbers_in_messages(tmp_path: Path) -> None:
    points, cells = box(2, 2, 2)
    more = np.concatenate([np.full((5, 3), 9.0), points])
    said = _said(_file(tmp_path / "unused.vtk", more, cells[[0, 7]] + 5))
    assert "the cells at vertex 18 do not form one piece" in said
    mesh = hex_mesh(more, cells + 5)
    assert mesh.topology.vertices == 27
    np.testing.assert_array_equal(mesh.topology.hexes, cells)


@pytest.mark.parametrize("suffix", ["vtk", "vtu", "mesh", "inp", "msh"])
def test_formats_give_the_same_mesh(tmp_path, suffix: str) -> None:
    points, cells = fan(5)
    order = np.array(HEXAHEDRON.vtk)
    path = tmp_path / f"fan.{suffix}"
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells[:, order])]),
        **({"file_format": "gmsh"} if suffix == "msh" else {}))
    mesh = read_hexes(path)
    np.testing.assert_array_equal(mesh.topology.hexes, cells)
    np.testing.assert_allclose(mesh.points, points, atol=1e-12)


def test_other_cells_and_files_are_refused(tmp_path) -> None:
    points = np.eye(4, 3)
    path = tmp_path / "one.vtk"
    meshio.write(path, meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])]))
    with pytest.raises(FormatError, match=r"1 tetrahedra.*hexahedra"):
        read_hexes(path)
    with pytest.raises(FormatError, match="there is no such file"):
        read_hexes(tmp_path / "none.vtk")
    (tmp_path / "x.mesh").write_text("MeshVersionFormatted 2\n")
    with pytest.raises(FormatError, match=r"x\.mesh"):
        read_hexes(tmp_path / "x.mesh")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), suffix=st.sampled_from(["vtk", "mesh", "inp"]))
def test_damaged_files_end_in_one_line(tmp_path, data: st.DataObject, suffix: str) -> None:
    whole = tmp_path / f"whole.{suffix}"
    if not whole.exists():
        points, cells = box(1, 1, 2)
        meshio.write(whole, meshio.Mesh(points, [("hexahedron", cells[:, list(HEXAHEDRON.vtk)])]))
    text = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    damaged = tmp_path / f"damaged.{suffix}"
    damaged.write_bytes(bytes(text[: data.draw(st.integers(1, len(text)))]))
    try:
        read_hexes(damaged)
    except InputError as error:
        assert "\n" not in str(error)


def test_real_meshes(data) -> None:
    t = read_hexes(data / "hex" / "rod.vtk").topology
    odd = ~t.regular_edges & (t.edge_kind == 3)
    assert (len(t.hexes), t.vertices, int((t.edge_kind == 3).sum())) == (1280, 1815, 2888)
    assert np.bincount(t.edge_cells[odd]).tolist() == [0, 0, 0, 0, 0, 8]
    e = read_hexes(data / "hex" / "ellipsoid.mesh").topology
    assert (len(e.hexes), int((~e.regular_edges & (e.edge_kind == 3)).sum())) == (6816, 192)
    with pytest.raises(FormatError, match="tetrahedra"):
        read_hexes(data / "tet" / "torus.msh")


@pytest.mark.long
def test_a_million_cells_in_seconds() -> None:
    import time

    points, cells = box(100, 100, 100)
    start = time.process_time()
    build_topology(cells, len(points))
    assert time.process_time() - start < 30.0
