r"""How far the closures are from the limit volume: a proved bound, and a measured lower bound.

Let T_k be the tricubic complex of the control mesh after k more subdivisions, P_k its control points. T_k tends to the
limit F, so on an irregular cell

    F - T_0 = (T_k - T_0) + sum_(j >= k) (T_(j+1) - T_j).

The first part is piecewise tricubic: the Bezier points of T_k on the descendants at level k less those of T_0, split by
de Casteljau; by the convex hull property it is nowhere longer than the longest of them. On descendants that are regular
T_k is the limit, and nothing follows. On the others every further term has Bezier points D P in the control points P
around, and is bounded once for every class of cell, because D 1 = 0, by

    |row . P| <= 1/2 |row|_1 diam(P),      row of D,

for K levels of children of children, and what is left after them by a contraction: the control points r_i P around a
descendant (r_i the rows of the product of subdivision matrices) have

    diam(R P) <= q diam(P),   q = max_ij 1/2 |r_i - r_j|_1,

so that a bound b over all classes (their set is completed until it is closed under subdivision) satisfies
b <= (sum of K levels) + q b, b <= (sum of K levels)/(1 - q). Nothing is sampled; rounding (1e-13 of the result) is not
counted. k grows only where a cell can still be the worst.

`hull_distance` needs no classes, so that every build can report it: all rules are convex combinations, hence F on a
descendant lies in the convex hull of the control points around it and T_0 in that of its Bezier points, and no two
points of these hulls are further apart than the boxes around them allow, up to two levels deeper than the closures.
It is some tens of times the distance that occurs, and falls with it.

The bound is on the distance of points of equal parameters, so it bounds the distance of the two volumes and surfaces.
Closures inside change no volume at all: by the divergence theorem the volume depends on the boundary, and closures and
limit have the same boundary except on irregular boundary faces. Parametric derivatives have no such bound: towards an
extraordinary edge of valence above four those of the limit itself grow without end.

Axis letters: e cell, k child, b Bezier point, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, kron
from scipy.spatial.distance import pdist

from geometry.catmull_clark.domain import CUBIC
from geometry.catmull_clark.interpolation import diagonal
from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows, limit_matrix, refinement_rows
from geometry.catmull_clark.neighbourhood import neighbourhoods, walk
from geometry.catmull_clark.pieces import SPLIT, local_topology, refine_locally
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import Topology, incidence

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Colours = NDArray[np.uint64]

CHAIN = 3
"""Levels K of subdivision whose operators are taken as they are before the contraction is used."""
_TERMS = 9
"""Most levels on which the distance is bounded step by step before the contraction bounds the rest."""
_MEASURED = 120_000
"""Cells up to which `hull_distance` measures as well as it bounds."""
_LOOK = (25_000, 500)
"""Closures up to which hulls are taken one and two levels deeper."""
_BATCH = 16
_SAMPLES = CUBIC.tabulate(np.array(list(np.ndindex(3, 3, 3))) / 2.0, 0)[0]
_SPLITS = csr_array(SPLIT.reshape(512, 64))


@dataclass(frozen=True)
class Distance:
    """Distance of closures and limit, over the diagonal of the control points.

    Attributes
    ----------
    bound : no point of the closures is further from the point of the limit with the same parameters.
    measured : largest distance at sample points where the limit is known exactly; the bound cannot be below it.
    contraction : the factor q of the proof.
    classes : irregular classes met.
    """

    bound: float
    measured: float
    contraction: float
    classes: int


def closure_distance(
    topology: Topology, control: Array, depth: int, sharp: float = 2.0, most: int = 1500
) -> Distance:
    """Bound and measure the distance between the limit and the closures after ``depth`` subdivisions.

    Parameters
    ----------
    control : (v, 3) control points.
    sharp : stop when the bound is at most so many times the distance known to occur; above 1.
    most : stop when more cells than this would have to be subdivided for that; the bound is then less sharp.
    """
    size = diagonal(control)
    local, points, cells = _closed(topology, control, depth)
    if not len(cells):
        return Distance(0.0, 0.0, 0.0, 0)
    measured = _measured(local, points, cells)
    start = _nets(local, points, cells)
    known = Constants({}, {}, set())
    sure = 0.0  # a bound for all cells that are done with
    for step in range(_TERMS):
        local, points, children = refine_locally(local, points, cells)
        start = (SPLIT[None] @ start[:, None]).reshape(-1, 64, 3)
        term = _nets(local, points, children) - start
        irregular = ~local.regular_hexes[children]
        ended = term[~irregular]  # the difference itself, on these descendants
        sure = max(sure, float(_longest(ended).max(initial=0.0)))
        measured = max(measured, float(np.linalg.norm(_SAMPLES @ ended, axis=2).max(initial=0.0)))
        cells, start = children[irregular], start[irregular]
        if not len(cells):
            break
        so_far = _longest(term[irregular])
        total = so_far + _rest(local, points, cells, known)
        # Cells that cannot be the worst are done with; the others are subdivided once more.
        open_ = total > max(sharp * measured, sure)
        if step == _TERMS - 1 or open_.sum() > most or not open_.any():
            sure = max(sure, float(total.max()))
            break
        sure = max(sure, float(total[~open_].max(initial=0.0)))
        cells, start = cells[open_], start[open_]
    return Distance(sure / size, measured / size, known.contraction, len(known.sums))


def _longest(nets: Array) -> Array:
    """Bound of the length of polynomials with Bezier points (e, 64, 3), from the Bezier points of their eighths."""
    halves = (SPLIT[None] @ nets[:, None]).reshape(len(nets), 512, 3)
    return np.asarray(np.linalg.norm(halves, axis=2).max(axis=1))


def _rest(local: Topology, points: Array, cells: Index, known: Constants) -> Array:
    """Bound of all terms that are still to come, (e,)."""
    signature, first, label = _classes(local, cells)
    known.add(local, cells[first], signature[first])
    return known.of(signature[first])[label] * _diameters(local, points, cells)


def hull_distance(topology: Topology, control: Array, depth: int) -> Distance:
    """Bound the distance between the limit and the closures by convex hulls, and measure it, in about a second.

    Not measured (0) where the closures are more than some 100,000.
    """
    local, points, cells = _closed(topology, control, depth)
    if not len(cells):
        return Distance(0.0, 0.0, 0.0, 0)
    size = diagonal(control)
    measured = _measured(local, points, cells) if len(local.hexes) <= _MEASURED else 0.0
    start = _nets(local, points, cells)
    sure = 0.0
    levels = sum(len(cells) <= most for most in _LOOK)
    for level in range(levels):
        local, points, cells = refine_locally(local, points, cells)
        start = (SPLIT[None] @ start[:, None]).reshape(-1, 64, 3)
        regular = local.regular_hexes[cells]
        if level + 1 < levels and regular.any():  # there the difference itself is known
            ended = _nets(local, points, cells[regular]) - start[regular]
            sure = max(sure, float(np.linalg.norm(ended, axis=2).max()))
            cells, start = cells[~regular], start[~regular]
    low, high = _boxes(local, points, cells)
    reach = np.maximum(high - start.min(axis=1), start.max(axis=1) - low)
    return Distance(max(sure, float(np.linalg.norm(reach, axis=1).max())) / size, measured / size, 0.0, 0)


def _closed(topology: Topology, control: Array, depth: int) -> tuple[Topology, Array, Index]:
    """The mesh around the closures after ``depth`` subdivisions, its control points, and the cells that are closed."""
    local, points, cells = topology, control, np.flatnonzero(~topology.regular_hexes)
    for _ in range(depth):
        if len(cells):
            local, points, cells = refine_locally(local, points, cells)
            cells = cells[~local.regular_hexes[cells]]
    return local, points, cells


def _nets(local: Topology, points: Array, cells: Index) -> Array:
    """Bezier points (e, 64, 3) of cells."""
    rows = bezier_rows(local)
    return np.asarray((bezier_matrix(local, rows, cells) @ points)[rows.cells[cells]])


def _measured(local: Topology, points: Array, cells: Index) -> float:
    """Largest distance of closures and limit at the new vertices of one subdivision."""
    places = refinement_rows(local)
    closure = _SAMPLES @ _nets(local, points, cells)
    fine, S = subdivide(local)
    limit = (limit_matrix(fine) @ (S @ points))[places.cells[cells]]
    return float(np.linalg.norm(closure - limit, axis=2).max())


def _diameters(local: Topology, points: Array, cells: Index) -> Array:
    """Diagonal of the box around the control points of each cell's neighbourhood, (e,)."""
    low, high = _boxes(local, points, cells)
    return np.asarray(np.linalg.norm(high - low, axis=1))


def _boxes(local: Topology, points: Array, cells: Index) -> tuple[Array, Array]:
    """Opposite corners (e, 3) of the box around the control points of each cell's neighbourhood."""
    low, high = points.copy(), points.copy()
    corners = local.hexes
    for _ in range(2):
        box_low, box_high = low[corners].min(axis=1), high[corners].max(axis=1)
        np.minimum.at(low, corners.ravel(), np.repeat(box_low, 8, axis=0))
        np.maximum.at(high, corners.ravel(), np.repeat(box_high, 8, axis=0))
    # After one pass a vertex knows its cells; the box of a cell's vertices is that of its neighbourhood.
    return box_low[cells], box_high[cells]


def _classes(local: Topology, cells: Index) -> tuple[Colours, Index, Index]:
    signature = np.concatenate([part.signature for part in walk(local, cells)])
    _, first, label = np.unique(signature, return_index=True, return_inverse=True)
    return signature, first, label


@dataclass
class Constants:
    """Bounds of |F - T_0| over the diameter of the control points, by class of cell.

    Attributes
    ----------
    sums, contractions : what `_chain` found for each class.
    wanted : classes of descendants; all of them are keys of ``sums``.
    """

    sums: dict[int, float]
    contractions: dict[int, float]
    wanted: set[int]

    @property
    def contraction(self) -> float:
        """Largest factor q."""
        return max(self.contractions.values(), default=0.0)

    def add(self, local: Topology, cells: Index, signature: Colours) -> None:
        """Add classes given by one cell each, and those of their descendants."""
        waiting = [(local, cells, signature)]
        while waiting:
            mesh, todo, names = waiting.pop()
            new = np.array([int(name) not in self.sums for name in names], dtype=bool)
            todo, names = todo[new], names[new]
            for start in range(0, len(todo), _BATCH):
                part = slice(start, start + _BATCH)
                total, q, met = _chain(mesh, todo[part])
                keys = names[part].tolist()
                self.sums |= dict(zip(keys, total.tolist()))
                self.contractions |= dict(zip(keys, q.tolist()))
                waiting.append(met)
        if self.contraction >= 1.0:
            raise ArithmeticError(f"subdivision does not contract in {CHAIN} levels (q = {self.contraction:.2f})")

    def of(self, signature: Colours) -> Array:
        """Constants of the classes given, (k,)."""
        worst = max(self.sums.values()) / (1.0 - self.contraction)
        names = [int(name) for name in signature]
        return np.array([self.sums[k] + self.contractions[k] * worst for k in names])


def _chain(mesh: Topology, cells: Index) -> tuple[Array, Array, tuple[Topology, Index, Colours]]:
    """Sum of the bounds of K levels for each cell, the contraction after them, and one descendant of each class."""
    local, cell = local_topology(mesh, neighbourhoods(mesh, cells))
    matrix = csr_array(eye_array(local.vertices))
    owner = np.arange(len(cells))
    so_far, total, q = np.zeros(len(cells)), np.zeros(len(cells)), np.zeros(len(cells))
    met = None
    for _ in range(CHAIN):
        rows = bezier_rows(local)
        net = bezier_matrix(local, rows, cell)[rows.cells[cell].ravel()] @ matrix
        local, matrix, children = refine_locally(local, matrix, cell)
        rows = bezier_rows(local)
        fine = bezier_matrix(local, rows, children)[rows.cells[children].ravel()] @ matrix
        D = abs(fine - kron(eye_array(len(cell)), _SPLITS).tocsr() @ net)
        term = 0.5 * np.asarray(D.sum(axis=1)).reshape(-1, 64).max(axis=1)
        so_far = np.repeat(so_far, 8) + term
        owner = np.repeat(owner, 8)
        np.maximum.at(total, owner, so_far)
        irregular = ~local.regular_hexes[children]
        cell, owner, so_far = children[irregular], owner[irregular], so_far[irregular]
        if met is None:
            signature, first, _ = _classes(local, cell)
            met = (local, cell[first], signature[first])
    near = csr_array(incidence(local.hexes[cell], local.vertices) @ local.cells_of_vertex)
    for k in range(len(cell)):  # a few dozen descendants of each class
        vertices = np.unique(local.hexes[near.indices[near.indptr[k] : near.indptr[k + 1]]])
        part = matrix[vertices]
        columns = np.unique(part.indices)
        R = part[:, columns].toarray()
        q[owner[k]] = max(q[owner[k]], 0.5 * float(pdist(R, "cityblock").max()))
    assert met is not None
    return total, q, met
