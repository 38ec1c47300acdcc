"""The state machine of a recorder: what is recorded, from when to when, and in which files."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

from recorder import disk
from recorder.daemon.board import show_scene
from recorder.daemon.desk import sentence_of
from recorder.daemon.requests import Start, parse_outcome
from recorder.daemon.take import Take
from recorder.daemon.voice import Voice
from recorder.daemon.writing import Writing
from recorder.errors import RecorderError, RequestRefusedError
from recorder.intake.caches import Caches
from recorder.intake.patterns import Patterns
from recorder.intake.receiving import Receiver
from recorder.notices import Notices
from recorder.recording import Demonstrated
from recorder.teaching.feedback import Plausible, Sightings
from recorder.teaching.presses import Presses
from recorder.teaching.watch import Watch
from recorder.upload.carrier import Destination
from recorder.upload.uploader import Uploader

State = Literal["idle", "recording", "paused"]
LOOK_S: Final = 0.02
"""Between two looks for what is on its way."""
APPEARS_S: Final = 1.0
"""So long a start waits for names of which the cell's poses have not told yet."""
SETTLE_NETWORK_S: Final = 4.0
"""So long a stop waits for what publishers' caches still have, if anything is missing."""


@dataclass(frozen=True)
class Options:
    """How a recorder records. Sizes in bytes, times in seconds; None is without limit.

    `cell` is what a request to start may leave out because the recorder knows its cell: objects, frames, scene.
    """

    pre_roll_s: float = 2.0
    buffer_bytes: int = 256 << 20
    split_bytes: int | None = None
    split_s: float | None = None
    patterns: Patterns = field(default_factory=Patterns)
    upload_to: Destination | None = None
    """The service to which finished recordings travel."""
    plausible: Plausible = field(default_factory=Plausible)
    cell: Mapping[str, Any] = field(default_factory=dict)


class Machine:
    """Idle, recording or paused. All but `state`, `take` and `status` is for one thread, that of the requests.

    `submit` has something done on that thread; `uploader` is told of what is finished, if there is one.
    """

    def __init__(
        self,
        cell: str,
        folder: Path,
        options: Options,
        receiver: Receiver,
        caches: Caches,
        watch: Watch,
        notices: Notices,
        voice: Voice,
        submit: Callable[[Callable[[], None]], None],
        uploader: Uploader | None,
    ) -> None:
        self.cell, self.folder, self.options = cell, folder, options
        self.rate = disk.Rate()
        self.take: Take | None = None
        """The demonstration being recorded."""
        self._receiver, self._caches, self._watch = receiver, caches, watch
        self._notices, self._voice, self._submit, self._uploader = notices, voice, submit, uploader
        self._paused = False

    @property
    def state(self) -> State:
        """What the recorder does now."""
        if self.take is None:
            return "idle"
        return "paused" if self._paused else "recording"

    @property
    def situation(self) -> str:
        """The state as a sentence."""
        if self.take is None:
            return f"nothing is being recorded in {self.cell}; send start first"
        return f"{self.take.demonstration_id} is {self.state} in {self.cell}"

    def needs(self, verb: str, condition: bool) -> Take:
        """The demonstration being recorded. Raises RequestRefusedError without one, and unless a condition holds."""
        if self.take is None or not condition:
            raise RequestRefusedError(f"cannot {verb}: {self.situation}")
        return self.take

    # --- what is asked for

    def start(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a demonstration. Raises RequestRefusedError, DiskError."""
        said = {name: value for name, value in request.items() if value is not None}
        start = Start.parse({**self.options.cell, **said})
        if self.take is not None:
            raise RequestRefusedError(f"cannot start: {self.situation}; stop or discard it first")
        disk.check_room(self.folder, self.rate.bytes_s)
        self._needs_to_be_seen(start)
        demonstrated = start.demonstrated(_new_id(start.task), self.cell, time.time_ns())
        self._voice.forget()
        self._notices.clear()
        self._watch.begin(Sightings(start.base_frame, (*start.objects, start.end_effector_frame), self._notices))
        writing = self._writing(demonstrated)
        self._paused = False
        take = Take(demonstrated, writing, time.monotonic(), Presses(demonstrated, self.options.plausible))
        take.demonstrated = replace(demonstrated, start_ns=self._receiver.begin(writing.intake))
        self.take = take
        self._caches.latched.begin()
        show_scene(self._receiver, take.demonstrated)
        begun = {"demonstration_id": take.demonstration_id, "file": str(writing.file)}
        self._voice.tell("start", **begun)
        return begun

    def stop(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """End the demonstration; its file is durable. Raises RequestRefusedError, OSError."""
        outcome = parse_outcome(request)
        take = self.needs("stop", True)
        with self._watch.sightings() as sightings:
            reason = take.presses.contradiction(sightings)
        if reason and outcome == "success":
            raise RequestRefusedError(
                f"cannot stop with outcome success: {reason}; take it back with undo, or stop with another outcome"
            )
        return self._end(take, outcome)

    def discard(self) -> None:
        """Take the demonstration off the disk. Raises RequestRefusedError."""
        take = self.needs("discard", True)
        self.take = None
        self._receiver.end()
        self._watch.end()
        take.writing.discard()
        for part in take.parts:
            part.file.unlink(missing_ok=True)
        self._receiver.forget()
        self._voice.tell("discard", demonstration_id=take.demonstration_id)

    def pause(self) -> None:
        """Record nothing until `resume`. Raises RequestRefusedError."""
        self.needs("pause", self.state == "recording")
        self._receiver.pause()
        self._paused = True
        self._voice.tell("pause")

    def resume(self) -> None:
        """Record again. Raises RequestRefusedError."""
        self.needs("resume", self.state == "paused")
        self._receiver.resume()
        self._paused = False
        self._voice.tell("resume")

    def split(self) -> None:
        """Go on in another file, between two samples, before the present one is closed. Raises RequestRefusedError."""
        take = self.needs("split", True)
        part = (take.demonstrated.part or 1) + 1
        following = replace(take.demonstrated, part=part)
        writing = self._writing(following)
        self._caches.latched.keep(end=True)
        balance = self._receiver.swap(writing.intake)
        self._caches.latched.begin()
        before = take.go_on(following, writing, time.monotonic())
        show_scene(self._receiver, following)
        finished = before.finish("unknown", balance, self._notices.sentences, continued=True)
        take.add_part(before, finished)
        self._voice.tell("split", file=str(finished.file), part=part - 1, next_file=str(writing.file))

    def status(self) -> dict[str, Any]:
        """The reply to `status` (CONTRACT, section 1). For any thread."""
        take = self.take
        counts, lost, refused = self._receiver.counted() if take else ({}, {}, {})
        return {
            "state": self.state,
            "demonstration_id": take.demonstration_id if take else None,
            "file": str(take.writing.file) if take else None,
            "messages": counts,
            "lost": lost,
            "overflowed": refused,
            "actions_durable": take.actions_durable if take else 0,
            "disk_free_bytes": disk.free_bytes(self.folder),
            "alarms": self._voice.alarms,
            "notes": list(self._notices.sentences) if take else [],
            "unseen": list(self._unseen(take)) if take else [],
            "part": take.demonstrated.part if take else None,
            "uploads": self._uploader.to_data() if self._uploader else None,
        }

    # --- what happens by itself

    def close(self) -> None:
        """End an open demonstration durably, with outcome `unknown`. Raises OSError."""
        if self.take is not None:
            self._end(self.take, "unknown")

    def is_split_due(self) -> bool:
        """Whether the present part is as large or as long as parts may be. For any thread."""
        take, options = self.take, self.options
        if take is None:
            return False
        large = options.split_bytes is not None and take.writing.size_bytes >= options.split_bytes
        return large or (options.split_s is not None and time.monotonic() - take.begun_s >= options.split_s)

    def split_if_due(self) -> None:
        """Split, unless that was just done."""
        if self.is_split_due():
            self.split()

    def _end_on_error(self, error: OSError) -> None:
        """The disk takes no more: close what is written, and say so."""
        take = self.take
        if take is None or take.writing.error is None:
            return
        reason = error.strerror or str(error)
        name = f"the recording {take.demonstration_id}"
        self._voice.alarm(f"{name} has ended by itself, because the disk fails: {reason}; free it")
        try:
            self._end(take, "unknown", reason=reason)
        except (OSError, RecorderError) as failure:
            self._voice.alarm(f"{name} could not be closed ({sentence_of(failure)}); recover it later")

    def _say_durable(self) -> None:
        if self.take is not None:
            self._voice.tell("durable", actions_durable=self.take.actions_durable)

    # --- how it is done

    def _end(self, take: Take, outcome: str, **more: Any) -> dict[str, Any]:
        self._caches.settle(SETTLE_NETWORK_S)
        self._receiver.end()
        self._watch.update()
        self._watch.end()
        self.take = None
        take.writing.drain()
        balance = self._receiver.close_account(take.writing.unwritten)
        self._voice.tell_notices(self._notices)
        notes = self._notices.sentences
        finished = take.finish(outcome, balance, notes)
        report = take.report(finished, balance, notes)
        self._voice.tell("stop", outcome=outcome, **report, **more)
        if self._uploader:
            self._uploader.add(part.file for part in (*take.parts, finished))
        return report

    def _needs_to_be_seen(self, start: Start) -> None:
        """Raises RequestRefusedError for names that nobody publishes, unless the request takes them all the same."""
        end_s = time.monotonic() + APPEARS_S
        while not start.unseen_ok and (missing := self._missing(start)):
            if time.monotonic() >= end_s:
                raise RequestRefusedError(f"cannot start: {missing}; check the names, or send `unseen_ok`: true")
            time.sleep(LOOK_S)

    def _missing(self, start: Start) -> str | None:
        return self._watch.missing(start.wanted, start.base_frame, self._receiver.clock.now_ns())

    def _unseen(self, take: Take) -> tuple[str, ...]:
        objects = take.demonstrated.objects
        with self._watch.sightings() as sightings:
            missing = sightings.unseen(objects, self.options.plausible)
        return tuple(name for name in objects if name in {*missing, *take.unseen})

    def _writing(self, demonstrated: Demonstrated) -> Writing:
        part = demonstrated.part or 1
        name = demonstrated.demonstration_id + (f"-part{part}" if part > 1 else "")
        return Writing(
            self.folder / f"{name}.mcap",
            demonstrated,
            self._receiver.channels.describe,
            self.options.buffer_bytes,
            on_durable=lambda count: self._submit(self._say_durable),
            on_error=lambda error: self._submit(lambda: self._end_on_error(error)),
        )


def _new_id(task: str) -> str:
    """Tells a person what and when, and never repeats; a name of the contract."""
    return f"{task[:32]}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(4)}"
