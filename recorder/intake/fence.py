"""A fence between samples and requests, which come on threads of their own."""

from __future__ import annotations

import itertools
import threading

import zenoh


class Fence:
    """A sample to oneself goes behind all others: when it has come, so have they. Safe for threads."""

    def __init__(self, key: str) -> None:
        self.key = key
        self._numbers, self._passed = itertools.count(1), 0
        self._changed = threading.Condition()

    def await_samples(self, session: zenoh.Session, patience_s: float) -> None:
        """Until every sample that reached this process before has been taken in, or the patience [s] ends."""
        with session.declare_publisher(
            self.key,
            allowed_destination=zenoh.Locality.SESSION_LOCAL,
            congestion_control=zenoh.CongestionControl.BLOCK,
        ) as publisher:
            number = next(self._numbers)
            publisher.put(str(number))
        with self._changed:
            self._changed.wait_for(lambda: self._passed >= number, patience_s)

    def take(self, sample: zenoh.Sample) -> None:
        """A sample on the key has come."""
        with self._changed:
            self._passed = max(self._passed, int(sample.payload.to_bytes()))
            self._changed.notify_all()
