"""Asking publishers' caches for what the network has lost.

zenoh.ext's AdvancedPublisher tells two things below `<key>/@adv/pub/<session>/<number>/…`: a liveliness token says
that it is there, and a queryable gives what its cache still has (`_sn=first..last`, both included). A gap is asked for
by its numbers; a publisher that has gone quiet is asked whether something came after its last sample. Answers to two
questions overtake each other. Where a publisher may have begun anew, the last sample before is asked for too: another
one under its number tells.

Measured with 1.10.2, and the reasons for two choices: its counterpart, the AdvancedSubscriber, drops plain samples that
overtake each other on a wildcard, and skips the cache of a publisher that comes late; and whoever subscribes to the
heartbeats brings a publisher that waits (BLOCK) in a flood to a standstill. So neither is used.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Self

import zenoh

from recorder.intake.account import Source
from recorder.intake.latched import Latched
from recorder.intake.receiving import Receiver
from recorder.wire import ADVANCED

PATIENCE_S: Final = 0.03
"""A sample may be overtaken on its way by so much without being asked for."""
AGAIN_S: Final = (0.1, 0.3, 1.0)
"""Between one fruitless answer and the next question; after the last the cache has it no more."""
TIMEOUT_S: Final = 5.0
SETTLE_S: Final = 0.25
"""Publishers found in the first moments were there before."""


QUIET_S: Final = (0.3, 1.0, 5.0)
"""So long after its last sample a publisher is asked for later ones, again and again at the last of these."""


@dataclass
class _Questions:
    """What is being asked of one source; times are those of a monotonic clock [s]."""

    topic: str
    busy: bool = False
    due_s: float = 0.0
    expected: int = -1
    """The number it was to use next when it was last looked at, since `quiet_since_s`."""
    quiet_since_s: float = 0.0
    quiet_asked: int = 0
    returned: bool = False
    """Whether it has come, perhaps another one under the same name, and was not asked for its last samples since."""

    def is_quiet(self, expected: int, now_s: float) -> bool:
        """Whether it is time to ask a publisher that says nothing."""
        if expected != self.expected:
            self.expected, self.quiet_since_s, self.quiet_asked = expected, now_s, 0
        if now_s - self.quiet_since_s < QUIET_S[min(self.quiet_asked, len(QUIET_S) - 1)]:
            return False
        self.quiet_asked += 1
        if self.quiet_asked >= len(QUIET_S):
            self.quiet_since_s = now_s
        return True


class Caches:
    """Follows the advanced publishers of a cell and fills the gaps of its receiver's ledger, as a context."""

    def __init__(self, session: zenoh.Session, prefix: str, receiver: Receiver) -> None:
        self._session, self._prefix, self._receiver = session, prefix, receiver
        self.latched = Latched(session, prefix, receiver)
        self._present: set[Source] = set()
        self._gone: set[Source] = set()
        self._questions: dict[Source, _Questions] = {}
        self._lock = threading.Lock()
        self._stopping, self._wake = threading.Event(), threading.Event()
        self._opened = contextlib.ExitStack()
        self._opened_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="recorder-caches", daemon=True)

    def __enter__(self) -> Self:
        keys = f"{self._prefix}**{ADVANCED}**"
        with contextlib.ExitStack() as undo:
            undo.enter_context(self._session.liveliness().declare_subscriber(keys, self._token, history=True))
            self._opened = undo.pop_all()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        self._opened.close()

    def settle(self, patience_s: float) -> None:
        """Until nothing more can be had from any cache, or the patience [s] ends; a stop waits for it."""
        end_s = time.monotonic() + patience_s
        for source, topic in self._recorded_sources().items():
            self._ask_tail(topic, source)
        while time.monotonic() < end_s and self._unsettled():
            time.sleep(0.005)
        self.latched.keep(end=True)

    def _recorded_sources(self) -> dict[Source, str]:
        with self._lock, self._receiver.lock:
            known = [source for source in self._present if self._receiver.ledger.knows(source)]
            return {source: self._questions[source].topic for source in known}

    def _unsettled(self) -> bool:
        with self._lock, self._receiver.lock:
            questions = self._questions.values()
            busy = any(each.busy or each.returned for each in questions) or not self.latched.settled
            return busy or any(source not in self._gone for source in self._receiver.ledger.open_gaps)

    # --- what publishers tell

    def _parse(self, key: str) -> tuple[str, Source] | None:
        """The topic and the source of an advanced publisher's key; None if it has no sequence numbers."""
        topic, found, rest = key.rpartition(ADVANCED)
        chunks = rest.split("/")
        if not found or len(chunks) < 2 or not chunks[1].isdigit():
            return None
        return "/" + topic.removeprefix(self._prefix), (chunks[0], int(chunks[1]))

    def _token(self, sample: zenoh.Sample) -> None:
        parsed = self._parse(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.PUT and self._receiver.recording:
            self.latched.came(str(sample.key_expr))
        if parsed is None or not self._receiver.records(parsed[0]):
            return
        topic, source = parsed
        if sample.kind == zenoh.SampleKind.DELETE:
            with self._lock:
                self._present.discard(source)
                self._gone.add(source)
            return
        with self._lock:
            self._present.add(source)
            self._gone.discard(source)
            self._questions.setdefault(source, _Questions(topic))
        self._came(topic, source)

    def _came(self, topic: str, source: Source) -> None:
        """A publisher is there, again or for the first time: what did we miss?"""
        late = time.monotonic() > self._opened_s + SETTLE_S
        with self._receiver.lock:
            ledger = self._receiver.ledger
            if late and self._receiver.recording:
                self._receiver.expect_late(source)
                ledger.appeared(topic, source, time.time_ns())
            known = ledger.knows(source)
            for gap in ledger.open_gaps.get(source, ()):
                gap.asked = 0
        if known:
            self._note_return(topic, source)
            self._ask_tail(topic, source)
        else:
            self._ask_newest(topic, source)
        self._wake.set()

    # --- what is asked

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._ask_for_gaps()
            self._ask_the_returned()
            if self._receiver.recording:
                self._ask_the_quiet()
                self.latched.keep()
            self._wake.wait(PATIENCE_S)
            self._wake.clear()
            self._stopping.wait(PATIENCE_S)

    def _note_return(self, topic: str, source: Source) -> None:
        with self._lock:
            self._questions.setdefault(source, _Questions(topic)).returned = True

    def _ask_the_returned(self) -> None:
        """Ask those who could not be asked when they came, because they were being asked for something else."""
        with self._lock:
            returned = [
                (source, questions.topic) for source, questions in self._questions.items() if questions.returned
            ]
        for source, topic in returned:
            self._ask_tail(topic, source)

    def _ask_the_quiet(self) -> None:
        now_s = time.monotonic()
        for source, topic in self._recorded_sources().items():
            with self._lock, self._receiver.lock:
                quiet = self._questions[source].is_quiet(self._receiver.ledger.expected(source), now_s)
            if quiet:
                self._ask_tail(topic, source)

    def _ask_for_gaps(self) -> None:
        with self._receiver.lock:
            gaps = {source: (found[0].topic, found[0].first, found[-1].last)
                    for source, found in self._receiver.ledger.open_gaps.items()}  # fmt: skip
        for source, (topic, first, last) in gaps.items():
            with self._lock:
                questions = self._questions.setdefault(source, _Questions(topic))
                due = not questions.busy and time.monotonic() >= questions.due_s and source not in self._gone
                questions.busy = questions.busy or due
            if due:
                before = max(first - 1, 0)
                self._ask(topic, source, f"_sn={before}..{last}", self._receiver.receive_cached, self._answered)

    def _answered(self, source: Source) -> None:
        """The cache has given what it has."""
        with self._receiver.lock:
            gaps = self._receiver.ledger.open_gaps.get(source, [])
            for gap in gaps:
                gap.asked += 1
                gap.hopeless = gap.asked > len(AGAIN_S)
            asked = min((gap.asked for gap in gaps), default=0)
        with self._lock:
            questions = self._questions[source]
            questions.busy = False
            questions.due_s = time.monotonic() + (AGAIN_S[min(asked, len(AGAIN_S)) - 1] if asked else 0.0)

    def _ask_tail(self, topic: str, source: Source) -> None:
        """Ask for what came after the last sample; of a publisher that has come again, for that one too, and for its
        newest: it may not have come so far yet."""
        with self._lock, self._receiver.lock:
            questions = self._questions.setdefault(source, _Questions(topic))
            if questions.busy:
                return
            first = max(self._receiver.ledger.expected(source) - questions.returned, 0)
            done = self._ask_last if questions.returned else self._free
            questions.busy, questions.returned = True, False
        self._ask(topic, source, f"_sn={first}..", self._receiver.receive_cached, done)

    def _ask_last(self, source: Source) -> None:
        with self._lock:
            topic = self._questions[source].topic
        self._ask(topic, source, "_max=1", self._receiver.receive_cached, self._free)

    def _ask_newest(self, topic: str, source: Source) -> None:
        def heard(sample: zenoh.Sample) -> None:
            info = sample.source_info
            if info is not None:
                with self._receiver.lock:
                    self._receiver.ledger.heard(topic, source, info.source_sn, time.time_ns())

        self._ask(topic, source, "_max=1", heard, lambda _: None)

    def _free(self, source: Source) -> None:
        with self._lock:
            self._questions[source].busy = False

    def _ask(
        self,
        topic: str,
        source: Source,
        parameters: str,
        take: Callable[[zenoh.Sample], None],
        done: Callable[[Source], None],
    ) -> None:
        """Ask a source's cache; `take` gets each sample, `done` is called once when there are no more."""

        def reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                take(reply.ok)

        key = f"{self._prefix}{topic[1:]}{ADVANCED}{source[0]}/{source[1]}/**"
        try:
            self._session.get(
                f"{key}?{parameters}",
                zenoh.handlers.Callback(reply, lambda: done(source)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                timeout=TIMEOUT_S,
            )
        except zenoh.ZError:
            # The session is closing: there is nobody left to ask.
            done(source)
