r"""Patches glued along coincident faces, C0 and conforming.

Interfaces are found by geometry: two faces whose four corner points coincide under one of the eight symmetries of the
square, and whose control nets and weights (up to one common factor) then agree, after both faces were brought to
common knots and degree. What the faces lack is added by knot insertion and degree elevation and carried through the
multipatch: directions that interfaces tie together form one class (with orientation), and every member of a class gets
the same knots. Functions are shared by topology alone, through faces: two patches that meet only in an edge share the
functions of that edge if a chain of glued faces around the edge connects them.

A patch may be glued to itself (a closed ring). Faces are numbered 2 * direction + side. An interface is a row
(patch a, face a, patch b, face b, swap, flip 0, flip 1): the net of b, its two directions exchanged if ``swap`` and
then each run backwards if ``flip``, is the net of a.

Axis letters: i interface, n control point.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from geometry.knots import common, normalised
from geometry.nurbs.coincidence import same_surface
from geometry.patch import (
    FACES,
    Patch,
    bisect,
    elevate,
    face_of,
    fit,
    reverse,
    signed_volume,
    swap,
)
from iga.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

Name = tuple[str, int, int]  # boundary name, patch, face

SYMMETRIES = tuple((s, f, g) for s in (0, 1) for f in (0, 1) for g in (0, 1))


@dataclass(frozen=True, eq=False)
class Multipatch:
    """Conforming patches.

    Attributes
    ----------
    patches : right-handed volumes whose glued faces have equal control nets and weights.
    interfaces : (i, 7) rows as in the module docstring.
    names : (boundary name, patch, face) of every face that is on the boundary and has a name of its own.
    turned : patches that were left-handed and had their last direction reversed.
    collapsed : (patch, face) of faces that have shrunk to a curve or point: neither interface nor boundary.
    gap : largest distance between control points that were glued.
    """

    patches: tuple[Patch, ...]
    interfaces: Index
    names: tuple[Name, ...] = ()
    turned: tuple[int, ...] = ()
    collapsed: tuple[tuple[int, int], ...] = ()
    gap: float = 0.0


def orient(face: Patch, symmetry: tuple[int, int, int]) -> Patch:
    """Apply a symmetry (swap, flip 0, flip 1) to a face."""
    if symmetry[0]:
        face = swap(face)
    for axis in (0, 1):
        if symmetry[1 + axis]:
            face = reverse(face, axis)
    return face


def glue(patches: Iterable[Patch], names: Iterable[Name] = (), tolerance: float = 1e-6, where: str = "") -> Multipatch:
    """Turn left-handed patches round, find the interfaces, and make the patches conform.

    Parameters
    ----------
    patches : volumes (three directions each), from `patch.make_patch`.
    names : names of boundary faces; those of faces that turn out to be interfaces are dropped.
    tolerance : how far points may lie apart to be one, relative to the diagonal of the model.
    where : file name for messages.

    Raises
    ------
    InputError : faces that lie on each other but do not match, three faces in one place, weights that cannot be made
        to agree; the message names patches and faces.
    """
    made, turned = [], []
    for number, patch in enumerate(patches):
        volume = signed_volume(patch)
        if not np.isfinite(volume) or volume == 0.0:
            raise InputError(f"{where}: patch {number} has no volume")
        if volume < 0:
            turned.append(number)
            patch = reverse(patch, 2)
        made.append(patch)
    if not made:
        raise InputError(f"{where}: there is no patch")
    # Reversing the last direction exchanges faces 4 and 5; names stay with the face they were given to.
    named = [(name, p, f ^ 1 if p in set(turned) and f >= 4 else f) for name, p, f in names]
    points = np.concatenate([p.control.reshape(-1, 3) for p in made])
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    faces = [face_of(p, f) for p in made for f in range(6)]
    whole = np.array([not _collapsed(face, tolerance * size) for face in faces])
    interfaces = find_interfaces(faces, whole, tolerance * size, where)
    _refuse_same_side(interfaces, where)
    made = conform(made, interfaces)
    made = match_weights(made, interfaces, where)
    collapsed = tuple(divmod(x, 6) for x in np.flatnonzero(~whole).tolist())
    inner = {(int(a), int(f)) for row in interfaces for a, f in (row[:2], row[2:4])} | set(collapsed)
    kept = tuple((name, p, f) for name, p, f in named if (p, f) not in inner)
    result = Multipatch(tuple(made), interfaces, kept, tuple(turned), collapsed)
    return replace(result, gap=_gap(result))


def face_name(patch: int, face: int) -> str:
    """How messages and boundaries call a face."""
    return f"patch {patch} face {FACES[face]}"


def find_interfaces(faces: list[Patch], whole: NDArray[np.bool_], tolerance: float, where: str) -> Index:
    """Pairs of coincident faces, (i, 7).

    Parameters
    ----------
    faces : six of each patch.
    whole : for each face whether it has an area.
    tolerance : absolute distance.
    """
    corners = np.array([f.control[::len(f.control) - 1, ::f.control.shape[1] - 1] for f in faces])  # (f, 2, 2, 3)
    pairs = cKDTree(corners.reshape(-1, 3)).query_pairs(tolerance, output_type="ndarray")
    k = len(faces) * 4
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(k, k))
    vertex = connected_components(graph, directed=False)[1].reshape(-1, 2, 2)
    groups: dict[tuple[int, ...], list[int]] = {}
    for number in np.flatnonzero(whole).tolist():
        groups.setdefault(tuple(sorted(vertex[number].ravel().tolist())), []).append(number)
    rows: list[tuple[int, ...]] = []
    partner: dict[int, int] = {}
    for members in groups.values():
        for i, a in enumerate(members):
            for b in members[i + 1 :]:
                symmetry = _match(faces, vertex, a, b, tolerance, where)
                if symmetry is None:
                    continue
                for one, other in ((a, b), (b, a)):
                    if one in partner:
                        three = sorted({one, other, partner[one]})
                        said = ", ".join(face_name(*divmod(x, 6)) for x in three)
                        raise InputError(f"{where}: {said} coincide; at most two patches can meet in a face")
                    partner[one] = other
                rows.append((*divmod(a, 6), *divmod(b, 6), *symmetry))
    free = [x for x in np.flatnonzero(whole).tolist() if x not in partner]
    _refuse_overlaps(faces, free, tolerance, where)
    return np.array(rows, dtype=np.int64).reshape(-1, 7)


def _collapsed(face: Patch, tolerance: float) -> bool:
    """Whether a face has shrunk to a curve or a point."""
    net = face.control
    return any(bool((np.ptp(net, axis=axis).max(axis=-1) <= tolerance).all()) for axis in (0, 1))


def _match(
    faces: list[Patch], vertex: Index, a: int, b: int, tolerance: float, where: str
) -> tuple[int, int, int] | None:
    """Symmetry that takes face b to face a, or None if they are different surfaces."""
    tried = False
    for symmetry in SYMMETRIES:
        grid = vertex[b].T if symmetry[0] else vertex[b]
        grid = grid[:: 1 - 2 * symmetry[1], :: 1 - 2 * symmetry[2]]
        if (grid == vertex[a]).all():
            tried = True
            if _coincide(faces[a], orient(faces[b], symmetry), tolerance):
                return symmetry
    if tried and same_surface(faces[a], faces[b], tolerance, enough=9):
        raise InputError(
            f"{where}: {face_name(*divmod(a, 6))} and {face_name(*divmod(b, 6))} are one surface but parametrised "
            f"differently, so they cannot be glued point for point; reparametrise one of them"
        )
    return None


def _coincide(a: Patch, b: Patch, tolerance: float) -> bool:
    """Whether two faces, already oriented alike, are the same map (weights up to a factor)."""
    same = a.degree == b.degree and all(
        len(s) == len(t) and np.abs(normalised(s) - normalised(t)).max() < 1e-6 for s, t in zip(a.knots, b.knots)
    )
    if not same:
        for axis in (0, 1):
            knots, degree = common([(a.knots[axis], a.degree[axis]), (b.knots[axis], b.degree[axis])])
            a, b = fit(a, axis, knots, degree), fit(b, axis, knots, degree)
    if np.abs(a.control - b.control).max() > tolerance:
        return False
    u, v = (np.ones(p.control.shape[:-1]) if p.weights is None else p.weights for p in (a, b))
    return bool(np.abs(u / u.mean() - v / v.mean()).max() <= 1e-6)


def _refuse_overlaps(faces: list[Patch], free: list[int], tolerance: float, where: str) -> None:
    """Refuse boundary faces of which a part lies on another one: a non-matching interface."""
    if len(free) < 2:
        return
    low = np.array([faces[x].control.min(axis=(0, 1)) for x in free]) - tolerance
    high = np.array([faces[x].control.max(axis=(0, 1)) for x in free]) + tolerance
    for i, x in enumerate(free):
        near = np.flatnonzero(((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i])).all(axis=1)) + i + 1
        for y in (free[j] for j in near.tolist()):
            if same_surface(faces[x], faces[y], tolerance, enough=3) or same_surface(
                faces[y], faces[x], tolerance, enough=3
            ):
                raise InputError(
                    f"{where}: {face_name(*divmod(x, 6))} and {face_name(*divmod(y, 6))} lie on each other but do not "
                    f"match corner to corner; split the patches so that whole faces meet"
                )


def _refuse_same_side(interfaces: Index, where: str) -> None:
    """Refuse right-handed patches that lie on the same side of their common face, hence overlap."""
    for a, fa, b, fb, swapped, *flips in interfaces.tolist():
        da, db = ([d for d in range(3) if d != f // 2] for f in (fa, fb))
        if swapped:
            db.reverse()
        # Directions of b that continue those of a; out of a is into b.
        M = np.zeros((3, 3))
        M[fb // 2, fa // 2] = 1.0 if fa % 2 != fb % 2 else -1.0
        for t in (0, 1):
            M[db[t], da[t]] = 1.0 - 2.0 * flips[t]
        if np.linalg.det(M) < 0:
            raise InputError(
                f"{where}: {face_name(a, fa)} and {face_name(b, fb)} coincide, but both patches lie on the same side; "
                f"one of them is there twice or folded"
            )


def conform(patches: list[Patch], interfaces: Index) -> list[Patch]:
    """Give all directions that interfaces tie together the same degree and knots.

    Node 2k + o is direction k = 3 * patch + d run forwards (o = 0) or backwards (o = 1); a tie joins equal runs. A
    direction tied to its own reverse gets symmetric knots by itself.
    """
    if not len(interfaces):
        return patches
    ends = []
    for a, fa, b, fb, swapped, *flips in interfaces.tolist():
        da = [d for d in range(3) if d != fa // 2]
        db = [d for d in range(3) if d != fb // 2]
        if swapped:
            db.reverse()
        ends += [
            (2 * (3 * a + da[t]) + o, 2 * (3 * b + db[t]) + (o ^ flips[t])) for t in (0, 1) for o in (0, 1)
        ]
    k = 6 * len(patches)
    i, j = np.array(ends).T
    label = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(k, k)), directed=False)[1]
    result = list(patches)
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    for nodes in np.split(order, starts[1:]):
        forward = [node for node in nodes.tolist() if node % 2 == 0]
        if len(nodes) == 1 or not forward:
            continue
        members = []
        for node in nodes.tolist():
            patch, d = divmod(node // 2, 3)
            t = patches[patch].knots[d]
            members.append((1.0 - normalised(t)[::-1] if node % 2 else normalised(t), patches[patch].degree[d]))
        knots, degree = common(members)
        for node in forward:
            patch, d = divmod(node // 2, 3)
            result[patch] = fit(result[patch], d, knots, degree)
    return result


def match_weights(patches: list[Patch], interfaces: Index, where: str) -> list[Patch]:
    """Scale the weights of whole patches so that they agree on interfaces (a common factor changes no shape)."""
    if all(p.weights is None for p in patches):
        return patches
    weights = [np.ones(p.control.shape[:-1]) if p.weights is None else p.weights for p in patches]
    made = [replace(p, weights=w) for p, w in zip(patches, weights)]
    if not len(interfaces):
        return made
    ratio = np.array([
        face_of(made[a], fa).weights.mean() / face_of(made[b], fb).weights.mean()  # type: ignore[union-attr]
        for a, fa, b, fb, *_ in interfaces.tolist()
    ])
    a, b = interfaces[:, 0], interfaces[:, 2]
    n = len(patches)
    graph = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(n, n)).tocsr()
    log = np.zeros(n)
    known = {(int(x), int(y)): float(np.log(r)) for x, y, r in zip(a, b, ratio)}
    for part_root in np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]:
        order, before = breadth_first_order(graph, part_root, directed=False)
        for node in order[1:].tolist():
            parent = int(before[node])
            step = known.get((parent, node))
            log[node] = log[parent] + (step if step is not None else -known[node, parent])
    off = np.abs(log[a] + np.log(ratio) - log[b])
    if off.max() > 1e-6:
        row = interfaces[off.argmax()]
        raise InputError(
            f"{where}: weights of {face_name(*row[:2])} and {face_name(*row[2:4])} differ by a factor that no scaling "
            f"of whole patches can remove"
        )
    log[np.abs(log) < 1e-12] = 0.0
    return [replace(p, weights=w * np.exp(s)) for p, w, s in zip(made, weights, log)]


def number(multipatch: Multipatch) -> tuple[list[Index], int]:
    """Global function numbers: for each patch an array of the shape of its control net, and how many there are.

    Functions are numbered patch by patch in the order of the nets; a glued one has the number it got first.
    """
    shapes = [p.control.shape[:-1] for p in multipatch.patches]
    offsets = np.concatenate([[0], np.cumsum([int(np.prod(s)) for s in shapes])])
    nets = [np.arange(o, o + int(np.prod(s))).reshape(s) for o, s in zip(offsets[:-1], shapes)]
    if not len(multipatch.interfaces):
        return nets, int(offsets[-1])
    one, two = (np.concatenate(x) for x in zip(*glued_pairs(multipatch, nets)))
    total = int(offsets[-1])
    label = connected_components(coo_array((np.ones(len(one)), (one, two)), shape=(total, total)), directed=False)[1]
    _, first, compact = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    numbers = rank[compact.reshape(-1)]
    return [numbers[net] for net in nets], len(first)


def glued_pairs(multipatch: Multipatch, nets: list[NDArray[Any]]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """For each interface the entries of two nets (arrays of the control nets' shapes) that meet there, flattened."""
    pairs = []
    for a, fa, b, fb, swapped, flip0, flip1 in multipatch.interfaces.tolist():
        one, two = (np.take(nets[p], -(f % 2), axis=f // 2) for p, f in ((a, fa), (b, fb)))
        if swapped:
            two = np.swapaxes(two, 0, 1)
        two = two[:: 1 - 2 * flip0, :: 1 - 2 * flip1]
        tail = one.shape[2:]
        pairs.append((one.reshape(-1, *tail), two.reshape(-1, *tail)))
    return pairs


def _gap(multipatch: Multipatch) -> float:
    pairs = glued_pairs(multipatch, [p.control for p in multipatch.patches])
    return max((float(np.linalg.norm(a - b, axis=-1).max()) for a, b in pairs), default=0.0)


def refined(multipatch: Multipatch, levels: int = 0, elevated: int = 0) -> Multipatch:
    """Elevate all patches, then halve all knot intervals ``levels`` times (k-refinement); conformity stays."""
    patches = tuple(bisect(elevate(p, elevated), levels) for p in multipatch.patches)
    return replace(multipatch, patches=patches)


def parts(multipatch: Multipatch) -> int:
    """Number of connected pieces."""
    n = len(multipatch.patches)
    a, b = multipatch.interfaces[:, 0], multipatch.interfaces[:, 2]
    return int(connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[0])
