"""What a recorder does without anybody asking, a few times a second."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Final, Self

from recorder.daemon.desk import Desk
from recorder.daemon.machine import Machine
from recorder.daemon.voice import Voice
from recorder.intake.receiving import Receiver
from recorder.notices import Notices
from recorder.teaching.watch import Watch
from recorder.wire import GRIPPER, POSES

TICK_S: Final = 0.25
SILENCE_S: Final = 2.0
"""A topic that learning needs and on which nothing has come for so long [s] since the start is worth an alarm."""


class Upkeep:
    """Looks after the recording on a thread of its own, as a context."""

    def __init__(
        self, machine: Machine, receiver: Receiver, watch: Watch, notices: Notices, voice: Voice, desk: Desk
    ) -> None:
        self._machine, self._receiver, self._watch = machine, receiver, watch
        self._notices, self._voice, self._desk = notices, voice, desk
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-clock", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(TICK_S):
            self._machine.rate.update(self._receiver.received_bytes)
            self._watch.update()
            self._receiver.note_restarts()
            self._note_clock()
            self._note_silence()
            if self._notices.untold:
                self._desk.submit(lambda: self._voice.tell_notices(self._notices))
            if self._machine.is_split_due():
                self._desk.submit(self._machine.split_if_due)

    def _note_clock(self) -> None:
        sentence = self._receiver.clock.noticed()
        if sentence and self._machine.take is not None:
            self._notices.add(sentence)

    def _note_silence(self) -> None:
        take = self._machine.take
        if take is None or take.silence_told or self._machine.state == "paused":
            return
        if time.monotonic() < take.begun_s + SILENCE_S:
            return
        take.silence_told = True
        for topic in (POSES, GRIPPER):
            if not take.parts and topic not in self._receiver.counts:
                self._notices.add(f"nothing is published on {topic} in {self._machine.cell}")
