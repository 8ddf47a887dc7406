r"""Limit functions as close to extraordinary edges and vertices as one likes: powers of local subdivision matrices.

After a few subdivisions the child of a cell at an irregular corner is of the cell's own class, so the control points
around the two are related by one square matrix A, and a point at distance 2^-m is m equal steps away. With l the limit
mask (l A = l, l 1 = 1) and t the functions, or t' their derivatives, at the point as the last child sees it,

    value       t A^m  = l + t B^m,        B = A - 1 l,
    derivative  2^m t' A^m = 2^m t' B^m    (t' 1 = 0: constants are taken out before they are multiplied by 2^m).

At an edge around which all is a product (plane) x (cubic B-splines along it), A acts on the plane alone and the point
keeps its place along the edge (Stam 1998 for the plane); at a vertex A is the full matrix. B^m = V diag(w^m) V^-1 where
B is diagonalisable and V has a condition number below `CONDITION`; otherwise (vertices with all edges of valence three,
most of the boundary: Jordan blocks) B^m is multiplied out by squaring. On the edge or vertex itself (m without end) the
value is the limit mask, which the Bezier closure has exactly; derivatives across have no limit there and are not a
number; those along a product edge are exact.

Axis letters: p point, n function (slot of a neighbourhood), k table: value, 3 first and 6 second derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components

from geometry.catmull_clark.domain import CUBIC
from geometry.catmull_clark.lattice import bezier_matrix, bezier_rows
from geometry.catmull_clark.neighbourhood import Neighbourhood, neighbourhoods
from geometry.catmull_clark.pieces import local_topology, refine_locally
from geometry.catmull_clark.topology import EDGES, FACES, Topology
from iga.cells import HEXAHEDRON

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Complex = NDArray[np.complex128]

CONDITION = 1e6
"""Largest condition number of eigenvectors that are used."""
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
ORDERS = np.array([(0, 0, 0), *np.eye(3, dtype=int).tolist(), *(np.eye(3, dtype=int)[list(p)].sum(0) for p in PAIRS)])
"""How often each of the ten tables is differentiated in each direction, (k, 3)."""
RINGS, EIGEN, SQUARED = 0, 1, 2
"""Ways of a point: subdivided step by step; powers by eigenvectors; powers by squaring."""
_CORNERS = HEXAHEDRON.vertices.astype(int)
# Pairs of a cell's vertices along each direction, (3, 4, 2).
_PAIRS_ALONG = np.array([[e for e in EDGES.tolist() if _CORNERS[e[0], d] != _CORNERS[e[1], d]] for d in range(3)])


def tables(eta: Array) -> Array:
    """Bernstein functions and derivatives at points (p, 3), as (k, p, 64)."""
    B, dB, ddB = CUBIC.tabulate(eta, 2)
    return np.stack([B, *np.moveaxis(dB, -1, 0), *(ddB[..., a, b] for a, b in PAIRS)])


@dataclass(frozen=True, eq=False)
class Power:
    """Powers of B = A - 1 l.

    Attributes
    ----------
    B : (n, n).
    limit : l, (n,).
    eigen : eigenvalues w (n,), eigenvectors V (n, n) as columns, and V^-1; None if they are too ill conditioned.
    """

    B: Array
    limit: Array
    eigen: tuple[Complex, Complex, Complex] | None

    @property
    def way(self) -> int:
        """EIGEN or SQUARED."""
        return SQUARED if self.eigen is None else EIGEN

    def times(self, rows: Array, m: Index) -> Array:
        """Rows (k, p, n) times B^m, m (p,)."""
        if self.eigen is not None:
            w, V, inverse = self.eigen
            return np.ascontiguousarray((((rows @ V) * w ** m[:, None]) @ inverse).real)
        made = np.empty_like(rows)
        for power in np.unique(m).tolist():
            mine = m == power
            made[:, mine] = rows[:, mine] @ np.linalg.matrix_power(self.B, power)
        return made


def power_of(A: Array) -> Power:
    """Prepare powers of a local subdivision matrix (n, n) with rows that sum to one."""
    n = len(A)
    system = np.concatenate([A.T - np.eye(n), np.ones((1, n))])
    limit = np.linalg.lstsq(system, np.eye(n + 1)[-1], rcond=None)[0]
    B = A - limit[None]
    w, V = (np.asarray(part, dtype=np.complex128) for part in np.linalg.eig(B))
    if np.linalg.cond(V) > CONDITION:
        return Power(B, limit, None)
    return Power(B, limit, (w, V, np.asarray(np.linalg.inv(V), dtype=np.complex128)))


@dataclass(frozen=True, eq=False)
class Product:
    """A cell around which all is (plane) x (line along ``axis``).

    Attributes
    ----------
    corner : in the plane, where the extraordinary edge is, (3,), zero along the axis.
    plane, layer : (n,) place in the plane and layer of each slot; layers start at 0.
    power : of the matrix in the plane.
    """

    axis: int
    corner: Index
    plane: Index
    layer: Index
    power: Power

    def times(self, rows: Array, m: Index) -> Array:
        """Rows (k, p, n) times B^m in the plane, layer by layer."""
        made = np.empty_like(rows)
        for one in range(int(self.layer.max()) + 1):
            slots = np.flatnonzero(self.layer == one)
            slots = slots[np.argsort(self.plane[slots])]
            made[..., slots] = self.power.times(rows[..., slots], m)
        return made

    def limits(self, rows: Array) -> Array:
        """Rows (k, p, n) times (1 l) in the plane, layer by layer."""
        made = np.empty_like(rows)
        for one in range(int(self.layer.max()) + 1):
            slots = np.flatnonzero(self.layer == one)
            slots = slots[np.argsort(self.plane[slots])]
            made[..., slots] = rows[..., slots].sum(axis=-1, keepdims=True) * self.power.limit
        return made


@dataclass(frozen=True, eq=False)
class Node:
    """A class of cells as numbered in the mesh, by one of its cells in the topology of its neighbourhood."""

    local: Topology
    cell: int
    name: int
    known: dict[int, Node]

    @cached_property
    def regular(self) -> bool:
        """Whether the limit on the cell is one tricubic."""
        return bool(self.local.regular_hexes[self.cell])

    @cached_property
    def C(self) -> Array:
        """Bezier points, (64, n): the limit of a regular cell, the closure of others."""
        rows = bezier_rows(self.local)
        cell = np.array([self.cell])
        return np.asarray(bezier_matrix(self.local, rows, cell)[rows.cells[self.cell]].toarray())

    @cached_property
    def children(self) -> tuple[list[Node], list[Array]]:
        """The eight children and the matrices (n', n) from the cell's control points to theirs."""
        start = csr_array(eye_array(self.local.vertices))
        fine, M, cells = refine_locally(self.local, start, np.array([self.cell]))
        part = neighbourhoods(fine, cells, turn=False)
        dense = M.toarray()
        slots = [part.vertex[a:z] for a, z in zip(part.start[:-1], part.start[1:])]
        return nodes_of(fine, part, self.known), [dense[some] for some in slots]

    @cached_property
    def corner(self) -> tuple[int, Power] | None:
        """Irregular corner whose child is of this class again, with the matrix of that step."""
        nodes, matrices = self.children
        for v in np.flatnonzero(~self.local.regular_vertices[self.local.hexes[self.cell]]).tolist():
            if nodes[v].name == self.name:
                return v, power_of(matrices[v])
        return None

    @cached_property
    def product(self) -> Product | None:
        """The cell as a product along its one irregular edge, if it is one."""
        t = self.local
        odd = np.flatnonzero(~t.regular_vertices[t.hexes[self.cell]])
        if len(odd) != 2 or self.corner is None or np.abs(_CORNERS[odd[1]] - _CORNERS[odd[0]]).sum() != 1:
            return None
        axis = int(np.abs(_CORNERS[odd[1]] - _CORNERS[odd[0]]).argmax())
        found = _layers(t, self.cell, axis)
        if found is None:
            return None
        plane, layer = found
        A = self.children[1][self.corner[0]]
        size, count = int(plane.max()) + 1, int(layer.max()) + 1
        if size * count != len(plane):
            return None
        order = np.lexsort((plane, layer))
        whole = A[np.ix_(order, order)].reshape(count, size, count, size)
        flat, line = whole.sum(axis=2)[0], whole.sum(axis=3)[:, 0]
        if np.abs(whole - line[:, None, :, None] * flat[None, :, None, :]).max() > 1e-14:
            return None
        corner = np.where(np.arange(3) == axis, 0, _CORNERS[self.corner[0]])
        return Product(axis, corner, plane, layer, power_of(flat))


def nodes_of(topology: Topology, part: Neighbourhood, known: dict[int, Node]) -> list[Node]:
    """The class of each neighbourhood, made with ``turn=False``; ``known`` are classes met so far, and grows."""
    found = []
    for k, name in enumerate(part.signature.tolist()):
        if name not in known:
            alone = neighbourhoods(topology, part.cells[[k]], turn=False)
            local, own = local_topology(topology, alone)
            known[name] = Node(local, int(own[0]), name, known)
        found.append(known[name])
    return found


def _layers(t: Topology, root: int, axis: int) -> tuple[Index, Index] | None:
    """Place in the plane and layer of each vertex, by walking from cell to cell; None if they contradict."""
    layer = np.full(t.vertices, -99, dtype=np.int64)
    layer[t.hexes[root]] = _CORNERS[:, axis]
    along = {root: axis}
    waiting = [root]
    while waiting:
        cell = waiting.pop()
        own = layer[t.hexes[cell]]
        for face in t.hex_faces[cell].tolist():
            for other, side in np.argwhere(t.hex_faces == face).tolist():
                if other in along:
                    continue
                quad = FACES[side]
                seen = layer[t.hexes[other][quad]]
                if (seen == seen[0]).all():  # one lies on the other along the edge
                    direction, beyond = side // 2, int(own.sum()) // 4 - int(seen[0])
                    made = np.where(_CORNERS[:, direction] == side % 2, seen[0], 2 * seen[0] - beyond)
                else:
                    fits = [d for d in range(3) if all(len(set(seen[_CORNERS[quad, d] == b])) == 1 for b in (0, 1))]
                    if len(fits) != 1:
                        return None
                    direction = fits[0]
                    made = np.array([seen[_CORNERS[quad, direction] == b][0] for b in _CORNERS[:, direction]])
                before = layer[t.hexes[other]]
                if ((before != -99) & (before != made)).any():
                    return None
                layer[t.hexes[other]] = made
                along[other] = direction
                waiting.append(other)
    if len(along) < len(t.hexes):
        return None
    ends = np.concatenate([t.hexes[c][_PAIRS_ALONG[d]] for c, d in along.items()])
    n = t.vertices
    plane = connected_components(coo_array((np.ones(len(ends)), ends.T), shape=(n, n)), directed=False)[1]
    return plane.astype(np.int64), layer - layer.min()


def rows_at(node: Node, eta: Array) -> tuple[Array, Index, Index]:
    """Functions and derivatives at points of a cell.

    Parameters
    ----------
    eta : (p, 3) in the cell.

    Returns
    -------
    Tables (k, p, n), levels of subdivision (p,), -1 on irregular edges and vertices, and ways (p,).
    """
    p = len(eta)
    if node.regular:
        return tables(eta) @ node.C, np.zeros(p, dtype=np.int64), np.full(p, RINGS)
    if node.corner is None:
        return _step(node, eta)
    product = node.product
    corner = _CORNERS[node.corner[0]] if product is None else product.corner
    free = np.ones(3, dtype=bool) if product is None else np.arange(3) != product.axis
    power = node.corner[1] if product is None else product.power
    distance = np.abs(eta - corner) * free
    far = distance.max(axis=1)
    m = np.maximum(-np.frexp(far)[1], 0).astype(np.int64)
    on = far == 0.0
    m[on] = 0
    near = np.where(free, np.abs(corner - np.ldexp(distance, m[:, None])), eta)
    made, level, way = np.empty((10, p, node.C.shape[1])), np.full(p, -1), np.full(p, power.way)
    off = np.flatnonzero(~on)
    across = ORDERS @ free
    if len(off):
        T, level[off], deeper = _step(node, near[off])
        steps = m[off]
        level[off] += steps
        way[off] = np.where(steps > 0, np.maximum(power.way, deeper), deeper)
        B = power.times(T, steps) if product is None else product.times(T, steps)
        whole = np.broadcast_to(power.limit, T[0].shape) if product is None else product.limits(T)
        B += np.where((steps > 0)[None, :, None] & (across == 0)[:, None, None], whole, 0.0)
        made[:, off] = np.ldexp(B, across[:, None, None] * steps[None, :, None])
    if on.any():
        made[:, on] = tables(eta[on]) @ node.C
        made[np.ix_(across > 0, on)] = np.nan
    return made, level, way


def _step(node: Node, eta: Array) -> tuple[Array, Index, Index]:
    """One level of subdivision."""
    nodes, matrices = node.children
    bit = (eta >= 0.5).astype(np.int64)
    child = bit @ np.array([4, 2, 1])
    made = np.empty((10, len(eta), matrices[0].shape[1]))
    level, way = np.empty(len(eta), dtype=np.int64), np.empty(len(eta), dtype=np.int64)
    scale = 2.0 ** ORDERS.sum(axis=1)[:, None, None]
    for c in np.unique(child).tolist():
        mine = np.flatnonzero(child == c)
        T, below, way[mine] = rows_at(nodes[c], 2.0 * eta[mine] - bit[mine])
        made[:, mine] = scale * (T @ matrices[c])
        level[mine] = np.where(below < 0, -1, below + 1)
    return made, level, way
