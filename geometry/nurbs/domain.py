"""Conforming patches as a `Domain`: Kronecker extraction blocks, global functions, named facets.

On a knot interval box the functions are products of univariate ones, so the extraction is C_1 (x) C_2 (x) C_3 and only
the distinct univariate operators are stored (a uniform cubic direction has five to seven). Patches of equal degree
share one block, because the core works on chunks of elements of one block and small blocks make small chunks. Elements
are numbered patch by patch, last direction fastest.

Axis letters: e element, n function, k distinct operator, d direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.knots import distinct, extraction
from geometry.nurbs.multipatch import Multipatch, face_name, number, parts
from geometry.patch import FACES, Patch
from iga.bernstein import bernstein
from iga.block import Block, Kronecker
from iga.cells import HEXAHEDRON
from iga.domain import Domain, Facets, Provenance, Space
from iga.errors import InputError

Index = NDArray[np.int64]

MAX_FUNCTIONS = 2_000_000_000  # entries of the dof table: 16 GB


def build_domain(multipatch: Multipatch, source: str, parameters: Mapping[str, Any]) -> Domain:
    """Domain on conforming patches.

    Parameters
    ----------
    multipatch : from `multipatch.glue`.
    source : name of the file or shape, kept in the provenance.
    parameters : settings of the build, kept in the provenance.

    Raises
    ------
    InputError : the tables would not fit in memory.
    """
    patches = multipatch.patches
    entries = sum(int(np.prod(p.elements)) * int(np.prod([q + 1 for q in p.degree])) for p in patches)
    if entries > MAX_FUNCTIONS:
        raise InputError(f"{source}: {entries:.2g} entries in the table of functions are too many; refine less")
    nets, n = number(multipatch)
    points = np.empty((n, 3))
    weights = None if patches[0].weights is None else np.empty(n)
    for net, patch in reversed(list(zip(nets, patches))):  # the first patch has the last word on shared points
        points[net] = patch.control
        if weights is not None:
            weights[net] = patch.weights
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, patch in enumerate(patches):
        groups.setdefault(patch.degree, []).append(i)
    blocks: list[Block] = []
    place: dict[int, tuple[int, int]] = {}
    for degree, members in groups.items():
        offset = 0
        for i in members:
            place[i] = (len(blocks), offset)
            offset += int(np.prod(patches[i].elements))
        blocks.append(_block(degree, [patches[i] for i in members], [nets[i] for i in members]))
    report = {
        "patches": len(patches),
        "degrees": [list(degree) for degree in groups],
        "interfaces": len(multipatch.interfaces),
        "parts": parts(multipatch),
        "rational": weights is not None,
        "turned_round": list(multipatch.turned),
        "collapsed_faces": [face_name(p, f) for p, f in multipatch.collapsed],
        "largest_gap": multipatch.gap,
    }
    return Domain(
        Space(tuple(blocks), n, weights),
        points,
        _boundaries(multipatch, place),
        provenance=Provenance("nurbs", source, dict(parameters), to_arrays(multipatch)),
        report=report,
    )


def _block(degree: tuple[int, ...], patches: list[Patch], nets: list[Index]) -> Block:
    """One block of the elements of patches of equal degree."""
    operators: list[list[NDArray[Any]]] = [[], [], []]
    windows: list[list[Index]] = []
    for patch in patches:
        firsts = []
        for d in range(3):
            C, first = extraction(patch.knots[d], degree[d])
            operators[d].append(C)
            firsts.append(first[:, None] + np.arange(degree[d] + 1))
        windows.append(firsts)
    factors = []
    pattern: list[list[Index]] = [[] for _ in patches]
    for d in range(3):
        F, which = distinct(np.concatenate(operators[d]))
        factors.append(F)
        for i, part in enumerate(np.split(which, np.cumsum([len(C) for C in operators[d]])[:-1])):
            pattern[i].append(part)
    size = int(np.prod([p + 1 for p in degree]))
    dofs = [
        net[x[:, None, None, :, None, None], y[None, :, None, None, :, None], z[None, None, :, None, None, :]]
        .reshape(-1, size)
        for net, (x, y, z) in zip(nets, windows)
    ]
    kinds = [np.stack(np.meshgrid(*p, indexing="ij"), axis=-1).reshape(-1, 3) for p in pattern]
    return Block(
        bernstein(HEXAHEDRON, degree),
        dofs[0] if len(dofs) == 1 else np.concatenate(dofs),
        Kronecker(tuple(factors), np.concatenate(kinds)),
    )


def _boundaries(multipatch: Multipatch, place: dict[int, tuple[int, int]]) -> dict[str, tuple[Facets, ...]]:
    """Facets by name: those with names of their own, and all other free faces by patch and face."""
    inner = {(int(p), int(f)) for row in multipatch.interfaces for p, f in (row[:2], row[2:4])}
    inner |= set(multipatch.collapsed)
    rows = list(multipatch.names)
    named = {(p, f) for _, p, f in rows}
    single = len(multipatch.patches) == 1
    turned = set(multipatch.turned)
    for p in range(len(multipatch.patches)):
        for f in range(6):
            if (p, f) not in inner and (p, f) not in named:
                face = FACES[f ^ 1 if p in turned and f >= 4 else f]
                rows.append((face if single else f"patch{p}:{face}", p, f))
    gathered: dict[str, dict[tuple[int, int], list[Index]]] = {}
    for name, p, f in rows:
        block, offset = place[p]
        size = multipatch.patches[p].elements
        lattice = offset + np.arange(int(np.prod(size))).reshape(size)
        elements = np.take(lattice, -(f % 2), axis=f // 2).ravel()
        gathered.setdefault(name, {}).setdefault((block, f), []).append(elements)
    return {
        name: tuple(Facets(block, f, np.unique(np.concatenate(e))) for (block, f), e in sorted(sides.items()))
        for name, sides in gathered.items()
    }


def to_arrays(multipatch: Multipatch) -> dict[str, NDArray[Any]]:
    """Flatten the patches into a fixed set of plain arrays, to be saved with the domain."""
    patches = multipatch.patches
    arrays: dict[str, NDArray[Any]] = {
        "shape": np.array([p.control.shape[:3] for p in patches], dtype=np.int64),
        "degree": np.array([p.degree for p in patches], dtype=np.int64),
        "knots": np.concatenate([t for p in patches for t in p.knots]),
        "control": np.concatenate([p.control.reshape(-1, 3) for p in patches]),
        "interfaces": multipatch.interfaces,
        "turned": np.array(multipatch.turned, dtype=np.int64),
        "collapsed": np.array(multipatch.collapsed, dtype=np.int64).reshape(-1, 2),
        "names": np.array([name for name, _, _ in multipatch.names], dtype=np.str_),
        "named_faces": np.array([row[1:] for row in multipatch.names], dtype=np.int64).reshape(-1, 2),
    }
    if patches[0].weights is not None:
        arrays["weights"] = np.concatenate([p.weights.ravel() for p in patches])  # type: ignore[union-attr]
    return arrays


def from_arrays(arrays: Mapping[str, NDArray[Any]], gap: float = 0.0) -> Multipatch:
    """Undo `to_arrays`.

    Raises
    ------
    InputError : arrays are missing or do not fit each other.
    """
    try:
        shape, degree = arrays["shape"], arrays["degree"]
        sizes = (shape + degree + 1).ravel()
        knots = np.split(arrays["knots"], np.cumsum(sizes)[:-1])
        cuts = np.cumsum(shape.prod(axis=1))[:-1]
        nets = np.split(arrays["control"], cuts)
        weights = np.split(arrays["weights"], cuts) if "weights" in arrays else [None] * len(shape)
        patches = tuple(
            Patch(tuple(knots[3 * i : 3 * i + 3]), net.reshape(*s, 3), None if w is None else w.reshape(s))
            for i, (s, net, w) in enumerate(zip(shape.tolist(), nets, weights))
        )
        names = tuple((str(n), int(p), int(f)) for n, (p, f) in zip(arrays["names"], arrays["named_faces"]))
        collapsed = tuple((int(p), int(f)) for p, f in arrays["collapsed"])
        return Multipatch(patches, arrays["interfaces"], names, tuple(arrays["turned"].tolist()), collapsed, gap)
    except (KeyError, ValueError) as error:
        raise InputError(f"the domain does not hold the patches it was built from ({error})") from None
