"""Pictures of files: a saved domain, or a solution written for ParaView."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from iga.errors import InputError
from iga.exchange.files import require_place
from iga.exchange.reading import read_vtu
from iga.pictures.plot import plot_domain, plot_field
from iga.store import load


def draw(
    path: str | Path, field: str | None, out: str | Path, cut: str | None = None,
    view: Sequence[float] | None = None, up: str = "z",
) -> Path:
    """Draw a ``.npz`` domain or a ``.vtu`` solution.

    Parameters
    ----------
    field : field or attribute to colour by; a solution shows its first field, a domain its named boundaries.
    out : PNG file.
    cut : axis to cut along ("x", "-z", ..) to see inside.
    view : direction from the solid to the eye (default: oblique).
    up : axis that points up.

    Raises
    ------
    InputError : no such file or field; the fields that exist are listed.
    """
    path, out = Path(path), require_place(out, ".png")
    if path.suffix.lower() == ".vtu":
        domain, fields = read_vtu(path)
    else:
        domain = load(path)
        fields = dict(domain.attributes)
    if field is not None and field not in fields:
        raise InputError(f"{path} has no field {field!r}; there are: {', '.join(fields) or 'none'}")
    if field is None and path.suffix.lower() == ".vtu":
        field = next(iter(fields), None)
    if field is None:
        plot_domain(domain, out, cut=cut, view=view, up=up)
        return out
    warp = fields.get("displacement") if field != "temperature" else None
    plot_field(domain, fields[field], field, out, cut=cut, warp=warp, view=view, up=up)
    return out
