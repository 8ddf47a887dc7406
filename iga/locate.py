r"""Point location: which element holds a point of space, and where in it.

Control points of an element (with positive weights) span a convex hull that holds it, so its box of control points
encloses it. A point is looked up in a tree of boxes; in the elements that remain, x(xi) = p is solved by damped Newton,
after a test that excludes most elements for good: x(xi) - p keeps a sign along a row of J^-1. The pyramid is inverted
in its collapsed coordinates, where its map is polynomial.

Axis letters: p point, e element, b Bernstein function, v barycentric coordinate, d reference dimension.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from iga.bernstein import Bernstein
from iga.block import bezier_coefficients
from iga.certificate import as_bernstein
from iga.determinant import Form, determinant, form
from iga.domain import Domain, homogeneous
from iga.errors import InputError
from iga.kernels.approach import approach
from iga.kernels.boxes import LEAF, query
from iga.kernels.inversion import FOUND, OPEN, TESTED, invert
from iga.located import Located
from iga.parallel import ranges, run

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_POINTS = 50_000
"""Points looked up at a time."""
_CHUNK_BYTES = 32 * 2**20
"""Bytes of control nets and extraction operators that are held at a time."""


@dataclass(frozen=True, eq=False)
class Location:
    """Where points lie.

    Attributes
    ----------
    block, element : (p,) block number and element number in the block; -1 for points outside.
    xi : (p, 3) reference coordinates; NaN outside.
    distance : (p,) between the point and x(xi); infinite for points outside.
    """

    block: Index
    element: Index
    xi: Array
    distance: Array


@dataclass(frozen=True, eq=False)
class Tree:
    """Boxes of all elements of a domain, blocks one after the other, in a binary tree; make it with `tree`.

    Attributes
    ----------
    offsets : (blocks + 1,) elements of block i are offsets[i]:offsets[i + 1].
    low, high : (e, 3) box of each element.
    node_low, node_high : (nodes, 3); node i has the children 2i and 2i + 1, the root is 1.
    order : (e,) elements along the leaves.
    size : length of the diagonal of the box of everything.
    """

    offsets: Index
    low: Array
    high: Array
    node_low: Array
    node_high: Array
    order: Index
    size: float


def tree(domain: Domain) -> Tree:
    """Boxes of a domain's elements; build it once to locate many times.

    Raises
    ------
    InputError : a Bezier weight is not positive, so that control points do not enclose the element.
    """
    offsets = np.concatenate([[0], np.cumsum([b.elements for b in domain.space.blocks])]).astype(np.int64)
    low, high = np.empty((offsets[-1], 3)), np.empty((offsets[-1], 3))
    for number in range(len(domain.space.blocks)):
        for elements in _pieces(domain, number, np.arange(domain.space.blocks[number].elements)):
            net = control_nets(domain, number, elements)
            if not (net[..., 3] > 0.0).all():
                bad = elements[np.flatnonzero(~(net[..., 3] > 0.0).all(axis=1))[0]]
                raise InputError(f"element {bad} of block {number} has a Bezier weight that is not positive")
            points = net[..., :3] / net[..., 3:]
            low[offsets[number] + elements] = points.min(axis=1)
            high[offsets[number] + elements] = points.max(axis=1)
    size = float(np.linalg.norm(high.max(axis=0) - low.min(axis=0))) if len(low) else 0.0
    order = _morton(0.5 * (low + high))
    leaves = max(1, 1 << (max(-(-len(order) // LEAF), 1) - 1).bit_length())
    node_low, node_high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    padded = np.full((2, leaves * LEAF, 3), np.inf)
    padded[0, : len(order)], padded[1, : len(order)] = low[order], -high[order]
    node_low[leaves:] = padded[0].reshape(leaves, LEAF, 3).min(axis=1)
    node_high[leaves:] = -padded[1].reshape(leaves, LEAF, 3).min(axis=1)
    start = leaves
    while start > 1:
        children = slice(start, 2 * start)
        node_low[start // 2 : start] = node_low[children].reshape(-1, 2, 3).min(axis=1)
        node_high[start // 2 : start] = node_high[children].reshape(-1, 2, 3).max(axis=1)
        start //= 2
    return Tree(offsets, low, high, node_low, node_high, order, size)


def locate(
    domain: Domain, points: Array, tolerance: float = 1e-10, nearest: bool = False, boxes: Tree | None = None
) -> Location:
    """Find the elements that hold points.

    Parameters
    ----------
    domain : a solid.
    points : (p, 3)
    tolerance : relative to the size of the domain: points no further away are on the boundary. Points on faces
        between elements get any of their owners.
    nearest : give points outside the nearest point of the solid (a local search in all elements that may have it), with
        its distance.
    boxes : the domain's `tree`, if at hand.

    Raises
    ------
    InputError : points have a wrong shape or are not finite, tolerance is negative, or weights are not positive.
    """
    points = np.ascontiguousarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points to locate must have the shape (p, 3), not {points.shape}")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InputError(f"point {bad[0]} to locate is not finite")
    if not tolerance >= 0.0:
        raise InputError(f"tolerance {tolerance} must not be negative")
    boxes = boxes or tree(domain)
    count = len(points)
    found = Location(np.full(count, -1), np.full(count, -1), np.full((count, 3), np.nan), np.full(count, np.inf))
    if not len(boxes.order):
        return found
    # Never below what the coordinates themselves can tell apart.
    reach = max(tolerance * boxes.size, 16.0 * np.finfo(float).eps * float(np.abs(boxes.node_low[1]).max()))
    reach = max(reach, 16.0 * np.finfo(float).eps * float(np.abs(boxes.node_high[1]).max()))
    for start in range(0, count, _POINTS):
        _inside(domain, boxes, points, np.arange(start, min(start + _POINTS, count)), reach, found)
    if nearest:
        outside = np.flatnonzero(found.element < 0)
        bound = _corner_distance(domain, points[outside])
        for start in range(0, len(outside), _POINTS // 10):
            part = slice(start, start + _POINTS // 10)
            _closest(domain, boxes, points, outside[part], bound[part], found)
    return found


def places(domain: Domain, block: Index, element: Index, xi: Array) -> Array:
    """Points (p, 3) of the solid at reference coordinates xi (p, 3) of elements (p,) of blocks (p,): the way back.

    Raises
    ------
    InputError : there is no such element.
    """
    xi = np.asarray(xi, dtype=float)
    sizes = np.array([b.elements for b in domain.space.blocks])
    known = (block >= 0) & (block < len(sizes))
    known[known] = (element[known] >= 0) & (element[known] < sizes[block[known]])
    if not known.all():
        p = int(np.argmin(known))
        raise InputError(f"point {p}: there is no element {element[p]} of block {block[p]}")
    return Located(domain, block, element, xi).x


def _inside(domain: Domain, boxes: Tree, points: Array, rows: Index, reach: float, found: Location) -> None:
    """Newton in the candidates of each point, best ones first; then from more starts where nothing is proved."""
    start, candidates, _ = _candidates(boxes, points[rows], np.full(len(rows), reach))
    status = np.full(len(candidates), OPEN, dtype=np.int64)
    for attempt in range(2):
        here = start[:-1].copy()
        while True:
            waiting = (found.element[rows] < 0) & (here < start[1:])
            pairs = here[waiting]
            if not len(pairs):
                break
            here[waiting] += 1
            mine = rows[waiting]
            open_ = status[pairs] == OPEN
            _newton(domain, boxes, points, mine[open_], candidates, pairs[open_], status, attempt, reach, found)


def _newton(
    domain: Domain, boxes: Tree, points: Array, rows: Index, candidates: Index, pairs: Index, status: Index,
    attempt: int, reach: float, found: Location,
) -> None:
    for number, some, nets, which in _grouped(domain, boxes, candidates[pairs]):
        shape, origin, starts = _search(as_bernstein(domain.space.blocks[number].basis))
        targets = points[rows[some]]
        state = status[pairs[some]]
        barycentric, distance = np.empty((len(some), len(origin))), np.empty(len(some))
        # The second attempt skips the test (what is open survived it) and the first start.
        state[:] = OPEN if attempt == 0 else TESTED
        chosen = starts[:1] if attempt == 0 else starts[1:]
        run([
            partial(invert, nets, which, targets, shape.exponents, shape.scale, origin, chosen, reach, a, b, state,
                    barycentric, distance)
            for a, b in ranges(len(some))
        ])
        status[pairs[some]] = np.where(state == TESTED, OPEN, state)
        hit = np.flatnonzero(state == FOUND)
        _store(domain, boxes, number, candidates[pairs[some[hit]]], rows[some[hit]], origin, barycentric[hit],
               distance[hit], found)


def _closest(domain: Domain, boxes: Tree, points: Array, rows: Index, bound: Array, found: Location) -> None:
    """Nearest points, element boxes in the order of their distance until none can be closer."""
    start, candidates, gaps = _candidates(boxes, points[rows], bound * (1.0 + 1e-12) + 1e-300)
    here = start[:-1].copy()
    while True:
        waiting = here < start[1:]
        pairs = here[waiting]
        closer = np.zeros(len(rows), dtype=bool)
        closer[waiting] = np.maximum(gaps[pairs], 0.0) < found.distance[rows[waiting]]
        pairs = here[closer]
        if not len(pairs):
            return
        here[closer] += 1
        here[waiting & ~closer] = start[1:][waiting & ~closer]
        mine = rows[closer]
        for number, some, nets, which in _grouped(domain, boxes, candidates[pairs]):
            shape, origin, starts = _search(as_bernstein(domain.space.blocks[number].basis))
            barycentric, distance = np.empty((len(some), len(origin))), np.empty(len(some))
            run([
                partial(approach, nets, which, points[mine[some]], shape.exponents, shape.scale, origin,
                        starts[0], a, b, barycentric, distance)
                for a, b in ranges(len(some))
            ])
            hit = np.flatnonzero(distance < found.distance[mine[some]])
            _store(domain, boxes, number, candidates[pairs[some[hit]]], mine[some[hit]], origin, barycentric[hit],
                   distance[hit], found)


def _store(
    domain: Domain, boxes: Tree, number: int, elements: Index, rows: Index, origin: Index, barycentric: Array,
    distance: Array, found: Location,
) -> None:
    xi = barycentric[:, origin != np.arange(len(origin))]
    if domain.space.blocks[number].basis.cell.name == "pyramid":
        xi[:, :2] *= 1.0 - xi[:, 2:]
    found.block[rows] = number
    found.element[rows] = elements - boxes.offsets[number]
    found.xi[rows] = xi
    found.distance[rows] = distance


def _candidates(boxes: Tree, points: Array, radius: Array) -> tuple[Index, Index, Array]:
    """Elements whose box is within the radius of each point, best first: start (p + 1,), elements, sort keys."""
    start = np.zeros(len(points) + 1, dtype=np.int64)
    leaves = len(boxes.node_low) // 2
    head = (boxes.node_low, boxes.node_high, leaves, boxes.order, boxes.low, boxes.high, points, radius)
    nothing, none = np.empty(0, dtype=np.int64), np.empty(0)
    run([partial(query, *head, a, b, start, nothing, none) for a, b in ranges(len(points))])
    start = np.cumsum(start)
    elements, key = np.empty(start[-1], dtype=np.int64), np.empty(start[-1])
    if len(elements):
        run([partial(query, *head, a, b, start, elements, key) for a, b in ranges(len(points))])
    order = np.lexsort((key, np.repeat(np.arange(len(points)), np.diff(start))))
    return start, elements[order], key[order]


def _grouped(domain: Domain, boxes: Tree, elements: Index) -> Iterator[tuple[int, Index, Array, Index]]:
    """Requests for elements by block and bounded memory: block, rows of ``elements``, distinct nets, which net."""
    blocks = np.searchsorted(boxes.offsets, elements, side="right") - 1
    for number in np.unique(blocks).tolist():
        rows = np.flatnonzero(blocks == number)
        rows = rows[np.argsort(elements[rows], kind="stable")]
        distinct, which = np.unique(elements[rows] - boxes.offsets[number], return_inverse=True)
        bounds = 0
        for some in _pieces(domain, number, distinct):
            a, b = np.searchsorted(which, [bounds, bounds + len(some)])
            yield number, rows[a:b], form_nets(domain, number, some), which[a:b] - bounds
            bounds += len(some)


def _pieces(domain: Domain, number: int, elements: Index) -> list[Index]:
    block = domain.space.blocks[number]
    step = max(64, _CHUNK_BYTES // (32 * max(block.n, block.basis.n) * (1 if block.extraction is None else block.n)))
    return [elements[i : i + step] for i in range(0, len(elements), step)]


def control_nets(domain: Domain, number: int, elements: Index) -> Array:
    """Homogeneous control points (w x, w) of elements of a block, (m, b, 4)."""
    space = domain.space
    net = bezier_coefficients(space.blocks[number], homogeneous(space, domain.points), elements)
    if space.weights is None:
        return np.concatenate([net, np.ones((*net.shape[:2], 1))], axis=2)
    return net


def form_nets(domain: Domain, number: int, elements: Index) -> Array:
    """Control nets in the form that is inverted: pyramids as tensor products in collapsed coordinates."""
    net = control_nets(domain, number, elements)
    basis = as_bernstein(domain.space.blocks[number].basis)
    if basis.cell.name == "pyramid":
        weight = determinant(basis, True).weight
        net = net if weight is None else weight.matrix @ net
    return np.ascontiguousarray(net)


@cache
def _search(basis: Bernstein) -> tuple[Form, Index, Array]:
    """Form, first barycentric coordinate of each one's simplex factor, and points to start from (s, v)."""
    weight = determinant(basis, True).weight
    if weight is None:
        raise InputError(f"no volume map on a {basis.cell.name}")
    shape = weight.form
    origin = np.concatenate([np.full(c, sum(s[0] for s in shape.sizes[:g])) for g, (c, _) in enumerate(shape.sizes)])
    corners = form(tuple((c, 1) for c, _ in shape.sizes)).exponents.astype(float)
    centre = corners.mean(axis=0)
    return shape, origin.astype(np.int64), np.vstack([centre, 0.4 * centre + 0.6 * corners])


def _corner_distance(domain: Domain, points: Array) -> Array:
    """Distance from points to the nearest vertex of any element: no nearest point is further."""
    corners = []
    for number, block in enumerate(domain.space.blocks):
        B = block.basis.tabulate(block.basis.cell.vertices, 0)[0]
        for elements in _pieces(domain, number, np.arange(block.elements)):
            x = B @ control_nets(domain, number, elements)
            corners.append((x[..., :3] / x[..., 3:]).reshape(-1, 3))
    return np.asarray(cKDTree(np.concatenate(corners)).query(points, workers=-1)[0])


def _morton(centres: Array) -> Index:
    """Order of points along Morton's curve, 21 bits a direction."""
    if not len(centres):
        return np.empty(0, dtype=np.int64)
    low = centres.min(axis=0)
    spread = max(float((centres.max(axis=0) - low).max()), 1e-300)
    grid = np.minimum((centres - low) / spread * 2.0**21, 2.0**21 - 1.0).astype(np.uint64)
    code = np.zeros(len(centres), dtype=np.uint64)
    for d in range(3):
        x = grid[:, d]
        for shift, mask in (
            (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | (x << np.uint64(shift))) & np.uint64(mask)
        code |= x << np.uint64(2 - d)
    return np.argsort(code, kind="stable")
