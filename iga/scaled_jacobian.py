r"""Scaled Jacobian: the determinant of the derivatives relative to their lengths, at points (a sample, not a proof).

The measure of the papers: 1 for the ideal cell, below 0 where the map is turned over. See `iga.certificate` for proofs.

Axis letters: e element, q point, c component, d reference dimension.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iga.chunk import Chunk
from iga.domain import Domain
from iga.quadrature import gauss

Array = NDArray[np.float64]

SIZE = 512
"""Elements at a time."""

# Ideal cells: the columns are the edge vectors of the cell whose scaled Jacobian is one.
_ROOT = {"tetrahedron": np.sqrt(2.0), "wedge": 2.0 / np.sqrt(3.0), "hexahedron": 1.0, "pyramid": 1.0}


def scaled_jacobian(domain: Domain) -> dict[str, float | int | None]:
    r"""Scaled Jacobian at 2 x 2 x 2 Gauss points and at the centre of each element.

    The determinant divided by the lengths of the derivatives, and by its value for the ideal cell, so that it is at
    most one:

    - hexahedron: det J / (|x_r| |x_s| |x_t|), ideal is the cube;
    - tetrahedron: sqrt(2) det J / (largest product of the three edge vectors at a vertex, of the tetrahedron spanned by
      the derivatives), ideal is the regular one;
    - wedge: (2 / sqrt 3) det J / (largest product of two edges of the triangle, times |x_t|);
    - pyramid: the same as for the hexahedron for x_r, x_s and the derivative along the axis, ideal is a square pyramid.

    Returns
    -------
    min and mean over Gauss points; share_below_half, of the elements whose smallest Gauss point value is below 1/2;
    cells_negative_gauss and cells_negative_centre, how many elements have a negative value. None without elements.
    """
    least: list[Array] = []
    centre: list[Array] = []
    total = 0.0
    for number, block in enumerate(domain.space.blocks):
        cell = block.basis.cell
        rule = gauss(cell, 2)
        points = np.vstack([rule.points, cell.centre])
        for start in range(0, block.elements, SIZE):
            elements = np.arange(start, min(start + SIZE, block.elements))
            scaled = scale(cell.name, Chunk(domain, number, elements, points, np.append(rule.weights, 0.0)).J)
            least.append(scaled[:, :-1].min(axis=1))
            centre.append(scaled[:, -1])
            total += float(scaled[:, :-1].mean(axis=1).sum())
    if not least:
        return dict.fromkeys(("min", "mean", "share_below_half", "cells_negative_gauss", "cells_negative_centre"))
    low, middle = np.concatenate(least), np.concatenate(centre)
    return {
        "min": float(low.min()),
        "mean": total / len(low),
        "share_below_half": float((low < 0.5).mean()),
        "cells_negative_gauss": int((low < 0.0).sum()),
        "cells_negative_centre": int((middle < 0.0).sum()),
    }


def least_of_elements(domain: Domain) -> Array:
    """Smallest scaled Jacobian (e,) of each element at 2 x 2 x 2 Gauss points, blocks one after the other."""
    least = [np.empty(0)]
    for number, block in enumerate(domain.space.blocks):
        cell, rule = block.basis.cell, gauss(block.basis.cell, 2)
        for start in range(0, block.elements, SIZE):
            elements = np.arange(start, min(start + SIZE, block.elements))
            least.append(scale(cell.name, Chunk(domain, number, elements, rule.points, rule.weights).J).min(axis=1))
    return np.concatenate(least)


def scale(name: str, J: Array) -> Array:
    """Scaled Jacobians of matrices J (..., 3, 3) on a cell; zero where a column vanishes."""
    det = np.linalg.det(J)
    r, s, t = J[..., 0], J[..., 1], J[..., 2]
    if name == "pyramid":
        t = t - 0.5 * (r + s)
    length = np.linalg.norm
    if name == "tetrahedron":
        a, b, c = length(r, axis=-1), length(s, axis=-1), length(t, axis=-1)
        ab, ac, bc = length(s - r, axis=-1), length(t - r, axis=-1), length(t - s, axis=-1)
        size = np.max([a * b * c, a * ab * ac, b * ab * bc, c * ac * bc], axis=0)
    elif name == "wedge":
        a, b, ab = length(r, axis=-1), length(s, axis=-1), length(s - r, axis=-1)
        size = np.max([a * b, a * ab, b * ab], axis=0) * length(t, axis=-1)
    else:
        size = length(r, axis=-1) * length(s, axis=-1) * length(t, axis=-1)
    return _ROOT[name] * np.divide(det, size, out=np.zeros_like(det), where=size > 0.0)
