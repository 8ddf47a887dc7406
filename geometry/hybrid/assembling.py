"""Space and control points of a skin from the meshes of its faces.

Functions are numbered: vertices, two on each side from its lower vertex, one in each triangle, four in each
quadrilateral. Axis letters: e element, n function, k side, c component.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep, Face
from geometry.hybrid.chart import Chart, chart_points, line_frames, line_normals, line_points
from geometry.hybrid.curves import fit_cubics
from geometry.hybrid.facemesh import FaceMesh, interior_pairs
from geometry.hybrid.fitting import BICUBIC, CUBIC, INNER, INNER_QUAD, bezier_nets, fit_quads, fit_triangles
from geometry.hybrid.pieces import Pieces
from geometry.hybrid.poles import AROUND, corners_of
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
    folded : (e,)
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
    keys, x = compact.reshape(keys.shape), x[used]
    on_edge = np.zeros(len(x), dtype=bool)
    on_edge[[renumber[v] for a, b, _ in curves for v in (a, b)]] = True
    table = _SideTable(keys, len(x))
    shared = np.concatenate([x, values.reshape(-1, 3)])
    parts: list[Part] = []
    points = [shared]
    count = len(shared)
    for quads in (True, False):
        columns, inner, made_ = [], [], []
        for f, (face, m) in enumerate(zip(brep.faces, meshes)):
            own = renumber[m.vertices[m.quads if quads else m.triangles]]
            if not len(own):
                continue
            if quads:
                dofs = table.quad_dofs(own)
                fitted = fit_quads(face, m.low, m.high, shared[np.maximum(dofs, 0)], nets[f])
                if face.reversed:
                    own, dofs = own[:, [0, 3, 2, 1]], dofs[:, TURNED]
                    control = fitted.control[:, TURNED]
                else:
                    control = fitted.control
                touches = on_edge[own].any(axis=1)
                inside = INNER_QUAD
            else:
                local = m.outward
                own = own[:, ::-1] if face.reversed else own
                dofs = table.triangle_dofs(own)
                fitted = fit_triangles(face, m.chart, m.points[local], shared[np.maximum(dofs, 0)])
                control = fitted.control
                touches = np.full(len(own), not flat[f])
                inside = np.array([INNER])
            dofs[:, inside] = count + np.arange(dofs[:, inside].size).reshape(len(dofs), -1)
            count += dofs[:, inside].size
            points.append(control[:, inside].reshape(-1, 3))
            columns.append(dofs)
            inner.append(own)
            bound = np.full(len(own), np.nan) if fitted.bound is None else fitted.bound
            made_.append((np.full(len(own), f), fitted.distance, fitted.folded, touches, bound))
        if columns:
            owner, distance, folded, touches, bound = (np.concatenate(c) for c in zip(*made_))
            block = Block(BICUBIC if quads else CUBIC, np.concatenate(columns))
            parts.append(Part(block, np.concatenate(inner), owner, distance, folded, touches, bound))
    space = Space(tuple(part.block for part in parts), count)
    rows = np.array([(renumber[a], renumber[b], e) for a, b, e in curves], dtype=np.int64).reshape(-1, 3)
    return Assembled(space, np.concatenate(points), len(x), rows, tuple(parts))


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


class _SideTable:
    """Numbers of the functions on sides."""

    def __init__(self, keys: Index, vertices: int):
        codes = keys[:, 0] * (vertices + 1) + keys[:, 1]
        self.order = np.argsort(codes)
        self.codes = codes[self.order]
        self.vertices = vertices

    def pair(self, near: Index, far: Index) -> Index:
        """Functions (.., 2) between vertices, the one beside ``near`` first."""
        code = np.minimum(near, far) * (self.vertices + 1) + np.maximum(near, far)
        edge = self.order[np.searchsorted(self.codes, code)]
        turned = (near > far).astype(np.int64)
        first = self.vertices + 2 * edge
        return np.stack([first + turned, first + 1 - turned], axis=-1)

    def triangle_dofs(self, corners: Index) -> Index:
        """Functions (e, 10), -1 inside."""
        dofs = np.full((len(corners), 10), -1, dtype=np.int64)
        for column, exponent in enumerate(CUBIC.exponents.tolist()):
            if 3 in exponent:
                dofs[:, column] = corners[:, exponent.index(3)]
            elif 0 in exponent:
                near, far = corners[:, exponent.index(2)], corners[:, exponent.index(1)]
                dofs[:, column] = self.pair(near, far)[:, 0]
        return dofs

    def quad_dofs(self, corners: Index) -> Index:
        """Functions (e, 16) of corners around, -1 inside."""
        dofs = np.full((len(corners), 16), -1, dtype=np.int64)
        for k in range(4):
            near, far = corners[:, k], corners[:, (k + 1) % 4]
            dofs[:, SIDES[k, 0]] = near
            dofs[:, SIDES[k, 1:3]] = self.pair(near, far)
        return dofs
