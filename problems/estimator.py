r"""Where a heat solution is inaccurate: the residual error estimator, element by element.

For -div(k grad u) = f with temperatures, fluxes g and convection on the boundary,

    eta_K^2 = h_K^2 int_K (f + div(k grad u))^2 / k
            + 1/2 sum over inner faces F of K   h_K int_F [n . k grad u]^2 / k
            + sum over boundary faces           h_K int_F (g - n . k grad u)^2 / k       where u is not prescribed
            + sum over boundary faces           1/h_K int_F k (u_D - u)^2                where it is u_D

bounds the energy norm of the error from above and, up to oscillation of the data, from below, with constants that
depend on the degree and on shapes (Verfuerth, "A posteriori error estimation techniques", 2013, theorem 1.20). h_K is
the largest distance between vertices and k the mean of the conductivity's eigenvalues.

Second derivatives in space follow from those in reference coordinates,

    H = J^-T (u_ij - sum_c (du/dx_c) x_c,ij) J^-1,

with the quotient rule where functions are rational. Faces of two elements are one if their centres are. What is then
left over inside hangs on larger faces or has smaller ones on it; there the gradient on the other side is looked up at
each point. (On T-meshes splines are smooth across such faces, and nothing comes of it.) The last term is the
oscillation of the data where they are imposed strongly, and what Nitsche's method leaves where weakly.

Axis letters: e element, q point, c component of space, i and j reference directions, f face.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from iga.bernstein import Bernstein, functions_at
from iga.block import to_bezier
from iga.cells import TRIANGLE
from iga.chunk import SIZE, Chunk, chunks, rule_for
from iga.domain import Domain, all_facets, facets_of
from iga.errors import InputError
from iga.field import Field
from iga.locate import locate, tree
from iga.located import Located
from problems.data import freeze, values
from problems.formula import Formula
from problems.heat import Heat, resolved

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BEYOND = 1e-6
"""Step over a face, in its size: across it for sure, and no gradient changes on the way."""


def indicators(problem: Heat, domain: Domain, temperature: Array, points: int | None = None) -> Array:
    """Estimate the error of a steady temperature in the energy norm, element by element.

    Parameters
    ----------
    temperature : (n,) coefficients of the solution.
    points : Gauss points per direction, by default `iga.chunk.default_points`.

    Returns
    -------
    (e,) eta_K, blocks of the space one after the other; the estimate is the root of the sum of their squares.

    Raises
    ------
    InputError : a conductivity that cannot be differentiated (a function, or a field of tensors).
    """
    problem = resolved(problem, domain)
    k = problem.conductivity
    if (callable(k) and not isinstance(k, Formula)) or (isinstance(k, Field) and k.coefficients[0].size > 1):
        raise InputError("the error estimator needs a conductivity that is a number, tensor, formula or scalar field")
    sizes = [block.elements for block in domain.space.blocks]
    start = np.concatenate([[0], np.cumsum(sizes)])
    squares = np.zeros(int(start[-1]))
    diameter = np.empty(len(squares))
    for chunk in chunks(domain, points):
        rows = start[chunk.block] + chunk.elements
        diameter[rows] = _diameters(chunk)
        left = values(freeze(problem.source), chunk, ()) + _divergence(chunk, k, temperature)
        squares[rows] = diameter[rows] ** 2 * (left**2 / _mean(k, chunk) * np.abs(chunk.dx)).sum(axis=1)
    faces, centres = _faces(domain)
    pairs = cKDTree(centres).query_pairs(1e-8 * float(np.ptp(domain.points, axis=0).max()), output_type="ndarray")
    jumps = [
        *_jumps(domain, k, temperature, points, start, faces, pairs),
        *_hanging(domain, k, temperature, points, start, np.delete(faces, np.unique(pairs), axis=0)),
    ]
    for rows, jump in jumps:
        squares += np.bincount(rows, 0.5 * diameter[rows] * jump, len(squares))
    for rows, square in _boundary(problem, domain, temperature, points, start):
        squares += np.bincount(rows, diameter[rows] * square, len(squares))
    for rows, square in _missed(problem, domain, temperature, points, start):
        squares += np.bincount(rows, square / diameter[rows], len(squares))
    return np.sqrt(squares)


def _diameters(chunk: Chunk) -> Array:
    """Largest distance between vertices of each element, (e,)."""
    basis = chunk.basis
    at = functions_at(basis, basis.cell.vertices)
    corners = chunk.control[:, at]
    if chunk.domain.space.weights is not None:
        corners = corners[..., :3] / corners[..., 3:]
    return np.asarray(np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max(axis=(1, 2)))


def _mean(k: Any, chunk: Chunk) -> Array:
    """Mean eigenvalue of the conductivity, (e, q)."""
    value = _conductivity(k, chunk)
    return value if value.ndim == 2 else np.trace(value, axis1=2, axis2=3) / 3.0


def _conductivity(k: Any, chunk: Chunk) -> Array:
    """Conductivity (e, q) or (e, q, 3, 3)."""
    tensor = k.shape == (3, 3) if isinstance(k, Formula) else not isinstance(k, Field) and np.ndim(k) == 2
    return values(freeze(k), chunk, (3, 3) if tensor else ())


def _flux(chunk: Chunk, k: Any, temperature: Array) -> Array:
    """Outward flux n . k grad u on facets, (e, q)."""
    slope, value = chunk.gradient(temperature), _conductivity(k, chunk)
    flux = value[..., None] * slope if value.ndim == 2 else (value @ slope[..., None])[..., 0]
    return np.asarray((chunk.normal * flux).sum(axis=-1))


def _divergence(chunk: Chunk, k: Any, temperature: Array) -> Array:
    """div(k grad u), (e, q)."""
    slope, second = chunk.gradient(temperature), _hessian(chunk, temperature)
    value = _conductivity(k, chunk)
    if value.ndim == 2:
        found = value * np.trace(second, axis1=2, axis2=3)
    else:
        found = np.einsum("eqcd,eqcd->eq", value, second)
    if isinstance(k, Field):
        found = found + (chunk.gradient(k.coefficients.reshape(-1)) * slope).sum(axis=-1)
    elif isinstance(k, Formula) and not k.is_constant:
        change = values(freeze(k.gradient()), chunk, (*k.shape, 3))
        row = change if k.shape == () else np.trace(change, axis1=2, axis2=4)  # sum_c dk_cd/dx_c
        found = found + (row * slope).sum(axis=-1)
    return np.asarray(found)


def _hessian(chunk: Chunk, temperature: Array) -> Array:
    """Second derivatives of the temperature in space, (e, q, 3, 3)."""
    block, weights = chunk.domain.space.blocks[chunk.block], chunk.domain.space.weights
    local = np.concatenate([chunk.domain.points[chunk.dofs], temperature[chunk.dofs][..., None]], axis=2)
    if weights is not None:
        own = weights[chunk.dofs][..., None]
        local = np.concatenate([local * own, own], axis=2)
    control = to_bezier(block, local, chunk.elements)
    N, dN, ddN = block.basis.tabulate(chunk.points, 2)
    A = N @ control
    first = np.einsum("qbi,ebc->eqci", dN, control, optimize=True)
    second = np.einsum("qbij,ebc->eqcij", ddN, control, optimize=True)
    if weights is not None:
        W, dW, ddW = A[..., 4], first[..., 4, :], second[..., 4, :, :]
        A = A[..., :4] / W[..., None]
        first = (first[..., :4, :] - A[..., None] * dW[..., None, :]) / W[..., None, None]
        cross = first[..., :, None] * dW[..., None, None, :]
        second = second[..., :4, :, :] - cross - cross.swapaxes(3, 4) - A[..., None, None] * ddW[..., None, :, :]
        second = second / W[..., None, None, None]
    inverse = chunk.inverse
    slope = (first[..., 3, None, :] @ inverse)[..., 0, :]
    curved = second[..., 3, :, :] - np.einsum("eqc,eqcij->eqij", slope, second[..., :3, :, :])
    return np.asarray(inverse.swapaxes(2, 3) @ curved @ inverse)


def _boundary(
    problem: Heat, domain: Domain, temperature: Array, points: int | None, start: Index
) -> list[tuple[Index, Array]]:
    """Element rows and integrals of the squared residual of natural conditions, over k."""
    free = [name for name in domain.boundaries if name not in problem.temperature]
    fixed: dict[tuple[int, int], list[Index]] = {}  # boundaries may overlap
    for name in problem.temperature if free else ():
        for f in domain.boundaries[name]:
            fixed.setdefault((f.block, f.face), []).append(f.elements)
    found = []
    for name in free:
        for f in facets_of(domain, name):
            own = np.setdiff1d(f.elements, np.concatenate(fixed.get((f.block, f.face), [f.elements[:0]])))
            for chunk in _facet_chunks(domain, f.block, f.face, own, points):
                right = np.zeros(chunk.dx.shape)
                if name in problem.flux:
                    right = right + values(freeze(problem.flux[name]), chunk, ())
                if name in problem.convection:
                    exchange = problem.convection[name]
                    away = values(freeze(exchange.ambient), chunk, ()) - chunk.at(temperature)
                    right = right + values(freeze(exchange.coefficient), chunk, ()) * away
                k = problem.conductivity
                square = (right - _flux(chunk, k, temperature)) ** 2 / _mean(k, chunk)
                found.append((start[chunk.block] + chunk.elements, (square * chunk.dx).sum(axis=1)))
    return found


def _missed(
    problem: Heat, domain: Domain, temperature: Array, points: int | None, start: Index
) -> list[tuple[Index, Array]]:
    """Element rows and integrals of the squared distance from prescribed temperatures, times k; each facet once."""
    found = []
    seen: dict[tuple[int, int], Index] = {}
    for name, datum in reversed(list(problem.temperature.items())):
        for f in facets_of(domain, name):
            before = seen.get((f.block, f.face), f.elements[:0])
            own = np.setdiff1d(f.elements, before)
            seen[f.block, f.face] = np.union1d(before, own)
            for chunk in _facet_chunks(domain, f.block, f.face, own, points):
                gap = values(freeze(datum), chunk, ()) - chunk.at(temperature)
                square = gap**2 * _mean(problem.conductivity, chunk)
                found.append((start[chunk.block] + chunk.elements, (square * chunk.dx).sum(axis=1)))
    return found


def _facet_chunks(domain: Domain, block: int, face: int, elements: Index, points: int | None) -> list[Chunk]:
    """Chunks of facets at points that are symmetric on the face, so that they fit from both sides."""
    basis = domain.space.blocks[block].basis
    shape = basis.cell.faces[face]
    count = max(max(b.basis.degree) for b in domain.space.blocks) + 1 if points is None else points
    rule = rule_for(domain, block, count, face)
    where, weights = rule.points, rule.weights
    if shape.cell is TRIANGLE:
        whole = np.column_stack([1 - where.sum(axis=1), where])
        orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
        where = np.concatenate([whole[:, order][:, 1:] for order in orders])
        weights = np.tile(weights, 6) / 6.0
    inside = shape.origin + where @ shape.axes.T
    return [
        Chunk(domain, block, elements[s : s + SIZE], inside, weights, None, face) for s in range(0, len(elements), SIZE)
    ]


def _jumps(
    domain: Domain, k: Any, temperature: Array, points: int | None, start: Index, faces: Index, pairs: Index
) -> list[tuple[Index, Array]]:
    """Element rows and integrals of the squared jump of the flux over k, twice for each pair of faces (p, 2)."""
    if not len(pairs):
        return []
    used = np.unique(pairs)
    x, flux, weight = _at_faces(domain, k, temperature, points, faces, used)
    one, two = (np.searchsorted(used, pairs[:, side]) for side in (0, 1))
    square = np.empty(len(pairs))
    for begin in range(0, len(pairs), 1024):
        some = slice(begin, begin + 1024)
        a, b = one[some], two[some]
        count = np.isfinite(weight[a]).sum(axis=1)
        away = np.linalg.norm(x[a][:, :, None] - x[b][:, None], axis=3)
        partner = np.nan_to_num(away, nan=np.inf).argmin(axis=2)
        jump = flux[a] + np.take_along_axis(flux[b], partner, axis=1)
        jump = np.where(np.arange(jump.shape[1]) < count[:, None], jump, 0.0)
        square[some] = (jump**2 * np.nan_to_num(weight[a])).sum(axis=1)
    rows = start[faces[:, 0]] + faces[:, 2]
    return [(rows[pairs[:, side]], square) for side in (0, 1)]


def _hanging(
    domain: Domain, k: Any, temperature: Array, points: int | None, start: Index, faces: Index
) -> list[tuple[Index, Array]]:
    """Element rows and integrals of the squared jump of the flux over k on faces (f, 3) without a partner."""
    outer = {(f.block, f.face): f.elements for f in all_facets(domain)}
    found: list[tuple[Index, Array]] = []
    boxes = None
    for number, face in np.unique(faces[:, :2], axis=0).tolist():
        mine = faces[(faces[:, :2] == (number, face)).all(axis=1), 2]
        mine = np.setdiff1d(mine, outer.get((number, face), mine[:0]))
        for chunk in _facet_chunks(domain, number, face, mine, points) if len(mine) else ():
            boxes = boxes or tree(domain)
            normal = chunk.normal
            beyond = chunk.x + BEYOND * np.sqrt(chunk.dx.sum(axis=1))[:, None, None] * normal
            there = locate(domain, beyond.reshape(-1, 3), boxes=boxes)
            inside = there.element >= 0
            slope = chunk.gradient(temperature)
            jump = np.zeros(slope.shape).reshape(-1, 3)
            other = Located(domain, there.block[inside], there.element[inside], there.xi[inside])
            jump[inside] = slope.reshape(-1, 3)[inside] - other.gradient(temperature)
            value = _conductivity(k, chunk)
            step = jump.reshape(slope.shape)
            flux = value[..., None] * step if value.ndim == 2 else (value @ step[..., None])[..., 0]
            square = (normal * flux).sum(axis=-1) ** 2 / _mean(k, chunk)
            found.append((start[number] + chunk.elements, (square * chunk.dx).sum(axis=1)))
    return found


def _faces(domain: Domain) -> tuple[Index, Array]:
    """Block, local face and element (f, 3) of all faces that have an area, and their centres (f, 3)."""
    rows, centres = [], []
    for number, block in enumerate(domain.space.blocks):
        for face, shape in enumerate(block.basis.cell.faces):
            assert isinstance(block.basis, Bernstein)
            centre = shape.origin + shape.axes @ shape.cell.centre
            for begin in range(0, block.elements, 4096):
                elements = np.arange(begin, min(begin + 4096, block.elements))
                chunk = Chunk(domain, number, elements, centre[None], np.ones(1), None, face)
                rows.append(np.column_stack([np.full(len(elements), number), np.full(len(elements), face), elements]))
                centres.append(chunk.x[:, 0])
    return np.concatenate(rows), np.concatenate(centres)


def _at_faces(
    domain: Domain, k: Any, temperature: Array, points: int | None, faces: Index, used: Index
) -> tuple[Array, Array, Array]:
    """Points (f, q, 3), outward fluxes (f, q) and weights over k (f, q) of some faces; NaN beyond a face's points."""
    found: list[tuple[Index, Array, Array, Array]] = []
    for number, face in np.unique(faces[used, :2], axis=0).tolist():
        mine = np.flatnonzero((faces[used, :2] == (number, face)).all(axis=1))
        at = 0
        for chunk in _facet_chunks(domain, number, face, faces[used[mine], 2], points):
            rows = mine[at : at + len(chunk.elements)]
            at += len(rows)
            found.append((rows, chunk.x, _flux(chunk, k, temperature), chunk.dx / _mean(k, chunk)))
    q = max(f.shape[1] for _, _, f, _ in found)
    x = np.full((len(used), q, 3), np.nan)
    flux, weight = np.full((2, len(used), q), np.nan)
    for rows, own, through, area in found:
        x[rows, : own.shape[1]], flux[rows, : own.shape[1]], weight[rows, : own.shape[1]] = own, through, area
    return x, flux, weight
