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

from geometry.cad.brep import Face
from geometry.hybrid.assembling import SIDES, TURNED, Assembled, Part
from geometry.hybrid.extraction import blocks_of
from geometry.hybrid.face_rows import NEAR, face_rows
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import BICUBIC, fit_triangles, measure_quads, measure_triangles
from geometry.hybrid.splining import Splined, on_lines
from geometry.hybrid.triangle import CUBIC, INNER
from geometry.patch import Patch
from iga.block import Block
from iga.domain import Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ZERO = 1e-13
"""Entry of a row, of size one at most but for a few, below which it is rounding."""
DEPENDENT = 1e-6
"""Diagonal of QR, relative to the first, below which a function beside the curves is a combination of others."""
FAINT = 3e-5
"""Size below which a function beside the curves is joined to another: integrals of its square would be rounding."""

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
    solid, meshes : what the HB-rep was made from: the solid with bicubic faces, and the mesh of each face.
    """

    made: Assembled
    M: csr_array
    points: Array
    trim: int
    splines: tuple[Patch | None, ...]
    numbers: tuple[Index | None, ...]
    on_curve: Mask
    adjust: csr_array
    solid: Splined
    meshes: tuple[FaceMesh, ...]


def seal(solid: Splined, meshes: list[FaceMesh], made: Assembled) -> Sealed:
    """Functions and control points of the HB-rep on a skin."""
    on_curve = _on_curves(made)
    done = on_curve.copy()
    trim = np.flatnonzero(on_curve)
    count, n = len(made.points), len(trim)
    rows, columns, values, points = [trim], [np.arange(n)], [np.ones(n)], [made.points[trim]]
    faces: list[_Splines | None] = []
    for f, mesh in enumerate(meshes):
        if f in solid.without or mesh.grid is None or not len(mesh.quads):
            faces.append(None)
            continue
        surface = on_lines(solid.brep.faces[f].surface, mesh.grid.lines)
        own = _splines(solid.brep.faces[f], f, surface, mesh, made, done, on_curve, n)
        faces.append(own)
        rows.append(own.rows)
        columns.append(own.columns)
        values.append(own.values)
        points.append(own.points)
        n += len(own.points)
    rest = np.flatnonzero(~done)
    so_far = _matrix(rows, columns, values, count, n) @ np.concatenate(points)
    rows.append(rest)
    columns.append(n + np.arange(len(rest)))
    values.append(np.ones(len(rest)))
    points.append(_at_poles(solid, meshes, made, so_far, rest))
    n += len(rest)
    M = _matrix(rows, columns, values, count, n)
    M.eliminate_zeros()
    coefficients = np.concatenate(points)
    placed = replace(made, points=M @ coefficients)
    placed = replace(placed, parts=_measured(solid, meshes, placed))
    with_splines = [own for own in faces if own is not None]
    for own in with_splines:
        own.adjust.resize(own.adjust.shape[0], n)
    adjust = vstack([csr_array((0, n)), *(own.adjust for own in with_splines)], format="csr")
    splines = tuple(None if own is None else own.surface for own in faces)
    numbers = tuple(None if own is None else own.number for own in faces)
    return Sealed(placed, M, coefficients, len(trim), splines, numbers, on_curve, adjust, solid, tuple(meshes))


@dataclass(frozen=True, eq=False)
class _Splines:
    """Functions that the B-splines of one face become.

    Attributes
    ----------
    surface : the face with the knots of its grid.
    rows, columns, values : (k,) entries of M.
    points : (m, 3) their coefficients.
    number : (r,) function of each B-spline, -1 where it vanishes.
    adjust : rows of `Sealed.adjust`, as many columns as there are functions so far.
    """

    surface: Patch
    rows: Index
    columns: Index
    values: Array
    points: Array
    number: Index
    adjust: csr_array


def _splines(
    face: Face, number: int, surface: Patch, mesh: FaceMesh, made: Assembled, done: Mask, on_curve: Mask, first: int
) -> _Splines:
    """Functions of a face, numbered from ``first`` on; Bernstein functions that get rows are marked ``done``."""
    (b, i, own), masked = face_rows(face, surface, mesh, made, number, done, on_curve)
    on_quad = np.zeros(len(made.points), dtype=bool)
    for part in made.parts:
        if part.block.basis is BICUBIC:
            on_quad[part.block.dofs[part.owner == number]] = True
    place, points = _merged(b, i, own, on_quad, surface)
    keep = place[i] >= 0
    numbers = np.where(place < 0, -1, first + place)
    adjust = _adjusting((np.cumsum(on_curve) - 1)[masked[0]], numbers, masked, int(on_curve.sum()))
    return _Splines(surface, b[keep], first + place[i[keep]], own[keep], points, numbers, adjust)


def _adjusting(b: Index, number: Index, masked: tuple[Index, Index, Array], trim: int) -> csr_array:
    """Rows of `Sealed.adjust` of one face.

    Where B-splines vanish under the mask, trim functions take their place, and there is nothing to adjust.

    Parameters
    ----------
    b : (k,) trim functions of the entries.
    masked : their entries as `face_rows` gives them; B-splines are ``number`` [i] here.
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
    quadrilaterals, so that functions still sum to one, and r_kept + T (r_rest - r_l) gives the same surface, but for
    what faint ones add to it (`FAINT`).
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
            inner = SIDES[k, 1:3] if m == 4 else np.array([NEAR[k, 0], NEAR[(k + 1) % 3, 1]])
            mask[part.block.dofs[np.isin(ends, pairs)][:, inner]] = True
    return mask


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
