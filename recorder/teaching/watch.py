"""What the cell shows now: taken down as it comes, decoded when somebody asks."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from recorder.teaching.feedback import NOT_WATCHING, Sightings
from recorder.teaching.known import Known
from recorder.wire import POSES

MOST: Final = 4096
"""So many messages wait to be decoded; of more the oldest are forgotten."""


class Watch:
    """Poses and gripper of the cell, and the sightings of the present demonstration. Safe for threads."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[str, int, bytes]] = deque(maxlen=MOST)
        self._sightings, self._known = NOT_WATCHING, Known()
        self._lock = threading.Lock()

    def note(self, message: tuple[str, int, bytes]) -> None:
        """Take down a message: its topic, its log time [ns] and its payload. Never waits."""
        self._waiting.append(message)

    def begin(self, sightings: Sightings) -> None:
        """A demonstration begins: what was wrong with stamps in another must not blind it."""
        with self._lock:
            self._waiting.clear()
            self._sightings = sightings

    def end(self) -> None:
        """The demonstration has ended."""
        self.begin(NOT_WATCHING)

    @contextmanager
    def sightings(self) -> Iterator[Sightings]:
        """Those of the present demonstration, with all that has come, held as long as the context lasts."""
        with self._lock:
            self._take()
            yield self._sightings

    def update(self) -> None:
        """Decode what has come."""
        with self._lock:
            self._take()

    def missing(self, wanted: Mapping[str, str], base_frame: str, now_ns: int) -> str | None:
        """What of `wanted` the cell's poses do not tell of, as `Known.missing`."""
        with self._lock:
            self._take()
            return self._known.missing(wanted, base_frame, now_ns)

    def _take(self) -> None:
        while self._waiting:
            topic, log_ns, payload = self._waiting.popleft()
            if topic == POSES:
                self._known.take(payload, log_ns)
            take = self._sightings.add if topic == POSES else self._sightings.add_gripper
            take(payload, log_ns)
