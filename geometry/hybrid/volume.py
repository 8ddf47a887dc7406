r"""Zero layers: a rational Bernstein pyramid on every quadrilateral of a skin, tetrahedra in the rest.

The mesh: pyramids with their apex inside (`pyramids`), tetrahedra between their lateral faces and the skin's triangles
(`filling`), none of which lies flat in a smooth skin (`flat_corners`). The space: C0 Bernstein functions of the skin's
degree inside and the skin's own functions on it (`numbering`), so that the boundary of the volume is the skin, exactly.
The map: `curving`.

Axis letters: e element, v vertex, b Bernstein function, n function, c component.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.curving import curve, sized_shapes, smooth_tops
from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.filling import LIMIT, fill
from geometry.hybrid.flat_corners import tangents_of, without_flat_corners
from geometry.hybrid.numbering import ON_QUAD, numbering, skin_rows, volume_rows
from geometry.hybrid.pyramids import apexes, lateral_triangles
from geometry.hybrid.shell import Shell
from iga.bernstein import bernstein
from iga.block import Block
from iga.cells import PYRAMID, QUADRILATERAL, TETRAHEDRON, TRIANGLE, Cell
from iga.conforming import Complex, boundary, entity_keys, straight_domain
from iga.domain import Domain, Facets, Provenance, Space, grouped_facets
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Filled:
    """A straight mesh under a skin.

    Attributes
    ----------
    vertices : (v, 3), those of the skin first.
    mesh : pyramids, one for each quadrilateral of the skin in the order of its blocks, and tetrahedra.
    heights : (q,) of the pyramids.
    cut : vertices added so that no tetrahedron lies flat in the skin.
    """

    vertices: Array
    mesh: Complex
    heights: Array
    cut: int


def degree_of(skin: Shell) -> int:
    """The skin's degree.

    Raises
    ------
    InputError : blocks differ in degree, or the skin is rational.
    """
    degrees = {p for block in skin.space.blocks for p in block.basis.degree}
    if len(degrees) != 1:
        raise InputError(f"the skin has elements of degrees {sorted(degrees)}; raise them to one degree first")
    if skin.space.weights is not None:
        raise InputError("the skin is rational; approximate it by polynomials first")
    return degrees.pop()


def corners_of(skin: Shell, cell: Cell) -> Index:
    """Vertex numbers of the skin's elements of one cell, blocks one after the other."""
    found = [c for block, c in zip(skin.space.blocks, skin.corners) if block.basis.cell is cell]
    return np.concatenate([np.zeros((0, len(cell.vertices)), dtype=np.int64), *found])


def fill_skin(skin: Shell, limit: float = LIMIT) -> Filled:
    """Straight pyramids and tetrahedra inside a skin.

    Raises
    ------
    InputError : the skin is not closed or too coarse for straight elements, or the rest could not be filled.
    """
    quads, triangles = corners_of(skin, QUADRILATERAL), corners_of(skin, TRIANGLE)
    faces = [face for block, face in zip(skin.space.blocks, skin.face) if block.basis.cell is QUADRILATERAL]
    names = [skin.names[f] for own in faces for f in own.tolist()]
    tops, heights = apexes(skin.vertices, quads, triangles, names)
    top = len(skin.vertices) + np.arange(len(quads))
    pyramids = np.column_stack([quads[:, ON_QUAD[:4]], top]) if len(quads) else np.zeros((0, 5), dtype=np.int64)
    points = np.concatenate([skin.vertices, tops])
    surface = np.concatenate([lateral_triangles(quads, top), triangles])
    filled, tets = fill(points, surface, limit)
    vertices, tets, cut = without_flat_corners(filled, tets, tangents_of(skin))
    parts = tuple((cell, own) for cell, own in ((PYRAMID, pyramids), (TETRAHEDRON, tets)) if len(own))
    return Filled(vertices, Complex(parts), heights, cut)


def skin_facets(mesh: Complex, skin: Shell) -> list[Index]:
    """Where the elements of each block of a skin lie in a mesh: part, face and element, (e, 3)."""
    found = []
    for corners in skin.corners:
        faces = []
        for f in boundary(mesh):
            cell, vertices = mesh.parts[f.block]
            local = cell.faces[f.face].vertices
            if len(local) == corners.shape[1]:
                label = np.broadcast_to([f.block, f.face], (len(f.elements), 2))
                faces.append((vertices[f.elements][:, local], np.column_stack([label, f.elements])))
        there = [own for own, _ in faces]
        keys = entity_keys(np.concatenate([corners, *there]), mesh.vertices)
        mine, keys = keys[: len(corners)], keys[len(corners) :]
        order = np.argsort(keys)
        place = order[np.minimum(np.searchsorted(keys[order], mine), len(order) - 1)] if len(order) else order
        if len(place) != len(mine) or (keys[place] != mine).any():
            raise InputError("an element of the skin is no face of the volume")
        found.append(np.concatenate([label for _, label in faces])[place])
    return found


def complete(skin: Shell, provenance: Provenance | None = None, limit: float = LIMIT, rounds: int = 12,
             shown: Progress = QUIET) -> Domain:
    """Volume of pyramids and tetrahedra under a skin.

    Parameters
    ----------
    limit : seconds for the mesh generator.
    rounds : most rounds of untangling.

    Raises
    ------
    InputError : no volume can be made under this skin, and why.
    """
    degree = degree_of(skin)
    shown.say("filling")
    filled = fill_skin(skin, limit)
    shown.say("curving")
    return assemble(skin, filled.mesh, filled.vertices, degree, rounds, provenance, {
        "layers": 0, "lowest_pyramid": float(filled.heights.min(initial=np.inf)), "cut_vertices": filled.cut,
    }, shown)


def assemble(
    skin: Shell, mesh: Complex, vertices: Array, degree: int, rounds: int, provenance: Provenance | None,
    report: Mapping[str, Any], shown: Progress = QUIET,
) -> Domain:
    """Domain of a straight mesh under a skin, curved to fit it."""
    numbers = numbering(mesh, skin, degree)
    rows = skin_rows(skin, numbers)
    straight = straight_domain(mesh, vertices, degree)
    mismatch = [not np.array_equal(b.dofs, own) for b, own in zip(straight.space.blocks, numbers.dofs)]
    if any(mismatch):
        raise AssertionError("numbering of Bernstein functions")
    outer = numbers.outer
    curved = curve(straight, outer, rows @ skin.points, rounds, shown)
    inner, smooth = curved.points, False
    if degree > 1 and not len(curved.invalid) and any(cell is PYRAMID for cell, _ in mesh.parts):
        better = smooth_tops(replace(straight, points=inner), outer, sized_shapes(straight), rounds, shown)
        smooth = better is not None
        inner = inner if better is None else better.points
    M = volume_rows(outer, rows)
    points = np.concatenate([skin.points, inner[~outer]])
    blocks: list[Block] = []
    places: list[Index] = []
    corners: dict[str, Index] = {}
    for (cell, own), dofs in zip(mesh.parts, numbers.dofs):
        # For each element of the part its block and its number there.
        place = np.empty((len(own), 2), dtype=np.int64)
        for block, elements in blocks_of(bernstein(cell, degree), dofs, M):
            place[elements] = np.column_stack([np.full(len(elements), len(blocks)), np.arange(len(elements))])
            corners[f"corners{len(blocks)}"] = own[elements]
            blocks.append(block)
        places.append(place)
    named = _named(skin, skin_facets(mesh, skin), places)
    origin = provenance or Provenance("hybrid")
    origin = Provenance(origin.source, origin.input, origin.parameters, {**origin.arrays, **corners})
    report = {**report, "curving_steps": curved.steps, "not_certified": len(curved.invalid)}
    if any(cell is PYRAMID for cell, _ in mesh.parts):
        report["smooth_pyramids"] = smooth
    return Domain(Space(tuple(blocks), M.shape[1]), points, named, provenance=origin, report=report)


def _named(skin: Shell, facets: Sequence[Index], places: Sequence[Index]) -> dict[str, tuple[Facets, ...]]:
    """Facets of each named CAD face."""
    rows = []
    for where, face in zip(facets, skin.face):
        at = np.empty((len(where), 4), dtype=np.int64)
        for part, place in enumerate(places):
            mine = where[:, 0] == part
            at[mine] = np.column_stack([place[where[mine, 2]], where[mine, 1], face[mine]])
        rows.append(at)
    table = np.concatenate(rows)  # block, element, local face, CAD face
    names = np.array(skin.names)[table[:, 3]]
    return {name: grouped_facets(table[names == name, :3]) for name in dict.fromkeys(skin.names)}
