"""Creases of a skin, and its smooth sides around each vertex.

Two elements that meet at an angle have a crease between them. Around a vertex, corners of elements that meet without
one are on one side.

Axis letters: e element, v vertex, g side, m corner of an element, k pair, b Bernstein function, x and c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.hybrid.shell import Shell
from iga.block import bezier_coefficients

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SHARP = np.deg2rad(30.0)
"""Angle between the normals of two elements from which their common edge is a crease."""


@dataclass(frozen=True, eq=False)
class Creases:
    """The smooth sides of a skin around its vertices, and its creases.

    Attributes
    ----------
    side : for each block (e, m) number of the side that each corner of an element is on.
    beside : (k, 2) sides and the vertices beside their own on them.
    vertex : (g,) vertex of each side.
    sharp : for each block (e, edges) which edges are creases.
    along : (k, 2) vertices on creases and the next ones along these.
    """

    side: tuple[Index, ...]
    beside: Index
    vertex: Index
    sharp: tuple[Mask, ...]
    along: Index


def creases(shell: Shell) -> Creases:
    """Sides and creases of a shell."""
    count = len(shell.vertices)
    keys, normals, corners, ends = [], [], [], []
    first = 0
    for block, own in zip(shell.space.blocks, shell.corners):
        cell = block.basis.cell
        gradients = block.basis.tabulate(cell.vertices, 1)[1]
        J = np.einsum("mbd,ebc->emcd", gradients, bezier_coefficients(block, shell.points))
        normal = np.cross(J[..., 0], J[..., 1])
        normal /= np.linalg.norm(normal, axis=2, keepdims=True) + 1e-300
        number = first + np.arange(own.size).reshape(own.shape)
        first += own.size
        turned = own[:, cell.edges[:, 0]] > own[:, cell.edges[:, 1]]
        local = np.where(turned[:, :, None], cell.edges[:, ::-1], cell.edges)  # (e, edges, 2), lower vertex first
        rows = np.arange(len(own))[:, None, None]
        pair = own[rows, local]
        keys.append((pair @ np.array([count, 1])).ravel())
        ends.append(pair.reshape(-1, 2))
        normals.append(normal[rows, local].reshape(-1, 2, 3))
        corners.append(number[rows, local].reshape(-1, 2))
    order = np.argsort(np.concatenate(keys), kind="stable").reshape(-1, 2)  # both elements of each edge
    n, at, pairs = (np.concatenate(some) for some in (normals, corners, ends))
    cosine = np.einsum("kvc,kvc->kv", n[order[:, 0]], n[order[:, 1]]).min(axis=1)
    crease = cosine < np.cos(SHARP)
    a, b = (at[order[~crease][:, k]].ravel() for k in range(2))
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(first, first))
    groups, label = connected_components(graph, directed=False)
    label = label.astype(np.int64)
    vertex = np.empty(groups, dtype=np.int64)
    vertex[label[at.ravel()]] = pairs.ravel()
    beside = np.unique(np.concatenate([
        np.stack([label[at[:, k]], pairs[:, 1 - k]], axis=1) for k in range(2)
    ]), axis=0)
    flags = np.zeros(len(pairs), dtype=bool)
    flags[order[crease]] = True
    line = pairs[order[crease][:, 0]]
    sides, sharp, place, spot = [], [], 0, 0
    for block, own in zip(shell.space.blocks, shell.corners):
        edges = len(block.basis.cell.edges)
        sides.append(label[place : place + own.size].reshape(own.shape))
        sharp.append(flags[spot : spot + len(own) * edges].reshape(-1, edges))
        place, spot = place + own.size, spot + len(own) * edges
    return Creases(tuple(sides), beside, vertex, tuple(sharp), np.concatenate([line, line[:, ::-1]]))
