"""Files and names that outlast a power cut, and files that are whole or not there."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(file: Path) -> Iterator[Path]:
    """A path beside a file at which to write it: durable and in its place where the block ends well, else gone.

    Whoever reads the file meanwhile sees what was there before. Raises OSError.
    """
    beside = file.with_name(f".{file.name}.{secrets.token_hex(4)}.part")
    try:
        yield beside
        sync_file(beside)
        beside.replace(file)
    finally:
        beside.unlink(missing_ok=True)
    sync_folder(file.parent)


def sync_file(file: Path) -> None:
    """Make durable what a file holds."""
    _sync(file, os.O_RDONLY)


def sync_folder(folder: Path) -> None:
    """Make durable which names a folder holds."""
    _sync(folder, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
