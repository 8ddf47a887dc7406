"""The list of geometry sources, and building through it.

A source is anything with ``name``, ``reads(path)``, ``build(path, **parameters)`` and ``refine(domain, levels,
elevate)``: the sub-packages of `geometry`, and what other distributions register under the entry point group
``iga.geometry_sources``, whose entry points are loaded only when they are used.
"""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from iga.domain import Domain
from iga.errors import InputError
from iga.refinement import refine as refine_bernstein

BUILT_IN = ("nurbs", "tets", "catmull_clark", "meccano", "hybrid")
GROUP = "iga.geometry_sources"


class Source(Protocol):
    """What a geometry source offers."""

    name: str

    def reads(self, path: str | Path) -> bool:
        """Whether the source takes this input, from a look at its beginning."""

    def build(self, path: str | Path, **parameters: Any) -> Domain:
        """Domain from the input; `InputError` names what is wrong with it. Parameters may be texts (`parameters`)."""

    def refine(self, domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
        """Finer domain of the same solid."""


def sources() -> dict[str, Source]:
    """All sources by name, the built-in ones first; built-in names cannot be taken by others.

    Raises
    ------
    InputError : a registered source cannot be loaded, or is not one.
    """
    found: dict[str, Source] = {}
    for name in BUILT_IN:
        module: Any = importlib.import_module(f"geometry.{name}")
        found[name] = module
    for entry in entry_points(group=GROUP):
        if entry.name in found:
            continue
        try:
            loaded = entry.load()
        except Exception as error:  # whatever another package does on import
            raise InputError(f"geometry source {entry.name!r} of {entry.value} cannot be loaded: {error}") from error
        missing = [what for what in ("name", "reads", "build", "refine") if not hasattr(loaded, what)]
        if missing:
            raise InputError(f"the geometry source {entry.name!r} of {entry.value} has no {missing[0]!r}")
        found[entry.name] = loaded
    return found


def build(path: str | Path, source: str | None = None, **parameters: Any) -> Domain:
    """Build a domain from an input.

    Parameters
    ----------
    path : a file, or whatever else the source takes (a shape's name).
    source : name of the source; None takes the first one that says it reads the input.
    parameters : settings of the source, as texts or Python values.

    Raises
    ------
    InputError : no such source, none that reads the input, or something is wrong with the input.
    """
    known = sources()
    if source is not None:
        if source not in known:
            raise InputError(f"no geometry source is called {source!r}; there are: {', '.join(known)}")
        return known[source].build(path, **parameters)
    for candidate in known.values():
        if candidate.reads(path):
            return candidate.build(path, **parameters)
    what = "no geometry source reads it" if Path(path).exists() else "there is no such file, and no shape of this name"
    raise InputError(f"{path}: {what} (sources: {', '.join(known)})")


def refine(domain: Domain, levels: int = 1, elevate: int = 0) -> Domain:
    """Refine a domain by the source it came from; one made by hand is refined if it is a C0 Bernstein domain.

    Parameters
    ----------
    levels : how often to halve the elements.
    elevate : degrees to add first.

    Raises
    ------
    InputError : the domain's source is not installed, or it cannot refine.
    """
    known = sources()
    name = domain.provenance.source
    if not name:
        return refine_bernstein(domain, levels, elevate)
    if name not in known:
        raise InputError(f"the domain was built by source {name!r}, which is not here; there are: {', '.join(known)}")
    return known[name].refine(domain, levels, elevate)
