"""What was seen around a press: the hand and every object, a held one moved with the hand.

Matched by stamps alone (CONTRACT, section 1): the last pose of each child at or before the press. The value is made
robust: positions are medians and orientations are means of the largest agreeing set over the still moments just
before, so that camera noise and a marker that flips for a frame do not enter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from learner.model import Pose, Recording, Scene, Track
from learner.model.holding import SLIP_M
from learner.model.pose import Array, angle_between, mean_quaternion
from learner.observation.believing import in_reach
from learner.observation.freshness import NS, Freshness


@dataclass(frozen=True)
class Held:
    """What the gripper holds, since which press, and the world at that press."""

    object: str
    stamp_ns: int
    end_effector: Pose
    objects: Mapping[str, Pose]


@dataclass(frozen=True)
class Astray:
    """A held object that is seen at `pose`, `away_m` [m] from where the hand carries it.

    `in_hand` tells whether it is still within the gripper's reach there: turned in the grasp, not elsewhere.
    """

    pose: Pose
    away_m: float
    in_hand: bool


@dataclass(frozen=True)
class Surroundings:
    """What was seen in one demonstration, by child frame; `objects` are those that it names."""

    tracks: Mapping[str, Track]
    objects: tuple[str, ...]
    end_effector_frame: str
    scene: Scene | None = None
    freshness: Freshness = field(default_factory=Freshness)

    def hand_age_s(self, stamp_ns: int) -> float | None:
        """How old [s] the hand's last pose at or before a stamp is; None if there is none."""
        track = self.tracks.get(self.end_effector_frame)
        index = -1 if track is None else last(track, stamp_ns)
        return None if track is None or index < 0 else (stamp_ns - int(track.stamps_ns[index])) / NS

    def hand(self, stamp_ns: int) -> Pose:
        """The hand's last pose at or before a stamp, else its first."""
        track = self.tracks[self.end_effector_frame]
        index = max(last(track, stamp_ns), 0)
        return Pose.of(track.positions[index], track.quaternions_xyzw[index])

    def sightings(self, stamp_ns: int, held: Held | None = None) -> dict[str, Pose]:
        """The pose in the base of every object seen at most 5 s before, a held one moved with the hand."""
        found = ((name, self._sighting(name, stamp_ns, held)) for name in self.objects)
        return {name: pose for name, pose in found if pose is not None}

    def first_seen(self, name: str) -> Pose:
        """The pose of an object when it was first seen."""
        track = self.tracks[name]
        return still_pose(track, int(track.stamps_ns[0]), 0, self.freshness)

    def carried(self, held: Held, objects: Mapping[str, Pose]) -> set[str]:
        """The objects that moved along with the held one since the pick."""
        if not {held.object} <= objects.keys() & held.objects.keys():
            return set()
        before, after = held.objects[held.object], objects[held.object]
        return {
            name
            for name in set(objects) & set(held.objects) - {held.object}
            if distance_m(before.inverse() @ held.objects[name], after.inverse() @ objects[name])
            < self.freshness.carried_m < distance_m(held.objects[name], objects[name])
        }  # fmt: skip

    def astray(self, held: Held, stamp_ns: int) -> Astray | None:
        """Where the held object was last seen, if that is not where the hand carried it then; else None."""
        index = self._fresh(held.object, stamp_ns)
        track = self.tracks.get(held.object)
        if index is None or track is None or int(track.stamps_ns[index]) <= held.stamp_ns:
            return None
        seen_ns = int(track.stamps_ns[index])
        pose = still_pose(track, seen_ns, index, self.freshness)
        away_m = distance_m(pose, self._carried_to(held, seen_ns) or pose)
        if away_m <= SLIP_M:
            return None
        return Astray(pose, away_m, in_reach(self.hand(seen_ns), held.object, pose, self.scene))

    def _carried_to(self, held: Held, stamp_ns: int) -> Pose | None:
        """Where the hand carries what it holds, as it was gripped; None if it was not seen then."""
        gripped = held.objects.get(held.object)
        return None if gripped is None else self.hand(stamp_ns) @ held.end_effector.inverse() @ gripped

    def _fresh(self, name: str, stamp_ns: int) -> int | None:
        """The index of the last sample of an object, if it is fresh enough."""
        track = self.tracks.get(name)
        index = -1 if track is None else last(track, stamp_ns)
        if track is None or index < 0 or stamp_ns - int(track.stamps_ns[index]) > self.freshness.object_s * NS:
            return None
        return index

    def _sighting(self, name: str, stamp_ns: int, held: Held | None) -> Pose | None:
        index = self._fresh(name, stamp_ns)
        if index is None:
            return None
        track = self.tracks[name]
        if held is None or held.object != name:
            return still_pose(track, int(track.stamps_ns[index]), index, self.freshness)
        astray = self.astray(held, stamp_ns)
        if astray is not None and not astray.in_hand:
            return self._carried_to(held, stamp_ns)
        return self._moved_with_hand(held, track, index, stamp_ns)

    def _moved_with_hand(self, held: Held, track: Track, index: int, stamp_ns: int) -> Pose:
        """The pose of the held object: as last seen, moved by what the hand has moved since."""
        seen_ns = int(track.stamps_ns[index])
        pose = still_pose(track, seen_ns, index, self.freshness)
        then = self.hand(seen_ns) if seen_ns > held.stamp_ns else held.end_effector
        return self.hand(stamp_ns) @ then.inverse() @ pose


def surroundings_of(recording: Recording, freshness: Freshness | None = None) -> Surroundings:
    """What was seen in a whole recording."""
    r = recording
    return Surroundings(r.tracks, r.objects, r.end_effector_frame, r.scene, freshness or Freshness())


def last(track: Track, stamp_ns: int) -> int:
    """The index of the last sample at or before a stamp; -1 if there is none."""
    return int(np.searchsorted(track.stamps_ns, stamp_ns, side="right")) - 1


def still_pose(track: Track, seen_ns: int, index: int, freshness: Freshness) -> Pose:
    """The pose at sample `index`, made robust over the still samples in the window that ends there.

    For the very first sample the window begins there instead.
    """
    if index == 0:
        begin, end = 0, last(track, seen_ns + freshness.window_ns) + 1
    else:
        begin, end = last(track, seen_ns - freshness.window_ns) + 1, index + 1
    positions, quaternions = track.positions[begin:end], track.quaternions_xyzw[begin:end]
    near = np.linalg.norm(positions - track.positions[index], axis=1) < 2 * freshness.still_m
    return Pose.of(np.median(positions[near], axis=0), _agreeing_mean(quaternions[near], freshness.agreeing_rad))


def _agreeing_mean(quaternions: Array, agreeing_rad: float) -> Array:
    """The mean of the largest set of orientations within `agreeing_rad` of one of them; the later one in a tie."""
    angles = angle_between(quaternions[:, None, :], quaternions[None, :, :])
    agreeing = angles < agreeing_rad
    best = len(quaternions) - 1 - int(np.argmax(agreeing.sum(axis=1)[::-1]))
    return mean_quaternion(quaternions[agreeing[best]])


def distance_m(a: Pose, b: Pose) -> float:
    """Between the origins of two poses."""
    return float(np.linalg.norm(np.subtract(a.position, b.position)))
