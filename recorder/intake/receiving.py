"""From Zenoh to the open recording: what happens to every sample, on the thread that received it.

Nothing here waits for the disk. A sample is copied, numbered off in the ledger, packed, and left to the writer.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic_ns
from typing import Final

import zenoh

from recorder.clocks import LogClock
from recorder.intake.account import Source
from recorder.intake.channels import Channels
from recorder.intake.fence import Fence
from recorder.intake.ledger import Balance, Ledger
from recorder.intake.patterns import Patterns
from recorder.intake.routes import Route, Routes
from recorder.intake.waiting import Intake, PreRoll
from recorder.notices import Notices
from recorder.recording.chunks import Batch
from recorder.wire import ACTION, ACTION_ENCODING, ATTACHMENT, NS, listed

ATTACHED: Final = "zenoh/bytes"
"""The encoding under which attachments are kept: they tell none."""
OURSELVES: Final[Source] = ("the recorder", 0)
"""The source of the actions that are pressed at the recorder itself: their numbers have no gaps."""
_PUT: Final = zenoh.SampleKind.PUT


@dataclass(frozen=True)
class Arrival:
    """A sample of interest to others: an action, or poses."""

    log_ns: int
    payload: bytes
    recorded: bool


class Receiver:
    """Takes samples from any number of threads. `lock` guards its state and what its owner keeps in step with it."""

    def __init__(
        self,
        prefix: str,
        patterns: Patterns,
        pre_roll_s: float,
        on_action: Callable[[Arrival], None],
        on_early: Callable[[tuple[str, int, bytes]], None],
        notices: Notices,
    ) -> None:
        self.lock = threading.RLock()
        self.ledger = Ledger()
        self.clock = LogClock()
        self.received_bytes = 0
        self.counts: dict[str, int] = {}
        self.fence = Fence(f"{prefix}recorder/fence")
        self._routes = Routes(prefix, patterns, notices)
        self._on_action, self._on_early, self._notices = on_action, on_early, notices
        self._pre_roll = PreRoll(int(pre_roll_s * NS))
        self._intake: Intake | None = None
        self._start_ns = 0
        self._late: set[Source] = set()
        self._own, self._shown = itertools.count(), itertools.count()
        self._sessions: dict[zenoh.ZenohId, str] = {}
        self._paused = False

    @property
    def channels(self) -> Channels:
        """Those of the present recording and of the pre-roll before it."""
        return self._routes.channels

    def records(self, topic: str) -> bool:
        """Whether samples of a topic are recorded."""
        return self._routes.of_topic(topic).recorded

    @property
    def recording(self) -> bool:
        """Whether samples are being recorded now."""
        return self._intake is not None and not self._paused

    def expect_late(self, source: Source) -> None:
        """A publisher came during the recording: what its cache has from before the start is left out."""
        self._late.add(source)

    def begin(self, intake: Intake) -> int:
        """A recording begins, with the pre-roll; returns its start [ns]."""
        with self.lock:
            self._pre_roll.move(self.clock.set())
            now_ns = self.clock.now_ns()
            batch = self._pre_roll.take(now_ns)
            self.counts = {}
            self._count(batch)
            if len(batch):
                intake.put_first(batch)
            self.ledger.begin()
            self._late.clear()
            self._intake, self._paused, self._start_ns = intake, False, now_ns
        return now_ns

    def swap(self, intake: Intake) -> Balance:
        """The recording goes on in another part, between two samples; returns what the one before has lost."""
        with self.lock:
            ended = self.ledger.split(self.counts)
            self._intake, self.counts = intake, {}
        return ended

    def pause(self) -> None:
        """Samples are not recorded until `resume`."""
        with self.lock:
            self._paused = True
            self.ledger.pause()

    def resume(self) -> None:
        """Samples are recorded again."""
        with self.lock:
            self._paused = False
            self.ledger.resume()

    def end(self) -> None:
        """The recording has ended; what comes from now on may be the pre-roll of the next."""
        with self.lock:
            self._intake = None
            self._pre_roll.clear()
            self._routes.begin_anew()

    def close_account(self, unwritten: Mapping[str, int]) -> Balance:
        """What the recording that has ended has lost, with what of it could not be written."""
        with self.lock:
            for topic, count in unwritten.items():
                self.ledger.unwritten(topic, count)
            self.note_restarts()
            balance = self.ledger.balance(self.counts)
            self.ledger.forget()
        return balance

    def forget(self) -> None:
        """The recording that has ended is discarded, and what it has lost with it."""
        with self.lock:
            self.ledger.forget()

    def counted(self) -> tuple[dict[str, int], Mapping[str, int | None], Mapping[str, int]]:
        """How many messages of each topic were kept, lost, and of those not kept though they had come."""
        with self.lock:
            counts, balance = dict(sorted(self.counts.items())), self.ledger.balance(self.counts)
        return counts, balance.lost, balance.refusals

    def note_restarts(self) -> None:
        """Note which publishers have begun anew since the last call."""
        with self.lock:
            restarts = self.ledger.take_restarts()
        for topic, count in restarts.items():
            self._notices.add(f"a publisher of {topic} was started again and begins a new account", count)

    def receive_cached(self, sample: zenoh.Sample) -> None:
        """Take in a sample out of a publisher's cache."""
        self.receive(sample, cached=True)

    def receive_latched(self, samples: Sequence[zenoh.Sample]) -> None:
        """Record what a publisher's cache held when the file began, if it is silent since; oldest first.

        The samples were published, and perhaps received, before: they do not concern the ledger.
        """
        route = self._routes.of(str(samples[-1].key_expr))
        with self.lock:
            if self.recording and self._is_latched(route, samples[-1]):
                for sample in samples:
                    log_ns, stamp, info = self.clock.now_ns(), sample.timestamp, sample.source_info
                    publish_ns = log_ns if stamp is None else stamp.get_time_as_ntp64().as_nanos()
                    number = 0 if info is None else info.source_sn
                    encoding, payload = str(sample.encoding), sample.payload.to_bytes()
                    self._keep(route, encoding, number, None, log_ns, publish_ns, payload, sample.attachment)

    def _is_latched(self, route: Route, newest: zenoh.Sample) -> bool:
        info, stamp = newest.source_info, newest.timestamp
        before = stamp is not None and stamp.get_time_as_ntp64().as_nanos() < self._start_ns
        if info is None:
            return before and route.topic not in self.counts
        source = (self._session(info.source_id.zid), info.source_id.eid)
        silent = self.ledger.silent(source, info.source_sn)
        return before if silent is None else silent

    def receive(self, sample: zenoh.Sample, cached: bool = False) -> None:
        """Take in a sample as it comes from the network, or out of a cache (`cached`)."""
        key = str(sample.key_expr)
        route = self._routes.of(key)
        if not route.recorded:
            if key == self.fence.key:
                self.fence.take(sample)
            return
        payload = sample.payload.to_bytes()
        stamp = sample.timestamp
        info = sample.source_info
        with self.lock:
            # As the clock's `now_ns`, without the call: this line is passed for every sample.
            log_ns = self.clock.offset_ns + monotonic_ns()
            publish_ns = log_ns if stamp is None else stamp.get_time_as_ntp64().as_nanos()
            number, source = 0, None
            if info is None:
                self.ledger.arrived_unnumbered(route.topic)
            else:
                identity, number = info.source_id, info.source_sn
                session = identity.zid
                source = (self._sessions.get(session) or self._session(session), identity.eid)
                if not self.ledger.arrived(route.topic, source, number, publish_ns, cached):
                    return
                if cached and source in self._late and publish_ns < self._start_ns:
                    self.ledger.began_late(source, number + 1)
                    return
            if sample.kind == _PUT:
                encoding, attachment = str(sample.encoding), sample.attachment
                self._keep(route, encoding, number, source, log_ns, publish_ns, payload, attachment)

    def _keep(
        self,
        route: Route,
        encoding: str,
        number: int,
        source: Source | None,
        log_ns: int,
        publish_ns: int,
        payload: bytes,
        attachment: zenoh.ZBytes | None,
    ) -> None:
        self.received_bytes += len(payload)
        if route.poses:
            payload = listed(payload)
        intake = self._intake
        if intake is None:
            if route.early and (channel := route.channels.get(encoding) or self._routes.channel(route, encoding)):
                self._pre_roll.add(channel, number, log_ns, publish_ns, payload)
        elif not self._paused:
            if attachment is not None:
                self._keep_attachment(route, number, log_ns, publish_ns, attachment.to_bytes(), intake)
            channel = route.channels.get(encoding) or self._routes.channel(route, encoding)
            if channel and intake.add(channel, number, log_ns, publish_ns, payload, route.essential, route.action):
                self.counts[route.topic] = self.counts.get(route.topic, 0) + 1
            else:
                self.ledger.refused(route.topic, source, publish_ns)
        if route.early:
            self._on_early((route.topic, log_ns, payload))
        elif route.action:
            self._on_action(Arrival(log_ns, payload, intake is not None and not self._paused))

    def _keep_attachment(
        self, route: Route, number: int, log_ns: int, publish_ns: int, attachment: bytes, intake: Intake
    ) -> None:
        """Beside its sample, on a channel of its own; other middleware puts its sender and numbers there."""
        channel = self.channels.number(f"{route.topic}{ATTACHMENT}", ATTACHED, route.essential)
        if not channel or not intake.add(channel, number, log_ns, publish_ns, attachment, route.essential, False):
            self._notices.add(f"the attachments of samples on {route.topic} are not recorded: there is no room")

    def record_press(self, payload: bytes) -> int | None:
        """Record an action that was pressed at the recorder itself; its log time [ns], None if it is not recorded."""
        route = self._routes.of_topic(ACTION)
        with self.lock:
            log_ns, intake = self.clock.now_ns(), self._intake
            if intake is None or self._paused:
                return None
            number = next(self._own)
            self.ledger.arrived(route.topic, OURSELVES, number, log_ns)
            channel = self._routes.channel(route, ACTION_ENCODING)
            if not channel or not intake.add(channel, number, log_ns, log_ns, payload, True, True):
                self.ledger.refused(route.topic, OURSELVES, log_ns)
                return None
            self.counts[route.topic] = self.counts.get(route.topic, 0) + 1
        return log_ns

    def show(self, topic: str, encoding: str, payload_at: Callable[[int], bytes]) -> None:
        """Record a message of the recorder's own, made for its log time [ns]; it counts to nothing that a cell sent."""
        with self.lock:
            log_ns, intake = self.clock.now_ns(), self._intake
            if intake is None or self._paused:
                return
            channel, number = self.channels.number(topic, encoding, essential=False), next(self._shown)
            if not channel or not intake.add(channel, number, log_ns, log_ns, payload_at(log_ns), False, False):
                self._notices.add(f"what belongs on {topic} is not recorded: there is no room")

    def _session(self, session: zenoh.ZenohId) -> str:
        return self._sessions.setdefault(session, str(session))

    def _count(self, batch: Batch) -> None:
        """The pre-roll belongs to the recording, and to what its teacher is told."""
        for channel, log_ns, payload in zip(batch.channels, batch.stamps_ns, batch.pieces[1::2], strict=True):
            topic = self.channels.describe(channel)[0]
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self._on_early((topic, log_ns, payload))
