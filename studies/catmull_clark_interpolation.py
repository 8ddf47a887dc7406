"""How do the ways of interpolating a hex mesh by a Catmull-Clark solid compare (Xie et al. 2020, Figures 1 to 6)?

Every method on the same inputs: steps of progressive iteration on the boundary and inside until the residual is 1e-12
of the diagonal, the measured convergence factor, the largest residual, how far the control points move from the
vertices, and roughness: how far limit points lie from the mean of their neighbours, squared and summed over the inner
vertices of the twice refined mesh, over the same of the approximating limit ("plain"). Push-back has the once refined
control mesh and three sets of the parameters lambda, mu, gamma of Figure 2. "butterfly" is the interpolating four-point
scheme (McDonnell et al. 2004, with our own masks at extraordinary edges and vertices): two of its levels, whose points
lie on its limit. It has no control mesh and no polynomial pieces, only points.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark import interpolation
from geometry.catmull_clark.butterfly import butterfly
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import Interpolation
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import HexMesh, hex_mesh
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan, tetrahedron
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import INTERIOR, Topology
from iga.cells import HEXAHEDRON
from iga.conforming import Complex, straight_domain
from iga.pictures.plot import plot_domain
from iga.progress import Progress
from studies.figures import drawing, plot_panels
from studies.study import Figure, Result, Size
from studies.table import Column, table

Array = NDArray[np.float64]

NAME = "catmull_clark_interpolation"
COLUMNS = (
    Column("mesh", "text", key=True),
    Column("method", "text", key=True),
    Column("vertices", "int"),
    Column("boundary_steps", "int", absolute=2),
    Column("interior_steps", "int", absolute=3),
    Column("factor", absolute=0.05, format=".3f"),
    Column("error", absolute=1e-11, format=".1e"),
    Column("moved", relative=1e-6, format=".4f"),
    Column("roughness", relative=1e-6, format=".3f"),
    Column("seconds", "time", "s"),
)
SLOPES = ()
LEVELS = 2
"""Levels of refinement on which roughness is measured and pictures are drawn."""
METHODS: dict[str, Callable[[Topology, Array], Interpolation]] = {
    "plain": interpolation.plain,
    "butterfly": interpolation.plain,
    "pia": lambda t, v: interpolation.pia(t, v, tolerance=1e-12),
    "pia, factor 1.5": lambda t, v: interpolation.pia(t, v, 1.5, tolerance=1e-12),
    "pia, factor 1.8": lambda t, v: interpolation.pia(t, v, 1.8, tolerance=1e-12),
    "conjugate gradients": lambda t, v: interpolation.conjugate(t, v, tolerance=1e-12),
    "direct": interpolation.direct,
    "push-back 0.05 0.05 0.05": lambda t, v: interpolation.push_back(t, v, 0.05, 0.05, 0.05),
    "push-back 0.25 0.125 0.0625": interpolation.push_back,
    "push-back 0.25 0.25 0.25": lambda t, v: interpolation.push_back(t, v, 0.25, 0.25, 0.25),
}


def run(size: Size, progress: Progress) -> Result:
    """Interpolate all meshes in all ways, with smooth boundaries throughout."""
    rows: list[dict[str, Any]] = []
    histories = {}
    meshes = _meshes(size)
    cases = [(name, method) for name in meshes for method in METHODS]
    for name, method in progress.track(cases, "interpolation"):
        mesh = meshes[name]
        topology = with_features(mesh.topology, mesh.points, "none")
        start = time.perf_counter()
        found = METHODS[method](topology, mesh.points)
        seconds = time.perf_counter() - start
        steps = {key: len(history) for key, history in found.history.items()}
        if method == "pia":
            histories[name] = found.history
        rows.append(
            {
                "mesh": name, "method": method, "vertices": topology.vertices,
                "boundary_steps": steps.get("boundary", 0), "interior_steps": steps.get("interior", 0),
                "factor": found.factor, "moved": _moved(found, mesh.points), "seconds": seconds,
                **_on_the_limit(method, topology, found, mesh.points),
            }
        )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    iterated = {m: max(r["interior_steps"] + r["boundary_steps"] for r in rows if r["method"] == m) for m in METHODS}
    rough = {m: np.median([r["roughness"] for r in rows if r["method"] == m]) for m in METHODS}
    summary = (
        "All but the plain limit pass through the vertices to 1e-11 of the diagonal. Progressive iteration takes up "
        f"to {iterated['pia']} steps, {iterated['pia, factor 1.8']} with factor 1.8, conjugate gradients on the same "
        f"equations at most {iterated['conjugate gradients']}. Median roughness over that of the plain limit: "
        f"{rough['pia']:.2f} (PIA), {rough['push-back 0.25 0.125 0.0625']:.2f} (push-back), {rough['butterfly']:.2f} "
        "(butterfly)."
    )
    figures = (
        Figure("residuals", lambda path: _draw(path, histories), "residual of each step"),
        Figure("side_by_side", lambda path: _side_by_side(path, size), "five methods on the same mesh, cut open below"),
        Figure("parameters", _parameters, "push-back with the three sets of parameters of Figure 2"),
        Figure("iterations", _iterations, "progressive iteration: the limit after 0, 1, 3 and 10 steps"),
    )
    return Result(made, figures, summary)


def _meshes(size: Size) -> dict[str, HexMesh]:
    made = {
        "ball, 7 blocks": ball(), "tetrahedron in 4": tetrahedron(), "5 tetrahedra in 20": cross_of_tetrahedra(5),
        "fan of 3": fan(3), "fan of 5": fan(5), "box 6": _noisy(6),
    }
    if size == "full":
        made |= {"fan of 6": fan(6), "fan of 8": fan(8), "box 8": _noisy(8), "box 16": _noisy(16)}
    return {name: hex_mesh(*mesh) for name, mesh in made.items()}


def _noisy(n: int) -> tuple[Array, NDArray[np.int64]]:
    """Box of n^3 cells with normal noise of a tenth of a cell."""
    points, cells = box(n, n, n)
    return points + 0.1 * np.random.default_rng(11).standard_normal(points.shape), cells


def _moved(found: Interpolation, points: Array) -> float:
    distance = np.linalg.norm(found.values[: len(points)] - points, axis=1)
    return float(distance.max()) / interpolation.diagonal(points)


def _on_the_limit(method: str, topology: Topology, found: Interpolation, points: Array) -> dict[str, float]:
    """Distance of the limit from the vertices over the diagonal, and roughness over that of the plain limit."""
    fine, limit = _limit_points(method, topology, found, points)
    plain = _limit_points("plain", topology, interpolation.plain(topology, points), points)[1]
    error = np.linalg.norm(limit[: len(points)] - points, axis=1).max() / interpolation.diagonal(points)
    return {"error": float(error), "roughness": _bending(fine, limit) / _bending(fine, plain)}


def _limit_points(method: str, topology: Topology, found: Interpolation, points: Array) -> tuple[Topology, Array]:
    """Points of the limit at the vertices of the mesh refined LEVELS times; the first are those of the mesh itself."""
    if method == "butterfly":
        for _ in range(LEVELS):
            topology, S = butterfly(topology)
            points = S @ points
        return topology, points
    fine, values = found.topology, found.values
    for _ in range(LEVELS if fine.vertices == topology.vertices else LEVELS - 1):
        fine, S = subdivide(fine)
        values = S @ values
    return fine, limit_matrix(fine) @ values


def _bending(topology: Topology, x: Array) -> float:
    """Squared distances of inner points (v, 3) from the mean of their neighbours, summed up."""
    ends = topology.edges
    total = np.zeros_like(x)
    np.add.at(total, ends[:, 0], x[ends[:, 1]])
    np.add.at(total, ends[:, 1], x[ends[:, 0]])
    inside = topology.vertex_kind == INTERIOR
    return float((((total / topology.vertex_edges[:, None]) - x)[inside] ** 2).sum())


def _draw(path: Path, histories: dict[str, dict[str, Array]]) -> None:
    with drawing(path, 1, 2) as panels:
        for axes, group in zip(panels, ("boundary", "interior"), strict=True):
            for name, history in histories.items():
                if group in history:
                    axes.semilogy(history[group], label=name)
            axes.set_xlabel("step")
            axes.set_ylabel(f"residual, {group}")
        panels[-1].legend()


# --- pictures --------------------------------------------------------------------------------------------------------


def _rendered(topology: Topology, points: Array, cut: str | None = None) -> NDArray[np.uint8]:
    solid = straight_domain(Complex(((HEXAHEDRON, topology.hexes),)), points)
    return plot_domain(solid, cut=cut, names=False, size=560)


def _side_by_side(path: Path, size: Size) -> None:
    """Input, plain, butterfly, push-back, PIA and direct: outside and inside."""
    mesh = _meshes("ci")["5 tetrahedra in 20"] if size == "ci" else hex_mesh(*ball())
    t = with_features(mesh.topology, mesh.points, "none")
    panels = [("input", t, mesh.points)]
    shown = {
        "plain (approximating)": "plain", "butterfly": "butterfly", "push-back": "push-back 0.25 0.125 0.0625",
        "PIA": "pia", "direct": "direct",
    }
    for title, method in shown.items():
        panels.append((title, *_limit_points(method, t, METHODS[method](t, mesh.points), mesh.points)))
    pictures = [(title if cut is None else "", _rendered(s, x, cut)) for cut in (None, "-y") for title, s, x in panels]
    plot_panels(path, pictures, len(panels))


def _parameters(path: Path) -> None:
    """Push-back on one mesh with the three sets of parameters, outside and inside."""
    mesh = hex_mesh(*cross_of_tetrahedra(5))
    t = with_features(mesh.topology, mesh.points, "none")
    panels = [
        (method, *_limit_points(method, t, METHODS[method](t, mesh.points), mesh.points))
        for method in METHODS if method.startswith("push-back")
    ]
    pictures = [(title if cut is None else "", _rendered(s, x, cut)) for cut in (None, "-y") for title, s, x in panels]
    plot_panels(path, pictures, len(panels))


def _iterations(path: Path) -> None:
    """Limits of the control meshes after some steps of progressive iteration (Figures 3 and 6)."""
    mesh = hex_mesh(*cross_of_tetrahedra(5))
    t = with_features(mesh.topology, mesh.points, "none")
    panels = []
    for steps in (0, 1, 3, 10):
        found = interpolation.pia(t, mesh.points, iterations=steps)
        error = found.error
        panels.append((f"{steps} steps, residual {error:.0e}", *_limit_points("pia", t, found, mesh.points)))
    plot_panels(path, [(title, _rendered(s, x)) for title, s, x in panels], len(panels))
