"""The recorder of a cell, put together."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from learner.model import check_name
from recorder import disk, wire
from recorder.daemon.board import show_event
from recorder.daemon.buttons import Buttons
from recorder.daemon.desk import Desk
from recorder.daemon.machine import Machine, Options, State
from recorder.daemon.upkeep import Upkeep
from recorder.daemon.voice import OnEvent, Voice
from recorder.errors import SecondRecorderError
from recorder.intake.caches import Caches
from recorder.intake.receiving import Arrival, Receiver
from recorder.notices import Notices
from recorder.recovery import recover_folder, sole_recorder
from recorder.teaching.watch import Watch
from recorder.upload.carrier import Destination
from recorder.upload.uploader import Uploader

ALONE_S: Final = (0.0, 0.2, 0.3)
"""Between the looks for another recorder."""
FENCE_S: Final = 10.0
"""So long a request waits for the samples that came before it."""


class Recorder:
    """Serves one cell on an open session, from entering to leaving its context.

    Leaving closes an open recording durably with outcome `unknown`. `on_event` gets every event that is also
    published on `recorder/events`.

    Raises SecondRecorderError if the cell has a recorder, DiskError if `folder` cannot be written, NameRefusedError
    for a bad name of a cell.
    """

    def __init__(
        self,
        session: zenoh.Session,
        cell: str,
        folder: Path,
        options: Options | None = None,
        on_event: OnEvent = lambda event: None,
    ) -> None:
        self.cell = check_name("cell", cell)
        self.folder, self._session = folder.absolute(), session
        self._prefix, options = wire.prefix_of(cell), options or Options()
        notices, watch = Notices(), Watch()
        self._on_event = on_event
        self.voice = Voice(session, self._key("events"), self._hear_event)
        self.receiver = Receiver(self._prefix, options.patterns, options.pre_roll_s, self._hear, watch.note, notices)
        self._caches = Caches(session, self._prefix, self.receiver)
        self._desk = Desk(session, self._key(""), self._fence, self._fulfil, self.voice)
        self._uploader = self._make_uploader(options.upload_to) if options.upload_to else None
        submit = self._desk.submit
        self.machine = Machine(
            self.cell,
            self.folder,
            options,
            self.receiver,
            self._caches,
            watch,
            notices,
            self.voice,
            submit,
            self._uploader,
        )
        self._buttons = Buttons(self.machine, self.receiver, watch, self.voice, submit)
        self._upkeep = Upkeep(self.machine, self.receiver, watch, notices, self.voice, self._desk)
        self._opened = contextlib.ExitStack()

    def __enter__(self) -> Self:
        disk.prepare(self.folder)
        with contextlib.ExitStack() as undo:
            self._be_alone()
            undo.enter_context(sole_recorder(self.folder, self.cell))
            undo.enter_context(self.voice)
            recover_folder(self.folder, self.voice.tell_recovery)
            undo.enter_context(self._session.liveliness().declare_token(self._key("alive")))
            undo.enter_context(self._session.declare_subscriber(f"{self._prefix}**", self.receiver.receive))
            undo.enter_context(self._caches)
            if self._uploader:
                undo.enter_context(self._uploader)
            undo.callback(self.machine.close)
            undo.enter_context(self._desk)
            undo.enter_context(self._upkeep)
            self._opened = undo.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def _make_uploader(self, destination: Destination) -> Uploader:
        return Uploader(
            self.folder,
            self.cell,
            destination,
            held_back=lambda: self.machine.take.demonstration_id if self.machine.take else None,
            tell=lambda event, more: self.voice.tell(event, **more),
            alarm=self.voice.alarm,
        )

    @property
    def state(self) -> State:
        """What the recorder does now."""
        return self.machine.state

    def _key(self, verb: str) -> str:
        return f"{self._prefix}recorder/{verb}"

    def _be_alone(self) -> None:
        for pause_s in ALONE_S:
            # A session that was opened just now hears only little by little what others have declared.
            time.sleep(pause_s)
            for reply in self._session.liveliness().get(self._key("alive"), timeout=2.0):
                if reply.ok is not None:
                    raise SecondRecorderError(self.cell)

    def _fence(self) -> None:
        self.receiver.fence.await_samples(self._session, FENCE_S)

    def _hear_event(self, told: dict[str, Any]) -> None:
        self._on_event(told)
        show_event(self.receiver, told)

    def _hear(self, arrival: Arrival) -> None:
        """An action has arrived (on the receiving thread): judge it elsewhere."""
        self._desk.submit(lambda: self._buttons.hear(arrival))

    def _fulfil(self, verb: str, request: Mapping[str, Any]) -> dict[str, Any]:
        machine = self.machine
        answering = {"start": machine.start, "stop": machine.stop, "press": self._buttons.press}
        if verb in answering:
            return answering[verb](request)
        changing: dict[str, Callable[[], None]] = {
            "discard": machine.discard, "pause": machine.pause, "resume": machine.resume, "split": machine.split,
        }  # fmt: skip
        if verb in changing:
            changing[verb]()
        return machine.status()
