r"""The geometry source "tets": meshes of linear and curved tetrahedra as Bezier tetrahedra or hexahedra.

Input is a file with tetrahedra of degree 1 to 4 in a format of meshio, or the name of a shape: "cube" or "ball".

    convert    "none" (default), "hex4": each tetrahedron becomes four hexahedra, exactly, or "hex1": one hexahedron
               with a collapsed face (Xu et al. 2018)
    degree     raise the file's degree to this one (default: as it is; 2 for shapes)
    angle      split the boundary where neighbouring facets meet at more than this angle, in degrees (default: never)
    tags       whether the file's groups name the boundary (default true)
    n          of shapes only: cells along a side of the cube, refinements of the ball (default 2)

Refinement is exact and nested: tetrahedra by Bey's red refinement, the hexahedra of "hex4" by de Casteljau, "hex1" by
refining its tetrahedra (`iga.refinement`).

Axis letters: e element, n function, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.inputs import require_file
from geometry.parameters import optional, parsed, real, truth, whole, word
from geometry.tets.domain import CONVERSIONS, SOURCE, as_degenerate_hexes, as_tets, domain_of
from geometry.tets.mesh import TetMesh
from geometry.tets.reader import SURFACES, extensions, may_hold_tets, read_tets
from geometry.tets.shapes import ball, cube
from iga.domain import Domain
from iga.errors import InputError
from iga.refinement import refine as refine_bernstein

Array = NDArray[np.float64]

name = SOURCE
SHAPES: dict[str, Callable[[int, int], TetMesh]] = {"cube": cube, "ball": ball}

RULES = {
    "convert": word(*CONVERSIONS),
    "degree": optional(whole(1)),
    "angle": optional(real(0.0, 180.0, ends=False), "never"),
    "tags": truth(),
}
OF_SHAPES = {"n": whole(1)}
DEFAULTS: dict[str, Any] = {"convert": "none", "degree": None, "angle": None, "tags": True, "n": 2}


def reads(path: str | Path) -> bool:
    """Whether an input is a shape or looks like a tet mesh: by its ending, and by its cells where others share that."""
    if str(path) in SHAPES:
        return True
    path = Path(path)
    ending = path.suffix.lower()
    if not path.name.lower().endswith(extensions()) or ending in SURFACES:
        return False
    if not path.is_file():
        return True
    if ending not in (".mesh", ".xml"):
        return may_hold_tets(path)
    content = path.read_bytes()
    return b"<dolfin" in content[:2000] if ending == ".xml" else b"Tetrahedra" in content


def build(path: str | Path, **parameters: Any) -> Domain:
    """Domain from a mesh file.

    Parameters
    ----------
    path : a file, or the name of a shape.
    parameters : see the module docstring.

    Raises
    ------
    InputError : unknown or ill-typed parameters, a file that cannot be read (`FormatError`) or is no valid mesh.
    """
    shape = SHAPES.get(str(path))
    chosen = DEFAULTS | parsed(name, parameters, RULES | OF_SHAPES if shape else RULES)
    tags, degree = chosen["tags"], chosen["degree"]
    mesh = shape(chosen["n"], degree or 2) if shape else read_tets(require_file(path, SHAPES), tags=tags)
    try:
        return domain_of(mesh, chosen["convert"], degree, chosen["angle"], source=Path(path).name, tags=tags)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a domain of this source; the geometry does not change and spaces are nested.

    Parameters
    ----------
    levels : how often each element is cut into eight.
    elevate : by how much the degree is raised afterwards.

    Raises
    ------
    InputError : the domain is of another source, or a number is negative.
    """
    if domain.provenance.source != name:
        raise InputError(f"this domain comes from {domain.provenance.source or 'no source'!r}, not from tets")
    convert = str(domain.provenance.parameters.get("convert", "none"))
    fine = refine_bernstein(as_tets(domain) if convert == "hex1" else domain, levels, elevate)
    if convert == "hex1":
        fine = as_degenerate_hexes(fine)
    parameters = {
        **domain.provenance.parameters,
        "degree": fine.space.blocks[0].basis.degree[0],
        "levels": int(domain.provenance.parameters.get("levels", 0)) + levels,
    }
    report = {key: value for key, value in domain.report.items() if key != "quality"}
    return replace(fine, provenance=replace(domain.provenance, parameters=parameters), report=report)
