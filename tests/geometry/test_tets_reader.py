"""Reading tet meshes: node orders, named boundaries, what is wrong with a mesh."""

from __future__ import annotations

import shutil

import meshio
import numpy as np
import pytest

from geometry.tet_to_hex import degree_of
from geometry.tets.domain import domain_of
from geometry.tets.mesh import TetMesh, checked_mesh, straight_determinants
from geometry.tets.order import node_columns, node_exponents
from geometry.tets.reader import nodes_to_bernstein, read_tets
from geometry.tets.shapes import ball, cube, mapped
from geometry.tets.source import build, reads
from iga.bernstein import bernstein
from iga.cells import TETRAHEDRON
from iga.errors import FormatError, InputError
from tests.geometry.tets_files import nodes_of, write

# Interior and face nodes as Gmsh 4.15 lists them (element properties of "Tetrahedron 3" and "Tetrahedron 4").
GMSH_3 = "3000 0300 0030 0003 2100 1200 0210 0120 1020 2010 1002 2001 0012 0021 0102 0201 1110 1101 1011 0111"
GMSH_4 = (
    "4000 0400 0040 0004 3100 2200 1300 0310 0220 0130 1030 2020 3010 1003 2002 3001 0013 0022 0031 0103 0202 0301 "
    "2110 1120 1210 2101 1201 1102 2011 1012 1021 0112 0211 0121 1111"
)


def bend(x: np.ndarray) -> np.ndarray:
    return x + 0.06 * np.sin(2 * x[..., [1, 2, 0]])


def same_solid(one: TetMesh, two: TetMesh) -> float:
    """Largest distance between the coefficients of two meshes listed in the same order of tetrahedra."""
    return float(np.abs(np.sort(one.coefficients, axis=1) - np.sort(two.coefficients, axis=1)).max())


def test_gmsh_orders():
    for degree, text in ((3, GMSH_3), (4, GMSH_4)):
        assert [[int(x) for x in word] for word in text.split()] == node_exponents(degree, "gmsh").tolist()


@pytest.mark.parametrize("degree", range(1, 11))
def test_orders_are_lattices_and_vtk_agrees(degree):
    tetra = pytest.importorskip("vtkmodules.vtkCommonDataModel").vtkHigherOrderTetra
    made = node_exponents(degree, "vtk")
    for k, exponents in enumerate(made.tolist()):
        index = [0, 0, 0, 0]
        tetra.BarycentricIndex(k, index, degree)
        assert exponents == [index[3], index[0], index[1], index[2]]
    for order in ("vtk", "gmsh"):
        lattice = node_exponents(degree, order)
        assert len(np.unique(lattice, axis=0)) == len(lattice) == bernstein(TETRAHEDRON, degree).n
        assert (lattice.sum(axis=1) == degree).all()
        # Nodes of an affine tetrahedron land on the domain points of the Bernstein functions.
        corners = np.random.default_rng(degree).standard_normal((4, 3))
        nodes = (lattice / degree) @ corners
        basis = bernstein(TETRAHEDRON, degree)
        control = nodes_to_bernstein(degree) @ nodes[node_columns(degree, order)]
        assert np.abs(control - basis.exponents / degree @ corners).max() < 1e-14 * 4**degree


@pytest.mark.parametrize(
    ("degree", "ending", "order"),
    [(2, ".msh", "gmsh"), (3, ".msh", "gmsh"), (4, ".msh", "gmsh"), (5, ".msh", "gmsh"), (2, ".vtu", "vtk"),
     (2, ".vtk", "vtk")],
)
def test_curved_meshes_come_back(degree, ending, order, tmp_path):
    mesh = ball(0, degree)
    # meshio itself reorders Gmsh's ten-node tetrahedra, so they are handed over in VTK's order.
    read = read_tets(write(tmp_path / f"ball{ending}", mesh, "vtk" if degree == 2 else order))
    assert read.degree == degree
    assert read.report["order"] == order
    assert same_solid(read, mesh) < (1e-11 if ending == ".vtu" else 1e-13)  # written with 11 digits
    assert domain_of(read).space.n == domain_of(mesh).space.n


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_lagrange_cells_of_vtk(degree, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    mesh = mapped(cube(1), bend, degree)
    points, cells = nodes_of(mesh, "vtk")
    kinds = np.full(len(cells), pyvista.CellType.LAGRANGE_TETRAHEDRON)
    table = np.column_stack([np.full(len(cells), cells.shape[1]), cells])
    path = tmp_path / "cube.vtu"
    pyvista.UnstructuredGrid(table, kinds, points).save(path, binary=False)
    read = read_tets(path)
    assert read.degree == degree
    assert read.report["order"] == "vtk"
    assert same_solid(read, mesh) < 1e-13


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_the_other_order_is_recognised_by_geometry(degree, tmp_path):
    """A file in the order of the other format: nodes fit only that."""
    mesh = mapped(cube(1), bend, degree)
    read = read_tets(write(tmp_path / "cube.msh", mesh, "gmsh" if degree == 2 else "vtk"))
    assert same_solid(read, mesh) < 1e-14


def test_no_order_fits(tmp_path):
    points, cells = nodes_of(mapped(cube(1), bend, 3), "gmsh")
    shuffled = cells.copy()
    shuffled[:, 4:] = shuffled[:, 4:][:, np.random.default_rng(3).permutation(16)]
    path = tmp_path / "cube.msh"
    meshio.write(path, meshio.Mesh(points, [("tetra20", shuffled)]), file_format="gmsh")
    with pytest.raises(InputError, match="neither Gmsh's nor VTK's order"):
        read_tets(path)


def test_mixed_degrees_are_raised(tmp_path):
    one = cube(1)
    points, cells = nodes_of(mapped(one, lambda x: x, 2), "vtk")
    path = tmp_path / "mixed.vtu"
    meshio.write(path, meshio.Mesh(points, [("tetra10", cells[:3]), ("tetra", cells[3:, :4])]), binary=False)
    read = read_tets(path)
    assert read.degree == 2
    assert domain_of(read).space.n == 27


def quad_mesh(names: dict[str, int]) -> tuple[np.ndarray, list, dict]:
    """Straight cube with tagged triangles on x0, x1 and y0."""
    mesh = cube(2)
    points, cells = nodes_of(mesh, "vtk")
    from geometry.tets.mesh import FACES

    # Vertex numbers of the cube follow its lattice; find the file's nodes by position.
    corners = mesh.coefficients
    node = {tuple(np.round(p, 9)): k for k, p in enumerate(points)}
    triangles, tags = [], []
    for name, tag in names.items():
        for e, f in mesh.boundaries[name]:
            triangles.append([node[tuple(np.round(corners[e, v], 9))] for v in FACES[f]])
            tags.append(tag)
    return points, [("tetra", cells), ("triangle", np.array(triangles))], {"tags": np.array(tags), "tets": len(cells)}


def test_physical_groups_name_the_boundary(tmp_path):
    points, cells, tags = quad_mesh({"x0": 3, "x1": 5, "y0": 8})
    path = tmp_path / "cube.msh"
    groups = {"inlet": (3, 2), "outlet": (5, 2), "nothing": (9, 2), "steel": (1, 3)}
    fields = {name: np.array(tag) for name, tag in groups.items()}
    data = [np.ones(tags["tets"], dtype=int), tags["tags"]]
    mesh = meshio.Mesh(points, cells, cell_data={"gmsh:physical": data, "gmsh:geometrical": data}, field_data=fields)
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    read = read_tets(path)
    assert {k: len(v) for k, v in read.boundaries.items()} == {"inlet": 8, "outlet": 8, "physical_8": 8, "boundary": 24}
    assert read.report["empty_groups"] == "nothing"
    assert read.report["regions"] == "steel"
    assert {k: len(v) for k, v in read_tets(path, tags=False).boundaries.items()} == {"boundary": 48}
    domain = build(path, convert="hex4")
    assert sum(len(f.elements) for f in domain.boundaries["inlet"]) == 24


GMSH_PARTIAL = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 7 "floor"
2 8 "both"
$EndPhysicalNames
$Entities
0 0 3 1
1 0 0 0 1 1 0 2 7 8 0
2 0 0 0 1 0 1 1 8 0
3 0 0 0 0 1 1 0 0
1 0 0 0 1 1 1 0 3 1 2 3
$EndEntities
$Nodes
1 4 1 4
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
4 4 1 4
2 1 2 1
1 1 3 2
2 2 2 1
2 1 2 4
2 3 2 1
3 1 4 3
3 1 4 1
4 1 2 3 4
$EndElements
"""


def test_entities_in_several_physical_groups_and_in_none(tmp_path):
    (tmp_path / "partial.msh").write_text(GMSH_PARTIAL)
    read = read_tets(tmp_path / "partial.msh")
    assert {k: v.tolist() for k, v in read.boundaries.items()} == {
        "floor": [[0, 3]], "both": [[0, 2], [0, 3]], "boundary": [[0, 0], [0, 1]],
    }


def test_medit_references_name_the_boundary(tmp_path):
    points, cells, tags = quad_mesh({"x0": 3, "x1": 0, "y0": 8})
    path = tmp_path / "cube.mesh"
    refs = [np.ones(tags["tets"], dtype=int), tags["tags"]]
    meshio.write(path, meshio.Mesh(points, cells, cell_data={"medit:ref": refs}))
    read = read_tets(path)
    assert {k: len(v) for k, v in read.boundaries.items()} == {"boundary_3": 8, "boundary_8": 8, "boundary": 32}


def test_triangles_inside_are_left_out(tmp_path):
    points, cells, tags = quad_mesh({"x0": 3})
    inner = cells[0][1][:, [0, 1, 2]]
    cells[1] = ("triangle", np.concatenate([cells[1][1], inner[:5]]))
    path = tmp_path / "cube.mesh"
    refs = [np.ones(tags["tets"], dtype=int), np.concatenate([tags["tags"], np.full(5, 4)])]
    meshio.write(path, meshio.Mesh(points, cells, cell_data={"medit:ref": refs}))
    read = read_tets(path)
    assert len(read.boundaries["boundary_3"]) == 8
    assert read.report["triangles_off_boundary"] + len(read.boundaries.get("boundary_4", [])) == 5


def test_order_of_vertices_is_put_right():
    mesh = mapped(cube(2), bend, 3)
    turned = np.random.default_rng(11).random(len(mesh.vertices)) < 0.5
    exponents = bernstein(TETRAHEDRON, 3).exponents
    place = {tuple(a): k for k, a in enumerate(exponents.tolist())}
    swap = [place[tuple(a)] for a in exponents[:, [1, 0, 2, 3]].tolist()]
    vertices = np.where(turned[:, None], mesh.vertices[:, [1, 0, 2, 3]], mesh.vertices)
    coefficients = np.where(turned[:, None, None], mesh.coefficients[:, swap], mesh.coefficients)
    again = checked_mesh(vertices, coefficients)
    assert again.report["oriented"] == turned.sum()
    assert again.report["parts"] == 1
    assert "folded" not in again.report
    assert (straight_determinants(again.coefficients) > 0).all()
    assert np.allclose(np.sort(domain_of(again).points, axis=0), np.sort(domain_of(mesh).points, axis=0))
    for (element, face), own in zip(again.boundaries["boundary"], again.vertices[again.boundaries["boundary"][:, 0]]):
        assert 0 <= face < 4
        assert element < len(own) * len(again.vertices)


def test_a_fold_is_not_hidden():
    """A vertex pushed through the opposite face: the tetrahedron stays negative, its neighbours stay positive."""
    mesh = cube(3)
    middle = int(mesh.vertices[np.abs(mesh.coefficients - 1 / 3).max(axis=2) < 1e-12][0])
    coefficients = mesh.coefficients.copy()
    coefficients[mesh.vertices == middle] += 0.5
    folded = checked_mesh(mesh.vertices, coefficients)
    assert folded.report["folded"] == int((straight_determinants(folded.coefficients) < 0).sum()) > 0
    assert folded.report["oriented"] == 0


def test_a_left_handed_file_is_turned_as_a_whole():
    mesh = cube(2)
    mirrored = mesh.coefficients * np.array([-1.0, 1.0, 1.0])
    again = checked_mesh(mesh.vertices, mirrored)
    assert again.report["oriented"] == len(mesh.vertices)
    assert (straight_determinants(again.coefficients) > 0).all()


def test_parts_are_counted():
    mesh = cube(1)
    apart = checked_mesh(
        np.concatenate([mesh.vertices, mesh.vertices + 100]),
        np.concatenate([mesh.coefficients, mesh.coefficients + 3.0]),
    )
    assert apart.report["parts"] == 2
    assert apart.vertices.max() == 15


CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [-1, -1, -1], [0, 0, -1]])


@pytest.mark.parametrize(
    ("vertices", "change", "words"),
    [
        ([[0, 1, 2, 3], [1, 1, 2, 4]], None, "tetrahedron 1 has vertex 1 twice"),
        ([[0, 1, 2, 3], [1, 2, 3, 4], [3, 2, 1, 0]], None, "tetrahedra 0 and 2 have the same"),
        ([[0, 1, 2, 3], [1, 2, 3, 4]], (4, [1 / 3, 1 / 3, 1 / 3]), "tetrahedron 1 has no volume"),
        ([[0, 1, 2, 3], [0, 1, 2, 5], [0, 1, 2, 6]], None, "vertices 0, 1, 2 belongs to 3 tetrahedra"),
        ([[0, 1, 2, 3]], (2, [0, np.nan, 0]), "tetrahedron 0 has a coordinate that is no number"),
        ([[0, 1, 2, 3]], (2, [0, np.inf, 0]), "tetrahedron 0 has a coordinate that is no number"),
        ([[0, 1, 2, 3]], (2, [0, 1e200, 0]), "tetrahedron 0 has a coordinate that is no number"),
    ],
)
def test_what_makes_no_mesh(vertices, change, words):
    points = CORNERS.copy()
    if change:
        points[change[0]] = change[1]
    with pytest.raises(InputError, match=words):
        checked_mesh(np.array(vertices), points[np.array(vertices)])


def test_files_that_hold_no_tet_mesh(tmp_path, data):
    with pytest.raises(InputError, match="1280 hexahedra but no tetrahedra"):
        read_tets(data / "hex" / "rod.vtk")
    with pytest.raises(InputError, match="triangles but no tetrahedra"):
        read_tets(data / "surface" / "bone.off")
    with pytest.raises(FormatError, match="no such file"):
        read_tets(tmp_path / "nothing.msh")
    with pytest.raises(FormatError, match="is a folder"):
        read_tets(tmp_path)
    (tmp_path / "text.docx").write_text("hello")
    with pytest.raises(FormatError, match="ending"):
        read_tets(tmp_path / "text.docx")
    points = np.concatenate([CORNERS, CORNERS + 1])
    both = meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]]), ("wedge", [[0, 1, 2, 7, 8, 9]])])
    meshio.write(tmp_path / "both.vtu", both, binary=False)
    with pytest.raises(InputError, match="1 wedges besides 1 tetrahedra"):
        read_tets(tmp_path / "both.vtu")


def test_isolated_nodes_are_dropped_and_told(tmp_path):
    mesh = meshio.Mesh(np.concatenate([CORNERS, [[np.nan] * 3]]), [("tetra", [[1, 2, 3, 4]])])
    meshio.write(tmp_path / "loose.vtu", mesh, binary=False)
    read = read_tets(tmp_path / "loose.vtu")
    assert read.report["isolated_nodes"] == 4
    assert read.vertices.tolist() in ([[0, 1, 2, 3]], [[0, 3, 2, 1]])


def test_a_node_that_is_not_there(tmp_path):
    vertices = "Vertices\n4\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"
    text = f"MeshVersionFormatted 1\nDimension 3\n{vertices}Tetrahedra\n1\n1 2 3 9 0\nEnd\n"
    (tmp_path / "far.mesh").write_text(text)
    with pytest.raises(FormatError, match="cell 0 names a node"):
        read_tets(tmp_path / "far.mesh")


def test_what_the_source_claims_to_read(tmp_path, data):
    assert reads(data / "tet" / "bunny.mesh")
    assert reads(data / "tet" / "sphere_P2.msh")
    assert reads(data / "tet" / "escher_P2.vtk")
    assert not reads(data / "nurbs" / "mfem_ball-nurbs.mesh")
    assert not reads(data / "nurbs" / "gismo_cylinder.xml")
    assert not reads(data / "surface" / "bone.off")
    assert not reads(data / "hex" / "ellipsoid.mesh")
    assert not reads(tmp_path / "nothing.step")
    shutil.copy(data / "tet" / "torus.msh", tmp_path / "TORUS.MSH")
    assert reads(tmp_path / "TORUS.MSH")
    assert degree_of(4) == 1
