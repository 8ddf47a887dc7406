"""Solids read back from the Bezier cells of a ``.vtu`` file, such as `iga.exchange.export.write_vtu` makes.

Every cell becomes an element with functions of its own, so fields that jump between elements survive. The boundary is
found from the corners that cells share. A pyramid comes back as the collapsed hexahedron that the file holds.

Axis letters: e element, b Bernstein function, c component.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein, functions_at
from iga.block import Block
from iga.cells import HEXAHEDRON, TETRAHEDRON, WEDGE, Cell
from iga.domain import Domain, Facets, Space
from iga.errors import FormatError
from iga.exchange.export import vtk_order

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELL_OF = {79: HEXAHEDRON, 78: TETRAHEDRON, 80: WEDGE}


def read_vtu(path: str | Path) -> tuple[Domain, dict[str, Array]]:
    """Read a solid and the fields on it.

    Returns
    -------
    The domain, with all its boundary facets under the name "boundary", and coefficients (n,) or (n, c) by field name.

    Raises
    ------
    FormatError : the file is missing or damaged, or holds no Bezier cells.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkObject
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    path = Path(path)
    if not path.is_file():
        raise FormatError(f"{path} does not exist")
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(path))
        reader.Update()
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    grid = reader.GetOutput()
    if reader.GetErrorCode() or not grid.GetNumberOfCells():
        raise FormatError(f"{path} is not a VTK unstructured grid, or is damaged")
    types = vtk_to_numpy(grid.GetCellTypes())
    degrees = grid.GetCellData().GetHigherOrderDegrees()
    if degrees is None or not set(np.unique(types).tolist()) <= set(CELL_OF):
        raise FormatError(f"{path} holds other cells than Bezier hexahedra, tetrahedra and wedges")
    kinds = np.column_stack([types, vtk_to_numpy(degrees)]).astype(np.int64)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    connectivity = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).astype(np.int64)
    places = vtk_to_numpy(grid.GetPoints().GetData()).astype(np.float64)
    blocks, gathered = [], []
    start = 0
    for kind in np.unique(kinds, axis=0):
        cell = CELL_OF[int(kind[0])]
        degree = _degree(cell, kind[1:])
        basis = bernstein(cell, degree)
        cells = np.flatnonzero((kinds == kind).all(axis=1))
        if (np.diff(offsets)[cells] != basis.n).any():
            raise FormatError(f"{path}: a {cell.name} of degree {degree} has {basis.n} points, cell {cells[0]} has not")
        order = np.empty(basis.n, dtype=np.int64)
        order[vtk_order(cell, degree)] = np.arange(basis.n)
        gathered.append(connectivity[offsets[cells][:, None] + order].ravel())
        blocks.append(Block(basis, start + np.arange(len(cells) * basis.n).reshape(len(cells), -1)))
        start += len(gathered[-1])
    take = np.concatenate(gathered)
    data = grid.GetPointData()
    fields = {data.GetArrayName(k): vtk_to_numpy(data.GetArray(k))[take] for k in range(data.GetNumberOfArrays())}
    weights = fields.pop("RationalWeights", None)
    space = Space(tuple(blocks), len(take), None if weights is None else np.ascontiguousarray(weights, dtype=float))
    points = np.ascontiguousarray(places[take])
    domain = Domain(space, points, {"boundary": _boundary(blocks, points)})
    return domain, {name: np.ascontiguousarray(values, dtype=float) for name, values in fields.items()}


def _degree(cell: Cell, three: Index) -> tuple[int, ...]:
    p = tuple(int(d) for d in three)
    return {"hexahedron": p, "tetrahedron": p[:1], "wedge": (p[0], p[2])}[cell.name]


def _boundary(blocks: list[Block], points: Array) -> tuple[Facets, ...]:
    """Facets whose corners no second cell has; corners are one vertex if they coincide to single precision."""
    corners = [block.dofs[:, functions_at(block.basis, block.basis.cell.vertices)] for block in blocks]
    flat = np.concatenate([c.ravel() for c in corners])
    size = float(np.ptp(points, axis=0).max()) or 1.0
    cells = np.round((points[flat] - points.min(axis=0)) / (1e-6 * size)).astype(np.int64)
    vertex = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    found: list[tuple[int, int, Index]] = []
    at = 0
    for number, (block, own) in enumerate(zip(blocks, corners)):
        numbers = vertex[at : at + own.size].reshape(own.shape)
        at += own.size
        found += [(number, k, numbers[:, face.vertices]) for k, face in enumerate(block.basis.cell.faces)]
    keys = np.concatenate([_distinct(numbers) for _, _, numbers in found])
    inverse, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)[1:]
    # A face with less than three corners of its own (at the apex of a pyramid) has no area.
    single = (count[inverse.ravel()] == 1) & (keys[:, 2] >= 0)
    facets, at = [], 0
    for number, k, numbers in found:
        elements = np.flatnonzero(single[at : at + len(numbers)])
        at += len(numbers)
        if len(elements):
            facets.append(Facets(number, k, elements))
    return tuple(facets)


def _distinct(corners: Index) -> Index:
    """Sorted distinct vertices of each face (m, 4), filled up with -1."""
    ordered = np.sort(corners, axis=1)
    ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
    filled = -np.sort(-ordered, axis=1)
    return np.pad(filled, ((0, 0), (0, 4 - corners.shape[1])), constant_values=-1)
