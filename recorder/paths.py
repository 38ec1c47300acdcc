"""Paths as a sentence, a table or JSON can hold them, whatever names a file system admits."""

from __future__ import annotations

from os import PathLike, fsencode
from pathlib import Path


def shown(path: str | PathLike[str]) -> str:
    """The path with what cannot be printed escaped: bytes that are no UTF-8, line ends, other control characters."""
    text = fsencode(path).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def is_file(path: Path) -> bool:
    """Whether there is a file; a name that the system does not admit names none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """The same of a folder."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False
