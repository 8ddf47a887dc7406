"""Rigid motions: which ones the supports of an elastic body leave free, and their names.

A rigid motion u = a + omega x (x - c) has the coefficients a + omega x (P_i - c) in any space that holds its own
geometry. Supports see it through the held unknowns and through springs; a motion that neither sees is free:

    A = R_f^T R_f + R^T S R  (6, 6),   R_f rows of R (3n, 6) at held unknowns, S spring matrix;   free = kernel of A.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from iga.domain import Domain, Space

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def parts_of(space: Space) -> tuple[int, Index]:
    """Return the number of separate parts and the part (n,) of each function."""
    first, second = [], []
    for block in space.blocks:
        first.append(np.repeat(block.dofs[:, 0], block.n))
        second.append(block.dofs.ravel())
    i, j = np.concatenate(first), np.concatenate(second)
    count, label = connected_components(coo_array((np.ones(len(i)), (i, j)), (space.n, space.n)), directed=False)
    return int(count), label.astype(np.int64)


def motions(points: Array) -> tuple[Array, Array, float]:
    """Return the six rigid motions as coefficients (n*3, 6), the centre (3,) and the size they are scaled with."""
    centre = points.mean(axis=0)
    size = float(np.abs(points - centre).max()) or 1.0
    R = np.zeros((len(points), 3, 6))
    R[:, :, :3] = np.eye(3)
    for axis, omega in enumerate(np.eye(3)):
        R[:, :, 3 + axis] = np.cross(omega, (points - centre) / size)
    return R.reshape(-1, 6), centre, size


def free_motions(points: Array, held: Index, springs: csr_array | None = None) -> list[str]:
    """Names of the rigid motions that nothing holds, each with its axis where it is a rotation.

    Parameters
    ----------
    points : (n, 3) control points of one part
    held : unknowns (function*3 + component) with prescribed values
    springs : (n*3, n*3) matrix of elastic supports
    """
    R, centre, size = motions(points)
    seen = R[held]
    A = seen.T @ seen / max(len(held), 1)
    if springs is not None:
        S = R.T @ (springs @ R)
        scale = np.abs(S).max()
        A = A + (S / scale if scale > 0 else 0.0)
    eigenvalues, vectors = np.linalg.eigh(A)
    null = vectors[:, eigenvalues < 1e-10]
    # the same motions with rotations about the origin, so that those get the plainest name
    null[:3] -= np.cross(null[3:].T, centre / size).T
    basis = simplest_basis(null)
    return [name_of(m, size) for m in basis[np.argsort(basis[:, 3:].any(axis=1), kind="stable")]]


def simplest_basis(null: Array) -> Array:
    """Return a basis (k, 6) of motions (6, k): translations and rotations about coordinate axes where possible."""
    if not null.shape[1]:
        return np.zeros((0, 6))
    # rotations first in the elimination, so that the rows left over are pure translations
    rows = echelon(np.hstack([null[3:].T, null[:3].T]))
    return np.hstack([rows[:, 3:], rows[:, :3]])


def echelon(rows: Array) -> Array:
    """Return the reduced row echelon form with row pivoting."""
    rows = rows.copy()
    rank = 0
    for column in range(rows.shape[1]):
        if rank == len(rows):
            break
        pivot = rank + int(np.argmax(np.abs(rows[rank:, column])))
        if abs(rows[pivot, column]) < 1e-6:
            continue
        rows[[rank, pivot]] = rows[[pivot, rank]]
        rows[rank] /= rows[rank, column]
        others = np.arange(len(rows)) != rank
        rows[others] -= np.outer(rows[others, column], rows[rank])
        rank += 1
    rows[np.abs(rows) < 1e-6] = 0.0
    return rows


def name_of(motion: Array, size: float) -> str:
    """Name a motion (6,): translation (3,) and rotation (3,) about the origin, the latter times the size."""
    a, omega = motion[:3], motion[3:] / size
    if not omega.any():
        return f"translation along {direction(a)}"
    across = a - omega * (a @ omega) / (omega @ omega)
    through = np.cross(omega, across) / (omega @ omega)
    name = f"rotation about {direction(omega)}"
    if np.abs(through).max() > 1e-6 * size:
        name += " through ({:.4g}, {:.4g}, {:.4g})".format(*(through + 0.0))
    return name + (" with a slide along it" if abs(a @ omega) > 1e-6 * np.linalg.norm(omega) else "")


def direction(vector: Array) -> str:
    """Return "x", "y" or "z" for a coordinate direction, else the unit vector."""
    unit = vector / np.linalg.norm(vector)
    axis = int(np.argmax(np.abs(unit)))
    if abs(unit[axis]) > 1 - 1e-9:
        return "xyz"[axis]
    return "({:.3g}, {:.3g}, {:.3g})".format(*(unit * np.sign(unit[axis])))


def describe_free(domain: Domain, held: Index, springs: csr_array | None = None) -> str:
    """Return a phrase that names the free rigid motions of every separate part; empty if all parts are supported."""
    count, label = parts_of(domain.space)
    phrases = []
    for part in range(count):
        functions = np.flatnonzero(label == part)
        inside = held[label[held // 3] == part]
        local = np.searchsorted(functions, inside // 3) * 3 + inside % 3
        unknowns = (functions[:, None] * 3 + np.arange(3)).ravel()
        support = springs if count == 1 or springs is None else springs[unknowns][:, unknowns]
        free = free_motions(domain.points[functions], local, support)
        if free:
            where = (
                ""
                if count == 1
                else " of part {} near ({:.4g}, {:.4g}, {:.4g})".format(
                    part + 1, *domain.points[functions].mean(axis=0)
                )
            )
            phrases.append(", ".join(free) + where)
    return "; ".join(phrases)
