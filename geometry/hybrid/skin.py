r"""Watertight skin of a trimmed B-rep: curvilinear triangles that share the coefficients of their common curves.

Every edge of the solid is cut into cubic pieces, once, and both faces take the same pieces: the skin is watertight by
construction. Every face is triangulated in a chart (`geometry.hybrid.triangulation`) with those pieces for boundary;
interior edges are cubics fitted to the surface, and the inner control point of each triangle is the one of quadratic
precision, moved along the normal until the triangle is as near to the surface as it can be. Where the distance to the
CAD surface exceeds the tolerance, or the straight skeleton cuts through itself, elements are made smaller and the skin
is built again.

Rational faces are approximated by polynomials, to the tolerance, because the cells of the volume on the skin are
polynomial; planes are met to rounding. The distance is measured at samples of each element, by projection to the
surface.

Axis letters: e element, n function, q sample, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.brep import Brep, Curve, Face, curve_points, surface_frame
from geometry.hybrid.chart import Chart, chart_points, make_chart, to_chart, to_parameters
from geometry.hybrid.crossing import crossing_pairs
from geometry.hybrid.curves import fit_cubics
from geometry.hybrid.sizing import Sizing, divide_edge, size_at, size_edges
from geometry.hybrid.triangulation import Triangulation, triangulate
from iga.bernstein import bernstein
from iga.block import Block
from iga.cells import TRIANGLE
from iga.domain import Space
from iga.errors import InputError
from iga.progress import QUIET, Progress
from iga.quadrature import gauss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 8
PATIENCE = 2
"""Rounds without improvement by a third after which refinement stops: what is left is the file's gap, or a cusp."""
SMOOTH = 2.3
"""Boundary vertices with a larger angle (radians) inside the face must not be the tip of an ear."""


@dataclass(frozen=True, eq=False)
class Skin:
    """A watertight closed surface of Bernstein cells.

    Attributes
    ----------
    space : blocks of two-dimensional cells, outward normals by x_xi x x_eta; functions 0 .. vertices - 1 are the
        vertices of the mesh, the others belong to edges and elements.
    points : (n, 3) control points.
    vertices : number of vertices.
    faces : for each block, the CAD face of each element (e,).
    names : name of each CAD face; pieces of a face that was split at its seam share one.
    curves : (s, 3) mesh edges that lie on CAD edges: two vertices and the number of the CAD edge.
    edge_to_edge : no hanging nodes.
    report : distances, areas, volume, ... (see `build_skin`).
    """

    space: Space
    points: Array
    vertices: int
    faces: tuple[Index, ...]
    names: tuple[str, ...]
    curves: Index
    edge_to_edge: bool = True
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "report", MappingProxyType(dict(self.report)))


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of one edge: parameters (m + 1,), vertices (m + 1,), control points (m, 4, 3)."""

    ends: Array
    vertices: Index
    control: Array


@dataclass(frozen=True, eq=False)
class _FaceMesh:
    """A meshed face: chart vertices, their global numbers, triangles of local numbers, and its chart."""

    mesh: Triangulation
    vertices: Index
    chart: Chart


def build_skin(
    brep: Brep, size: float = 0.2, tolerance: float = 2e-5, where: str = "", progress: Progress = QUIET
) -> Skin:
    """Skin of a solid.

    Parameters
    ----------
    brep : the solid.
    size : largest element, relative to the diagonal.
    tolerance : wanted distance to the CAD surfaces, relative to the diagonal.
    where : name for messages.

    Returns
    -------
    The skin; its report holds ``elements``, ``max_distance`` and ``exact_area_share`` (elements within 1e-9 of the
    diagonal), ``watertight_gap``, ``worst_face``, ``volume``, ``volume_error``, ``crossings``, ``min_quality``,
    ``folded``.

    Raises
    ------
    InputError : a face cannot be meshed, by name.
    """
    if not (0.0 < size <= 1.0 and 1e-10 <= tolerance <= 0.1):
        raise InputError(f"{where or brep.name}: size must lie in (0, 1] and tolerance in [1e-10, 0.1]")
    where = where or brep.name or "solid"
    base, wanted = size_edges(brep, size)
    charts = [make_chart(face) for face in brep.faces]
    sizing = base
    least = _least_pieces(brep)
    best: tuple[float, Skin] | None = None
    stuck = 0
    for _ in progress.track(range(ROUNDS), "skin"):
        edges, count = _cut_edges(brep, sizing, wanted, least, tolerance)
        try:
            meshes = _mesh_faces(brep, charts, edges, count, sizing, where)
        except _FaceError as error:
            for loop in brep.faces[error.face].loops:
                for c in loop:
                    if not brep.edges[c.edge].degenerate:
                        least[c.edge] = 2 * (len(edges[c.edge].ends) - 1)
            if max(least) > 3000:
                raise InputError(str(error)) from error
            failed: InputError | None = error
            continue
        failed = None
        skin, finer = _assemble(brep, edges, meshes, count, tolerance)
        badness = float(skin.report["crossings"] + skin.report["folded"]) * 1e6 + skin.report["max_distance"]
        stuck = 0 if best is None or badness < 0.7 * best[0] else stuck + 1
        if best is None or badness < best[0]:
            best = (badness, skin)
        if len(finer.points) == 0 or stuck == PATIENCE:
            break
        sizing = Sizing(np.concatenate([sizing.points, finer.points]), np.concatenate([sizing.size, finer.size]))
    if best is None:
        raise InputError(str(failed))
    return best[1]


class _FaceError(InputError):
    """A face that cannot be meshed with the pieces that its edges have."""

    def __init__(self, face: int, message: str):
        super().__init__(message)
        self.face = face


def _least_pieces(brep: Brep) -> list[int]:
    """One piece at least; three on closed edges; two where edges share both ends."""
    seen: dict[tuple[int, ...], list[int]] = {}
    for e, edge in enumerate(brep.edges):
        if not edge.degenerate:
            seen.setdefault(tuple(sorted(edge.vertices)), []).append(e)
    least = [1] * len(brep.edges)
    for ends, edges in seen.items():
        for e in edges:
            least[e] = 3 if ends[0] == ends[1] else 2 if len(edges) > 1 else 1
    return least


def _cut_edges(
    brep: Brep, sizing: Sizing, wanted: list[Array], least: list[int], tolerance: float
) -> tuple[list[_Pieces], int]:
    """Pieces of all edges, and the number of vertices so far."""
    count = len(brep.vertices)
    pieces = []
    samples = np.linspace(0.0, 1.0, len(next(w for w in wanted if len(w))))
    for e, edge in enumerate(brep.edges):
        if edge.degenerate:
            pieces.append(_Pieces(np.array([0.0, 1.0]), np.array(edge.vertices), np.zeros((1, 4, 3))))
            continue
        h = np.minimum(wanted[e], size_at(sizing, curve_points(edge.curve, samples)))
        fewest = least[e]
        for _ in range(6):
            ends = divide_edge(brep, e, h, fewest)
            m = len(ends) - 1
            numbers = np.concatenate([[edge.vertices[0]], count + np.arange(m - 1), [edge.vertices[1]]])
            x = curve_points(edge.curve, ends)
            x[0], x[-1] = brep.vertices[edge.vertices[0]], brep.vertices[edge.vertices[1]]

            control, distance = fit_cubics(partial(_edge_points, edge.curve, ends), x[:-1], x[1:])
            # Vertices may lie off the curve by as much as the file says.
            if distance.max() <= 0.5 * tolerance * brep.diagonal + edge.tolerance:
                break
            fewest = 2 * m
        pieces.append(_Pieces(ends, numbers, control))
        count += m - 1
    return pieces, count


def _edge_points(curve: Curve, ends: Array, s: Array) -> Array:
    """Points (m, k, 3) of the pieces of an edge at their own parameters (m, k)."""
    t = ends[:-1, None] + np.diff(ends)[:, None] * s
    return curve_points(curve, t.ravel()).reshape(*s.shape, 3)


def _mesh_faces(
    brep: Brep, charts: list[Chart], edges: list[_Pieces], count: int, sizing: Sizing, where: str
) -> list[_FaceMesh]:
    """Triangulations of all faces, without interior edges between vertices that are joined elsewhere."""
    taken = {tuple(sorted(pair)) for p in edges for pair in zip(p.vertices[:-1].tolist(), p.vertices[1:].tolist())}
    meshes = []
    for f, (face, chart) in enumerate(zip(brep.faces, charts)):
        forced: set[tuple[int, int]] = set()
        for _ in range(6):
            made = _mesh_face(brep, f, face, chart, edges, count, sizing, forced, f"{where}: {face.name}")
            pairs = _interior_pairs(made)
            double = [(a, b) for (a, b), g in pairs.items() if g in taken]
            if not double:
                break
            forced |= set(double)
        taken |= set(pairs.values())
        count += len(made.mesh.vertices) - int((made.vertices < count).sum())
        meshes.append(made)
    return meshes


def _interior_pairs(made: _FaceMesh) -> dict[tuple[int, int], tuple[int, int]]:
    """Interior edges by local vertices, with their global vertices."""
    t = made.mesh.triangles
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(sides, axis=0, return_counts=True)
    inner = unique[counts == 2]
    ends = np.sort(made.vertices[inner], axis=1)
    return {(a, b): (c, d) for (a, b), (c, d) in zip(inner.tolist(), ends.tolist())}


def _mesh_face(
    brep: Brep, number: int, face: Face, chart: Chart, edges: list[_Pieces], count: int, sizing: Sizing,
    forced: set[tuple[int, int]], where: str,
) -> _FaceMesh:  # fmt: skip
    q: list[Array] = []
    names: list[Index] = []
    loops: list[Index] = []
    smooth: list[NDArray[np.bool_]] = []
    placed = 0
    for loop in face.loops:
        ring: list[Array] = []
        corners: list[tuple[int, Array, Array, Array]] = []
        size = 0
        for c in loop:
            if brep.edges[c.edge].degenerate:
                continue
            piece = edges[c.edge]
            t, v = (piece.ends[::-1], piece.vertices[::-1]) if c.reversed else (piece.ends, piece.vertices)
            uv = curve_points(c.curve, t)
            ring.append(to_chart(chart, uv[:-1]))
            names.append(v[:-1])
            control = piece.control[::-1, ::-1] if c.reversed else piece.control
            corners.append((size, control[0, 1] - control[0, 0], control[-1, 3] - control[-1, 2], uv[0]))
            size += len(t) - 1
        if size < 3:
            raise _FaceError(number, f"{where}: a loop of {size} pieces")
        flags = np.ones(size, dtype=bool)
        for i, (place, leaving, _, uv0) in enumerate(corners):
            _, du, dv = surface_frame(face.surface, uv0[None])
            flags[place] = _inner_angle(corners[i - 1][2], leaving, np.cross(du, dv)[0]) > SMOOTH
        q.append(np.concatenate(ring))
        loops.append(placed + np.arange(size))
        smooth.append(flags)
        placed += size
    boundary = np.concatenate(q)
    middle = boundary.mean(axis=0)

    def frame(at: Array) -> tuple[Array, Array]:
        x, du, dv = surface_frame(face.surface, to_parameters(chart, at))
        n = np.cross(du, dv)
        length = np.linalg.norm(n, axis=1)
        flat = length < 1e-6 * (np.median(length) if len(length) > 2 else 0.0)
        if flat.any():  # a pole: the normal beside it
            _, du, dv = surface_frame(face.surface, to_parameters(chart, at + 1e-4 * (middle - at)))
            n[flat] = np.cross(du, dv)[flat]
        return x, n / (np.linalg.norm(n, axis=1)[:, None] + 1e-300)

    try:
        mesh = triangulate(
            boundary, loops, np.concatenate(smooth), frame, lambda x: size_at(sizing, x), forced, where
        )
    except InputError as error:
        raise _FaceError(number, str(error)) from error
    own = np.concatenate([np.concatenate(names), count + np.arange(len(mesh.vertices) - placed)])
    return _FaceMesh(mesh, own, chart)


def _inner_angle(arriving: Array, leaving: Array, normal: Array) -> float:
    """Angle inside a region on the left of a boundary that arrives and leaves along given directions."""
    size = np.linalg.norm(normal)
    if size == 0.0:
        return 0.0
    turn = np.arctan2(np.dot(np.cross(arriving, leaving), normal / size), np.dot(arriving, leaving))
    return float(np.pi - turn)


_PLACES = np.array([(a, b, 4 - a - b) for a in (1, 2) for b in (1, 2) if a + b < 4] + [(1.2, 1.4, 1.4)]) / 4.0
_CHECKS = np.array([(a, b, 6 - a - b) for a in range(7) for b in range(7 - a)]) / 6.0


def _assemble(
    brep: Brep, edges: list[_Pieces], meshes: list[_FaceMesh], count: int, tolerance: float
) -> tuple[Skin, Sizing]:
    """Skin from the meshes of the faces, and where elements must be smaller."""
    basis = bernstein(TRIANGLE, 3)
    vertices = int(max(m.vertices.max() for m in meshes)) + 1
    x = np.full((vertices, 3), np.nan)
    x[: len(brep.vertices)] = brep.vertices
    pieces: dict[tuple[int, int], Array] = {}
    curves = []
    for e, piece in enumerate(edges):
        if brep.edges[e].degenerate:
            continue
        x[piece.vertices] = np.concatenate([piece.control[:, 0], piece.control[-1:, 3]])
        for a, b, control in zip(piece.vertices[:-1].tolist(), piece.vertices[1:].tolist(), piece.control):
            pieces[min(a, b), max(a, b)] = control[1:3] if a < b else control[2:0:-1]
            curves.append((a, b, e))
    for made in meshes:
        inner = np.isnan(x[made.vertices, 0])
        x[made.vertices[inner]] = chart_points(made.chart, made.mesh.vertices[inner])
    for made in meshes:
        pairs = _interior_pairs(made)
        if pairs:
            local, ends = np.array(list(pairs)), np.array(list(pairs.values()))
            local = np.where((made.vertices[local[:, 0]] == ends[:, 0])[:, None], local, local[:, ::-1])
            line = (made.chart, made.mesh.vertices[local[:, 0]], made.mesh.vertices[local[:, 1]])
            control, _ = fit_cubics(
                partial(_line_points, *line), x[ends[:, 0]], x[ends[:, 1]], partial(_line_normals, *line)
            )
            pieces.update(zip(map(tuple, ends.tolist()), control[:, 1:3]))
    keys = np.array(sorted(pieces))
    values = np.array([pieces[tuple(k)] for k in keys.tolist()])
    used, compact = np.unique(keys, return_inverse=True)  # vertices without an edge (inside a seam) are dropped
    renumber = np.full(vertices, -1)
    renumber[used] = np.arange(len(used))
    keys = compact.reshape(keys.shape)
    x = x[used]
    triangles = np.concatenate([
        renumber[m.vertices[m.mesh.triangles[:, ::-1] if face.reversed else m.mesh.triangles]]
        for m, face in zip(meshes, brep.faces)
    ])
    owner = np.repeat(np.arange(len(meshes)), [len(m.mesh.triangles) for m in meshes])
    dofs, total = _dofs(triangles, keys, len(x))
    control = np.zeros((total, 3))
    control[: len(x)] = x
    control[len(x) : len(x) + 2 * len(keys)] = values.reshape(-1, 3)
    inside = _inside(basis.exponents)
    local = control[dofs]
    corner, side = (basis.exponents == 3).any(axis=1), (basis.exponents == 2).any(axis=1)
    local[:, inside] = 0.25 * local[:, side].sum(axis=1) - local[:, corner].sum(axis=1) / 6.0
    distance = np.zeros(len(triangles))
    folded = np.zeros(len(triangles), dtype=bool)
    start = 0
    for f, made in enumerate(meshes):
        part = slice(start, start + len(made.mesh.triangles))
        start = part.stop
        face = brep.faces[f]
        turned = made.mesh.triangles[:, ::-1] if face.reversed else made.mesh.triangles
        q = made.mesh.vertices[turned]
        local[part], distance[part], folded[part] = _fit_inside(face, made.chart, q, local[part], inside)
    control[dofs[:, inside]] = local[:, inside]
    space = Space((Block(basis, dofs),), total)
    report, finer = _report(brep, control, dofs, triangles, x, owner, distance, folded, tolerance)
    names = tuple(face.name for face in brep.faces)
    curve_rows = np.array([(renumber[a], renumber[b], e) for a, b, e in curves], dtype=np.int64).reshape(-1, 3)
    return Skin(space, control, len(x), (owner,), names, curve_rows, True, report), finer


def _line_points(chart: Chart, a: Array, b: Array, s: Array) -> Array:
    """Points (m, k, 3) of straight lines of the chart from a to b (m, 2) at parameters (m, k)."""
    q = a[:, None] + s[..., None] * (b - a)[:, None]
    return chart_points(chart, q.reshape(-1, 2)).reshape(*s.shape, 3)


def _line_normals(chart: Chart, a: Array, b: Array, s: Array) -> Array:
    """Unit normals of the surface along such lines; a little beside their ends, which may be poles."""
    q = a[:, None] + np.clip(s, 1e-3, 1.0 - 1e-3)[..., None] * (b - a)[:, None]
    _, du, dv = surface_frame(chart.face.surface, to_parameters(chart, q.reshape(-1, 2)))
    n = np.cross(du, dv)
    return np.asarray(n / (np.linalg.norm(n, axis=1)[:, None] + 1e-300)).reshape(*s.shape, 3)


def _inside(exponents: Index) -> int:
    return int(np.flatnonzero((exponents == 1).all(axis=1))[0])


def _dofs(triangles: Index, keys: Index, vertices: int) -> tuple[Index, int]:
    """Function numbers (e, 10): vertices, then two on each edge from its lower vertex, then one in each triangle."""
    basis = bernstein(TRIANGLE, 3)
    base = vertices + 1
    codes = keys[:, 0] * base + keys[:, 1]
    order = np.argsort(codes)
    dofs = np.zeros((len(triangles), basis.n), dtype=np.int64)
    for column, exponent in enumerate(basis.exponents.tolist()):
        if 3 in exponent:
            dofs[:, column] = triangles[:, exponent.index(3)]
        elif 0 in exponent:
            near, far = triangles[:, exponent.index(2)], triangles[:, exponent.index(1)]
            code = np.minimum(near, far) * base + np.maximum(near, far)
            edge = order[np.searchsorted(codes[order], code)]
            dofs[:, column] = vertices + 2 * edge + (near > far)
        else:
            dofs[:, column] = vertices + 2 * len(keys) + np.arange(len(triangles))
    return dofs, vertices + 2 * len(keys) + len(triangles)


def _fit_inside(
    face: Face, chart: Chart, q: Array, local: Array, inside: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Move inner control points (e, 10, 3) along the normal; distance to the surface and whether elements fold.

    Where normals turn, distances can be lowered by moving along the surface too, which pays unless the element folds.
    """
    made, distance, folded = _fit_damped(face, chart, q, local, inside, 0.0002)
    if folded.any():
        made[folded], distance[folded], folded[folded] = _fit_damped(
            face, chart, q[folded], local[folded], inside, 0.03
        )
    return made, distance, folded


def _fit_damped(
    face: Face, chart: Chart, q: Array, local: Array, inside: int, share: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The same with one damping of moves along the surface."""
    basis = bernstein(TRIANGLE, 3)
    local = local.copy()
    values = basis.tabulate(_PLACES[:, 1:], 0)[0]
    weight = values[:, inside]
    uv = to_parameters(chart, np.einsum("kv,evd->ekd", _PLACES, q).reshape(-1, 2))
    damping = share * float(weight @ weight) * np.eye(3)
    for _ in range(4):
        x = np.einsum("kn,enc->ekc", values, local)
        uv, gap, normal = _project(face, uv, x.reshape(-1, 3))
        n = normal.reshape(*x.shape)
        g = gap.reshape(x.shape[:2])
        A = np.einsum("k,ekc,ekd->ecd", weight**2, n, n) + damping
        local[:, inside] += np.linalg.solve(A, np.einsum("k,ek,ekc->ec", weight, g, n)[..., None])[..., 0]
    values, gradients = basis.tabulate(_CHECKS[:, 1:], 1)
    x = np.einsum("kn,enc->ekc", values, local)
    start = to_parameters(chart, np.einsum("kv,evd->ekd", _CHECKS, q).reshape(-1, 2))
    _, gap, normal = _project(face, start, x.reshape(-1, 3))
    distance = np.abs(gap).reshape(x.shape[:2]).max(axis=1)
    J = np.einsum("knd,enc->ekcd", gradients, local)
    own = np.cross(J[..., 0], J[..., 1])
    normal = normal.reshape(own.shape)
    cosine = np.einsum("ekc,ekc->ek", own, normal) * (-1.0 if face.reversed else 1.0)
    size = np.linalg.norm(own, axis=-1).max(axis=1)
    folded = (cosine < 1e-3 * size[:, None]) & (normal != 0.0).any(axis=-1)
    return local, distance, folded.any(axis=1)


def _project(face: Face, uv: Array, x: Array, rounds: int = 4) -> tuple[Array, Array, Array]:
    """Foot points: parameters, signed distance along the unit normal of the surface, that normal (zero at poles)."""
    for _ in range(rounds):
        s, du, dv = surface_frame(face.surface, uv)
        J = np.stack([du, dv], axis=-1)
        metric = np.einsum("qci,qcj->qij", J, J)
        metric += 1e-12 * np.trace(metric, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        step = np.linalg.solve(metric, np.einsum("qci,qc->qi", J, x - s)[..., None])[..., 0]
        uv = uv + step
    s, du, dv = surface_frame(face.surface, uv)
    n = np.cross(du, dv)
    length = np.linalg.norm(n, axis=1)
    pole = length <= 1e-6 * np.median(length)
    n = np.where(pole[:, None], 0.0, n / (length[:, None] + 1e-300))
    away = np.einsum("qc,qc->q", n, x - s)
    return uv, -away, n


def _report(
    brep: Brep, control: Array, dofs: Index, triangles: Index, x: Array, owner: Index, distance: Array,
    folded: NDArray[np.bool_], tolerance: float,
) -> tuple[dict[str, Any], Sizing]:  # fmt: skip
    basis = bernstein(TRIANGLE, 3)
    rule = gauss(TRIANGLE, 5)
    values, gradients = basis.tabulate(rule.points, 1)
    local = control[dofs]
    X = np.einsum("kn,enc->ekc", values, local)
    J = np.einsum("knd,enc->ekcd", gradients, local)
    normal = np.cross(J[..., 0], J[..., 1])
    volume = float(np.einsum("k,ekc,ekc->", rule.weights, X - x.mean(axis=0), normal)) / 3.0
    area = np.einsum("k,ek->e", rule.weights, np.linalg.norm(normal, axis=-1))
    exact = distance <= 1e-9 * brep.diagonal
    pairs = crossing_pairs(x, triangles)
    corners = x[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    quality = 2.0 * np.sqrt(3.0) * flat / (sides**2).sum(axis=1)
    worst = int(distance.argmax())
    report = {
        "elements": len(triangles), "max_distance": float(distance.max() / brep.diagonal),
        "worst_face": brep.faces[int(owner[worst])].name, "exact_area_share": float(area[exact].sum() / area.sum()),
        "area": float(area.sum()), "volume": volume, "volume_error": abs(volume / brep.volume - 1.0),
        "watertight_gap": _gap(local, triangles) / brep.diagonal, "crossings": len(pairs),
        "folded": int(folded.sum()), "min_quality": float(quality.min()),
    }  # fmt: skip
    bad = folded.copy()
    bad[pairs.ravel()] = True
    coarse = distance > tolerance * brep.diagonal
    shrink = np.where(bad, 0.5, np.clip((tolerance * brep.diagonal / (distance + 1e-300)) ** 0.25, 0.4, 0.6))
    some = bad | coarse
    return report, Sizing(corners[some].mean(axis=1), (sides.max(axis=1) * shrink)[some])


def _gap(local: Array, triangles: Index) -> float:
    """Largest distance between the two sides of mesh edges, evaluated independently from both elements."""
    s = np.linspace(0.0, 1.0, 5)
    zero = np.zeros_like(s)
    basis = bernstein(TRIANGLE, 3)
    found: dict[tuple[int, int], Array] = {}
    worst = 0.0
    traces = []
    for path in (np.stack([s, zero], 1), np.stack([1 - s, s], 1), np.stack([zero, 1 - s], 1)):
        traces.append(np.einsum("kn,enc->ekc", basis.tabulate(path, 0)[0], local))
    for e, row in enumerate(triangles.tolist()):
        for k in range(3):
            a, b = row[k], row[(k + 1) % 3]
            other = found.pop((b, a), None)
            if other is None:
                found[a, b] = traces[k][e]
            else:
                worst = max(worst, float(np.abs(other[::-1] - traces[k][e]).max()))
    if found:
        a, b = next(iter(found))
        raise InputError(f"mesh edge {a} - {b} of the skin has one element: the skin is not closed")
    return worst
