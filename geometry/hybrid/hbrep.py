r"""Hybrid B-rep of a face: revised B-splines, trim functions, and their extraction (Song and Cohen 2019, Section 3).

On every piece the functions are combinations of its Bernstein functions theta. With N = A theta the B-splines on a
rectangle and M the mask that keeps the Bernstein functions that vanish on the trimming curve,

    rectangle      revised  A M theta             trim  (I - M) theta
    triangle       revised  A S M theta(phi^-1)   trim  (I - M) theta(phi^-1)        S from `triangle.selection`

Trim functions are numbered by the control points of the trimming curves in space (Upsilon), three to a segment, shared
by consecutive segments, so sealing is nothing but giving them these control points. Revised and trim functions sum to
one; outside the band the revised ones are the B-splines. The degree is three in both directions.

Rational surfaces are first approximated by bicubic polynomial splines (`polynomial_surface`), because the trimming
curve in space, which two faces share, carries no weights.

Axis letters: e element, n function, b Bernstein function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Face, surface_points
from geometry.hybrid.band import Band, make_band
from geometry.hybrid.partition import Partition, partition
from geometry.hybrid.triangle import CURVE, Phi, Psi, make_phi, selection
from geometry.hybrid.trimming import Trimming, cut_at_knots, trim_face
from geometry.knots import apply, bisected, blossom, elevation, evaluation, find_spans, insertion
from geometry.patch import Patch
from iga.bernstein import bernstein
from iga.block import Block, Patterns
from iga.cells import QUADRILATERAL, TRIANGLE
from iga.domain import Space
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DEGREE = 3
SIDES = np.array([[0, 1, 2, 3], [12, 13, 14, 15], [0, 4, 8, 12], [3, 7, 11, 15]])
"""Tensor Bernstein functions on the sides xi = low, xi = high, eta = low, eta = high, in increasing order."""
CORNERS = np.array([0, 3, 12, 15])


@dataclass(frozen=True, eq=False)
class HybridFace:
    """Hybrid representation of one face.

    Attributes
    ----------
    surface : the bicubic surface, its control points being R.
    band, parts : triangles and rectangles along the curves, and the rest.
    phi : (t, 10, 2) maps of the triangles to the parameter plane.
    space : the functions, R first, then the trim functions; blocks of quadrilaterals by number of trim functions,
        then the triangles.
    points : (n, 3) control points: R, then those of the trimming curves in space.
    low, high : (q, 2) for the quadrilaterals, block after block, their rectangles.
    revised, trim : numbers of functions of both kinds.
    """

    surface: Patch
    band: Band
    parts: Partition
    phi: Array
    space: Space
    points: Array
    low: Array
    high: Array
    revised: int
    trim: int


def bezier_rows(knots: Array, low: Array, high: Array) -> tuple[Array, Index]:
    """Extraction (e, n, b) of cubic B-splines on intervals from low to high (e,), either way round, and the first n."""
    spans = find_spans(knots, DEGREE, 0.5 * (low + high))
    upper = np.tri(DEGREE + 1, DEGREE, -1)
    arguments = (1.0 - upper) * low[:, None, None] + upper * high[:, None, None]
    rows = blossom(knots, DEGREE, np.repeat(spans, DEGREE + 1), arguments.reshape(-1, DEGREE))
    return np.swapaxes(rows.values.reshape(len(low), DEGREE + 1, DEGREE + 1), 1, 2), spans - DEGREE


def tensor_rows(knots: tuple[Array, ...], low: Array, high: Array) -> tuple[Array, Index]:
    """Extraction (e, 16, 16) on rectangles (e, 2), which may run backwards, and the B-splines on them (e, 16)."""
    x, i = bezier_rows(knots[0], low[:, 0], high[:, 0])
    y, j = bezier_rows(knots[1], low[:, 1], high[:, 1])
    A = np.einsum("enb,emc->enmbc", x, y).reshape(len(low), 16, 16)
    columns = len(knots[1]) - DEGREE - 1
    steps = np.arange(DEGREE + 1)
    dofs = (i[:, None, None] + steps[:, None]) * columns + j[:, None, None] + steps
    return A, dofs.reshape(len(low), 16)


def hybrid_face(
    face: Face | Patch,
    trimming: Trimming | None = None,
    depth: float = 0.25,
    phi: Phi = "blend",
    psi: Psi = "correction",
    tolerance: float = 1e-8,
    keep: Partition | None = None,
    where: str = "",
) -> HybridFace:
    """Build the hybrid representation of a face.

    Parameters
    ----------
    face : the face, or its bicubic surface if ``trimming`` is given.
    trimming : its trimming curves; by default cubics within ``tolerance`` of the face's loops.
    depth : wanted depth of band rectangles, as a share of a knot interval.
    phi, psi : variants of the triangles' maps (see `triangle`); "selection" is the paper's.
    keep : a partition that is to be kept where it still fits.

    Raises
    ------
    InputError : the surface is not bicubic after approximation, or no band fits.
    """
    if isinstance(face, Patch):
        if trimming is None:
            raise InputError("a bare surface needs its trimming curves")
        surface = face
    else:
        surface = polynomial_surface(face.surface, 1e-6)
        where = where or face.name
        if trimming is None:
            trimming = cut_at_knots(trim_face(face, tolerance), surface.knots)
    if surface.degree != (DEGREE, DEGREE) or surface.weights is not None:
        raise InputError(f"{where}: the hybrid representation needs a bicubic polynomial surface")
    knots = (surface.knots[0], surface.knots[1])
    band = make_band(trimming, knots, depth, where or "face")
    return assemble_face(surface, band, partition(band, knots, keep), phi, psi)


def assemble_face(
    surface: Patch, band: Band, parts: Partition, phi: Phi = "blend", psi: Psi = "correction"
) -> HybridFace:
    """Functions and control points of a face whose band and partition are known."""
    knots = (surface.knots[0], surface.knots[1])
    curve = band.trimming.plane[band.segment]
    oriented = np.where(band.forward[:, None, None], curve, curve[:, ::-1])
    maps = make_phi(band.q0, oriented, phi)
    columns = surface.control.shape[0] * surface.control.shape[1]
    blocks, low, high = _rectangles(band, parts, knots, columns)
    if len(band.segment):
        blocks.append(_triangles(band, oriented, maps, knots, columns, psi))
    trim = 3 * len(band.trimming.next)
    points = np.concatenate([surface.control.reshape(-1, 3), band.trimming.space[:, :3].reshape(-1, 3)])
    space = Space(tuple(blocks), columns + trim)
    return HybridFace(surface, band, parts, maps, space, points, low, high, columns, trim)


def _curve_dofs(band: Band, segments: Index, first: int) -> Index:
    """Trim functions (s, 4) of segments."""
    s = np.asarray(segments)
    return first + np.stack([3 * s, 3 * s + 1, 3 * s + 2, 3 * band.trimming.next[s]], axis=1)


def _rectangles(
    band: Band, parts: Partition, knots: tuple[Array, Array], first: int
) -> tuple[list[Block], Array, Array]:
    low, high = np.concatenate([parts.low, band.low]), np.concatenate([parts.high, band.high])
    A, dofs = tensor_rows(knots, low, high)
    trims: list[dict[int, int]] = [{} for _ in parts.low]
    for touch, along in zip(band.touching.tolist(), band.along.tolist()):
        mine: dict[int, int] = {}
        for corner, t in zip(CORNERS.tolist(), touch):
            if t >= 0:
                mine[corner] = first + 3 * t
        for side, s in enumerate(along):
            if s < 0:
                continue
            row = _curve_dofs(band, np.array([s]), first)[0]
            d = 1 - side // 2
            rising = band.trimming.plane[s, 3, d] > band.trimming.plane[s, 0, d]
            mine.update(zip(SIDES[side].tolist(), (row if rising else row[::-1]).tolist()))
        trims.append(mine)
    counts = np.array([len(t) for t in trims])
    basis = bernstein(QUADRILATERAL, DEGREE)
    blocks, order = [], []
    for count in np.unique(counts):
        mine_ = np.flatnonzero(counts == count)
        order.append(mine_)
        C = np.zeros((len(mine_), 16 + count, 16))
        C[:, :16] = A[mine_]
        numbers = np.zeros((len(mine_), 16 + count), dtype=np.int64)
        numbers[:, :16] = dofs[mine_]
        for e, k in enumerate(mine_.tolist()):
            for i, (b, n) in enumerate(trims[k].items()):
                C[e, :, b] = 0.0
                C[e, 16 + i, b] = 1.0
                numbers[e, 16 + i] = n
        blocks.append(Block(basis, numbers, Patterns(C, np.arange(len(mine_)))))
    taken = np.concatenate(order) if order else np.zeros(0, dtype=np.int64)
    return blocks, low[taken], high[taken]


def _triangles(
    band: Band, oriented: Array, maps: Array, knots: tuple[Array, Array], first: int, psi: Psi
) -> Block:
    far = np.stack([oriented[:, 0, 0], oriented[:, 3, 1]], axis=1)  # xi of pa, eta of pb
    A, dofs = tensor_rows(knots, band.q0, far)
    S = selection(maps, psi)
    full = A @ S
    C = np.zeros((len(A), 20, 10))
    C[:, :16] = full
    C[:, :16, CURVE] = 0.0
    C[:, 16 + np.arange(4), CURVE] = 1.0
    trims = _curve_dofs(band, band.segment, first)
    trims = np.where(band.forward[:, None], trims, trims[:, ::-1])
    return Block(bernstein(TRIANGLE, DEGREE), np.concatenate([dofs, trims], axis=1), Patterns(C, np.arange(len(A))))


def polynomial_surface(surface: Patch, tolerance: float) -> Patch:
    """Bicubic polynomial spline within a tolerance (relative to the extent) of a surface; exact where it can be.

    Surfaces of lower degree are elevated; others are interpolated at Greville points on knots that are halved until
    samples between them are met.
    """
    if surface.weights is None and max(surface.degree) <= DEGREE:
        knots, control = list(surface.knots), surface.control
        for d in range(2):
            for p in range(surface.degree[d], DEGREE):
                knots[d], rows = elevation(knots[d], p)
                control = apply(rows, control, d)
        return Patch((knots[0], knots[1]), control)
    extent = float(np.linalg.norm(np.ptp(surface.control.reshape(-1, 3), axis=0)))
    w = surface.weights
    exact = [
        p <= DEGREE and (w is None or bool(np.ptp(w, axis=d).max() <= 1e-13)) for d, p in enumerate(surface.degree)
    ]
    knots = [_raised(t, p) for t, p in zip(surface.knots, surface.degree)]
    for _ in range(9):
        made = _interpolated(surface, knots[0], knots[1])
        fine = [np.concatenate([x[:-1] + f * np.diff(x) for f in (0.13, 0.5, 0.87)]) for x in map(np.unique, knots)]
        uv = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1).reshape(-1, 2)
        if np.linalg.norm(surface_points(made, uv) - surface_points(surface, uv), axis=1).max() <= tolerance * extent:
            return made
        knots = [t if done else bisected(t) for t, done in zip(knots, exact)]
    raise InputError(f"a bicubic spline does not come within {tolerance:g} of a surface of degree {surface.degree}")


def _raised(knots: Array, degree: int) -> Array:
    """Cubic knots with the continuity that splines of a degree have at its knots, at most C2."""
    values, counts = np.unique(knots, return_counts=True)
    repeats = np.clip(DEGREE - degree + counts, 1, DEGREE)
    repeats[[0, -1]] = DEGREE + 1
    return np.repeat(values, repeats)


def _interpolated(surface: Patch, *knots: Array) -> Patch:
    """Bicubic spline through a surface at Greville points."""
    where = [np.array([t[i + 1 : i + 4].mean() for i in range(len(t) - 4)]) for t in knots]
    grid = np.stack(np.meshgrid(*where, indexing="ij"), axis=-1)
    control = surface_points(surface, grid.reshape(-1, 2)).reshape(*grid.shape[:2], 3)
    inverse = []
    for t, x in zip(knots, where):
        rows = evaluation(t, DEGREE, x)
        matrix = np.zeros((len(x), len(x)))
        matrix[np.arange(len(x))[:, None], rows.first[:, None] + np.arange(DEGREE + 1)] = rows.values
        inverse.append(np.linalg.inv(matrix))
    return Patch((knots[0], knots[1]), np.einsum("ai,bj,ijc->abc", *inverse, control))


def refined_surface(surface: Patch, levels: int = 1) -> Patch:
    """The same surface with every knot interval halved."""
    control = surface.control
    knots = []
    for d in range(2):
        t = surface.knots[d]
        fine = bisected(t, levels)
        control = apply(insertion(t, len(t) - control.shape[d] - 1, fine), control, d)
        knots.append(fine)
    return Patch((knots[0], knots[1]), control)


def refine_hybrid(
    face: HybridFace, levels: int = 1, keep_partition: bool = False, depth: float = 0.25, psi: Psi = "correction"
) -> HybridFace:
    """Refine by halving knot intervals; the band is built again, its old functions are not reproduced inside it.

    Parameters
    ----------
    keep_partition : rectangles of the coarse partition are cut where they must, instead of chosen anew. The functions
        and the geometry are the same either way.
    """
    surface = refined_surface(face.surface, levels)
    trimming = cut_at_knots(face.band.trimming, surface.knots)
    return hybrid_face(surface, trimming, depth, psi=psi, keep=face.parts if keep_partition else None, where="refined")
