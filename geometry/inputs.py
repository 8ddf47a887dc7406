"""What every source asks of its input before it reads it: that there is such a file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from iga.errors import FormatError


def require_file(path: str | Path, shapes: Iterable[str] = ()) -> Path:
    """Return the path of a file that exists.

    Parameters
    ----------
    shapes : names that the source takes in place of a file, for the message.

    Raises
    ------
    FormatError : there is no such file, or it is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise FormatError(f"{path}: is a folder, not a file")
    if not path.is_file():
        names = ", ".join(shapes)
        shape = f", nor a built-in shape of this name ({names})" if names else ""
        raise FormatError(f"{path}: there is no such file{shape}")
    return path
