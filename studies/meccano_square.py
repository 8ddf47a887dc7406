"""How much of a square with a re-entrant corner do the meccano's T-splines fold, and does refinement help?

The test of section 4.1 of Escobar, Cascon, Rodriguez and Montenegro, "The meccano method for isogeometric solid
modeling" (Figure 4). The corner (1, 1) of the unit square moves to (0.65, 0.65), so that the boundary bends inwards
there: no cell with its corner at that point can be valid everywhere. The square's eight triangles are smoothed (the
paper: the centre goes to 0.38), and their piecewise linear map is interpolated by T-splines.

    9 points, 14 points     the paper's two T-meshes (b, e); the second splits the cell at the corner
    centre fixed            the same with the centre left at (0.5, 0.5)
    round 1, 2, ..          from 14 points on, cells that are folded somewhere are split, again and again (the paper
                            looks at centres, where nothing is negative from 14 points on)
    pillowed                a square with one new block under each side, so that no cell has two sides on the boundary;
                            hierarchical splines close to the map of its own triangles

``negative`` is the share of the parameter square where det J < 0, and ``scaled_jacobian`` the smallest value of
det J / (|x_1| |x_2|), both over the centres of a fine grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layouts.blocks import cube, pillowed, place
from geometry.meccano.bisection import FULL, kuhn, oriented, picture, refine_all
from geometry.meccano.collocation import collocation, quasi_interpolation
from geometry.meccano.hierarchical import hierarchy
from geometry.meccano.interpolation import collocation as rational_values
from geometry.meccano.interpolation import interpolate, points_and_slopes
from geometry.meccano.parametrisation import Parametrisation, image
from geometry.meccano.t_spline import TSpline, t_spline
from geometry.meccano.tmesh import TMesh, cells_at, octree, refined, uniform
from geometry.meccano.volume import parametrise
from geometry.simplices.relocation import ideal_gradients, relocate
from iga.progress import Progress
from studies.figures import drawing
from studies.study import Figure, Result, Size
from studies.table import Column, Slope, Value, table

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NAME = "meccano_square"
COLUMNS = (
    Column("model", "text", key=True),
    Column("functions", "int"),
    Column("cells", "int"),
    Column("centre", absolute=1e-4, format=".4f"),
    Column("negative", relative=0.02, absolute=1e-5, format=".3%"),
    Column("scaled_jacobian", absolute=2e-3, format=".3f"),
    Column("condition", relative=0.01, format=".2f"),
)
SLOPES: tuple[Slope, ...] = ()
CORNER = 0.65


@dataclass(frozen=True, eq=False)
class _Model:
    """A spline map of the square: derivatives at points of blocks, and what is drawn.

    Attributes
    ----------
    name : title of its row.
    mapping : the triangles.
    tmesh : the cells.
    control : (n, 2) control points.
    own : the T-spline space, None for hierarchical splines.
    condition : of the interpolation, None if there is none.
    """

    name: str
    mapping: Parametrisation
    tmesh: TMesh
    control: Array
    own: TSpline | None
    condition: float | None


def run(size: Size, progress: Progress) -> Result:
    """Fit all models and sample their Jacobians."""
    grid = 400 if size == "ci" else 1600
    rounds = 3 if size == "ci" else 6
    smoothed, fixed = _square(True), _square(False)
    nine = uniform(cube(2), 1)
    fourteen = octree(cube(2), np.zeros(1, dtype=np.int64), np.array([[3 * FULL // 4] * 2]))
    models = [
        _interpolated("9 points", smoothed, nine), _interpolated("14 points", smoothed, fourteen),
        _interpolated("9 points, centre fixed", fixed, nine), _interpolated("14 points, centre fixed", fixed, fourteen),
    ]
    last = models[1]
    for step in progress.track(range(rounds), "rounds of the remedy"):
        cells = _bad_cells(last)
        if not len(cells):
            break
        last = _interpolated(f"round {step + 1}", smoothed, refined(last.tmesh, cells))
        models.append(last)
    models.append(_pillowed())
    rows: list[dict[str, Value]] = []
    for model in progress.track(models, "Jacobians"):
        scaled = np.concatenate([s.ravel() for s in _scaled(model, grid)])
        rows.append({
            "model": model.name, "functions": len(model.control), "cells": model.tmesh.cells,
            "centre": float(image(model.mapping, np.zeros(1, dtype=np.int64), np.array([[0.5, 0.5]]))[0, 0]),
            "negative": float((scaled < 0).mean()), "scaled_jacobian": float(scaled.min()),
            "condition": model.condition,
        })
    summary = (
        f"The paper's two T-meshes fold {rows[0]['negative']:.2%} and {rows[1]['negative']:.2%} of the square; "
        f"splitting folded cells leaves {rows[-2]['negative']:.2%}. Pillowed, it folds {rows[-1]['negative']:.2%}."
    )
    shown = [models[0], models[1], models[-1]]
    return Result(table(NAME, COLUMNS, rows), (Figure("figure_4", lambda path: _draw(path, shown), summary),), summary)


def _moved(x: Array) -> Array:
    """Boundary points (q, 2) of the deformed square, straight from (1, 1/2) to the corner and on to (1/2, 1)."""
    return x - (1.0 - CORNER) * np.clip(2.0 * x - 1.0, 0.0, None).min(axis=1, keepdims=True)


def _square(smooth: bool) -> Parametrisation:
    """Eight triangles of the deformed square."""
    mesh = refine_all(kuhn(cube(2)), 2)
    ideals = picture(mesh)
    nodes = np.zeros((len(mesh.ends), 2))
    nodes[mesh.tets.ravel()] = ideals.reshape(-1, 2)
    nodes[mesh.on_boundary] = _moved(nodes[mesh.on_boundary])
    if smooth:
        nodes = relocate(mesh.tets, ideal_gradients(ideals), nodes, ~mesh.on_boundary, tolerance=1e-9).nodes
    tets, places = oriented(mesh)
    return Parametrisation(mesh.blocks, tets, mesh.block, places, nodes)


def _interpolated(name: str, mapping: Parametrisation, tmesh: TMesh) -> _Model:
    own = t_spline(tmesh)
    images = image(mapping, np.zeros(len(own.anchors), dtype=np.int64), own.anchors / FULL)
    control, report = interpolate(own, images)
    return _Model(name, mapping, tmesh, control, own, report["condition"])


def _pillowed() -> _Model:
    """Hierarchical splines on five blocks of 2 x 2 cells, close to the map of 640 smoothed triangles."""
    blocks = pillowed(cube(2))
    faces = blocks.cell.faces
    origin, axes = np.array([face.origin for face in faces]), np.array([face.axes for face in faces])

    def onto(side: Index, s: Array) -> Array:
        block, face = blocks.boundary_sides[side].T
        return _moved(place(blocks, block, origin[face] + np.einsum("qds,qs->qd", axes[face], s)))

    mapping, _ = parametrise(blocks, onto, tolerance=1.0, levels=4, stages=1, sweeps=100)
    space = hierarchy(uniform(blocks, 1, 3))
    block, xi, matrix = quasi_interpolation(space)
    return _Model("pillowed", mapping, space.tmesh, matrix @ image(mapping, block, xi), None, None)


def _jacobians(model: _Model, block: Index, xi: Array) -> Array:
    """Derivatives (q, 2, 2) of the map at points of blocks, [c, d] = d x_c / d xi_d."""
    if model.own is None:
        space = hierarchy(model.tmesh)
        return np.stack([collocation(space, block, xi, step) @ model.control for step in ((1, 0), (0, 1))], axis=-1)
    return points_and_slopes(model.own, model.control, xi)[1]


def _scale(J: Array) -> Array:
    lengths = np.linalg.norm(J, axis=1).prod(axis=1)
    return np.asarray(np.linalg.det(J) / np.maximum(lengths, np.finfo(float).tiny))


def _grid(n: int) -> Array:
    centres = (np.arange(n) + 0.5) / n
    return np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)


def _scaled(model: _Model, n: int) -> list[Array]:
    """Scaled Jacobians (n, n) at the centres of a grid, of each block."""
    blocks = range(len(model.tmesh.blocks.corners))
    xi = _grid(n)
    return [_scale(_jacobians(model, np.full(len(xi), k), xi)).reshape(n, n) for k in blocks]


def _bad_cells(model: _Model, n: int = 256) -> Index:
    """Cells where the Jacobian is negative at a point of a grid."""
    xi = _grid(n)
    block = np.zeros(len(xi), dtype=np.int64)
    return np.asarray(np.unique(cells_at(model.tmesh, block, xi)[_scale(_jacobians(model, block, xi)) < 0]))


# --- picture ----------------------------------------------------------------------------------------------------------


def _draw(path: Path, models: list[_Model]) -> None:
    """As Figure 4: cells and triangles, the spline's parameter lines, the scaled Jacobian."""
    with drawing(path, len(models), 3, (3.4, 3.2)) as panels:
        for (left, middle, right), model in zip(panels, models, strict=True):
            _mesh(left, model)
            _lines(middle, model)
            _colours(right, model)
            for axes in (left, middle, right):
                axes.set_aspect("equal")
                axes.set_axis_off()
            left.set_title(model.name)
            middle.set_title("spline")
            right.set_title("scaled Jacobian")


def _placed(model: _Model, block: int, xi: Array) -> Array:
    """Points of the picture of the square."""
    corners = model.tmesh.blocks.places[model.tmesh.blocks.corners[block]].reshape(2, 2, 2)
    along = np.stack([1.0 - xi, xi], axis=-1)
    return np.einsum("qi,qj,ijc->qc", along[:, 0], along[:, 1], corners)


def _mesh(axes: Any, model: _Model) -> None:
    mapping, tmesh = model.mapping, model.tmesh
    for tri, block in zip(mapping.places / FULL, mapping.block.tolist(), strict=True):
        x = _placed(model, block, tri[[0, 1, 2, 0]])
        axes.plot(*x.T, "--", color="#999999", linewidth=0.6)
    outline = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    for c in range(tmesh.cells):
        x = _placed(model, int(tmesh.block[c]), (tmesh.corner[c] + tmesh.size[c] * outline) / FULL)
        axes.plot(*x.T, "-", color="black", linewidth=1.0)


def _lines(axes: Any, model: _Model) -> None:
    """Images of the cells' sides and of three lines between them."""
    tmesh = model.tmesh
    fine = np.linspace(0.0, 1.0, 60)
    for c in range(tmesh.cells):
        for axis in (0, 1):
            for t in (0.0, 0.25, 0.5, 0.75, 1.0):
                local = np.empty((len(fine), 2))
                local[:, axis], local[:, 1 - axis] = t, fine
                xi = np.clip((tmesh.corner[c] + tmesh.size[c] * local) / FULL, 0.0, 1.0)
                x = _points(model, int(tmesh.block[c]), xi)
                edge = t in (0.0, 1.0)
                axes.plot(*x.T, color="black" if edge else "#0072B2", linewidth=1.0 if edge else 0.4)


def _points(model: _Model, block: int, xi: Array) -> Array:
    if model.own is not None:
        return np.asarray(rational_values(model.own, xi) @ model.control)
    return np.asarray(collocation(hierarchy(model.tmesh), np.full(len(xi), block), xi) @ model.control)


def _colours(axes: Any, model: _Model) -> None:
    n = 120
    ends = np.linspace(0.0, 1.0, n + 1)
    corner = np.stack(np.meshgrid(ends, ends, indexing="ij"), axis=-1).reshape(-1, 2)
    for block, scaled in enumerate(_scaled(model, n)):
        x = _placed(model, block, corner).reshape(n + 1, n + 1, 2)
        axes.pcolormesh(
            x[..., 0], x[..., 1], scaled, vmin=-1.0, vmax=1.0, cmap="RdBu", shading="flat", rasterized=True
        )
        axes.contour(
            0.25 * (x[1:, 1:, 0] + x[:-1, 1:, 0] + x[1:, :-1, 0] + x[:-1, :-1, 0]),
            0.25 * (x[1:, 1:, 1] + x[:-1, 1:, 1] + x[1:, :-1, 1] + x[:-1, :-1, 1]),
            scaled, levels=[0.0], colors="black", linewidths=0.8,
        )
