r"""Whether a body is held: motions without energy that no fixed unknown prevents.

A singular system is refused before it is solved, because a factorization of it may look fine in floating point.

Axis letters: n unknown, m motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from iga.errors import InputError
from iga.linear.products import product

Array = NDArray[np.float64]

MOTIONS = ("translation along x", "translation along y", "translation along z", "rotation about x", "rotation about y",
           "rotation about z")


def require_held(K: csr_array, held: NDArray[np.bool_], modes: Array, components: int) -> None:
    """Refuse a system in which a connected part of the body can move without energy.

    On each part the energies Z^T K Z of the motions Z that the fixed unknowns leave free must be positive: the null
    space of the m x m matrix Z^T K Z + (Z^T diag(K) Z over fixed unknowns) is looked for.

    Parameters
    ----------
    K : (n, n)
    held : (n,) which unknowns are fixed.
    modes : (n, m) motions Z without energy: constants, translations or rigid motions.
    components : unknowns per function.

    Raises
    ------
    InputError : a part is not held; the motions it is free to make are named.
    """
    c, n, m = components, K.shape[0], modes.shape[1]
    graph = K if c == 1 else csr_array(K[::c][:, ::c])
    count, label = connected_components(graph, directed=False) if graph.shape[0] * c == n else (1, np.zeros(n // c))
    part = np.repeat(label, c).astype(np.int64)
    stiffness = np.bincount(part, K.diagonal(), count)
    gram = np.zeros((count, m, m))
    size = np.zeros((count, m))
    d = np.abs(K.diagonal())
    forces = np.stack([product(K, np.ascontiguousarray(modes[:, j])) for j in range(m)], axis=1)
    for i in range(m):
        size[:, i] = np.bincount(part, modes[:, i] ** 2 * d, count)
        for j in range(m):
            pinned = np.where(held, modes[:, i] * modes[:, j] * d, 0.0)
            gram[:, i, j] = np.bincount(part, modes[:, i] * forces[:, j] + pinned, count)
    size = np.sqrt(np.maximum(size, 1e-300))
    gram = gram / (size[:, :, None] * size[:, None, :])
    energies, vectors = np.linalg.eigh(0.5 * (gram + gram.swapaxes(1, 2)))
    loose = np.argwhere((energies < 1e-12) & (stiffness > 0)[:, None])
    if not len(loose):
        return
    body = int(loose[0, 0])
    which = "the body" if count == 1 else f"part {body} of {count} (with function {int(np.argmax(label == body))})"
    if m == 1 or c == 1:
        raise InputError(f"{which} is not held: its level is free, so fix a value or add a convection condition")
    span = vectors[body][:, energies[body] < 1e-12]
    names = [MOTIONS[i] for i in range(m) if (span[i] ** 2).sum() > 1e-3]
    raise InputError(f"{which} is not held and free to move by: {', '.join(names)}; fix displacements or add springs")
