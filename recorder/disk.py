"""Room on the disk: whether a demonstration can be finished, and a reserve to end one on a full disk."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import Final

from recorder.errors import DiskError

RESERVE_BYTES: Final = 2 << 20
"""What the reserve holds back: room for the last chunk, the summary and the metadata of an open recording."""
LEAST_BYTES: Final = 6 << 20
"""No recording starts with less than this."""
AVERAGED_S: Final = 5.0
"""The rate is that of so many last seconds."""
FINISH_S: Final = 60.0
"""A demonstration must be able to go on for so long at the cell's present rate."""


def prepare(folder: Path) -> None:
    """Make the folder, and see that it can be written. Raises DiskError."""
    probe = folder / f".writable-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"x")
        probe.unlink()
    except OSError as error:
        raise DiskError(
            f"{folder} cannot be written ({error.strerror}); free it, or set TREEWRIGHT_HOME to a folder that can"
        ) from error


def free_bytes(folder: Path) -> int:
    """Bytes that are free for us on the folder's file system."""
    return shutil.disk_usage(folder).free


class Rate:
    """How fast the cell's messages come [bytes/s], over the last seconds."""

    def __init__(self) -> None:
        self.bytes_s = 0.0
        self._received, self._then_s = 0, time.monotonic()

    def update(self, received: int) -> None:
        """So many bytes have come until now."""
        now_s = time.monotonic()
        elapsed_s = now_s - self._then_s
        rate = (received - self._received) / elapsed_s
        self._received, self._then_s = received, now_s
        self.bytes_s += (rate - self.bytes_s) * min(elapsed_s / AVERAGED_S, 1.0)


def check_room(folder: Path, rate_bytes_s: float) -> None:
    """Raise DiskError unless a demonstration at this rate [bytes/s] can be finished."""
    needed = LEAST_BYTES + int(rate_bytes_s * FINISH_S)
    free = free_bytes(folder)
    if free < needed:
        raise DiskError(
            f"no room to finish a demonstration in {folder}: {free >> 20} MiB are free, "
            f"{-(-needed >> 20)} MiB are needed at the present rate; free some and start again"
        )


class Reserve:
    """Blocks held back on the disk while a recording is open, given back when it must be ended on a full one."""

    def __init__(self, folder: Path, size_bytes: int = RESERVE_BYTES) -> None:
        self.file = folder / f".reserve-{os.getpid()}"
        try:
            with self.file.open("wb") as stream:
                os.posix_fallocate(stream.fileno(), 0, size_bytes)
        except OSError as error:
            self.file.unlink(missing_ok=True)
            raise DiskError(
                f"no room to start a recording in {folder} ({error.strerror}); free some and start again"
            ) from error

    def release(self) -> None:
        """Give the blocks back."""
        self.file.unlink(missing_ok=True)
