"""The recorder of a cell: one state machine between the network, the open recording and the operator."""

from __future__ import annotations

import contextlib
import json
import queue
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self

import zenoh

from learner.model import ActionPress, check_name
from recorder import disk, wire
from recorder.control import Start, parse_outcome, parse_press, parse_request
from recorder.errors import PayloadError, RecorderError, RequestRefusedError, SecondRecorderError
from recorder.feedback import NOT_WATCHING, Plausible, Sightings, gaps_near_actions
from recorder.intake.caches import Caches
from recorder.intake.known import Known
from recorder.intake.receiving import Arrival, Patterns, Receiver
from recorder.notices import Notices
from recorder.presses import Pressed, Presses
from recorder.recording import Demonstrated, Finished
from recorder.recovery import recover_folder, sole_recorder
from recorder.writing import Writing

State = Literal["idle", "recording", "paused"]
MOST_ALARMS: Final = 20
NOTES: Final = "notes"
"""The entry of a recording's metadata that tells, as a JSON array of sentences, what was odd."""
SETTLE_S: Final = 0.4
"""Poses that arrive later than the press get so long before the operator is told that one is missing."""
ANSWER_S: Final = 0.2
"""A press that is not accepted is answered after so long [s], in case that what it needs is on its way."""
LOOK_S: Final = 0.02
"""Between two looks for what is on its way."""
APPEARS_S: Final = 1.0
"""So long a start waits for names of which the cell's poses have not told yet."""
TICK_S: Final = 0.25
SILENCE_S: Final = 2.0
"""A topic that learning needs and on which nothing has come for so long [s] since the start is worth an alarm."""
ALONE_S: Final = (0.0, 0.2, 0.3)
"""Between the looks for another recorder."""
FENCE_S: Final = 10.0
"""So long a request waits for the samples that came before it."""
SETTLE_NETWORK_S: Final = 4.0
"""So long a stop waits for what publishers' caches still have, if anything is missing."""
_Event = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Options:
    """How a recorder records. Sizes in bytes, times in seconds; None is without limit."""

    pre_roll_s: float = 2.0
    buffer_bytes: int = 256 << 20
    split_bytes: int | None = None
    split_s: float | None = None
    patterns: Patterns = field(default_factory=Patterns)
    plausible: Plausible = field(default_factory=Plausible)


@dataclass
class _Open:
    """The demonstration being recorded: its present part and the finished ones."""

    demonstrated: Demonstrated
    writing: Writing
    begun_s: float
    presses: Presses
    parts: list[Finished] = field(default_factory=list)
    durable_before: int = 0
    """Actions in the parts that are finished."""
    unseen: tuple[str, ...] = ()
    silence_told: bool = False
    """Whether topics on which nothing comes have been looked for."""
    stamps: list[tuple[int, str]] = field(default_factory=list)
    """Stamp [ns] and type of every action."""

    @property
    def actions_durable(self) -> int:
        return self.durable_before + self.writing.actions_durable


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
        on_event: _Event = lambda event: None,
    ) -> None:
        self.cell = check_name("cell", cell)
        self.folder = folder.absolute()
        self.options = options or Options()
        self._session, self._on_event = session, on_event
        self._prefix = wire.prefix_of(cell)
        self._open: _Open | None = None
        self._paused = False
        self._alarms: deque[str] = deque(maxlen=MOST_ALARMS)
        self._sightings, self._known = NOT_WATCHING, Known()
        self._sightings_lock = threading.Lock()
        self._early: deque[tuple[str, int, bytes]] = deque(maxlen=4096)
        self._requests: queue.SimpleQueue[tuple[str, zenoh.Query] | Callable[[], None] | None] = queue.SimpleQueue()
        self._status_requests: queue.SimpleQueue[zenoh.Query | None] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._rate_bytes_s = 0.0
        self._notices = Notices()
        self._receiver = Receiver(
            self._prefix, self.options.patterns, self.options.pre_roll_s, self._acted, self._early.append, self._notices
        )
        self._caches = Caches(session, self._prefix, self._receiver)
        self._opened = contextlib.ExitStack()
        self._threads: list[threading.Thread] = []

    # --- opening and closing

    def __enter__(self) -> Self:
        disk.prepare(self.folder)
        with contextlib.ExitStack() as undo:
            self._be_alone()
            undo.enter_context(sole_recorder(self.folder, self.cell))
            self._events = undo.enter_context(self._session.declare_publisher(self._key("events")))
            recover_folder(self.folder, self._tell_recovery)
            undo.enter_context(self._session.liveliness().declare_token(self._key("alive")))
            undo.enter_context(self._session.declare_subscriber(f"{self._prefix}**", self._receiver.receive))
            undo.enter_context(self._caches)
            undo.enter_context(self._session.declare_queryable(self._key("*"), self._asked))
            self._opened = undo.pop_all()
        self._threads = [
            threading.Thread(target=run, name=f"recorder-{name}", daemon=True)
            for name, run in (("control", self._control), ("status", self._answer_status), ("clock", self._clock))
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._requests.put(None)
        self._status_requests.put(None)
        for thread in self._threads:
            thread.join()
        try:
            if self._open:
                self._stop("unknown")
        finally:
            self._opened.close()

    def _tell_recovery(self, fate: str, sentence: str) -> None:
        self._tell("recovery", fate=fate, sentence=sentence)
        self._alarms.append(sentence)

    def _key(self, verb: str) -> str:
        return f"{self._prefix}recorder/{verb}"

    def _be_alone(self) -> None:
        for pause_s in ALONE_S:
            # A session that was opened just now hears only little by little what others have declared.
            time.sleep(pause_s)
            for reply in self._session.liveliness().get(self._key("alive"), timeout=2.0):
                if reply.ok is not None:
                    raise SecondRecorderError(self.cell)

    # --- requests

    def _asked(self, query: zenoh.Query) -> None:
        """Take a request from the receiving thread; never wait there."""
        verb = str(query.key_expr).removeprefix(self._key(""))
        if verb == "status":
            self._status_requests.put(query)
        else:
            self._requests.put((verb, query))

    def _control(self) -> None:
        while (request := self._requests.get()) is not None:
            if callable(request):
                self._do(request)
            else:
                self._answer(*request)

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except (RecorderError, OSError) as error:
            self._alarm(_sentence(error))
        except Exception as error:  # noqa: BLE001  # whatever one message brought up, the next request is answered
            self._alarm(f"a defect of the recorder: {type(error).__name__}: {error}")

    def _answer_status(self) -> None:
        while (query := self._status_requests.get()) is not None:
            self._answer("status", query)

    def _answer(self, verb: str, query: zenoh.Query) -> None:
        with query:
            try:
                request = parse_request(verb, query.payload.to_bytes() if query.payload else b"")
                self._receiver.fence(self._session, FENCE_S)
                reply = self._fulfil(verb, request)
            except (RecorderError, OSError) as error:
                query.reply_err(_json({"error": _sentence(error)}), encoding=wire.JSON_ENCODING)
            except Exception as error:  # noqa: BLE001  # an empty reply would look like no recorder at all
                sentence = f"a defect of the recorder at the request {verb}: {type(error).__name__}: {error}"
                self._alarm(sentence)
                query.reply_err(_json({"error": sentence}), encoding=wire.JSON_ENCODING)
            else:
                query.reply(self._key(verb), _json(reply), encoding=wire.JSON_ENCODING)

    def _fulfil(self, verb: str, request: Mapping[str, Any]) -> dict[str, Any]:
        if verb == "start":
            return self._start(Start.parse(request))
        if verb == "stop":
            outcome = parse_outcome(request)
            self._needs("stop", self._open is not None)
            self._needs_to_agree(outcome)
            return self._stop(outcome)
        if verb == "press":
            return self._press(request)
        if verb != "status":
            {"discard": self._discard, "pause": self._pause, "resume": self._resume, "split": self._split}[verb]()
        return self.status()

    def _needs(self, verb: str, condition: bool) -> None:
        if not condition:
            raise RequestRefusedError(f"cannot {verb}: {self._situation()}")

    def _needs_to_agree(self, outcome: str) -> None:
        """A demonstration in which something stands that contradicts what was seen is no success."""
        assert self._open is not None
        self._take_poses()
        with self._sightings_lock:
            reason = self._open.presses.contradiction(self._sightings)
        if reason and outcome == "success":
            raise RequestRefusedError(
                f"cannot stop with outcome success: {reason}; take it back with undo, or stop with another outcome"
            )

    def _situation(self) -> str:
        if self._open is None:
            return f"nothing is being recorded in {self.cell}; send start first"
        return f"{self._open.demonstrated.demonstration_id} is {self.state} in {self.cell}"

    # --- the state machine

    @property
    def state(self) -> State:
        """What the recorder does now."""
        if self._open is None:
            return "idle"
        return "paused" if self._paused else "recording"

    def status(self) -> dict[str, Any]:
        """The reply to `status` (CONTRACT, section 1)."""
        now = self._open
        with self._receiver.lock:
            counts = dict(sorted(self._receiver.counts.items())) if now else {}
            lost = self._receiver.ledger.lost(counts) if now else {}
            refused = self._receiver.ledger.refusals if now else {}
        return {
            "state": self.state,
            "demonstration_id": now.demonstrated.demonstration_id if now else None,
            "file": str(now.writing.file) if now else None,
            "messages": counts,
            "lost": lost,
            "overflowed": refused,
            "actions_durable": now.actions_durable if now else 0,
            "disk_free_bytes": disk.free_bytes(self.folder),
            "alarms": list(self._alarms),
            "notes": list(self._notices.sentences) if now else [],
            "unseen": list(self._unseen(now)) if now else [],
            "part": now.demonstrated.part if now else None,
        }

    def _unseen(self, now: _Open) -> tuple[str, ...]:
        self._take_poses()
        with self._sightings_lock:
            missing = self._sightings.unseen(now.demonstrated.objects, self.options.plausible)
        return tuple(name for name in now.demonstrated.objects if name in {*missing, *now.unseen})

    def _start(self, start: Start) -> dict[str, Any]:
        if self._open is not None:
            raise RequestRefusedError(f"cannot start: {self._situation()}; stop or discard it first")
        disk.check_room(self.folder, self._rate_bytes_s)
        self._needs_to_be_seen(start)
        demonstrated = Demonstrated(
            demonstration_id=_new_id(start.task),
            task=start.task,
            user=start.user,
            cell=self.cell,
            base_frame=start.base_frame,
            end_effector_frame=start.end_effector_frame,
            objects=start.objects,
            start_ns=time.time_ns(),
            scene=start.scene,
        )
        self._alarms.clear()
        self._notices.clear()
        self._watch(Sightings(start.base_frame, (*start.objects, start.end_effector_frame), self._notices))
        writing = self._writing(demonstrated)
        self._paused = False
        now = _Open(demonstrated, writing, time.monotonic(), Presses(demonstrated, self.options.plausible))
        now.demonstrated = replace(demonstrated, start_ns=self._receiver.begin(writing.intake))
        self._open = now
        self._caches.latched.begin()
        self._tell("start", demonstration_id=demonstrated.demonstration_id, file=str(writing.file))
        return {"demonstration_id": demonstrated.demonstration_id, "file": str(writing.file)}

    def _needs_to_be_seen(self, start: Start) -> None:
        """Raises RequestRefusedError for names that nobody publishes, unless the request takes them all the same."""
        end_s = time.monotonic() + APPEARS_S
        while not start.unseen_ok and (missing := self._missing(start)):
            if time.monotonic() >= end_s:
                raise RequestRefusedError(f"cannot start: {missing}; check the names, or send `unseen_ok`: true")
            time.sleep(LOOK_S)

    def _missing(self, start: Start) -> str | None:
        self._take_poses()
        with self._sightings_lock:
            return self._known.missing(start.wanted, start.base_frame, self._receiver.clock.now_ns())

    def _writing(self, demonstrated: Demonstrated) -> Writing:
        part = demonstrated.part or 1
        name = demonstrated.demonstration_id + (f"-part{part}" if part > 1 else "")
        return Writing(
            self.folder / f"{name}.mcap",
            demonstrated,
            self._receiver.channels.describe,
            self.options.buffer_bytes,
            on_durable=lambda count: self._requests.put(self._say_durable),
            on_error=lambda error: self._requests.put(lambda: self._end_on_error(error)),
        )

    def _stop(self, outcome: str, **more: Any) -> dict[str, Any]:
        now = self._open
        assert now is not None
        self._caches.settle(SETTLE_NETWORK_S)
        self._receiver.end()
        self._take_poses()
        self._watch(NOT_WATCHING)
        self._open = None
        now.writing.drain()
        with self._receiver.lock:
            ledger = self._receiver.ledger
            for topic, count in now.writing.unwritten.items():
                ledger.unwritten(topic, count)
            self._note_restarts()
            lost, losses, refused = ledger.lost(self._receiver.counts), ledger.losses, ledger.refusals
            ledger.forget()
        self._tell_notices()
        notes = self._notices.sentences
        gaps = gaps_near_actions(losses, now.stamps)
        finished = _finish(now, outcome, lost, gaps, notes)
        reply = {
            "demonstration_id": now.demonstrated.demonstration_id,
            "file": str(finished.file),
            "messages": dict(finished.messages),
            "lost": lost,
            "overflowed": refused,
            "sha256": finished.sha256,
            "gaps": list(gaps),
            "notes": list(notes),
        }
        if now.parts:
            reply["parts"] = [str(part.file) for part in (*now.parts, finished)]
        self._tell("stop", outcome=outcome, **reply, **more)
        return reply

    def _discard(self) -> None:
        self._needs("discard", self._open is not None)
        now, self._open = self._open, None
        assert now is not None
        self._receiver.end()
        self._watch(NOT_WATCHING)
        now.writing.discard()
        for part in now.parts:
            part.file.unlink(missing_ok=True)
        with self._receiver.lock:
            self._receiver.ledger.forget()
        self._tell("discard", demonstration_id=now.demonstrated.demonstration_id)

    def _pause(self) -> None:
        self._needs("pause", self.state == "recording")
        self._receiver.pause()
        self._paused = True
        self._tell("pause")

    def _resume(self) -> None:
        self._needs("resume", self.state == "paused")
        self._receiver.resume()
        self._paused = False
        self._tell("resume")

    def _split(self) -> None:
        """Go on in another file, between two samples, before the present one is closed."""
        self._needs("split", self._open is not None)
        now = self._open
        assert now is not None
        before = replace(now, demonstrated=replace(now.demonstrated, part=now.demonstrated.part or 1))
        part = (now.demonstrated.part or 1) + 1
        following = replace(now.demonstrated, part=part)
        writing = self._writing(following)
        self._caches.latched.keep(end=True)
        lost, losses = self._receiver.swap(writing.intake)
        self._caches.latched.begin()
        now.demonstrated, now.writing, now.begun_s = following, writing, time.monotonic()
        gaps, notes = gaps_near_actions(losses, now.stamps), self._notices.sentences
        finished = _finish(before, "unknown", lost, gaps, notes, continued=True)
        now.durable_before += before.writing.actions_durable
        now.parts.append(finished)
        self._tell("split", file=str(finished.file), part=part - 1, next_file=str(writing.file))

    # --- what happens by itself

    def _clock(self) -> None:
        before, then = 0, time.monotonic()
        while not self._stopping.wait(TICK_S):
            received, now_s = self._receiver.received_bytes, time.monotonic()
            rate = (received - before) / (now_s - then)
            before, then = received, now_s
            self._rate_bytes_s += (rate - self._rate_bytes_s) * TICK_S / 5.0
            self._take_poses()
            self._note_restarts()
            self._note_clock()
            self._note_silence()
            if self._notices.untold:
                self._requests.put(self._tell_notices)
            if self._due():
                self._requests.put(self._split_if_due)

    def _note_restarts(self) -> None:
        with self._receiver.lock:
            restarts = self._receiver.ledger.take_restarts()
        for topic, count in restarts.items():
            self._notices.add(f"a publisher of {topic} was started again and begins a new account", count)

    def _note_clock(self) -> None:
        sentence = self._receiver.clock.noticed()
        if sentence and self._open is not None:
            self._notices.add(sentence)

    def _note_silence(self) -> None:
        now = self._open
        if now is None or now.silence_told or self._paused or time.monotonic() < now.begun_s + SILENCE_S:
            return
        now.silence_told = True
        for topic in (wire.POSES, wire.GRIPPER):
            if not now.parts and topic not in self._receiver.counts:
                self._notices.add(f"nothing is published on {topic} in {self.cell}")

    def _tell_notices(self) -> None:
        for sentence in self._notices.take_untold():
            self._alarm(sentence)

    def _due(self) -> bool:
        now, options = self._open, self.options
        if now is None:
            return False
        large = options.split_bytes is not None and now.writing.size_bytes >= options.split_bytes
        return large or (options.split_s is not None and time.monotonic() - now.begun_s >= options.split_s)

    def _split_if_due(self) -> None:
        if self._due():
            self._split()

    def _end_on_error(self, error: OSError) -> None:
        """The disk takes no more: close what is written, and say so."""
        if self._open is None or self._open.writing.error is None:
            return
        identifier = self._open.demonstrated.demonstration_id
        reason = error.strerror or str(error)
        self._alarm(f"the recording {identifier} has ended by itself, because the disk fails: {reason}; free it")
        try:
            self._stop("unknown", reason=reason)
        except (OSError, RecorderError) as failure:
            self._alarm(f"the recording {identifier} could not be closed ({_sentence(failure)}); recover it later")

    def _say_durable(self) -> None:
        now = self._open
        if now is not None:
            self._tell("durable", actions_durable=now.actions_durable)

    def _take_poses(self) -> None:
        with self._sightings_lock:
            while self._early:
                topic, log_ns, payload = self._early.popleft()
                if topic == wire.POSES:
                    self._known.take(payload, log_ns)
                take = self._sightings.add if topic == wire.POSES else self._sightings.add_gripper
                take(payload, log_ns)

    def _watch(self, sightings: Sightings) -> None:
        """Sightings are of one demonstration alone: what was wrong with stamps in another must not blind it."""
        with self._sightings_lock:
            self._early.clear()
            self._sightings = sightings

    def _acted(self, arrival: Arrival) -> None:
        """An action has arrived (on the receiving thread): judge it elsewhere."""
        self._requests.put(lambda: self._judge_action(arrival))

    def _judge_action(self, arrival: Arrival) -> None:
        try:
            press = wire.parse_action(arrival.payload)
        except PayloadError as error:
            self._alarm(f"an action that is none was published: {arrival.payload[:80]!r} {error}")
            if arrival.recorded and self._open is not None:
                self._open.presses.take_none(str(error))
            return
        if not arrival.recorded or self._open is None:
            self._alarm(f"the action {press.type} is not recorded: {self._situation()}")
            self._tell("action", type=press.type, recorded=False)
            return
        pressed = self._judged(self._open, press, arrival.log_ns)
        if pressed.verdict == "accepted":
            self._report(self._open, pressed)
        else:
            self._report_later(self._open, pressed)

    def _press(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Record an action that is pressed here, and judge it at once."""
        self._needs("press", self.state == "recording")
        now = self._open
        assert now is not None
        press = parse_press(request, self._present_ns(now))
        fields = {"object": press.object, "signal": press.signal, "value": press.value}
        log_ns = self._receiver.record_press(wire.action_message(press.stamp_ns, press.type, **fields))
        if log_ns is None:
            raise RequestRefusedError(f"the action {press.type} cannot be recorded: memory or disk is full")
        pressed, end_s = self._judged(now, press, log_ns), time.monotonic() + ANSWER_S
        while pressed.verdict != "accepted" and time.monotonic() < end_s:
            time.sleep(LOOK_S)
            self._judge_again(now, pressed)
        if pressed.verdict == "accepted":
            self._report(now, pressed)
        else:
            self._report_later(now, pressed)
        return pressed.to_data()

    def _present_ns(self, now: _Open) -> int:
        """The present [ns] by the clock that stamps the hand's poses, to which presses are matched."""
        self._take_poses()
        with self._sightings_lock:
            return self._sightings.now_ns(now.demonstrated.end_effector_frame, self._receiver.clock.now_ns())

    def _judged(self, now: _Open, press: ActionPress, arrived_ns: int) -> Pressed:
        now.stamps.append((press.stamp_ns, press.type))
        self._take_poses()
        with self._sightings_lock:
            moved_ns = self._sightings.moved(press.stamp_ns, arrived_ns)
            return now.presses.take(replace(press, stamp_ns=moved_ns), press.stamp_ns, self._sightings)

    def _judge_again(self, now: _Open, pressed: Pressed) -> None:
        self._take_poses()
        with self._sightings_lock:
            now.presses.again(pressed, self._sightings)

    def _report_later(self, now: _Open, pressed: Pressed) -> None:
        """What a press needs may be on its way: it is judged once more before it is told."""

        def again() -> None:
            if now is self._open:
                self._judge_again(now, pressed)
                self._report(now, pressed)

        timer = threading.Timer(SETTLE_S, lambda: self._requests.put(again))
        timer.daemon = True
        timer.start()

    def _report(self, now: _Open, pressed: Pressed) -> None:
        """Tell of a press."""
        now.unseen = pressed.finding.unseen
        findings = list(pressed.finding.sentences)
        more = {"action_stamp_ns": pressed.stamp_ns, "recorded": True, "unseen": list(now.unseen), "findings": findings}
        self._tell("action", **pressed.to_data(), **more)
        for sentence in dict.fromkeys((*pressed.sentences, *findings)):
            self._alarm(f"at the action {pressed.press.type}: {sentence}")

    def _alarm(self, sentence: str) -> None:
        self._alarms.append(sentence)
        self._tell("alarm", alarm=sentence)

    def _tell(self, event: str, **more: Any) -> None:
        told = {"stamp_ns": time.time_ns(), "event": event, **more}
        self._events.put(_json(told), encoding=wire.JSON_ENCODING)
        self._on_event(told)


def _finish(
    now: _Open,
    outcome: str,
    lost: Mapping[str, int | None],
    gaps: tuple[str, ...],
    notes: tuple[str, ...],
    continued: bool = False,
) -> Finished:
    """Close a part, its losses and what was odd written in it."""
    now.writing.drain()
    more = {**now.demonstrated.more, **({NOTES: json.dumps(notes)} if notes else {})}
    described = replace(
        now.demonstrated, outcome=outcome, messages_lost=lost, gaps=gaps, more=more, continued=continued
    )
    return now.writing.finish(described)


def _new_id(task: str) -> str:
    """Tells a person what and when, and never repeats; a name of the contract."""
    return f"{task[:32]}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(4)}"


def _json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, sort_keys=True).encode()


def _sentence(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"the disk refuses {error.filename or 'the recording'}: {error.strerror}"
    return str(error) or type(error).__name__
