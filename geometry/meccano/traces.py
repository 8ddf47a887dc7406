"""What a space of hierarchical splines has on the sides of its blocks: facets of elements, and functions with a trace.

Inside a block the trace of a function on a side is not zero exactly if the spline's index normal to the side is the
first (or the last), so on a side the functions see the first layer of cells only.

Axis letters: f side, n function.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.hierarchical import Hierarchy
from geometry.meccano.tmesh import on_side
from iga.bernstein import face_functions
from iga.domain import Facets

Index = NDArray[np.int64]


def facets_on(own: Hierarchy, block: int, side: int) -> tuple[Facets, ...]:
    """Facets of all elements on a side of a block; local faces have the side's number."""
    where = own.element[on_side(own.tmesh, block, side)]
    return tuple(
        Facets(number, side, np.sort(where[where[:, 0] == number, 1])) for number in np.unique(where[:, 0]).tolist()
    )


def boundaries(own: Hierarchy) -> dict[str, tuple[Facets, ...]]:
    """Facets of every boundary side, named ``side0``, ``side1``, ... by rows of ``blocks.boundary_sides``."""
    rows = own.tmesh.blocks.boundary_sides.tolist()
    return {f"side{row}": facets_on(own, block, side) for row, (block, side) in enumerate(rows)}


def functions_on(own: Hierarchy, sides: Index | None = None) -> Index:
    """Functions, ascending, that do not vanish on some of the sides (f, 2), each a block and its side.

    Parameters
    ----------
    sides : all boundary sides by default.
    """
    rows = own.tmesh.blocks.boundary_sides if sides is None else np.asarray(sides).reshape(-1, 2)
    splines = np.zeros(own.expansion.shape[0])
    for block, side in rows.tolist():
        # Traces of tensor-product splines on a cell of the first layer are those of the Bernstein functions.
        trace = face_functions(own.cells.basis, side)[1]
        splines[own.cells.dofs[np.ix_(on_side(own.tmesh, block, side), trace)]] = 1.0
    return np.flatnonzero(abs(own.expansion).T @ splines)
