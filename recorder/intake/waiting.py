"""Between the receiving threads and the disk: bounded, and never waiting."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import Final

from recorder.recording.chunks import CHUNK_BYTES, OVERHEAD, Batch

RESERVE_BYTES: Final = 32 << 20
"""Beyond the limit, for poses, gripper and actions alone: a camera's images must not push them out."""


class Intake:
    """Messages that wait to be written. `add` never waits; `take` waits for as much as makes a chunk.

    `limit_bytes` bounds the memory of what waits; what does not fit is refused, and the caller counts it.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self.waiting_bytes = 0
        """Bytes that are not written yet."""
        self._full: deque[Batch] = deque()
        self._batch = Batch()
        # Entered as a plain lock where nothing is waited for: a condition's own entering costs a microsecond.
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._closed = False
        self._taken_bytes = 0

    def add(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes, essential: bool, action: bool
    ) -> bool:
        """Keep a message; False if there is no room. An action closes the chunk at once."""
        size = len(payload) + OVERHEAD
        with self._lock:
            room = self.limit_bytes + (RESERVE_BYTES if essential else 0)
            if self._closed or self.waiting_bytes + size > room:
                return False
            self.waiting_bytes += size
            batch = self._batch
            batch.add(channel, sequence, log_ns, publish_ns, payload)
            batch.actions += action
            if action or batch.size_bytes >= CHUNK_BYTES:
                self._close_batch()
        return True

    def put_first(self, batch: Batch) -> None:
        """Keep the pre-roll, before anything else."""
        with self._changed:
            self.waiting_bytes += batch.size_bytes
            self._full.appendleft(batch)
            self._changed.notify()

    def close(self) -> None:
        """Nothing more will come."""
        with self._changed:
            self._closed = True
            self._close_batch()

    def take(self, patience_s: float) -> Batch | None:
        """What makes a chunk: its size, an action, or whatever came within `patience_s` [s]. None: closed and empty."""
        with self._changed:
            self.waiting_bytes -= self._taken_bytes
            self._taken_bytes = 0
            if not (self._full or self._closed):
                self._changed.wait(patience_s)
                if not self._full:
                    self._close_batch()
            batch = self._full.popleft() if self._full else Batch()
            self._taken_bytes = batch.size_bytes
            return None if self._closed and not len(batch) and not self._full else batch

    def _close_batch(self) -> None:
        if len(self._batch):
            self._full.append(self._batch)
            self._batch = Batch()
        self._changed.notify()


@dataclass
class PreRoll:
    """The last moments of poses and gripper before a start; forgotten at every stop."""

    length_ns: int
    limit_bytes: int = 64 << 20
    _kept: deque[tuple[int, int, int, int, bytes]] = field(default_factory=deque)
    _size_bytes: int = 0

    def add(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Keep a message for `length_ns`, or for as long as memory allows."""
        kept = self._kept
        kept.append((log_ns, channel, sequence, publish_ns, payload))
        self._size_bytes += len(payload) + OVERHEAD
        while kept and (kept[0][0] < log_ns - self.length_ns or self._size_bytes > self.limit_bytes):
            self._size_bytes -= len(kept.popleft()[4]) + OVERHEAD

    def move(self, by_ns: int) -> None:
        """The clock of the log was set by so much [ns]: what is kept is as old as before."""
        kept = [(log_ns + by_ns, *rest) for log_ns, *rest in self._kept]
        self._kept = deque(kept)  # type: ignore[arg-type]  # a star in a tuple has no types

    def take(self, now_ns: int) -> Batch:
        """What is not older than the pre-roll's length, and nothing is kept any more."""
        batch = Batch()
        for log_ns, channel, sequence, publish_ns, payload in self._kept:
            if log_ns >= now_ns - self.length_ns:
                batch.add(channel, sequence, log_ns, publish_ns, payload)
        self.clear()
        return batch

    def clear(self) -> None:
        """Forget everything: what was before a stop never precedes a start."""
        self._kept.clear()
        self._size_bytes = 0
