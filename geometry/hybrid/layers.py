r"""Spline layers under a skin: hexahedra below quadrilaterals, wedges below triangles, and the rest filled inside.

With the skin's functions N_k(xi, eta) and open uniform B-splines B_j(zeta) of the same degree d, j = 0 .. n,

    x(xi, eta, zeta) = sum_kj P_kj N_k(xi, eta) B_j(zeta),      zeta = 1 on the skin, zeta = 0 on the innermost layer,

n + 1 layers of control points, n >= d, and n - d + 1 elements across (Song and Cohen 2019, Section 4). The innermost
layer has the skin's functions and topology again; pyramids stand on its quadrilaterals and tetrahedra fill the rest
(`volume`), sharing its functions.

**Paths.** The vertices are traced along a blend of harmonic gradient and distance (`field`), and the control points of
layer j lie at the share omega (1 - g_j) of the path, g_j the Greville abscissae. With ``paths="straight"``, and where
traced layers are not valid, paths are straight: a vertex v moves along w, where n_f . w = -1 for the normals n_f of the
elements around it in the sense of least squares, an offset of all of them, also at edges and corners. It can go until
the ball around v + D w with radius D, which touches all of them, meets another point v + q of the skin,

    |q - D w|^2 = D^2,

an estimate of the distance to the mid-structure.

**Adjustment, separation, relaxation, sealing** (Section 4.2). Neighbouring faces share the functions and the vertices
of their common edges, so a layer has no gaps along trimming curves by construction; what the least squares do is to
find control points whose surface moves, on each element, as nearly as possible linearly between its vertices. Layers
are kept apart by the size of elements: depths of neighbours differ by ``SLOPE`` times their distance at most, which
scales with the mesh (the paper's fixed epsilon does not, which is what it calls wrinkles). Relaxation moves each
vertex's shift by ``beta`` towards the mean of its neighbours'.

Axis letters: e element, v vertex, k function of the skin, j layer, s element across, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import lsqr

from geometry.hybrid.field import Field, field_under, paths
from geometry.hybrid.filling import LIMIT
from geometry.hybrid.flat_corners import tangents_of
from geometry.hybrid.shell import Shell
from geometry.hybrid.subdividing import refined
from geometry.hybrid.volume import assemble, complete, degree_of, fill_skin
from geometry.knots import extraction
from iga.bernstein import bernstein, elevation, functions_at
from iga.block import Block, Extraction, Patterns, bezier_coefficients, dense_extraction
from iga.cells import HEXAHEDRON, QUADRILATERAL, WEDGE
from iga.certificate import certify
from iga.domain import Domain, Facets, Provenance, Space, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BETA = 0.2
"""Relaxation: share of a vertex's shift that the mean of its neighbours' replaces."""
SLOPE = 0.3
"""Largest difference of depth between neighbours over their distance."""
_TRIES = 3
LOWER = 0.7
"""Factor of the depth around elements that are not certified."""
STUBBORN = 0.4
"""Factor below which a vertex leaves its path for the straight one."""
LONGEST = 2.0
"""Largest |w|: sharp edges move less than a full offset."""


def inner_shell(shell: Shell, omega: float) -> tuple[Shell, Array]:
    """Skin moved inwards along straight paths.

    Parameters
    ----------
    omega : share of the way to the mid-structure, in (0, 1).

    Returns
    -------
    The shell, and the displacement of each function's control point (n, 3).
    """
    w = directions(shell)
    depth = omega * _bounded(shell.vertices, _meet(shell.vertices, w, _targets(shell)), _edges(shell))
    D = _displacement(shell, depth[:, None] * w)
    return moved(shell, D), D


@dataclass(frozen=True, eq=False)
class Ways:
    """Paths inwards from the vertices of a shell.

    Attributes
    ----------
    places : (v, s, 3) points on the paths, equally spaced by length.
    lengths : (v,)
    straight : (v, 3) displacement that `directions` and the largest ball allow.
    edges : (k, 2) vertices that are joined.
    """

    places: Array
    lengths: Array
    straight: Array
    edges: Index


def ways_of(shell: Shell, field: Field | None) -> Ways:
    """Paths along a field, or straight ones without."""
    w = directions(shell)
    edges = _edges(shell)
    straight = _bounded(shell.vertices, _meet(shell.vertices, w, _targets(shell)), edges)[:, None] * w
    if field is None:
        places = np.stack([shell.vertices, shell.vertices + straight], axis=1)
        return Ways(places, np.linalg.norm(straight, axis=1), straight, edges)
    unit = w / np.linalg.norm(w, axis=1, keepdims=True)
    return Ways(*paths(field, np.arange(len(w)), unit), straight, edges)


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
    rows = np.arange(len(shell.vertices))
    depth = _bounded(shell.vertices, scale * omega * ways.lengths, ways.edges)
    good = _inward(shell, ways, depth) & (scale > STUBBORN)
    reach = np.linalg.norm(ways.straight, axis=1)
    plain = np.minimum(1.0, np.minimum(depth, scale * omega * reach) / (reach + 1e-300))[:, None] * ways.straight
    degree = np.bincount(ways.edges.ravel(), minlength=len(rows))[:, None]
    relax = beta * (good & (np.asarray(scale) == 1.0))[:, None]  # vertices in difficulty stay on their way
    last = ways.places.shape[1] - 1
    result = []
    for share in shares:
        at = share * depth / (ways.lengths + 1e-300) * last
        k = np.clip(at.astype(np.int64), 0, last - 1)
        rest = (at - k)[:, None]
        shift = (1.0 - rest) * ways.places[rows, k] + rest * ways.places[rows, k + 1] - shell.vertices
        shift = np.where(good[:, None], shift, share * plain)
        mean = np.zeros_like(shift)
        np.add.at(mean, ways.edges[:, 0], shift[ways.edges[:, 1]])
        np.add.at(mean, ways.edges[:, 1], shift[ways.edges[:, 0]])
        result.append(_displacement(shell, (1.0 - relax) * shift + relax * mean / degree))
    return np.stack(result)


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
        verdict = certify(with_layers(innermost, shell, D, len(shell.vertices)), 1e9).verdict
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


def _inward(shell: Shell, ways: Ways, depth: Array) -> NDArray[np.bool_]:
    """Which paths (v,) lead inwards from all elements around their vertices, at least half as well as w does."""
    skin = tangents_of(shell)
    count = len(shell.vertices)
    places, lengths = ways.places, ways.lengths
    longest = np.linalg.norm(directions(shell), axis=1)[skin.vertex]
    at = np.clip(np.rint(depth / (lengths + 1e-300) * (places.shape[1] - 1)).astype(np.int64), 1, places.shape[1] - 1)
    good = lengths > 0.0
    for part in (1, 2):  # at half the depth, and at the whole
        spot = places[np.arange(count), np.maximum(at * part // 2, 1)] - shell.vertices
        spot = spot / (np.linalg.norm(spot, axis=1, keepdims=True) + 1e-300)
        inward = -np.einsum("ec,ec->e", skin.normal, spot[skin.vertex]) * longest
        least = np.full(count, np.inf)
        np.minimum.at(least, skin.vertex, inward)
        good &= least > 0.5
    return np.asarray(good)


def moved(shell: Shell, displacement: Array) -> Shell:
    """Shell with moved control points."""
    points = shell.points + displacement
    vertices = shell.vertices.copy()
    for block, own in zip(shell.space.blocks, shell.corners):
        at = functions_at(block.basis, block.basis.cell.vertices)
        vertices[own] = bezier_coefficients(block, points)[:, at]
    return replace(shell, points=points, vertices=vertices)


def _displacement(shell: Shell, shift: Array) -> Array:
    """Displacement of control points (n, 3) that is nearest to a linear one on each element between shifts (v, 3)."""
    values = [
        elevation(bernstein(block.basis.cell, 1), block.basis.degree) @ shift[corners]
        for block, corners in zip(shell.space.blocks, shell.corners)
    ]
    return _fit(list(shell.space.blocks), values, shell.space.n)


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


def _bounded(vertices: Array, depth: Array, edges: Index) -> Array:
    """Depths (v,) lowered until those of neighbours differ by a share of their distance at most."""
    depth = depth.copy()
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
        D, scale, left = valid_layers(shell, found[how], share, n, beta)
        if left:
            reason = f"{left} elements of layers are not certified with {how} paths at omega={share:g}"
            shown.say(f"layers: {reason}")
            continue
        outer = shell
        for _ in range(levels):
            outer, fine = refined(outer, np.moveaxis(D, 0, 1).reshape(outer.space.n, -1))
            D = np.moveaxis(fine.reshape(outer.space.n, n + 1, 3), 1, 0)
        inner = moved(outer, D[0])
        try:
            filled = fill_skin(inner, limit)
            inside = assemble(inner, filled.mesh, filled.vertices, degree, 12, provenance, {
                "lowest_pyramid": float(filled.heights.min(initial=np.inf)), "cut_vertices": filled.cut,
            }, shown)
            domain = with_layers(inside, outer, D, filled.mesh.vertices)
            left = int((certify(domain, 1e9).verdict <= 0).sum())
            if not left:
                lowered = int((scale < 1.0).sum())
                return with_report(domain, omega=share, paths=how, lowered=lowered, not_certified=0, **told)
            reason = f"{left} elements are not certified with {how} paths at omega={share:g}"
        except InputError as error:
            reason = f"{error} ({how} paths, omega={share:g})"
        shown.say(f"layers: {reason}")
    for _ in range(levels):
        shell = refined(shell, shell.points)[0]
    return with_report(complete(shell, provenance, limit, shown=shown), layers_dropped=reason)
