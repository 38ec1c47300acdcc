"""Recordings told line by line: where the hand goes, what is pressed, what the camera does not see.

tape = Tape({"A": at(0.4, 0.1), "box": at(0.5, -0.2)})
tape.pick("A").release("place", Pose((0.5, -0.2, 0.03)))
observe(tape.recording())
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from support_demonstrations import BASE, GRASP, TOOL

from learner.model import ActionPress, GripperSample, Pose, Recording, Track
from learner.model.condition import GripperState

NS = 1_000_000_000
START_NS = 1_790_000_000 * NS
STEP_S = 1 / 30
SPEED_M = 0.02
"""The hand goes so far from one pose to the next [m]."""
UP: tuple[float, float, float] = (0.0, 0.0, 0.15)

Seen = Callable[[str, int, Pose], Pose | None]
"""What the camera makes of the true pose of a name at its n-th sample; None where it sees nothing."""


class Tape:
    """A cell whose clock goes on with every line told; everything is seen at 30 Hz unless `hidden`."""

    def __init__(self, poses: Mapping[str, Pose], seen: Seen | None = None) -> None:
        self.poses, self.seen = dict(poses), seen
        self.hand = Pose((0.3, 0.0, 0.4), GRASP.quaternion_xyzw)
        self.now_ns = START_NS
        self.hidden: set[str] = set()
        self.grasped: dict[str, Pose] = {}
        self.sightings: dict[str, list[tuple[int, Pose]]] = {TOOL: [], **{name: [] for name in poses}}
        self.gripper = [GripperSample(START_NS, "open", 0.08)]
        self.presses: list[ActionPress] = []
        self.wait(0.5)

    def wait(self, duration_s: float) -> Tape:
        for _ in range(max(1, round(duration_s / STEP_S))):
            self.now_ns += round(STEP_S * NS)
            self._look()
            if self.now_ns - self.gripper[-1].stamp_ns > NS:
                self.gripper.append(replace(self.gripper[-1], stamp_ns=self.now_ns))
        return self

    def _look(self) -> None:
        for name, pose in {TOOL: self.hand, **self.poses}.items():
            found = self.seen(name, len(self.sightings[name]), pose) if self.seen else pose
            if name not in self.hidden and found is not None:
                self.sightings[name].append((self.now_ns, found))

    def hide(self, *names: str) -> Tape:
        self.hidden |= set(names)
        return self

    def show(self, *names: str) -> Tape:
        self.hidden -= set(names)
        return self

    def put(self, name: str, pose: Pose) -> Tape:
        """Somebody sets an object down somewhere else."""
        self.poses[name] = pose
        return self

    def go(self, to: Pose) -> Tape:
        """Move the hand in a straight line; what it holds goes along."""
        begin, end = np.array(self.hand.position), np.array(to.position)
        steps = max(1, math.ceil(float(np.linalg.norm(end - begin)) / SPEED_M))
        for share in np.linspace(0, 1, steps + 1)[1:]:
            self.hand = Pose.of(begin + share * (end - begin), to.quaternion_xyzw)
            self.poses.update({name: self.hand @ pose for name, pose in self.grasped.items()})
            self.wait(STEP_S)
        return self

    def press(self, kind: str, name: str | None = None) -> Tape:
        self.presses.append(ActionPress(self.now_ns, kind, name))
        return self

    def grip(self, state: GripperState, *names: str) -> Tape:
        """Close around objects (what lies on the held one included), or open."""
        self.gripper.append(GripperSample(self.now_ns, state, None))
        self.grasped = {name: self.hand.inverse() @ self.poses[name] for name in names}
        return self

    def reach(self, name: str) -> Tape:
        grasp = self.poses[name] @ GRASP
        self.go(replace(grasp, position=tuple(np.add(grasp.position, UP).tolist())))  # type: ignore[arg-type]
        return self.go(grasp).wait(0.4)

    def pick(self, name: str, *carried: str, named: bool = True) -> Tape:
        self.reach(name).press("pick", name if named else None).wait(0.15).grip("closed", name, *carried).wait(0.3)
        return self

    def bring(self, to: Pose) -> Tape:
        """Move the hand so that the object it holds comes to a pose in the base."""
        held = next(iter(self.grasped.values()))
        hand = to @ held.inverse()
        lifted = np.add(self.hand.position, UP), np.add(hand.position, UP)
        for position in lifted:
            self.go(Pose.of(position, hand.quaternion_xyzw))
        return self.go(hand).wait(0.4)

    def release(self, kind: str, to: Pose, fall_m: float = 0.0, named: bool = True) -> Tape:
        """Bring the held object above where it comes to rest, press, open, and let it fall."""
        name = next(iter(self.grasped))
        x, y, z = to.position
        self.bring(Pose((x, y, z + fall_m), to.quaternion_xyzw)).press(kind, name if named else None).wait(0.15)
        return self.grip("open").put(name, to).wait(0.8)

    def tracks(self) -> dict[str, Track]:
        return {name: _track(found) for name, found in self.sightings.items() if found}

    def recording(self, **other: Any) -> Recording:
        """What was recorded, with other values for some fields."""
        recording = Recording(
            demonstration_id="d1",
            task="task",
            user="u1",
            cell="cell",
            base_frame=BASE,
            end_effector_frame=TOOL,
            objects=tuple(sorted(self.poses)),
            outcome="success",
            tracks=self.tracks(),
            gripper=tuple(self.gripper),
            presses=tuple(self.presses),
            sha256="0" * 64,
            parents=frozenset({BASE}),
        )
        return replace(recording, **other)


def _track(sightings: list[tuple[int, Pose]]) -> Track:
    return Track(
        np.array([stamp for stamp, _ in sightings], dtype=np.int64),
        np.array([pose.position for _, pose in sightings]),
        np.array([pose.quaternion_xyzw for _, pose in sightings]),
    )


def before(track: Track, stamp_ns: int) -> Track:
    """The samples of a track up to a stamp, without those after it."""
    kept = track.stamps_ns <= stamp_ns
    return Track(track.stamps_ns[kept], track.positions[kept], track.quaternions_xyzw[kept])
