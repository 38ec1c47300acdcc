"""The teacher's feedback: whether each action's poses are there, at once, so that the step is repeated and not the day.

The same rules of freshness by which learning matches actions to poses (CONTRACT, section 1), applied to the stream.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from learner.model import GripperSample, Track
from learner.model.stamps import Timeline
from learner.observation import Freshness
from recorder.clocks import THE_GRIPPER, clock_sentences
from recorder.errors import PayloadError
from recorder.intake.account import Loss
from recorder.notices import Notices
from recorder.wire import ACTION, GRIPPER, NS, POSES, Sighting, parse_gripper, parse_sighting, parse_transforms


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


FAR_M: Final = 20.0
"""No arm reaches so far: what is said to be there is given in another unit."""
FAR: Final = "{child} is more than 20 m away from {base}; positions are metres, these look like millimetres"
KEPT_NS: Final = 8 * NS
"""Sightings older than this against the newest are forgotten."""


@dataclass(frozen=True)
class Finding:
    """What is wrong around an action: `unseen` objects have no usable pose; `sentences` say all there is to say."""

    unseen: tuple[str, ...]
    sentences: tuple[str, ...]


class Sightings:
    """The last seconds of /poses and /gripper in one demonstration, decoded and on one timeline.

    What is odd about them goes to `notices`. `names` are the demonstration's objects and its end-effector; of other
    children nothing is told. Not safe for threads: its owner holds a lock.
    """

    freshness: Final = Freshness()

    def __init__(self, base_frame: str, names: Sequence[str] = (), notices: Notices | None = None) -> None:
        self.base_frame, self._names = base_frame, frozenset(names)
        self._notices = notices or Notices()
        self._timeline: Timeline[Sighting | GripperSample] = Timeline()
        self._stamps: dict[str, deque[int]] = defaultdict(deque)
        self._seen: dict[str, deque[Sighting]] = defaultdict(deque)
        self._heard: dict[str, tuple[int, int]] = {}
        self.gripper: list[GripperSample] = []
        """Of the whole demonstration, by stamp: of each run of one state the first and the last."""
        self.newest_ns = 0

    def add(self, payload: bytes, arrived_ns: int) -> None:
        """Take in a message of /poses that arrived at a log time [ns]."""
        if not self.base_frame:
            return
        try:
            transforms = parse_transforms(payload)
        except PayloadError as error:
            self._notices.add(f"a message on {POSES} {error}")
            return
        for transform in transforms:
            self._see(transform, arrived_ns)
        self._note_clocks()

    def add_gripper(self, payload: bytes, arrived_ns: int) -> None:
        """Take in a message of /gripper that arrived at a log time [ns]."""
        if not self.base_frame:
            return
        try:
            sample = parse_gripper(payload)
        except PayloadError as error:
            self._notices.add(f"a message on {GRIPPER} {error}")
            return
        for stamp_ns, found in self._timeline.take(THE_GRIPPER, sample.stamp_ns, arrived_ns, sample):
            assert isinstance(found, GripperSample)
            self._keep_gripper(replace(found, stamp_ns=stamp_ns))
        self._note_clocks()

    def now_ns(self, child: str, now_ns: int) -> int:
        """What the clock that stamps a child's poses shows at a log time [ns]; the log time where it never came."""
        stamp_ns, arrived_ns = self._heard.get(child, (now_ns, now_ns))
        return stamp_ns + max(now_ns - arrived_ns, 0)

    def tracks(self, names: Iterable[str]) -> dict[str, Track]:
        """The last seconds of those names that were seen."""
        return {name: _track(self._stamps[name], self._seen[name]) for name in names if self._stamps.get(name)}

    def moved(self, stamp_ns: int, arrived_ns: int) -> int:
        """Where the stamp [ns] of an action stands on the timeline of the poses."""
        return self._timeline.moved(stamp_ns, arrived_ns)

    def _see(self, transform: FrameTransform, arrived_ns: int) -> None:
        child = transform.child_frame_id
        try:
            seen = parse_sighting(transform)
        except PayloadError as error:
            self._note(child, f"a message on {POSES} {error}")
            return
        if seen.parent != self.base_frame:
            if child not in self._stamps:
                self._note(child, f"{child} is given in {seen.parent!r}, not in the base frame {self.base_frame}")
            return
        if math.hypot(*seen.position) > FAR_M:
            self._note(child, FAR.format(child=child, base=self.base_frame))
        for stamp_ns, found in self._timeline.take(child, seen.stamp_ns, arrived_ns, seen):
            assert isinstance(found, Sighting)
            if found is seen:
                self._heard[child] = seen.stamp_ns, arrived_ns
            self._keep(child, stamp_ns, found)

    def _note(self, child: str, sentence: str) -> None:
        if child in self._names:
            self._notices.add(sentence)

    def _note_clocks(self) -> None:
        steps, strays = self._timeline.steps, self._timeline.strays
        if not (steps or strays):
            return
        for sentence in clock_sentences(steps, strays):
            self._notices.add(sentence)
        for stray in strays:
            self._forget(str(stray.sender), stray.stamp_ns)
        steps.clear()
        strays.clear()

    def _keep(self, child: str, stamp_ns: int, seen: Sighting) -> None:
        self.newest_ns = max(self.newest_ns, stamp_ns)
        stamps, kept = self._stamps[child], self._seen[child]
        index = bisect_right(stamps, stamp_ns)
        if index and stamps[index - 1] == stamp_ns:
            return
        stamps.insert(index, stamp_ns)
        kept.insert(index, seen)
        while stamps[0] < self.newest_ns - KEPT_NS and len(stamps) > 1:
            stamps.popleft()
            kept.popleft()

    def _keep_gripper(self, sample: GripperSample) -> None:
        index = bisect_right(self.gripper, sample.stamp_ns, key=lambda each: each.stamp_ns)
        before = [each.state for each in self.gripper[max(index - 2, 0) : index]]
        if index == len(self.gripper) and before == [sample.state, sample.state]:
            self.gripper.pop()
            index -= 1
        self.gripper.insert(index, sample)

    def _forget(self, sender: str, stamp_ns: int) -> None:
        """A stamp that was taken in turned out a stray."""
        self.gripper = [each for each in self.gripper if sender != THE_GRIPPER or each.stamp_ns != stamp_ns]
        stamps = self._stamps.get(sender)
        if stamps is not None and stamp_ns in stamps:
            del self._seen[sender][stamps.index(stamp_ns)]
            stamps.remove(stamp_ns)
            self.newest_ns = max((stamps[-1] for stamps in self._stamps.values() if stamps), default=0)

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
            (stamp, seen.position)
            for stamp, seen in zip(self._stamps.get(child, ()), self._seen.get(child, ()), strict=True)
            if begin_ns <= stamp <= stamp_ns
        ]
        steps = (
            math.dist(before, after)
            for (earlier, before), (later, after) in pairwise(sightings)
            if later - earlier <= plausible.jump_s * NS
        )
        return max(steps, default=0.0)


def _track(stamps_ns: Iterable[int], seen: Iterable[Sighting]) -> Track:
    numbers = np.array([(*each.position, *each.quaternion_xyzw) for each in seen], dtype=np.float64)
    return Track(np.array(stamps_ns, dtype=np.int64), numbers[:, :3], numbers[:, 3:])


NOT_WATCHING: Final = Sightings("")
"""Takes nothing in."""


def find(
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


APART_S: Final = 3600.0
"""A pose so old is not an old one: the clocks are apart."""
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
    if age_s is None:
        return "no pose came before the action"
    apart = "; do the clocks of poses and action agree?" if age_s > APART_S else ""
    return f"its last pose is {age_s:.1f} s old{apart}"


def _jumps(sightings: Sightings, name: str, stamp_ns: int, plausible: Plausible) -> list[str]:
    jump_m = sightings.largest_jump_m(name, stamp_ns, plausible)
    if jump_m <= plausible.jump_m:
        return []
    return [f"the marker of {name} jumped by {jump_m * 100:.0f} cm just before the action; check what it is glued to"]
