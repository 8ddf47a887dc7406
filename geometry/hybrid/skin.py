r"""Watertight skin of a trimmed B-rep: CAD surfaces as they are, curvilinear triangles along the trimming curves.

Every edge of the solid is cut into cubic pieces, once, and both faces take the same pieces (`pieces`): the skin is
watertight by construction. Faces that carry splines get quadrilaterals between parameter lines (`grid`), which are
their Bezier patches and so the CAD surface itself, and triangles between those and the edges (`facemesh`); plane faces
get triangles alone, which are as exact. Sides between triangles are cubics fitted to the surface, and inner control
points are fitted as well (`fitting`). Omega^banded is what touches an edge, and all triangles of a curved face. Where
the distance to the CAD surface exceeds the tolerance, or the straight skeleton cuts through itself, elements are made
smaller and the skin is built again, until neither is so, or there are ``MOST`` elements. Edges that lie off their faces
are moved to where these meet (`meeting`), so that the tolerances of the file do not stay in the skin.

Rational faces are approximated by polynomials, to the tolerance, because the cells of the volume on the skin are
polynomial, and so are polynomials of more than degree three. The distance is measured at samples of each element, by
projection to the surface.

Axis letters: e element, n function, q sample, c component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.brep import Brep
from geometry.hybrid.assembling import assemble
from geometry.hybrid.chart import Chart, make_chart
from geometry.hybrid.compatible import compatible_cuts, halved, line_cuts, with_cuts, with_missing
from geometry.hybrid.cusps import refuse_cusps
from geometry.hybrid.facemesh import FaceMesh, mesh_faces
from geometry.hybrid.grid import Grid, agree, is_flat, kept_share, make_grid
from geometry.hybrid.measures import Finer, measure
from geometry.hybrid.meeting import edge_distances, met
from geometry.hybrid.outline import FaceError
from geometry.hybrid.pcurves import fitted_curves
from geometry.hybrid.pieces import Pieces, cut_edges, divide_edges, least_pieces
from geometry.hybrid.reporting import describe
from geometry.hybrid.sealing import Sealed, seal, spline_blocks
from geometry.hybrid.settings import SKINS
from geometry.hybrid.sizing import Sizing, size_edges
from geometry.hybrid.splining import Splined, splined
from iga.domain import Space
from iga.errors import InputError
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ROUNDS = 12
"""Rounds at most: sizes come down by up to three in each, and faces that cannot be meshed take one."""
MOST = 40_000
"""Elements of a skin above which it is not refined for its distance any more."""
MOST_PIECES = 3000
"""Pieces of an edge above which its face is refused: more do not help where some hundreds did not."""
LITTLE, HALVINGS = 0.25, 2
"""Share of a face kept as quadrilaterals below which its cells are halved, and how often."""
WORTH, PATIENCE = 0.7, 3
"""Share of the best distance that a round must reach to be worth its while, and rounds without after which refinement
stops: what is left is the file's gap, or a cusp."""
SAME = 1e-3
"""Relative change of the distance of an HB-rep below which the file's gap is all that is left."""


@dataclass(frozen=True, eq=False)
class Skin:
    """A watertight closed surface of Bernstein cells.

    Attributes
    ----------
    space : blocks of two-dimensional cells, outward normals by x_xi x x_eta; functions 0 .. vertices - 1 are the
        vertices of the mesh, the others belong to edges and elements, unless the skin is an HB-rep.
    points : (n, 3) control points.
    vertices : number of vertices.
    faces : for each block, the CAD face of each element (e,).
    names : name of each CAD face; pieces of a face that was split at its seam share one.
    curves : (s, 3) mesh edges that lie on CAD edges: two vertices and the number of the CAD edge.
    report : distances, areas, volume, ... (see `build_skin`).
    sealed : of an HB-rep: the splines of its faces, its functions and what they were made from.
    """

    space: Space
    points: Array
    vertices: int
    faces: tuple[Index, ...]
    names: tuple[str, ...]
    curves: Index
    report: Mapping[str, Any] = field(default_factory=dict)
    sealed: Sealed | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "report", MappingProxyType(dict(self.report)))


def build_skin(
    brep: Brep, size: float = 0.2, tolerance: float = 2e-5, where: str = "", progress: Progress = QUIET,
    kind: str = "triangles",
) -> Skin:  # fmt: skip
    """Skin of a solid.

    Parameters
    ----------
    brep : the solid.
    size : largest element, relative to the diagonal.
    tolerance : wanted distance to the CAD surfaces, relative to the diagonal.
    where : name for messages.
    kind : "triangles" alone; "hybrid": quadrilaterals on curved faces, where they fit; "hb-rep": quadrilaterals on all
        faces, whose B-splines, revised beside the trimming curves, and trim functions are the functions of the skin
        (`sealing`), reported by `reporting.describe` as ``hb_rep``.

    Returns
    -------
    The skin; its report holds ``elements``, ``quadrilaterals``, ``max_distance`` and ``exact_area_share`` (elements
    within 1e-12 of the diagonal), ``band_area``, ``watertight_gap``, ``worst_face``, ``volume``, ``volume_error``,
    ``crossings``, ``min_quality``, ``folded``, ``faulty_faces`` if there are any, and
    ``cad_faces_with_quadrilaterals``: for each its knot intervals, areas and distance outside the band, and
    ``cad_faces_without_quadrilaterals``: for each that is not flat why. Of an HB-rep, the rows of faces have
    ``right_triangles``, ``rectangles``, why pieces of curves have no right triangle, and ``omega_banded``, the share of
    the area that these take; rows of faces with poles ``polar`` and ``polar_area``, the triangles at them;
    ``cad_faces_without_band`` says which faces have none, and why.
    ``edge_distance_in_file`` and ``edge_distance`` are how far edges lie off their faces, relative to the diagonal, as
    they come and as they are used.

    Raises
    ------
    InputError : a face has a cusp, or cannot be meshed, by name.
    """
    where = where or brep.name or "solid"
    if not (0.0 < size <= 1.0 and 1e-10 <= tolerance <= 0.1):
        raise InputError(f"{where}: size must lie in (0, 1] and tolerance in [1e-10, 0.1]")
    if kind not in SKINS:
        raise InputError(f"{where}: a skin is one of {', '.join(SKINS)}, not {kind!r}")
    splines = kind == "hb-rep"
    refuse_cusps(brep, where)
    off = edge_distances(brep)
    brep = fitted_curves(met(brep, off), tolerance)
    # Fitted triangles come nearer than their edges' gap; revised B-splines go on with it.
    left = edge_distances(brep) if splines else np.zeros(len(brep.edges))
    sizes = size_edges(brep, size)  # of the CAD surfaces: splines in their place curl a little
    solid = splined(brep, tolerance, left) if splines else None
    brep = brep if solid is None else solid.brep
    task, plan = _begun(brep, solid, sizes, left, size * brep.diagonal, tolerance, kind != "triangles")
    made = _best(task, plan, where, progress)
    told = {"edge_distance_in_file": float(off.max(initial=0.0)), "edge_distance": float(edge_distances(brep).max())}
    report: dict[str, Any] = {**made.skin.report, **{key: value / brep.diagonal for key, value in told.items()}}
    if made.skin.sealed is not None:
        report["hb_rep"] = describe(made.skin.sealed)
    return replace(made.skin, report=report)


def _best(task: _Task, plan: _Plan, where: str, progress: Progress) -> _Made:
    """The best skin of all rounds.

    Raises
    ------
    InputError : a face could not be meshed in any of them, by name.
    """
    brep = task.brep
    best: _Made | None = None
    failed: FaceError | None = None
    stuck = 0
    for _ in progress.track(range(ROUNDS), "skin"):
        edges, count, grids = _laid_out(task, plan)
        try:
            meshes = mesh_faces(brep, task.charts, edges, count, plan.sizing, grids, where, plan.banded)
        except FaceError as error:
            plan, failed = _given_way(brep, plan, edges, error), error
            continue
        made = _built(task, plan, edges, meshes)
        stuck = 0 if best is None or made.badness < WORTH * best.badness else stuck + 1
        # The same vertex is the worst, however small its elements: that is the file's gap.
        same = (
            task.solid is not None and best is not None and made.sound
            and abs(made.badness / best.badness - 1.0) < SAME
        )
        if best is None or (made.badness < best.badness and not same):
            best = made
        many = made.sound and made.skin.report["elements"] > MOST
        if len(made.finer.sizing.points) == 0 or same or stuck == PATIENCE or many:
            break
        if stuck or best.badness < made.badness:
            lighter = _without_faulty(plan, made.finer.faulty)
            stuck = stuck if lighter is plan else 0
            plan = lighter
        plan = _smaller(brep, plan, made.finer, edges)
    if best is None:
        raise InputError(str(failed)) from failed
    return best


@dataclass(frozen=True, eq=False)
class _Task:
    """What all rounds need.

    Attributes
    ----------
    brep : the solid, its edges on its faces.
    solid : its B-splines, for an HB-rep.
    charts, flat : of each face.
    wanted : sizes along each edge, from curvature.
    off : distance of each edge from the CAD surfaces that elements are allowed.
    """

    brep: Brep
    solid: Splined | None
    charts: list[Chart]
    flat: Mask
    wanted: list[Array]
    off: Array
    tolerance: float


@dataclass(frozen=True, eq=False)
class _Plan:
    """How a skin is built; each round makes another plan of it.

    Attributes
    ----------
    sizing : wanted sizes of elements.
    cells : largest cell of each face that has quadrilaterals, and ``without``, why others have none.
    banded : faces whose triangles along curves are a band's, and ``unbanded``, why others have none.
    cuts : parameters at which edges are cut in any case.
    least : fewest pieces of each edge.
    faulty : faces that folded or were cut in the last round.
    """

    sizing: Sizing
    cells: dict[int, float]
    banded: frozenset[int]
    cuts: dict[int, Array]
    least: list[int]
    without: dict[int, str] = field(default_factory=dict)
    unbanded: dict[int, str] = field(default_factory=dict)
    faulty: frozenset[int] = frozenset()


@dataclass(frozen=True, eq=False)
class _Made:
    """The skin of one round, and where its elements must be smaller."""

    skin: Skin
    finer: Finer

    @property
    def sound(self) -> bool:
        """Nothing crosses or folds."""
        return not self.skin.report["crossings"] + self.skin.report["folded"]

    @property
    def badness(self) -> float:
        """Largest distance, relative to the diagonal; a crossing or a fold is worse than any distance."""
        report = self.skin.report
        return float(report["crossings"] + report["folded"]) * 1e6 + float(report["max_distance"])


def _begun(
    brep: Brep, solid: Splined | None, sizes: tuple[Sizing, list[Array]], off: Array, most: float, tolerance: float,
    quads: bool,
) -> tuple[_Task, _Plan]:  # fmt: skip
    """The first plan: elements as the curvature wants them, cells no larger than ``most``."""
    sizing, wanted = sizes
    # The B-splines of all faces are revised, of plane ones too.
    flat = np.array([is_flat(face.surface) and solid is None for face in brep.faces])
    task = _Task(brep, solid, [make_chart(face) for face in brep.faces], flat, wanted, off, tolerance)
    cells = dict.fromkeys(np.flatnonzero(~flat).tolist(), most) if quads else {}
    cuts = {} if solid is None else compatible_cuts(brep)
    least = least_pieces(brep)
    if cells:
        cells = _fitting_cells(brep, divide_edges(brep, sizing, wanted, least, tolerance), sizing, cells)
    return task, _Plan(sizing, cells, frozenset(() if solid is None else cells), cuts, least)


def _laid_out(task: _Task, plan: _Plan) -> tuple[list[Pieces], int, dict[int, Grid]]:
    """Pieces of edges, the number of their vertices, and grids of the faces that have quadrilaterals."""
    brep, cuts = task.brep, plan.cuts
    ends = divide_edges(brep, plan.sizing, task.wanted, plan.least, task.tolerance)
    lines, ends = agree(brep, with_cuts(ends, cuts), plan.sizing, plan.cells, cuts)
    ends = with_missing(ends, cuts)
    if task.solid is not None:
        ends = line_cuts(brep, ends, cuts, lines)
    grids = {f: make_grid(brep, f, own, plan.sizing) for f, own in lines.items()}
    edges, count = cut_edges(brep, ends)
    return edges, count, grids


def _given_way(brep: Brep, plan: _Plan, edges: list[Pieces], error: FaceError) -> _Plan:
    """Plan in which a face that cannot be meshed gives up its band, then its quadrilaterals; then its edges get more
    pieces.

    Raises
    ------
    InputError : there are too many of these.
    """
    f = error.face
    if f in plan.banded:
        return replace(plan, banded=plan.banded - {f}, unbanded={**plan.unbanded, f: str(error)})
    if f in plan.cells:
        cells = {g: most for g, most in plan.cells.items() if g != f}
        return replace(plan, cells=cells, without={**plan.without, f: str(error)})
    least = list(plan.least)
    for e in {c.edge for loop in brep.faces[f].loops for c in loop}:
        if not brep.edges[e].degenerate:
            least[e] = 2 * (len(edges[e].ends) - 1)
    if max(least) > MOST_PIECES:
        raise InputError(str(error)) from error
    return replace(plan, least=least)


def _built(task: _Task, plan: _Plan, edges: list[Pieces], meshes: list[FaceMesh]) -> _Made:
    """The skin of the faces' meshes."""
    brep, solid = task.brep, task.solid
    made = assemble(brep, edges, meshes, task.flat)
    sealed = None if solid is None else seal(solid, meshes, made)
    made = made if sealed is None else sealed.made
    report, finer = measure(brep, made, meshes, task.tolerance, task.off)
    names = tuple(face.name for face in brep.faces)
    none = {f: "no cell fits between its curves" for f in plan.cells if not len(meshes[f].quads)}
    if solid is not None:
        report["cad_faces_without_band"] = {names[f]: why for f, why in sorted(plan.unbanded.items())}
    report["cad_faces_without_quadrilaterals"] = {names[f]: why for f, why in sorted({**none, **plan.without}.items())}
    if sealed is None:
        owners = tuple(part.owner for part in made.parts)
        skin = Skin(made.space, made.points, made.vertices, owners, names, made.curves, report)
    else:
        space, owners = spline_blocks(sealed)
        skin = Skin(space, sealed.points, made.vertices, owners, names, made.curves, report, sealed)
    return _Made(skin, finer)


def _without_faulty(plan: _Plan, faulty: frozenset[int]) -> _Plan:
    """Plan without the bands, or if there are none the quadrilaterals, of faces that fold or are cut although elements
    were made smaller; the same plan if these have neither.
    """
    dropped = faulty & plan.banded
    if dropped:
        why = dict.fromkeys(dropped, "its elements fold or are cut")
        return replace(plan, banded=plan.banded - dropped, unbanded={**plan.unbanded, **why})
    dropped = faulty & plan.faulty & plan.cells.keys()  # not those that fold for the first time
    if not dropped:
        return plan
    cells = {f: most for f, most in plan.cells.items() if f not in dropped}
    why = dict.fromkeys(dropped, "its quadrilaterals fold or are cut")
    return replace(plan, cells=cells, without={**plan.without, **why})


def _smaller(brep: Brep, plan: _Plan, finer: Finer, edges: list[Pieces]) -> _Plan:
    """Plan with smaller elements and cells, and more cuts of edges, where these must be."""
    cells = {f: min(most, finer.cells.get(f, most)) for f, most in plan.cells.items()}
    sizing = Sizing(
        np.concatenate([plan.sizing.points, finer.sizing.points]),
        np.concatenate([plan.sizing.size, finer.sizing.size]),
    )
    cuts = halved(brep, plan.cuts, finer.pieces, edges, cells.keys())
    return replace(plan, sizing=sizing, cells=cells, cuts=cuts, faulty=finer.faulty)


def _fitting_cells(
    brep: Brep, ends: dict[int, Array], sizing: Sizing, cells: dict[int, float]
) -> dict[int, float]:
    """Largest cells of faces, halved where hardly one fits between the trimming curves, if that helps."""
    fitting, trial = dict(cells), dict(cells)
    for _ in range(HALVINGS + 1):
        lines, _ = agree(brep, ends, sizing, trial)
        poor = {f for f, own in lines.items() if kept_share(make_grid(brep, f, own, sizing)) < LITTLE}
        fitting |= {f: trial[f] for f in lines if f not in poor}
        if not poor:
            break
        trial = {f: 0.5 * most if f in poor else fitting[f] for f, most in trial.items()}
    return fitting
