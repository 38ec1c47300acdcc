"""From a recording to a demonstration: which world surrounded each press, and where the object came to rest.

An action is matched to poses by their stamps alone (CONTRACT, section 1): the last pose of each child at or before
the press. The value is made robust: positions are medians and orientations are means of the largest agreeing set
over the still moments just before, so that camera noise and a marker that flips for a frame do not enter.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, get_args

import numpy as np

from learner.errors import DemonstrationRefusedError, NameRefusedError
from learner.model import DemonstratedAction, Demonstration, Pose, Recording, Track, check_name
from learner.model.demonstration import ActionType, Outcome
from learner.model.pose import Array, angle_between, mean_quaternion

NS: Final = 1_000_000_000
_NO_GRIPPER: Final = "the gripper's states were not recorded; actions are not checked by them"


@dataclass(frozen=True)
class Freshness:
    """How old and how still a pose has to be. Defaults from CONTRACT, sections 1 and 2, where it gives them."""

    end_effector_s: float = 0.5
    object_s: float = 5.0
    window_s: float = 0.3
    still_m: float = 0.005
    agreeing_rad: float = 0.35
    """Orientations further apart than this within a window are a flip, not noise."""
    gripper_s: float = 0.1
    """By so much the gripper's stamp may run ahead of the press."""
    release_s: float = 2.0
    """So long the gripper may take to move after a press before the press counts as contradicted."""
    far_m: float = 20.0
    """No arm reaches so far: what is there was not given in metres."""
    carried_m: float = 0.02
    """An object that keeps its place relative to the held one within this is carried by it."""


def observe(recording: Recording, freshness: Freshness | None = None) -> Demonstration:
    """The demonstration that a recording holds.

    Raises DemonstrationRefusedError, with the reason for the quarantine, for a recording that breaks the contract:
    a bad name, no action, an object never seen, an action without a fresh pose of what it needs, or one that
    contradicts the gripper or the object held.
    """
    return _Observer(recording, freshness or Freshness()).demonstration()


@dataclass
class _Held:
    """What the gripper holds, since which press, and the world at that press."""

    object: str
    stamp_ns: int
    end_effector: Pose
    objects: Mapping[str, Pose]


class _Observer:
    """One pass over the presses of one recording."""

    def __init__(self, recording: Recording, freshness: Freshness) -> None:
        self.recording, self.freshness = recording, freshness
        self.held: _Held | None = None
        self.names: tuple[str, ...] = ()
        self.gripper_stamps = [sample.stamp_ns for sample in recording.gripper]

    def demonstration(self) -> Demonstration:
        r = self.recording
        self._check_whole()
        self.names = self._names()
        actions = tuple(self._action(step) for step in range(len(r.presses)))
        everything = [int(stamp) for track in r.tracks.values() for stamp in track.stamps_ns[[0, -1]]]
        return Demonstration(
            demonstration_id=r.demonstration_id,
            task=r.task,
            user=r.user,
            cell=r.cell,
            base_frame=r.base_frame,
            end_effector_frame=r.end_effector_frame,
            objects=r.objects,
            outcome=r.outcome,  # type: ignore[arg-type]  # checked in _check_whole
            actions=actions,
            sha256=r.sha256,
            initial={name: _still_pose(r.tracks[name], int(r.tracks[name].stamps_ns[0]), 0, self.freshness)
                     for name in r.objects},
            final=self._sightings(max(everything)),
            start_ns=r.start_ns,
            messages_lost=r.messages_lost,
            scene=r.scene,
            warnings=(*(() if r.gripper else (_NO_GRIPPER,)), *r.notes),
            gaps=r.gaps,
        )  # fmt: skip

    @property
    def window_ns(self) -> int:
        return int(self.freshness.window_s * NS)

    def _check_whole(self) -> None:
        r = self.recording
        for kind, names in (("task", [r.task]), ("user", [r.user]), ("cell", [r.cell]), ("object", r.objects),
                            ("frame", [r.base_frame, r.end_effector_frame])):  # fmt: skip
            for name in names:
                _refuse_bad_name(kind, name)
        if r.outcome not in get_args(Outcome):
            raise DemonstrationRefusedError(f"the outcome is {r.outcome!r}, not one of {', '.join(get_args(Outcome))}")
        if len(set(r.objects)) != len(r.objects) or {r.base_frame, r.end_effector_frame} & set(r.objects):
            raise DemonstrationRefusedError("objects, base frame and end-effector frame need names of their own")
        if not r.presses:
            raise DemonstrationRefusedError("no action was demonstrated; press pick, place or drop while recording")
        for name in (r.end_effector_frame, *r.objects):
            if name not in r.tracks or not len(r.tracks[name].stamps_ns):
                raise DemonstrationRefusedError(self._never_seen(name))
            if np.median(np.linalg.norm(r.tracks[name].positions, axis=1)) > self.freshness.far_m:
                raise DemonstrationRefusedError(
                    f"{name} is more than {self.freshness.far_m:g} m away from {r.base_frame}; "
                    "positions are metres, these look like millimetres"
                )

    def _never_seen(self, name: str) -> str:
        what = "end-effector frame" if name == self.recording.end_effector_frame else "object"
        others = sorted(self.recording.parents - {self.recording.base_frame})
        told = [note for note in self.recording.notes if repr(name) in note]
        told += [f"poses were given relative to {', '.join(others)}"] if others else []
        hint = f" ({'; '.join(told)})" if told else ""
        seen = ", ".join(sorted(self.recording.tracks)) or "nothing: the recording holds no poses in that frame"
        return f"the {what} {name} was never seen in {self.recording.base_frame}{hint}; seen were {seen}"

    def _names(self) -> tuple[str, ...]:
        """The object of every press: the one named, else the nearest (pick) or the one held (place, drop)."""
        names: list[str] = []
        held: str | None = None
        for step, press in enumerate(self.recording.presses):
            if press.type not in get_args(ActionType):
                raise DemonstrationRefusedError(f"action {step} is of type {press.type!r}, not pick, place or drop")
            if press.object is not None and press.object not in self.recording.objects:
                known = ", ".join(self.recording.objects)
                raise DemonstrationRefusedError(f"action {step} names {press.object!r}; the objects are {known}")
            if press.type == "pick":
                if held:
                    raise DemonstrationRefusedError(f"action {step} picks while {held} is held")
                held = press.object or self._nearest(step)
                names.append(held)
            else:
                if held is None or press.object not in (None, held):
                    what, holding = press.object or "something", held or "nothing"
                    raise DemonstrationRefusedError(
                        f"action {step} ({press.type}) releases {what}, but {holding} is held"
                    )
                names.append(held)
                held = None
        return tuple(names)

    def _nearest(self, step: int) -> str:
        objects = self._sightings(self.recording.presses[step].stamp_ns)
        if not objects:
            raise DemonstrationRefusedError(self._stale(step, "any object"))
        end_effector = self._end_effector(step)
        return min(sorted(objects), key=lambda name: _distance(objects[name], end_effector))

    def _stale(self, step: int, what: str) -> str:
        press = self.recording.presses[step]
        limit = f"{self.freshness.object_s:g} s"
        return f"action {step} ({press.type}) has no fresh pose of {what}: none in the {limit} before it"

    def _action(self, step: int) -> DemonstratedAction:
        press, name = self.recording.presses[step], self.names[step]
        end_effector = self._end_effector(step)
        objects = self._sightings(press.stamp_ns)
        if name not in objects:
            raise DemonstrationRefusedError(self._stale(step, name))
        self._check_gripper(step)
        if press.type == "pick":
            self.held = _Held(name, press.stamp_ns, end_effector, objects)
            return DemonstratedAction(step, press.stamp_ns, "pick", name, end_effector, objects, tuple(sorted(objects)))
        return self._release(step, end_effector, objects)

    def _release(self, step: int, end_effector: Pose, objects: Mapping[str, Pose]) -> DemonstratedAction:
        press, name = self.recording.presses[step], self.names[step]
        frames = tuple(sorted(set(objects) - {name} - self._carried(objects)))
        self.held = None
        rest_ns = self._rest_ns(step, name)
        world = objects if rest_ns is None else {**objects, **self._sightings(rest_ns)}
        rest = {frame: world[frame].inverse() @ world[name] for frame in frames}
        return DemonstratedAction(
            step=step,
            stamp_ns=press.stamp_ns,
            type="place" if press.type == "place" else "drop",
            object=name,
            end_effector=end_effector,
            objects=objects,
            frames=frames,
            rest={**rest, self.recording.base_frame: world[name]},
            rest_seen=rest_ns is not None,
            warnings=() if rest_ns is not None else (f"{name} was not seen at rest; its pose at the press stands in",),
        )

    def _end_effector(self, step: int) -> Pose:
        press, name = self.recording.presses[step], self.recording.end_effector_frame
        track = self.recording.tracks[name]
        index = _last(track, press.stamp_ns)
        age_s = (press.stamp_ns - int(track.stamps_ns[index])) / NS if index >= 0 else None
        if age_s is None or age_s > self.freshness.end_effector_s:
            age = "none came before it" if age_s is None else f"the last is {age_s:.2f} s old"
            raise DemonstrationRefusedError(
                f"action {step} ({press.type}) has no fresh pose of the end-effector {name}: {age}"
            )
        return Pose.of(track.positions[index], track.quaternions_xyzw[index])

    def _check_gripper(self, step: int) -> None:
        press, samples = self.recording.presses[step], self.recording.gripper
        before, after = ("open", "closed") if press.type == "pick" else ("closed", "open")
        at = bisect_right(self.gripper_stamps, press.stamp_ns) - 1
        ahead = bisect_right(self.gripper_stamps, press.stamp_ns - int(self.freshness.gripper_s * NS)) - 1
        if at >= 0 and all(samples[index].state != before for index in {at, max(ahead, 0)}):
            raise DemonstrationRefusedError(f"action {step} ({press.type}) contradicts the gripper: it is not {before}")
        end_ns = self._next_press_ns(step)
        later = [sample for sample in samples[at + 1 :] if end_ns is None or sample.stamp_ns <= end_ns]
        patience_ns = press.stamp_ns + int(self.freshness.release_s * NS)
        waited = any(sample.stamp_ns > patience_ns for sample in later)
        if waited and all(sample.state != after for sample in later):
            raise DemonstrationRefusedError(
                f"action {step} ({press.type}) contradicts the gripper: it never became {after}"
            )

    def _next_press_ns(self, step: int, name: str | None = None) -> int | None:
        """The stamp of the next press, or of the next one that concerns `name`."""
        later = self.recording.presses[step + 1 :]
        named = zip(later, self.names[step + 1 :], strict=True)
        return next((press.stamp_ns for press, of in named if name in (None, of)), None)

    def _sightings(self, stamp_ns: int) -> dict[str, Pose]:
        """The pose in the base of every object seen at most 5 s before, a held one moved with the gripper."""
        found = ((name, self._sighting(name, stamp_ns)) for name in self.recording.objects)
        return {name: pose for name, pose in found if pose is not None}

    def _sighting(self, name: str, stamp_ns: int) -> Pose | None:
        track = self.recording.tracks[name]
        index = _last(track, stamp_ns)
        if index < 0 or stamp_ns - int(track.stamps_ns[index]) > self.freshness.object_s * NS:
            return None
        seen_ns = int(track.stamps_ns[index])
        if self.held is None or self.held.object != name:
            return _still_pose(track, seen_ns, index, self.freshness)
        return self._moved_with_gripper(self.held, track, index, stamp_ns)

    def _moved_with_gripper(self, held: _Held, track: Track, index: int, stamp_ns: int) -> Pose:
        """The pose of the held object: as last seen, moved by what the end-effector has moved since."""
        seen_ns = int(track.stamps_ns[index])
        since_grasp = seen_ns > held.stamp_ns
        pose = _still_pose(track, seen_ns, index, self.freshness)
        hand = self.recording.tracks[self.recording.end_effector_frame]
        then = _pose_at(hand, seen_ns) if since_grasp else held.end_effector
        now = _pose_at(hand, stamp_ns)
        return now @ then.inverse() @ pose

    def _carried(self, objects: Mapping[str, Pose]) -> set[str]:
        """The objects that moved along with the held one since the pick."""
        held = self.held
        if held is None or held.object not in held.objects:
            return set()
        before, after = held.objects[held.object], objects[held.object]
        return {
            name
            for name in set(objects) & set(held.objects) - {held.object}
            if _distance(before.inverse() @ held.objects[name], after.inverse() @ objects[name])
            < self.freshness.carried_m < _distance(held.objects[name], objects[name])
        }  # fmt: skip

    def _rest_ns(self, step: int, name: str) -> int | None:
        """The end of the first 0.3 s after the release in which the object is seen and still; None if there is none."""
        track = self.recording.tracks[name]
        released_ns = self._released_ns(step)
        next_ns = self._next_press_ns(step, name)
        first = bisect_right(track.stamps_ns, released_ns)
        last = len(track.stamps_ns) if next_ns is None else _last(track, next_ns) + 1
        for begin in range(first, last):
            end_ns = int(track.stamps_ns[begin]) + self.window_ns
            end = min(_last(track, end_ns) + 1, last)
            whole = next_ns is None or end_ns <= next_ns
            if whole and _covers(track, begin, end, self.window_ns) and self._still(track.positions[begin:end]):
                return int(track.stamps_ns[end - 1])
        return None

    def _still(self, positions: Array) -> bool:
        return _drift(positions) < self.freshness.still_m

    def _released_ns(self, step: int) -> int:
        press = self.recording.presses[step]
        end_ns = self._next_press_ns(step)
        opened = (s.stamp_ns for s in self.recording.gripper if s.stamp_ns > press.stamp_ns and s.state == "open")
        first = next(opened, press.stamp_ns)
        return first if end_ns is None or first < end_ns else press.stamp_ns


def _refuse_bad_name(kind: str, name: str) -> None:
    try:
        check_name(kind, name)
    except NameRefusedError as error:
        raise DemonstrationRefusedError(str(error)) from error


def _last(track: Track, stamp_ns: int) -> int:
    """The index of the last sample at or before a stamp; -1 if there is none."""
    return int(np.searchsorted(track.stamps_ns, stamp_ns, side="right")) - 1


def _pose_at(track: Track, stamp_ns: int) -> Pose:
    index = max(_last(track, stamp_ns), 0)
    return Pose.of(track.positions[index], track.quaternions_xyzw[index])


def _still_pose(track: Track, seen_ns: int, index: int, freshness: Freshness) -> Pose:
    """The pose at sample `index`, made robust over the still samples in the window that ends there.

    For the very first sample the window begins there instead.
    """
    window_ns = int(freshness.window_s * NS)
    if index == 0:
        begin, end = 0, _last(track, seen_ns + window_ns) + 1
    else:
        begin, end = _last(track, seen_ns - window_ns) + 1, index + 1
    positions, quaternions = track.positions[begin:end], track.quaternions_xyzw[begin:end]
    near = np.linalg.norm(positions - track.positions[index], axis=1) < 2 * freshness.still_m
    return Pose.of(np.median(positions[near], axis=0), _agreeing_mean(quaternions[near], freshness.agreeing_rad))


def _agreeing_mean(quaternions: Array, agreeing_rad: float) -> Array:
    """The mean of the largest set of orientations within `agreeing_rad` of one of them; the later one in a tie."""
    angles = angle_between(quaternions[:, None, :], quaternions[None, :, :])
    agreeing = angles < agreeing_rad
    best = len(quaternions) - 1 - int(np.argmax(agreeing.sum(axis=1)[::-1]))
    return mean_quaternion(quaternions[agreeing[best]])


def _distance(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(np.subtract(a.position, b.position)))


def _covers(track: Track, begin: int, end: int, window_ns: int) -> bool:
    """Whether the samples really span the window, so that a glimpse does not count as being seen."""
    span_ns = int(track.stamps_ns[end - 1] - track.stamps_ns[begin])
    return end - begin >= 3 and span_ns > window_ns // 2


def _drift(positions: Array) -> float:
    """How far [m] the object moved over the samples (n, 3): between the medians of both halves, noise averaged out."""
    half = (len(positions) + 1) // 2
    return float(np.linalg.norm(np.median(positions[:half], axis=0) - np.median(positions[-half:], axis=0)))


def warnings_of(demonstration: Demonstration) -> Iterable[str]:
    """Every warning of a demonstration, those of its actions with their step."""
    yield from demonstration.warnings
    for action in demonstration.actions:
        for warning in action.warnings:
            yield f"action {action.step} ({action.type} {action.object}): {warning}"
