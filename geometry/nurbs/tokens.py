"""Reading text files that may be anything: words and numbers with errors that name the place.

A cursor walks over the words of a file once; counts that a file declares are compared with the words that are left
before anything is allocated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iga.errors import FormatError

Array = NDArray[np.float64]

MAX_BYTES = 1 << 29
"""Size of a file that is still read."""


def read_text(path: str | Path) -> str:
    """Return the contents of a text file.

    Raises
    ------
    FormatError : the file cannot be read, is larger than 512 MB, or is not text.
    """
    name = Path(path).name
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise FormatError(f"{name}: larger than {MAX_BYTES >> 20} MB, which no NURBS file should be")
        return Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(f"{name}: not a text file") from None
    except (OSError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def numbers(text: str | list[str], where: str) -> Array:
    """Floating-point numbers of a text or of words, (k,).

    Raises
    ------
    FormatError : something is not a number; the message quotes it.
    """
    words = text.split() if isinstance(text, str) else text
    try:
        return np.array(words, dtype=np.str_).astype(np.float64) if words else np.zeros(0)
    except ValueError:
        for word in words:
            try:
                float(word)
            except ValueError:
                raise FormatError(f"{where}: {word[:40]!r} is not a number") from None
        raise FormatError(f"{where}: not a list of numbers") from None


def integers(text: str | list[str], where: str) -> list[int]:
    """Whole numbers of a text or of words.

    Raises
    ------
    FormatError : a word is not a whole number that fits 32 bits.
    """
    words = text.split() if isinstance(text, str) else text
    result = []
    for word in words:
        digits = word.lstrip("+-")
        if not (digits.isascii() and digits.isdigit() and len(digits) < 10 and len(word) - len(digits) < 2):
            raise FormatError(f"{where}: {word[:40]!r} is not a whole number")
        result.append(int(word))
    return result


class Cursor:
    """Position in the words of a file."""

    def __init__(self, words: list[str], name: str) -> None:
        self.words = words
        self.name = name
        self.at = 0

    @property
    def left(self) -> int:
        """Words not yet taken."""
        return len(self.words) - self.at

    def peek(self) -> str:
        """Return the next word without taking it, "" at the end."""
        return self.words[self.at] if self.left else ""

    def take(self, count: int, what: str) -> list[str]:
        """Return the next ``count`` words.

        Raises
        ------
        FormatError : there are not so many left.
        """
        if not 0 <= count <= self.left:
            raise FormatError(f"{self.name}: {what} needs {count} more entries, but {self.left} are left in the file")
        self.at += count
        return self.words[self.at - count : self.at]

    def integer(self, what: str) -> int:
        """Return the next word as a whole number."""
        return integers(self.take(1, what), f"{self.name}, {what}")[0]

    def count(self, what: str) -> int:
        """Return the next word as a number of things that are still to come: not negative, not more than words left.

        Raises
        ------
        FormatError : it is neither.
        """
        value = self.integer(what)
        if not 0 <= value <= self.left:
            raise FormatError(f"{self.name}: {what} is {value}, but {self.left} entries are left in the file")
        return value

    def numbers(self, count: int, what: str) -> Array:
        """Return the next ``count`` words as floating-point numbers."""
        return numbers(self.take(count, what), f"{self.name}, {what}")

    def expect(self, word: str) -> None:
        """Take one word that must be this one.

        Raises
        ------
        FormatError : it is another one.
        """
        found = self.take(1, word)[0]
        if found != word:
            raise FormatError(f"{self.name}: expected {word!r}, found {found[:40]!r}")
