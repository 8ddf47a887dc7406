r"""Spline layers under a skin: hexahedra below quadrilaterals, wedges below triangles, and the rest filled inside.

With the skin's functions N_k(xi, eta) and open uniform B-splines B_j(zeta) of the same degree d, j = 0 .. n,

    x(xi, eta, zeta) = sum_kj P_kj N_k(xi, eta) B_j(zeta),      zeta = 1 on the skin, zeta = 0 on the innermost layer,

n + 1 layers of control points, n >= d, and n - d + 1 elements across (Song and Cohen 2019, Section 4). The innermost
layer has the skin's functions and topology again; pyramids stand on its quadrilaterals and tetrahedra fill the rest
(`volume`), sharing its functions.

**Paths.** The vertices are traced along a blend of harmonic gradient and distance (`field`), and the control points of
layer j lie at the share omega (1 - g_j) of the path, g_j the Greville abscissae. With ``paths="straight"``, and where
traced layers are not valid, paths are straight (`ways`).

**Adjustment, separation, relaxation, sealing** (Section 4.2). Neighbouring faces share the functions and the vertices
of their common edges, so a layer has no gaps along trimming curves by construction; what the least squares do is to
find control points whose surface moves, on each element, as nearly as possible linearly between its vertices, and
under an HB-rep such that each face's B-splines, without their revision, follow the curves: what the trim functions then
add is small. Between C0 functions bulges of elements shrink with the layer (`affine`). Layers are kept apart by the
size of elements: depths of neighbours differ by `SLOPE` times their distance at most, which scales with the mesh (the
paper's fixed epsilon does not, which is what it calls wrinkles). Relaxation moves each vertex's shift ``SWEEPS`` times
by ``beta`` towards the affine fit of its neighbours'.

Axis letters: e element, v vertex, k function of the skin, j layer, s element across, c component.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from geometry.hybrid.affine import relaxed, spread
from geometry.hybrid.fairing import fair_displacement
from geometry.hybrid.field import field_under
from geometry.hybrid.filling import LIMIT
from geometry.hybrid.shell import Shell
from geometry.hybrid.subdividing import refined
from geometry.hybrid.volume import assemble, complete, degree_of, fill_skin
from geometry.hybrid.ways import Ways, bounded, inward, ways_of
from geometry.knots import extraction
from iga.bernstein import bernstein, functions_at
from iga.block import Block, Extraction, Patterns, bezier_coefficients, distinct_extractions
from iga.cells import HEXAHEDRON, QUADRILATERAL, WEDGE
from iga.certificate import SIGN_ALONE, certify
from iga.domain import Domain, Provenance, Space, grouped_facets, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BETA, SWEEPS = 0.5, 4
"""Relaxation: share of a vertex's shift that the affine fit of its neighbours' replaces, and how often."""
_TRIES = 3
"""Shares of the way that are tried on each kind of path, each half of the one before."""
LOWER = 0.7
"""Factor of the depth around elements that are not certified."""
STUBBORN = 0.4
"""Factor below which a vertex leaves its path for the straight one."""


def traced(
    shell: Shell, ways: Ways, omega: float, shares: Array, beta: float = BETA, scale: Array | float = 1.0
) -> Array:
    """Displacements of control points along paths.

    Parameters
    ----------
    omega : share of the paths, in (0, 1).
    shares : (j,) places of the layers in proportion of that, 0 on the skin and 1 on the innermost layer.
    beta : relaxation.
    scale : (v,) factors of the depth.

    Returns
    -------
    (j, n, 3)
    """
    shifts = _shifts(shell, ways, omega, shares, beta, scale)
    if _smooth(shell):
        D = fair_displacement(shell, np.hstack(shifts))
        return np.moveaxis(D.reshape(shell.space.n, -1, 3), 1, 0)
    lowered = bool((np.asarray(scale) < 1.0).any())
    result = []
    for shift, whole in zip(shifts, _shifts(shell, ways, omega, shares, beta, 1.0) if lowered else shifts):
        length, most = (np.linalg.norm(some, axis=1) for some in (shift, whole))
        result.append(spread(shell, shift, ways.creases, whole, np.minimum(1.0, length / (most + 1e-300))))
    return np.array(result)


def _shifts(
    shell: Shell, ways: Ways, omega: float, shares: Array, beta: float, scale: Array | float
) -> list[Array]:
    """Shifts (v, 3) of the vertices for each layer."""
    rows = np.arange(len(shell.vertices))
    depth = bounded(shell.vertices, scale * omega * ways.lengths, ways.edges)
    good = inward(shell, ways, depth) & (scale > STUBBORN)
    reach = np.linalg.norm(ways.straight, axis=1)
    plain = np.minimum(1.0, np.minimum(depth, scale * omega * reach) / (reach + 1e-300))[:, None] * ways.straight
    relax = beta * (good & (np.asarray(scale) == 1.0))  # vertices in difficulty stay on their way
    last = ways.places.shape[1] - 1
    result = []
    for share in shares:
        at = share * depth / (ways.lengths + 1e-300) * last
        k = np.clip(at.astype(np.int64), 0, last - 1)
        rest = (at - k)[:, None]
        shift = (1.0 - rest) * ways.places[rows, k] + rest * ways.places[rows, k + 1] - shell.vertices
        shift = np.where(good[:, None], shift, share * plain)
        shift = relaxed(shell.vertices, shift, ways.creases, relax, SWEEPS)
        if shell.adjust is not None:
            shift = _faired(shell, ways.edges, shift, scale)
        result.append(shift)
    return result


def _faired(shell: Shell, edges: Index, shift: Array, scale: Array | float) -> Array:
    """Shifts (v, 3) that are harmonic inside CAD faces, between those on their curves, times the factors of the depth.

    Functions of an HB-rep are C2 across elements, so they follow a displacement with kinks there with an error of first
    order only. Least bending of the functions (`fairing`) does not replace this: without it the innermost layer turns
    by 1.3 to 2 times as much (bent box minus another: 14 degrees for 11, 9.0 for 4.4), and depths must be lowered.
    """
    count = len(shift)
    least, most = np.full(count, len(shell.names)), np.full(count, -1)
    for corners, face in zip(shell.corners, shell.face):
        np.minimum.at(least, corners, face[:, None])
        np.maximum.at(most, corners, face[:, None])
    inside = least == most
    if not inside.any():
        return shift
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    W = coo_array((1.0 / np.linalg.norm(shell.vertices[a] - shell.vertices[b], axis=1), (a, b)), shape=(count, count))
    L = csr_array(diags_array(np.asarray(W.sum(axis=1))) - W.tocsr())
    rows = L[inside]
    found = shift.copy()
    solver = splu(csc_array(rows[:, inside]))
    found[inside] = solver.solve(-(rows[:, ~inside] @ shift[~inside]))
    return np.where(inside[:, None], np.broadcast_to(np.asarray(scale), count)[:, None] * found, shift)


def valid_layers(
    shell: Shell, ways: Ways, omega: float, n: int, beta: float = BETA, rounds: int = 12
) -> tuple[Array, Array, int]:
    """Layers without folds: depths are lowered where elements are not certified.

    Returns
    -------
    displacements (n + 1, k, 3), the factors of the depth (v,), and how many elements are still not certified.
    """
    degree = degree_of(shell)
    scale = np.ones(len(shell.vertices))
    for _ in range(rounds):
        D = traced(shell, ways, omega, shares_of(n, degree), beta, scale)
        innermost = Domain(Space((), shell.space.n), shell.points + D[0])
        verdict = certify(with_layers(innermost, shell, D, len(shell.vertices)), SIGN_ALONE).verdict
        left = np.flatnonzero(verdict <= 0)
        if not len(left):
            break
        at = 0
        for block, own in zip(shell.space.blocks, shell.corners):
            count = (n - degree + 1) * block.elements
            mine = left[(left >= at) & (left < at + count)] - at
            scale[np.unique(own[mine % block.elements])] *= LOWER
            at += count
    return D, scale, len(left)


def moved(shell: Shell, displacement: Array) -> Shell:
    """Shell with moved control points."""
    points = shell.points + displacement
    vertices = shell.vertices.copy()
    for block, own in zip(shell.space.blocks, shell.corners):
        at = functions_at(block.basis, block.basis.cell.vertices)
        vertices[own] = bezier_coefficients(block, points)[:, at]
    return replace(shell, points=points, vertices=vertices)


def _smooth(shell: Shell) -> bool:
    return any(block.extraction is not None for block in shell.space.blocks)


def with_layers(inside: Domain, shell: Shell, displacements: Array, vertices: int) -> Domain:
    """Put layers between a shell and a volume under its inner copy.

    Parameters
    ----------
    inside : the volume; its first functions are those of the inner shell, the same as the shell's.
    displacements : (n + 1, k, 3) from the shell's control points to those of each layer, the innermost first; the last
        is zero.
    vertices : number of vertices of the volume's mesh; the first are those of the shell.
    """
    degree = shell.space.blocks[0].basis.degree[0]
    n = len(displacements) - 1
    spans = n - degree + 1
    line, first = extraction(_knots(n, degree), degree)
    count = shell.space.n
    # Functions of layer 0 are the first of the volume's; the others follow after all of these.
    number = np.concatenate([np.arange(count)[None], inside.space.n + np.arange(n * count).reshape(n, count)])
    points = [inside.points] + [shell.points + own for own in displacements[1:]]
    level = np.concatenate([
        np.arange(len(shell.vertices))[None],
        vertices + np.arange(spans * len(shell.vertices)).reshape(spans, len(shell.vertices)),
    ])
    blocks, arrays = list(inside.space.blocks), dict(inside.provenance.arrays)
    named: dict[str, list[Index]] = {}  # rows of block, element and local face
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
                rows = [np.full(len(mine), len(blocks)), outer + mine, np.full(len(mine), 5 if hexes else 1)]
                named.setdefault(name, []).append(np.column_stack(rows))
        blocks.append(Block(basis, dofs, made))
    origin = inside.provenance
    boundaries = {
        name: grouped_facets(np.concatenate(named[name])) for name in dict.fromkeys(shell.names) if name in named
    }
    return Domain(
        Space(tuple(blocks), inside.space.n + n * count), np.concatenate(points), boundaries,
        provenance=Provenance(origin.source, origin.input, origin.parameters, arrays),
        report={**inside.report, "layers": n, "elements_across": spans},
    )


def _knots(n: int, degree: int) -> Array:
    """Open uniform knots of n + 1 splines."""
    return np.concatenate([np.zeros(degree), np.linspace(0.0, 1.0, n - degree + 2), np.ones(degree)])


def shares_of(n: int, degree: int) -> Array:
    """Depth (n + 1,) of each layer over that of the innermost: Greville abscissae, from 1 to 0."""
    spots = np.lib.stride_tricks.sliding_window_view(_knots(n, degree)[1:-1], degree).mean(axis=1)
    return np.asarray(1.0 - spots)


def _product(block: Block, line: Array, spans: int) -> Extraction:
    """Extraction of layers: that of the skin times that of the line, elements of one span together."""
    plain = np.abs(line - np.eye(line.shape[1])).max() < 1e-15
    if block.extraction is None and plain:
        return None
    C, pattern = distinct_extractions(block)
    both = np.einsum("kib,sjc->skijbc", C, line).reshape(spans * len(C), C.shape[1] * line.shape[1], -1)
    which = (np.arange(spans)[:, None] * len(C) + pattern).ravel()
    return Patterns(np.ascontiguousarray(both), which)


def complete_with_layers(
    shell: Shell, n: int, omega: float, provenance: Provenance | None = None, limit: float = LIMIT,
    shown: Progress = QUIET, levels: int = 0, way: str = "blended", middle: Array | None = None,
    beta: float = BETA,
) -> Domain:
    """Volume of layers, pyramids and tetrahedra under a shell, or without layers where they cannot be made valid.

    Parameters
    ----------
    n : layers of control points less one, at least the degree.
    omega : share of the way to the mid-structure; halved where that is too much.
    limit : seconds for the mesh generator.
    levels : how often the layers are cut with the skin, after tracing.
    way : "blended" or "straight" paths.
    middle : (m, 3) points of the mid-structure, found if None.
    beta : relaxation, from 0 to 1.

    Raises
    ------
    InputError : n is too small for the degree, or no volume can be made at all.
    """
    degree = degree_of(shell)
    if n < degree:
        raise InputError(f"layers={n}: splines of degree {degree} need at least {degree} layers, or none")
    reason, field, told = "", None, {}
    if way == "blended":
        shown.say("field")
        try:
            field = field_under(shell, limit, middle)
            told = {"mid_structure": int(field.middle.sum()), "depth": float(field.distance.max())}
        except InputError as error:
            reason = str(error)
    found = {"blended": ways_of(shell, field)} if field else {}
    found["straight"] = ways_of(shell, None)
    for how, share in [(how, omega / 2**k) for how in found for k in range(_TRIES)]:
        try:
            made = _under_layers(shell, found[how], share, n, beta, levels, provenance, limit, shown)
            return with_report(made, omega=share, paths=how, **told)
        except InputError as error:
            reason = f"{error} ({how} paths, omega={share:g})"
            shown.say(f"layers: {reason}")
    for _ in range(levels):
        shell = refined(shell, shell.points)[0]
    return with_report(complete(shell, provenance, limit, shown=shown), layers_dropped=reason)


def _under_layers(
    shell: Shell, ways: Ways, omega: float, n: int, beta: float, levels: int, provenance: Provenance | None,
    limit: float, shown: Progress,
) -> Domain:  # fmt: skip
    """Volume of layers along given ways, and what is below them; parameters as of `complete_with_layers`.

    Raises
    ------
    InputError : elements are not certified, or what is below the layers cannot be filled.
    """
    degree = degree_of(shell)
    D, scale, left = valid_layers(shell, ways, omega, n, beta)
    if left:
        raise InputError(f"{left} elements of layers are not certified")
    for _ in range(levels):
        shell, fine = refined(shell, np.moveaxis(D, 0, 1).reshape(shell.space.n, -1))
        D = np.moveaxis(fine.reshape(shell.space.n, n + 1, 3), 1, 0)
    inner = moved(shell, D[0])
    filled = fill_skin(inner, limit)
    inside = assemble(inner, filled.mesh, filled.vertices, degree, 12, provenance, {
        "lowest_pyramid": float(filled.heights.min(initial=np.inf)), "cut_vertices": filled.cut,
    }, shown)
    domain = with_layers(inside, shell, D, filled.mesh.vertices)
    left = int((certify(domain, SIGN_ALONE).verdict <= 0).sum())
    if left:
        raise InputError(f"{left} elements are not certified")
    return with_report(domain, lowered=int((scale < 1.0).sum()), not_certified=0)
