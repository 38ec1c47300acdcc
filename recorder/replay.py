"""Publishing a recording again, with its timing, as the cell published it."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zenoh
import zenoh.ext as ze
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError
from mcap.records import Channel

from learner.model import check_name
from recorder.errors import RecorderError
from recorder.foxglove import SHOWN
from recorder.paths import shown
from recorder.recording import messages
from recorder.wire import (
    ACTION,
    ACTION_ENCODING,
    ATTACHMENT,
    GRIPPER,
    GRIPPER_ENCODING,
    NS,
    POSES,
    POSES_ENCODING,
    SIGNALS,
)

CACHE_SAMPLES: Final = 20_000
CACHE_BYTES: Final = 16 << 20
"""The caches of all publishers together hold no more samples than fill this."""
HEARTBEAT_S: Final = 0.5
BACK_NS: Final = NS // 2
"""Messages may have been recorded out of order by so much [ns]; ..."""
STEPPED: Final = 3
"""... so many in a row that are further back are a step of the clock."""
_ENCODINGS: Final = {POSES: POSES_ENCODING, GRIPPER: GRIPPER_ENCODING, ACTION: ACTION_ENCODING}
Key = tuple[str, str]
"""A topic and its Zenoh encoding: what is one publisher's."""
Say = Callable[[str], None]
"""Gets a sentence about what is odd, when it comes."""


@dataclass(frozen=True)
class Replay:
    """How a recording is replayed: `rate` times as fast, from `start_s` [s] after its first message on, `loops` times.

    Every payload is published byte for byte, so that what is recorded again is the same demonstration at any rate.
    With `restamp` the stamps inside poses, gripper, actions and signals are moved to the time and rate of the replay
    instead.
    A gap longer than `max_gap_s` [s] of the recording is shortened to that.
    """

    rate: float = 1.0
    start_s: float = 0.0
    loops: int | None = 1
    restamp: bool = False
    max_gap_s: float = 5.0


@dataclass(frozen=True)
class Timed:
    """A message of a recording and when it is due."""

    channel: Channel
    log_ns: int
    since_begin_ns: int
    """How long after the first message it is due, gaps shortened."""
    payload: bytes
    attachment: bytes | None

    @property
    def key(self) -> Key:
        """Whose publisher's it is."""
        topic = self.channel.topic
        return topic, self.channel.metadata.get("zenoh_encoding") or _ENCODINGS.get(topic, "zenoh/bytes")

    @property
    def size_bytes(self) -> int:
        """What a cache holds of it."""
        return len(self.payload) + len(self.attachment or b"")


def replay(
    session: zenoh.Session, cell: str, files: Sequence[Path], how: Replay, stopped: threading.Event, say: Say
) -> Iterator[dict[str, int]]:
    """Publish a recording below the cell's keys, and yield after each loop how many messages of each topic went out.

    `files` are the parts of one demonstration in their order. They are read through before anything is published: gaps
    and steps back are told at once, nothing is played of what is damaged. Then they are read as they are played, so
    that memory does not grow with them. Messages keep the order of the file, log times give the timing. A topic that
    is no key is left out and told. Ends early when `stopped` is set. Raises RecordingError as the reader does,
    NameRefusedError for a bad cell, RecorderError if there is nothing to replay.
    """
    check_name("cell", cell)
    samples = cached_samples(_timed(files, how, say), stopped)
    loop = 0
    with _Publishers(session, cell, samples, say) as publishers:
        while not stopped.is_set() and (how.loops is None or loop < how.loops):
            loop += 1
            sent = _once(_timed(files, how, _nobody), publishers, how, stopped)
            if publishers.nothing and not stopped.is_set():
                raise RecorderError(f"{shown(files[0])} has no messages to replay after {how.start_s:g} s")
            yield sent


def _nobody(_: str) -> None:
    """What was told before is not told again."""


def cached_samples(timed: Iterator[Timed], stopped: threading.Event) -> dict[Key, int]:
    """How many samples the cache of each publisher may hold; those that need little have it all, the rest share."""
    counts: Counter[Key] = Counter()
    largest: dict[Key, int] = defaultdict(lambda: 1)
    for message in timed:
        counts[message.key] += 1
        largest[message.key] = max(largest[message.key], message.size_bytes)
        if stopped.is_set():
            break
    needs = sorted((min(counts[key], CACHE_SAMPLES) * largest[key], key) for key in counts)
    samples, left = dict[Key, int](), CACHE_BYTES
    for number, (need, key) in enumerate(needs):
        share = min(need, left // (len(needs) - number))
        samples[key] = share // largest[key]
        left -= samples[key] * largest[key]
    return samples


def _timed(files: Sequence[Path], how: Replay, say: Say) -> Iterator[Timed]:
    """The messages in the order of the file, each with when it is due."""
    course, begin_ns = _Course(int(how.max_gap_s * NS), say), -1
    attached: tuple[int, bytes] | None = None
    for channel, message in (found for file in files for found in messages(file)):
        log_ns = message.log_time
        begin_ns = log_ns + int(how.start_s * NS) if begin_ns < 0 else begin_ns
        if log_ns < begin_ns and not course.stepped:
            continue
        if channel.topic in SHOWN:
            continue
        if channel.topic.endswith(ATTACHMENT):
            attached = log_ns, message.data
            continue
        attachment = attached[1] if attached and attached[0] == log_ns else None
        attached = None
        yield Timed(channel, log_ns, course.due_ns(log_ns), message.data, attachment)


class _Course:
    """From log times, in the order of the file, to when each message is due, which never goes back by more than what
    was recorded out of order.
    """

    def __init__(self, max_gap_ns: int, say: Say) -> None:
        self._max_gap_ns, self._say = max_gap_ns, say
        self._last_ns, self._offset_ns, self._behind = 0, 0, 0
        self.begun = self.stepped = False

    def due_ns(self, log_ns: int) -> int:
        """How long after the first message [ns] the next one is due."""
        if not self.begun:
            self.begun, self._last_ns, self._offset_ns = True, log_ns, log_ns
        ahead_ns = log_ns - self._last_ns
        if ahead_ns > self._max_gap_ns:
            self._say(f"a gap of {ahead_ns / NS:.1f} s is shortened to {self._max_gap_ns / NS:g} s")
            self._offset_ns += ahead_ns - self._max_gap_ns
        self._behind = self._behind + 1 if ahead_ns < -BACK_NS else 0
        if self._behind >= STEPPED:
            self._say(f"the log's clock steps back by {-ahead_ns / NS:.1f} s; the file's order is kept")
            self._offset_ns += ahead_ns
            self._last_ns, self._behind, self.stepped = log_ns, 0, True
        self._last_ns = max(self._last_ns, log_ns)
        return log_ns - self._offset_ns


class _Publishers:
    """A publisher for each key, declared when its first message comes; a context manager."""

    def __init__(self, session: zenoh.Session, cell: str, samples: Mapping[Key, int], say: Say) -> None:
        """`samples`: how many of each the publisher keeps for those who missed them."""
        self._session, self._cell, self._samples, self._say = session, cell, samples, say
        self._publishers: dict[Key, ze.AdvancedPublisher | None] = {}
        self._opened = ExitStack()
        self.nothing = True
        """Whether no message went out yet."""

    def __enter__(self) -> _Publishers:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def put(self, message: Timed, payload: bytes) -> bool:
        """Publish; False where the topic is no key."""
        key = message.key
        if key not in self._publishers:
            self._publishers[key] = self._declared(*key, self._samples.get(key, 0))
        if (publisher := self._publishers[key]) is None:
            return False
        publisher.put(payload, attachment=message.attachment)
        self.nothing = False
        return True

    def _declared(self, topic: str, encoding: str, samples: int) -> ze.AdvancedPublisher | None:
        if set(topic) & set("*$?#"):
            self._say(f"the topic {topic!r} is a pattern and no key; its messages are left out")
            return None
        try:
            publisher = ze.declare_advanced_publisher(
                self._session,
                f"treewright/{self._cell}/{topic.strip('/')}",
                encoding=encoding,
                congestion_control=zenoh.CongestionControl.BLOCK,
                cache=ze.CacheConfig(samples) if samples else None,
                sample_miss_detection=ze.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
                publisher_detection=True,
            )
        except zenoh.ZError:
            self._say(f"the topic {topic!r} is no key below {self._cell}; its messages are left out")
            return None
        return self._opened.enter_context(publisher)


def _once(timed: Iterator[Timed], publishers: _Publishers, how: Replay, stopped: threading.Event) -> dict[str, int]:
    sent: dict[str, int] = {}
    begun_s, begun_ns = time.monotonic(), time.time_ns()
    for message in timed:
        due_ns = int(message.since_begin_ns / how.rate)
        if stopped.wait(max(0.0, begun_s + due_ns / NS - time.monotonic())):
            break
        shift_ns = begun_ns + due_ns - message.log_ns
        payload = _restamped(message, shift_ns, how.rate) if how.restamp else message.payload
        if publishers.put(message, payload):
            sent[message.channel.topic] = sent.get(message.channel.topic, 0) + 1
    return dict(sorted(sent.items()))


def _restamped(message: Timed, shift_ns: int, rate: float) -> bytes:
    """The payload with its stamps moved as its log time is; one that is not of the contract stays as it is."""

    def moved(stamp_ns: int) -> int:
        return message.log_ns + shift_ns + int((stamp_ns - message.log_ns) / rate)

    try:
        if message.channel.topic == POSES:
            return _moved_poses(message.payload, moved)
        if message.channel.topic in (GRIPPER, ACTION) or message.channel.topic.startswith(SIGNALS):
            content = json.loads(message.payload)
            return json.dumps({**content, "stamp_ns": moved(content["stamp_ns"])}).encode()
    except (DecodeError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return message.payload
    return message.payload


def _moved_poses(payload: bytes, moved: Callable[[int], int]) -> bytes:
    transforms = FrameTransforms.FromString(payload)
    for transform in transforms.transforms:
        stamp = transform.timestamp
        stamp.seconds, stamp.nanos = divmod(moved(stamp.seconds * NS + stamp.nanos), NS)
    return transforms.SerializeToString()
