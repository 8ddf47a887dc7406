"""What the command line says of a domain: counts, boundaries, volume, validity.

The validity proof is made once, when a domain is built or refined, and saved in its report as ``quality``.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from iga.assembly import volume
from iga.certificate import quality
from iga.clock import Clock
from iga.domain import Domain, counts, max_degree, with_report
from iga.errors import InputError


def peak_mb() -> float:
    """Largest resident memory of this process so far, in units of 2^20 bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # in bytes on macOS, in 2^10 bytes elsewhere
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def wholly_certified(proof: Mapping[str, Any]) -> bool:
    """Whether every element is, by what `iga.certificate.quality` found."""
    return not (proof["refuted"] or proof["undecided"] or proof.get("degenerate"))


def with_quality(domain: Domain) -> Domain:
    """Return the domain with its validity proof in the report."""
    return with_report(domain, quality=quality(domain))


def require_valid(domain: Domain) -> None:
    """Refuse a domain whose elements are proved to fold.

    Raises
    ------
    InputError : elements are refuted.
    """
    found = domain.report.get("quality") or quality(domain)
    if found["refuted"]:
        raise InputError(
            f"{found['refuted']} elements are folded, {_place(found)} (det J <= {found['min_det_upper']:.3g}); "
            "repair the geometry, or solve all the same with --allow-invalid"
        )


def _place(found: dict[str, Any]) -> str:
    """Where the deepest fold is."""
    if not found.get("folds"):
        return "see iga info"
    fold = found["folds"][0]
    where = ", ".join(f"{c:.4g}" for c in fold["x"])
    return f"worst element {fold['element']} of block {fold['block']} at ({where})"


def measured_volume(domain: Domain) -> float:
    """Volume by a rule that is exact for polynomial cells and far past the default for rational ones."""
    p = max_degree(domain)
    return volume(domain, (3 * p) // 2 + 1 if domain.space.weights is None else 2 * p + 4)


def describe(domain: Domain, clock: Clock) -> dict[str, Any]:
    """Return the answer of ``iga build`` and ``iga info``."""
    report = dict(domain.report)
    proof = report.pop("quality", None) or quality(domain)
    return {
        "source": domain.provenance.source,
        "input": Path(domain.provenance.input).name,
        "degree": max_degree(domain),
        "elements": counts(domain),
        "functions": domain.space.n,
        "boundaries": {
            name: int(sum(len(f.elements) for f in facets)) for name, facets in domain.boundaries.items()
        },
        "volume": measured_volume(domain),
        "quality": proof,
        "distance": report.pop("distance", None),
        "report": report,
        "seconds": clock.seconds,
        "peak_mb": peak_mb(),
    }


def export(domain: Domain, path: Path) -> Path:
    """Write a domain in the format that the suffix names.

    Raises
    ------
    InputError : the suffix is unknown, or the format cannot hold this domain.
    """
    suffix = path.suffix.lower()
    if suffix == ".vtu":
        from iga.exchange.export import write_vtu

        return write_vtu(path, domain)
    if suffix == ".vtk":
        from iga.exchange.export import write_vtk

        return write_vtk(path, domain)
    if suffix == ".bext":
        from iga.exchange.bext import write_bext

        return write_bext(path, domain)
    if suffix == ".xml":
        from geometry.nurbs import write_gismo

        return write_gismo(path, domain)
    raise InputError(f"{path}: the suffix must be .vtu, .vtk, .xml or .bext")
