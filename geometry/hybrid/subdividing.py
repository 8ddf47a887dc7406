"""Skins with every element cut in four: the same functions and the same surface, on smaller elements.

Coefficients on a child are S times those on its parent (de Casteljau), so its extraction is C S^T. Axis letters:
e element, k child, n function on the element, b Bernstein function, v vertex, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.shell import Shell
from iga.bernstein import functions_at
from iga.block import Block, Patterns, bezier_coefficients, distinct_extractions
from iga.cells import QUADRILATERAL, TRIANGLE
from iga.conforming import Complex, number
from iga.domain import Space
from iga.refinement import blossom_matrix, line_subdivision, simplex_children

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def subdivided(skin: Shell) -> Shell:
    """Cut every element of a skin in four."""
    total = len(skin.vertices)
    ends = [c[:, block.basis.cell.edges] for block, c in zip(skin.space.blocks, skin.corners)]
    keys = [np.sort(e, axis=2) @ np.array([total, 1]) for e in ends]
    unique = np.unique(np.concatenate([k.ravel() for k in keys]))
    start = total + len(unique)
    blocks, corners, faces = [], [], []
    for block, own, key, face in zip(skin.space.blocks, skin.corners, keys, skin.face):
        cell = block.basis.cell
        middle = total + np.searchsorted(unique, key)
        places = [cell.vertices, cell.vertices[cell.edges].mean(axis=1)]
        numbers = [own, middle]
        if cell is QUADRILATERAL:
            places.append(cell.centre[None])
            numbers.append(start + np.arange(len(own))[:, None])
            start += len(own)
            children = (cell.vertices[:, None] + cell.vertices) / 2
        else:
            children = simplex_children(TRIANGLE) @ TRIANGLE.vertices
        nearest = np.abs(children[:, :, None] - np.concatenate(places)).max(axis=-1).argmin(axis=-1)
        corners.append(np.concatenate(numbers, axis=1)[:, nearest].reshape(-1, children.shape[1]))
        blocks.append(_cut(block))
        faces.append(np.repeat(face, 4))
    vertices = np.zeros((start, 3))
    for block, own in zip(blocks, corners):
        at = functions_at(block.basis, block.basis.cell.vertices)
        vertices[own] = bezier_coefficients(block, skin.points)[:, at]
    vertices[:total] = skin.vertices
    space = Space(tuple(blocks), skin.space.n, skin.space.weights)
    return Shell(space, skin.points, tuple(corners), vertices, tuple(faces), skin.names, skin.adjust)


def refined(skin: Shell, fields: Array) -> tuple[Shell, Array]:
    """Cut every element of a skin in four, with C0 Bernstein functions: the same surface, more functions.

    Parameters
    ----------
    fields : (n, c) coefficients of functions on the skin.

    Returns
    -------
    The shell and the coefficients there; its functions contain the skin's.
    """
    cut = subdivided(skin)
    degree = max(cut.space.blocks[0].basis.degree)
    cells = tuple((block.basis.cell, own) for block, own in zip(cut.space.blocks, cut.corners))
    dofs, n = number(Complex(cells), degree)
    old = np.column_stack([cut.points, fields])
    values = np.empty((n, old.shape[1]))
    for block, own in zip(cut.space.blocks, dofs):
        values[own] = bezier_coefficients(block, old)
    blocks = tuple(Block(block.basis, own) for block, own in zip(cut.space.blocks, dofs))
    shell = replace(cut, space=Space(blocks, n), points=np.ascontiguousarray(values[:, :3]), adjust=None)
    return shell, np.ascontiguousarray(values[:, 3:])


def _cut(block: Block) -> Block:
    """Children of a block's elements, those of one parent together, in the order of its vertices."""
    degree = block.basis.degree
    if block.basis.cell is QUADRILATERAL:
        first, second = line_subdivision(degree[0]), line_subdivision(degree[1])
        S = np.stack([np.kron(a, b) for a in first for b in second])
    else:
        corners = simplex_children(TRIANGLE).tolist()
        S = np.stack([blossom_matrix(TRIANGLE, degree[0], tuple(map(tuple, own))) for own in corners])
    C, pattern = distinct_extractions(block)
    fine = np.matmul(C[:, None], np.swapaxes(S, 1, 2)).reshape(-1, *C.shape[1:])
    which = (4 * pattern[:, None] + np.arange(4)).ravel()
    return Block(block.basis, np.repeat(block.dofs, 4, axis=0), Patterns(fine, which))
