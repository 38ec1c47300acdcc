"""Brings finished recordings to the service as they come, as long as it takes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from recorder.errors import LinkError, UploadRefusedError
from recorder.recording import sha256_of
from recorder.upload.carrier import Carrier, Destination
from recorder.upload.outbox import Outbox, Parcel

LOOK_S: Final = 30.0
"""Between two looks for recordings that others have put there."""
AGAIN_S: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Between two attempts; after the last so long again and again."""

END_S: Final = 10.0
"""So long the end waits for what is under way; what is not confirmed then is brought another time."""

Tell = Callable[[str, dict[str, Any]], None]


class Uploader:
    """Uploads what is finished in a cell's folder, on a thread of its own, as a context. Nothing is ever deleted.

    `held_back` names the demonstration that is being recorded, whose finished parts do not travel yet. `tell` gets the
    event `uploaded` for each recording that the service has confirmed; `alarm` a sentence when uploading begins to
    fail, or fails otherwise.
    """

    def __init__(
        self,
        folder: Path,
        cell: str,
        destination: Destination,
        held_back: Callable[[], str | None],
        tell: Tell,
        alarm: Callable[[str], None],
    ) -> None:
        self._outbox, self._cell = Outbox(folder, held_back), cell
        self._carrier, self._tell, self._alarm = Carrier(destination), tell, alarm
        self._lock = threading.Lock()
        self._waiting: dict[str, int] = {}
        self._reason: str | None = None
        self._failures = 0
        self._stopping, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-upload", daemon=True)

    def __enter__(self) -> Self:
        self._look()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._wake.set()
        self._carrier.interrupt()
        self._thread.join(END_S)

    def add(self, files: Iterable[Path]) -> None:
        """These recordings are finished. For any thread; never waits."""
        with self._lock:
            self._waiting |= {file.name: file.stat().st_size for file in files}
        self._wake.set()

    def to_data(self) -> dict[str, Any]:
        """What still waits, and why, for the recorder's status. For any thread."""
        with self._lock:
            return {"waiting": len(self._waiting), "waiting_bytes": sum(self._waiting.values()), "reason": self._reason}

    def _look(self) -> list[Parcel]:
        """What waits by what lies there."""
        with self._lock:
            parcels = self._outbox.waiting()
            self._waiting = {parcel.name: parcel.size_bytes for parcel in parcels}
        return parcels

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._wake.clear()
            reason = self._deliver_all()
            if self._stopping.is_set():
                return
            self._note(reason)
            pause_s = AGAIN_S[min(self._failures, len(AGAIN_S)) - 1] if reason else LOOK_S
            self._wake.wait(pause_s)

    def _deliver_all(self) -> str | None:
        """Deliver what waits; why not all of it could be, None if nothing waits any more."""
        reason = None
        try:
            for parcel in self._look():
                reason = self._delivered(parcel) or reason
        except (LinkError, OSError) as error:
            return str(error)
        return reason

    def _delivered(self, parcel: Parcel) -> str | None:
        """Deliver one recording; why the service does not take it. Raises LinkError, OSError: none can be."""
        file = self._outbox.file(parcel)
        self._carrier.reach()
        sha256 = sha256_of([file])
        try:
            self._carrier.carry(file, self._cell, sha256, parcel.size_bytes)
        except UploadRefusedError as error:
            return str(error)
        if self._outbox.is_unchanged(parcel):
            self._outbox.confirm(parcel, sha256)
            with self._lock:
                self._waiting.pop(parcel.name, None)
            self._tell("uploaded", {"file": str(file), "sha256": sha256})
        return None

    def _note(self, reason: str | None) -> None:
        self._failures = self._failures + 1 if reason else 0
        with self._lock:
            before, self._reason = self._reason, reason
        if reason and reason != before:
            self._alarm(reason)
