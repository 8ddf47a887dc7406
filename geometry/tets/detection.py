r"""Which hexahedra are converted tetrahedra, and which tetrahedra they were (Theorem 2, and Theorem 3 backwards).

**One degenerate hexahedron.** A hexahedron of degree (n, n, n) is a tetrahedron of degree n exactly if every slice
i = 0..n along r is a triangular surface of degree n - i in (s, t), that is, if its control points lie in the column
space of the matrix M of Theorem 1. (Slice 0 counts; the printed range i = 1..n misses it.) Which of its faces collapses
is not known beforehand, so the symmetries of the cube are tried. Reflecting t only exchanges two vertices of the
tetrahedron and leaves the column space as it is, so the 24 rotations stand for all 48 symmetries, and a rotation keeps
the orientation.

**Four hexahedra.** The matrix M_m of Theorem 3 has full rank too, so one hexahedron alone determines the tetrahedron it
would be a quarter of, up to which corner it keeps (8 choices). Candidates that share the opposite corner, the
tetrahedron's centroid, are put in order by their kept vertices and accepted if one tetrahedron gives all four.

Least squares by an orthonormal basis of the column space; cond(M) is 2 to 34 for n = 1..8.

Source: Xu et al. 2018, theorems 2 and 3.  Axis letters: e hexahedron, g group of four, b control point, n coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.tet_to_hex import AXES, degenerate_matrix, hex_matrices
from geometry.tets.mesh import corner_columns
from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_CHUNK = 20_000
"""Elements at a time."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Which hexahedra (or groups of them) are converted tetrahedra.

    Attributes
    ----------
    found : (e,) bool, accepted within the tolerance.
    coefficients : (e, C(n+3, 3), 3) Bernstein coefficients of the tetrahedra, meaningless where not found.
    residual : (e,) largest distance of a control point from the best fit, relative to the hexahedron's size; where no
        face is near a point it is a lower bound.
    point_face, line_face : (e,) the face that collapses to a point and the one that collapses to a line, -1 if not
        found.
    """

    found: NDArray[np.bool_]
    coefficients: Array
    residual: Array
    point_face: Index
    line_face: Index


def hexes_to_tets(coefficients: Array, tolerance: float = 1e-10) -> Detection:
    """Find the hexahedra that are tetrahedra converted by Theorem 1, in whatever way they are turned.

    Parameters
    ----------
    coefficients : (e, (n+1)^3, 3) Bernstein coefficients of hexahedra of degree (n, n, n).
    tolerance : largest accepted distance of a control point, relative to the hexahedron's bounding box.

    Raises
    ------
    InputError : the number of coefficients is no cube.
    """
    coefficients = np.asarray(coefficients, dtype=float)
    n = hex_degree(coefficients)
    e, tets = len(coefficients), degenerate_matrix(n).shape[1]
    made = Detection(
        np.zeros(e, dtype=bool), np.zeros((e, tets, 3)), np.empty(e), np.full(e, -1), np.full(e, -1)
    )
    symmetries = cube_symmetries(n)
    rotations = [k for k in range(48) if symmetry_sign(k) > 0]
    size = _sizes(coefficients)
    made.residual[:] = _smallest_spread(coefficients, n) / (2 * size)
    basis = np.linalg.qr(degenerate_matrix(n))[0]
    inverse = np.linalg.pinv(degenerate_matrix(n))
    # A face whose spread is s is at least s/2 off any tetrahedron: only the others need to be fitted. A loose threshold
    # keeps the residual of near misses meaningful.
    candidates = np.flatnonzero(made.residual <= max(tolerance, 1e-2))
    for start in range(0, len(candidates), _CHUNK):
        rows = candidates[start : start + _CHUNK]
        part = coefficients[rows]
        residual = np.stack([_residual(part[:, symmetries[k]], basis) for k in rotations])
        best = residual.argmin(axis=0)
        chosen = np.array(rotations)[best]
        turned = np.take_along_axis(part, symmetries[chosen][:, :, None], axis=1)
        made.coefficients[rows] = inverse @ turned
        made.residual[rows] = residual[best, np.arange(len(rows))] / size[rows]
        ok = made.residual[rows] <= tolerance
        made.found[rows] = ok
        faces = np.array([symmetry_faces(k) for k in range(48)])[chosen]
        made.point_face[rows[ok]] = faces[ok, 1]
        made.line_face[rows[ok]] = faces[ok, 3]
    return made


def _residual(control: Array, basis: Array) -> Array:
    """Largest distance (e,) of control points (e, b, 3) from the span of an orthonormal basis (b, n)."""
    off = control - basis @ (basis.T @ control)
    return np.sqrt((off**2).sum(axis=2).max(axis=1))


def _sizes(coefficients: Array) -> Array:
    """Diagonals (e,) of the bounding boxes."""
    diagonal = np.linalg.norm(np.ptp(coefficients, axis=1), axis=1)
    return np.where(diagonal > 0, diagonal, 1.0)


def _smallest_spread(coefficients: Array, n: int) -> Array:
    """Largest extent (e,) of the control points of the face that is nearest to a point."""
    grid = coefficients.reshape(-1, n + 1, n + 1, n + 1, 3)
    faces = [np.take(grid, k, axis=axis).reshape(len(grid), -1, 3) for axis in (1, 2, 3) for k in (0, n)]
    return np.min([np.ptp(f, axis=1).max(axis=1) for f in faces], axis=0)


def hex_degree(coefficients: Array) -> int:
    """Degree n of hexahedra with (e, (n+1)^3, c) coefficients."""
    count = coefficients.shape[1] if coefficients.ndim == 3 else 0
    m = round(count ** (1 / 3))
    if m < 2 or m**3 != count:
        raise InputError(f"{count} coefficients per hexahedron are no cube (8, 27, 64, ... are needed)")
    return m - 1


_SYMMETRIES = tuple((axes, flips) for axes in permutations(range(3)) for flips in product((0, 1), repeat=3))


@cache
def cube_symmetries(n: int) -> Index:
    """The 48 ways of turning and reflecting a hexahedron's control points, (48, (n+1)^3).

    Symmetry (axes, flips): new axis d runs along old axis ``axes[d]``, backwards if ``flips[d]``.
    """
    grid = np.arange((n + 1) ** 3).reshape((n + 1,) * 3)
    made = [
        grid.transpose(axes)[tuple(slice(None, None, -1) if f else slice(None) for f in flips)].ravel()
        for axes, flips in _SYMMETRIES
    ]
    return np.array(made, dtype=np.int64)


def symmetry_sign(k: int) -> int:
    """+1 for a rotation, -1 for a reflection."""
    axes, flips = _SYMMETRIES[k]
    odd = sum(axes[a] > axes[b] for a in range(3) for b in range(a + 1, 3)) + sum(flips)
    return 1 - 2 * (odd % 2)


def symmetry_faces(k: int) -> Index:
    """Old face numbers (6,) of the new faces 0 (r=0), 1 (r=1), 2 (s=0), ..."""
    axes, flips = _SYMMETRIES[k]
    return np.array([2 * axes[d] + (side ^ flips[d]) for d in range(3) for side in (0, 1)], dtype=np.int64)


def hex_groups_to_tets(coefficients: Array, tolerance: float = 1e-10) -> tuple[Index, Array, Array]:
    """Find groups of four hexahedra that are one tetrahedron converted by Theorem 3.

    Parameters
    ----------
    coefficients : (e, (n+1)^3, 3) Bernstein coefficients of hexahedra of degree (n, n, n), in any order, turned anyhow.
    tolerance : largest accepted distance of a control point, relative to the tetrahedron's bounding box.

    Returns
    -------
    groups : (g, 4) the hexahedra of each tetrahedron, by the vertex they keep.
    tets : (g, C(n+3, 3), 3) its coefficients, positive if the first hexahedron is.
    residual : (g,)
    """
    coefficients = np.asarray(coefficients, dtype=float)
    n = hex_degree(coefficients)
    symmetries = cube_symmetries(n)
    basis = np.linalg.qr(hex_matrices(n)[0])[0]
    # Exchanging axes exchanges the vertices p, q, o and keeps the column space: one rotation for each kept corner.
    corner = {flips: k for k, (_, flips) in enumerate(_SYMMETRIES) if symmetry_sign(k) > 0}
    chosen = np.array([corner[flips] for flips in product((0, 1), repeat=3)])
    size = _sizes(coefficients)
    residual, turn = np.empty(len(coefficients)), np.empty(len(coefficients), dtype=np.int64)
    for start in range(0, len(coefficients), _CHUNK):
        rows = slice(start, start + _CHUNK)
        fits = np.stack([_residual(coefficients[rows][:, symmetries[k]], basis) for k in chosen])
        turn[rows] = chosen[fits.argmin(axis=0)]
        residual[rows] = fits.min(axis=0) / size[rows]
    # A single hexahedron determines its tetrahedron less sharply than four together: sift loosely, judge below.
    kept = np.flatnonzero(residual <= 10 * tolerance)
    turned = np.take_along_axis(coefficients[kept], symmetries[turn[kept]][:, :, None], axis=1)
    quads = _by_last_corner(turned[:, -1], size[kept], tolerance)
    groups, arranged = _arrange(kept[quads], turned[quads], n)
    stack = hex_matrices(n).reshape(-1, hex_matrices(n).shape[2])
    together = arranged.reshape(len(groups), len(stack), 3)
    tets = np.linalg.pinv(stack) @ together
    off = np.sqrt(((together - stack @ tets) ** 2).sum(axis=2))
    worst = off.max(axis=1, initial=0.0) / _sizes(tets)
    good = worst <= tolerance
    return groups[good], tets[good], worst[good]


def _by_last_corner(centres: Array, size: Array, tolerance: float) -> Index:
    """Groups (g, 4) of candidates with the same last corner."""
    if not len(centres):
        return np.zeros((0, 4), dtype=np.int64)
    reach = 4 * tolerance * float(size.max())
    distance, near = cKDTree(centres).query(centres, k=5, distance_upper_bound=max(reach, 1e-300))
    near = np.sort(np.where(np.isfinite(distance), near, len(centres)), axis=1)
    exactly = (near[:, 3] < len(centres)) & (near[:, 4] == len(centres)) & (near[:, 0] == np.arange(len(centres)))
    return near[exactly, :4].astype(np.int64)


def _arrange(groups: Index, control: Array, n: int) -> tuple[Index, Array]:
    """Order groups by the vertex that each hexahedron keeps, and axes to match; control points (g, 4, b, 3).

    The first hexahedron is number 0 and its axes lead to 1, 2, 3. Each other one is recognised by the corner of the
    first one's tetrahedron that it keeps.
    """
    inverse = np.linalg.pinv(hex_matrices(n)[0])
    corners = corner_columns(n)
    made = control.copy()
    order = np.zeros((len(groups), 4), dtype=np.int64)
    # Vertices (g, 4 hexahedra, 4) of the tetrahedron that each hexahedron implies: kept, along r, along s, along t.
    implied = (inverse @ control)[:, :, corners]
    first = implied[:, 0]
    exponents = bernstein(HEXAHEDRON, n).exponents
    grid = (n + 1) ** np.arange(2, -1, -1)
    rows = np.arange(len(groups))
    for m in range(1, 4):
        distance = np.linalg.norm(implied[:, :, 0] - first[:, None, m], axis=2)
        hexahedron = distance.argmin(axis=1)
        order[:, m] = hexahedron
        own = implied[rows, hexahedron]
        # axis[d]: which of its axes leads where axis d of sub-hexahedron m should lead.
        axis = np.stack(
            [np.linalg.norm(own[:, 1:] - first[:, None, v], axis=2).argmin(axis=1) for v in AXES[m]], axis=1
        )
        index = np.einsum("bd,gd->gb", exponents, grid[axis])
        made[:, m] = control[rows[:, None], hexahedron[:, None], index]
    return np.take_along_axis(groups, order, axis=1), made


