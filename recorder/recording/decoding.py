"""The messages of one file, decoded."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from mcap.records import Channel, Message

from learner.model import ActionPress, GripperSample
from recorder import wire
from recorder.clocks import Arrived
from recorder.errors import NotARecordingError, PayloadError
from recorder.notices import Notices
from recorder.recording.reader import messages, read_header
from recorder.wire import ACTION, GRIPPER, POSES, Sighting

_Parsed = TypeVar("_Parsed")


class ReadFile:
    """One file, decoded: what was `demonstrated`, and what its messages hold. What cannot be decoded is left out and
    noted, as long as its topic holds anything else. Raises as `read_recording`.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.gripper: list[Arrived[GripperSample]] = []
        self.presses: list[Arrived[ActionPress]] = []
        self.sightings: dict[tuple[str, str], list[Arrived[Sighting]]] = defaultdict(list)
        self.oddities = Notices()
        self.demonstrated = read_header(file)
        decoders = {POSES: self._poses, GRIPPER: self._gripper, ACTION: self._action}
        for channel, message in messages(file, frozenset(decoders)):
            decoders[channel.topic](channel, message)
        self.parents = frozenset(parent for parent, _ in self.sightings)
        if self.oddities.sentences and not (self.sightings and self.gripper):
            self._refuse_what_is_nothing_but_odd()

    def _refuse_what_is_nothing_but_odd(self) -> None:
        for topic, found in ((POSES, self.sightings), (GRIPPER, self.gripper)):
            odd = [sentence for sentence in self.oddities.sentences if sentence.startswith(f"a message on {topic} ")]
            if odd and not found:
                raise NotARecordingError(self.file, odd[0])

    def _poses(self, channel: Channel, message: Message) -> None:
        if channel.message_encoding != "protobuf":
            raise NotARecordingError(self.file, f"{POSES} is encoded as {channel.message_encoding!r}, not as protobuf")
        for transform in self._parsed(channel, wire.parse_transforms, message.data) or ():
            seen = self._parsed(channel, wire.parse_sighting, transform)
            if seen:
                self.sightings[seen.parent, seen.child].append(Arrived(message.log_time, seen.stamp_ns, seen))

    def _gripper(self, channel: Channel, message: Message) -> None:
        sample = self._parsed(channel, wire.parse_gripper, message.data)
        if sample:
            self.gripper.append(Arrived(message.log_time, sample.stamp_ns, sample))

    def _action(self, channel: Channel, message: Message) -> None:
        try:
            press = wire.parse_action(message.data)
        except PayloadError as error:
            raise NotARecordingError(self.file, f"a message on {channel.topic} {error}") from error
        self.presses.append(Arrived(message.log_time, press.stamp_ns, press))

    def _parsed(self, channel: Channel, parse: Callable[[Any], _Parsed], what: Any) -> _Parsed | None:
        try:
            return parse(what)
        except PayloadError as error:
            self.oddities.add(f"a message on {channel.topic} {error}")
            return None
