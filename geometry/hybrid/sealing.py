r"""HB-rep of a solid: B-splines on its faces, revised beside the trimming curves, and trim functions that faces share.

A skin of quadrilaterals and triangles has C0 Bernstein functions theta_b (`assembling`). The HB-rep's functions are

    N_i = sum_b M[b, i] theta_b,

where a row b of M is one of

    trim      a unit vector, if theta_b does not vanish on a trimming curve: the function T_b, shared by both faces
    A         extraction of the face's B-splines, if b belongs to a quadrilateral (the mask: trim rows come first)
    A S       the rules of `strip`, if b belongs to triangles alone

so B-splines away from the curves are untouched, the others are revised: they vanish on the curves, where trim
functions alone remain. Rows sum to one, which is the partition of unity. The coefficients are the face's B-spline
coefficients R and the control points Upsilon of the curves in space: both faces take these, so there is no gap.

The curves are compatible: their pieces lie in one knot interval and are monotone on both sides (`compatible`). Right
triangles with legs on parameter lines and rectangles in the corners between them lie along the curves (`banding`), and
general triangles where these do not fit, and between them and whole cells: where the paper cuts the remainder into
rectangles with hanging nodes, elements here meet edge to edge, because cells stand on them. On all triangles the
functions follow `strip`, which on right triangles are the rules of a single face (`hbrep`).

Each face's B-splines have the CAD surface's knots, with its continuity, and simple knots (C2) at the other lines of the
face's grid: the h-refinement of the trimmed B-rep before the HB-rep is built. Weights do not enter: a rational surface,
or one of a higher degree, is replaced by a bicubic polynomial spline within a share of the tolerance (`splining`), with
a proved bound of the distance where the degree allows, because the curves in space, that neighbours share, carry no
weights. At a pole the knot intervals become triangles (`poles`). Other triangles near a pole, and faces without a
quadrilateral, keep C0 functions of their own.

Axis letters: b Bernstein function, i function, e element, c component.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.sparse import coo_array, csr_array, vstack

from geometry.cad.brep import Face, surface_frame
from geometry.hybrid.assembling import SIDES, TURNED, Assembled, Part
from geometry.hybrid.chart import NARROWS, chart_steps, parameter_bends, parameter_steps, to_parameters, widths
from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import BICUBIC, CUBIC, INNER, fit_triangles, measure_quads, measure_triangles
from geometry.hybrid.grid import ALONG
from geometry.hybrid.hbrep import tensor_rows
from geometry.hybrid.poles import REVERSED, PolarCells, inner_row, triangle_map
from geometry.hybrid.splining import Splined, on_lines
from geometry.hybrid.strip import (
    DOMAIN_POINTS,
    OTHERS,
    crossing,
    inner_rows,
    meeting_rows,
    phi_of,
    side_rows,
    vertex_rows,
)
from geometry.patch import Patch
from iga.block import Block
from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ZERO = 1e-13
DEPENDENT = 1e-6
"""Diagonal of QR, relative to the first, below which a function beside the curves is a combination of others."""
FAINT = 3e-5
"""Size below which a function beside the curves is joined to another: integrals of its square would be rounding."""
_CORNER = np.array([int(np.flatnonzero(CUBIC.exponents[:, i] == 3)[0]) for i in range(3)])
_NEAR = np.array([
    [int(np.flatnonzero((CUBIC.exponents[:, i] == 2) & (CUBIC.exponents[:, j] == 1))[0]) for j in OTHERS[i]]
    for i in range(3)
])
"""Functions (i, 2) beside corner i on the sides to the corners that follow."""


@dataclass(frozen=True, eq=False)
class Sealed:
    """Functions of an HB-rep over the Bernstein functions of a skin.

    Attributes
    ----------
    made : the skin, its points those of the HB-rep.
    M : (b, i) rows of Bernstein functions; functions are those of the curves, then B-splines face by face, then others.
    points : (i, 3) coefficients.
    trim : number of trim functions.
    splines : for each face its bicubic surface with the knots of the grid, or None.
    numbers : for each face (r,) numbers of its B-splines' functions, -1 where they vanish, or None.
    on_curve : (b,) Bernstein functions that do not vanish on a trimming curve.
    adjust : (k, i) rows whose product with coefficients says how far a face's B-splines alone, without the mask, are
        from the trim functions' coefficients, one for each of these and each of its faces.
    """

    made: Assembled
    M: csr_array
    points: Array
    trim: int
    splines: tuple[Patch | None, ...]
    numbers: tuple[Index | None, ...]
    on_curve: Mask
    adjust: csr_array


def seal(solid: Splined, meshes: list[FaceMesh], made: Assembled) -> Sealed:
    """Functions and control points of the HB-rep on a skin."""
    brep = solid.brep
    on_curve = _on_curves(made)
    count = len(made.points)
    trim = np.flatnonzero(on_curve)
    rows, columns, values = [trim], [np.arange(len(trim))], [np.ones(len(trim))]
    done = on_curve.copy()
    points = [made.points[trim]]
    n = len(trim)
    trim_number = np.cumsum(on_curve) - 1
    adjust: list[csr_array] = []
    splines: list[Patch | None] = []
    numbers: list[Index | None] = []
    for f, mesh in enumerate(meshes):
        if f in solid.without or mesh.grid is None or not len(mesh.quads):
            splines.append(None)
            numbers.append(None)
            continue
        surface = on_lines(brep.faces[f].surface, mesh.grid.lines)
        (b, i, own), masked = _face_rows(brep.faces[f], surface, mesh, made, f, done, on_curve)
        on_quad = np.zeros(count, dtype=bool)
        for part in made.parts:
            if part.block.basis is BICUBIC:
                on_quad[part.block.dofs[part.owner == f]] = True
        place, control = _merged(b, i, own, on_quad, surface)
        keep = place[i] >= 0
        rows.append(b[keep])
        columns.append(n + place[i[keep]])
        values.append(own[keep])
        points.append(control)
        splines.append(surface)
        number = np.where(place < 0, -1, n + place)
        numbers.append(number)
        adjust.append(_adjusting(trim_number[masked[0]], number, masked, len(trim)))
        n += len(control)
    rest = np.flatnonzero(~done)
    own = _at_poles(solid, meshes, made, _matrix(rows, columns, values, count, n) @ np.concatenate(points), rest)
    rows.append(rest)
    columns.append(n + np.arange(len(rest)))
    values.append(np.ones(len(rest)))
    points.append(own)
    n += len(rest)
    M = _matrix(rows, columns, values, count, n)
    M.eliminate_zeros()
    coefficients = np.concatenate(points)
    placed = replace(made, points=M @ coefficients)
    placed = replace(placed, parts=_measured(solid, meshes, placed))
    for rows_ in adjust:
        rows_.resize(rows_.shape[0], n)
    between = vstack([csr_array((0, n)), *adjust], format="csr")
    return Sealed(placed, M, coefficients, len(trim), tuple(splines), tuple(numbers), on_curve, between)


def _adjusting(b: Index, number: Index, masked: tuple[Index, Index, Array], trim: int) -> csr_array:
    """Rows of `Sealed.adjust` of one face.

    Where B-splines vanish under the mask, trim functions take their place, and there is nothing to adjust.

    Parameters
    ----------
    b : (k,) trim functions of the entries.
    masked : their entries as `_face_rows` gives them; B-splines are ``number`` [i] here.
    """
    _, i, value = masked
    lost = np.zeros(trim)
    np.add.at(lost, b[number[i] < 0], np.abs(value[number[i] < 0]))
    keep = (number[i] >= 0) & (lost[b] <= ZERO)
    used = np.unique(b[keep])
    row = np.searchsorted(used, b[keep])
    entries = (
        np.concatenate([value[keep], -np.ones(len(used))]),
        (np.concatenate([row, np.arange(len(used))]), np.concatenate([number[i[keep]], used])),
    )
    return csr_array(coo_array(entries, shape=(len(used), 1 + max(int(number.max()), trim))).tocsr())


def _matrix(rows: list[Index], columns: list[Index], values: list[Array], b: int, n: int) -> csr_array:
    """Sparse matrix (b, n) of entries."""
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(coo_array(entries, shape=(b, n)).tocsr())


def _at_poles(solid: Splined, meshes: list[FaceMesh], made: Assembled, points: Array, rest: Index) -> Array:
    """Control points of functions of triangles' own: inner ones are fitted anew between the sides as they are now."""
    points = points.copy()
    points[rest] = made.points[rest]
    for part in made.parts:
        if part.block.basis is not CUBIC:
            continue
        for f, (face, mesh) in enumerate(zip(solid.brep.faces, meshes)):
            mine = np.flatnonzero(part.owner == f)
            dofs = part.block.dofs[mine]
            left = np.isin(dofs[:, INNER], rest)
            if left.all() or not left.any():
                continue
            corners = mesh.outward[left]
            fitted = fit_triangles(face, mesh.chart, mesh.points[corners], points[dofs[left]])
            points[dofs[left, INNER]] = fitted.control[:, INNER]
    return np.asarray(points[rest])


def _merged(b: Index, i: Index, own: Array, on_quad: Mask, surface: Patch) -> tuple[Index, Array]:
    """Function of each B-spline of a face, -1 where it vanishes, and the functions' control points.

    B-splines that act on triangles alone can be dependent there: a triangle has fewer coefficients than a cell. With
    A_rest = A_kept T, found by pivoted QR, the rest are added each to the nearest B-spline l of those on
    quadrilaterals, so that functions still sum to one, and r_kept + T (r_rest - r_l) gives the same surface.
    """
    control = surface.control.reshape(-1, 3).copy()
    size = np.zeros((2, len(control)))
    np.maximum.at(size, (on_quad[b].astype(np.int64), i), np.abs(own))
    leader = np.where(size.max(axis=0) > ZERO, np.arange(len(control)), -1)
    inner = np.flatnonzero(size[1] > ZERO)
    outer = np.flatnonzero((size[0] > ZERO) & (size[1] <= ZERO))
    if len(outer):
        mine = np.isin(i, outer)
        at, row = np.unique(b[mine], return_inverse=True)
        A = np.zeros((len(at), len(outer)))
        np.add.at(A, (row.ravel(), np.searchsorted(outer, i[mine])), own[mine])
        norm = np.linalg.norm(A, axis=0)
        R, order = qr(A / norm, mode="r", pivoting=True)
        depth = np.abs(np.diag(R))
        rank = int((depth > DEPENDENT * depth[0]).sum())
        stays = (np.arange(len(outer)) < rank) & (norm[order] > FAINT)
        kept, rest = order[stays], order[~stays]
        T = np.linalg.lstsq(A[:, kept], A[:, rest], rcond=None)[0]
        grid = np.stack(np.divmod(np.arange(len(control)), surface.control.shape[1]), axis=1)
        far = np.linalg.norm(grid[outer[rest], None] - grid[None, inner], axis=2)
        leader[outer[rest]] = inner[far.argmin(axis=1)]
        control[outer[kept]] += T @ (control[outer[rest]] - control[leader[outer[rest]]])
    leads = leader == np.arange(len(control))
    place = np.where(leader < 0, -1, (np.cumsum(leads) - 1)[leader])
    return place, control[leads]


def _on_curves(made: Assembled) -> Mask:
    """Bernstein functions that do not vanish on a trimming curve."""
    mask = np.zeros(len(made.points), dtype=bool)
    mask[made.curves[:, :2]] = True
    pairs = np.sort(made.curves[:, :2], axis=1) @ np.array([made.vertices, 1])
    for part in made.parts:
        m = part.corners.shape[1]
        for k in range(m):
            ends = np.sort(part.corners[:, [k, (k + 1) % m]], axis=1) @ np.array([made.vertices, 1])
            inner = SIDES[k, 1:3] if m == 4 else np.array([_NEAR[k, 0], _NEAR[(k + 1) % 3, 1]])
            mask[part.block.dofs[np.isin(ends, pairs)][:, inner]] = True
    return mask


def _face_rows(
    face: Face, surface: Patch, mesh: FaceMesh, made: Assembled, number: int, done: Mask, on_curve: Mask
) -> tuple[tuple[Index, Index, Array], tuple[Index, Index, Array]]:
    """Entries (b, B-spline, value) of the rows of one face that are not ``done``, which they are marked then, and of
    those on trimming curves as they are without the mask.
    """
    none = np.zeros(0, dtype=np.int64)
    found, masked = [(none, none, np.zeros(0))], [(none, none, np.zeros(0))]
    seen = np.zeros(len(done), dtype=bool)

    def add(b: Index, dofs: Index, own: Array) -> None:
        first = np.unique(b, return_index=True)[1]
        for into, known in ((found, done[b[first]]), (masked, ~on_curve[b[first]] | seen[b[first]])):
            new = first[~known]
            into.append((np.repeat(b[new], dofs.shape[1]), dofs[new].ravel(), own[new].ravel()))
        done[b[first]] = True
        seen[b[first]] = True

    knots = surface.knots
    for part in made.parts:
        mine = part.owner == number
        dofs = part.block.dofs[mine]
        if part.block.basis is BICUBIC:
            dofs = dofs[:, TURNED] if face.reversed else dofs
            A, functions = tensor_rows(knots, _snapped(knots, mesh.low), _snapped(knots, mesh.high))
            add(dofs.ravel(), np.repeat(functions, 16, axis=0), np.swapaxes(A, 1, 2).reshape(-1, 16))
        elif len(dofs):
            corners = mesh.outward
            if mesh.polar is not None:
                tips = slice(mesh.first_polar, mesh.first_polar + len(mesh.polar.side))
                b, functions, values = _polar_rows(face, surface, mesh.polar, made.points, dofs[tips])
                add(b, functions, values)
            w = widths(mesh.chart, mesh.points)[corners]
            regular = w.max(axis=1) <= NARROWS * w.min(axis=1)
            corners, dofs = corners[regular], dofs[regular]
            uv, steps, inwards, spots = _steps(
                surface, mesh, corners, made.points[dofs], part.corners[mine][regular], made
            )
            middle = uv.mean(axis=1)
            across = np.flatnonzero(crossing(knots, uv))
            whole, everywhere = meeting_rows(knots, spots[across])
            for i in range(3):
                own, functions = vertex_rows(knots, uv[:, i], middle)
                add(dofs[:, _CORNER[i]], functions, own)
                for k, j in enumerate(OTHERS[i].tolist()):
                    cut = crossing(knots, uv[:, [i, j]])
                    mine = cut[across]
                    add(dofs[across[mine], _NEAR[i, k]], everywhere[mine], whole[mine, _NEAR[i, k]])
                    own, functions = side_rows(knots, uv[:, i], uv[:, j], steps[:, i, k])
                    add(dofs[~cut, _NEAR[i, k]], functions[~cut], own[~cut])
            add(dofs[across, INNER], everywhere, whole[:, INNER])
            own, functions = inner_rows(knots, uv, steps, inwards)
            add(dofs[:, INNER], functions, own)
    return tuple(tuple(map(np.concatenate, zip(*kind))) for kind in (found, masked))  # type: ignore[return-value]


def _polar_rows(
    face: Face, surface: Patch, cells: PolarCells, control: Array, dofs: Index
) -> tuple[Index, Index, Array]:
    """Bernstein functions (r,), B-splines (r, 16) and entries (r, 16) of the rows of triangles at poles (k, 10)."""
    A, functions = tensor_rows(surface.knots, _snapped(surface.knots, cells.low), _snapped(surface.knots, cells.high))
    net = np.einsum("enb,enc->ebc", A, surface.control.reshape(-1, 3)[functions])
    dofs = dofs[:, REVERSED] if face.reversed else dofs
    parts: list[tuple[Index, Index, Array]] = []
    for side in np.unique(cells.side).tolist():
        e = np.flatnonzero(cells.side == side)
        F = np.repeat(triangle_map(side)[None], len(e), axis=0)
        F[:, :, INNER] = inner_row(net[e], side, control[dofs[e, INNER]])
        own = np.einsum("enb,ebc->ecn", A[e], F)
        parts.append((dofs[e].ravel(), np.repeat(functions[e], 10, axis=0), own.reshape(-1, 16)))
    return tuple(map(np.concatenate, zip(*parts)))  # type: ignore[return-value]


def _snapped(knots: tuple[Array, ...], uv: Array) -> Array:
    """Parameters (e, 2), those of knots where they are equal to within what makes two lines one."""
    result = uv.copy()
    for d, t in enumerate(knots):
        x = np.unique(t)
        nearest = x[np.abs(uv[:, d, None] - x).argmin(axis=1)]
        on = np.abs(uv[:, d] - nearest) <= 20 * ALONG * np.ptp(x)
        result[on, d] = nearest[on]
    return result


def _steps(
    surface: Patch, mesh: FaceMesh, corners: Index, control: Array, vertices: Index, made: Assembled
) -> tuple[Array, Array, Array, Array]:
    """Corners (t, 3, 2) of triangles in the parameter plane, (t, 3, 2, 2) and (t, 3, 2) as `inner_rows` wants them, and
    (t, 10, 2) as `meeting_rows` does.

    Sides are straight in the chart, or along parameter lines at quadrilaterals; on trimming curves steps are those
    whose images are the steps of the curve in space.
    """
    q = mesh.points[corners]
    flat = to_parameters(mesh.chart, q.reshape(-1, 2))
    uv = flat.reshape(q.shape)
    ring = np.concatenate([mesh.quads[:, [k, (k + 1) % 4]] for k in range(4)])
    size = len(mesh.points) + 1
    beside = np.sort(np.concatenate([ring, mesh.legs]), axis=1) @ np.array([size, 1])
    pairs = np.sort(made.curves[:, :2], axis=1) @ np.array([made.vertices, 1])
    _, du, dv = surface_frame(surface, flat)
    J = np.stack([du, dv], axis=-1).reshape(*q.shape[:2], 3, 2)
    steps, ways = np.zeros((len(q), 3, 2, 2)), np.zeros((len(q), 3, 2, 2))
    for i in range(3):
        for k, j in enumerate(OTHERS[i].tolist()):
            ways[:, i, k] = (q[:, j] - q[:, i]) / 3.0
            steps[:, i, k] = parameter_steps(mesh.chart, q[:, i], ways[:, i, k])
            along = np.isin(np.sort(corners[:, [i, j]], axis=1) @ np.array([size, 1]), beside)
            steps[along, i, k] = (uv[along, j] - uv[along, i]) / 3.0
            curve = np.isin(np.sort(vertices[:, [i, j]], axis=1) @ np.array([made.vertices, 1]), pairs)
            way = control[curve, _NEAR[i, k]] - control[curve, _CORNER[i]]
            own = J[curve, i]
            metric = np.einsum("tcd,tce->tde", own, own)
            steps[curve, i, k] = np.linalg.solve(metric, np.einsum("tcd,tc->td", own, way)[..., None])[..., 0]
            bent = along | curve
            ways[bent, i, k] = chart_steps(mesh.chart, uv[bent, i], steps[bent, i, k])
    inner, inwards = phi_of(q, ways), np.zeros(q.shape)
    for i in range(3):
        inwards[:, i] = parameter_steps(mesh.chart, q[:, i], inner - q[:, i])
        inwards[:, i] += 1.5 * parameter_bends(mesh.chart, q[:, i], ways[:, i, 0], ways[:, i, 1])
    phi = np.zeros((len(q), 10, 2))
    phi[:, _CORNER], phi[:, _NEAR], phi[:, INNER] = q, q[:, :, None] + ways, inner
    spots = CUBIC.tabulate(DOMAIN_POINTS, 0)[0] @ phi
    return uv, steps, inwards, to_parameters(mesh.chart, spots.reshape(-1, 2)).reshape(spots.shape)


def _measured(solid: Splined, meshes: list[FaceMesh], made: Assembled) -> tuple[Part, ...]:
    """Parts with the distances of the control points as they are now."""
    parts = []
    for part in made.parts:
        distance, folded = part.distance.copy(), part.folded.copy()
        for f, (face, mesh) in enumerate(zip(solid.brep.faces, meshes)):
            mine = part.owner == f
            if not mine.any():
                continue
            control = made.points[part.block.dofs[mine]]
            if part.block.basis is BICUBIC:
                control = control[:, TURNED] if face.reversed else control
                found = measure_quads(face, mesh.low, mesh.high, control)
            else:
                corners = mesh.outward
                found = measure_triangles(face, mesh.chart, mesh.points[corners], control)
            distance[mine], folded[mine] = found.distance + solid.apart[f], found.folded
        parts.append(replace(part, distance=distance, folded=folded))
    return tuple(parts)


def spline_blocks(sealed: Sealed) -> tuple[Space, tuple[Index, ...]]:
    """Space of the HB-rep, and for each block the CAD face of each element."""
    blocks: list[Block] = []
    owners = []
    for part in sealed.made.parts:
        for block, mine in blocks_of(part.block.basis, part.block.dofs, sealed.M):
            blocks.append(block)
            owners.append(part.owner[mine])
    return Space(tuple(blocks), sealed.M.shape[1]), tuple(owners)
