r"""Hierarchical splines at points of the meccano, on finer meshes, and from samples.

All three are rows of one kind: on a leaf cell the functions are C B, so a linear form on Bernstein coefficients that is
a product of forms of one variable, v = v_1 (x) v_2 (x) v_3, gives the row C v.

    value at a point            v_d = Bernstein functions (or derivatives) there
    coefficient of a finer f    v_d = blossom at the inner knots of f: truncated functions have the *same* coefficient
                                on a leaf of their level as the untruncated spline has in the local expansion
                                (preservation of coefficients, Giannelli et al. 2014, doi:10.1007/s10444-013-9315-2)

The second makes prolongation exact and local, and with interpolation on one leaf cell in front of it a projection from
samples (hierarchical quasi-interpolation, Speleers and Manni 2016, doi:10.1007/s00211-015-0711-z).

Axis letters: q row, n function, d dimension, b Bernstein function, c cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from geometry.meccano.hierarchical import Hierarchy, hierarchy
from geometry.meccano.parametrisation import LEVELS
from geometry.meccano.splines import functional
from geometry.meccano.tmesh import cells_at, cells_of, refined
from iga.bernstein import bernstein
from iga.block import Kronecker
from iga.cells import LINE
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_BATCH = 512


def collocation(own: Hierarchy, block: Index, xi: Array, derivative: tuple[int, ...] = ()) -> csr_array:
    """Values of all functions at points, or of one of their derivatives with respect to xi.

    Parameters
    ----------
    block, xi : (q,) and (q, d), points of the meccano.
    derivative : order in each direction, each 0 to 2; none by default.

    Returns
    -------
    (q, n); at points of a block's side only functions with a trace there have entries.
    """
    xi = np.asarray(xi, dtype=float)
    cells = cells_at(own.tmesh, block, xi)
    level = own.tmesh.level[cells]
    local = np.ldexp(xi, level[:, None]) - (own.tmesh.corner[cells] >> (LEVELS - level)[:, None])
    factors = np.empty((len(cells), own.tmesh.dim, own.degree + 1))
    for d in range(own.tmesh.dim):
        order = derivative[d] if derivative else 0
        values = bernstein(LINE, own.degree).tabulate(local[:, d : d + 1], order)[order]
        factors[:, d] = np.ldexp(values.reshape(len(cells), own.degree + 1), order * level[:, None])
    return _rows(own, cells, factors)


def prolongation(coarse: Hierarchy, fine: Hierarchy) -> csr_array:
    """Matrix T (n_fine, n_coarse) with coarse function = sum of fine functions, exactly.

    Raises
    ------
    InputError : the fine mesh is coarser somewhere, or the degrees or the blocks differ.
    """
    if coarse.degree != fine.degree or not np.array_equal(coarse.tmesh.blocks.corners, fine.tmesh.blocks.corners):
        raise InputError("splines are nested only on the same blocks and of the same degree")
    own, mesh = fine.tmesh, coarse.tmesh
    above = cells_of(mesh, own.block, own.corner)
    bad = np.flatnonzero(mesh.level[above] > own.level)
    if len(bad):
        raise InputError(f"spaces are not nested: cell {bad[0]} of the finer mesh is larger than that of the coarser")
    cells = above[fine.home]
    T = _rows(coarse, cells, _functionals(fine, mesh.corner[cells], mesh.size[cells]))
    T.data[np.abs(T.data) < 1e-14] = 0.0
    T.eliminate_zeros()
    return T


def refine(own: Hierarchy, cells: Index | None = None) -> tuple[Hierarchy, csr_array]:
    """Split cells (all by default), and return the finer space and the prolongation to it; coefficients are T @ old."""
    finer = hierarchy(refined(own.tmesh, cells), own.degree)
    return finer, prolongation(own, finer)


def quasi_interpolation(own: Hierarchy) -> tuple[Index, Array, csr_array]:
    """Points at which to sample a function, and the matrix from samples to coefficients of a spline close to it.

    A projection: splines of the space are reproduced. Boundary functions depend on samples at the boundary only.

    Returns
    -------
    block (s,), xi (s, d), matrix (n, s)
    """
    p, d = own.degree, own.tmesh.dim
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(p + 1) / p)
    inverse = np.linalg.inv(bernstein(LINE, p).tabulate(nodes[:, None], 0)[0])
    cells, place = np.unique(own.home, return_inverse=True)
    size, corner = own.tmesh.size[cells], own.tmesh.corner[cells]
    grid = np.stack(np.meshgrid(*[nodes] * d, indexing="ij"), axis=-1).reshape(-1, d)
    xi = (corner[:, None] + size[:, None, None] * grid) / 2.0**LEVELS
    weights = _outer(_functionals(own, corner[place], size[place]) @ inverse)
    count = grid.shape[0]
    column = place.reshape(-1, 1) * count + np.arange(count)
    row = np.broadcast_to(np.arange(own.n)[:, None], column.shape)
    matrix = coo_array((weights.ravel(), (row.ravel(), column.ravel())), shape=(own.n, len(cells) * count))
    return np.repeat(own.tmesh.block[cells], count), xi.reshape(-1, d), matrix.tocsr()


def _functionals(own: Hierarchy, corner: Index, size: Index) -> Array:
    """Forms (n, d, b) on polynomials over given cells (n,) that give the coefficient of each function."""
    low, width = np.ldexp(corner.astype(np.float64), -LEVELS), np.ldexp(size.astype(np.float64), -LEVELS)
    parts = [
        functional(own.index[:, d], own.level, low[:, d], width, own.degree)
        for d in range(own.tmesh.dim)
    ]
    return np.stack(parts, axis=1)


def _rows(own: Hierarchy, cells: Index, factors: Array) -> csr_array:
    """Rows C v (q, n) for cells (q,) and forms v as factors (q, d, b)."""
    block = own.cells
    assert isinstance(block.extraction, Kronecker)
    forms = np.stack([
        (F[block.extraction.pattern[cells, d]] @ factors[:, d, :, None])[..., 0]
        for d, F in enumerate(block.extraction.factors)
    ], axis=1)
    found = _outer(forms)
    line, i = np.nonzero(found)
    shape = (len(cells), own.expansion.shape[0])
    return csr_array(csr_array((found[line, i], (line, block.dofs[cells[line], i])), shape=shape) @ own.expansion)


def _outer(factors: Array) -> Array:
    """Products (q, b^d) of factors (q, d, b), the first slowest."""
    made = factors[:, 0]
    for d in range(1, factors.shape[1]):
        made = (made[:, :, None] * factors[:, d, None]).reshape(len(made), factors.shape[2] ** (d + 1))
    return made
