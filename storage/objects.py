"""Immutable bytes in files named by their SHA-256: what an artifact store keeps beside its database."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Final, NamedTuple

from storage.errors import DamagedError

DIGEST: Final = re.compile(r"[0-9a-f]{64}")
REMEMBERED_BYTES: Final = 64 << 20
"""How much verified text is kept in memory, the least recently read forgotten first."""


class Seen(NamedTuple):
    """What tells that a file is the one whose bytes were hashed: any write to it changes one of these."""

    inode: int
    size: int
    modified_ns: int
    changed_ns: int


class Objects:
    """The files below `root`, which is created by the first one. Threads may share it.

    A file is hashed when it is read for the first time, and again once it is not the file that was hashed.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._verified: OrderedDict[str, tuple[Seen, str]] = OrderedDict()
        self._remembered = 0
        self._lock = threading.Lock()

    def save(self, text: str) -> str:
        """Keep `text` and return its digest: written beside, durable, renamed. What is there is verified and kept."""
        content = text.encode()
        sha256 = hashlib.sha256(content).hexdigest()
        path = self._path(sha256)
        if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() == sha256:
            return sha256
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(f"{sha256}.{secrets.token_hex(4)}.part")
        try:
            with beside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.chmod(0o444)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
        for folder in (path.parent, self.root, self.root.parent):  # each of them may be new
            sync_folder(folder)
        return sha256

    def load(self, sha256: str, what: str) -> str:
        """The text under a digest; `what` it is for the error. Raises DamagedError if it is gone or has changed."""
        path = self._path(sha256)
        try:
            with path.open("rb") as file:
                seen = _seen(os.fstat(file.fileno()))
                remembered = self._recall(sha256, seen)
                content = b"" if remembered is not None else file.read()
        except FileNotFoundError as error:
            raise DamagedError(f"{what} is gone: {path} does not exist") from error
        if remembered is not None:
            return remembered
        if hashlib.sha256(content).hexdigest() != sha256:
            raise DamagedError(f"{what} is damaged: {path} does not have its digest")
        return self._remember(sha256, seen, content.decode())

    def forget(self) -> None:
        """Hash every file again at its next reading."""
        with self._lock:
            self._verified.clear()
            self._remembered = 0

    def _path(self, sha256: str) -> Path:
        if not DIGEST.fullmatch(sha256):
            raise DamagedError(f"the store's database names the digest {sha256[:80]!r}, which is none")
        return self.root / sha256[:2] / sha256

    def _recall(self, sha256: str, seen: Seen) -> str | None:
        with self._lock:
            known, text = self._verified.get(sha256, (None, ""))
            if known != seen:
                return None
            self._verified.move_to_end(sha256)
            return text

    def _remember(self, sha256: str, seen: Seen, text: str) -> str:
        with self._lock:
            if previous := self._verified.pop(sha256, None):
                self._remembered -= len(previous[1])
            self._verified[sha256] = seen, text
            self._remembered += len(text)
            while self._remembered > REMEMBERED_BYTES:
                _, (_, forgotten) = self._verified.popitem(last=False)
                self._remembered -= len(forgotten)
        return text


def sync_folder(folder: Path) -> None:
    """Make durable which names a folder holds."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _seen(status: os.stat_result) -> Seen:
    return Seen(status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
