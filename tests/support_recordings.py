"""Recordings of "object in box" by a writer of their own: plain `mcap`, nothing of the recorder's writer."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from learner.model import Pose
from recorder.wire import pose_message

START_NS = 1_790_000_000_000_000_000
NS = 1_000_000_000
RATE_HZ = 30
BASE, HAND, CUBE, BOX = "base", "tool0", "A", "box"
DOWN = (1.0, 0.0, 0.0, 0.0)

Message = tuple[int, str, bytes]
"""Log time [ns], topic, payload."""


@dataclass
class Take:
    """One demonstration as messages and metadata, to be broken by tests before it is written."""

    metadata: dict[str, str]
    messages: list[Message] = field(default_factory=list)

    def without(self, keep: Callable[[Message], bool]) -> Take:
        """The messages for which `keep` holds."""
        return Take(dict(self.metadata), [message for message in self.messages if keep(message)])

    def saying(self, **metadata: str) -> Take:
        """The same with other metadata."""
        return Take({**self.metadata, **metadata}, list(self.messages))

    def presses(self) -> list[dict[str, Any]]:
        """The operator's presses."""
        return [json.loads(payload) for _, topic, payload in self.messages if topic == "/action"]

    def with_presses(self, presses: Sequence[Mapping[str, Any]]) -> Take:
        """The same with other presses at their stamps."""
        others = [message for message in self.messages if message[1] != "/action"]
        pressed = [(press["stamp_ns"], "/action", json.dumps(press).encode()) for press in presses]
        return Take(dict(self.metadata), sorted([*others, *pressed]))

    def halves(self) -> tuple[Take, Take]:
        """The same demonstration split in the middle into parts 1 and 2."""
        middle = self.messages[len(self.messages) // 2][0]
        first = self.without(lambda message: message[0] < middle).saying(part="1", outcome="unknown")
        return first, self.without(lambda message: message[0] >= middle).saying(part="2")

    def write(self, file: Path, chunk_size: int = 4096) -> Path:
        """Write it as an MCAP file and return its path."""
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("wb") as stream:
            writer = Writer(stream, chunk_size=chunk_size)
            writer.start()
            channels = {topic: _channel(writer, topic) for topic in ("/poses", "/gripper", "/action")}
            for log_ns, topic, payload in self.messages:
                writer.add_message(channels[topic], log_ns, payload, log_ns)
            writer.add_metadata("treewright.demonstration", self.metadata)
            writer.finish()
        return file


def _channel(writer: Writer, topic: str) -> int:
    if topic == "/poses":
        schema = writer.register_schema("foxglove.FrameTransforms", "protobuf", b"")
        return writer.register_channel(topic, "protobuf", schema)
    return writer.register_channel(topic, "json", writer.register_schema(topic[1:], "jsonschema", b"{}"))


def object_in_box(seed: int, task: str = "object_in_box", user: str = "u1", **metadata: str) -> Take:
    """A demonstration with a random start: the cube is picked and dropped in the box."""
    rng = np.random.default_rng(seed)
    place = _Script(rng)
    told = {
        "contract": "1",
        "demonstration_id": f"{task}-{seed}",
        "task": task,
        "user": user,
        "cell": "bench",
        "base_frame": BASE,
        "end_effector_frame": HAND,
        "objects": json.dumps([CUBE, BOX]),
        "outcome": "success",
    }
    return Take({**told, **metadata}, sorted(place.messages(), key=lambda message: message[0]))


class _Script:
    """Approach, pick, carry, drop, retreat; the state is what a camera and a gripper would tell."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.now_ns, self.holding = rng, START_NS, False
        yaw = rng.uniform(-math.pi, math.pi)
        turned = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        self.box = Pose.of([*rng.uniform([0.25, 0.05], [0.65, 0.45]), 0.0], turned)
        self.cube = Pose.of([*rng.uniform([0.3, -0.3], [0.6, -0.1]), 0.025], (0.0, 0.0, 0.0, 1.0))
        self.hand = Pose.of([0.4, 0.0, 0.4], DOWN)

    def messages(self) -> Iterator[Message]:
        yield self._gripper("open")
        yield from self._move(self._missed(self.cube.position))
        yield from self._press("pick", "closed")
        yield from self._move((0.4, 0.0, 0.4))
        yield from self._move(self._missed(self.box.apply((0.02, 0.01, 0.16))))
        yield from self._press("drop", "open")
        x, y = self.rng.normal(0, 0.025, 2)
        self.cube = Pose(self.box.apply((x, y, 0.03)))
        yield from self._stay(0.8)

    def _missed(self, position: Sequence[float]) -> tuple[float, float, float]:
        x, y, z = (np.asarray(position) + self.rng.normal(0, 0.003, 3)).tolist()
        return (x, y, z)

    def _move(self, position: tuple[float, float, float]) -> Iterator[Message]:
        begin = np.asarray(self.hand.position)
        for share in np.linspace(0, 1, RATE_HZ // 2):
            before = self.hand
            self.hand = Pose.of(begin + share * (np.asarray(position) - begin), DOWN)
            if self.holding:
                self.cube = self.hand @ before.inverse() @ self.cube
            yield self._poses()
        yield from self._stay(0.3)

    def _press(self, kind: str, becomes: str) -> Iterator[Message]:
        yield self.now_ns, "/action", json.dumps({"stamp_ns": self.now_ns, "type": kind, "object": CUBE}).encode()
        self.now_ns += NS // 10
        self.holding = becomes == "closed"
        yield self._gripper(becomes)

    def _stay(self, duration_s: float) -> Iterator[Message]:
        for _ in range(int(duration_s * RATE_HZ)):
            yield self._poses()
        yield self._gripper("closed" if self.holding else "open")

    def _poses(self) -> Message:
        self.now_ns += NS // RATE_HZ
        seen = {name: self._noisy(pose) for name, pose in ((CUBE, self.cube), (BOX, self.box))}
        return self.now_ns, "/poses", pose_message(self.now_ns, BASE, {HAND: self.hand, **seen})

    def _noisy(self, pose: Pose) -> Pose:
        return Pose.of(np.asarray(pose.position) + self.rng.normal(0, 0.0015, 3), pose.quaternion_xyzw)

    def _gripper(self, state: str) -> Message:
        return (
            self.now_ns,
            "/gripper",
            json.dumps({"stamp_ns": self.now_ns, "state": state, "width_m": None}).encode(),
        )
