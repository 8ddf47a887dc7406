r"""Conformity of a mixed mesh, measured: what random functions of its space jump across inner facets.

A field of random coefficients in [-1, 1] and the map are evaluated on both sides of every facet between two cells at
random points of it, each from its own cell's basis, extraction and corner order alone, so that a wrong number, a wrong
orientation, or two bases that differ on a common face show. A point of a facet is given by weights of its vertices in
an order that both cells know: a triangle's by vertex numbers; a quadrilateral's from the smallest to its smaller
neighbour and around, bilinear.

Axis letters: e element, f facet, s sample, v vertex, n function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.block import bezier_coefficients
from iga.conforming import Complex, entity_keys
from iga.domain import Domain, homogeneous
from iga.errors import InputError
from iga.sampling import bounding_box

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CHUNK = 20000
"""Facets that are evaluated at a time."""
_RING = np.array([0, 2, 3, 1])
"""Corners around a quadrilateral, whose corner (i, j) is number 2 i + j."""


@dataclass(frozen=True)
class Jump:
    """Facets between two kinds of cell.

    Attributes
    ----------
    cells : names of the two, in order of the alphabet.
    vertices : of a facet, 3 or 4.
    facets : how many.
    field : largest jump of a random field with coefficients in [-1, 1].
    map : largest distance between the two images of a point, relative to the diagonal of the control points.
    """

    cells: tuple[str, str]
    vertices: int
    facets: int
    field: float
    map: float


def jumps(domain: Domain, mesh: Complex, samples: int = 4, seed: int = 20190) -> tuple[Jump, ...]:
    """Jumps across all facets between two cells, by the kinds of cell.

    Facets of one cell alone, on the boundary or between a face and what it is divided into, are left out.

    Parameters
    ----------
    mesh : connectivity of the domain, a part for each block.
    samples : points on each facet.

    Raises
    ------
    InputError : the mesh does not have the elements of the domain.
    """
    blocks = domain.space.blocks
    expected = [(block.basis.cell.name, block.elements) for block in blocks]
    if expected != [(cell.name, len(corners)) for cell, corners in mesh.parts]:
        raise InputError(f"a mesh of {len(mesh.parts)} parts does not have the elements of the domain's blocks")
    random = np.random.default_rng(seed)
    columns = np.column_stack([domain.points, random.uniform(-1.0, 1.0, domain.space.n)])
    nets = [bezier_coefficients(block, homogeneous(domain.space, columns)) for block in blocks]
    diagonal = float(np.linalg.norm(np.ptp(bounding_box(domain), axis=0)))
    found: list[Jump] = []
    for size in (3, 4):
        sides = [
            (k, face, own[:, list(block.basis.cell.faces[face].vertices)])
            for k, (block, (_, own)) in enumerate(zip(blocks, mesh.parts))
            for face in range(len(block.basis.cell.faces)) if len(block.basis.cell.faces[face].vertices) == size
        ]  # fmt: skip
        if sides:
            found += _of_size(domain, nets, sides, size, samples, random, diagonal)
    return tuple(found)


def worst_jump(domain: Domain, mesh: Complex, samples: int = 4, seed: int = 20190) -> float:
    """Largest jump of a random field and of the map across all facets between two cells; see `jumps`."""
    return max((max(jump.field, jump.map) for jump in jumps(domain, mesh, samples, seed)), default=0.0)


def _of_size(
    domain: Domain, nets: list[Array], sides: list[tuple[int, int, Index]], size: int, samples: int,
    random: np.random.Generator, diagonal: float,
) -> list[Jump]:  # fmt: skip
    every = np.concatenate([own for _, _, own in sides])
    total = 1 + int(every.max())
    facet, count = np.unique(entity_keys(every, total), return_inverse=True, return_counts=True)[1:]
    order = _common_order(every)
    weights = _weights(size, len(count), samples, random)
    values = np.empty((len(every), samples, 4))
    kind = np.empty(len(every), dtype=np.int64)
    names = sorted({block.basis.cell.name for block in domain.space.blocks})
    at = 0
    for k, face, own in sides:
        block = domain.space.blocks[k]
        vertices = block.basis.cell.vertices[list(block.basis.cell.faces[face].vertices)]
        for start in range(0, len(own), CHUNK):
            e = np.arange(start, min(start + CHUNK, len(own)))
            rows = at + e
            points = np.einsum("esv,evd->esd", weights[facet[rows]], vertices[order[rows]])
            table = block.basis.tabulate(points.reshape(-1, 3), 0)[0].reshape(len(e), samples, -1)
            value = table @ nets[k][e]
            values[rows] = value if domain.space.weights is None else value[..., :4] / value[..., 4:]
        kind[at : at + len(own)] = names.index(block.basis.cell.name)
        at += len(own)
    inner = np.flatnonzero(count[facet] == 2)
    inner = inner[np.argsort(facet[inner], kind="stable")]
    a, b = inner[::2], inner[1::2]
    off = values[a] - values[b]
    field = np.abs(off[..., 3]).max(axis=1)
    away = np.linalg.norm(off[..., :3], axis=-1).max(axis=1) / diagonal
    pairs = np.sort(np.column_stack([kind[a], kind[b]]), axis=1)
    found = []
    for pair in np.unique(pairs, axis=0):
        mine = (pairs == pair).all(axis=1)
        cells = (names[pair[0]], names[pair[1]])
        found.append(Jump(cells, size, int(mine.sum()), float(field[mine].max()), float(away[mine].max())))
    return found


def _common_order(corners: Index) -> Index:
    """For each facet (f, v) its corners in an order that depends on vertex numbers alone."""
    if corners.shape[1] == 3:
        return np.argsort(corners, axis=1)
    around = corners[:, _RING]
    start = around.argmin(axis=1)[:, None]
    after, before = (np.take_along_axis(around, (start + step) % 4, 1) for step in (1, 3))
    return _RING[(start + np.where(after < before, 1, 3) * np.arange(4)) % 4]


def _weights(size: int, facets: int, samples: int, random: np.random.Generator) -> Array:
    """Weights (f, s, v) of a facet's vertices at random points."""
    if size == 3:
        return random.dirichlet(np.ones(3), (facets, samples))
    a, b = random.uniform(size=(2, facets, samples))
    return np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=-1)
