r"""Spline layers under a skin: hexahedra below quadrilaterals, wedges below triangles, and the rest filled inside.

With the skin's functions N_k(xi, eta) and open uniform B-splines B_j(zeta) of the same degree d, j = 0 .. n,

    x(xi, eta, zeta) = sum_kj P_kj N_k(xi, eta) B_j(zeta),      zeta = 1 on the skin, zeta = 0 on the innermost layer,

n + 1 layers of control points, n >= d, and n - d + 1 elements across (Song and Cohen 2019, Section 4). The innermost
layer has the skin's functions and topology again; pyramids stand on its quadrilaterals and tetrahedra fill the rest
(`volume`), sharing its functions.

Paths inwards are straight. A vertex v moves along w, where n_f . w = -1 for the normals n_f of the elements around it
in the sense of least squares: an offset of all of them, also at edges and corners. It can go until the ball around
v + D w with radius D, which touches all of them, meets another point v + q of the skin,

    |q - D w|^2 = D^2,

an estimate of the distance to the mid-structure; the layers take the share omega of it, less where neighbours would
differ too much. The displacement is linear on elements, the control points follow by least squares, and the layers
between lie at the Greville abscissae in proportion.

Axis letters: e element, v vertex, k function of the skin, j layer, s element across, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import lsqr

from geometry.hybrid.filling import LIMIT
from geometry.hybrid.flat_corners import tangents_of
from geometry.hybrid.shell import Shell
from geometry.hybrid.subdividing import refined
from geometry.hybrid.volume import assemble, complete, degree_of, fill_skin
from geometry.knots import extraction
from iga.bernstein import bernstein, elevation
from iga.block import Block, Extraction, Patterns, dense_extraction
from iga.cells import HEXAHEDRON, QUADRILATERAL, WEDGE
from iga.certificate import certify
from iga.domain import Domain, Facets, Provenance, Space, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SLOPE = 0.3
"""Largest difference of depth between neighbours over their distance."""
_TRIES = 4
LONGEST = 2.0
"""Largest |w|: sharp edges move less than a full offset."""


def inner_shell(shell: Shell, omega: float) -> tuple[Shell, Array]:
    """Skin moved inwards.

    Parameters
    ----------
    omega : share of the way to the mid-structure, in (0, 1).

    Returns
    -------
    The shell, and the displacement of each function's control point (n, 3).
    """
    w = directions(shell)
    depth = omega * _free(shell.vertices, w, _targets(shell), _edges(shell))
    shift = depth[:, None] * w
    rows, values = [], []
    for block, corners in zip(shell.space.blocks, shell.corners):
        cell = block.basis.cell
        rows.append(block)
        values.append(elevation(bernstein(cell, 1), block.basis.degree) @ shift[corners])
    D = _fit(rows, values, shell.space.n)
    return replace(shell, points=shell.points + D, vertices=shell.vertices + shift), D


def directions(shell: Shell) -> Array:
    """Direction w (v, 3) of each vertex."""
    skin = tangents_of(shell)
    count = len(shell.vertices)
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(A, skin.vertex, skin.normal[:, :, None] * skin.normal[:, None, :])
    np.add.at(b, skin.vertex, -skin.normal)
    times = np.bincount(skin.vertex, minlength=count)[:, None]
    mean = b / times
    ridge = 1e-3  # where all normals are equal to within a degree or two, w is their mean
    w = np.linalg.solve(A / times[:, :, None] + ridge * np.eye(3), ((1.0 + ridge) * mean)[:, :, None])[:, :, 0]
    length = np.linalg.norm(w, axis=1, keepdims=True)
    return np.asarray(w * np.minimum(1.0, LONGEST / length))


def _targets(shell: Shell) -> Array:
    """Points that the layers keep away from: vertices, and middles of edges and elements."""
    found = [shell.vertices]
    for block, corners in zip(shell.space.blocks, shell.corners):
        found += [shell.vertices[corners].mean(axis=1)]
        ends = corners[:, block.basis.cell.edges].reshape(-1, 2)
        found += [shell.vertices[np.unique(np.sort(ends, axis=1), axis=0)].mean(axis=1)]
    return np.concatenate(found)


def _edges(shell: Shell) -> Index:
    ends = [c[:, b.basis.cell.edges].reshape(-1, 2) for b, c in zip(shell.space.blocks, shell.corners)]
    return np.unique(np.sort(np.concatenate(ends), axis=1), axis=0)


def _free(vertices: Array, w: Array, targets: Array, edges: Index) -> Array:
    """How far each vertex can go along w (v,), with bounded slope."""
    depth = _meet(vertices, w, targets)
    length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    for _ in range(len(vertices)):
        before = depth.copy()
        np.minimum.at(depth, edges[:, 0], before[edges[:, 1]] + SLOPE * length)
        np.minimum.at(depth, edges[:, 1], before[edges[:, 0]] + SLOPE * length)
        if np.array_equal(before, depth):
            break
    return depth


@numba.njit(cache=True)
def _meet(vertices, w, targets):  # type: ignore[no-untyped-def]
    """Smallest D > 0 with |q - D w| = D over targets v + q in front of each vertex."""
    result = np.full(len(vertices), np.inf)
    for v in range(len(vertices)):
        a = w[v, 0] ** 2 + w[v, 1] ** 2 + w[v, 2] ** 2 - 1.0
        for t in range(len(targets)):
            b, c = 0.0, 0.0
            for k in range(3):
                q = targets[t, k] - vertices[v, k]
                b += q * w[v, k]
                c += q * q
            # Points beside the vertex, to within the error of its normals, are no obstacle.
            if b <= 0.05 * np.sqrt(c) or b * b <= 1.02 * a * c:
                continue
            if abs(a) < 1e-9:
                D = c / (2.0 * b)
            else:
                D = c / (b + np.sqrt(b * b - a * c))
            result[v] = min(result[v], D)
    return result


def _fit(blocks: list[Block], values: list[Array], n: int) -> Array:
    """Coefficients (n, 3) whose Bernstein coefficients on the elements are nearest to the given ones (e, b, 3)."""
    if all(block.extraction is None for block in blocks):
        result = np.zeros((n, 3))
        for block, own in zip(blocks, values):
            result[block.dofs] = own
        return result
    rows, columns, entries, right, start = [], [], [], [], 0
    for block, own in zip(blocks, values):
        C = dense_extraction(block, slice(None))
        C = np.broadcast_to(np.eye(block.n), (block.elements, block.n, block.n)) if C is None else C
        e, i, b = np.nonzero(np.abs(C) > 1e-13)
        rows.append(start + e * C.shape[2] + b)
        columns.append(block.dofs[e, i])
        entries.append(C[e, i, b])
        right.append(own.reshape(-1, 3))
        start += C.shape[0] * C.shape[2]
    at = (np.concatenate(rows), np.concatenate(columns))
    A = csr_array(coo_array((np.concatenate(entries), at), shape=(start, n)).tocsr())
    target = np.concatenate(right)
    return np.stack([lsqr(A, target[:, c], atol=1e-12, btol=1e-12, iter_lim=2000)[0] for c in range(3)], axis=1)


def with_layers(inside: Domain, shell: Shell, displacement: Array, n: int, vertices: int) -> Domain:
    """Put layers between a shell and a volume under its inner copy.

    Parameters
    ----------
    inside : the volume; its first functions are those of the inner shell, the same as the shell's.
    displacement : (k, 3) from the shell's control points to those of the inner shell.
    n : layers of control points less one.
    vertices : number of vertices of the volume's mesh; the first are those of the shell.
    """
    degree = shell.space.blocks[0].basis.degree[0]
    spans = n - degree + 1
    knots = np.concatenate([np.zeros(degree), np.linspace(0.0, 1.0, spans + 1), np.ones(degree)])
    line, first = extraction(knots, degree)
    greville = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree).mean(axis=1)
    count = shell.space.n
    # Functions of layer 0 are the first of the volume's; the others follow after all of these.
    number = np.concatenate([np.arange(count)[None], inside.space.n + np.arange(n * count).reshape(n, count)])
    points = [inside.points] + [shell.points + (1.0 - g) * displacement for g in greville[1:]]
    level = np.concatenate([
        np.arange(len(shell.vertices))[None],
        vertices + np.arange(spans * len(shell.vertices)).reshape(spans, len(shell.vertices)),
    ])
    blocks, arrays = list(inside.space.blocks), dict(inside.provenance.arrays)
    named: dict[str, list[Facets]] = {}
    for block, corners, face in zip(shell.space.blocks, shell.corners, shell.face):
        hexes = block.basis.cell is QUADRILATERAL
        cell = HEXAHEDRON if hexes else WEDGE
        elements = block.elements
        span = np.repeat(np.arange(spans), elements)
        made = _product(block, line, spans)
        functions = number[first[:, None] + np.arange(degree + 1)]  # (s, j, k)
        dofs = np.moveaxis(functions[:, :, block.dofs], 1, 3).reshape(spans * elements, -1)  # (s, e, i, j)
        basis = bernstein(cell, degree)
        below = np.tile(corners, (spans, 1))
        ends = np.stack([level[span[:, None], below], level[span[:, None] + 1, below]], axis=2)
        arrays[f"corners{len(blocks)}"] = ends.reshape(spans * elements, -1)
        outer = (spans - 1) * elements
        for f, name in enumerate(shell.names):
            mine = np.flatnonzero(face == f)
            if len(mine):
                named.setdefault(name, []).append(Facets(len(blocks), 5 if hexes else 1, outer + mine))
        blocks.append(Block(basis, dofs, made))
    origin = inside.provenance
    boundaries = {name: _merged(named[name]) for name in dict.fromkeys(shell.names) if name in named}
    return Domain(
        Space(tuple(blocks), inside.space.n + n * count), np.concatenate(points), boundaries,
        provenance=Provenance(origin.source, origin.input, origin.parameters, arrays),
        report={**inside.report, "layers": n, "elements_across": spans},
    )


def _product(block: Block, line: Array, spans: int) -> Extraction:
    """Extraction of layers: that of the skin times that of the line, elements of one span together."""
    plain = np.abs(line - np.eye(line.shape[1])).max() < 1e-15
    if block.extraction is None and plain:
        return None
    if isinstance(block.extraction, Patterns):
        C, pattern = block.extraction.C, block.extraction.pattern
    else:
        dense = dense_extraction(block, slice(None))
        C, pattern = (np.eye(block.n)[None], np.zeros(block.elements, dtype=np.int64)) if dense is None else (
            dense, np.arange(block.elements)
        )
    both = np.einsum("kib,sjc->skijbc", C, line).reshape(spans * len(C), C.shape[1] * line.shape[1], -1)
    which = (np.arange(spans)[:, None] * len(C) + pattern).ravel()
    return Patterns(np.ascontiguousarray(both), which)


def _merged(facets: list[Facets]) -> tuple[Facets, ...]:
    found: dict[tuple[int, int], list[Index]] = {}
    for f in facets:
        found.setdefault((f.block, f.face), []).append(f.elements)
    return tuple(Facets(b, k, np.sort(np.concatenate(e))) for (b, k), e in sorted(found.items()))


def complete_with_layers(
    shell: Shell, n: int, omega: float, provenance: Provenance | None = None, limit: float = LIMIT,
    shown: Progress = QUIET, levels: int = 0,
) -> Domain:
    """Volume of layers, pyramids and tetrahedra under a shell, or without layers where they cannot be made valid.

    Parameters
    ----------
    n : layers of control points less one, at least the degree.
    omega : share of the way to the mid-structure; halved where that is too much.
    limit : seconds for the mesh generator.
    levels : how often the layers are cut with the skin, after tracing.

    Raises
    ------
    InputError : n is too small for the degree, or no volume can be made at all.
    """
    degree = degree_of(shell)
    if n < degree:
        raise InputError(f"layers={n}: splines of degree {degree} need at least {degree} layers, or none")
    reason = ""
    for _ in range(_TRIES):
        inner, displacement = inner_shell(shell, omega)
        outer = shell
        for _ in range(levels):
            inner = refined(inner, displacement)[0]
            outer, displacement = refined(outer, displacement)
        try:
            filled = fill_skin(inner, limit)
            inside = assemble(inner, filled.mesh, filled.vertices, degree, 12, provenance, {
                "lowest_pyramid": float(filled.heights.min(initial=np.inf)), "cut_vertices": filled.cut,
            }, shown)
            domain = with_layers(inside, outer, displacement, n, filled.mesh.vertices)
            left = int((certify(domain, 1e9).verdict <= 0).sum())
            if not left:
                return with_report(domain, omega=omega, not_certified=0)
            reason = f"{left} elements are not certified at omega={omega:g}"
        except InputError as error:
            reason = f"{error} (omega={omega:g})"
        shown.say(f"layers: {reason}")
        omega /= 2.0
    for _ in range(levels):
        shell = refined(shell, shell.points)[0]
    return with_report(complete(shell, provenance, limit, shown=shown), layers_dropped=reason)
