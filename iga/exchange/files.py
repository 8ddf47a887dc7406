"""Files that appear whole or not at all: written under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from iga.errors import InputError


def require_place(path: str | Path, suffix: str = "") -> Path:
    """Return the path if a file could stand there; asked before long work, so that none is lost to a typing error.

    Raises
    ------
    InputError : the name has another suffix, the folder is missing, or a folder, device or pipe has this name.
    """
    path = Path(path)
    if suffix and path.suffix.lower() != suffix:
        raise InputError(f"{path}: the name of this file must end in {suffix}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not a file")
    if path.exists() and not path.is_file():  # a file would take the place of /dev/null itself
        raise InputError(f"{path}: is a device or a pipe, not a file")
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to write to; on success it takes the place of `path`, on failure it is removed.

    The temporary name keeps the suffix of `path`, because writers choose their format by it.

    Raises
    ------
    InputError : the folder is missing, cannot be written, or the disk is full; what was at `path` is still there.
    """
    path = require_place(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all (UTF-8, ends of lines as given)."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
