"""What VTK reads back from our files is the geometry itself: exact on curved, rational and mixed cells."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from iga.bernstein import bernstein, greville
from iga.block import Block, Kronecker
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE
from iga.conforming import Complex, straight_domain
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.exchange.export import bezier_grid, vtk_order, write_vtk, write_vtu
from iga.field import Field
from iga.sampling import Samples, subdivision

pv = pytest.importorskip("pyvista")

DEGREES = [
    (HEXAHEDRON, (1, 1, 1)), (HEXAHEDRON, (2, 3, 1)), (HEXAHEDRON, (4, 2, 3)), (TETRAHEDRON, (1,)),
    (TETRAHEDRON, (2,)), (TETRAHEDRON, (5,)), (WEDGE, (1, 1)), (WEDGE, (3, 2)), (WEDGE, (2, 4)), (PYRAMID, (1,)),
    (PYRAMID, (2,)), (PYRAMID, (4,)),
]  # fmt: skip


def bent(x):
    return x + 0.1 * np.sin(2.0 * x[..., [1, 2, 0]])


def one_element(cell, degree, rational):
    basis = bernstein(cell, degree)
    rng = np.random.default_rng(7)
    weights = rng.uniform(0.6, 1.7, basis.n) if rational else None
    space = Space((Block(basis, np.arange(basis.n)[None]),), basis.n, weights)
    return Domain(space, bent(greville(basis))), rng.normal(size=basis.n)


def points_inside(cell, count=20):
    rng = np.random.default_rng(11)
    xi = rng.uniform(size=(count, 3))
    if cell is TETRAHEDRON:
        xi = rng.dirichlet([1, 1, 1, 1], count)[:, :3]
    if cell is WEDGE:
        xi[:, :2] = rng.dirichlet([1, 1, 1], count)[:, :2]
    return xi


def vtk_values(grid, xi, names):
    """Places and fields at VTK's own parametric points of the only cell."""
    import vtk

    cell, data = grid.GetCell(0), grid.GetPointData()
    if data.GetRationalWeights():
        cell.SetRationalWeightsFromPointData(data, grid.GetNumberOfPoints())
    wrapped = pv.wrap(grid)
    arrays = {name: np.asarray(wrapped.point_data[name]) for name in names}
    places, found = [], {name: [] for name in names}
    for point in xi.tolist():
        x, share = [0.0] * 3, [0.0] * grid.GetNumberOfPoints()
        cell.EvaluateLocation(vtk.reference(0), point, x, share)
        places.append(x)
        for name in names:
            found[name].append(np.asarray(share) @ arrays[name])
    return np.array(places), {name: np.array(v) for name, v in found.items()}


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize(("cell", "degree"), DEGREES, ids=str)
def test_vtk_evaluates_the_same_cell(cell, degree, rational, tmp_path):
    domain, u = one_element(cell, degree, rational)
    path = write_vtu(tmp_path / "one.vtu", domain, {"u": u, "x": lambda s: s.x, "product": lambda s: s.x[..., 0]})
    grid = pv.read(path)
    xi = points_inside(cell)
    ours = xi.copy()
    if cell is PYRAMID:  # VTK sees the hexahedron of the collapsed coordinates
        ours[:, :2] *= 1.0 - xi[:, 2:]
    samples = Samples(domain, 0, np.array([0]), ours)
    places, values = vtk_values(grid, xi, ["u", "x", "product"])
    np.testing.assert_allclose(places, samples.x[0], atol=3e-15)
    np.testing.assert_allclose(values["u"], samples.at(u)[0], atol=3e-15)
    # Functions are interpolated, which loses nothing on what the cell can represent.
    np.testing.assert_allclose(values["x"], samples.x[0], atol=1e-12)
    np.testing.assert_allclose(values["product"], samples.x[0, :, 0], atol=1e-12)
    degrees = np.asarray(grid.cell_data["HigherOrderDegrees"])[0]
    expected = degree if cell is HEXAHEDRON else (degree[0], degree[0], degree[-1])
    assert degrees.tolist() == list(expected)
    assert (grid.GetPointData().GetRationalWeights() is not None) == rational
    assert grid.GetCellData().GetHigherOrderDegrees() is not None


@pytest.mark.parametrize(("cell", "degree"), DEGREES, ids=str)
def test_order_is_a_permutation_that_starts_with_the_corners(cell, degree):
    if cell is PYRAMID:
        pytest.skip("a pyramid is written as a hexahedron")
    order = vtk_order(cell, degree)
    assert sorted(order) == list(range(bernstein(cell, degree).n))
    corners = greville(bernstein(cell, degree))[order[: len(cell.vertices)]]
    np.testing.assert_array_equal(corners, cell.vertices[list(cell.vtk)])


def octant_of_ball():
    """Quarter cylinder of radius 2 and height 1 as one rational hexahedron of degrees (1, 2, 1)."""
    r = np.sqrt(0.5)
    arc, w = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), np.array([1.0, r, 1.0])
    points = [[*(radius * arc[j]), z] for radius in (1.0, 2.0) for j in range(3) for z in (0.0, 1.0)]
    weights = np.array([w[j] for _ in (1, 2) for j in range(3) for _ in (0, 1)])
    basis = bernstein(HEXAHEDRON, (1, 2, 1))
    return Domain(Space((Block(basis, np.arange(12)[None]),), 12, weights), np.array(points))


def test_vtk_tessellates_a_cylinder_exactly(tmp_path):
    domain = octant_of_ball()
    grid = pv.read(write_vtu(tmp_path / "cylinder.vtu", domain, degree=3))
    skin = grid.extract_surface(nonlinear_subdivision=4, algorithm="dataset_surface")
    outer = skin.points[skin.point_data["RationalWeights"] > 0]
    radius = np.linalg.norm(outer[:, :2], axis=1)
    assert np.abs(radius - np.clip(radius, 1.0, 2.0)).max() < 1e-6  # VTK tessellates in single precision
    assert (np.abs(radius - 2.0) < 1e-6).sum() > 30


def test_spline_elements_become_bezier_cells():
    """Two elements of a quadratic B-spline line, extruded: C1 across the knot, so the cells join smoothly."""
    first = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.5]]
    last = [[0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    line = np.array([first, last])
    one = np.eye(2)[None]
    basis = bernstein(HEXAHEDRON, (2, 1, 1))
    number = np.arange(16).reshape(4, 2, 2)
    dofs = np.stack([number[:3].ravel(), number[1:].ravel()])
    pattern = np.array([[0, 0, 0], [1, 0, 0]])
    block = Block(basis, dofs, Kronecker((line, one, one), pattern))
    rng = np.random.default_rng(3)
    domain = Domain(Space((block,), 16), rng.normal(size=(16, 3)))
    grid = pv.wrap(bezier_grid(domain, {"u": rng.normal(size=16)}))
    assert grid.n_points == 24
    assert grid.celltypes.tolist() == [79, 79]
    order = vtk_order(HEXAHEDRON, (2, 1, 1))
    first, second = np.empty((12, 3)), np.empty((12, 3))
    first[order], second[order] = grid.points[:12], grid.points[12:]
    first, second = first.reshape(3, 4, 3), second.reshape(3, 4, 3)
    np.testing.assert_allclose(first[2], second[0], atol=1e-14)
    np.testing.assert_allclose(first[2] - first[1], second[1] - second[0], atol=1e-14)


def mixed():
    """One hexahedron with a pyramid on top, a wedge at its side and a tetrahedron on the wedge."""
    v = np.array([*np.ndindex(2, 2, 2)], dtype=float)
    v = np.vstack([v, [0.5, 0.5, 1.8], [1.7, 0.0, 0.0], [1.7, 1.0, 0.0], [1.6, 0.4, 1.0]])
    parts = (
        (HEXAHEDRON, np.array([[0, 1, 2, 3, 4, 5, 6, 7]])),
        (PYRAMID, np.array([[1, 3, 5, 7, 8]])),
        (WEDGE, np.array([[4, 6, 5, 7, 9, 10]])),
    )
    return straight_domain(Complex(parts), v[:11], 2)


def test_mixed_cells_and_fields_of_other_degree(tmp_path):
    domain = mixed()
    fine = straight_domain(
        Complex(tuple((b.basis.cell, np.arange(len(b.basis.cell.vertices))[None]) for b in domain.space.blocks[:1])),
        HEXAHEDRON.vertices, 3,
    )  # fmt: skip
    assert fine.space.n == 64
    only = Domain(Space(domain.space.blocks[:1], domain.space.n), domain.points)
    cubic = Field(fine.space, fine.points[:, 0] ** 1)
    grid = pv.wrap(bezier_grid(only, {"cubic": cubic}))
    assert grid.cell_data["HigherOrderDegrees"][0].tolist() == [3, 3, 3]
    np.testing.assert_allclose(grid.point_data["cubic"], grid.points[:, 0], atol=1e-14)
    path = write_vtu(tmp_path / "mixed.vtu", domain, {"z": domain.points[:, 2]})
    grid = pv.read(path)
    assert grid.celltypes.tolist() == [79, 79, 80]
    assert grid.cell_data["block"].tolist() == [0, 1, 2]
    np.testing.assert_allclose(grid.point_data["z"], grid.points[:, 2], atol=1e-14)


def test_sampled_cells_fill_the_same_volume(tmp_path):
    domain = mixed()
    grid = pv.read(write_vtk(tmp_path / "mixed.vtk", domain, {"z": domain.points[:, 2]}, pieces=3))
    np.testing.assert_allclose(grid.point_data["z"], grid.points[:, 2], atol=1e-6)
    sizes = grid.compute_cell_sizes(length=False, area=False).cell_data["Volume"]
    exact = [1.0, 0.8 / 3.0, 0.35]
    for block, volume in enumerate(exact):
        assert abs(sizes[grid.cell_data["block"] == block].sum() - volume) < 1e-5, block
    read = meshio.read(tmp_path / "mixed.vtk")
    np.testing.assert_array_equal(np.concatenate(read.cell_data["element"]), 0)
    np.testing.assert_allclose(read.point_data["z"].ravel(), read.points[:, 2], atol=1e-6)


@pytest.mark.parametrize("cell", [TETRAHEDRON, HEXAHEDRON, WEDGE], ids=str)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_subdivisions_fill_the_cell(cell, n):
    points, cells = subdivision(cell, n)
    shape = bernstein(cell, 1)
    from iga.quadrature import gauss

    rule = gauss(cell, 2)
    gradients = shape.tabulate(rule.points, 1)[1]
    determinant = np.linalg.det(np.einsum("kvc,qvd->kqcd", points[cells], gradients))
    assert (determinant > 0).all()
    assert abs((determinant @ rule.weights).sum() - cell.volume) < 1e-14


def test_gradient_of_samples_is_that_of_the_chunk():
    from iga.chunk import Chunk

    domain, u = one_element(HEXAHEDRON, (2, 3, 2), True)
    xi = points_inside(HEXAHEDRON, 5)
    samples = Samples(domain, 0, np.array([0]), xi)
    chunk = Chunk(domain, 0, np.array([0]), xi, np.ones(5))
    vector = np.column_stack([u, 2 * u, u * u])
    np.testing.assert_allclose(samples.x, chunk.x, atol=1e-14)
    np.testing.assert_allclose(samples.gradient(u), chunk.gradient(u), atol=1e-11)
    np.testing.assert_allclose(samples.gradient(vector), chunk.gradient(vector), atol=1e-11)


def test_wrong_fields_and_names_are_told(tmp_path):
    domain = mixed()
    n = domain.space.n
    with pytest.raises(InputError, match=r"field 'u' has shape \(3,\)"):
        write_vtu(tmp_path / "a.vtu", domain, {"u": np.zeros(3)})
    with pytest.raises(InputError, match="field 'u' is not finite at function 4"):
        write_vtu(tmp_path / "a.vtu", domain, {"u": np.where(np.arange(n) == 4, np.nan, 0.0)})
    with pytest.raises(InputError, match="cannot be called 'RationalWeights'"):
        write_vtu(tmp_path / "a.vtu", domain, {"RationalWeights": np.zeros(n)})
    with pytest.raises(InputError, match=r"must end in \.vtu"):
        write_vtu(tmp_path / "a.vtk", domain)
    with pytest.raises(InputError, match="no folder"):
        write_vtu(tmp_path / "none" / "a.vtu", domain)
    assert not list(tmp_path.iterdir())
