"""MFEM NURBS meshes ("MFEM NURBS mesh v1.0"), hexahedral patches.

The file gives a topology (``elements`` are patches with eight vertices, ``boundary`` quadrilaterals with attributes,
``edges`` with the number of their knot vector) and then either ``patches``, each with its own knots and control points,
or shared ``knotvectors`` and one list of ``weights`` and of nodes. In the second form functions are numbered by
topology: vertices, then the inside of edges (in the order of the list, from the lower vertex to the higher), of
faces (in the order in which the patches meet them, running as in the first patch that has them), and of patches, the
first direction fastest. A knot vector runs from the first to the second vertex of its edges.

Axis letters: p patch, v vertex, f face, n function.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.knots import reversed_knots
from geometry.nurbs.multipatch import Name
from geometry.nurbs.tokens import Cursor, read_text
from geometry.patch import Patch, make_patch
from iga.errors import FormatError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# The vertices of a patch in MFEM's order, and MFEM's local faces.
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
EDGES = ((0, 1), (3, 2), (4, 5), (7, 6)), ((1, 2), (0, 3), (5, 6), (4, 7)), ((0, 4), (1, 5), (2, 6), (3, 7))
QUADS = ((3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7))
QUAD_FACES = (4, 2, 1, 3, 0, 5)  # as 2 * direction + side


@dataclass(frozen=True, eq=False)
class Topology:
    """Patches of a file: elements (p, 8) vertices, boundary rows (attribute, four vertices), edges (knots, v, v)."""

    elements: Index
    boundary: list[tuple[int, tuple[int, ...]]]
    edges: list[tuple[int, int, int]]
    vertices: int


def read(path: str | Path) -> tuple[list[Patch], list[Name]]:
    """Read the patches of an MFEM NURBS mesh and its boundary attributes as names ``boundary_{attribute}``.

    Raises
    ------
    FormatError : the file is truncated, of another kind, or inconsistent.
    InputError : it is not a volume, or a patch is not valid; the message names file and patch.
    """
    name = Path(path).name
    text = read_text(path)
    first = text.split("\n", 1)[0].strip()
    if first != "MFEM NURBS mesh v1.0":
        raise FormatError(f"{name}: starts with {first[:40]!r}, not with 'MFEM NURBS mesh v1.0'")
    cursor = Cursor([w for line in text.splitlines()[1:] for w in line.split("#", 1)[0].split()], name)
    topology = _topology(cursor)
    section = cursor.take(1, "knotvectors or patches")[0]
    if section == "patches":
        patches = [_own_patch(cursor, f"{name}, patch {p}") for p in range(len(topology.elements))]
    elif section == "knotvectors":
        patches = _shared(cursor, topology)
    else:
        raise FormatError(f"{name}: expected 'knotvectors' or 'patches', found {section[:40]!r}")
    faces: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for p, v in enumerate(topology.elements.tolist()):
        for quad, face in zip(QUADS, QUAD_FACES):
            faces.setdefault(tuple(sorted(v[i] for i in quad)), []).append((p, face))
    names: list[Name] = []
    for row, (attribute, vertices) in enumerate(topology.boundary):
        owners = faces.get(tuple(sorted(vertices)))
        if not owners:
            raise FormatError(f"{name}: boundary element {row} with vertices {vertices} is no face of a patch")
        names += [(f"boundary_{attribute}", p, f) for p, f in owners]
    return patches, names


def _topology(cursor: Cursor) -> Topology:
    name = cursor.name
    cursor.expect("dimension")
    dimension = cursor.integer("dimension")
    if dimension != 3:
        raise InputError(f"{name}: a mesh of dimension {dimension} ({'surface' if dimension == 2 else 'curve'}), "
                         f"not a volume")
    cursor.expect("elements")
    rows = []
    for p in range(cursor.count("number of elements")):
        _, kind, *v = (cursor.integer(f"element {p}") for _ in range(10))
        if kind != 5:
            raise FormatError(f"{name}: element {p} has geometry type {kind}; patches are hexahedra (type 5)")
        rows.append(v)
    cursor.expect("boundary")
    boundary = []
    for i in range(cursor.count("number of boundary elements")):
        attribute, kind, *quad = (cursor.integer(f"boundary element {i}") for _ in range(6))
        if kind != 3:
            raise FormatError(f"{name}: boundary element {i} has geometry type {kind}, not 3 (square)")
        boundary.append((attribute, tuple(quad)))
    edges = []
    if cursor.peek() == "edges":
        cursor.expect("edges")
        for i in range(cursor.count("number of edges")):
            k, v0, v1 = (cursor.integer(f"edge {i}") for _ in range(3))
            edges.append((k, v0, v1))
    cursor.expect("vertices")
    vertices = cursor.integer("number of vertices")
    elements = np.array(rows, dtype=np.int64).reshape(-1, 8)
    if not len(elements):
        raise FormatError(f"{name}: there is no patch")
    for p, v in enumerate(rows):
        if len(set(v)) != 8 or min(v) < 0 or max(v) >= vertices:
            raise FormatError(f"{name}: patch {p} needs eight different vertices between 0 and {vertices - 1}, not {v}")
    if vertices != len(np.unique(elements)):
        raise FormatError(f"{name}: {vertices} vertices, but the patches use {len(np.unique(elements))}")
    return Topology(elements, boundary, edges, vertices)


def _knot_vector(cursor: Cursor, where: str) -> tuple[Array, int]:
    """Knots and number of control points."""
    degree = cursor.integer(f"degree of {where}")
    n = cursor.count(f"number of control points of {where}")
    if not 1 <= degree < n:
        raise FormatError(f"{cursor.name}: {where} has degree {degree} and {n} control points")
    return cursor.numbers(n + degree + 1, where), n


def _own_patch(cursor: Cursor, where: str) -> Patch:
    """One patch of the ``patches`` form."""
    cursor.expect("knotvectors")
    if cursor.integer("number of knot vectors") != 3:
        raise InputError(f"{where}: a patch that is not a volume (a volume has three knot vectors)")
    vectors = [_knot_vector(cursor, f"knot vector {d} of {where}") for d in range(3)]
    cursor.expect("dimension")
    if cursor.integer("dimension") != 3:
        raise InputError(f"{where}: control points are not in three-dimensional space")
    kind = cursor.take(1, "controlpoints")[0]
    if kind not in ("controlpoints", "controlpoints_homogeneous", "controlpoints_cartesian"):
        raise FormatError(f"{where}: expected 'controlpoints', found {kind[:40]!r}")
    n1, n2, n3 = (n for _, n in vectors)
    values = cursor.numbers(4 * n1 * n2 * n3, f"control points of {where}")
    net = np.ascontiguousarray(values.reshape(n3, n2, n1, 4).transpose(2, 1, 0, 3))
    control, weights = net[..., :3], np.ascontiguousarray(net[..., 3])
    if kind != "controlpoints_cartesian":
        with np.errstate(all="ignore"):
            control = np.nan_to_num(control / weights[..., None]) if not (weights > 0).all() else (
                control / weights[..., None])
    return make_patch([t for t, _ in vectors], control, weights, where)


def _shared(cursor: Cursor, topology: Topology) -> list[Patch]:
    """Patches of the form with shared knot vectors, weights and nodes."""
    name = cursor.name
    vectors = [_knot_vector(cursor, f"knot vector {k}") for k in range(cursor.count("number of knot vectors"))]
    wrong = [e for e in topology.edges if not 0 <= e[0] < len(vectors)]
    if wrong:
        raise FormatError(f"{name}: the edge between vertices {wrong[0][1]} and {wrong[0][2]} names knot vector "
                          f"{wrong[0][0]} of {len(vectors)}")
    chosen = [_directions(topology, p, name) for p in range(len(topology.elements))]
    shapes = [tuple(vectors[k][1] for k, _ in three) for three in chosen]
    if sum(n1 * n2 * n3 for n1, n2, n3 in shapes) > 64 * max(cursor.left, 1):
        raise FormatError(f"{name}: patches of {shapes[0]} control points, but {cursor.left} entries are left")
    nets, n = _number(topology, shapes, [vectors[k][1] for k, *_ in topology.edges], name)
    cursor.expect("weights")
    weights = cursor.numbers(n, f"{n} weights")
    cursor.expect("FiniteElementSpace")
    cursor.expect("FiniteElementCollection:")
    collection = cursor.take(1, "FiniteElementCollection")[0]
    cursor.expect("VDim:")
    components = cursor.integer("VDim")
    cursor.expect("Ordering:")
    ordering = cursor.integer("Ordering")
    if not collection.startswith("NURBS") or components != 3 or ordering not in (0, 1):
        raise FormatError(f"{name}: nodes {collection[:20]} with VDim {components}, Ordering {ordering} cannot be read")
    values = cursor.numbers(3 * n, f"{n} nodes")
    points = values.reshape(n, 3) if ordering == 1 else values.reshape(3, n).T
    patches = []
    for p, (net, three) in enumerate(zip(nets, chosen)):
        knots = [reversed_knots(vectors[k][0]) if backwards else vectors[k][0] for k, backwards in three]
        patches.append(make_patch(knots, points[net], weights[net], f"{name}, patch {p}"))
    return patches


def _directions(topology: Topology, p: int, name: str) -> list[tuple[int, bool]]:
    """Knot vector of each direction of a patch, and whether it runs backwards there."""
    table = {(v0, v1): k for k, v0, v1 in topology.edges}
    if len({tuple(sorted(e)) for e in table}) != len(topology.edges):
        raise FormatError(f"{name}: two edges have the same vertices; write the file in the 'patches' form")
    v = topology.elements[p].tolist()
    result = []
    for d in range(3):
        found = set()
        for a, b in EDGES[d]:
            ahead, back = table.get((v[a], v[b])), table.get((v[b], v[a]))
            k = ahead if ahead is not None else back
            if k is None:
                raise FormatError(f"{name}: patch {p}: the edge between vertices {v[a]} and {v[b]} is not listed")
            found.add((k, ahead is None))
        if len(found) != 1:
            raise FormatError(f"{name}: patch {p}: its four edges along {'xyz'[d]} differ in knot vector or sense")
        result.append(found.pop())
    return result


def _number(
    topology: Topology, shapes: list[tuple[int, ...]], edge_sizes: list[int], name: str
) -> tuple[list[Index], int]:
    """Function numbers of each patch, arrays of the shape of its control net, and how many there are."""
    total = topology.vertices
    edge_offset = {}
    for (_, v0, v1), size in zip(topology.edges, edge_sizes):
        edge_offset[min(v0, v1), max(v0, v1)] = total
        total += size - 2
    frames: dict[tuple[int, ...], tuple[list[int], Index]] = {}
    nets = [np.full(shape, -1, dtype=np.int64) for shape in shapes]
    for v, net in zip(topology.elements.tolist(), nets):
        for quad in QUADS:
            corner = [v[i] for i in quad]
            key = tuple(sorted(corner))
            if key not in frames:
                view = _face_view(net, CORNERS[list(quad)])
                n1, n2 = view.shape
                frames[key] = (corner, total + np.arange(n1 * n2).reshape(n2, n1).T)
                total += n1 * n2
    for v, net in zip(topology.elements.tolist(), nets):
        net[np.ix_(*([0, -1],) * 3)] = np.array(v)[_corner_order()]
        for d in range(3):
            for a, b in EDGES[d]:
                inside = tuple(slice(1, -1) if k == d else -int(CORNERS[a][k]) for k in range(3))
                first = edge_offset[min(v[a], v[b]), max(v[a], v[b])]
                run = np.arange(first, first + net.shape[d] - 2)
                net[inside] = run if v[a] < v[b] else run[::-1]
        for quad in QUADS:
            corner, numbers = frames[tuple(sorted(v[i] for i in quad))]
            view = _face_view(net, CORNERS[[v.index(c) for c in corner]])
            if view.shape != numbers.shape:
                raise FormatError(f"{name}: the face with vertices {corner} differs in size between its two patches")
            view[...] = numbers
        inner = net[1:-1, 1:-1, 1:-1]
        n1, n2, n3 = inner.shape
        inner[...] = total + np.arange(n1 * n2 * n3).reshape(n3, n2, n1).transpose(2, 1, 0)
        total += n1 * n2 * n3
    return nets, total


def _corner_order() -> Index:
    """Position in MFEM's order of the vertex at (i, j, k), (2, 2, 2)."""
    order = np.empty((2, 2, 2), dtype=np.int64)
    order[tuple(CORNERS.T)] = np.arange(8)
    return order


def _face_view(net: Index, corners: Index) -> Index:
    """Inside of a face of a net: axes from corner 0 to corner 1 and from corner 0 to corner 3 of ``corners`` (4, 3)."""
    fixed = int(np.flatnonzero((corners == corners[0]).all(axis=0))[0])
    view = net[tuple(-int(corners[0][k]) if k == fixed else slice(1, -1) for k in range(3))]
    rest = [k for k in range(3) if k != fixed]
    first = int(np.flatnonzero(corners[1] != corners[0])[0])
    if (corners[1] != corners[0]).sum() != 1 or (corners[3] != corners[0]).sum() != 1:
        raise FormatError("the vertices of a face are not in the same cyclic order in its two patches")
    if rest[0] != first:
        view = view.T
        rest.reverse()
    backwards = [slice(None, None, -1) if corners[0][k] else slice(None) for k in rest]
    return view[backwards[0], backwards[1]]
