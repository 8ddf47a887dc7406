"""Building the volumetric parametrisation: adapted mesh, image of its boundary, relocation of its inner nodes.

The tolerance falls in stages. The mesh of a stage refines that of the stage before. Its inner nodes start where that
stage's map puts them, or in the harmonic extension of the boundary nodes, whichever inverts fewer simplices, and are
then untangled and smoothed; if simplices stay inverted, the other start is tried as well.

Axis letters: m simplex, n node, d dimension.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_matrix
from scipy.sparse.linalg import splu

from geometry.layouts.blocks import Blocks
from geometry.meccano.adaptation import Measure, Onto, adapt, boundary_nodes
from geometry.meccano.bisection import BisectedMesh, coloured, kuhn, oriented, picture, place_new, refine, refine_all
from geometry.meccano.parametrisation import Parametrisation
from geometry.simplices.kernels_relocation import shapes
from geometry.simplices.relocation import Relocated, ideal_gradients, quality, relocate, relocate_globally
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Start = Literal["coloured", "kuhn"]

DIRECT = 20_000  # unknowns above which linear systems are solved by multigrid


@dataclass(frozen=True)
class Stage:
    """Numbers of one stage.

    Attributes
    ----------
    tolerance, distance : the bound on d(T) asked for and the largest d(T).
    nodes, inner, tets : counts of nodes, of free ones, and of simplices.
    before, after : inverted simplices before relocation and after it.
    sweeps : inverted simplices after each sweep.
    least, mean : mean ratio of the simplices, relative to their shapes in the meccano.
    seconds : wall time.
    """

    tolerance: float
    distance: float
    nodes: int
    inner: int
    tets: int
    before: int
    after: int
    sweeps: list[int]
    least: float
    mean: float
    seconds: float


def parametrise(
    blocks: Blocks, onto: Onto, tolerance: float, measure: Measure = "volume", start: Start = "coloured",
    levels: int = 3, stages: int = 3, sweeps: int = 40, rescues: int = 3, most: int = 1_000_000,
    progress: Progress = QUIET,
) -> tuple[Parametrisation, list[Stage]]:
    """Volumetric parametrisation of the solid whose boundary is the image of the meccano's boundary.

    Parameters
    ----------
    onto : (side (q,), s (q, d - 1)) -> points (q, d), the boundary map; side is a row of ``blocks.boundary_sides``.
    tolerance : bound on d(T), a volume (an area) or a length, see `adaptation`.
    start : "kuhn", the paper's, for one block only.
    levels : uniform bisections before adapting; d of them halve the cells.
    stages : number of tolerances, each 8 times smaller than the one before.
    sweeps : most sweeps of relocation in a stage.
    rescues : most rounds that bisect what is still inverted and relocate again, as long as that helps.
    most : most simplices.

    Returns
    -------
    The parametrisation, and the numbers of each stage; the last says how many simplices remain inverted.

    Raises
    ------
    InputError : the tolerance needs more than ``most`` simplices.
    """
    mesh = refine_all(kuhn(blocks) if start == "kuhn" else coloured(blocks), levels)
    nodes: Array | None = None
    made: list[Stage] = []
    for step in progress.track(range(stages), "tetrahedra"):
        begin = perf_counter()
        bound = tolerance * 8.0 ** (stages - 1 - step)
        finer, distance = adapt(mesh, onto, bound, measure, most)
        if nodes is not None and len(finer.tets) == len(mesh.tets) and step < stages - 1:
            continue
        mesh = finer
        nodes, stage = _settle(mesh, onto, nodes, sweeps, bound, distance, begin)
        made.append(stage)
    assert nodes is not None
    for _ in range(rescues):
        if not made[-1].after:
            break
        begin = perf_counter()
        sigma = shapes(mesh.tets, ideal_gradients(picture(mesh)), nodes)[0]
        finer = refine(mesh, sigma <= 0.0, most)[0]
        finer, distance = adapt(finer, onto, tolerance, measure, most)
        moved, stage = _settle(finer, onto, nodes, sweeps, tolerance, distance, begin)
        if stage.after >= made[-1].after:
            break
        mesh, nodes = finer, moved
        made.append(stage)
    tets, places = oriented(mesh)
    return Parametrisation(blocks, tets, mesh.block, places, nodes), made


def _settle(
    mesh: BisectedMesh, onto: Onto, nodes: Array | None, sweeps: int, tolerance: float, distance: float, begin: float
) -> tuple[Array, Stage]:
    """Nodes of a mesh after relocation; ``nodes`` are those of the coarser mesh."""
    gradients = ideal_gradients(picture(mesh))
    number, where = boundary_nodes(mesh, onto)
    free = np.ones(len(mesh.ends), dtype=bool)
    free[number] = False
    fixed = np.zeros((len(mesh.ends), mesh.blocks.dim))
    fixed[number] = where
    starts = [harmonic(mesh, gradients, fixed, free)]
    if nodes is not None:
        starts.append(np.where(free[:, None], place_new(mesh, nodes), fixed))
    starts.sort(key=lambda start: quality(mesh.tets, gradients, start).inverted)
    tries: list[Relocated] = []
    for start in starts:
        if mesh.blocks.dim == 2:  # all at once first: node by node gets stuck at re-entrant corners
            start = relocate_globally(mesh.tets, gradients, start, free).nodes
        tries.append(relocate(mesh.tets, gradients, start, free, sweeps))
        if tries[-1].quality.inverted == 0:
            break
    done = min(tries, key=lambda made: made.quality.inverted)
    return done.nodes, Stage(
        tolerance, distance, len(fixed), int(free.sum()), len(mesh.tets), int(done.inverted[0]),
        done.quality.inverted, done.inverted[1:].tolist(), done.quality.least, done.quality.mean,
        perf_counter() - begin,
    )


def harmonic(mesh: BisectedMesh, gradients: Array, nodes: Array, free: NDArray[np.bool_]) -> Array:
    """Nodes (n, d) with the free ones where linear elements on the picture put the harmonic extension of the others."""
    size = mesh.tets.shape[1]
    volume = 1.0 / np.abs(np.linalg.det(gradients[:, 1:]))
    local = np.einsum("mvd,mwd,m->mvw", gradients, gradients, volume)
    rows, columns = np.repeat(mesh.tets, size, axis=1), np.tile(mesh.tets, (1, size))
    K = csc_array((local.ravel(), (rows.ravel(), columns.ravel())), shape=(len(nodes),) * 2)
    inner = np.flatnonzero(free)
    result = nodes.copy()
    if len(inner):
        held = np.flatnonzero(~free)
        right = -(K[inner][:, held] @ nodes[held])
        own = K[inner][:, inner]
        if len(inner) <= DIRECT:
            result[inner] = splu(own.tocsc()).solve(right)
        else:  # a starting point needs no more digits
            levels = pyamg.smoothed_aggregation_solver(csr_matrix(own))
            for c in range(nodes.shape[1]):
                result[inner, c] = levels.solve(right[:, c], tol=1e-5, accel="cg")
    return result
