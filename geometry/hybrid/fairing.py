r"""Smooth displacements of a skin whose functions are smoother than C0, from shifts of its vertices.

The coefficients d (n) minimise

    sum_v W^2 |D(v) - shift_v|^2 + sum_e |second differences of the Bernstein coefficients of D on e|^2
    + ADJUST^2 |difference between a face's splines, without revision, and the curves|^2

with D = sum_n d_n N_n: splines through the shifts with least bending. Functions are C2 inside faces, so a displacement
with a kink at every vertex, such as a piecewise linear one, would be met with an error of first order in its slope;
this one stays smooth when elements are made smaller (Song and Cohen 2019, Section 4.2: control points are traced, and
then moved by least squares so that neighbouring faces agree along trimming curves).

Axis letters: e element, v vertex, n function, b Bernstein function, r row, c component.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import splu

from geometry.hybrid.shell import Shell
from iga.bernstein import Bernstein, functions_at
from iga.block import Block, dense_extraction
from iga.cells import QUADRILATERAL

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RIDGE = 1e-12
"""Added to the diagonal of normal equations with columns of length one: what is below has no say in them."""
THROUGH = 30.0
"""Weight of the shifts of vertices beside second differences."""
ADJUST = 10.0
"""Weight of the difference between a face's splines and the curves."""


def fair_displacement(shell: Shell, shift: Array) -> Array:
    """Coefficients (n, c) of the displacement."""
    n = shell.space.n
    parts, target, seen = [], [], np.zeros(len(shell.vertices), dtype=bool)
    for block, corners in zip(shell.space.blocks, shell.corners):
        assert isinstance(block.basis, Bernstein)
        bends = _rows(block, second_differences(block.basis), np.arange(block.elements))
        parts.append(bends)
        target.append(np.zeros((bends.shape[0], shift.shape[1])))
        at = functions_at(block.basis, block.basis.cell.vertices)
        for k, b in enumerate(at.tolist()):
            new, first = np.unique(corners[:, k], return_index=True)
            first = first[~seen[new]]
            seen[corners[first, k]] = True
            unit = np.zeros((1, block.basis.n))
            unit[0, b] = THROUGH
            parts.append(_rows(block, unit, first))
            target.append(THROUGH * shift[corners[first, k]])
    if shell.adjust is not None:
        parts.append(csr_array(ADJUST * shell.adjust))
        target.append(np.zeros((shell.adjust.shape[0], shift.shape[1])))
    for part in parts:
        part.resize(part.shape[0], n)
    A, right = csr_array(vstack(parts, format="csr")), np.concatenate(target)
    # Normal equations with columns of length one and a step of refinement; what is nearly dependent moves nothing.
    size = 1.0 / np.sqrt(np.asarray(A.multiply(A).sum(axis=0)))
    A = csr_array(A @ diags_array(size))
    solver = splu(csc_array(A.T @ A + RIDGE * diags_array(np.ones(n))))
    found = solver.solve(A.T @ right)
    found += solver.solve(A.T @ (right - A @ found))
    return np.asarray(size[:, None] * found)


def _rows(block: Block, rows: Array, elements: Index) -> csr_array:
    """Rows (r, b) on the Bernstein coefficients of some elements, as rows (e r, n) on a block's functions."""
    C = dense_extraction(block, elements)
    C = np.broadcast_to(np.eye(block.n), (len(elements), block.n, block.n)) if C is None else C
    values = np.einsum("enb,rb->ern", C, rows)
    e, r, i = np.nonzero(np.abs(values) > 1e-13)
    at = (e * len(rows) + r, block.dofs[elements][e, i])
    return csr_array(coo_array((values[e, r, i], at), shape=(len(elements) * len(rows), 1 + int(block.dofs.max()))))


@cache
def second_differences(basis: Bernstein) -> Array:
    """Matrix (r, b): differences of second order of Bernstein coefficients along the directions of a cell."""
    found = []
    exponents = [tuple(row) for row in basis.exponents.tolist()]
    place = {own: k for k, own in enumerate(exponents)}

    def add(*terms: tuple[tuple[int, ...], float]) -> None:
        if all(own in place for own, _ in terms):
            row = np.zeros(basis.n)
            for own, factor in terms:
                row[place[own]] += factor
            found.append(row)

    steps = [(1, 0), (0, 1)] if basis.cell is QUADRILATERAL else [(-1, 1, 0), (0, -1, 1), (1, 0, -1)]

    def moved(own: tuple[int, ...], *ways: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(np.add(own, np.sum(ways, axis=0)).tolist())

    for own in exponents:
        for k, a in enumerate(steps):
            add((own, 1.0), (moved(own, a), -2.0), (moved(own, a, a), 1.0))
            for b in steps[k + 1 :]:
                add((own, 1.0), (moved(own, a), -1.0), (moved(own, b), -1.0), (moved(own, a, b), 1.0))
    return np.array(found)
