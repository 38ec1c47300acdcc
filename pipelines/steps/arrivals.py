"""Recordings that arrive from recorders elsewhere, piece by piece, and are believed by their digest alone.

What has come of one lies in a folder of its own under its digest, so that it goes on there after any cut. When all is
there and its digest is right, it takes its place among the recordings, where ingest finds it.
"""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from learner.errors import LearnerError
from learner.model import check_name
from pipelines.errors import CommandError
from pipelines.home import Home
from recorder.durable import sync_file, sync_folder, whole
from recorder.recording import sha256_of

LEAST_FREE_BYTES: Final = 64 << 20
"""Of the disk, beside what is on its way."""
_DIGEST: Final = re.compile(r"[0-9a-f]{64}", re.ASCII)
_FILE: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap", re.ASCII)
_NUMBER: Final = re.compile(r"[0-9]{1,15}", re.ASCII)


class ParcelRefusedError(CommandError):
    """What a recorder says of a recording is not what it can be."""


class WrongDigestError(CommandError):
    """The bytes that came are not those that were sent; they are forgotten."""


class NoRoomError(CommandError):
    """The disk has no room for a recording; may pass."""


class OvertakenError(CommandError):
    """The bytes do not go on where those that came end; `received_bytes` says where that is."""

    def __init__(self, received_bytes: int) -> None:
        super().__init__(f"so far {received_bytes} bytes have come; go on there")
        self.received_bytes = received_bytes


@dataclass(frozen=True)
class Parcel:
    """A recording that is on its way: the digest of its bytes, its cell, name and size."""

    sha256: str
    cell: str
    name: str
    size_bytes: int

    @staticmethod
    def of(sha256: str, told: Mapping[str, str]) -> Parcel:
        """Raises ParcelRefusedError, also where a name could become a path."""
        name, size = told.get("name", ""), told.get("size_bytes", "")
        if not _FILE.fullmatch(name):
            raise ParcelRefusedError(f"{name!r:.140} is no name of a recording; it is letters, digits, ._- and .mcap")
        try:
            cell = check_name("cell", told.get("cell"))
        except LearnerError as error:
            raise ParcelRefusedError(str(error)) from error
        if not _NUMBER.fullmatch(size) or not int(size):
            raise ParcelRefusedError(f"size_bytes is a whole number from 1, not {size!r:.40}")
        return Parcel(check_digest(sha256), cell, name, int(size))


def check_digest(sha256: str) -> str:
    """Raises ParcelRefusedError."""
    if not _DIGEST.fullmatch(sha256):
        raise ParcelRefusedError(f"{sha256!r:.80} is no SHA-256 in 64 small hexadecimal digits")
    return sha256


def check_offset(text: str) -> int:
    """Raises ParcelRefusedError."""
    if not _NUMBER.fullmatch(text):
        raise ParcelRefusedError(f"offset is a whole number from 0, not {text!r:.40}")
    return int(text)


@dataclass(frozen=True)
class Received:
    """How much of a recording is here, and whether it has taken its place."""

    received_bytes: int
    whole: bool


class Arrivals:
    """What is on its way to a data root. Safe for threads; `arrived` is called with each recording that is whole."""

    def __init__(self, home: Home, arrived: Callable[[Path], None]) -> None:
        self._home, self._arrived = home, arrived
        self._locks: dict[str, threading.Lock] = {}
        self._placing = threading.Lock()

    def received(self, sha256: str) -> Received:
        """How much of a recording is here. Raises ParcelRefusedError."""
        with self._lock(check_digest(sha256)):
            file = self._place_of(sha256)
            return Received(file.stat().st_size, True) if file else Received(self._size(sha256), False)

    def begin(self, parcel: Parcel, offset: int) -> Received:
        """More of a recording is to come, from a byte on, unless it is whole. Raises OvertakenError, NoRoomError."""
        received = self.received(parcel.sha256)
        if received.whole:
            return received
        if offset != received.received_bytes:
            raise OvertakenError(received.received_bytes)
        self._home.arriving.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(self._home.arriving).free - LEAST_FREE_BYTES
        if parcel.size_bytes - offset > free:
            raise NoRoomError(f"no room for {parcel.name}: {max(free, 0) >> 20} MiB are free for recordings")
        return received

    def append(self, parcel: Parcel, offset: int, piece: bytes) -> int:
        """Keep a piece; where the next one begins. What another connection has brought meanwhile stands.

        Raises OvertakenError, ParcelRefusedError for more bytes than there are, OSError.
        """
        end = offset + len(piece)
        if end > parcel.size_bytes:
            raise ParcelRefusedError(f"{parcel.name} has {parcel.size_bytes} bytes as was said, and more have come")
        with self._lock(parcel.sha256):
            if self._size(parcel.sha256) != offset:
                raise OvertakenError(self._size(parcel.sha256))
            with self._part(parcel.sha256).open("ab") as stream:
                stream.write(piece)
        return end

    def finish(self, parcel: Parcel) -> Received:
        """Give a recording its place if all of it is here. Raises WrongDigestError, OSError."""
        with self._lock(parcel.sha256):
            part = self._part(parcel.sha256)
            if self._place_of(parcel.sha256) is None:
                if self._size(parcel.sha256) < parcel.size_bytes:
                    return Received(self._size(parcel.sha256), False)
                self._take_in(parcel, part)
        return self.received(parcel.sha256)

    def _take_in(self, parcel: Parcel, part: Path) -> None:
        sync_file(part)
        if sha256_of([part]) != parcel.sha256:
            part.unlink()
            raise WrongDigestError(f"{parcel.name} came with other bytes than it was sent with; send it again")
        with self._placing:
            file = self._free_place(parcel)
            file.parent.mkdir(parents=True, exist_ok=True)
            part.replace(file)
        for folder in (file.parent, self._home.recordings, self._home.root):
            sync_folder(folder)
        self._note(parcel.sha256, file)
        self._arrived(file)

    def _free_place(self, parcel: Parcel) -> Path:
        """Where it belongs; beside it, if another recording has that name: ingest judges both."""
        file = self._home.recordings / parcel.cell / parcel.name
        if not file.exists() or sha256_of([file]) == parcel.sha256:
            return file
        return file.with_name(f"{file.stem}-{parcel.sha256[:12]}{file.suffix}")

    def _note(self, sha256: str, file: Path) -> None:
        """Remember where it lies."""
        with whole(self._noted(sha256)) as beside:
            beside.write_text(json.dumps({"file": str(file.relative_to(self._home.recordings))}))

    def _place_of(self, sha256: str) -> Path | None:
        """Where a recording lies that has arrived and is still there."""
        try:
            file = self._home.recordings / json.loads(self._noted(sha256).read_text())["file"]
        except (OSError, ValueError, KeyError, TypeError):
            return None  # not arrived, or the note of it is damaged
        return file if file.is_file() else None

    def _lock(self, sha256: str) -> threading.Lock:
        return self._locks.setdefault(sha256, threading.Lock())

    def _part(self, sha256: str) -> Path:
        return self._home.arriving / f"{sha256}.part"

    def _noted(self, sha256: str) -> Path:
        return self._home.arriving / f"{sha256}.json"

    def _size(self, sha256: str) -> int:
        try:
            return self._part(sha256).stat().st_size
        except FileNotFoundError:
            return 0
