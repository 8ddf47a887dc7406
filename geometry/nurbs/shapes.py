r"""Solids built from code, exact and free of degenerate faces, with natural boundary names.

Every builder takes its measures and returns a `Multipatch`; `SHAPES` lists them by name for `source.build`, which adds
elevation and refinement. Angles are in degrees. Planes of a box or of symmetry are named ``x0`` (lower) and ``x1``
(upper) and so on, curved faces by what they are (``inner``, ``outer``, ``hole``), ends of a sweep ``start``, ``end``.

The shell of the sphere is six rational patches of degree 4 (J. Cobb, Tiling the sphere with rational Bezier patches,
University of Utah, 1988): the stereographic image (2 u w, 2 v w, w^2 - u^2 - v^2) / (w^2 + u^2 + v^2) of the
biquadratic planar patch (u, v, w) between the four circular arcs to which the edges of a cube project. A quarter of
one is a third of an octant.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb, prod

import numpy as np
from numpy.typing import NDArray

from geometry.knots import normalised
from geometry.nurbs.multipatch import Multipatch, Name, glue
from geometry.nurbs.sweep import arc, disc, extrude, quadrilateral, rectangle, revolve, ruled
from geometry.patch import Patch, elevate, face_of, from_homogeneous, homogeneous, insert, split
from iga.errors import InputError

Array = NDArray[np.float64]

MAX_ENTRIES = 4e9
"""Most entries of the tables of a patch: functions on an element times elements. More is a mistake in a setting."""


def _positive(**measures: float) -> None:
    for what, value in measures.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{what} is {value:g}; it must be positive")


def _planes(patches: list[Patch], planes: dict[str, tuple[int, float]]) -> list[Name]:
    """Names of faces that lie in a coordinate plane, {name: (axis, value)}."""
    size = max(float(np.abs(p.control).max()) for p in patches)
    return [
        (name, number, f)
        for number, p in enumerate(patches)
        for f in range(6)
        for name, (axis, value) in planes.items()
        if np.abs(face_of(p, f).control[..., axis] - value).max() < 1e-12 * size
    ]


def box(length: float = 1.0, width: float = 1.0, height: float = 1.0, degree: int = 1, elements: int = 1) -> Multipatch:
    """Box [0, length] x [0, width] x [0, height] as one B-spline patch of maximal smoothness.

    Parameters
    ----------
    degree : of all directions.
    elements : knot intervals in each direction.
    """
    _positive(length=length, width=width, height=height, elements=elements)
    patch = extrude(rectangle(0, length, 0, width), 0, height)
    return Multipatch((_uniform(elevate(patch, _above(degree, 1)), elements),), np.zeros((0, 7), dtype=np.int64))


def cube(side: float = 1.0, degree: int = 1, elements: int = 1) -> Multipatch:
    """Cube [0, side]^3 as one B-spline patch of maximal smoothness."""
    return box(side, side, side, degree, elements)


def bench_cube(degree: int = 2, elements: int = 8) -> Multipatch:
    """Unit cube with the interior map x + (0.3, -0.3, 0.2) g, g = 4 X(1-X) Y(1-Y) Z(1-Z), maximal smoothness.

    Parameters
    ----------
    degree : at least 2, so that the map is exact.
    elements : knot intervals in each direction.
    """
    _positive(elements=elements)
    bubble = np.array([0.0, 0.5, 0.0])  # Bernstein coefficients of X (1 - X)
    g = 4.0 * np.einsum("i,j,k->ijk", bubble, bubble, bubble)
    grid = np.stack(np.meshgrid(*(np.array([0.0, 0.5, 1.0]),) * 3, indexing="ij"), axis=-1)
    knots = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    patch = Patch((knots,) * 3, grid + g[..., None] * np.array([0.3, -0.3, 0.2]))
    return Multipatch((_uniform(elevate(patch, _above(degree, 2)), elements),), np.zeros((0, 7), dtype=np.int64))


def _above(degree: int, lowest: int) -> int:
    if degree < lowest:
        raise InputError(f"degree {degree} cannot hold this shape; it needs at least {lowest}")
    if degree > 30:
        raise InputError(f"degree {degree} is above 30")
    return degree - lowest


def _uniform(patch: Patch, elements: int) -> Patch:
    """Cut each direction of a Bezier patch on [0, 1] into equal knot intervals."""
    if elements > 4096:
        raise InputError(f"{elements} elements in each direction are more than 4096")
    entries = prod(elements * (q + 1.0) for q in patch.degree)
    if entries > MAX_ENTRIES:
        raise InputError(f"{elements} elements in each direction need {entries:.0e} table entries; take less")
    for axis in range(3):
        patch = insert(patch, axis, np.arange(1, elements) / elements)
    return patch


def thick_ring(inner: float = 1.0, outer: float = 2.0, height: float = 1.0, angle: float = 90.0) -> Multipatch:
    """Sector of a thick cylinder about the z axis (directions: radius, angle, height); 360 degrees closes on itself.

    Boundaries: inner, outer, start, end (if not closed), z0, z1.
    """
    _positive(inner=inner, **{"outer - inner": outer - inner}, height=height)
    patch = revolve(rectangle(inner, outer, 0, height), angle)
    names = [(name, 0, f) for f, name in enumerate(("inner", "outer", "start", "end", "z0", "z1"))]
    return glue([patch], names, where="thick_ring")


def hollow_sphere_octant(inner: float = 1.0, outer: float = 2.0) -> Multipatch:
    """Octant x, y, z >= 0 of a hollow sphere: three patches of degree (1, 4, 4) without a pole.

    Boundaries: inner, outer, and the planes of symmetry x0, y0, z0.
    """
    _positive(inner=inner, **{"outer - inner": outer - inner})
    _, cap = split(split(_sphere_face(), 0, 0.5)[1], 1, 0.5)  # x, y >= 0 of the face around +z
    patches = []
    for turn in range(3):
        radial = np.roll(homogeneous(cap)[..., :3], turn, axis=-1)
        weight = homogeneous(cap)[..., 3:]
        values = np.stack([np.concatenate([r * radial, weight], axis=-1) for r in (inner, outer)])
        patches.append(from_homogeneous((np.array([0.0, 0.0, 1.0, 1.0]), *map(normalised, cap.knots)), values))
    names = [(name, p, f) for p in range(3) for f, name in enumerate(("inner", "outer"))]
    names += _planes(patches, {"x0": (0, 0.0), "y0": (1, 0.0), "z0": (2, 0.0)})
    return glue(patches, names, where="hollow_sphere_octant")


def _sphere_face() -> Patch:
    """The face around +z of the unit sphere's cube tiling, biquartic on [0, 1]^2, normal outward."""
    corner = (np.sqrt(3.0) - 1.0) / 2.0
    w = np.cos(np.deg2rad(15.0))
    middle = w * (np.sqrt(2.0) / w - 1.0)  # homogeneous: each edge is an arc of 30 degrees about (-1, 0) and the like
    u = np.array([[-corner, -middle, -corner], [0.0, 0.0, 0.0], [corner, middle, corner]])
    weights = np.array([[1.0, w, 1.0], [w, w * w, w], [1.0, w, 1.0]])
    u[0, 1], u[2, 1] = -middle, middle
    v = u.T
    knots = np.concatenate([np.zeros(5), np.ones(5)])
    square = _product(weights, weights)
    radius = _product(u, u) + _product(v, v)
    values = np.stack([2 * _product(u, weights), 2 * _product(v, weights), square - radius, square + radius], axis=-1)
    return from_homogeneous((knots, knots), values)


def _product(a: Array, b: Array) -> Array:
    """Bernstein coefficients of the product of two tensor polynomials, (p+1, p+1) each."""
    p = len(a) - 1
    binomial = np.array([comb(p, i) for i in range(p + 1)], dtype=float)
    twice = np.array([comb(2 * p, i) for i in range(2 * p + 1)], dtype=float)
    a, b = (c * np.multiply.outer(binomial, binomial) for c in (a, b))
    result = np.zeros((2 * p + 1, 2 * p + 1))
    for i in range(p + 1):
        for j in range(p + 1):
            result[i : i + p + 1, j : j + p + 1] += a[i, j] * b
    return result / np.multiply.outer(twice, twice)


def ball(radius: float = 1.0, core: float = 0.5) -> Multipatch:
    """Solid ball about the origin: a cube and six patches up to the exact sphere, all of degree 4, regular everywhere.

    Parameters
    ----------
    core : distance of the cube's corners from the centre, relative to the radius.

    Boundary: sphere.
    """
    _positive(radius=radius)
    if not 0.1 <= core <= 0.8:
        raise InputError(f"core is {core:g}; it must lie between 0.1 and 0.8")
    half = core * radius / np.sqrt(3.0)
    cap = _sphere_face()
    outside = homogeneous(cap) * np.array([radius, radius, radius, 1.0])
    u = np.linspace(-half, half, 5)
    flat = np.stack([*np.meshgrid(u, u, indexing="ij"), np.full((5, 5), half)], axis=-1)
    inside = np.concatenate([flat, np.ones((5, 5, 1))], axis=-1)
    radial = np.array([0.0, 0.0, 1.0, 1.0])
    outer = [Patch((np.repeat([0.0, 1.0], 5),) * 3, np.stack(np.meshgrid(u, u, u, indexing="ij"), axis=-1))]
    for axis in range(3):
        for side in (1.0, -1.0):
            turned = np.stack([inside, outside])
            turned[..., :3] = np.roll(turned[..., :3] * np.array([1.0, side, side]), axis + 1, axis=-1)
            outer.append(elevate(from_homogeneous((radial, *map(normalised, cap.knots)), turned), (3, 0, 0)))
    return glue(outer, [("sphere", p, 1) for p in range(1, 7)], where="ball")


def cylinder(radius: float = 1.0, height: float = 1.0, core: float = 0.5) -> Multipatch:
    """Solid cylinder about the z axis: a square prism and four outer patches, regular everywhere.

    Parameters
    ----------
    core : distance of the square's corners from the axis, relative to the radius.

    Boundaries: outer, z0, z1.
    """
    _positive(radius=radius, height=height)
    if not 0.1 <= core <= 0.9:
        raise InputError(f"core is {core:g}; it must lie between 0.1 and 0.9")
    patches = [extrude(p, 0, height) for p in disc(radius, core)]
    names = [("outer", p, 1) for p in range(1, 5)] + [(z, p, f) for p in range(5) for z, f in (("z0", 4), ("z1", 5))]
    return glue(patches, names, where="cylinder")


def torus(major: float = 2.0, minor: float = 0.5, angle: float = 90.0, core: float = 0.5) -> Multipatch:
    """Part of a solid torus about the z axis, of circular section, swept through an angle; 360 degrees close it.

    Parameters
    ----------
    major : distance of the section's centre from the axis.
    minor : radius of the section.

    Boundaries: outer, start, end (if not closed).
    """
    _positive(minor=minor, **{"major - minor": major - minor})
    if not 0.1 <= core <= 0.9:
        raise InputError(f"core is {core:g}; it must lie between 0.1 and 0.9")
    patches = []
    for profile in disc(minor, core):
        moved = profile.control + np.array([major, 0.0, 0.0])
        patches.append(revolve(Patch(profile.knots, moved, profile.weights), angle))
    names = [("outer", p, 1) for p in range(1, 5)]
    names += [(end, p, f) for p in range(5) for end, f in (("start", 2), ("end", 3))]
    return glue(patches, names, where="torus")


def plate_with_hole(radius: float = 1.0, size: float = 4.0, thickness: float = 1.0) -> Multipatch:
    """Quarter x, y >= 0 of a square plate with a circular hole, two patches, extruded along z.

    Parameters
    ----------
    size : half of the side of the whole plate.

    Boundaries: hole, the planes of symmetry x0, y0, the far sides x1, y1, and z0, z1.
    """
    _positive(radius=radius, **{"size - radius": size - radius}, thickness=thickness)
    knots, eighth = arc(45)
    patches = []
    for turn, ends in ((0.0, ((size, 0.0), (size, size))), (45.0, ((size, size), (0.0, size)))):
        c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
        curve = radius * (eighth[:, :2] / eighth[:, 2:]) @ np.array([[c, s], [-s, c]])
        curve[np.abs(curve) < 1e-15 * radius] = 0.0
        a, b = np.array(ends)
        side = np.stack([a, 0.5 * (a + b), b])
        patches.append(extrude(ruled((knots, curve, eighth[:, 2]), (knots, side, np.ones(3))), 0, thickness))
    names = [("hole", p, 0) for p in (0, 1)] + _planes(
        patches,
        {"x0": (0, 0.0), "y0": (1, 0.0), "x1": (0, size), "y1": (1, size), "z0": (2, 0.0), "z1": (2, thickness)},
    )
    return glue(patches, names, where="plate_with_hole")


def fichera(side: float = 1.0) -> Multipatch:
    """Cube [-side, side]^3 without the octant of positive coordinates: seven cubes around a re-entrant corner.

    Boundaries: the outer planes x0 .. z1, and reentrant for the three faces at the missing octant.
    """
    _positive(side=side)
    patches, names = [], []
    for index in np.ndindex(2, 2, 2):
        if index == (1, 1, 1):
            continue
        low = [(i - 1) * side for i in index]
        flat = quadrilateral(np.array([
            [low[0] + a * side, low[1] + b * side] for a in (0, 1) for b in (0, 1)
        ]))
        patches.append(extrude(flat, low[2], low[2] + side))
    planes = {f"{'xyz'[d]}{s}": (d, (2 * s - 1) * side) for d in range(3) for s in (0, 1)}
    names += _planes(patches, planes)
    # The faces at 0 of the cubes that lie next to the missing octant are the only other free ones.
    for number, p in enumerate(patches):
        centre = p.control.reshape(-1, 3).mean(axis=0)
        if (centre > 0).sum() == 2:
            names.append(("reentrant", number, 2 * int(np.argmin(centre)) + 1))
    return glue(patches, names, where="fichera")


SHAPES: dict[str, Callable[..., Multipatch]] = {
    f.__name__: f
    for f in (box, cube, thick_ring, hollow_sphere_octant, ball, cylinder, torus, plate_with_hole, fichera, bench_cube)
}
