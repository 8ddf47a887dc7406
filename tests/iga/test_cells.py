"""Cells: faces close up, look outward and give the volume by the divergence theorem."""

from __future__ import annotations

import numpy as np
import pytest

from iga.cells import CELLS, Cell

THREE = [cell for cell in CELLS.values() if cell.dim == 3]


@pytest.mark.parametrize("cell", THREE, ids=str)
def test_faces_are_closed_and_give_the_volume(cell: Cell) -> None:
    total, volume = np.zeros(3), 0.0
    for face in cell.faces:
        area = np.cross(face.axes[:, 0], face.axes[:, 1])
        centroid = face.origin + face.axes @ face.cell.centre
        total += area * face.cell.volume
        volume += area @ centroid * face.cell.volume / 3
        assert area @ (centroid - cell.centre) > 0
    assert np.abs(total).max() < 1e-15
    assert abs(volume - cell.volume) < 1e-15


@pytest.mark.parametrize("cell", CELLS.values(), ids=str)
def test_face_maps_hit_the_named_vertices(cell: Cell) -> None:
    for face in cell.faces:
        image = face.origin + face.cell.vertices @ face.axes.T
        assert np.array_equal(image, cell.vertices[list(face.vertices)])


@pytest.mark.parametrize("cell", THREE, ids=str)
def test_every_edge_lies_on_two_faces(cell: Cell) -> None:
    for a, b in cell.edges:
        assert sum({a, b} <= set(face.vertices) for face in cell.faces) == 2
    assert len(cell.vertices) - len(cell.edges) + len(cell.faces) == 2


@pytest.mark.parametrize("cell", CELLS.values(), ids=str)
def test_vtk_order_is_a_permutation(cell: Cell) -> None:
    assert sorted(cell.vtk) == list(range(len(cell.vertices)))
