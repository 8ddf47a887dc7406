"""Are hexahedra made of Bezier tetrahedra the same solid, to the last digits?

Theorem 1 (one degenerate hexahedron for each tetrahedron) and Theorem 3 (four) of Xu et al. 2018, "Exact conversion
from Bezier tetrahedra to Bezier hexahedra". For degrees 1 to 8 the hexahedra are evaluated at random points of the cube
and compared with the tetrahedron at the points that the theorems' maps send them to:

    distance = max |hex(r, s, t) - tet(phi(r, s, t))| / size of the tetrahedron's control polygon.

``recovered`` is Theorem 2: the largest distance between the tetrahedron's coefficients and those found again in its
degenerate hexahedron. ``mismatch`` is the largest distance between a hexahedron's own control points and those it
shares with its neighbours. Random tetrahedra have independent normal coefficients; meshes are the built-in curved ball
and, at full size, the real meshes of ``../shared/data/tet`` where that folder is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.tet_to_hex import degenerate_to_tet_points, hex_to_tet_points
from geometry.tets import TetMesh, domain_of, read_tets, shapes, tets_to_degenerate_hexes, tets_to_hexes
from geometry.tets.detection import hexes_to_tets
from iga.bernstein import bernstein
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.progress import Progress
from studies.data import TETS
from studies.figures import plot_heat_table
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]

NAME = "tet_to_hex_exactness"
COLUMNS = (
    Column("mesh", "text", key=True),
    Column("degree", "int", key=True),
    Column("theorem", "int", key=True),
    Column("tets", "int"),
    Column("hexes", "int"),
    Column("points", "int", "per hex"),
    Column("distance", at_most=1e-13, format=".1e"),
    Column("recovered", at_most=1e-11, format=".1e"),
    Column("mismatch", at_most=1e-14, format=".1e"),
)
SLOPES: tuple[Slope, ...] = ()
REAL = ("sphere_P2.msh", "escher_P2.vtk", "sphere_P4.msh", "sphere_fine_P3.msh", "torus.msh", "bob.mesh")
DEGREES = range(1, 9)
SEED = 20183


def run(size: Size, progress: Progress) -> Result:
    """Compare random tetrahedra of all degrees and meshes with their hexahedra."""
    random = np.random.default_rng(SEED)
    rows: list[dict[str, Value]] = []
    for degree in progress.track(DEGREES, "random tets"):
        count = 2 if size == "ci" else 25
        coefficients = random.normal(size=(count, bernstein(TETRAHEDRON, degree).n, 3))
        for theorem in (1, 3):
            rows.append(_row("random", coefficients, degree, theorem, 10_000, random))
    for name, mesh in progress.track(list(_meshes(size)), "meshes"):
        points = 500 if size == "ci" else 10_000 if len(mesh.coefficients) <= 2000 else 1_000
        for theorem in (1, 3):
            row = _row(name, mesh.coefficients, mesh.degree, theorem, points, random)
            rows.append({**row, "mismatch": _mismatch(mesh) if theorem == 3 else None})
    made = table(NAME, COLUMNS, rows)
    worst = max(float(v) for v in made.column("distance") if isinstance(v, float))
    summary = f"Both conversions are exact to round-off: the largest relative distance is {worst:.1e}."
    return Result(made, (Figure("distance", lambda path: _draw(path, rows), "Largest relative distance"),), summary)


def _meshes(size: Size) -> Iterator[tuple[str, TetMesh]]:
    for degree in (2, 3, 4):
        yield "ball", shapes.ball(1 if size == "full" else 0, degree)
    if size == "full" and TETS.is_dir():
        for file in REAL:
            if (TETS / file).is_file():
                yield Path(file).stem, read_tets(TETS / file)


def _row(
    mesh: str, coefficients: Array, degree: int, theorem: int, points: int, random: np.random.Generator
) -> dict[str, Value]:
    hexes = tets_to_degenerate_hexes(coefficients)[:, None] if theorem == 1 else tets_to_hexes(coefficients)
    size = np.linalg.norm(np.ptp(coefficients, axis=1), axis=1)
    worst = 0.0
    for start in range(0, points, 500):
        where = random.random((min(500, points - start), 3))
        targets = degenerate_to_tet_points(where)[None] if theorem == 1 else hex_to_tet_points(where)
        values = bernstein(HEXAHEDRON, degree).tabulate(where, 0)[0]
        for m, target in enumerate(targets):
            exact = bernstein(TETRAHEDRON, degree).tabulate(target, 0)[0]
            apart = np.linalg.norm(values @ hexes[:, m] - exact @ coefficients, axis=-1).max(axis=1)
            worst = max(worst, float((apart / size).max()))
    recovered = None
    if theorem == 1:
        recovered = _recovered(hexes[:, 0], coefficients, size)
    return {
        "mesh": mesh, "degree": degree, "theorem": theorem, "tets": len(coefficients),
        "hexes": hexes.shape[0] * hexes.shape[1], "points": points, "distance": worst, "recovered": recovered,
    }  # fmt: skip


def _recovered(hexes: Array, coefficients: Array, size: Array) -> float:
    """Theorem 2 on the degenerate hexahedra; infinite if one is not recognised."""
    some = slice(0, 200)
    found = hexes_to_tets(hexes[some])
    if not found.found.all():
        return float("inf")
    apart = np.linalg.norm(found.coefficients - coefficients[some], axis=-1).max(axis=1)
    return float((apart / size[some]).max())


def _mismatch(mesh: TetMesh) -> float:
    """Own control points of the hexahedra against the shared ones of the conforming complex."""
    domain = domain_of(mesh, "hex4")
    own = tets_to_hexes(mesh.coefficients)
    shared = domain.points[domain.space.blocks[0].dofs].reshape(own.shape)
    size = np.linalg.norm(np.ptp(mesh.coefficients.reshape(-1, 3), axis=0))
    return float(np.linalg.norm(own - shared, axis=-1).max() / size)


def _draw(path: Path, rows: list[dict[str, Value]]) -> None:
    chosen = {(r["theorem"], r["degree"]): r["distance"] for r in rows if r["mesh"] == "random"}
    values = np.array([[chosen[theorem, degree] for degree in DEGREES] for theorem in (1, 3)], dtype=float)
    names = ["Theorem 1", "Theorem 3"]
    plot_heat_table(path, names, [f"$n={d}$" for d in DEGREES], values, "Largest relative distance, random tetrahedra")
