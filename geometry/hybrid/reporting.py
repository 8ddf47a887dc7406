r"""An HB-rep of a solid in numbers.

Axis letters: b Bernstein function, i function.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import eigsh

from geometry.hybrid.sealing import Sealed

Array = NDArray[np.float64]

DENSE = 1000
"""Functions of a face whose eigenvalues are found all at once: time grows with their third power, 0.3 s for these."""
ROUNDING = 1e-16
"""Share of the largest eigenvalue below which others are rounding."""


def describe(sealed: Sealed) -> dict[str, Any]:
    """Numbers of an HB-rep.

    Returns
    -------
    ``b_splines``, ``revised``, ``trim`` and ``own``: functions untouched, revised, of the curves, and C0 functions of
    faces that are no splines; ``unity_error``; ``on_curves``, the largest coefficient of another function in a row of a
    trimming curve; ``c0_faces``, those without splines, with the reason, by name; ``replaced``, for faces that are not
    bicubic polynomials the bound of the distance and whether it is proved; ``condition``, the largest of
    `column_condition`.
    """
    M, made, solid = sealed.M, sealed.made, sealed.solid
    band = np.zeros(len(made.points), dtype=bool)
    for part in made.parts:
        band[part.block.dofs[part.banded]] = True
    spline = np.zeros(M.shape[1], dtype=bool)
    for own in sealed.numbers:
        if own is not None:
            spline[own[own >= 0]] = True
    touched = np.zeros(M.shape[1], dtype=bool)
    touched[csr_array(M[band]).indices] = True
    on = csr_array(M[sealed.on_curve])
    beyond = np.abs(on.data[on.indices >= sealed.trim])
    names = [face.name for face in solid.brep.faces]
    c0 = {names[f]: solid.without.get(f, "no quadrilateral fits") for f, s in enumerate(sealed.splines) if s is None}
    return {
        "b_splines": int((spline & ~touched).sum()), "revised": int((spline & touched).sum()), "trim": sealed.trim,
        "own": M.shape[1] - sealed.trim - int(spline.sum()),
        "unity_error": float(np.abs(M.sum(axis=1) - 1.0).max()), "on_curves": float(beyond.max(initial=0.0)),
        "c0_faces": c0, "condition": max(column_condition(sealed).values(), default=1.0),
        "replaced": {
            names[f]: {"distance": float(solid.apart[f] / solid.brep.diagonal), "proved": bool(solid.proved[f])}
            for f in np.flatnonzero(solid.apart > 0.0).tolist()
        },
    }  # fmt: skip


def column_condition(sealed: Sealed, dense: int = DENSE) -> dict[int, float]:
    """For each face with splines the condition of its functions as combinations of Bernstein functions, scaled.

    From the eigenvalues of the Gram matrix, so what is above 1e8 is not told apart.

    Parameters
    ----------
    dense : functions of a face up to which all eigenvalues are found; of more, the outer ones by Lanczos' method.
    """
    found = {}
    for f, own in enumerate(sealed.numbers):
        if own is None:
            continue
        part = csr_array(sealed.M[:, np.unique(own[own >= 0])])
        G = csr_array(part.T @ part)
        size = 1.0 / np.sqrt(G.diagonal())
        low, high = _dense_ends(G, size) if len(size) <= dense else _sparse_ends(G, size)
        found[f] = float(np.sqrt(high / max(low, ROUNDING * high)))
    return found


def _dense_ends(G: csr_array, size: Array) -> tuple[float, float]:
    """Least and largest eigenvalue of G (n, n) with rows and columns scaled by sizes (n,)."""
    values = np.linalg.eigvalsh(size[:, None] * G.toarray() * size)
    return float(values[0]), float(values[-1])


def _sparse_ends(G: csr_array, size: Array) -> tuple[float, float]:
    """The same of a large matrix: the least one by inverse iteration, off zero by rounding, where G may be singular."""
    scaled = csc_array(diags_array(size) @ G @ diags_array(size))
    start = np.ones(len(size))
    high = float(eigsh(scaled, 1, which="LA", v0=start, return_eigenvectors=False)[0])
    low = float(eigsh(scaled, 1, sigma=-ROUNDING * high, v0=start, return_eigenvectors=False)[0])
    return low, high
