"""Files for ParaView: exact Bezier cells (``.vtu``) and sampled linear cells (``.vtk``).

`write_vtu` writes every element as one VTK Bezier cell, so the file holds the spline geometry itself, not a
tessellation:

    hexahedron    VTK_BEZIER_HEXAHEDRON (79)
    tetrahedron   VTK_BEZIER_TETRAHEDRON (78)
    wedge         VTK_BEZIER_WEDGE (80)
    pyramid       VTK_BEZIER_HEXAHEDRON in the collapsed coordinates (a, b, c), four corners at the apex. VTK has no
                  Bezier pyramid, and none is needed: in (a, b, c) the rational pyramid is a polynomial whose layer k
                  has degree p - k in a and b, and raising all layers to degree p is exact.

Rational weights are the point data array ``RationalWeights``, degrees the cell data array ``HigherOrderDegrees``, both
marked as VTK's active attributes of these names. Points are repeated for each element, so that discontinuous quantities
fit. Cell data ``block`` and ``element`` say where a cell came from.

Fields in the domain's own functions are exact. So are polynomial fields of other degrees on polynomial geometry: the
cells take the highest degree. Anything else (functions such as von Mises stress; fields with other weights) is
interpolated on each element in the cell's functions at its domain points, pulled into the cell by a thousandth.

Axis letters: e element, b Bernstein function (ours or VTK's order), c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import Bernstein, bernstein, elevation, greville, lagrange_to_bernstein
from iga.cells import HEXAHEDRON, PYRAMID, QUADRILATERAL, Cell
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.exchange.files import replacing, require_place
from iga.sampling import Quantity, evaluate_block, named_quantities, subdivision, weighted_coefficients

if TYPE_CHECKING:
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BEZIER_TYPE = {"hexahedron": 79, "tetrahedron": 78, "wedge": 80, "pyramid": 79}
LINEAR_TYPE = {"hexahedron": 12, "tetrahedron": 10, "wedge": 13, "pyramid": 12}
PULL = 1e-3
"""How far towards the middle of a cell values are taken: derivatives jump at faces and fail at an apex."""
_RESERVED = ("RationalWeights", "HigherOrderDegrees", "block", "element")


def write_vtu(path: str | Path, domain: Domain, fields: Mapping[str, Any] | None = None, degree: int = 1) -> Path:
    """Write a domain and fields on it as VTK Bezier cells.

    Parameters
    ----------
    path : file, ends in ``.vtu``.
    fields : by name: coefficients (n,) or (n, c) in the domain's functions, an object with ``coefficients`` and
        ``space``, or a function of `iga.sampling.Samples` that returns (m, q) or (m, q, c). Attributes of the
        domain are written as well.
    degree : least degree of the cells; raise it to interpolate functions better.

    Raises
    ------
    InputError : the path or a field is wrong, or the file cannot be written; an existing file is then left whole.
    """
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    path = require_place(path, ".vtu")
    grid = bezier_grid(domain, fields, degree)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(2)
    return _written(writer, path)


def write_vtk(path: str | Path, domain: Domain, fields: Mapping[str, Any] | None = None, pieces: int = 0) -> Path:
    """Write a domain and fields as linear cells in the legacy VTK format, for tools that know no Bezier cells.

    Parameters
    ----------
    path : file, ends in ``.vtk``.
    fields : as in `write_vtu`.
    pieces : sub-cells along each edge of an element; 0 takes the highest degree of the element.

    Raises
    ------
    InputError : as in `write_vtu`.
    """
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    path = require_place(path, ".vtk")
    writer = vtkUnstructuredGridWriter()
    writer.SetInputData(linear_grid(domain, fields, pieces))
    writer.SetFileTypeToBinary()
    writer.SetFileVersion(42)  # of VTK before 9: the layout of cells that all readers know
    writer.SetHeader("isogeometric domain, sampled")
    return _written(writer, path)


def _written(writer: Any, path: Path) -> Path:
    """Let a VTK writer write a file, whole or not at all."""
    with replacing(path) as temporary:
        writer.SetFileName(str(temporary))
        if writer.Write() != 1 or writer.GetErrorCode() != 0:
            raise InputError(f"{path}: cannot be written (is the disk full?)")
    return path


# --- Bezier cells ----------------------------------------------------------------------------------------------------


def bezier_grid(domain: Domain, fields: Mapping[str, Any] | None = None, degree: int = 1) -> vtkUnstructuredGrid:
    """Return the grid that `write_vtu` writes."""
    quantities = named_quantities(domain, {**domain.attributes, **(fields or {})})
    for name in quantities:
        if name in _RESERVED:
            raise InputError(f"a field cannot be called {name!r}: the file format uses that name")
    rational = domain.space.weights is not None
    points, weights, degrees, types, sizes, origin = [], [], [], [], [], []
    data: dict[str, list[Array]] = {name: [] for name in quantities}
    for number, block in enumerate(domain.space.blocks):
        cell = block.basis.cell
        if cell.name not in BEZIER_TYPE:
            raise InputError(f"block {number}: VTK has no three-dimensional Bezier {cell.name}")
        spaces = [space for _, space in quantities.values()]
        basis = _common(cell, [s.blocks[number].basis.degree for s in [domain.space, *spaces]], degree)
        geometry, w = _raised(domain.space, number, domain.points, basis)
        vtk_weights = None if w is None else _to_vtk(basis, w[..., None])[..., 0]
        points.append(_projected(_to_vtk(basis, geometry), vtk_weights))
        if rational:
            weights.append((np.ones(points[-1].shape[:2]) if vtk_weights is None else vtk_weights).ravel())
        for name, (quantity, space) in quantities.items():
            values = _coefficients(domain, number, quantity, space, basis, w)
            data[name].append(_projected(_to_vtk(basis, values), vtk_weights).reshape(-1, values.shape[-1]))
        elements = block.elements
        sizes.append(np.full(elements, points[-1].shape[1]))
        types.append(np.full(elements, BEZIER_TYPE[cell.name], dtype=np.uint8))
        degrees.append(np.tile(_three_degrees(basis), (elements, 1)))
        origin.append(np.column_stack([np.full(elements, number), np.arange(elements)]))
    count = sum(p.shape[0] * p.shape[1] for p in points)
    grid = _assemble(
        np.concatenate([p.reshape(-1, 3) for p in points]),
        np.concatenate(types),
        np.concatenate(sizes),
        np.arange(count),
    )
    _add(grid.GetPointData(), {name: _scalar_or_vector(np.concatenate(v)) for name, v in data.items()})
    where = np.concatenate(origin)
    _add(grid.GetCellData(), {"block": where[:, 0], "element": where[:, 1]})
    if rational:
        grid.GetPointData().SetRationalWeights(_vtk_array("RationalWeights", np.concatenate(weights)))
    grid.GetCellData().SetHigherOrderDegrees(_vtk_array("HigherOrderDegrees", np.concatenate(degrees).astype(float)))
    return grid


def _common(cell: Cell, degrees: list[tuple[int, ...]], least: int) -> Bernstein:
    """Basis of the highest degree in each direction."""
    return bernstein(cell, tuple(max(least, *(d[k] for d in degrees)) for k in range(len(degrees[0]))))


def _raised(space: Space, block: int, coefficients: Array, basis: Bernstein) -> tuple[Array, Array | None]:
    """Homogeneous coefficients (e, b, c) and weights (e, b) in a higher degree; exact."""
    values, weights = weighted_coefficients(space, block, coefficients)
    own = space.blocks[block].basis
    if own.degree != basis.degree:
        raise_ = elevation(bernstein(own.cell, own.degree), basis.degree)
        values = raise_ @ values
        weights = None if weights is None else weights @ raise_.T
    return values, weights


def _coefficients(
    domain: Domain, block: int, quantity: Quantity, space: Space, basis: Bernstein, weights: Array | None
) -> Array:
    """Homogeneous coefficients (e, b, c) of a quantity with respect to the geometry's weights."""
    same = space is domain.space or (space.weights is None and domain.space.weights is None)
    if isinstance(quantity, np.ndarray) and same:
        return _raised(space, block, quantity, basis)[0]
    xi = greville(basis)
    centre = basis.cell.vertices.mean(axis=0)
    inside = centre + (1.0 - PULL) * (xi - centre)
    values = evaluate_block(quantity, space, domain, block, inside)
    if weights is not None:
        values = values * (weights @ basis.tabulate(inside, 0)[0].T)[..., None]
    return lagrange_to_bernstein(basis, inside) @ values


def _projected(values: Array, weights: Array | None) -> Array:
    return values if weights is None else values / weights[..., None]


def _three_degrees(basis: Bernstein) -> Index:
    p = basis.degree
    if basis.cell.name == "hexahedron":
        return np.array(p)
    return np.array([p[0], p[0], p[-1]])


def _scalar_or_vector(values: Array) -> Array:
    return values[:, 0] if values.shape[1] == 1 else values


@cache
def vtk_order(cell: Cell, degree: tuple[int, ...]) -> Index:
    """Return our function for each point of VTK's Bezier cell, (b,): corners, then edges, faces, the interior."""
    exponents = bernstein(cell, degree).exponents.tolist()
    order = np.empty(len(exponents), dtype=np.int64)
    if cell.name == "hexahedron":
        from vtkmodules.vtkCommonDataModel import vtkHigherOrderHexahedron

        for ours, (i, j, k) in enumerate(exponents):
            order[vtkHigherOrderHexahedron.PointIndexFromIJK(i, j, k, list(degree))] = ours
    elif cell.name == "wedge":
        from vtkmodules.vtkCommonDataModel import vtkHigherOrderWedge

        p, q = degree
        size = (p + 1) * (p + 2) // 2 * (q + 1)
        for ours, (_, i, j, k) in enumerate(exponents):
            order[vtkHigherOrderWedge.PointIndexFromIJK(i, j, k, [p, p, q, size])] = ours
    elif cell.name == "tetrahedron":
        from vtkmodules.vtkCommonDataModel import vtkHigherOrderTetra

        index = {tuple(a): ours for ours, a in enumerate(exponents)}
        place = [0, 0, 0, 0]
        for theirs in range(len(order)):
            vtkHigherOrderTetra.BarycentricIndex(theirs, place, degree[0])
            order[theirs] = index[place[3], place[0], place[1], place[2]]
    else:
        raise InputError(f"VTK has no three-dimensional Bezier {cell.name}")
    return order


def _to_vtk(basis: Bernstein, values: Array) -> Array:
    """Reorder our coefficients (e, b, c) to those of the VTK cell; a pyramid's layers are raised on the way."""
    if basis.cell.name == "pyramid":
        return _collapsed(basis.degree[0]) @ values
    return values[:, vtk_order(basis.cell, basis.degree)]


@cache
def _collapsed(p: int) -> Array:
    """Matrix from a pyramid's coefficients to those of its hexahedron in (a, b, c), in VTK's order."""
    matrix = np.zeros(((p + 1) ** 2, p + 1, bernstein(PYRAMID, p).n))
    at = 0
    for k in range(p + 1):
        layer = elevation(bernstein(QUADRILATERAL, p - k), (p, p))
        matrix[:, k, at : at + layer.shape[1]] = layer
        at += layer.shape[1]
    return matrix.reshape((p + 1) ** 3, -1)[vtk_order(HEXAHEDRON, (p, p, p))]


# --- linear cells ----------------------------------------------------------------------------------------------------


def linear_grid(domain: Domain, fields: Mapping[str, Any] | None = None, pieces: int = 0) -> vtkUnstructuredGrid:
    """Return the grid that `write_vtk` writes: each element cut into straight cells, all values exact at their corners.

    A function that has no value at a corner (a gradient at a pyramid's apex) is taken a thousandth inside.
    """
    quantities = named_quantities(domain, {**domain.attributes, **(fields or {})})
    points, types, sizes, corners, origin = [], [], [], [], []
    data: dict[str, list[Array]] = {name: [] for name in quantities}
    start = 0
    for number, block in enumerate(domain.space.blocks):
        cell = block.basis.cell
        xi, cells = subdivision(cell, pieces or max(block.basis.degree))
        elements = np.arange(block.elements)
        points.append(evaluate_block(domain.points, domain.space, domain, number, xi).reshape(-1, 3))
        inside = cell.vertices.mean(axis=0) * PULL + (1.0 - PULL) * xi
        for name, (quantity, space) in quantities.items():
            at = xi if isinstance(quantity, np.ndarray) else inside
            values = evaluate_block(quantity, space, domain, number, at)
            data[name].append(values.reshape(-1, values.shape[-1]))
        own = HEXAHEDRON if cell.name == "pyramid" else cell
        shift = start + np.arange(block.elements)[:, None, None] * len(xi)
        corners.append((shift + cells[:, own.vtk]).ravel())
        types.append(np.full(block.elements * len(cells), LINEAR_TYPE[cell.name], dtype=np.uint8))
        sizes.append(np.full(block.elements * len(cells), cells.shape[1]))
        origin.append(np.column_stack([np.full(len(sizes[-1]), number), np.repeat(elements, len(cells))]))
        start += len(xi) * block.elements
    grid = _assemble(np.concatenate(points), np.concatenate(types), np.concatenate(sizes), np.concatenate(corners))
    _add(grid.GetPointData(), {name: _scalar_or_vector(np.concatenate(v)) for name, v in data.items()})
    where = np.concatenate(origin)
    _add(grid.GetCellData(), {"block": where[:, 0], "element": where[:, 1]})
    return grid


# --- VTK arrays ------------------------------------------------------------------------------------------------------


def _assemble(points: Array, types: NDArray[np.uint8], sizes: Index, corners: Index) -> vtkUnstructuredGrid:
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid

    grid = vtkUnstructuredGrid()
    places = vtkPoints()
    places.SetDataTypeToDouble()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    grid.SetPoints(places)
    cells = vtkCellArray()
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    cells.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(corners.astype(np.int64), deep=True)
    )
    grid.SetCells(numpy_to_vtk(types, deep=True), cells)
    return grid


def _add(where: Any, arrays: Mapping[str, NDArray[Any]]) -> None:
    for name, values in arrays.items():
        where.AddArray(_vtk_array(name, values))


def _vtk_array(name: str, values: NDArray[Any]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    return array
