r"""The paper's T-splines: unclamped cubic blending functions on an octree, rational with weights one.

Every vertex of the T-mesh is an anchor t and carries a product of cubic B-splines with five knots in each direction
(section 3.1 of the paper):

    knots      the two next faces of cells on each side of t in that direction whose *closed* cross-section contains the
               other coordinates of t;
    phantoms   where there are fewer, the last spacing found on that side goes on, or the first spacing of the opposite
               side if there is none (figure 3b). All five knots are distinct, so the functions are C^2.

    S = sum_a P_a R_a,    R_a = B_a / sum_b B_b                                              (equations (9) and (10))

The B_a do not sum to one (5/6 in each direction at the boundary of a uniform mesh), so the quotient is essential. On a
polycube the octree fills a cube around it: cells outside give knots, but their vertices are no anchors.

Elements are the cells of the common refinement of all knot planes that are active in a leaf cell, so every B_a is one
polynomial on each. Their Bernstein coefficients are blossoms of the pieces,

    b_j = N(x0^(3-j), x1^j),    N_{k0..k4}(u, v, w) by the Cox-de Boor recursion, one argument at each step,

and depend on the knots relative to the element only, so elements share patterns. All coordinates are integers over
2^LEVELS and all comparisons are exact.

Values, and control points that interpolate, are in `interpolation`.

Axis letters: a anchor (function), d direction, c cell, e element, j Bernstein function, m pair of function and cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import Blocks, cube
from geometry.meccano.distinct import distinct
from geometry.meccano.enclosing import enclosing, frames_of
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.tmesh import TMesh, cells_of, divmod_side
from iga.bernstein import bernstein
from iga.block import Block, Patterns
from iga.domain import Facets, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_FULL = 1 << LEVELS
_FAR = 1 << 40


@dataclass(frozen=True, eq=False)
class TSpline:
    """A T-spline space; make it with `t_spline`.

    Attributes
    ----------
    blocks : the meccano.
    tmesh : octree of the enclosing cube (of the cube itself, if that is the meccano).
    owner : (c,) block of the meccano that each cell of it belongs to, -1 outside.
    anchors : (n, d) places of the anchors, integers over 2^LEVELS of the enclosing cube.
    knots : (n, d, 5) local knots in the same units, phantoms included.
    space : the functions on elements, with weights one.
    element : (k, 2) block of the space and element in it, cell by cell.
    cell : (k,) leaf cell of each of these elements.
    low, high : (k, d) their corners.
    start, acting : functions ``acting[start[c]:start[c + 1]]`` act on cell c.
    """

    blocks: Blocks
    tmesh: TMesh
    owner: Index
    anchors: Index
    knots: Index
    space: Space
    element: Index
    cell: Index
    low: Index
    high: Index
    start: Index
    acting: Index


def t_spline(tmesh: TMesh) -> TSpline:
    """T-spline space on the T-mesh of a cube (a square), or of a polycube of unit cubes.

    Raises
    ------
    InputError : the blocks are not unit cubes on a grid.
    """
    around, owner = enclosing(tmesh)
    anchors = anchors_of(around, owner >= 0)
    knots = local_knots(around, anchors)
    cell, function = _overlaps(around, owner >= 0, knots)
    start = np.searchsorted(cell, np.arange(around.cells + 1))
    parent, low, high = _elements(around, owner >= 0, knots, cell, function)
    space, element = _space(knots, anchors, start, function, parent, low, high)
    return TSpline(tmesh.blocks, around, owner, anchors, knots, space, element, parent, low, high, start, function)


def anchors_of(tmesh: TMesh, inside: Mask) -> Index:
    """Vertices (n, d) of the cells inside, lexicographic."""
    vertices = cube(tmesh.dim).cell.vertices.astype(np.int64)
    corners = tmesh.corner[inside, None] + tmesh.size[inside, None, None] * vertices
    key = np.unique(corners.reshape(-1, tmesh.dim) @ (_FULL + 1) ** np.arange(tmesh.dim)[::-1])
    return np.stack([key // (_FULL + 1) ** a % (_FULL + 1) for a in range(tmesh.dim)[::-1]], axis=1)


def local_knots(tmesh: TMesh, anchors: Index) -> Index:
    """Local knots (n, d, 5) of anchors (n, d) of the T-mesh of one cube."""
    n, d = anchors.shape
    knots = np.empty((n, d, 5), dtype=np.int64)
    knots[..., 2] = anchors
    for axis in range(d):
        low, high = (_march(tmesh, anchors, axis, sign) for sign in (-1, 1))
        own = anchors[:, axis]
        for side, other in ((low, high), (high, low)):
            # Missing knots lie at +-_FAR; the opposite side has at least one.
            none, one = np.abs(side[:, 0]) == _FAR, np.abs(side[:, 1]) == _FAR
            side[none, 0] = 2 * own[none] - other[none, 0]
            side[one, 1] = 2 * side[one, 0] - own[one]
        knots[:, axis, 1], knots[:, axis, 0] = low.T
        knots[:, axis, 3], knots[:, axis, 4] = high.T
    return knots


def _march(tmesh: TMesh, anchors: Index, axis: int, sign: int) -> Index:
    """First two faces (n, 2) met from anchors along an axis, +-_FAR where there are none.

    Lines a unit beside the anchor in every other direction together meet all closed cross-sections that contain it.
    """
    n, d = anchors.shape
    others = [a for a in range(d) if a != axis]
    found = []
    for beside in np.ndindex(*(2,) * (d - 1)):
        at = anchors.copy()
        at[:, others] -= np.array(beside)
        alive = ((at[:, others] >= 0) & (at[:, others] < _FULL)).all(axis=1)
        for _ in range(2):
            alive = alive & (at[:, axis] > 0 if sign < 0 else at[:, axis] < _FULL)
            probe = at[alive]
            probe[:, axis] -= sign < 0
            cells = cells_of(tmesh, np.zeros(len(probe), dtype=np.int64), probe)
            face = tmesh.corner[cells, axis] + (tmesh.size[cells] if sign > 0 else 0)
            at[alive, axis] = face
            value = np.full(n, _FAR)
            value[alive] = sign * face
            found.append(value)
    values = np.sort(np.stack(found, axis=1), axis=1)
    first = values[:, 0]
    second = np.where(values > first[:, None], values, _FAR).min(axis=1)
    return sign * np.stack([first, second], axis=1)


def _overlaps(tmesh: TMesh, inside: Mask, knots: Index) -> tuple[Index, Index]:
    """Pairs (m,) of an inside leaf cell and a function whose support meets its interior, sorted by both."""
    d = tmesh.dim
    function = np.arange(len(knots))
    at = np.zeros(len(knots), dtype=np.int64)
    cells, functions = [], []
    for level, nodes in enumerate(tmesh.tree):
        low = nodes.place << (LEVELS - level)
        meets = (
            (knots[function, :, 0] < low[at] + (1 << (LEVELS - level))) & (knots[function, :, 4] > low[at])
        ).all(axis=1)
        function, at = function[meets], at[meets]
        leaf = nodes.leaf[at]
        done = leaf >= 0
        kept = done & inside[leaf]
        cells.append(leaf[kept])
        functions.append(function[kept])
        # Children of split cells follow each other on the next level.
        first = (np.cumsum(nodes.leaf < 0) - 1) << d
        at = (first[at[~done], None] + np.arange(2**d)).ravel()
        function = np.repeat(function[~done], 2**d)
    cell, function = np.concatenate(cells), np.concatenate(functions)
    order = np.lexsort((function, cell))
    return cell[order], function[order]


def _elements(
    tmesh: TMesh, inside: Mask, knots: Index, cell: Index, function: Index
) -> tuple[Index, Index, Index]:
    """Cut cells by the knot planes active in them: leaf cell (k,), low and high corners (k, d)."""
    chosen = np.flatnonzero(inside)
    counts, starts, breaks = [], [], []
    for axis in range(tmesh.dim):
        low, high = tmesh.corner[:, axis], tmesh.corner[:, axis] + tmesh.size
        planes = knots[function, axis]
        m, j = np.nonzero((planes > low[cell, None]) & (planes < high[cell, None]))
        rows = np.concatenate([
            np.column_stack([chosen, low[chosen]]), np.column_stack([chosen, high[chosen]]),
            np.column_stack([cell[m], planes[m, j]]),
        ])
        key = np.unique(rows[:, 0] * (2 * _FULL) + rows[:, 1])
        owner = key // (2 * _FULL)
        breaks.append(key % (2 * _FULL))
        starts.append(np.searchsorted(owner, np.arange(tmesh.cells)))
        counts.append(np.bincount(owner, minlength=tmesh.cells) - 1)
    total = np.where(inside, np.prod(counts, axis=0), 0)
    parent = np.repeat(np.arange(tmesh.cells), total)
    rest = np.arange(len(parent)) - np.repeat(np.cumsum(total) - total, total)
    corners = []
    for axis in range(tmesh.dim - 1, -1, -1):
        rest, place = np.divmod(rest, counts[axis][parent])
        at = starts[axis][parent] + place
        corners.append((breaks[axis][at], breaks[axis][at + 1]))
    low, high = (np.stack([c[end] for c in corners[::-1]], axis=1) for end in (0, 1))
    return parent, low, high


def _space(
    knots: Index, anchors: Index, start: Index, acting: Index, parent: Index, low: Index, high: Index
) -> tuple[Space, Index]:
    """Blocks of elements by number of functions."""
    d = low.shape[1]
    count = (start[1:] - start[:-1])[parent]
    element = np.repeat(np.arange(len(parent)), count)
    own = np.arange(len(element)) - np.repeat(np.cumsum(count) - count, count)
    function = acting[start[parent[element]] + own]
    meets = ((knots[function, :, 0] < high[element]) & (knots[function, :, 4] > low[element])).all(axis=1)
    element, function = element[meets], function[meets]
    # Functions of an element in the order of their anchors: equal elements then list equal functions.
    order = np.lexsort((*anchors[function].T[::-1], element))
    element, function = element[order], function[order]
    kinds, tables = [], []
    for axis in range(d):
        size = (high[:, axis] - low[:, axis])[element, None]
        relative = (knots[function, axis] - low[element, axis][:, None]) / size
        shown, kind = distinct(relative)
        kinds.append(kind)
        tables.append(_pieces(relative[shown]))
    count = np.bincount(element, minlength=len(parent))
    first = np.cumsum(count) - count
    place = np.empty((len(parent), 2), dtype=np.int64)
    blocks = []
    basis = bernstein(cube(d).cell, 3)
    for number, size in enumerate(np.unique(count).tolist()):
        mine = np.flatnonzero(count == size)
        rows = first[mine][:, None] + np.arange(size)
        sign = np.stack([kind[rows] for kind in kinds], axis=2)
        shown, pattern = distinct(sign.reshape(len(mine), -1))
        sign = sign[shown]
        C = tables[0][sign[..., 0]]
        for axis in range(1, d):
            C = (C[..., :, None] * tables[axis][sign[..., axis]][..., None, :]).reshape(*C.shape[:2], -1)
        blocks.append(Block(basis, function[rows], Patterns(C, pattern)))
        place[mine, 0], place[mine, 1] = number, np.arange(len(mine))
    return Space(tuple(blocks), len(knots), np.ones(len(knots))), place


def _pieces(knots: Array) -> Array:
    """Bernstein coefficients (m, 4) on [0, 1] of B-splines with knots (m, 5), none of them inside."""
    coefficients = np.empty((len(knots), 4))
    span = (knots <= 0.0).sum(axis=1) - 1
    for j in range(4):
        N = (np.arange(4) == span[:, None]).astype(np.float64)
        for p in range(1, 4):
            u = float(p > 3 - j)
            rising = (u - knots[:, : 4 - p]) / (knots[:, p:4] - knots[:, : 4 - p])
            falling = (knots[:, p + 1 :] - u) / (knots[:, p + 1 :] - knots[:, 1 : 5 - p])
            N = rising * N[:, :-1] + falling * N[:, 1:]
        coefficients[:, j] = N[:, 0]
    # Pieces of B-splines have non-negative coefficients; what rounding leaves of zeros is below 1e-16.
    return np.where(coefficients < 1e-15, 0.0, coefficients)


# --- boundary ---------------------------------------------------------------------------------------------------------


def boundaries(own: TSpline) -> dict[str, tuple[Facets, ...]]:
    """Facets of every boundary side, named ``side0``, ``side1``, ... by rows of ``blocks.boundary_sides``."""
    origin, axes, unit = frames_of(own.blocks)
    made = {}
    for row, (block, side) in enumerate(own.blocks.boundary_sides.tolist()):
        d, end = divmod_side(own.blocks, side)
        normal = axes[block, d] * (2 * end - 1)
        axis = int(np.abs(normal).argmax())
        up = int(normal[axis] > 0)
        # The block's side lies at its lowest or highest coordinate of that axis.
        ends = np.sort([origin[block, axis], origin[block, axis] + axes[block, :, axis].sum()])
        plane = int(ends[up]) * unit
        at = own.high if up else own.low
        mine = np.flatnonzero((own.owner[own.cell] == block) & (at[:, axis] == plane))
        face = next(f for f in range(2 * own.tmesh.dim) if divmod_side(cube(own.tmesh.dim), f) == (axis, up))
        where = own.element[mine]
        made[f"side{row}"] = tuple(
            Facets(number, face, np.sort(where[where[:, 0] == number, 1])) for number in np.unique(where[:, 0]).tolist()
        )
    return made


def places_of(own: TSpline, x: Index) -> tuple[Index, Array]:
    """Block (q,) and xi (q, d) in it of integer points (q, d) of the enclosing cube, for images of anchors."""
    origin, axes, unit = frames_of(own.blocks)
    d = own.tmesh.dim
    block = np.full(len(x), -1, dtype=np.int64)
    for offset in np.ndindex(*(2,) * d):
        found = cells_of(own.tmesh, np.zeros(len(x), dtype=np.int64), np.clip(x - np.array(offset), 0, _FULL - 1))
        block = np.where((block < 0), own.owner[found], block)
    xi = np.einsum("qij,qj->qi", axes[block], x / unit - origin[block])
    return block, xi
