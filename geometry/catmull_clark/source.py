r"""The geometry source "catmull_clark": hexahedral meshes as smooth volumes.

Input is a mesh of hexahedra in a format of meshio, or the name of a shape: "box", "ball", "round_ball", "tetrahedron",
"ring", "fan_3", "fan_5", "fan_6" or "fan_8" (cells around one edge).

    interpolate   "auto" (default), "pia", "conjugate", "direct", "pushback", "butterfly" or "none"
    features      "auto" (default), "none", an angle in degrees, or a text file with the creases (two vertex numbers on
                  a line) and corners (one); vertices are counted as the cells use them, from 0
    depth         levels of subdivision of irregular cells before they are closed; "auto" (default): 2, 1 or 0, as the
                  number of pieces and their validity allow
    space         "catmull_clark" (default), or "optimal": see `optimal`
    repair        move control points until every cell is certified (default false)
    bound         sharpen the proved bound of how far the closures are from the limit, see `closure` (default false;
                  takes seconds to minutes)
    pillow        put one new layer of cells under the whole boundary first (default false), see `pillowing`
    lambda, mu, gamma    shape parameters of push-back, in (0, 1) (defaults 1/4, 1/8, 1/16): a number, the name of an
                  attribute whose mean over the vertices of each edge, face, cell is taken, or (from Python) one number
                  for each
    relaxation    factor of PIA, in (0, 2) (default 1)
    attributes    names of point data to carry, separated by commas; by default all

"auto" is PIA where the result is valid. Interpolation overshoots on coarse meshes and can fold cells of a mesh that is
itself fine; where it folds cells that the approximating volume keeps valid, interior control points nearby are moved,
so that the boundary is interpolated exactly and interior vertices as far as validity allows; a mesh that folds without
interpolation is left alone. The other settings interpolate every vertex, come what may. ``repair`` does the same
wherever cells are invalid; where that does not suffice, because faces of the boundary fold or meet in one plane across
an edge, boundary points are freed too, on springs that let them slide along the surface before they leave it, and all
go back as far as validity allows (see `repair`). The report says how many boundary vertices are no longer interpolated
and how far the surface is from them.

Refinement is one subdivision step of control points and attributes; the optimal space is built anew on the subdivided
mesh, over the map of the input mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark import interpolation
from geometry.catmull_clark.closure import closure_distance, hull_distance
from geometry.catmull_clark.domain import build_domain
from geometry.catmull_clark.features import smooth_folds, with_features
from geometry.catmull_clark.interpolation import Interpolation
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import SUFFIXES, HexMesh, hex_mesh, read_hexes
from geometry.catmull_clark.optimal import build_optimal
from geometry.catmull_clark.pillowing import pillow
from geometry.catmull_clark.repair import repair, surface_distance
from geometry.catmull_clark.settings import NAME, Parameter, Settings, parse
from geometry.catmull_clark.shapes import SHAPES
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import CORNER, CREASE, INTERIOR, SMOOTH, Topology, build_topology, with_kinds
from geometry.inputs import require_file
from iga.certificate import SIGN_ALONE, certify
from iga.domain import Domain, Provenance, with_report
from iga.errors import InputError
from iga.progress import QUIET, Progress, progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]

name = NAME
PIECES = 30_000
"""Pieces up to which ``depth="auto"`` subdivides irregular cells."""
_GROWTH = (1, 8, 20)
"""Pieces that an irregular cell becomes, about, at depth 0, 1 and 2."""


def reads(path: str | Path) -> bool:
    """Whether a file holds a hexahedral mesh: by its ending and its cells. A shape's name is taken as well."""
    if str(path) in SHAPES:
        return True
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES or not path.is_file():
        return False
    if path.suffix.lower() == ".mesh":
        return b"Hexahedra" in path.read_bytes()
    try:
        read_hexes(path)
    except InputError:
        return False
    return True


def build(path: str | Path, **parameters: Any) -> Domain:
    """Domain from a file with a hexahedral mesh.

    Parameters
    ----------
    path : a mesh that meshio reads, or the name of a shape (see `shapes`).
    parameters : see the module docstring.

    Raises
    ------
    InputError : an unknown or ill-typed parameter, a file that cannot be read (`FormatError`) or is no conforming
        mesh of hexahedra.
    """
    settings = parse(parameters)
    mesh = hex_mesh(*SHAPES[str(path)]()) if str(path) in SHAPES else read_hexes(require_file(path, SHAPES))
    return domain_of(mesh, settings, Path(path).name, progress())


def domain_of(
    mesh: HexMesh, settings: Settings | None = None, source: str = "", shown: Progress = QUIET
) -> Domain:
    """Domain of a mesh in memory.

    Parameters
    ----------
    source : name of the input, for the provenance.
    shown : where long steps are told.
    """
    settings = settings or Settings()
    mesh = pillow(mesh) if settings.pillow else mesh
    attributes = _chosen(mesh, settings.attributes)
    topology = with_features(mesh.topology, mesh.points, settings.features)
    given, columns = _stack(mesh.points, attributes)
    result = _interpolate(topology, given, settings, mesh.attributes)
    control, invalid = _validate(result, mesh.points, settings, shown)
    moved = int((control != result.values[:, :3]).any(axis=1).sum())
    values = np.column_stack([control, result.values[:, 3:]])
    report = _report(mesh, topology, result, settings)
    report |= {"moved_vertices": moved, "invalid_closures": invalid}
    if moved:
        report |= _errors(result.topology, values, given)
    carried = {key: _column(values, at, mesh.attributes[key]) for key, at in columns.items()}
    parameters = {
        k: v if isinstance(v, str | float | bool) else "given"
        for k, v in vars(settings).items() if k not in ("attributes", "depth")
    }
    if settings.space == "optimal":
        report |= _omitted(result.topology, values[:, :3], 0, settings.bound)
        return build_optimal(result.topology, values, 0, columns, Provenance(name, source, parameters), report)
    depth = automatic_depth(result.topology) if settings.depth is None else settings.depth
    while True:
        provenance = Provenance(name, source, parameters | {"depth": depth})
        domain = build_domain(result.topology, values[:, :3].copy(), depth, carried, provenance, report)
        # Closures may be valid where the limit itself folds: an automatic depth stops before that.
        if not depth or settings.depth is not None or invalid or (certify(domain, SIGN_ALONE).verdict > 0).all():
            break
        depth -= 1
    return with_report(domain, **_omitted(result.topology, domain.points, depth, settings.bound))


def _omitted(topology: Topology, control: Array, depth: int, sharp: bool) -> dict[str, float]:
    """How far closures, which integration takes for the limit, are off: known to occur, and at most, by proof.

    Over the diagonal. The bound is the better of two if ``sharp``.
    """
    found = hull_distance(topology, control, depth)
    measured, bound = found.measured, found.bound
    if sharp:
        other = closure_distance(topology, control, depth)
        measured, bound = max(measured, other.measured), min(bound, other.bound)
    return {"closure_distance": measured, "closure_distance_bound": bound}


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Subdivide control points and attributes; the limit volume stays.

    Raises
    ------
    InputError : elevation is asked for, or the domain did not come from this source.
    """
    if elevate:
        raise InputError("Catmull-Clark solids cannot be elevated; they are cubic")
    if levels < 0:
        raise InputError(f"cannot refine {levels} times")
    topology = stored_topology(domain)
    kept = {k: v for k, v in domain.report.items() if k in _LASTING}
    if domain.provenance.parameters.get("space") == "optimal":
        arrays = domain.provenance.arrays
        columns = {
            key: slice(int(a), int(b)) for key, (a, b) in zip(domain.attributes, np.asarray(arrays["columns"]))
        }
        total = int(domain.report["levels"]) + levels
        return build_optimal(topology, np.asarray(arrays["control"]), total, columns, domain.provenance, kept)
    points = domain.points
    attributes = {key: np.asarray(values) for key, values in domain.attributes.items()}
    for _ in range(levels):
        topology, S = subdivide(topology)
        points = S @ points
        attributes = {key: S @ values for key, values in attributes.items()}
    origin = replace(domain.provenance, arrays={})
    depth = int(domain.provenance.parameters["depth"])
    report = kept | {"levels": int(domain.report.get("levels", 0)) + levels}
    domain = build_domain(topology, points, depth, attributes, origin, report)
    return with_report(domain, **_omitted(topology, points, depth, False))


_LASTING = (
    "interpolation_error", "interpolation_error_boundary", "mirrored_cells", "interpolate", "moved_vertices",
    "closure_distance", "closure_distance_bound",
)


def stored_topology(domain: Domain) -> Topology:
    """Topology and kinds from what a domain carries.

    Raises
    ------
    InputError : the domain does not carry them.
    """
    arrays = domain.provenance.arrays
    if domain.provenance.source != name or not {"hexes", "vertex_kind", "creases"} <= set(arrays):
        raise InputError("the domain carries no Catmull-Clark control mesh")
    hexes = np.asarray(arrays["hexes"], dtype=np.int64)
    topology = build_topology(hexes, len(arrays["vertex_kind"]))
    edge = topology.edge_kind.copy()
    keys = topology.edges @ np.array([topology.vertices, 1])
    creases = np.asarray(arrays["creases"], dtype=np.int64) @ np.array([topology.vertices, 1])
    edge[np.searchsorted(keys, creases)] = CREASE
    return with_kinds(topology, np.asarray(arrays["vertex_kind"], dtype=np.int8), edge, topology.face_kind)


def automatic_depth(topology: Topology) -> int:
    """Deepest of 2, 1, 0 levels that keep the number of pieces moderate."""
    irregular = int((~topology.regular_hexes).sum())
    regular = len(topology.hexes) - irregular
    for depth in (2, 1):
        if regular + _GROWTH[depth] * irregular <= PIECES:
            return depth
    return 0


def _stack(points: Array, attributes: Mapping[str, Array]) -> tuple[Array, dict[str, slice]]:
    """Points and attributes as columns of one array (v, 3 + ..), and where each attribute is."""
    parts, columns, at = [points], {}, 3
    for key, values in attributes.items():
        flat = values.reshape(len(values), -1)
        columns[key] = slice(at, at + flat.shape[1])
        parts.append(flat)
        at += flat.shape[1]
    return np.concatenate(parts, axis=1), columns


def _column(values: Array, at: slice, like: Array) -> Array:
    return np.ascontiguousarray(values[:, at] if like.ndim == 2 else values[:, at.start])


def _chosen(mesh: HexMesh, wanted: tuple[str, ...] | None) -> dict[str, Array]:
    if wanted is None:  # names with a colon are bookkeeping of file formats
        return {key: values for key, values in mesh.attributes.items() if ":" not in key}
    missing = [key for key in wanted if key not in mesh.attributes]
    if missing:
        there = ", ".join(mesh.attributes) or "none"
        raise InputError(f"the mesh has no attribute {missing[0]!r}; there are: {there}")
    return {key: mesh.attributes[key] for key in wanted}


def _interpolate(
    topology: Topology, given: Array, settings: Settings, fields: Mapping[str, Array]
) -> Interpolation:
    """Interpolate all columns at once, each scaled to its own range (the points share one)."""
    size = np.ptp(given, axis=0)
    size[:3] = interpolation.diagonal(given[:, :3])
    size[size == 0.0] = 1.0
    scaled = given / size
    method = settings.interpolate
    if method in ("auto", "pia"):
        result = interpolation.pia(topology, scaled, settings.relaxation)
        if len(result.singular) and result.error > 1e-10:
            method = "pushback"  # PIA has no fixed point here; push-back interpolates on the refined mesh
    if method == "conjugate":
        result = interpolation.conjugate(topology, scaled)
    elif method == "direct":
        result = interpolation.direct(topology, scaled)
    elif method == "pushback":
        members = (("lambda", settings.lam, topology.edges), ("mu", settings.mu, topology.faces),
                   ("gamma", settings.gamma, topology.hexes))
        result = interpolation.push_back(topology, scaled, *(_shape(*one, fields) for one in members))
    elif method == "butterfly":
        result = interpolation.through_butterfly(topology, scaled, settings.relaxation)
    elif method == "none":
        result = interpolation.plain(topology, scaled)
    return replace(result, values=result.values * size)


def _shape(key: str, value: Parameter, members: Index, fields: Mapping[str, Array]) -> float | Array:
    """A parameter of push-back as a number or one number for each entity with the vertices given."""
    if not isinstance(value, str):
        return value
    if value not in fields:
        raise InputError(f"{key} must be a number or the name of an attribute, not {value!r}")
    if fields[value].ndim != 1:
        raise InputError(f"{key}: attribute {value!r} has {fields[value].shape[1]} components, not one")
    return np.asarray(fields[value][members].mean(axis=1))


def _validate(result: Interpolation, points: Array, settings: Settings, shown: Progress) -> tuple[Array, int]:
    """Control points moved where the settings ask for it, and how many closures stay invalid; -1 if none was asked."""
    control = result.values[:, :3].copy()
    t = result.topology
    if settings.interpolate != "auto" and not settings.repair:
        return control, -1
    reference = points if t.vertices == len(points) else control
    made = repair(t, reference, control, settings.repair, shown)
    return made.control, len(made.invalid)


def _errors(topology: Topology, values: Array, given: Array) -> dict[str, float]:
    """How far the limit is from the given vertices, over the diagonal.

    Of limit points from their vertices, everywhere and on the boundary; how many boundary vertices are not
    interpolated; and of the boundary surface from them: they may have slid along it.
    """
    limit = (limit_matrix(topology) @ values[:, :3])[: len(given)]
    distance = np.linalg.norm(limit - given[:, :3], axis=1) / interpolation.diagonal(given[:, :3])
    outer = topology.vertex_kind[: len(given)] != INTERIOR
    slid = np.flatnonzero(outer)[distance[outer] > 1e-9]
    off = surface_distance(topology, values[:, :3], given[slid, :3]) if len(slid) else np.zeros(1)
    return {
        "interpolation_error": float(distance.max()),
        "interpolation_error_boundary": float(distance[outer].max()),
        "moved_boundary_vertices": len(slid),
        "boundary_distance": float(off.max()) / interpolation.diagonal(given[:, :3]),
    }


def _report(mesh: HexMesh, topology: Topology, result: Interpolation, settings: Settings) -> dict[str, Any]:
    odd = ~topology.regular_edges & (topology.edge_kind == INTERIOR)
    folds = smooth_folds(topology)
    report: dict[str, Any] = {
        "interpolate": settings.interpolate,
        "interpolation_error": result.error,
        "interpolation_error_boundary": result.error,
        "iterations": {key: len(steps) for key, steps in result.history.items()},
        "convergence_factor": result.factor,
        "singular_boundary": len(result.singular),
        "mirrored_cells": mesh.mirrored,
        "extraordinary_edges": int(odd.sum()),
        "crease_edges": int((topology.edge_kind == CREASE).sum()),
        "corners": int((topology.vertex_kind == CORNER).sum()),
        "smooth_boundary_vertices": int((topology.vertex_kind == SMOOTH).sum()),
        "folded_cells": len(folds),
    }
    if len(folds):
        report["folded_cells_first"] = folds[:20].tolist()
        report["folded_cells_cure"] = "their Jacobian vanishes on a smooth edge: use features=auto or pillow=true"
    if len(result.singular):
        report["singular_boundary_note"] = "all its vertices have three boundary faces, where PIA has no fixed point"
    return report
