"""What a cell's poses and gripper say: the conditions of CONTRACT, section 3, decided from what was seen.

Pure: who listens to the cell calls `update_pose` and `update_gripper`, who ticks calls `holds`. Ages compare stamps
with stamps, never with this machine's clock; "now" is the newest stamp of any pose.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from learner.errors import TreeError
from learner.model.action import Motion, SetGripper
from learner.model.condition import (
    Condition,
    GripperIs,
    GripperState,
    InGripper,
    ObjectAt,
    ObjectPosedAt,
    ObjectRoughlyAt,
)
from learner.model.frame import START, objects_of, pose_of
from learner.model.holding import Grasp, Sighting, grasped
from learner.model.names import NONE
from learner.model.pose import Pose
from learner.model.query import CountAt, Query, SetSignal, SignalIs
from learner.model.tree import Node, Value
from learner.model.turning import turned_rad
from learner.relations import answering
from learner.relations.answering import Answering, Signal

UNSEEN_NS: Final = 10_000_000_000
"""A condition on an object unseen for this long fails [ns] (CONTRACT, 3)."""
MEMORY_NS: Final = 2_000_000_000
"""How far back poses are kept [ns]: cameras stamp their images earlier than they deliver them."""
FRESH_NS: Final = 500_000_000
"""A pose of the end-effector this far from a stamp [ns] says nothing about that moment (CONTRACT, 1)."""
FOREVER_NS: Final = -1
"""The moment of closing of a gripper that has been closed since before anything was heard of it."""


Checked = Condition | SignalIs | CountAt
"""What holds or not."""


def condition_of(node: Node) -> Checked:
    """The condition that a leaf of a flattened tree checks. Raises TreeError for any other node."""
    word = node.word
    if isinstance(word, Motion | SetGripper | SetSignal | Query):
        raise TreeError(f"{node.kind} is no condition that holds or not")
    return word


def query_of(node: Node) -> Query:
    """What a leaf of a flattened tree looks for. Raises TreeError for any other node."""
    word = node.word
    if not isinstance(word, Query):
        raise TreeError(f"{node.kind} looks for nothing")
    return word


@dataclass(frozen=True)
class Seen:
    """The newest pose of a child in the base frame, and its stamp [ns]."""

    stamp_ns: int
    pose: Pose

    @property
    def sighting(self) -> Sighting:
        """Without the stamp."""
        return _sighting(self.pose)


NOTHING_SEEN: Final[deque[Seen]] = deque()


class CellState:
    """The last seen state of a cell, and which conditions hold in it.

    What is held follows from the gripper's samples and the poses alone: when the gripper turns from open to closed,
    the object with the nearest body within 5 cm is grasped (`learner.model.holding`), and held until the gripper opens,
    but not while it is seen elsewhere than the gripper carries it. One that the hand hides is still held. Where the
    first sample already says closed, the poses at the first question decide.
    """

    def __init__(self, base_frame: str, end_effector_frame: str, answering: Answering | None = None) -> None:
        """`answering` answers the questions of vocabulary 2, and has the scene; without it objects are points."""
        self.base_frame, self.end_effector_frame = base_frame, end_effector_frame
        self.answering = answering or Answering()
        self.signals: dict[str, Signal] = {}
        """What machines say, by signal."""
        self._signals_ns: dict[str, int] = {}
        self._begun: Mapping[str, Pose] | None = None
        self.now_ns = 0
        """The newest stamp of any pose [ns]; 0 before the first."""
        self.gripper: GripperState | None = None
        """The gripper's state as last told, whatever is frozen."""
        self._gripper_ns = 0
        self._seen: dict[str, Seen] = {}
        self._tracks: dict[str, deque[Seen]] = {}
        self._grasp: Grasp | None = None
        self._closed_ns: int | None = None
        """When the gripper closed on something that is not decided yet [ns]."""
        self._unjudged: deque[Seen] = deque()
        self._frozen: tuple[GripperState | None, str | None] | None = None

    def update_pose(self, child: str, stamp_ns: int, pose: Pose) -> bool:
        """Take the pose of `child` in the base; whether it is newer than its last (an older one changes nothing)."""
        last = self._seen.get(child)
        if last and stamp_ns <= last.stamp_ns:
            return False
        seen = self._seen[child] = Seen(stamp_ns, pose)
        self.now_ns = max(self.now_ns, stamp_ns)
        self._remember(child, seen)
        if self._grasp and self._grasp.object == child:
            self._unjudged.append(seen)
        self._decide_grasp()
        self._follow()
        return True

    def forget(self, child: str, stamp_ns: int) -> None:
        """Take back the last pose of `child` if it has this stamp [ns], which turned out wrong."""
        if child not in self._seen or self._seen[child].stamp_ns != stamp_ns:
            return
        del self._seen[child]
        self._tracks.pop(child, None)
        self.now_ns = max((seen.stamp_ns for seen in self._seen.values()), default=0)

    def update_gripper(self, stamp_ns: int, state: GripperState) -> None:
        """Take a sample of the gripper; one older than the last changes nothing."""
        if self.gripper is not None and stamp_ns < self._gripper_ns:
            return
        before, self.gripper, self._gripper_ns = self.gripper, state, stamp_ns
        if state != before:
            self._unjudged.clear()
        if state == "open":
            self._grasp, self._closed_ns = None, None
        elif before != "closed":
            self._closed_ns = stamp_ns if before == "open" else FOREVER_NS
            self._decide_grasp()

    def update_signal(self, name: str, stamp_ns: int, value: Signal) -> None:
        """Take what a machine says; what is older than its last changes nothing."""
        if stamp_ns >= self._signals_ns.get(name, stamp_ns):
            self.signals[name], self._signals_ns[name] = value, stamp_ns

    def begin(self) -> None:
        """The run begins: frames `A@start` are from now on where A is seen now."""
        self._begun = self.poses()

    @property
    def held(self) -> str | None:
        """The object in the gripper, whatever is frozen; None for none."""
        if self._closed_ns == FOREVER_NS and self._hand:
            self._grasp, self._closed_ns = self._nearest(self.now_ns), None
        grasp = self._grasp if self._closed_ns is None else self._nearest(self._closed_ns)
        return grasp.object if grasp and not grasp.lost else None

    def freeze_gripper(self) -> None:
        """From now on GripperIs and InGripper (and "not held") keep the values of this moment: an action starts."""
        self._frozen = (self.gripper, self.held)

    def thaw_gripper(self) -> None:
        """They follow the cell again: the action has ended."""
        self._frozen = None

    def pose(self, name: str) -> Pose | None:
        """The last seen pose of an object, a frame or the end-effector in the base; None if it was never seen."""
        if name == self.base_frame:
            return Pose((0.0, 0.0, 0.0))
        if name.endswith(START) and self._begun is not None:
            return self._begun.get(name.removesuffix(START))
        if not set(objects_of(name)) <= self._seen.keys():
            return None
        return pose_of(name.removesuffix(START), lambda each: self._seen[each].pose)

    def poses(self) -> dict[str, Pose]:
        """The last seen pose of everything, by name."""
        return {name: seen.pose for name, seen in sorted(self._seen.items())}

    def unseen(self, name: str) -> bool:
        """Whether nothing was seen of `name`, or of what a frame goes by, for 10 s or ever. The base is always seen."""
        if name == self.base_frame:
            return False
        if name.endswith(START) and self._begun is not None:
            return name.removesuffix(START) not in self._begun
        return any(
            each not in self._seen or self.now_ns - self._seen[each].stamp_ns >= UNSEEN_NS for each in objects_of(name)
        )

    def holds(self, condition: Checked) -> bool:
        """Whether a condition holds now (CONTRACT, section 3).

        It fails if its object, or the object that is its frame, was unseen for 10 s; a condition on the gripper alone
        fails before the gripper's first sample.
        """
        gripper, held = self._frozen or (self.gripper, self.held)
        match condition:
            case GripperIs():
                return gripper == condition.state
            case InGripper(object=name):
                return gripper is not None and self._in_gripper(name, held)
            case ObjectAt():
                near = condition.object != held and self._is_near(condition, vertical=True)
                return near and self._is_turned(condition)
            case ObjectRoughlyAt():
                return condition.object != held and self._is_near(condition, vertical=False)
            case SignalIs() | CountAt():
                return self.answering.holds(condition, self._answered())

    def find(self, query: Query) -> Mapping[str, Value] | None:
        """What a query finds now, by its output ports; None if it fails (CONTRACT, section 3)."""
        return self.answering.find(query, self._answered())

    def pick_failed(self, name: str, grasp: Pose) -> None:
        """A Pick of an object has failed with the end-effector at `grasp` in the object's frame.

        Told before `thaw_gripper`: one that began with a closed gripper has tried no grasp.
        """
        gripper, _ = self._frozen or (self.gripper, self.held)
        if gripper != "closed" and (at := self.pose(name)) is not None:
            self.answering.grasping.failed(name, at, grasp)

    def _answered(self) -> answering.Seen:
        """What queries are answered by: what was seen lately."""
        _, held = self._frozen or (self.gripper, self.held)
        objects = {name: seen.pose for name, seen in self._seen.items() if not self.unseen(name)}
        hand = objects.pop(self.end_effector_frame, None)
        return answering.Seen(objects, hand, held, self._frame, self.signals)

    def _frame(self, name: str) -> Pose | None:
        return None if self.unseen(name) else self.pose(name)

    def _in_gripper(self, name: str, held: str | None) -> bool:
        return held is None if name == NONE else held == name and not self.unseen(name)

    def _is_near(self, condition: ObjectAt | ObjectRoughlyAt, *, vertical: bool) -> bool:
        if self.unseen(condition.object) or self.unseen(condition.frame):
            return False
        frame = self.pose(condition.frame)
        assert frame is not None  # it was seen
        x, y, z = frame.apply(condition.position)
        at = self._seen[condition.object].pose.position
        distance = math.hypot(at[0] - x, at[1] - y, at[2] - z if vertical else 0.0)
        return distance <= condition.radius

    def _is_turned(self, condition: ObjectAt) -> bool:
        if not isinstance(condition, ObjectPosedAt):
            return True
        frame, pose = self.pose(condition.frame), self._seen[condition.object].pose
        assert frame is not None  # it is near a place in it
        inside = (frame.inverse() @ pose).quaternion_xyzw
        shape = self.answering.scene.objects.get(condition.object)
        symmetry = shape.symmetry if shape else "none"
        return turned_rad(inside, condition.orientation, symmetry) <= condition.angle

    @property
    def _hand(self) -> deque[Seen]:
        return self._tracks.get(self.end_effector_frame, NOTHING_SEEN)

    def _remember(self, child: str, seen: Seen) -> None:
        track = self._tracks.setdefault(child, deque())
        track.append(seen)
        while track[0].stamp_ns < seen.stamp_ns - MEMORY_NS:
            track.popleft()

    def _hand_is_awaited(self, stamp_ns: int) -> bool:
        """Whether the hand is still to be seen at a moment that was heard of by other ways."""
        return not self._hand or 0 < stamp_ns - self._hand[-1].stamp_ns <= FRESH_NS

    def _decide_grasp(self) -> None:
        if self._closed_ns is None or self._closed_ns == FOREVER_NS or self._hand_is_awaited(self._closed_ns):
            return
        self._grasp, self._closed_ns = self._nearest(self._closed_ns), None

    def _nearest(self, stamp_ns: int) -> Grasp | None:
        """What the gripper grasped if it closed at a stamp: judged by the two sightings of the hand around it.

        The nearer one counts: before it the hand may still have been on its way, after it on its way again.
        """
        objects = [name for name in sorted(self._seen) if name != self.end_effector_frame and not self.unseen(name)]
        grasps = (self._grasped(hand, objects) for hand in _around(self._hand, stamp_ns))
        return min((grasp for grasp in grasps if grasp), key=lambda grasp: grasp.nearness, default=None)

    def _grasped(self, hand: Seen, objects: Iterable[str]) -> Grasp | None:
        seen = {name: _sighting(_at(self._tracks[name], hand.stamp_ns)) for name in objects}
        return grasped(hand.sighting, seen, self.answering.scene.sizes)

    def _follow(self) -> None:
        """Judge what was seen of the grasped object, as soon as the hand was seen at that moment or later."""
        while self._grasp and self._unjudged and not self._hand_is_awaited(self._unjudged[0].stamp_ns):
            seen = self._unjudged.popleft()
            hand = _sighting(_at(self._hand, seen.stamp_ns))
            self._grasp.follow(seen.stamp_ns, hand, seen.pose.position)


def _sighting(pose: Pose) -> Sighting:
    return pose.position, pose.quaternion_xyzw


def _around(track: deque[Seen], stamp_ns: int) -> list[Seen]:
    """The last sighting at or before a stamp and the first after it, as far as there are; none for an empty track.

    Only the last one before, if the next came long after; the newest of all, where none was seen near that moment:
    clocks that disagree.
    """
    after: Seen | None = None
    for before in reversed(track):
        if before.stamp_ns <= stamp_ns:
            apart = after is None or after.stamp_ns - before.stamp_ns > FRESH_NS
            return [before] if apart or after is None else [before, after]
        after = before
    if after is None:
        return []
    return [after] if after.stamp_ns - stamp_ns <= FRESH_NS else [track[-1]]


def _at(track: deque[Seen], stamp_ns: int) -> Pose:
    """Where a child was at a stamp: on the way between the two sightings around it. The track is not empty."""
    around = _around(track, stamp_ns)
    return _between(around[0], around[1], stamp_ns) if len(around) > 1 else around[0].pose


def _between(before: Seen, after: Seen, stamp_ns: int) -> Pose:
    """The pose on the straight way from one to the other, quaternions as the normalised mean."""
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    a, b = before.pose, after.pose
    same = 1.0 if sum(p * q for p, q in zip(a.quaternion_xyzw, b.quaternion_xyzw, strict=True)) >= 0 else -1.0
    position = [p + share * (q - p) for p, q in zip(a.position, b.position, strict=True)]
    turn = [p + share * (same * q - p) for p, q in zip(a.quaternion_xyzw, b.quaternion_xyzw, strict=True)]
    return Pose.of(position, turn)
