"""Locks between the processes of one machine: files that a process holds until it lets go of them or ends."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from pipelines.errors import TakenError


class _Held(threading.local):
    """The locks that this thread holds."""

    def __init__(self) -> None:
        self.files: set[Path] = set()


_HELD: Final = _Held()


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Hold the lock within the block, after whoever holds it now; a thread that holds it already goes on holding it."""
    if file in _HELD.files:
        yield
        return
    with _opened(file) as descriptor:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        _HELD.files.add(file)
        try:
            yield
        finally:
            _HELD.files.discard(file)


@contextmanager
def owned_alone(file: Path, what: str) -> Iterator[None]:
    """Hold the lock within the block. Raises TakenError, which says who has `what`, if another process holds it."""
    with _opened(file) as descriptor:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(descriptor, 200, 0).decode(errors="replace").strip()
            raise TakenError(what, owner or f"it holds {file}") from None
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()}, since {time.strftime('%H:%M:%S')}\n".encode(), 0)
        yield


@contextmanager
def _opened(file: Path) -> Iterator[int]:
    """The file is left where it is: one that is removed could be held by two."""
    file.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
