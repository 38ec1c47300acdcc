"""The teacher's feedback: whether each action's poses are there, at once, so that the step is repeated and not the day.

The same rules of freshness by which learning matches actions to poses (CONTRACT, section 1), applied to the stream.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError

from recorder.ledger import Loss
from recorder.wire import ACTION, GRIPPER, NS, POSES


@dataclass(frozen=True)
class Plausible:
    """What a pose at an action has to be."""

    end_effector_s: float = 0.5
    """The oldest pose of the end-effector (CONTRACT, section 1)."""
    object_s: float = 5.0
    """The oldest pose of an object (CONTRACT, section 1)."""
    gap_s: float = 1.0
    """An object unseen for so long just before the action is worth a word."""
    jump_m: float = 0.05
    """No demonstrated object is carried so far between two sightings of a camera."""
    jump_s: float = 0.1
    """Sightings further apart in time than this may be far apart in space."""
    window_s: float = 1.0
    """Jumps are looked for in so long before the action."""


Point = tuple[float, float, float]
KEPT_NS: Final = 8 * NS
"""Sightings older than this against the newest are forgotten."""


@dataclass(frozen=True)
class Finding:
    """What is wrong around an action: `unseen` objects have no usable pose; `sentences` say all there is to say."""

    unseen: tuple[str, ...]
    sentences: tuple[str, ...]


class Sightings:
    """The last seconds of /poses, decoded. Not safe for threads: its owner holds a lock."""

    def __init__(self, base_frame: str) -> None:
        self.base_frame = base_frame
        self._stamps: dict[str, deque[int]] = defaultdict(deque)
        self._points: dict[str, deque[Point]] = defaultdict(deque)
        self.newest_ns = 0

    def add(self, payload: bytes) -> None:
        """Take in a message of /poses; one that is none says nothing about any object."""
        for child, stamp_ns, point in decode(payload, self.base_frame):
            self.newest_ns = max(self.newest_ns, stamp_ns)
            stamps, points = self._stamps[child], self._points[child]
            if stamps and stamp_ns < stamps[-1]:
                continue
            stamps.append(stamp_ns)
            points.append(point)
            while stamps[0] < self.newest_ns - KEPT_NS and len(stamps) > 1:
                stamps.popleft()
                points.popleft()

    def age_s(self, child: str, stamp_ns: int) -> float | None:
        """How old [s] the last pose at or before a stamp is; None if there is none."""
        stamps = self._stamps.get(child, ())
        index = bisect_right(stamps, stamp_ns)
        return (stamp_ns - stamps[index - 1]) / NS if index else None

    def unseen(self, objects: Sequence[str], plausible: Plausible) -> tuple[str, ...]:
        """The objects without a pose in the last seconds of the stream."""
        ages = {name: self.age_s(name, self.newest_ns) for name in objects}
        return tuple(name for name, age in ages.items() if age is None or age > plausible.object_s)

    def largest_jump_m(self, child: str, stamp_ns: int, plausible: Plausible) -> float:
        """The longest step [m] between two sightings of one moment and the next, shortly before a stamp."""
        begin_ns = stamp_ns - int(plausible.window_s * NS)
        sightings = [
            (stamp, point)
            for stamp, point in zip(self._stamps.get(child, ()), self._points.get(child, ()), strict=True)
            if begin_ns <= stamp <= stamp_ns
        ]
        steps = (
            math.dist(before, after)
            for (earlier, before), (later, after) in pairwise(sightings)
            if later - earlier <= plausible.jump_s * NS
        )
        return max(steps, default=0.0)


def decode(payload: bytes, base_frame: str) -> Iterator[tuple[str, int, Point]]:
    """Child, stamp [ns] and position [m] of every transform from the base frame in a message of /poses."""
    try:
        transforms = FrameTransforms.FromString(payload).transforms
    except DecodeError:
        return
    for transform in transforms:
        point = (transform.translation.x, transform.translation.y, transform.translation.z)
        if transform.parent_frame_id == base_frame and all(map(math.isfinite, point)):
            yield transform.child_frame_id, transform.timestamp.seconds * NS + transform.timestamp.nanos, point


def judge(
    sightings: Sightings, end_effector_frame: str, objects: Sequence[str], stamp_ns: int, plausible: Plausible
) -> Finding:
    """What is wrong with the poses around an action that was chosen at a stamp [ns]."""
    sentences: list[str] = []
    unseen: list[str] = []
    age = sightings.age_s(end_effector_frame, stamp_ns)
    if age is None or age > plausible.end_effector_s:
        sentences.append(f"the end-effector {end_effector_frame} has no fresh pose: {_age(age)}; repeat the step")
    for name in objects:
        age = sightings.age_s(name, stamp_ns)
        if age is None or age > plausible.object_s:
            unseen.append(name)
            sentences.append(f"the marker of {name} was not seen: {_age(age)}; uncover it and repeat the step")
        elif age > plausible.gap_s:
            sentences.append(f"the marker of {name} is hidden: {_age(age)}")
        sentences += _jumps(sightings, name, stamp_ns, plausible)
    return Finding(tuple(unseen), tuple(sentences))


BEFORE_NS: Final = 1 * NS
"""A gap so long before an action may have taken the pose that the action is matched to."""
AFTER_NS: Final = 2 * NS
"""A gap so long after an action may have taken the rest pose of what was released."""


def gaps_near_actions(losses: Sequence[Loss], presses: Sequence[tuple[int, str]]) -> tuple[str, ...]:
    """Sentences about losses that may have falsified an action; `presses` are stamps [ns] and types.

    A loss of actions themselves is always one: nobody knows what was pressed.
    """
    sentences = [f"{loss.count} messages of {ACTION} were lost" for loss in losses if loss.topic == ACTION]
    for stamp_ns, kind in presses:
        near = [loss for loss in losses if loss.topic in (POSES, GRIPPER) and _touches(loss, stamp_ns)]
        sentences += [f"{loss.count} messages of {loss.topic} were lost near the action {kind}" for loss in near]
    return tuple(sentences)


def _touches(loss: Loss, stamp_ns: int) -> bool:
    return loss.begin_ns <= stamp_ns + AFTER_NS and loss.end_ns >= stamp_ns - BEFORE_NS


def _age(age_s: float | None) -> str:
    return "no pose came before the action" if age_s is None else f"its last pose is {age_s:.1f} s old"


def _jumps(sightings: Sightings, name: str, stamp_ns: int, plausible: Plausible) -> list[str]:
    jump_m = sightings.largest_jump_m(name, stamp_ns, plausible)
    if jump_m <= plausible.jump_m:
        return []
    return [f"the marker of {name} jumped by {jump_m * 100:.0f} cm just before the action; check what it is glued to"]
