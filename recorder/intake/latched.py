"""Latched topics: what was published once, before the recording began, and stands in its publisher's cache.

Camera info, static transforms, a map: whoever reads a file needs them, and nobody publishes them again. When a file
begins, all caches of the cell are asked for their newest sample. A publisher that says nothing more for a moment is no
stream, and what its cache holds is written into the file, at the log time at which it was had. Streams begin with
their first sample after the start. Never so poses and gripper, which have their pre-roll, and actions.
"""

from __future__ import annotations

import threading
import time
from typing import Final

import zenoh

from recorder.intake.receiving import Receiver
from recorder.wire import ADVANCED, ESSENTIAL

SILENT_S: Final = 1.0
"""Who has published nothing for so long [s] since the file began is no stream."""
FEW: Final = 100
"""Of a publisher that has published no more than this, all that its cache holds is latched; else the newest alone."""
TIMEOUT_S: Final = 2.0

_Publisher = tuple[str, str]
"""A key and the source that published on it; without sequence numbers the key alone."""


class Latched:
    """What is latched in a cell, for the recording of a receiver. Safe for threads."""

    def __init__(self, session: zenoh.Session, prefix: str, receiver: Receiver) -> None:
        self._session, self._prefix, self._receiver = session, prefix, receiver
        self._lock = threading.Lock()
        self._held: dict[_Publisher, dict[int, zenoh.Sample]] = {}
        self._asked = 0
        self._due_s = 0.0

    def begin(self) -> None:
        """A file begins: ask for what is latched."""
        with self._lock:
            self._held.clear()
            self._due_s = time.monotonic() + SILENT_S
        self._ask(f"{self._prefix}**{ADVANCED}**?_max=1")

    def came(self, key: str) -> None:
        """A publisher has come, whose cache answers at this key."""
        with self._lock:
            self._due_s = time.monotonic() + SILENT_S
        self._ask(f"{key}?_max=1")

    def keep(self, end: bool = False) -> None:
        """Hand over what has proved to be latched; at the `end` of a file as soon as all questions are answered."""
        end_s = time.monotonic() + TIMEOUT_S
        while end and self._asked and time.monotonic() < end_s:
            time.sleep(0.005)
        with self._lock:
            if not self._held or not (end or time.monotonic() >= self._due_s) or not self._receiver.recording:
                return
            held, self._held = self._held, {}
        for samples in held.values():
            self._receiver.receive_latched([samples[number] for number in sorted(samples)])

    @property
    def settled(self) -> bool:
        """Whether every question is answered."""
        return not self._asked

    def _ask(self, selector: str) -> None:
        with self._lock:
            self._asked += 1
        try:
            self._session.get(
                selector,
                zenoh.handlers.Callback(self._answered, self._done),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                timeout=TIMEOUT_S,
            )
        except zenoh.ZError:
            # The session is closing: there is nobody left to ask.
            self._done()

    def _done(self) -> None:
        with self._lock:
            self._asked -= 1

    def _answered(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if sample is None or sample.kind != zenoh.SampleKind.PUT:
            return
        key = str(sample.key_expr)
        topic = f"/{key.removeprefix(self._prefix)}"
        if topic in ESSENTIAL or not self._receiver.records(topic):
            return
        info = sample.source_info
        source = "" if info is None else f"{info.source_id.zid}/{info.source_id.eid}"
        number = 0 if info is None else info.source_sn
        with self._lock:
            known = self._held.setdefault((key, source), {})
            first = not known
            known[number] = sample
        if first and 0 < number < FEW:
            self._ask(f"{key}{ADVANCED}{source}/**?_sn=0..{number}")
