r"""Filling of a closed triangulation with tetrahedra that keep its triangles.

The work is done by a mesh generator: Netgen (LGPL), which comes with the package, or Gmsh or TetGen if Netgen fails and
the user has installed them. Each runs in a process of its own with a time limit, and its answer is checked: the given
points and triangles come back unchanged, all tetrahedra are positive, and together they have the volume inside.

Axis letters: v vertex, t triangle or tetrahedron, c component.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.hybrid.fillers import FILLERS
from iga.cells import TETRAHEDRON
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LIMIT = 300.0
"""Seconds after which a mesh generator is stopped."""
_FACES = np.array([face.vertices for face in TETRAHEDRON.faces])


def fill(points: Array, triangles: Index, limit: float = LIMIT, grading: float = 0.3) -> tuple[Array, Index]:
    """Tetrahedra inside a closed surface.

    Parameters
    ----------
    points : (v, 3) vertices, all in use.
    triangles : (t, 3) turned outwards.
    limit : seconds for each mesh generator.
    grading : how fast sizes may change, 0 to 1.

    Returns
    -------
    points (w, 3), the given ones first, and positive tetrahedra (t, 4) whose boundary is ``triangles``.

    Raises
    ------
    InputError : no mesh generator is installed, or none could fill the surface.
    """
    reasons = []
    for name in FILLERS:
        if find_spec(name) is None:
            reasons.append(f"{name} is not installed")
            continue
        answer = _run(name, points, triangles, limit, grading)
        if isinstance(answer, str):
            reasons.append(f"{name} {answer}")
            continue
        filled, tets = answer
        if not len(tets):
            reasons.append(f"{name} made no tetrahedra")
            continue
        volumes = signed_volumes(filled, tets)
        if volumes.sum() < 0:
            tets = tets[:, [1, 0, 2, 3]]
            volumes = -volumes
        wrong = fault(points, triangles, filled, tets, volumes)
        if wrong is None:
            return filled, tets
        reasons.append(f"{name} {wrong}")
    raise InputError(f"the inside of {len(triangles)} triangles could not be filled: {'; '.join(reasons)}")


def signed_volumes(points: Array, tets: Index) -> Array:
    """Volumes of tetrahedra, (t,)."""
    corner = points[tets]
    return np.asarray(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6.0


def fault(points: Array, triangles: Index, filled: Array, tets: Index, volumes: Array) -> str | None:
    """What is wrong with a filling, or None."""
    if len(filled) < len(points) or not np.array_equal(filled[: len(points)], points):
        return "moved points of the surface"
    faces = np.sort(tets[:, _FACES].reshape(-1, 3), axis=1)
    unique, times = np.unique(faces, axis=0, return_counts=True)
    outer = unique[times == 1]
    wanted = np.unique(np.sort(triangles, axis=1), axis=0)
    if times.max() > 2 or not np.array_equal(outer, wanted):
        return "changed triangles of the surface"
    if volumes.min() <= 0.0:
        return f"made tetrahedron {int(volumes.argmin())} with volume {volumes.min():.1e}"
    corner = points[triangles]
    inside = float(np.einsum("tc,tc->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6.0
    if abs(volumes.sum() - inside) > 1e-9 * abs(inside):
        return f"filled a volume of {volumes.sum():.6g} instead of {inside:.6g}"
    return None


def _run(name: str, points: Array, triangles: Index, limit: float, grading: float) -> tuple[Array, Index] | str:
    """Points and tetrahedra of a mesh generator, or what went wrong."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "surface.npz", Path(folder) / "mesh.npz"
        np.savez(source, points=points, triangles=triangles, grading=grading)
        root = str(Path(__file__).resolve().parents[2])
        try:
            done = subprocess.run(
                [sys.executable, "-m", "geometry.hybrid.fillers", name, str(source), str(target)],
                cwd=root, timeout=limit, capture_output=True, text=True, check=False,
            )
        except subprocess.TimeoutExpired:
            return f"did not finish in {limit:g} seconds"
        if done.returncode or not target.exists():
            text = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
            return f"failed ({text[-1].strip()[:120] if text else f'exit status {done.returncode}'})"
        with np.load(target) as data:
            return data["points"], data["tets"]
