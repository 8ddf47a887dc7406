r"""Rows of an HB-rep's functions on one face: which of its B-splines each Bernstein function of the skin is made of.

Quadrilaterals take the extraction of the B-splines, triangles at poles that of their cells (`poles`), other triangles
the rules of `strip`; triangles within which the chart narrows towards a pole have no rows. See `sealing` for what the
rows of all faces become.

Axis letters: b Bernstein function, i corner, t triangle, e element, k row, c component, d parameter direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Face, surface_frame
from geometry.hybrid.assembling import TURNED, Assembled
from geometry.hybrid.chart import chart_steps, narrows, parameter_bends, parameter_steps, to_parameters
from geometry.hybrid.facemesh import FaceMesh
from geometry.hybrid.fitting import BICUBIC
from geometry.hybrid.grid import ALONG
from geometry.hybrid.hbrep import tensor_rows
from geometry.hybrid.poles import REVERSED, PolarCells, inner_row, triangle_map
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
from geometry.hybrid.triangle import CORNER, CUBIC, INNER
from geometry.patch import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

NEAR = np.array([
    [int(np.flatnonzero((CUBIC.exponents[:, i] == 2) & (CUBIC.exponents[:, j] == 1))[0]) for j in OTHERS[i]]
    for i in range(3)
])
"""Functions (i, 2) beside corner i on the sides to the corners that follow."""


def face_rows(
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
            regular = ~narrows(mesh.chart, mesh.points[corners])
            corners, dofs = corners[regular], dofs[regular]
            uv, steps, inwards, spots = _steps(
                surface, mesh, corners, made.points[dofs], part.corners[mine][regular], made
            )
            middle = uv.mean(axis=1)
            across = np.flatnonzero(crossing(knots, uv))
            whole, everywhere = meeting_rows(knots, spots[across])
            for i in range(3):
                own, functions = vertex_rows(knots, uv[:, i], middle)
                add(dofs[:, CORNER[i]], functions, own)
                for k, j in enumerate(OTHERS[i].tolist()):
                    cut = crossing(knots, uv[:, [i, j]])
                    mine = cut[across]
                    add(dofs[across[mine], NEAR[i, k]], everywhere[mine], whole[mine, NEAR[i, k]])
                    own, functions = side_rows(knots, uv[:, i], uv[:, j], steps[:, i, k])
                    add(dofs[~cut, NEAR[i, k]], functions[~cut], own[~cut])
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
            way = control[curve, NEAR[i, k]] - control[curve, CORNER[i]]
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
    phi[:, CORNER], phi[:, NEAR], phi[:, INNER] = q, q[:, :, None] + ways, inner
    spots = CUBIC.tabulate(DOMAIN_POINTS, 0)[0] @ phi
    return uv, steps, inwards, to_parameters(mesh.chart, spots.reshape(-1, 2)).reshape(spots.shape)
