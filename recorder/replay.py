"""Publishing a recording again, with its timing, as the cell published it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zenoh
import zenoh.ext as ze
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap.records import Channel

from learner.model import check_name
from recorder.errors import RecorderError
from recorder.recording import messages
from recorder.wire import ACTION, ACTION_ENCODING, GRIPPER, GRIPPER_ENCODING, NS, POSES, POSES_ENCODING

CACHE_SAMPLES: Final = 20_000
HEARTBEAT_S: Final = 0.5
_ENCODINGS: Final = {POSES: POSES_ENCODING, GRIPPER: GRIPPER_ENCODING, ACTION: ACTION_ENCODING}


@dataclass(frozen=True)
class Replay:
    """How a recording is replayed: `rate` times as fast, from `start_s` [s] after its first message on, `loops` times.

    Every payload is published byte for byte, so that what is recorded again is the same demonstration at any rate.
    With `restamp` the stamps inside poses, gripper and actions are moved to the time and rate of the replay instead.
    """

    rate: float = 1.0
    start_s: float = 0.0
    loops: int | None = 1
    restamp: bool = False


@dataclass(frozen=True)
class _Timed:
    channel: Channel
    log_ns: int
    payload: bytes


def replay(
    session: zenoh.Session, cell: str, file: Path, how: Replay, stopped: threading.Event
) -> Iterator[dict[str, int]]:
    """Publish the recording below the cell's keys, and yield after each loop how many messages of each topic went out.

    Log times give the timing; messages are sorted by them, because a recorder may have had some late. Ends early when
    `stopped` is set. Raises RecordingError as the reader does, NameRefusedError for a bad cell, RecorderError if there
    is nothing to replay.
    """
    check_name("cell", cell)
    timed = _timed(file, how.start_s)
    with ExitStack() as opened:
        publishers = {
            _key(cell, message.channel): opened.enter_context(_publisher(session, cell, message.channel))
            for message in {message.channel.id: message for message in timed}.values()
        }
        loop = 0
        while not stopped.is_set() and (how.loops is None or loop < how.loops):
            loop += 1
            yield _once(cell, timed, publishers, how, stopped)


def _timed(file: Path, start_s: float) -> list[_Timed]:
    found = [_Timed(channel, message.log_time, message.data) for channel, message in messages(file)]
    found.sort(key=lambda message: message.log_ns)
    begin_ns = found[0].log_ns + int(start_s * NS) if found else 0
    kept = [message for message in found if message.log_ns >= begin_ns]
    if not kept:
        raise RecorderError(f"{file} has no messages to replay after {start_s:g} s")
    return kept


def _key(cell: str, channel: Channel) -> tuple[str, str]:
    encoding = channel.metadata.get("zenoh_encoding") or _ENCODINGS.get(channel.topic, "zenoh/bytes")
    return f"treewright/{cell}/{channel.topic.strip('/')}", encoding


def _publisher(session: zenoh.Session, cell: str, channel: Channel) -> ze.AdvancedPublisher:
    key, encoding = _key(cell, channel)
    if set(channel.topic) & set("*$?#"):
        raise RecorderError(f"the topic {channel.topic!r} is a pattern and no key; it is not published")
    try:
        return ze.declare_advanced_publisher(
            session,
            key,
            encoding=encoding,
            congestion_control=zenoh.CongestionControl.BLOCK,
            cache=ze.CacheConfig(CACHE_SAMPLES),
            sample_miss_detection=ze.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
            publisher_detection=True,
        )
    except zenoh.ZError as error:
        raise RecorderError(f"the topic {channel.topic!r} cannot be published below {cell}: {error}") from error


def _once(
    cell: str,
    timed: list[_Timed],
    publishers: dict[tuple[str, str], ze.AdvancedPublisher],
    how: Replay,
    stopped: threading.Event,
) -> dict[str, int]:
    sent: dict[str, int] = {}
    first_ns, begun_s, begun_ns = timed[0].log_ns, time.monotonic(), time.time_ns()

    def move(stamp_ns: int) -> int:
        return begun_ns + int((stamp_ns - first_ns) / how.rate)

    for message in timed:
        due_s = begun_s + (message.log_ns - first_ns) / NS / how.rate
        if stopped.wait(max(0.0, due_s - time.monotonic())):
            break
        payload = _restamped(message, move) if how.restamp else message.payload
        publishers[_key(cell, message.channel)].put(payload)
        sent[message.channel.topic] = sent.get(message.channel.topic, 0) + 1
    return dict(sorted(sent.items()))


def _restamped(message: _Timed, move: Callable[[int], int]) -> bytes:
    """The payload with its stamps moved; one that is not of the contract stays as it is."""
    if message.channel.topic == POSES:
        transforms = FrameTransforms.FromString(message.payload)
        for transform in transforms.transforms:
            stamp = transform.timestamp
            stamp.seconds, stamp.nanos = divmod(move(stamp.seconds * NS + stamp.nanos), NS)
        return transforms.SerializeToString()
    if message.channel.topic in (GRIPPER, ACTION):
        content = json.loads(message.payload)
        return json.dumps({**content, "stamp_ns": move(content["stamp_ns"])}).encode()
    return message.payload
