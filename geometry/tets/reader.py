r"""Read linear and curved tetrahedral meshes of any Lagrange degree from the formats that meshio knows.

Node values turn into Bernstein coefficients by one small matrix per degree, the inverse of the Bernstein functions at
the nodes, so the file's geometry is kept exactly. Where the nodes of a curved tetrahedron lie depends on the format:
the documented order is used, and geometry is the safety net, the lattice through the vertices must be near the nodes.

Whatever meshio does with bad bytes (raise, print, exit) comes out as one `FormatError` that names the file.

Axis letters: e tetrahedron, n node, f boundary triangle.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from meshio._helpers import extension_to_filetypes
from meshio.gmsh import _gmsh41
from numpy.typing import NDArray

from geometry.guarded import guarded
from geometry.inputs import require_file
from geometry.tet_to_hex import degree_of
from geometry.tets.mesh import LARGEST, TetMesh, checked_mesh
from geometry.tets.order import ORDERS, node_columns, node_exponents
from iga.bernstein import bernstein, elevation, greville, lagrange_to_bernstein
from iga.cells import TETRAHEDRON
from iga.errors import FormatError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Names for messages: what a file holds instead of tetrahedra.
_PLURALS = {
    "hexahedron": "hexahedra", "wedge": "wedges", "pyramid": "pyramids", "triangle": "triangles",
    "quad": "quadrilaterals", "polyhedron": "polyhedra", "voxel": "voxels",
}
#: Median distance of nodes from the straight lattice, in longest edges, beyond which an order does not fit.
_MISFIT = 0.3
#: Formats that hold surfaces or drawings only.
SURFACES = (".obj", ".off", ".ply", ".stl", ".svg", ".wkt")


def extensions() -> tuple[str, ...]:
    """File name endings that meshio knows."""
    return tuple(sorted(extension_to_filetypes))


def read_tets(path: str | Path, tags: bool = True) -> TetMesh:
    """Read and check a tetrahedral mesh.

    Parameters
    ----------
    path : a file in a format of meshio.
    tags : name parts of the boundary by the file's physical groups, references or cell sets.

    Raises
    ------
    FormatError : the file is missing or cannot be read as what it claims to be.
    InputError : it holds no tetrahedra, cells of other kinds, or tetrahedra that make no valid mesh.
    """
    path = Path(path)
    mesh = _load(path)
    points = _points(mesh, path)
    cells = [(_kind(block.type), np.asarray(block.data)) for block in mesh.cells]
    _refuse_others(cells, path)
    blocks = [(k, _connectivity(data, len(points), path)) for k, (kind, data) in enumerate(cells) if kind == "tetra"]
    documented = "gmsh" if path.suffix.lower() == ".msh" else "vtk"
    try:
        vertices, coefficients, order = _bernstein(points, [data for _, data in blocks], documented)
        report: dict[str, Any] = {"file_degree": degree_of(coefficients.shape[1]), "order": order}
        used = np.zeros(len(points), dtype=bool)
        for _, data in blocks:
            used[data] = True
        report["isolated_nodes"] = int((~used).sum())
        groups = _groups(mesh, cells, len(points), path, report) if tags else {}
        return checked_mesh(vertices, coefficients, groups, report)
    except FormatError:
        raise
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def may_hold_tets(path: Path) -> bool:
    """Whether a mesh file has tetrahedra, has no other solid cells, or cannot be read (as `read_tets` tells)."""
    try:
        kinds = {_kind(block.type) for block in _load(path).cells}
    except InputError:
        return True
    return "tetra" in kinds or kinds.isdisjoint(("hexahedron", "wedge", "pyramid", "voxel", "polyhedron"))


def _load(path: Path) -> meshio.Mesh:
    """Meshio's answer, or a FormatError, whatever meshio does."""
    require_file(path)
    if not any(path.name.lower().endswith(ending) for ending in extensions()):
        raise FormatError(f"{path}: {path.suffix!r} is no ending of a known mesh format ({' '.join(extensions())})")
    try:
        with guarded(path) as said:
            mesh = _read_with_partial_tags(path)
    except (Exception, SystemExit) as error:
        # meshio prints the reason before it exits.
        printed = "; ".join(line.strip() for line in said.getvalue().splitlines() if "Couldn't read" not in line)
        reason = f" ({printed.strip('; ')})" if isinstance(error, SystemExit) else f" ({type(error).__name__}: {error})"
        reason = "" if reason == " ()" else reason
        if isinstance(error, ModuleNotFoundError):
            reason = f" (this format needs the Python package {error.name})"
        text = " ".join(f"cannot be read as a mesh; it may be truncated or of another format{reason}".split())
        raise FormatError(f"{path}: {text[:240]}") from None
    if path.suffix.lower() == ".msh":
        _require_sections(path)
    return mesh


def _read_with_partial_tags(path: Path) -> meshio.Mesh:
    """Read a file; Gmsh's 4.1 files with entities outside all physical groups need help.

    For those meshio lists fewer tags than cell blocks and then refuses its own lists. The groups are in the cell sets
    as well, so such lists are dropped.
    """
    try:
        return meshio.read(path)
    except ValueError as error:
        if path.suffix.lower() != ".msh" or "Incompatible cell data" not in str(error):
            raise

    def lenient(points: Any, cells: Any, cell_data: Any = None, **rest: Any) -> meshio.Mesh:
        whole = {key: values for key, values in (cell_data or {}).items() if len(values) == len(cells)}
        return meshio.Mesh(points, cells, cell_data=whole, **rest)

    strict = _gmsh41.Mesh
    _gmsh41.Mesh = lenient
    try:
        return meshio.read(path)
    finally:
        _gmsh41.Mesh = strict


def _require_sections(path: Path) -> None:
    """Gmsh files cut off inside a section are read without complaint; look for the ends."""
    content = path.read_bytes()
    for section in (b"Nodes", b"Elements"):
        if b"$" + section in content and b"$End" + section not in content:
            raise FormatError(f"{path}: section ${section.decode()} has no end, the file is truncated")


def _points(mesh: meshio.Mesh, path: Path) -> Array:
    points = np.asarray(mesh.points)
    if points.ndim != 2 or points.dtype.kind not in "fiu":
        raise FormatError(f"{path}: holds no table of node coordinates")
    if points.shape[1] != 3:
        raise InputError(f"{path}: nodes have {points.shape[1]} coordinates; a solid needs three")
    return np.ascontiguousarray(points, dtype=float)


def _kind(name: str) -> str:
    """Meshio's cell name without its number of nodes."""
    lagrange = re.fullmatch(r"VTK_LAGRANGE_(\w+)", name)
    if lagrange:
        word = lagrange[1].lower()
        return {"tetrahedron": "tetra", "quadrilateral": "quad", "curve": "line"}.get(word, word)
    return re.sub(r"\d+$", "", name)


def _refuse_others(cells: list[tuple[str, NDArray[Any]]], path: Path) -> None:
    """Only tetrahedra may fill the volume."""
    counts: dict[str, int] = {}
    for kind, data in cells:
        counts[kind] = counts.get(kind, 0) + len(data)
    lower = ("vertex", "line", "triangle", "quad", "polygon")
    volume = {k: n for k, n in counts.items() if n and k not in lower and k != "tetra"}
    said = " and ".join(f"{n} {_PLURALS.get(k, k)}" for k, n in volume.items())
    if not counts.get("tetra"):
        surface = " and ".join(f"{n} {_PLURALS.get(k, k)}" for k, n in counts.items() if n and k in lower[2:])
        raise InputError(f"{path}: holds {said or surface or 'no cells'} but no tetrahedra; give a tet mesh")
    if volume:
        raise InputError(f"{path}: holds {said} besides {counts['tetra']} tetrahedra; give a mesh of tetrahedra only")


def _connectivity(data: NDArray[Any], nodes: int, path: Path) -> Index:
    if data.ndim != 2 or data.dtype.kind not in "iu":
        raise FormatError(f"{path}: the connectivity of the cells is no table of whole numbers")
    table = data.astype(np.int64)
    bad = np.flatnonzero(((table < 0) | (table >= nodes)).any(axis=1))
    if len(bad):
        raise FormatError(f"{path}: cell {bad[0]} names a node that is not among the file's {nodes} nodes")
    return table


def _bernstein(points: Array, blocks: list[Index], documented: str) -> tuple[Index, Array, str]:
    """Vertices (e, 4) and coefficients (e, n, 3) of the highest degree in the file, and the node order."""
    degrees = [degree_of(data.shape[1]) for data in blocks]
    top = max(degrees)
    parts, orders = [], []
    for data, degree in zip(blocks, degrees):
        bad = np.argwhere(~(np.abs(points[data]) <= LARGEST))
        if len(bad):
            e, k = bad[0, :2]
            where = f"node {data[e, k]} of tetrahedron {e}"
            raise InputError(f"{where} has a coordinate that is no number up to {LARGEST:g}")
        order = "vtk" if degree <= 2 else documented
        if degree > 1:
            order = _confirm_order(points, data, degree, order)
            # meshio has already turned Gmsh's ten-node tetrahedra into VTK's order.
            orders.append(documented if degree == 2 and order == "vtk" else order)
        values = points[data[:, node_columns(degree, order)]]
        parts.append(elevation(bernstein(TETRAHEDRON, degree), (top,)) @ (nodes_to_bernstein(degree) @ values))
    vertices = np.concatenate([data[:, :4] for data in blocks])
    return vertices, np.concatenate(parts), " and ".join(dict.fromkeys(orders)) or "linear"


def nodes_to_bernstein(degree: int) -> Array:
    """Matrix (C, C) from values at the lattice points of the Bernstein functions to coefficients."""
    basis = bernstein(TETRAHEDRON, degree)
    matrix = lagrange_to_bernstein(basis, greville(basis))
    # Coefficients of a face depend on nodes of that face only: rounding must not couple others.
    held = ((basis.exponents[:, None] > 0) | (basis.exponents[None] == 0)).all(axis=2)
    return np.where(held, matrix, 0.0)


def _confirm_order(points: Array, data: Index, degree: int, documented: str) -> str:
    """The documented order if the nodes fit it, the other one if only that fits."""
    misfit = {order: _misfit(points, data, degree, order) for order in ORDERS}
    best = min(misfit, key=lambda order: misfit[order])
    order = best if misfit[documented] > max(2 * misfit[best], 0.02) else documented
    if not misfit[order] <= _MISFIT:
        raise InputError(
            f"the nodes of its tetrahedra of degree {degree} follow neither Gmsh's nor VTK's order: they lie "
            f"{misfit[order]:.2g} edge lengths off"
        )
    return order


def _misfit(points: Array, data: Index, degree: int, order: str) -> float:
    """Median over tetrahedra of the rms distance of nodes from the straight lattice, in longest edges."""
    sample = data[:: max(1, len(data) // 20000)]
    nodes = points[sample]
    straight = (node_exponents(degree, order) / degree) @ nodes[:, :4]
    ends = TETRAHEDRON.edges
    longest = np.linalg.norm(nodes[:, ends[:, 1]] - nodes[:, ends[:, 0]], axis=2).max(axis=1)
    rms = np.sqrt(((nodes - straight) ** 2).sum(axis=2).mean(axis=1))
    return float(np.median(rms / np.maximum(longest, np.finfo(float).tiny)))


def _groups(
    mesh: meshio.Mesh, cells: list[tuple[str, NDArray[Any]]], nodes: int, path: Path, report: dict[str, Any]
) -> dict[str, Index]:
    """Vertex triples (f, 3) of the boundary triangles under each name of the file."""
    names = {int(v[0]): str(n) for n, v in mesh.field_data.items() if np.shape(v) == (2,) and int(v[1]) == 2}
    found: dict[str, list[Index]] = {name: [] for name in names.values()}
    tag_name, label = _tags(mesh)
    # Sets know facets that are in several groups; a tag is only the first of them.
    sets = {name: parts for name, parts in (mesh.cell_sets or {}).items() if not name.startswith("gmsh:")}
    for k, (kind, data) in enumerate(cells):
        if kind != "triangle" or not len(data):
            continue
        triples = _connectivity(data, nodes, path)[:, :3]
        if tag_name:
            values = np.asarray(mesh.cell_data[tag_name][k]).reshape(len(triples), -1)[:, 0]
            for tag in np.unique(values).tolist():
                if (tag or tag in names) and names.get(tag) not in sets:
                    found.setdefault(names.get(tag, f"{label}_{tag}"), []).append(triples[values == tag])
        for name, parts in sets.items():
            chosen = np.asarray(parts[k] if k < len(parts) and parts[k] is not None else [])
            if chosen.size and chosen.dtype.kind in "iu":
                found.setdefault(name, []).append(triples[chosen[chosen < len(triples)].astype(np.int64)])
    regions = {str(n) for n, v in mesh.field_data.items() if np.shape(v) == (2,) and int(v[1]) == 3}
    if regions:
        report["regions"] = ", ".join(sorted(regions))
    return {name: np.concatenate([np.zeros((0, 3), dtype=np.int64), *parts]) for name, parts in found.items()}


def _tags(mesh: meshio.Mesh) -> tuple[str | None, str]:
    """The cell data that tags boundary triangles, and how unnamed tags are called."""
    if "gmsh:physical" in mesh.cell_data:
        return "gmsh:physical", "physical"
    for name, values in mesh.cell_data.items():
        if not name.startswith("gmsh:") and all(np.asarray(v).dtype.kind in "iu" for v in values):
            return name, "boundary"
    return None, ""
