"""How do the ways of interpolating a hex mesh by a Catmull-Clark solid compare (Xie et al. 2020, Figures 1 to 4)?

Every method on the same inputs: steps of progressive iteration on the boundary and inside until the residual is 1e-12
of the diagonal, the measured convergence factor, the largest residual, how far the control points move from the
vertices, and roughness: how far limit points lie from the mean of their neighbours, squared and summed over the inner
vertices of the once refined mesh, over the same of the approximating limit. Push-back has the once refined control mesh
and three sets of the parameters lambda, mu, gamma of Figure 2.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark import interpolation
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import Interpolation
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import HexMesh, hex_mesh
from geometry.catmull_clark.shapes import ball, box, cross_of_tetrahedra, fan, tetrahedron
from geometry.catmull_clark.subdivision import subdivide
from geometry.catmull_clark.topology import Topology
from iga.progress import Progress
from studies.figures import drawing
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
    Column("error", at_most=1e-11, format=".1e"),
    Column("moved", relative=1e-6, format=".4f"),
    Column("roughness", relative=1e-6, format=".3f"),
    Column("seconds", "time", "s"),
)
SLOPES = ()
METHODS: dict[str, Callable[[Topology, Array], Interpolation]] = {
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
                "factor": found.factor, "error": found.error, "moved": _moved(found, mesh.points),
                "roughness": _roughness(topology, found, mesh.points), "seconds": seconds,
            }
        )  # fmt: skip
    made = table(NAME, COLUMNS, rows, SLOPES)
    slowest = max(row["interior_steps"] + row["boundary_steps"] for row in rows)
    quickest = max(r["interior_steps"] + r["boundary_steps"] for r in rows if r["method"] == "conjugate gradients")
    summary = (
        f"All methods interpolate to 1e-11 of the diagonal. Progressive iteration takes up to {slowest} steps, "
        f"conjugate gradients on the same equations at most {quickest}."
    )
    return Result(made, (Figure("residuals", lambda path: _draw(path, histories), "residual of each step"),), summary)


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


def _roughness(topology: Topology, found: Interpolation, points: Array) -> float:
    """Roughness over that of the approximating limit; all on the once refined connectivity."""
    fine, S = subdivide(topology)
    if found.topology.vertices == topology.vertices:
        values = S @ found.values
    else:
        values = found.values
    limit = limit_matrix(fine) @ values
    plain = limit_matrix(fine) @ (S @ points)
    return _bending(fine, limit) / _bending(fine, plain)


def _bending(topology: Topology, x: Array) -> float:
    ends = topology.edges
    total = np.zeros_like(x)
    np.add.at(total, ends[:, 0], x[ends[:, 1]])
    np.add.at(total, ends[:, 1], x[ends[:, 0]])
    inside = topology.vertex_kind == 3
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
