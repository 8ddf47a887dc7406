r"""Bezier pieces of each class of cells: N = C B on boxes that tile the cell.

A cell whose vertices are all regular is one tricubic piece. Any other cell is subdivided: its regular children are
tricubic pieces, the others are subdivided again, down to a stated depth, where the remaining ones are closed by the
tricubic of `lattice.bezier_matrix` on the mesh of that level. The closure is the one approximation made. It keeps what
analysis needs, exactly: functions sum to one and are C0 across all pieces (the rows of vertices, edges and faces are
shared between neighbours, and equal the spline's own where the entity is regular), linear functions are in the space,
limit points at vertices are exact, and along a straight extraordinary edge so is the limit curve. The subdivision works
on the control mesh itself, not on a once subdivided one: the closure needs no isolated irregularity, and the unknowns
stay the control points given.

Pieces whose polynomials continue each other are joined again, so rings around an extraordinary edge are not cut along
the edge.

C of a class is obtained from the neighbourhood of one representative: rows of (Bezier matrix) x (subdivision matrices).

Axis letters: p piece, n function of the neighbourhood, b Bernstein function, s slot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows, refinement_matrix, refinement_rows
from geometry.catmull_clark.neighbourhood import ROTATIONS, Neighbourhood, neighbourhoods
from geometry.catmull_clark.subdivision import CHILDREN, inherit_kinds
from geometry.catmull_clark.topology import Topology, build_topology, with_kinds

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_BATCH = 256
_STEPS = np.array(list(np.ndindex(2, 2, 2)))


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of some classes of cells.

    Attributes
    ----------
    owner : (p,) which of the classes.
    low, high : (p, 3) opposite corners of each piece in the cell.
    closed : (p,) whether the piece is a closure and not the limit itself.
    C : for each piece its extraction (n, 64) over the neighbourhood of its class.
    """

    owner: Index
    low: Array
    high: Array
    closed: NDArray[np.bool_]
    C: list[Array]


def pieces_of(topology: Topology, representatives: Index, depth: int, join: bool = True) -> Pieces:
    """Pieces of the cells given, each over its own canonically ordered neighbourhood.

    Parameters
    ----------
    representatives : (k,) cells, as a rule one of each class.
    depth : how often irregular cells are subdivided before they are closed.
    join : join pieces that continue each other.
    """
    owner: list[Index] = []
    low: list[Array] = []
    high: list[Array] = []
    closed: list[NDArray[np.bool_]] = []
    C: list[Array] = []
    for start in range(0, len(representatives), _BATCH):
        part = neighbourhoods(topology, representatives[start : start + _BATCH])
        for made in _batch(topology, part, depth):
            owner.append(made.owner + start)
            low.append(made.low)
            high.append(made.high)
            closed.append(made.closed)
            C += made.C
    result = Pieces(np.concatenate(owner), np.concatenate(low), np.concatenate(high), np.concatenate(closed), C)
    return _join(result) if join and depth else result


def local_topology(topology: Topology, part: Neighbourhood) -> tuple[Topology, Index]:
    """Topology of the neighbourhoods side by side, and the row of each cell itself, turned into its frame."""
    slots = len(part.vertex)
    asis = build_topology(part.slots, slots)
    edge = np.empty(len(asis.edges), dtype=np.int8)
    edge[asis.hex_edges] = topology.edge_kind[topology.hex_edges[part.member]]
    face = np.empty(len(asis.faces), dtype=np.int8)
    face[asis.hex_faces] = topology.face_kind[topology.hex_faces[part.member]]
    own = np.flatnonzero(part.member == part.cells[part.owner])
    hexes = part.slots.copy()
    hexes[own] = np.take_along_axis(hexes[own], ROTATIONS[part.rotation], axis=1)
    # Edges and faces are numbered by their vertices, so turning a cell leaves their numbers alone.
    return with_kinds(build_topology(hexes, slots), topology.vertex_kind[part.vertex], edge, face), own


def _batch(topology: Topology, part: Neighbourhood, depth: int) -> list[Pieces]:
    local, cell = local_topology(topology, part)
    matrix = csr_array(eye_array(local.vertices))
    owner = np.arange(len(cell))
    corner = np.zeros((len(cell), 3))
    made = []
    for level in range(depth + 1):
        regular = local.regular_hexes[cell]
        done = regular if level < depth else np.ones(len(cell), dtype=bool)
        if done.any():
            rows = bezier_rows(local)
            take = np.flatnonzero(done)
            values = bezier_matrix(local, rows, cell[take])[rows.cells[cell[take]].ravel()] @ matrix
            low = corner[take]
            made.append(
                Pieces(
                    owner[take], low, low + 0.5**level, ~regular[take], _dense(values, owner[take], part.start)
                )
            )
        if done.all():
            break
        cell, owner, corner = cell[~done], owner[~done], corner[~done]
        local, matrix, cell = refine_locally(local, matrix, cell)
        owner = np.repeat(owner, 8)
        corner = (corner[:, None] + 0.5 ** (level + 1) * _STEPS).reshape(-1, 3)
    return made


def refine_locally(local: Topology, matrix: csr_array, cell: Index) -> tuple[Topology, csr_array, Index]:
    """Subdivide, keeping only what the children of ``cell`` need."""
    rows = refinement_rows(local)
    children = (8 * cell[:, None] + np.arange(8)).ravel()
    hexes = rows.cells[:, CHILDREN].reshape(-1, 8)
    mine = np.zeros(len(rows.kind), dtype=bool)
    mine[hexes[children]] = True
    near = np.flatnonzero(mine[hexes].any(axis=1))
    used, inverse = np.unique(hexes[near], return_inverse=True)
    fine = build_topology(inverse.reshape(-1, 8), len(used))
    fine = inherit_kinds(fine, rows.kind[used])
    # A face on the outside of what was kept is boundary only if it lies on the boundary of the solid.
    return fine, refinement_matrix(local, rows)[used] @ matrix, np.searchsorted(near, children)


def _dense(values: csr_array, owner: Index, start: Index) -> list[Array]:
    """Extraction (n, 64) of each piece from sparse rows (64 p, slots) whose columns belong to the piece's owner."""
    values.sum_duplicates()
    count = np.diff(values.indptr)
    piece, b = np.divmod(np.repeat(np.arange(values.shape[0]), count), 64)
    size = np.diff(start)[owner]
    offset = np.concatenate([[0], np.cumsum(size * 64)])
    flat = np.zeros(offset[-1])
    flat[offset[piece] + (values.indices - start[owner[piece]]) * 64 + b] = values.data
    return [flat[a:z].reshape(-1, 64) for a, z in zip(offset[:-1].tolist(), offset[1:].tolist())]


def _join(pieces: Pieces) -> Pieces:
    """Join neighbouring pieces of a cell that are one polynomial."""
    order = np.argsort(pieces.owner, kind="stable")
    cuts = np.searchsorted(pieces.owner[order], np.arange(pieces.owner.max() + 2))
    owner, low, high, closed, C = [], [], [], [], []
    for k in range(len(cuts) - 1):
        boxes = [
            (pieces.low[i], pieces.high[i], bool(pieces.closed[i]), pieces.C[i]) for i in order[cuts[k] : cuts[k + 1]]
        ]
        for a, z, c, matrix in _join_boxes(boxes):
            owner.append(k)
            low.append(a)
            high.append(z)
            closed.append(c)
            C.append(matrix)
    return Pieces(np.array(owner, dtype=np.int64), np.array(low), np.array(high), np.array(closed), C)


Box = tuple[Array, Array, bool, Array]


def _join_boxes(boxes: list[Box]) -> list[Box]:
    """Greedy: join along one axis after the other until nothing continues."""
    changed = len(boxes) > 1
    while changed:
        changed = False
        for axis in range(3):
            at = {(*low, *high): k for k, (low, high, _, _) in enumerate(boxes)}
            gone = set()
            for k, (low, high, closed, C) in enumerate(boxes):
                if k in gone:
                    continue
                width = high[axis] - low[axis]
                if width >= 1.0 or (low[axis] / width) % 2:
                    continue
                step = np.zeros(3)
                step[axis] = width
                other = at.get((*(low + step), *(high + step)))
                if other is None or other in gone or boxes[other][2] != closed:
                    continue
                whole = _continued(C, boxes[other][3], axis)
                if whole is not None:
                    boxes[k] = (low, high + step, closed, whole)
                    gone.add(other)
            if gone:
                boxes = [box for k, box in enumerate(boxes) if k not in gone]
                changed = True
    return boxes


# Halves of a cubic in Bernstein form by de Casteljau: rows are coefficients of the half.
_LEFT = np.array([[8, 0, 0, 0], [4, 4, 0, 0], [2, 4, 2, 0], [1, 3, 3, 1]]) / 8.0
_RIGHT = _LEFT[::-1, ::-1]
_HALVES = (_LEFT, _RIGHT)
SPLIT = np.stack(
    [np.kron(np.kron(_HALVES[i], _HALVES[j]), _HALVES[k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
)
"""Bezier points of the eight children of a tricubic piece, (8, 64, 64)."""


def _continued(first: Array, second: Array, axis: int) -> Array | None:
    """Coefficients over both halves if the two are one polynomial along an axis, else None."""
    a = np.moveaxis(first.reshape(-1, 4, 4, 4), axis + 1, 3)
    b = np.moveaxis(second.reshape(-1, 4, 4, 4), axis + 1, 3)
    whole = np.stack([a[..., 0], 2 * a[..., 1] - a[..., 0], 2 * b[..., 2] - b[..., 3], b[..., 3]], axis=-1)
    if np.abs(whole @ _LEFT.T - a).max() > 1e-13 or np.abs(whole @ _RIGHT.T - b).max() > 1e-13:
        return None
    return np.moveaxis(whole, 3, axis + 1).reshape(-1, 64)


