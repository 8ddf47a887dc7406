r"""Functions of a mixed volume whose boundary has a skin's functions.

The volume has the C0 Bernstein functions of its mesh (`iga.conforming`). Those that live on the skin's elements are
replaced by the skin's functions: with the skin's extraction C on an element,

    N_i = sum_b C[i, b] B_b    on the skin, and into the volume with the B_b,

so M[b, i] = C[i, b] on the skin and the identity inside. Elements that share a vertex, an edge or a face of the skin
must agree on the rows they share.

Axis letters: e element, b Bernstein function, n function, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from geometry.hybrid.shell import Shell
from iga.bernstein import bernstein, face_functions
from iga.block import bezier_coefficients, dense_extraction
from iga.cells import PYRAMID, QUADRILATERAL, TETRAHEDRON
from iga.conforming import Complex, number
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ON_QUAD = np.argsort(np.array(PYRAMID.faces[0].vertices))
"""Corners of a quadrilateral of the skin as the base of a pyramid whose third coordinate points off the skin."""


@dataclass(frozen=True, eq=False)
class Numbering:
    """Bernstein functions of a volume mesh and how they follow from the volume's own.

    Attributes
    ----------
    dofs : for each part of the mesh the Bernstein functions of its elements (e, b).
    n : number of Bernstein functions.
    skin : for each block of the skin the Bernstein functions of its elements (e, b), in the order of its basis.
    """

    dofs: tuple[Index, ...]
    n: int
    skin: tuple[Index, ...]

    @property
    def outer(self) -> NDArray[np.bool_]:
        """(n,) which Bernstein functions live on the skin."""
        mask = np.zeros(self.n, dtype=bool)
        for own in self.skin:
            mask[own] = True
        return mask


def numbering(mesh: Complex, skin: Shell, degree: int) -> Numbering:
    """Number the Bernstein functions of a mesh whose first vertices are those of a skin."""
    extra = mesh.vertices
    stand_ins = []
    for block, corners in zip(skin.space.blocks, skin.corners):
        # A cell on the outside of each skin element: it shares the functions of its base.
        quad = block.basis.cell is QUADRILATERAL
        cells = np.full((len(corners), 5 if quad else 4), extra)
        if quad:
            cells[:, :4] = corners[:, ON_QUAD]
        else:
            cells[:, 1:] = corners
        stand_ins.append((PYRAMID if quad else TETRAHEDRON, cells))
    dofs, count = number(Complex((*mesh.parts, *stand_ins)), degree)
    inside = dofs[: len(mesh.parts)]
    used = np.zeros(count, dtype=bool)
    for own in inside:
        used[own] = True
    place = np.cumsum(used) - 1
    on_skin = []
    for (cell, _), own in zip(stand_ins, dofs[len(mesh.parts) :]):
        base = own[:, face_functions(bernstein(cell, degree), 0)[1]]
        missing = np.argwhere(~used[base])
        if len(missing):
            raise InputError(f"element {int(missing[0, 0])} of the skin is no face of the volume")
        on_skin.append(place[base])
    return Numbering(tuple(place[own] for own in inside), int(used.sum()), tuple(on_skin))


def skin_rows(skin: Shell, numbers: Numbering) -> csr_array:
    """Bernstein coefficients on the skin from the skin's coefficients, (numbers.n, skin functions).

    Raises
    ------
    InputError : neighbours on the skin disagree on what they share.
    """
    rows, columns, values = [], [], []
    taken = np.zeros(numbers.n, dtype=bool)
    # A random field tells whether elements agree on shared rows.
    random = np.random.default_rng(20195).standard_normal((skin.space.n, 1))
    field = np.zeros((numbers.n, 1))
    for block, own in zip(skin.space.blocks, numbers.skin):
        found = bezier_coefficients(block, random)
        flat = own.ravel()
        known = taken[flat]
        off = np.abs(field[flat[known]] - found.reshape(-1, 1)[known]).max(initial=0.0)
        first = np.unique(flat, return_index=True)[1]
        first = first[~known[first]]
        field[flat[first]] = found.reshape(-1, 1)[first]
        off = max(off, np.abs(field[flat] - found.reshape(-1, 1)).max(initial=0.0))
        if off > 1e-8:
            raise InputError(f"elements of the skin disagree by {off:.1e} on the functions of a common edge")
        taken[flat] = True
        element, b = first // own.shape[1], first % own.shape[1]
        C = dense_extraction(block, element)
        if C is None:
            rows.append(flat[first])
            columns.append(block.dofs[element, b])
            values.append(np.ones(len(first)))
        else:
            picked = C[np.arange(len(first)), :, b]
            i, j = np.nonzero(np.abs(picked) > 1e-13)  # rounding in extraction must not couple functions
            rows.append(flat[first][i])
            columns.append(block.dofs[element[i], j])
            values.append(picked[i, j])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(coo_array(entries, shape=(numbers.n, skin.space.n)).tocsr())


def volume_rows(outer: NDArray[np.bool_], skin: csr_array) -> csr_array:
    """M (Bernstein functions, all functions): the skin's functions come first, then the inner Bernstein functions."""
    inner = np.flatnonzero(~outer)
    columns = skin.shape[1] + np.arange(len(inner))
    found = skin.tocoo()
    entries = (
        np.concatenate([found.data, np.ones(len(inner))]),
        (np.concatenate([found.coords[0], inner]), np.concatenate([found.coords[1], columns])),
    )
    return csr_array(coo_array(entries, shape=(len(outer), skin.shape[1] + len(inner))).tocsr())
