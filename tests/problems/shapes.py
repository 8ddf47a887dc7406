"""Curved test solids from maps of the unit cube, interpolated in a Bernstein space of any degree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein, greville
from iga.cells import HEXAHEDRON
from iga.chunk import facet_chunks
from iga.conforming import Complex, bezier_domain, boundary
from iga.domain import Domain, Facets

Array = NDArray[np.float64]
Map = Callable[[Array], Array]


def solid(
    maps: list[Map], counts: tuple[int, int, int], degree: int, names: dict[str, Callable[[Array], NDArray[np.bool_]]]
) -> Domain:
    """Solid made of images of the unit cube, each cut into ``counts`` elements and glued where vertices coincide.

    ``names`` tells the boundary that a facet belongs to from its points (f, q, 3) -> (f, q); the rest is called "rest".
    """
    basis = bernstein(HEXAHEDRON, degree)
    nodes = greville(basis)
    to_bernstein = np.linalg.inv(basis.tabulate(nodes, 0)[0])
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    local = [(grid + points) / np.array(counts) for points in (nodes, HEXAHEDRON.vertices)]
    coefficients = np.concatenate([to_bernstein @ f(local[0]) for f in maps])
    corners = np.concatenate([f(local[1]) for f in maps])
    vertices = np.unique(np.round(corners.reshape(-1, 3), 9) + 0.0, axis=0, return_inverse=True)[1].reshape(-1, 8)
    mesh = Complex(((HEXAHEDRON, vertices.astype(np.int64)),))
    domain = bezier_domain(mesh, degree, [coefficients], boundaries={"all": boundary(mesh)})
    named: dict[str, list[Facets]] = {}
    for facets in boundary(mesh):
        for chunk in facet_chunks(domain, (facets,), size=10**9):
            left = np.ones(len(chunk.elements), dtype=bool)
            for name, test in names.items():
                hit = left & test(chunk.x).all(axis=1)
                left &= ~hit
                if hit.any():
                    named.setdefault(name, []).append(Facets(facets.block, facets.face, chunk.elements[hit]))
            if left.any():
                named.setdefault("rest", []).append(Facets(facets.block, facets.face, chunk.elements[left]))
    return Domain(domain.space, domain.points, {name: tuple(f) for name, f in named.items()})


def on_planes(size: Array) -> dict[str, Callable[[Array], NDArray[np.bool_]]]:
    """Names x0, x1, y0, ... of the sides of a box from the origin."""
    tests = {}
    for axis, letter in enumerate("xyz"):
        for end, value in enumerate((0.0, float(size[axis]))):
            tests[f"{letter}{end}"] = lambda x, axis=axis, value=value: np.abs(x[..., axis] - value) < 1e-9
    return tests


def box(counts: tuple[int, int, int], degree: int, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Domain:
    """Box from the origin with sides x0, x1, y0, y1, z0, z1."""
    return solid([lambda s: s * np.array(size)], counts, degree, on_planes(np.array(size)))


def bent_box(n: int, degree: int) -> Domain:
    """Unit cube with curved interior and plane sides."""

    def bend(s: Array) -> Array:
        bump = np.prod(np.sin(np.pi * s), axis=-1, keepdims=True)
        return s + 0.1 * bump * np.array([1.0, -0.7, 0.5])

    return solid([bend], (n, n, n), degree, on_planes(np.ones(3)))


def sphere_octant(n: int, degree: int, inner: float = 1.0, outer: float = 2.0) -> Domain:
    """Octant of a hollow sphere: sides inner, outer, x0, y0, z0."""

    def patch(turn: int) -> Map:
        def to_sphere(s: Array) -> Array:
            # the part of the octant nearest one axis: a quadrilateral from the axis over two edge middles to (1, 1, 1)
            a, b = s[..., 0], s[..., 1]
            direction = np.stack([np.ones_like(a), np.tan(np.pi / 4 * a), np.tan(np.pi / 4 * b)], axis=-1)
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            return np.roll(direction * (inner + (outer - inner) * s[..., 2:]), turn, axis=-1)

        return to_sphere

    return solid(
        [patch(k) for k in range(3)],
        (n, n, n),
        degree,
        {
            "x0": lambda x: np.abs(x[..., 0]) < 1e-9,
            "y0": lambda x: np.abs(x[..., 1]) < 1e-9,
            "z0": lambda x: np.abs(x[..., 2]) < 1e-9,
            "inner": lambda x: np.linalg.norm(x, axis=-1) < 0.5 * (inner + outer),
            "outer": lambda x: np.linalg.norm(x, axis=-1) > 0.5 * (inner + outer),
        },
    )


def cylinder_sector(n: int, degree: int, inner: float = 1.0, outer: float = 2.0, height: float = 1.0) -> Domain:
    """Quarter of a thick cylinder about z: sides inner, outer, x0, y0, z0, z1."""

    def turn(s: Array) -> Array:
        r, angle = inner + (outer - inner) * s[..., 0], np.pi / 2 * s[..., 1]
        return np.stack([r * np.cos(angle), r * np.sin(angle), height * s[..., 2]], axis=-1)

    return solid(
        [turn],
        (n, n, max(1, n // 2)),
        degree,
        {
            **{k: v for k, v in on_planes(np.array([9e9, 9e9, height])).items() if k in ("x0", "y0", "z0", "z1")},
            "inner": lambda x: np.hypot(x[..., 0], x[..., 1]) < 0.5 * (inner + outer),
            "outer": lambda x: np.hypot(x[..., 0], x[..., 1]) > 0.5 * (inner + outer),
        },
    )


def plate_with_hole(n: int, degree: int, radius: float = 1.0, half: float = 4.0, thickness: float = 1.0) -> Domain:
    """Quarter of a square plate with a hole: sides hole, x0, y0, x1, y1 (at half), z0, z1."""

    def patch(upper: bool) -> Map:
        def to_plate(s: Array) -> Array:
            angle = np.pi / 4 * s[..., 1]
            edge = np.stack([np.full_like(angle, half), half * np.tan(angle)], axis=-1)
            hole = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            t = s[..., :1]
            plane = (1 - t) * hole + t * edge
            if upper:
                plane = plane[..., ::-1]
            return np.concatenate([plane, thickness * s[..., 2:]], axis=-1)

        return (
            (lambda s: to_plate(np.concatenate([s[..., :1], 1 - s[..., 1:2], s[..., 2:]], axis=-1)))
            if upper
            else to_plate
        )

    return solid(
        [patch(False), patch(True)],
        (n, n, max(1, n // 4)),
        degree,
        {
            **on_planes(np.array([half, half, thickness])),
            "hole": lambda x: np.hypot(x[..., 0], x[..., 1]) < 0.5 * (radius + half),
        },
    )


def fichera(n: int, degree: int) -> Domain:
    """The cube (-1, 1)^3 less the octant x, y, z > 0: one boundary, "outside"."""
    corners = [c for c in ((i, j, k) for i in (-1, 0) for j in (-1, 0) for k in (-1, 0)) if c != (0, 0, 0)]
    return solid(
        [lambda s, c=c: s + np.array(c, dtype=float) for c in corners],
        (n, n, n),
        degree,
        {"outside": lambda x: x[..., 0] < 9.0},
    )
