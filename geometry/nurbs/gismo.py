"""G+Smo XML: tensor B-spline and NURBS volumes, single or as a MultiPatch, read and written.

A ``Geometry`` of type TensorBSpline3 or TensorNurbs3 holds three ``KnotVector`` (with their degree), ``coefs``
(Cartesian control points, first direction fastest) and, if rational, ``weights``. A ``MultiPatch`` names patches by id,
lists ``interfaces`` (patch side patch side, direction map, orientation; sides 1..6) and ``boundary`` sides, in named
groups or without names. Interfaces are found again from the geometry, so the list is not needed.

The parser refuses document types and entities, so nothing can expand or be fetched.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from geometry.nurbs.multipatch import Name
from geometry.nurbs.tokens import integers, numbers, read_text
from geometry.patch import Patch, make_patch
from iga.errors import FormatError, InputError
from iga.exchange.files import write_text

MAX_DEPTH = 32
"""Levels of nested tags: G+Smo writes a handful, and a parser's stack is finite."""


def read(path: str | Path) -> tuple[list[Patch], list[Name]]:
    """Read the volumes of a G+Smo file and the names of boundary faces.

    Raises
    ------
    FormatError : the file is not well-formed or not of this kind.
    InputError : it holds surfaces or curves, or a patch is not valid; the message names file and patch.
    """
    name = Path(path).name
    root = _parse(read_text(path), name)
    geometries = list(root.iter("Geometry"))
    if not geometries:
        raise FormatError(f"{name}: there is no Geometry in this XML file")
    collection = next(iter(root.iter("MultiPatch")), None)
    ids = [g.get("id", "") for g in geometries]
    wanted = list(range(len(geometries)))
    if collection is not None:
        wanted = _members(collection, ids, name)
    patches = [_patch(geometries[i], f"{name}, patch {k} (id {ids[i] or '-'})") for k, i in enumerate(wanted)]
    names = [] if collection is None else _names(collection, [ids[i] for i in wanted], name)
    return patches, names


def _parse(text: str, name: str) -> Element:
    """Tree of an XML text without document type, entities or deep nesting."""
    builder = TreeBuilder()
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise FormatError(f"{name}: XML nested deeper than {MAX_DEPTH} levels")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> None:
        raise FormatError(f"{name}: XML document types and entities are not accepted; remove the DOCTYPE")

    parser = expat.ParserCreate(encoding="utf-8")
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text.encode("utf-8"), True)
        return builder.close()
    except expat.ExpatError as error:
        raise FormatError(f"{name}: not well-formed XML ({error})") from None
    except (AssertionError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{name}: not well-formed XML ({error})") from None


def _patch(geometry: Element, where: str) -> Patch:
    kind = geometry.get("type", "")
    lower = kind.lower()
    if lower in ("tensorbspline2", "tensornurbs2", "tensorbspline1", "tensornurbs1", "bspline", "nurbs"):
        raise InputError(f"{where}: {kind} is a {'surface' if lower.endswith('2') else 'curve'}, not a volume")
    if lower not in ("tensorbspline3", "tensornurbs3"):
        raise InputError(f"{where}: geometry of type {kind[:40]!r}; only TensorBSpline3 and TensorNurbs3 are volumes")
    vectors = list(geometry.iter("KnotVector"))
    bases = [b for b in geometry.iter("Basis") if b.find("KnotVector") is not None]
    coefs = geometry.find("coefs")
    if len(vectors) != 3 or len(bases) != 3 or coefs is None:
        raise FormatError(f"{where}: a volume needs three Basis with a KnotVector each, and coefs")
    order = [integers(b.get("index", str(i)), f"{where}, index of a Basis") for i, b in enumerate(bases)]
    if sorted(order) != [[0], [1], [2]]:
        raise FormatError(f"{where}: the indices of the three Basis are not 0, 1, 2")
    knots, shape = [], []
    for d in range(3):
        basis = bases[order.index([d])]
        vector = basis.find("KnotVector")
        assert vector is not None
        if basis.get("periodic", "0") not in ("0", "-1", "") or vector.get("mode") is not None:
            raise InputError(f"{where}, direction {'xyz'[d]}: periodic and generated knot vectors are not supported")
        degree = integers(vector.get("degree", ""), f"{where}, degree of direction {'xyz'[d]}")
        t = numbers(vector.text or "", f"{where}, knots of direction {'xyz'[d]}")
        if len(degree) != 1 or not 1 <= degree[0] <= len(t) - 2:
            raise FormatError(f"{where}, direction {'xyz'[d]}: {len(t)} knots do not fit degree {vector.get('degree')}")
        knots.append(t)
        shape.append(len(t) - degree[0] - 1)
    for e in (coefs, geometry.find(".//weights")):
        if e is not None and e.get("format", "ASCII").upper() != "ASCII":
            raise FormatError(f"{where}: {e.tag} in {e.get('format')} encoding; write the file as plain text")
    if integers(coefs.get("geoDim", "3"), f"{where}, geoDim") != [3]:
        raise InputError(f"{where}: geoDim is {coefs.get('geoDim')}; a volume in space has dimension 3")
    control = _net(numbers(coefs.text or "", f"{where}, coefs"), shape, 3, f"{where}, coefs")
    weights = None
    if lower == "tensornurbs3":
        element = geometry.find(".//weights")
        if element is None:
            raise FormatError(f"{where}: a TensorNurbs3 without weights")
        weights = _net(numbers(element.text or "", f"{where}, weights"), shape, 1, f"{where}, weights")[..., 0]
    return make_patch(knots, control, weights, where)


def _net(values: NDArray[np.float64], shape: list[int], components: int, where: str) -> NDArray[np.float64]:
    """Array (n_1, n_2, n_3, c) from numbers listed with the first direction fastest."""
    n1, n2, n3 = shape
    if len(values) != n1 * n2 * n3 * components:
        raise FormatError(f"{where}: {n1} x {n2} x {n3} control points need {n1 * n2 * n3 * components} numbers, "
                          f"not {len(values)}")
    return np.ascontiguousarray(values.reshape(n3, n2, n1, components).transpose(2, 1, 0, 3))


def _members(collection: Element, ids: list[str], name: str) -> list[int]:
    """Positions in the file of a MultiPatch's patches."""
    element = collection.find("patches")
    if element is None:
        raise FormatError(f"{name}: the MultiPatch lists no patches")
    given = integers(element.text or "", f"{name}, patches of the MultiPatch")
    if element.get("type") == "id_range":
        if len(given) != 2 or not 0 <= given[1] - given[0] < len(ids):
            raise FormatError(f"{name}: the range of patches {given[:4]} does not fit {len(ids)} geometries")
        given = list(range(given[0], given[1] + 1))
    place = {i: k for k, i in enumerate(ids)}
    missing = [i for i in given if str(i) not in place]
    if missing or not given or len(set(given)) != len(given):
        raise FormatError(f"{name}: the MultiPatch names patch {missing[0] if missing else given}, "
                          f"which the file {'does not hold' if missing else 'does not hold once'}")
    return [place[str(i)] for i in given]


def _names(collection: Element, ids: list[str], name: str) -> list[Name]:
    place = {i: k for k, i in enumerate(ids)}
    names: list[Name] = []
    for element in collection.iter("boundary"):
        label = (element.get("name") or "").strip()
        if not label:
            continue
        rows = integers(element.text or "", f"{name}, boundary {label!r}")
        if len(rows) % 2:
            raise FormatError(f"{name}: boundary {label!r} does not list pairs of patch and side")
        for patch, side in zip(rows[::2], rows[1::2]):
            if str(patch) not in place or not 1 <= side <= 6:
                raise FormatError(f"{name}: boundary {label!r} names side {side} of patch {patch}, which is not there")
            names.append((label, place[str(patch)], side - 1))
    return names


def write(
    path: str | Path,
    patches: Iterable[Patch],
    interfaces: NDArray[np.int64] | None = None,
    names: Iterable[Name] = (),
) -> None:
    """Write volumes as G+Smo XML; numbers are written so that reading them gives the same ones bit for bit.

    Parameters
    ----------
    patches : three directions each.
    interfaces : (i, 7) as in `multipatch`; if given (also when empty), a MultiPatch is written.
    names : names of boundary faces; without them all boundary faces form one group without a name.
    """
    made = list(patches)
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<xml>"]
    for number, patch in enumerate(made):
        lines += _geometry(patch, number)
    if interfaces is not None:
        inner = {(int(p), int(f)) for row in interfaces for p, f in (row[:2], row[2:4])}
        grouped: dict[str, list[str]] = {}
        named = set()
        for name, p, f in names:
            grouped.setdefault(name, []).append(f"{p} {f + 1}")
            named.add((p, f))
        rest = [
            f"{p} {f + 1}" for p in range(len(made)) for f in range(6) if (p, f) not in inner and (p, f) not in named
        ]
        lines.append(f' <MultiPatch parDim="3" id="{len(made)}">')
        lines.append(f'  <patches type="id_range">0 {len(made) - 1}</patches>')
        lines.append("  <interfaces>" + "\n".join(_interface(row) for row in interfaces.tolist()) + "\n  </interfaces>")
        for name, rows in grouped.items():
            lines.append(f"  <boundary name={_quoted(name)}>" + "\n".join(rows) + "\n  </boundary>")
        if rest:
            lines.append("  <boundary>" + "\n".join(rest) + "\n  </boundary>")
        lines.append(" </MultiPatch>")
    lines.append("</xml>\n")
    write_text(path, "\n".join(lines))


def _quoted(text: str) -> str:
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;"), ("\n", "&#10;")):
        text = text.replace(character, entity)
    return f'"{text}"'


def _geometry(patch: Patch, number: int) -> list[str]:
    rational = patch.weights is not None
    kind = "TensorNurbs3" if rational else "TensorBSpline3"
    lines = [f' <Geometry type="{kind}" id="{number}">']
    if rational:
        lines.append('  <Basis type="TensorNurbsBasis3">')
    lines.append('   <Basis type="TensorBSplineBasis3">')
    for d, (t, p) in enumerate(zip(patch.knots, patch.degree)):
        lines.append(f'    <Basis type="BSplineBasis" index="{d}">')
        lines.append(f'     <KnotVector degree="{p}">{" ".join(map(repr, t.tolist()))}</KnotVector>')
        lines.append("    </Basis>")
    lines.append("   </Basis>")
    if patch.weights is not None:
        listed = patch.weights.transpose(2, 1, 0).ravel().tolist()
        lines.append("   <weights>" + "\n".join(map(repr, listed)) + "\n   </weights>")
        lines.append("  </Basis>")
    rows = patch.control.transpose(2, 1, 0, 3).reshape(-1, 3).tolist()
    lines.append('  <coefs geoDim="3">' + "\n".join(" ".join(map(repr, row)) for row in rows) + "\n  </coefs>")
    lines.append(" </Geometry>")
    return lines


def _interface(row: list[int]) -> str:
    """One line: patch side patch side, the direction of b for each direction of a, and whether it runs alike."""
    a, fa, b, fb, swapped, *flips = row
    da, db = ([d for d in range(3) if d != f // 2] for f in (fa, fb))
    if swapped:
        db.reverse()
    direction, alike = [0, 0, 0], [0, 0, 0]
    direction[fa // 2], alike[fa // 2] = fb // 2, int(fa % 2 != fb % 2)
    for t in (0, 1):
        direction[da[t]], alike[da[t]] = db[t], 1 - flips[t]
    return " ".join(map(str, (a, fa + 1, b, fb + 1, *direction, *alike)))
