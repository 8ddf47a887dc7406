"""The Catmull-Clark benchmark: seconds of each stage from hexahedra to control points, and of a stiffness matrix.

By default a prism around an edge of valence five (`geometry.catmull_clark.shapes.fan`) of some 100,000 cells, with
noise on its vertices so that interpolation has something to do; or the mesh of a file. Stages:

    topology      checks, edges, faces, valences, boundary, kinds (`hex_mesh`, `with_features`)
    subdivision   the sparse matrix of one level and the refined mesh
    limit         the limit matrix, and limit points by it
    pia           progressive-iterative approximation of Xie et al. 2020 to a residual of 1e-10, boundary first
    space         neighbourhoods, extraction and the domain, irregular cells closed at once (depth 0)
    stiffness     the matrix of heat conduction

The last two only if asked for. Compilation is not counted: a small mesh goes through all stages first.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.catmull_clark.domain import build_domain
from geometry.catmull_clark.features import with_features
from geometry.catmull_clark.interpolation import pia
from geometry.catmull_clark.lattice import limit_matrix
from geometry.catmull_clark.mesh import hex_mesh, read_hexes
from geometry.catmull_clark.shapes import fan
from geometry.catmull_clark.subdivision import subdivide
from iga.assembly import matrix
from iga.errors import InputError
from iga.integrands import Diffusion
from iga.parallel import limited
from studies.describe import peak_mb

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STAGES = ("topology", "subdivision", "limit", "pia", "space", "stiffness")
TOLERANCE = 1e-10
"""Residual of the interpolation, relative to the diagonal."""
_LAYERS, _VALENCE = 8, 5
"""Of the prism."""


def run(
    hexes: int = 100_000, threads: int = 1, mesh: str | Path | None = None, stiffness: bool = False
) -> dict[str, Any]:
    """Run the benchmark once.

    Parameters
    ----------
    hexes : about how many cells the prism has, at least 40.
    threads : number of threads.
    mesh : a file with a mesh to take instead.
    stiffness : whether to go on to the stiffness matrix.

    Returns
    -------
    mesh, hexes, vertices, t_STAGE_s for each stage, t_total_s, t_cpu_s (of all threads together: what a busy machine
    leaves alone), s_per_million (by stage), steps and residual of PIA, threads, peak_rss_mb; with ``stiffness`` also
    functions, nonzeros.

    Raises
    ------
    InputError : too few cells, or a file that is no mesh of hexahedra.
    """
    if hexes < 40:
        raise InputError(f"the benchmark needs at least 40 cells, not {hexes}")
    if mesh is None:
        points, cells = _prism(hexes)
    else:
        read = read_hexes(mesh)
        points, cells = read.points, read.topology.hexes
    with limited(threads):
        _stages(*_prism(40), stiffness)
        began = time.process_time()
        seconds, found = _stages(points, cells, stiffness)
        used = time.process_time() - began
    return {
        "mesh": "prism of valence 5" if mesh is None else Path(mesh).name,
        "hexes": len(cells),
        "vertices": len(points),
        **{f"t_{stage}_s": t for stage, t in seconds.items()},
        "t_total_s": sum(seconds.values()),
        "t_cpu_s": used,
        "s_per_million": {stage: t * 1e6 / len(cells) for stage, t in seconds.items()},
        **found,
        "threads": threads,
        "peak_rss_mb": peak_mb(),
    }


def _prism(hexes: int) -> tuple[Array, Index]:
    """Points and cells of the prism; vertices moved by a tenth of a cell."""
    rings = max(round((hexes / (_VALENCE * _LAYERS)) ** 0.5), 1)
    return fan(_VALENCE, _LAYERS, rings, noise=0.1)


def _stages(points: Array, cells: Index, stiffness: bool) -> tuple[dict[str, float], dict[str, Any]]:
    """Seconds of each stage, and what was found."""
    clock = [time.perf_counter()]
    made = hex_mesh(points, cells)
    t = with_features(made.topology, made.points)
    clock.append(time.perf_counter())
    subdivide(t)
    clock.append(time.perf_counter())
    limit_matrix(t) @ points
    clock.append(time.perf_counter())
    result = pia(t, points, tolerance=TOLERANCE)
    clock.append(time.perf_counter())
    steps = {key: len(history) for key, history in result.history.items()}
    found: dict[str, Any] = {"steps": steps, "residual": result.error}
    if stiffness:
        domain = build_domain(t, result.values, 0)
        clock.append(time.perf_counter())
        K = matrix(domain, Diffusion(1.0))
        clock.append(time.perf_counter())
        found |= {"functions": domain.space.n, "nonzeros": int(K.nnz)}
    return dict(zip(STAGES, np.diff(clock).tolist())), found
