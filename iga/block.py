r"""Blocks of like elements: N = C B.

On each element every function is a linear combination of a few Bernstein functions,

    N_i = sum_b C[i, b] B_b,

so an element is two short rows of data: which functions act on it (``dofs``) and with which coefficients (the
extraction). Elements of equal cell, degree and number of functions form a `Block`. Three ways of storing C cover all
sources: none (C is the identity), a few dense patterns shared by many elements (`Patterns`), and products of
one-dimensional operators (`Kronecker`), which tensor-product splines have.

Axis letters: e element, n function on the element, b Bernstein function, k distinct pattern, c component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import LocalBasis
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Patterns:
    """Dense extraction operators shared by elements: C (k, n, b), and ``pattern`` (e,) says which one."""

    C: Array
    pattern: Index


@dataclass(frozen=True, eq=False)
class Kronecker:
    """Products of one-dimensional operators on tensor cells, C = C_1 (x) C_2 (x) C_3.

    Attributes
    ----------
    factors : for each direction an array (k_d, n_d, p_d + 1) of distinct operators.
    pattern : (e, d), which operator of each direction.
    """

    factors: tuple[Array, ...]
    pattern: Index


Extraction = Patterns | Kronecker | None


@dataclass(frozen=True, eq=False)
class Block:
    """Elements of one cell, degree and number of functions.

    Attributes
    ----------
    basis : the Bernstein functions B on the reference cell.
    dofs : (e, n) global numbers of the functions on each element.
    extraction : C, or None for the identity (then n = b).
    parent : (e,) number of the larger element that each one is a piece of, or None.
    """

    basis: LocalBasis
    dofs: Index
    extraction: Extraction = None
    parent: Index | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "dofs", np.ascontiguousarray(self.dofs, dtype=np.int64))
        sizes = extraction_shape(self)
        if self.dofs.ndim != 2 or sizes != (self.dofs.shape[1], self.basis.n):
            raise InputError(
                f"block of {self.basis.cell.name}s of degree {self.basis.degree}: dofs {self.dofs.shape} and "
                f"extraction {sizes} do not fit {self.basis.n} Bernstein functions"
            )

    @property
    def n(self) -> int:
        """Functions on each element."""
        return int(self.dofs.shape[1])

    @property
    def elements(self) -> int:
        """Number of elements."""
        return int(self.dofs.shape[0])


def extraction_shape(block: Block) -> tuple[int, int]:
    """(n, b) of the extraction operators."""
    extraction = block.extraction
    if extraction is None:
        return block.basis.n, block.basis.n
    if isinstance(extraction, Patterns):
        return int(extraction.C.shape[1]), int(extraction.C.shape[2])
    shapes = np.array([f.shape[1:] for f in extraction.factors])
    return int(shapes[:, 0].prod()), int(shapes[:, 1].prod())


def unity_defect(block: Block) -> tuple[float, int]:
    """Largest deviation from one of the sum of a block's functions, and the number of the operator where it occurs."""
    extraction = block.extraction
    if extraction is None:
        return 0.0, 0
    operators = (extraction.C,) if isinstance(extraction, Patterns) else extraction.factors
    worst = (0.0, 0)
    for C in operators:
        off = np.abs(C.sum(axis=1) - 1.0).max(axis=1, initial=0.0)
        if len(off):
            worst = max(worst, (float(off.max()), int(off.argmax())))
    return worst


def dense_extraction(block: Block, elements: Index | slice) -> Array | None:
    """Operators C of some elements, (m, n, b); None for the identity."""
    extraction = block.extraction
    if extraction is None:
        return None
    if isinstance(extraction, Patterns):
        return extraction.C[extraction.pattern[elements]]
    pattern = extraction.pattern[elements]
    C = extraction.factors[0][pattern[:, 0]]
    for d in range(1, len(extraction.factors)):
        F = extraction.factors[d][pattern[:, d]]
        C = np.einsum("enb,emc->enmbc", C, F).reshape(len(F), C.shape[1] * F.shape[1], -1)
    return C


def distinct_extractions(block: Block) -> tuple[Array, Index]:
    """Distinct operators C (k, n, b) of a block, and which one each element has (e,); an identity is one."""
    extraction = block.extraction
    if extraction is None:
        return np.eye(block.n)[None], np.zeros(block.elements, dtype=np.int64)
    if isinstance(extraction, Patterns):
        return extraction.C, extraction.pattern
    _, first, pattern = np.unique(extraction.pattern, axis=0, return_index=True, return_inverse=True)
    C = dense_extraction(block, first)
    assert C is not None
    return C, np.asarray(pattern, dtype=np.int64).ravel()


def bezier_coefficients(block: Block, values: Array, elements: Index | slice = slice(None)) -> Array:
    """Bernstein coefficients of a field on elements of a block, C^T values[dofs].

    Parameters
    ----------
    values : (N, c) coefficients of the field's functions.
    elements : which elements, all by default.

    Returns
    -------
    (m, b, c)
    """
    return to_bezier(block, values[block.dofs[elements]], elements)


def to_bezier(block: Block, local: Array, elements: Index | slice = slice(None)) -> Array:
    """Bernstein coefficients (m, b, c) from the coefficients (m, n, c) of the elements' own functions."""
    extraction = block.extraction
    if extraction is None:
        return local
    if isinstance(extraction, Patterns):
        return np.swapaxes(extraction.C, 1, 2)[extraction.pattern[elements]] @ local
    # One direction at a time: (m, n1, n2, n3, c) with the active axis moved to the front of the rest.
    m, components = local.shape[0], local.shape[2]
    pattern = extraction.pattern[elements]
    shape = [f.shape[1] for f in extraction.factors]
    grid = local.reshape(m, *shape, components)
    for d, F in enumerate(extraction.factors):
        C = np.swapaxes(F, 1, 2)[pattern[:, d]]
        moved = np.moveaxis(grid, d + 1, 1)
        rest = moved.shape[2:]
        moved = (C @ moved.reshape(m, moved.shape[1], -1)).reshape(m, C.shape[1], *rest)
        grid = np.moveaxis(moved, 1, d + 1)
    return np.ascontiguousarray(grid.reshape(m, -1, components))
