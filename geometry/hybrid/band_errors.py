r"""How far a hybrid face, or its triangles alone, are from the surface at equal parameters, and where (Section 5).

Axis letters: e element, t triangle, q sample, b Bernstein function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import surface_frame, surface_points
from geometry.hybrid.hbrep import DEGREE, HybridFace, tensor_rows
from geometry.hybrid.triangle import CURVE, Phi, Psi, make_phi, right_corner, selection, triangle_map
from geometry.hybrid.trimming import Trimming
from geometry.patch import Patch
from iga.bernstein import bernstein
from iga.block import Patterns
from iga.cells import TRIANGLE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BandError:
    """Distance at equal parameters between a hybrid face and its surface.

    Attributes
    ----------
    largest, curve : on the triangles, and on the trimming curve alone.
    area : of the band in space, triangles and rectangles.
    share : of the face's area outside the band, where the surface is kept exactly.
    uv : where the largest distance is.
    """

    largest: float
    curve: float
    area: float
    share: float
    uv: tuple[float, float]


def band_error(face: HybridFace, surface: Patch | None = None, samples: int = 16) -> BandError:
    """Measure a hybrid face against a surface, its own by default."""
    surface = face.surface if surface is None else surface
    block = face.space.blocks[-1]
    ab = np.array([(i, j) for i in range(samples + 1) for j in range(samples + 1 - i)]) / samples
    largest, curve, place = 0.0, 0.0, (0.0, 0.0)
    triangle_area = 0.0
    if block.basis.cell is TRIANGLE:
        extraction = block.extraction
        assert isinstance(extraction, Patterns)
        control = np.einsum("enb,enc->ebc", extraction.C, face.points[block.dofs])
        values = block.basis.tabulate(ab, 0)[0]
        uv = np.einsum("qb,ebc->eqc", values, face.phi)
        x = np.einsum("qb,ebc->eqc", values, control)
        apart = np.linalg.norm(x - surface_points(surface, uv.reshape(-1, 2)).reshape(x.shape), axis=-1)
        e, q = np.unravel_index(int(apart.argmax()), apart.shape)
        largest, place = float(apart.max()), (float(uv[e, q, 0]), float(uv[e, q, 1]))
        curve = float(apart[:, np.abs(ab.sum(axis=1) - 1.0) < 1e-12].max())
        triangle_area = _triangle_area(face, surface)
    n = len(face.band.low)
    rectangle = _rectangle_area(surface, face.band.low, face.band.high) if n else 0.0
    rest = _rectangle_area(surface, face.parts.low, face.parts.high)
    band = triangle_area + rectangle
    return BandError(largest, curve, band, rest / (band + rest), place)


_GAUSS = 0.5 * (1.0 + np.array([-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526]))
_WEIGHT = 0.5 * np.array([0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538])


def _rectangle_area(surface: Patch, low: Array, high: Array) -> float:
    grid = np.stack(np.meshgrid(_GAUSS, _GAUSS, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = np.outer(_WEIGHT, _WEIGHT).ravel()
    uv = low[:, None] + grid * (high - low)[:, None]
    _, du, dv = surface_frame(surface, uv.reshape(-1, 2))
    area = np.linalg.norm(np.cross(du, dv), axis=1).reshape(len(low), -1)
    return float(np.einsum("q,eq,e->", weight, area, np.prod(high - low, axis=1)))


def _triangle_area(face: HybridFace, surface: Patch) -> float:
    u, v = (g.ravel() for g in np.meshgrid(_GAUSS, _GAUSS, indexing="ij"))
    weight = np.outer(_WEIGHT, _WEIGHT).ravel() * (1.0 - u)
    basis = bernstein(TRIANGLE, DEGREE)
    values, gradients = basis.tabulate(np.stack([u, v * (1.0 - u)], axis=1), 1)
    uv = np.einsum("qb,ebc->eqc", values, face.phi)
    J = np.einsum("qbd,ebc->eqcd", gradients, face.phi)
    det = np.abs(J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0])
    _, du, dv = surface_frame(surface, uv.reshape(-1, 2))
    return float(np.einsum("q,eq,eq->", weight, det, np.linalg.norm(np.cross(du, dv), axis=1).reshape(det.shape)))


@dataclass(frozen=True, eq=False)
class TriangleError:
    """Distances at equal parameters between curvilinear triangles (t,) and their surface, and what they cover.

    Attributes
    ----------
    largest, curve : on each triangle, and on its trimming edge.
    area : in the parameter plane.
    uv : (t, 2) where the largest distance is.
    """

    largest: Array
    curve: Array
    area: Array
    uv: Array


def triangle_error(
    surface: Patch, trimming: Trimming, phi: Phi = "blend", psi: Psi = "selection", samples: int = 24
) -> TriangleError:
    """Measure the triangles of all segments that do not follow a parameter line, without building a band."""
    start, end = trimming.plane[:, 0], trimming.plane[:, 3]
    step = end - start
    curved = np.abs(step).min(axis=1) > 1e-9 * np.abs(step).max(axis=1)
    start, end, step = start[curved], end[curved], step[curved]
    if not curved.any():
        return TriangleError(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2)))
    q0 = right_corner(start, end)
    forward = step[:, 0] * step[:, 1] <= 0  # the leg at the start runs along xi: the segment begins at pa
    plane, space = (np.where(forward[:, None, None], c[curved], c[curved][:, ::-1]) for c in (trimming.plane,
                                                                                             trimming.space))
    maps = make_phi(q0, plane, phi)
    A, dofs = tensor_rows(surface.knots, q0, np.stack([plane[:, 0, 0], plane[:, 3, 1]], axis=1))
    control = np.einsum("enb,enc->ebc", A @ selection(maps, psi), surface.control.reshape(-1, 3)[dofs])
    control[:, CURVE] = space
    ab = np.array([(i, j) for i in range(samples + 1) for j in range(samples + 1 - i)]) / samples
    uv, x = triangle_map(maps, ab), triangle_map(control, ab)
    apart = np.linalg.norm(x - surface_points(surface, uv.reshape(-1, 2)).reshape(x.shape), axis=-1)
    # Area of the region between the legs and the segment, by Green's formula on the cubic.
    P = plane - q0[:, None]
    moments = np.array([[0, 0.3, 0.15, 0.05], [-0.3, 0, 0.15, 0.15], [-0.15, -0.15, 0, 0.3], [-0.05, -0.15, -0.3, 0]])
    area = np.abs(np.einsum("ti,ij,tj->t", P[:, :, 0], moments, P[:, :, 1]))
    on = np.abs(ab.sum(axis=1) - 1.0) < 1e-12
    rows = np.arange(len(apart))
    return TriangleError(apart.max(axis=1), apart[:, on].max(axis=1), area, uv[rows, apart.argmax(axis=1)])
