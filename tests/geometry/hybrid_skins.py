"""Skins made by hand: closed C0 Bezier meshes, and boxes with B-spline faces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, lil_array

from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.numbering import ON_QUAD
from geometry.hybrid.refinement import mesh_of
from geometry.hybrid.shell import Shell
from iga.bernstein import bernstein, elevation, face_functions
from iga.cells import PYRAMID, QUADRILATERAL, TETRAHEDRON, TRIANGLE
from iga.conforming import Complex, number
from iga.conformity import jumps
from iga.domain import Domain, Space
from tests.splines import bezier_operators, greville

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Map = Callable[[Array], Array]


def base_functions(quads: Index, triangles: Index, degree: int) -> tuple[Index, Index, int]:
    """C0 Bernstein functions (e, b) of the quadrilaterals and triangles of a surface, and how many there are."""
    top = 1 + max(int(quads.max(initial=0)), int(triangles.max(initial=0)))
    over = np.full((len(quads), 5), top)
    over[:, :4] = quads[:, ON_QUAD[:4]]
    below = np.column_stack([np.full(len(triangles), top), triangles])
    parts = tuple((cell, own) for cell, own in ((PYRAMID, over), (TETRAHEDRON, below)) if len(own))
    found = {QUADRILATERAL.name: np.zeros((0, 0), dtype=np.int64), TRIANGLE.name: np.zeros((0, 0), dtype=np.int64)}
    for (cell, _), dofs in zip(parts, number(Complex(parts), degree)[0]):
        found[cell.faces[0].cell.name] = dofs[:, face_functions(bernstein(cell, degree), 0)[1]]
    used = np.unique(np.concatenate([f.ravel() for f in found.values()]))
    on_quads, on_triangles = (np.searchsorted(used, f) for f in found.values())
    return on_quads, on_triangles, len(used)


def bezier_skin(
    vertices: Array, quads: Index, triangles: Index, degree: int, warp: Map | None = None,
    face: tuple[Index, Index] | None = None, names: tuple[str, ...] = ("skin",), place: Map | None = None,
) -> Shell:
    """Shell of a closed mesh with C0 Bernstein functions.

    Parameters
    ----------
    warp : applied to the control points of the straight mesh.
    place : instead, a map that the surface interpolates at the domain points of its functions.
    """
    on_quads, on_triangles, n = base_functions(quads, triangles, degree)
    points = np.zeros((n, 3))
    blocks, corners, faces = [], [], []
    kinds = ((QUADRILATERAL, quads, on_quads), (TRIANGLE, triangles, on_triangles))
    for k, (cell, own, dofs) in enumerate(kinds):
        if not len(own):
            continue
        basis = bernstein(cell, degree)
        net = elevation(bernstein(cell, 1), basis.degree) @ vertices[own]
        if place is not None:
            from iga.bernstein import greville as domain_points
            from iga.bernstein import lagrange_to_bernstein

            at = domain_points(basis)
            straight = basis.tabulate(at, 0)[0] @ net
            net = lagrange_to_bernstein(basis, at) @ place(straight.reshape(-1, 3)).reshape(straight.shape)
        points[dofs] = net
        blocks += [b for b, _ in blocks_of(basis, dofs, csr_array(np.eye(n)))]
        corners.append(own)
        faces.append(np.zeros(len(own), dtype=np.int64) if face is None else face[k])
    moved = points if warp is None else warp(points)
    spots = vertices if warp is None and place is None else (warp or place)(vertices)  # type: ignore[misc]
    return Shell(Space(tuple(blocks), n), moved, tuple(corners), spots, tuple(faces), names)


def box_mesh(n: int, split: tuple[bool, ...]) -> tuple[Array, Index, Index, Index, Index]:
    """Surface of the unit cube: vertices, quadrilaterals, triangles, and the faces (x0, x1, y0, ..) they lie on.

    Parameters
    ----------
    split : for each face, whether its quadrilaterals are split into triangles.
    """
    index: dict[tuple[int, ...], int] = {}
    quads, triangles, on_quad, on_triangle = [], [], [], []
    for f in range(6):
        axis, high = f // 2, f % 2
        u, v = ((axis + 1) % 3, (axis + 2) % 3) if high else ((axis + 2) % 3, (axis + 1) % 3)
        for i in range(n):
            for j in range(n):
                corner = []
                for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
                    spot = [0, 0, 0]
                    spot[axis], spot[u], spot[v] = high * n, i + a, j + b
                    corner.append(index.setdefault(tuple(spot), len(index)))
                if split[f]:
                    triangles += [[corner[0], corner[2], corner[3]], [corner[0], corner[3], corner[1]]]
                    on_triangle += [f, f]
                else:
                    quads.append(corner)
                    on_quad.append(f)
    return (
        np.array(list(index), dtype=float) / n, np.array(quads, dtype=np.int64).reshape(-1, 4),
        np.array(triangles, dtype=np.int64).reshape(-1, 3), np.array(on_quad, dtype=np.int64),
        np.array(on_triangle, dtype=np.int64),
    )


SIDES = ("x0", "x1", "y0", "y1", "z0", "z1")


def spline_box(n: int, degree: int, split: tuple[bool, ...] = (False,) * 6, warp: Map | None = None) -> Shell:
    """Unit cube whose quadrilateral faces are open B-splines on n x n intervals; triangles carry C0 functions."""
    vertices, quads, triangles, on_quad, on_triangle = box_mesh(n, split)
    dofs_quad, dofs_triangle, count = base_functions(quads, triangles, degree)
    breaks = np.linspace(0.0, 1.0, n + 1)
    operators, kind = bezier_operators(degree, breaks)
    spots = greville(degree, breaks)
    index: dict[tuple[float, ...], int] = {}
    rows = lil_array((count, 6 * (n + degree) ** 2 + count))
    known = np.zeros(count, dtype=bool)
    seen = dict.fromkeys(range(6), 0)
    for e, f in enumerate(on_quad.tolist()):
        axis, high = f // 2, f % 2
        u, v = ((axis + 1) % 3, (axis + 2) % 3) if high else ((axis + 2) % 3, (axis + 1) % 3)
        i, j = divmod(seen[f], n)
        seen[f] += 1
        C = np.kron(operators[kind[i]], operators[kind[j]])
        columns = []
        for a in range(i, i + degree + 1):
            for b in range(j, j + degree + 1):
                spot = np.zeros(3)
                spot[axis], spot[u], spot[v] = high, spots[a], spots[b]
                columns.append(index.setdefault(tuple(np.round(spot, 9)), len(index)))
        for b, row in enumerate(dofs_quad[e].tolist()):
            if not known[row]:
                known[row] = True
                rows[row, columns] = C[:, b]
    points = np.array(list(index)).reshape(-1, 3)
    basis = bernstein(TRIANGLE, degree)
    rest = np.flatnonzero(~known)
    for k, row in enumerate(rest.tolist()):
        rows[row, len(index) + k] = 1.0
    extra = np.zeros((count, 3))
    if len(triangles):
        extra[dofs_triangle] = elevation(bernstein(TRIANGLE, 1), basis.degree) @ vertices[triangles]
    points = np.concatenate([points, extra[rest]])
    M = csr_array(csr_array(rows)[:, : len(points)])
    blocks, corners, face = [], [], []
    for cell, own, dofs, on in (
        (QUADRILATERAL, quads, dofs_quad, on_quad), (TRIANGLE, triangles, dofs_triangle, on_triangle),
    ):
        if len(own):
            for block, elements in blocks_of(bernstein(cell, degree), dofs, M):
                blocks.append(block)
                corners.append(own[elements])
                face.append(on[elements])
    moved = points if warp is None else warp(points)
    corner_of = np.zeros((len(vertices), 3))
    for block, own in zip(blocks, corners):
        from iga.bernstein import functions_at
        from iga.block import bezier_coefficients

        net = bezier_coefficients(block, moved)
        corner_of[own] = net[:, functions_at(block.basis, block.basis.cell.vertices)]
    return Shell(Space(tuple(blocks), len(points)), moved, tuple(corners), corner_of, tuple(face), SIDES)


def bend(points: Array) -> Array:
    """A bent and twisted image of the cube's surroundings."""
    x, y, z = points.T
    angle = 0.6 * (x - 0.5)
    radius = 2.0 + z + 0.15 * np.sin(2.0 * y)
    return np.column_stack([radius * np.sin(angle), y + 0.1 * x * z, radius * np.cos(angle)])


def ball(n: int, degree: int, split: tuple[bool, ...] = (False,) * 6) -> Shell:
    """Unit sphere, interpolated at the domain points of a cube's surface mesh."""
    vertices, quads, triangles, on_quad, on_triangle = box_mesh(n, split)

    def to_sphere(x: Array) -> Array:
        angle = np.tan(np.pi / 4 * (2.0 * x - 1.0))
        return np.asarray(angle / np.linalg.norm(angle, axis=1, keepdims=True))

    return bezier_skin(vertices, quads, triangles, degree, place=to_sphere, face=(on_quad, on_triangle), names=SIDES)


def jumps_of(domain: Domain) -> tuple[float, set[tuple[str, str]], int]:
    """Largest jump across facets between two cells, the pairs of cells that share one, and how many facets have one."""
    mesh = mesh_of(domain)
    found = jumps(domain, mesh)
    total = sum(len(cell.faces) * len(own) for cell, own in mesh.parts)
    alone = total - 2 * sum(jump.facets for jump in found)
    return max(max(jump.field, jump.map) for jump in found), {jump.cells for jump in found}, alone
