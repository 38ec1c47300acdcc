"""What a rosbag2 holds, read through the `rosbags` library, whose only home this is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from learner.errors import ModelError
from learner.model import Pose
from recorder.errors import ImportRefusedError
from recorder.imports.grippers import TYPES, Meaning, NoGripperError, number_of, states_of
from recorder.imports.transforms import Transforms
from recorder.wire import NS

TF: Final = "tf2_msgs/msg/TFMessage"
STATIC: Final = "tf_static"
"""A topic of this name, wherever it stands, holds transforms for ever."""
TEXT: Final = "std_msgs/msg/String"
SAME_CLOCK_NS: Final = NS // 2
"""Stamps further than this [ns] from when they were recorded are of another clock, such as a simulation's."""


@dataclass(frozen=True)
class Topic:
    """One topic of a bag: messages of one type; `definition` is that type's text, empty where the bag has none."""

    name: str
    type: str
    messages: int
    definition: str
    definition_format: str

    def __str__(self) -> str:
        return f"{self.name} ({self.type}, {self.messages} messages)"


class Bag:
    """An open rosbag2: a folder, or one .mcap or .db3 file. Times are those at which messages were recorded [ns]."""

    def __init__(self, path: Path, reader: AnyReader) -> None:
        self.path, self._reader = path, reader
        self.left_out: Counter[str] = Counter()
        """Sentences about single messages that were left out, with how many there are."""

    @property
    def topics(self) -> Mapping[str, Topic]:
        """By name."""
        return {c.topic: _topic(c) for c in self._reader.connections}

    def holds(self) -> str:
        """All topics in one sentence's end."""
        return ", ".join(str(topic) for topic in self.topics.values()) or "no messages"

    def raw(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time [ns] and bytes of every message of some topics, in the order of time."""
        with self._refusals():
            chosen = [c for c in self._reader.connections if c.topic in topics]
            for connection, stamp_ns, data in self._reader.messages(chosen) if chosen else ():
                yield connection.topic, stamp_ns, bytes(data)

    def messages(self, kinds: set[str], names: set[str] | None = None) -> Iterator[tuple[Topic, int, Any]]:
        """Every message of some types (on some topics), decoded. One that cannot be is left out and counted."""
        topics = {t.name: t for t in self.topics.values() if t.type in kinds and (names is None or t.name in names)}
        for name, stamp_ns, data in self.raw(set(topics)):
            try:
                yield topics[name], stamp_ns, self._reader.deserialize(data, topics[name].type)
            except Exception:  # noqa: BLE001  # the library raises whatever its decoder meets in foreign bytes
                self.left_out[f"messages on {name} that are no {topics[name].type}"] += 1

    def transforms(self) -> Transforms:
        """Every transform of every topic of tf2, on the clock on which the bag was recorded."""
        found, stamped = Transforms(), list[tuple[str, str, int, int, Pose, bool]]()
        for topic, at_ns, message in self.messages({TF}):
            static = topic.name.rsplit("/", 1)[-1] == STATIC
            for each in message.transforms:
                if (pose := self._pose(each)) is not None:
                    stamp_ns = int(each.header.stamp.sec) * NS + int(each.header.stamp.nanosec)
                    parent, child = _plain(each.header.frame_id), _plain(each.child_frame_id)
                    stamped.append((parent, child, stamp_ns, at_ns, pose, static))
        shift_ns = _shift_ns([at_ns - stamp_ns for _, _, stamp_ns, at_ns, _, static in stamped if not static])
        for parent, child, stamp_ns, at_ns, pose, static in stamped:
            found.add(parent, child, at_ns if static else stamp_ns + shift_ns, pose, static)
        return found

    def _pose(self, transform: Any) -> Pose | None:
        t, r = transform.transform.translation, transform.transform.rotation
        try:
            return Pose.of((t.x, t.y, t.z), (r.x, r.y, r.z, r.w))
        except ModelError as error:
            self.left_out[f"transforms of {_plain(transform.child_frame_id)}: {error}"] += 1
            return None

    def gripper(self, name: str, meaning: Meaning) -> list[tuple[int, str]]:
        """When [ns] the gripper said to be open or closed. Raises ImportRefusedError that says what the bag holds."""
        topic = self.topics.get(name)
        if topic is None or topic.type not in TYPES:
            what = f"no topic {name}" if topic is None else f"on {name} messages of type {topic.type}"
            raise ImportRefusedError(
                self.path,
                f"it has {what}; a gripper's topic is one of {', '.join(TYPES)}; the bag holds {self.holds()}",
            )
        try:
            told = [(at_ns, number_of(m, topic.type, meaning)) for _, at_ns, m in self.messages({topic.type}, {name})]
            states = states_of([number for _, number in told], name, topic.type, meaning)
        except NoGripperError as error:
            reason = f"the gripper's topic {name} does not tell its state: {error}"
            raise ImportRefusedError(self.path, reason) from error
        return [(at_ns, state) for (at_ns, _), state in zip(told, states, strict=True)]

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except ImportRefusedError:
            raise
        except Exception as error:  # the library raises whatever damaged bytes make it raise
            raise ImportRefusedError(self.path, f"it is damaged: {_line(error)}") from error


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """The bag at a path. Raises ImportRefusedError where there is none that can be read."""
    if path.exists() and not path.is_dir() and not path.is_file():
        raise ImportRefusedError(path, "it is neither a file nor a folder")
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except FileNotFoundError as error:
        raise ImportRefusedError(path, f"it is no rosbag2: {_line(error)}") from error
    except AnyReaderError as error:
        raise ImportRefusedError(path, f"it is no rosbag2 that can be read: {_line(error)}") from error
    except Exception as error:  # the library raises whatever damaged bytes make it raise
        raise ImportRefusedError(path, f"it is no rosbag2 that can be read: {_line(error)}") from error
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _topic(connection: Any) -> Topic:
    definition = connection.msgdef
    written = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
    return Topic(
        connection.topic, connection.msgtype, connection.msgcount, definition.data, written.get(definition.format, "")
    )


def _shift_ns(delays_ns: list[int]) -> int:
    """What stamps are moved by to stand on the clock of the recording: nothing where they do already."""
    if not delays_ns:
        return 0
    middle = sorted(delays_ns)[len(delays_ns) // 2]
    return middle if abs(middle) > SAME_CLOCK_NS else 0


def _plain(frame: str) -> str:
    """A frame's name without the slash that tf of ROS 1 had before it."""
    return str(frame).lstrip("/")


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
