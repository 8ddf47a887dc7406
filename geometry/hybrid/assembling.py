"""Space and control points of a skin from the meshes of its faces.

Functions are numbered: vertices, two on each side from its lower vertex, one in each triangle, four in each
quadrilateral. Axis letters: e element, n function, k side, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face
from geometry.hybrid.chart import Chart, chart_points, line_frames, line_normals, line_points
from geometry.hybrid.curves import fit_cubics
from geometry.hybrid.facemesh import FaceMesh, interior_pairs
from geometry.hybrid.fitting import (
    BICUBIC,
    INNER_QUAD,
    Fitted,
    bezier_nets,
    fit_quads,
    fit_triangles,
)
from geometry.hybrid.pieces import Pieces
from geometry.hybrid.poles import AROUND, corners_of
from geometry.hybrid.triangle import CUBIC, INNER
from iga.bernstein import Bernstein
from iga.block import Block
from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_GRID = np.arange(16).reshape(4, 4)
SIDES = np.array([_GRID[:, 0], _GRID[3], _GRID[::-1, 3], _GRID[0, ::-1]])
"""Bicubic functions on the sides from corner to corner around: (low, low), (high, low), (high, high), (low, high)."""
TURNED = _GRID.T.ravel()
"""Functions with the two directions exchanged, for faces whose normal points into the solid."""
Coefficients = dict[tuple[int, int], Array]
"""The two inner control points (2, 3) of each side, from its lower vertex."""


@dataclass(frozen=True, eq=False)
class Part:
    """Elements of one cell.

    Attributes
    ----------
    block : their functions.
    corners : (e, 3) or (e, 4) vertices around each element, outward normal by the right-hand rule.
    owner : (e,) CAD face.
    distance : (e,) largest sampled distance to the surface.
    folded : (e,) the normal turns over somewhere on the element.
    banded : (e,) the element touches an edge, or is a triangle of a curved face.
    bound : (e,) proved bound of the distance to a rational surface, NaN where there is none.
    """

    block: Block
    corners: Index
    owner: Index
    distance: Array
    folded: Mask
    banded: Mask
    bound: Array


@dataclass(frozen=True, eq=False)
class Assembled:
    """Space, control points (n, 3), number of vertices, rows (vertex, vertex, edge) of pieces, parts of the space."""

    space: Space
    points: Array
    vertices: int
    curves: Index
    parts: tuple[Part, ...]


def assemble(brep: Brep, edges: list[Pieces], meshes: list[FaceMesh], flat: Mask) -> Assembled:
    """Skin from the meshes of the faces.

    Parameters
    ----------
    flat : (f,) faces in a plane, of which no element belongs to the band.
    """
    x, sides, curves = _vertices(brep, edges, meshes)
    nets = [bezier_nets(face, m.low, m.high) if len(m.quads) else None for face, m in zip(brep.faces, meshes)]
    for face, made, net in zip(brep.faces, meshes, nets):
        _quad_sides(face, made, net, x, sides)
        _polar_sides(face, made, x, sides)
        _triangle_sides(face, made, x, sides)
    keys = np.array(sorted(sides))
    values = np.array([sides[tuple(k)] for k in keys.tolist()])
    used, compact = np.unique(keys, return_inverse=True)  # vertices without a side (inside a seam) are dropped
    renumber = np.full(len(x), -1)
    renumber[used] = np.arange(len(used))
    rows = np.array([(renumber[a], renumber[b], e) for a, b, e in curves], dtype=np.int64).reshape(-1, 3)
    on_edge = np.zeros(len(used), dtype=bool)
    on_edge[rows[:, :2]] = True
    table = _side_table(compact.reshape(keys.shape), len(used))
    shared = np.concatenate([x[used], values.reshape(-1, 3)])
    quads = [
        _quads(f, face, m, net, renumber[m.vertices[m.quads]], table, shared, on_edge)
        for f, (face, m, net) in enumerate(zip(brep.faces, meshes, nets)) if len(m.quads)
    ]
    triangles = [
        _triangles(f, face, m, renumber[m.vertices[m.triangles]], table, shared, bool(flat[f]))
        for f, (face, m) in enumerate(zip(brep.faces, meshes)) if len(m.triangles)
    ]
    parts, points, count = [], [shared], len(shared)
    for basis, inside, own in ((BICUBIC, INNER_QUAD, quads), (CUBIC, np.array([INNER]), triangles)):
        if own:
            part, inner = _joined(basis, inside, own, count)
            parts.append(part)
            points.append(inner)
            count += len(inner)
    space = Space(tuple(part.block for part in parts), count)
    return Assembled(space, np.concatenate(points), len(used), rows, tuple(parts))


@dataclass(frozen=True, eq=False)
class _Own:
    """Elements of one cell on one face: vertices around them (e, 3) or (e, 4), functions (e, n), -1 for inner ones,
    fitted control points in their order, and whether they belong to the band (e,).
    """

    face: int
    corners: Index
    dofs: Index
    fitted: Fitted
    banded: Mask


def _quads(
    number: int, face: Face, mesh: FaceMesh, net: Array | None, corners: Index, table: _SideTable, shared: Array,
    on_edge: Mask,
) -> _Own:  # fmt: skip
    """Quadrilaterals of a face, from their vertices (e, 4), control points of vertices and sides, and vertices on
    edges.
    """
    dofs = _quad_dofs(table, corners)
    fitted = fit_quads(face, mesh.low, mesh.high, shared[np.maximum(dofs, 0)], net)
    if face.reversed:
        corners, dofs = corners[:, [0, 3, 2, 1]], dofs[:, TURNED]
        fitted = replace(fitted, control=fitted.control[:, TURNED])
    return _Own(number, corners, dofs, fitted, np.asarray(on_edge[corners].any(axis=1)))


def _triangles(
    number: int, face: Face, mesh: FaceMesh, corners: Index, table: _SideTable, shared: Array, flat: bool
) -> _Own:
    """Triangles of a face, from their vertices (e, 3) and control points of vertices and sides."""
    corners = corners[:, ::-1] if face.reversed else corners
    dofs = _triangle_dofs(table, corners)
    fitted = fit_triangles(face, mesh.chart, mesh.points[mesh.outward], shared[np.maximum(dofs, 0)])
    return _Own(number, corners, dofs, fitted, np.full(len(corners), not flat))


def _joined(basis: Bernstein, inside: Index, own: list[_Own], first: int) -> tuple[Part, Array]:
    """Part of the elements of all faces, whose inner functions are numbered from ``first`` on, and the control points
    (k, 3) of these.
    """
    dofs = np.concatenate([o.dofs for o in own])
    dofs[:, inside] = first + np.arange(len(dofs) * len(inside)).reshape(len(dofs), -1)
    inner = np.concatenate([o.fitted.control[:, inside].reshape(-1, 3) for o in own])
    owner = np.concatenate([np.full(len(o.corners), o.face) for o in own])
    bound = [np.full(len(o.corners), np.nan) if o.fitted.bound is None else o.fitted.bound for o in own]
    rows = [(o.corners, o.fitted.distance, o.fitted.folded, o.banded) for o in own]
    corners, distance, folded, banded = (np.concatenate(column) for column in zip(*rows))
    return Part(Block(basis, dofs), corners, owner, distance, folded, banded, np.concatenate(bound)), inner


def _vertices(
    brep: Brep, edges: list[Pieces], meshes: list[FaceMesh]
) -> tuple[Array, Coefficients, list[tuple[int, int, int]]]:
    """Positions of all vertices, the sides on edges, and these sides with their edge."""
    x = np.full((int(max(m.vertices.max() for m in meshes)) + 1, 3), np.nan)
    x[: len(brep.vertices)] = brep.vertices
    sides: Coefficients = {}
    curves = []
    for e, piece in enumerate(edges):
        if brep.edges[e].degenerate:
            continue
        x[piece.vertices] = np.concatenate([piece.control[:, 0], piece.control[-1:, 3]])
        for a, b, control in zip(piece.vertices[:-1].tolist(), piece.vertices[1:].tolist(), piece.control):
            sides[min(a, b), max(a, b)] = control[1:3] if a < b else control[2:0:-1]
            curves.append((a, b, e))
    for made in meshes:
        inner = np.isnan(x[made.vertices, 0])
        x[made.vertices[inner]] = chart_points(made.chart, made.points[inner])
    return x, sides, curves


def _quad_sides(face: Face, made: FaceMesh, net: Array | None, x: Array, sides: Coefficients) -> None:
    """Sides of quadrilaterals that are on no edge."""
    if not len(made.quads):
        return
    box = np.stack([made.low, made.high], axis=1)
    for k in range(4):
        plane = [box[:, own, [0, 1]] for own in (AROUND[k], AROUND[(k + 1) % 4])]
        pair = made.vertices[made.quads[:, [k, (k + 1) % 4]]]
        _line_sides(face, plane, pair, None if net is None else net[:, SIDES[k]], x, sides)


def _polar_sides(face: Face, made: FaceMesh, x: Array, sides: Coefficients) -> None:
    """Sides of triangles at poles: those of their cells, as of quadrilaterals."""
    cells = made.polar
    if cells is None:
        return
    net = bezier_nets(face, cells.low, cells.high)
    corner = corners_of(cells)
    ring = made.vertices[cells.corners[:, [0, 0, 1, 2]]]  # from the corner of the cell behind `after`
    for k in (1, 2, 3):
        ends = [k, (k + 1) % 4]
        control = None if net is None else np.take_along_axis(net, SIDES[(cells.side + k) % 4][..., None], axis=1)
        _line_sides(face, [corner[:, end] for end in ends], ring[:, ends], control, x, sides)


def _line_sides(
    face: Face, plane: list[Array], pair: Index, control: Array | None, x: Array, sides: Coefficients
) -> None:
    """Sides along parameter lines between ``plane`` points, with vertices ``pair`` (k, 2), where there are none yet:
    Bezier points (k, 4, 3) of the surface, or cubics fitted to it.
    """
    if control is None:
        control = _on_lines((face, None, plane[0], plane[1]), x[pair[:, 0]], x[pair[:, 1]])
    for (a, b), own in zip(pair.tolist(), control):
        sides.setdefault((min(a, b), max(a, b)), own[1:3] if a < b else own[2:0:-1])


def _triangle_sides(face: Face, made: FaceMesh, x: Array, sides: Coefficients) -> None:
    """Interior sides of triangles: cubics fitted to the surface along straight lines of the chart."""
    pairs = {local: ends for local, ends in interior_pairs(made).items() if ends not in sides}
    if not pairs:
        return
    local, ends = np.array(list(pairs)), np.array(list(pairs.values()))
    local = np.where((made.vertices[local[:, 0]] == ends[:, 0])[:, None], local, local[:, ::-1])
    line = (face, made.chart, made.points[local[:, 0]], made.points[local[:, 1]])
    control = _on_lines(line, x[ends[:, 0]], x[ends[:, 1]])
    sides.update(zip(map(tuple, ends.tolist()), control[:, 1:3]))


def _on_lines(line: tuple[Face, Chart | None, Array, Array], start: Array, end: Array) -> Array:
    """Cubics (m, 4, 3) from start to end near straight lines of a chart, on the surface."""
    smooth = line[1] is None or not line[1].poles
    frames = partial(line_frames, *line) if smooth else None
    return fit_cubics(partial(line_points, *line), start, end, partial(line_normals, *line), frames=frames)[0]


@dataclass(frozen=True, eq=False)
class _SideTable:
    """Sides by their vertices: ``codes`` (s,), ascending, the number of each side (s,), and the number of vertices."""

    codes: Index
    side: Index
    vertices: int


def _side_table(keys: Index, vertices: int) -> _SideTable:
    """Table of sides with vertices (s, 2), the lower one first."""
    codes = keys[:, 0] * (vertices + 1) + keys[:, 1]
    order = np.argsort(codes)
    return _SideTable(codes[order], order, vertices)


def _beside(table: _SideTable, near: Index, far: Index) -> Index:
    """Functions (.., 2) between vertices, the one beside ``near`` first."""
    code = np.minimum(near, far) * (table.vertices + 1) + np.maximum(near, far)
    side = table.side[np.searchsorted(table.codes, code)]
    turned = (near > far).astype(np.int64)
    first = table.vertices + 2 * side
    return np.stack([first + turned, first + 1 - turned], axis=-1)


def _triangle_dofs(table: _SideTable, corners: Index) -> Index:
    """Functions (e, 10) of triangles with given corners (e, 3), -1 inside."""
    dofs = np.full((len(corners), 10), -1, dtype=np.int64)
    for column, exponent in enumerate(CUBIC.exponents.tolist()):
        if 3 in exponent:
            dofs[:, column] = corners[:, exponent.index(3)]
        elif 0 in exponent:
            near, far = corners[:, exponent.index(2)], corners[:, exponent.index(1)]
            dofs[:, column] = _beside(table, near, far)[:, 0]
    return dofs


def _quad_dofs(table: _SideTable, corners: Index) -> Index:
    """Functions (e, 16) of quadrilaterals with given corners around (e, 4), -1 inside."""
    dofs = np.full((len(corners), 16), -1, dtype=np.int64)
    for k in range(4):
        near, far = corners[:, k], corners[:, (k + 1) % 4]
        dofs[:, SIDES[k, 0]] = near
        dofs[:, SIDES[k, 1:3]] = _beside(table, near, far)
    return dofs
