"""Read closed surface triangulations from STL, OBJ, OFF and PLY files through meshio.

Texture seams split nothing: faces name vertices, not texture corners. STL has no vertices, so points equal to
rounding are one; where fans of triangles then meet in a single point, each fan gets its own vertex again.
Quadrilaterals are cut along their shorter diagonal.

Whatever meshio does with bad bytes (raise, print, exit) comes out as one `FormatError` that names the file.

Axis letters: v vertex, t triangle.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geometry.guarded import guarded
from geometry.inputs import require_file
from geometry.simplices.mending import mended
from geometry.simplices.surface import Surface, checked_surface, fans, require_numbers
from iga.errors import FormatError, InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ENDINGS = (".stl", ".obj", ".off", ".ply")
ROUNDING = 4 * 2.0**-23
"""Points of STL files closer than this part of the largest coordinate are one: a few roundings to single precision."""


class _Ending(io.BytesIO):
    """Bytes that say when they are over; meshio's reader of PLY waits for ever."""

    def readline(self, size: int | None = -1, /) -> bytes:
        line = super().readline(size)
        if not line:
            raise EOFError("the file ends too early")
        return line


def reads(path: str | Path) -> bool:
    """Whether the file looks like a surface triangulation, by its ending and its first bytes."""
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            begin = file.read(4096)
    except OSError:
        return False
    if ending == ".off":
        return begin.lstrip()[:3] == b"OFF"
    if ending == ".ply":
        return begin[:3] == b"ply"
    if ending == ".stl":
        return len(begin) >= 84 or begin.lstrip()[:5].lower() == b"solid"
    return any(line.split()[:1] in ([b"v"], [b"f"]) for line in begin.splitlines() if line.strip())


def read_surface(
    path: str | Path, mend: bool = False, crossings: bool = False
) -> tuple[Surface, dict[str, Any]]:
    """Read and check a surface.

    Parameters
    ----------
    path : an STL, OBJ, OFF or PLY file.
    mend : repair small defects (see `mending`) instead of refusing them.
    crossings : report triangles that cross each other instead of refusing them.

    Returns
    -------
    The surface and a report with vertices, triangles, genus, volume and what was done to it.

    Raises
    ------
    FormatError : the file is missing or cannot be read as what it claims to be.
    InputError : what it holds does not bound one solid; the message names the entity.
    """
    path = Path(path)
    points, triangles, report = _raw(path)
    try:
        require_numbers(points, triangles)
        separate = path.suffix.lower() == ".stl"
        if separate:
            points, triangles = _equal_points(points, triangles)
        if mend:
            points, triangles, done = mended(points, triangles)
            report["mended"] = done.report()
        if mend or separate:
            points, triangles = _split_fans(points, triangles)
        surface, found = checked_surface(points, triangles, crossings)
    except InputError as error:
        said = str(error).replace(" or build with mend=true", " by hand, mending did not do it") if mend else str(error)
        raise InputError(f"{path}: {said}") from None
    return surface, report | found


def _raw(path: Path) -> tuple[Array, Index, dict[str, Any]]:
    """Points, triangles and notes, as they are in the file."""
    mesh = _load(path)
    points = np.asarray(mesh.points)
    if points.ndim != 2 or points.dtype.kind not in "fiu" or (len(points) and points.shape[1] != 3):
        # Some OBJ files append colours to the coordinates.
        if path.suffix.lower() == ".obj" and points.ndim == 2 and points.dtype.kind == "f" and points.shape[1] == 6:
            points = points[:, :3]
        else:
            raise FormatError(f"{path}: holds no table of vertices with three coordinates")
    points = np.ascontiguousarray(points, dtype=float)
    parts: list[Index] = []
    report: dict[str, Any] = {}
    for block in mesh.cells:
        data = np.asarray(block.data)
        if block.type in ("vertex", "line") or not len(data):
            continue
        if data.ndim != 2 or data.dtype.kind not in "iu" or block.type not in ("triangle", "quad"):
            raise InputError(f"{path}: holds faces that are neither triangles nor quadrilaterals ({block.type})")
        table = data.astype(np.int64)
        if path.suffix.lower() == ".obj":
            # Negative numbers count back from the last vertex; meshio has taken one off.
            table = np.where(table < -1, table + len(points) + 1, table)
        if block.type == "quad":
            report["quadrilaterals"] = report.get("quadrilaterals", 0) + len(table)
            table = _cut(points, table)
        parts.append(table)
    if not parts:
        raise InputError(f"{path}: holds no triangles; give a closed surface triangulation")
    return points, np.concatenate(parts), report


def _cut(points: Array, quads: Index) -> Index:
    """Two triangles per quadrilateral, along the shorter diagonal; numbers out of range are left for the check."""
    if not ((quads >= 0) & (quads < len(points))).all():
        return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    length = np.linalg.norm(points[quads[:, [2, 3]]] - points[quads[:, [0, 1]]], axis=2)
    turned = np.where((length[:, 1] < length[:, 0])[:, None], np.roll(quads, -1, axis=1), quads)
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def _load(path: Path) -> meshio.Mesh:
    """Meshio's answer, or a FormatError, whatever meshio does."""
    require_file(path)
    if path.suffix.lower() not in ENDINGS:
        raise FormatError(f"{path}: {path.suffix!r} is no ending of a surface file ({' '.join(ENDINGS)})")
    try:
        with guarded(path):
            if path.suffix.lower() == ".obj":
                return meshio.read(_geometry_lines(path), file_format="obj")
            if path.suffix.lower() == ".off":
                return _read_off(path)
            if path.suffix.lower() == ".ply":
                return meshio.read(_Ending(path.read_bytes()), file_format="ply")
            return meshio.read(path, file_format="stl")
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        text = f"cannot be read as a surface; it may be truncated or of another format ({reason})"
        raise FormatError(f"{path}: {text[:240]}") from None


def _read_off(path: Path) -> meshio.Mesh:
    """Mesh of an OFF file; meshio never ends on short ones and knows triangles only."""
    lines = [line for raw in path.read_text(encoding="ascii").splitlines() if (line := raw.split("#")[0].strip())]
    if not lines or lines[0].split()[0] != "OFF":
        raise ValueError("the first word is not OFF")
    lines[0] = lines[0][3:].strip()
    lines = lines[0 if lines[0] else 1 :]
    count, faces = (int(word) for word in lines[0].split()[:2])
    if min(count, faces) < 0 or len(lines) < 1 + count + faces:
        raise ValueError(f"{count} vertices and {faces} faces are announced, {len(lines) - 1} lines follow")
    points = _table(lines[1 : 1 + count], (0, 1, 2), float)
    sides = lines[1 + count : 1 + count + faces]
    sizes = _table(sides, (0,), int)[:, 0]
    if (wrong := sizes[(sizes != 3) & (sizes != 4)]).size:
        raise ValueError(f"a face has {wrong[0]} vertices; triangles and quadrilaterals are taken")
    cells = []
    for size, kind in ((3, "triangle"), (4, "quad")):
        own = [sides[face] for face in np.flatnonzero(sizes == size)]
        if own:
            cells.append((kind, _table(own, range(1, 1 + size), int)))
    return meshio.Mesh(points, cells)


def _table(lines: list[str], columns: Sequence[int], kind: type) -> NDArray[Any]:
    """Some of the columns of lines of numbers, (lines, columns)."""
    if not lines:
        return np.empty((0, len(columns)), dtype=kind)
    return np.loadtxt(lines, dtype=kind, usecols=columns, ndmin=2)


def _geometry_lines(path: Path) -> io.StringIO:
    """Vertices and faces of an OBJ file; meshio refuses files with more texture corners than vertices."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return io.StringIO("\n".join(line for line in lines if line.split()[:1] in (["v"], ["f"])))


def _equal_points(points: Array, triangles: Index) -> tuple[Array, Index]:
    """Merge points that are equal to the rounding of STL's single precision."""
    unique, inverse = np.unique(points + 0.0, axis=0, return_inverse=True)
    near = cKDTree(unique).query_pairs(ROUNDING * float(np.abs(points).max()), output_type="ndarray")
    link = coo_array((np.ones(len(near), dtype=np.int8), (near[:, 0], near[:, 1])), shape=(len(unique),) * 2)
    label = connected_components(link, directed=False)[1]
    first = np.unique(label, return_index=True)[1]
    return unique[first], label[inverse.reshape(-1)][triangles].astype(np.int64)


def _split_fans(points: Array, triangles: Index) -> tuple[Array, Index]:
    """Give each fan of triangles its own vertex, if every edge has two triangles; leave others alone."""
    edge_of = Surface(points, triangles).edge_of
    if (np.bincount(edge_of.ravel()) != 2).any():
        return points, triangles
    fan = fans(triangles, edge_of)
    first, number = np.unique(fan, return_index=True, return_inverse=True)[1:]
    if len(first) == len(np.unique(triangles)):
        return points, triangles
    return points[triangles.ravel()[first]], number.reshape(-1, 3).astype(np.int64)
