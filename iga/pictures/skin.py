"""Skins: exact points, normals and element edges of what is seen of a domain.

Each facet is evaluated on a grid of its own. A cut takes away elements (or clips along the plane itself) and closes the
opening: with the faces that two neighbours shared, or with the section through the elements.

Axis letters: f facet, q point of the grid on a facet, t triangle of that grid, k curve, m point of a curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iga.cells import LINE, Cell
from iga.domain import Domain, Facets, Space
from iga.errors import InputError
from iga.facets import exposed, named
from iga.field import Field
from iga.sampling import Quantity, Samples, bounding_box, evaluate, subdivision

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TRIANGLES = 400_000
"""About how many triangles a skin may have: sets the grid on each facet."""
_NOTHING_LEFT = "there is nothing to draw: the cut takes all elements away"


@dataclass(frozen=True)
class Cut:
    """What is taken away so that the inside shows: elements whose centre lies beyond a plane.

    Attributes
    ----------
    normal : points to the side taken away; (3,), or a signed axis such as "x" or "-y".
    origin : a point of the plane; by default the centre of the domain's box.
    smooth : cut along the plane itself, not along the elements.
    """

    normal: str | Sequence[float]
    origin: Sequence[float] | None = None
    smooth: bool = False


@dataclass(frozen=True, eq=False)
class Plane:
    """A cut with its unit normal (3,) and origin (3,)."""

    normal: Array
    origin: Array
    smooth: bool

    def height(self, x: Array) -> Array:
        """Signed distance (...) of points (..., 3); positive is taken away."""
        return (x - self.origin) @ self.normal


@dataclass(frozen=True, eq=False)
class Skin:
    """A tessellated surface of exact points.

    Attributes
    ----------
    points, normals : (n, 3)
    triangles : (t, 3)
    part : (t,) number of the named boundary, -1 for none.
    values : (n,) or None.
    lines : edges of elements, arrays (k, m, 3) of polylines.
    """

    points: Array
    normals: Array
    triangles: Index
    part: Index
    values: Array | None
    lines: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class _Shown:
    """What is evaluated on a skin: a quantity and a displacement (n, 3), or None."""

    domain: Domain
    quantity: Quantity | None
    space: Space
    warp: Array | None


def tessellate(
    domain: Domain,
    quantity: Quantity | None = None,
    space: Space | None = None,
    plane: Plane | None = None,
    warp: Array | None = None,
    pieces: int = 0,
) -> Skin:
    """Triangles, exact normals and element edges of the skin of a domain, or of what a cut leaves of it.

    Parameters
    ----------
    quantity, space : what to evaluate at the points (its length, if it has several components).
    plane : what to take away.
    warp : displacement coefficients (n, 3) in the domain's functions.
    pieces : parts of each element edge; 0 chooses by the number of facets.

    Raises
    ------
    InputError : the cut takes all elements away.
    """
    shown = _Shown(domain, quantity, space or domain.space, warp)
    facets = _visible(domain, plane)
    count = sum(len(f.elements) for _, f in facets)
    if not count:
        raise InputError(_NOTHING_LEFT)
    n = pieces or int(np.clip(np.sqrt(TRIANGLES / (2 * count)), 1, 16))
    skin = _join([_on_facets(shown, number, f, n) for number, f in facets])
    return _clipped(shown, skin, plane, n) if plane is not None and plane.smooth else skin


def _on_facets(shown: _Shown, part: int, facets: Facets, n: int) -> Skin:
    """Grid of n x n on every facet of one kind."""
    domain = shown.domain
    cell = domain.space.blocks[facets.block].basis.cell
    face = cell.faces[facets.face]
    s, pieces = _surface_grid(face.cell, n)
    samples = Samples(domain, facets.block, facets.elements, face.origin + s @ face.axes.T)
    x, J = samples.x, samples.J
    if shown.warp is not None:
        x = x + samples.at(shown.warp)
        J = J + samples.reference_gradient(shown.warp)
    tangents = J @ face.axes
    values = None
    if shown.quantity is not None:
        if not isinstance(shown.quantity, np.ndarray):  # gradients do not exist where the cell is degenerate
            samples = replace(samples, points=samples.points * 0.999 + 0.001 * cell.centre)
        found = evaluate(shown.quantity, shown.space, samples)
        values = (found[..., 0] if found.shape[-1] == 1 else np.linalg.norm(found, axis=-1)).ravel()
    f, q = x.shape[:2]
    triangles = (np.arange(f)[:, None, None] * q + pieces).reshape(-1, 3)
    sides = [x[:, _side(face.cell, n, int(a), int(b))] for a, b in face.cell.edges]
    return Skin(
        x.reshape(-1, 3), _unit(np.cross(tangents[..., 0], tangents[..., 1])).reshape(-1, 3), triangles,
        np.full(len(triangles), part), values, (np.concatenate(sides),),
    )  # fmt: skip


def _unit(normals: Array) -> Array:
    """Normals (f, q, 3) of length one; where a facet collapses, the normal of its middle is the best there is."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    middle = normals.mean(axis=1, keepdims=True)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-300)
    flat = length <= 1e-9 * length.max(axis=1, keepdims=True)
    return np.where(flat, middle, normals / np.where(flat, 1.0, length))


@cache
def _surface_grid(cell: Cell, n: int) -> tuple[Array, Index]:
    """Points (q, 2) and triangles (t, 3) on a triangle or quadrilateral."""
    points, cells = subdivision(cell, n)
    if cells.shape[1] == 4:
        cells = cells[:, [[0, 2, 3], [0, 3, 1]]].reshape(-1, 3)
    return points, cells


@cache
def _side(cell: Cell, n: int, a: int, b: int) -> Index:
    """Numbers of the grid's points along the side from vertex a to vertex b."""
    points = subdivision(cell, n)[0]
    t = subdivision(LINE, n)[0]
    wanted = cell.vertices[a] + t * (cell.vertices[b] - cell.vertices[a])
    return np.abs(points[None] - wanted[:, None]).max(axis=-1).argmin(axis=1)


def _join(parts: list[Skin]) -> Skin:
    """Skins as one."""
    starts = np.cumsum([0, *(len(p.points) for p in parts)])
    values = [p.values for p in parts if p.values is not None]
    return Skin(
        np.concatenate([p.points for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.triangles + start for p, start in zip(parts, starts)]),
        np.concatenate([p.part for p in parts]),
        np.concatenate(values) if values else None,
        tuple(line for p in parts for line in p.lines),
    )


# --- cuts ------------------------------------------------------------------------------------------------------------


def plane_of(domain: Domain, cut: Cut | str | None) -> Plane | None:
    """Return the plane of a cut, or None.

    Raises
    ------
    InputError : the normal is neither an axis nor three numbers, or the origin is no point.
    """
    if cut is None:
        return None
    if isinstance(cut, str):
        cut = Cut(cut)
    if isinstance(cut.normal, str):
        axis = cut.normal.lstrip("+-")
        if axis not in ("x", "y", "z"):
            raise InputError(f"a cut is along x, y or z, perhaps with a sign, not {cut.normal!r}")
        normal = np.eye(3)["xyz".index(axis)] * (-1.0 if cut.normal.startswith("-") else 1.0)
    else:
        normal = np.asarray(cut.normal, dtype=float)
        if normal.shape != (3,) or not 0.0 < np.linalg.norm(normal) < np.inf:
            raise InputError(f"the normal of a cut is three numbers, not all zero: {cut.normal!r}")
        normal = normal / np.linalg.norm(normal)
    origin = bounding_box(domain).mean(axis=0) if cut.origin is None else np.asarray(cut.origin, dtype=float)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise InputError(f"the origin of a cut is a point with three coordinates: {cut.origin!r}")
    return Plane(normal, origin, cut.smooth)


def _visible(domain: Domain, plane: Plane | None) -> list[tuple[int, Facets]]:
    """Facets to draw with the number of their boundary, -1 for none."""
    if domain.boundaries and (plane is None or plane.smooth):
        return named(domain)
    keep = []
    for number, block in enumerate(domain.space.blocks):
        if plane is None or plane.smooth:
            keep.append(np.ones(block.elements, dtype=bool))
            continue
        centre = Samples(domain, number, np.arange(block.elements), block.basis.cell.centre[None]).x[:, 0]
        keep.append(plane.height(centre) <= 0.0)
    return [*named(domain, keep), *((-1, f) for f in exposed(domain, keep))]


def _clipped(shown: _Shown, skin: Skin, plane: Plane, n: int) -> Skin:
    """Clip the skin by the plane and close it with the section through the sampled elements."""
    import pyvista as pv

    mesh = pv.PolyData(skin.points, faces(skin.triangles))
    mesh.point_data["normals"] = skin.normals
    mesh.cell_data["part"] = skin.part
    if skin.values is not None:
        mesh.point_data["values"] = skin.values
    kept = mesh.clip(normal=plane.normal, origin=plane.origin, invert=True).triangulate()
    if not kept.n_cells:
        raise InputError(_NOTHING_LEFT)
    outside = Skin(
        np.asarray(kept.points, dtype=float), np.asarray(kept.point_data["normals"]), _triangles(kept),
        np.asarray(kept.cell_data["part"]), None if skin.values is None else np.asarray(kept.point_data["values"]),
        tuple(line[plane.height(line).max(axis=1) <= 0.0] for line in skin.lines),
    )  # fmt: skip
    section = _section(shown, plane, n)
    return outside if section is None else _join([outside, section])


def _section(shown: _Shown, plane: Plane, n: int) -> Skin | None:
    """Where the plane meets the sampled elements; None where it passes beside the solid."""
    import pyvista as pv

    from iga.exchange.export import linear_grid

    fields: dict[str, Any] = {}
    if shown.quantity is not None:
        quantity = shown.quantity
        fields["shown"] = Field(shown.space, quantity) if isinstance(quantity, np.ndarray) else quantity
    if shown.warp is not None:
        fields["moved"] = shown.warp
    count = shown.domain.space.elements
    fine = int(np.clip((TRIANGLES / max(count, 1)) ** (1 / 3), 1, 10))
    volume = pv.wrap(linear_grid(replace(shown.domain, attributes={}), fields, fine))
    if shown.warp is not None:
        volume.points = volume.points + volume.point_data["moved"]
    section = volume.slice(normal=plane.normal, origin=plane.origin).triangulate()
    if not section.n_cells:
        return None
    triangles = _triangles(section)
    points = np.asarray(section.points, dtype=float)
    corners = points[triangles]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ plane.normal < 0.0
    triangles[turned] = triangles[turned][:, ::-1]
    values = None
    if shown.quantity is not None:
        found = np.asarray(section.point_data["shown"])
        values = found if found.ndim == 1 else np.linalg.norm(found, axis=1)
    lines = _section_edges(shown, plane, n)
    return Skin(
        points, np.tile(plane.normal, (len(points), 1)), triangles, np.full(len(triangles), -1), values, (lines,)
    )


def _section_edges(shown: _Shown, plane: Plane, n: int) -> Array:
    """Segments (k, 2, 3) where the plane meets the faces of the elements it goes through."""
    import pyvista as pv

    meshes = []
    for number, block in enumerate(shown.domain.space.blocks):
        samples = Samples(shown.domain, number, np.arange(block.elements), subdivision(block.basis.cell, 2)[0])
        x = samples.x if shown.warp is None else samples.x + samples.at(shown.warp)
        height = plane.height(x)
        crossed = np.flatnonzero((height.min(axis=1) <= 0.0) & (height.max(axis=1) >= 0.0))
        bare = replace(shown, quantity=None)
        if len(crossed):
            for k in range(len(block.basis.cell.faces)):
                skin = _on_facets(bare, -1, Facets(number, k, crossed), min(n, 8))
                meshes.append(pv.PolyData(skin.points, faces(skin.triangles)))
    if not meshes:
        return np.empty((0, 2, 3))
    cut = pv.merge(meshes, merge_points=False).extract_surface(algorithm="dataset_surface")
    lines = cut.slice(normal=plane.normal, origin=plane.origin)
    if not lines.n_cells:
        return np.empty((0, 2, 3))
    return np.asarray(lines.points, dtype=float)[lines.lines.reshape(-1, 3)[:, 1:]]


def faces(triangles: Index) -> Index:
    """Triangles (t, 3) in VTK's flat layout."""
    return np.column_stack([np.full(len(triangles), 3), triangles]).ravel()


def _triangles(mesh: Any) -> Index:
    """Triangles (t, 3) of a PyVista surface that has no others."""
    flat = np.asarray(mesh.faces if mesh.n_cells else [], dtype=np.int64)
    return flat.reshape(-1, 4)[:, 1:].copy()
