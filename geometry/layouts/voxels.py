"""A set of voxels with the topology of a solid: its meccano, when the solid has handles.

The solid is turned so that its normals are as close to the axes as they can be (`orientation`). On grids that grow
finer, the share of every voxel inside the solid is found exactly along lines parallel to the first axis; the voxels
more than half inside make the first set. Single voxels then join or leave as long as that mends the topology, and
afterwards as long as it lowers

    sum over voxels of (share left out + share taken in from outside) + lambda (faces) / 6

without changing the topology. Of the sets that lie in space as the solid does (`isotopy`), the coarsest with little
volume between it and the solid is taken.

Axis letters: v vertex, t triangle, i j k voxel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.layouts.isotopy import deforms, simple
from geometry.layouts.orientation import orientation
from geometry.layouts.topology import defects_of, smooth_points, topology, topology_of
from geometry.simplices.surface import Surface, genus
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

LINES = 6
"""Lines per voxel and direction along which the inside is measured."""
THRESHOLDS = (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
"""First sets: voxels with more than this share inside."""
SMOOTHING = 0.1
"""lambda / 6."""
FINE = 60
"""Fine voxels along the longest axis, on which the place of handles is judged."""
COARSEST, FINEST = 3.0, 14.0
"""Voxels along the solid's longest axis."""
LARGEST_GRID = 10**7
"""Most voxels of a grid around cuboids: a hundred times what a meccano can have."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """A set of voxels placed in space.

    Attributes
    ----------
    cells : (k, 3) integer positions of the voxels in their grid.
    rotation : (3, 3) the grid's axes as rows.
    planes : where the planes of the grid cross each of these axes, ascending.
    """

    cells: Index
    rotation: Array
    planes: tuple[Array, Array, Array]

    @property
    def size(self) -> float:
        """Mean side of a voxel."""
        sides = [np.diff(line)[self.cells[:, d]] for d, line in enumerate(self.planes)]
        return float(np.mean(sides))


@dataclass(frozen=True, eq=False)
class Fitted:
    """Voxels found for a solid, and how well they fit.

    Attributes
    ----------
    voxels : the set.
    faces : faces on its boundary.
    resolution : voxels along the solid's longest axis.
    mismatch : volume between the set and the solid, as a share of the solid's.
    reach : largest distance of the surface from the set along an axis, in voxels' sides.
    """

    voxels: Voxels
    faces: int
    resolution: float
    mismatch: float
    reach: float

    def report(self) -> dict[str, float]:
        """Numbers for the report of a build."""
        return {
            "voxels": len(self.voxels.cells), "boundary_sides": self.faces, "resolution": self.resolution,
            "mismatch": self.mismatch, "reach": self.reach,
        }


def place(voxels: Voxels, corners: Array) -> Array:
    """Points (v, 3) in space of grid points (v, 3)."""
    whole = corners.astype(np.int64)
    return np.stack([line[whole[:, d]] for d, line in enumerate(voxels.planes)], axis=1) @ voxels.rotation


def voxelise(
    surface: Surface, resolution: float | None = None, mismatch: float = 0.53, progress: Progress = QUIET,
    fullness: float = 0.5, reach: float = np.inf, beyond: float = 0.0,
) -> Fitted:
    """Voxels with the topology of the solid inside a surface.

    Parameters
    ----------
    resolution : voxels along the solid's longest axis; None for the fewest that will do.
    mismatch : volume between voxels and solid, as a share of the solid's, that will do.
    fullness : share inside from which on a voxel rather belongs to the set; with less than a half, limbs thinner than
        a voxel are followed.
    reach : how many voxels' sides the surface may be away from the voxels.
    beyond : by how many voxels along the longest axis finer sets that will do as well are compared; the set with the
        least mismatch is taken.

    Raises
    ------
    InputError : no set of voxels has the solid's topology.
    """
    handles, rotation = genus(surface), orientation(surface)
    tried = np.arange(COARSEST, FINEST + 0.25, 0.5) if resolution is None else np.array([float(resolution)])
    if not (tried > 0).all() or not (tried <= 4 * FINEST).all():
        raise InputError(f"a resolution is a number of voxels between 0 and {4 * FINEST:g}, not {resolution}")
    found: list[Fitted] = []
    last = np.inf
    for number in progress.track(tried.tolist(), "voxels"):
        fitted = _on_grids(surface, handles, rotation, number, fullness)
        if fitted is not None:
            found.append(fitted)
            if fitted.mismatch <= mismatch and fitted.reach <= reach:
                last = min(last, number + beyond)
        if number >= last:
            break
    if not found:
        where = f"{tried[0]:g} to {tried[-1]:g} voxels" if len(tried) > 1 else f"{tried[0]:g} voxels"
        raise InputError(
            f"no set of voxels has the surface's genus {handles} with {where} along the longest axis; "
            "give another resolution or cuboids"
        )
    will_do = [one for one in found if one.mismatch <= mismatch and one.reach <= reach]
    return min(will_do or found, key=lambda one: one.mismatch)


def cuboids(surface: Surface, boxes: Index) -> Voxels:
    """Voxels given as cuboids, fitted to the box of a surface along its own axes.

    Parameters
    ----------
    boxes : (n, 2, 3) integer corners of the cuboids, the lowest and the highest of each; they may overlap.

    Raises
    ------
    InputError : a cuboid is empty, the grid around all is too large, or the union does not have the surface's topology.
    """
    boxes = np.asarray(boxes)
    if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or not len(boxes):
        raise InputError(f"cuboids are given as integers (n, 2, 3), lowest and highest corner, not as {boxes.shape}")
    broken = np.flatnonzero(((boxes != np.round(boxes)) | ~(np.abs(boxes) <= LARGEST_GRID)).any(axis=(1, 2)))
    if len(broken):
        corners = boxes[broken[0]].tolist()
        raise InputError(f"cuboid {broken[0]} has corners {corners}, which are no whole numbers up to {LARGEST_GRID}")
    boxes = boxes.astype(np.int64)
    empty = np.flatnonzero((boxes[:, 0] >= boxes[:, 1]).any(axis=1))
    if len(empty):
        lower, upper = boxes[empty[0]].tolist()
        raise InputError(f"cuboid {empty[0]} from {lower} to {upper} is empty")
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    if (size := math.prod((high - low).tolist())) > LARGEST_GRID:
        raise InputError(f"cuboids span {size:.0e} unit cubes, more than {LARGEST_GRID:.0e}; use smaller numbers")
    inside = np.zeros(high - low, dtype=bool)
    for lower, upper in boxes - low:
        inside[tuple(slice(a, b) for a, b in zip(lower, upper, strict=True))] = True
    require_topology(inside, genus(surface))
    ends = zip(surface.points.min(axis=0), surface.points.max(axis=0), high - low + 1, strict=True)
    x, y, z = (np.linspace(*line) for line in ends)
    return Voxels(np.argwhere(inside), np.eye(3), (x, y, z))


def require_topology(inside: Flags, handles: int) -> None:
    """Raise unless a set of voxels (i, j, k) bounds one solid of the given genus.

    Raises
    ------
    InputError : it does not.
    """
    found = topology(inside)
    if found.parts != 1 or found.outsides != 1:
        raise InputError(f"the cuboids form {found.parts} parts with {found.outsides - 1} closed holes, not one solid")
    if found.pinched:
        raise InputError(f"the cuboids touch themselves at an edge or a corner ({found.pinched} such grid points)")
    if found.genus != handles:
        raise InputError(f"the cuboids form a solid of genus {found.genus}, but the surface has genus {handles}")


def _on_grids(
    surface: Surface, handles: int, rotation: Array, number: float, fullness: float
) -> Fitted | None:
    """The best set on grids with so many voxels along the longest axis; None if there is none."""
    points = surface.points @ rotation.T
    low, high = points.min(axis=0), points.max(axis=0)
    spacing = float((high - low).max()) / number
    ni, nj, nk = (int(n) for n in np.ceil((high - low) / spacing) + 3)
    shape = (ni, nj, nk)
    smooth = smooth_points()
    found: dict[Any, tuple[float, float, int, Array, Flags]] = {}
    for shift in np.ndindex(2, 2, 2):
        origin = (low + high - spacing * (np.array(shape) - shift)) / 2
        share = _lifted(shares(surface, rotation, origin, spacing, shape), fullness)
        for threshold in THRESHOLDS:
            inside = np.zeros(shape, dtype=bool)
            inside[1:-1, 1:-1, 1:-1] = share[1:-1, 1:-1, 1:-1] > threshold
            defects, energy, faces = _relax(inside, share, smooth, handles, SMOOTHING)
            if defects == 0:
                key = (*shift, inside.tobytes())
                found[key] = energy + SMOOTHING * faces, energy / share.sum(), faces, origin, inside
    for _, mismatch, faces, origin, inside in sorted(found.values(), key=lambda one: one[0]):
        if handles == 0 or lies_like(surface, rotation, origin, spacing, inside):
            x, y, z = (start + spacing * np.arange(n + 1) for start, n in zip(origin, shape, strict=True))
            voxels = Voxels(np.argwhere(inside), rotation, (x, y, z))
            reach = _reach((points - origin) / spacing, inside)
            return Fitted(voxels, int(faces), number, float(mismatch), reach)
    return None


def lies_like(surface: Surface, rotation: Array, origin: Array, spacing: float, inside: Flags) -> bool:
    """Whether voxels lie in space as the solid does, judged on a grid a few times finer."""
    times = int(np.ceil(FINE / max(inside.shape)))
    shape = (inside.shape[0] * times, inside.shape[1] * times, inside.shape[2] * times)
    solid = shares(surface, rotation, origin, spacing / times, shape) > 0.5
    return deforms(solid, np.kron(inside, np.ones((times, times, times), dtype=bool)))


def _reach(points: Array, inside: Flags) -> float:
    """Largest distance, along an axis, of points (v, 3) in units of voxels from a set of voxels."""
    middles = cKDTree(np.argwhere(inside) + 0.5)
    return max(0.0, float(middles.query(points, p=np.inf)[0].max()) - 0.5)


def _lifted(share: Array, fullness: float) -> Array:
    """Shares enlarged so that ``fullness`` counts as a half, and twice as much as all."""
    return np.asarray(np.minimum(share / (2.0 * fullness), 1.0))


def shares(surface: Surface, rotation: Array, origin: Array, spacing: float, shape: tuple[int, int, int]) -> Array:
    """Share (i, j, k) of each voxel of a grid that lies inside the surface."""
    points = (surface.points @ rotation.T - origin) / spacing
    return np.asarray(_shares(points, surface.triangles, shape[0], shape[1], shape[2], LINES))


@njit(cache=True)
def _shares(points, triangles, ni, nj, nk, lines):  # type: ignore[no-untyped-def]
    """Every crossing of a line adds its sign times the part of the line beyond it; a running sum gives the shares."""
    steps = np.zeros((ni + 2, nj, nk))
    for t in range(len(triangles)):
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        area = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        if area == 0.0:
            continue
        low_j = int(np.ceil(min(a[1], b[1], c[1]) * lines - 0.5))
        high_j = int(np.floor(max(a[1], b[1], c[1]) * lines - 0.5))
        low_k = int(np.ceil(min(a[2], b[2], c[2]) * lines - 0.5))
        high_k = int(np.floor(max(a[2], b[2], c[2]) * lines - 0.5))
        for j in range(max(low_j, 0), min(high_j, nj * lines - 1) + 1):
            # The irrational shifts keep lines off vertices of regular triangulations.
            y = (j + 0.5) / lines + 1.234567e-7
            for k in range(max(low_k, 0), min(high_k, nk * lines - 1) + 1):
                z = (k + 0.5) / lines + 2.718281e-7
                s = ((y - a[1]) * (c[2] - a[2]) - (z - a[2]) * (c[1] - a[1])) / area
                r = ((b[1] - a[1]) * (z - a[2]) - (b[2] - a[2]) * (y - a[1])) / area
                if s < 0.0 or r < 0.0 or s + r > 1.0:
                    continue
                x = a[0] + s * (b[0] - a[0]) + r * (c[0] - a[0])
                sign = -1.0 if area > 0.0 else 1.0
                i = int(np.floor(x))
                if i < 0:
                    i, x = 0, 0.0
                if i >= ni:
                    continue
                steps[i, j // lines, k // lines] += sign * (i + 1 - x)
                steps[i + 1, j // lines, k // lines] += sign * (x - i)
    result = np.zeros((ni, nj, nk))
    total = np.zeros((nj, nk))
    for i in range(ni):
        total += steps[i]
        result[i] = total
    return result / lines**2


@njit(cache=True)
def _keeps(inside, smooth, i, j, k):  # type: ignore[no-untyped-def]
    """Whether the set stays what it is, as a shape, when a voxel joins or leaves it."""
    if not simple(inside[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2]):
        return False
    inside[i, j, k] = not inside[i, j, k]
    kept = True
    for a in range(i - 1, i + 1):
        for b in range(j - 1, j + 1):
            for c in range(k - 1, k + 1):
                pattern = 0
                for v in range(8):
                    if inside[a + (v >> 2), b + (v >> 1 & 1), c + (v & 1)]:
                        pattern |= 1 << v
                kept &= smooth[pattern]
    inside[i, j, k] = not inside[i, j, k]
    return kept


@njit(cache=True)
def _relax(inside, share, smooth, genus, weight):  # type: ignore[no-untyped-def]
    """Mend the topology of the set in place by single voxels, then lower its energy.

    Returns defects, energy without the faces' part, and faces.
    """
    ni, nj, nk = inside.shape
    defects = defects_of(inside, smooth, genus)
    for _ in range(inside.size):
        best, best_defects, where = np.inf, defects, (0, 0, 0)
        for i in range(1, ni - 1):
            for j in range(1, nj - 1):
                for k in range(1, nk - 1):
                    here = inside[i, j, k]
                    alike = 0
                    for axis in range(3):
                        for step in (-1, 1):
                            u = i + (step if axis == 0 else 0)
                            v = j + (step if axis == 1 else 0)
                            w = k + (step if axis == 2 else 0)
                            alike += inside[u, v, w] == here
                    if alike == 6:
                        continue
                    change = (2.0 * share[i, j, k] - 1.0) * (1.0 if here else -1.0) + weight * (2.0 * alike - 6.0)
                    if defects == 0 and change >= min(best, -1e-9):
                        continue
                    if defects == 0:
                        now = 0
                        better = _keeps(inside, smooth, i, j, k)
                    else:
                        inside[i, j, k] = not here
                        now = defects_of(inside, smooth, genus)
                        inside[i, j, k] = here
                        better = now < best_defects or (now < defects and now == best_defects and change < best)
                    if better:
                        best, best_defects, where = change, now, (i, j, k)
        if best == np.inf:
            break
        inside[where] = not inside[where]
        defects = best_defects
    energy = 0.0
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                energy += 1.0 - share[i, j, k] if inside[i, j, k] else share[i, j, k]
    return defects, energy, topology_of(inside, smooth)[4]
