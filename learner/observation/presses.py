"""The rules by which a press is judged, when it comes (by the recorder) and when it is ingested: they are these alone.

A press *contradicts* what was seen where no demonstration can hold it: the gripper is not as it has to be, something
else is held, a pose that it needs is not fresh. It is *doubtful* where it can be learned from, but perhaps does not
say what was meant. Sentences begin with the action's number: its place among the presses that the recording leaves.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, get_args

from learner.errors import DemonstrationRefusedError, NameRefusedError
from learner.model import ActionPress, GripperSample, Pose, check_name
from learner.model.demonstration import ActionType
from learner.observation.believing import unbelievable
from learner.observation.freshness import NS, Freshness
from learner.observation.surroundings import Astray, Held, Surroundings, distance_m

Verdict = Literal["accepted", "doubtful", "contradicts"]
SIGNAL: Final = "signal"
UNDO: Final = "undo"
TYPES: Final = (*get_args(ActionType), SIGNAL, UNDO)
UNPLANNED: Final = "learning does not plan with signals yet, so the tree does not set it"
"""Ends the sentence about every signal that was set."""


@dataclass(frozen=True)
class Numbered:
    """A press that stands, and its number in its demonstration."""

    step: int
    press: ActionPress


@dataclass(frozen=True)
class Judgement:
    """What a press came to: the object that it concerns, the world around it, and what is held after it."""

    step: int
    press: ActionPress
    object: str | None
    verdict: Verdict
    reasons: tuple[str, ...] = ()
    end_effector: Pose | None = None
    objects: Mapping[str, Pose] = field(default_factory=dict)
    held: Held | None = None
    astray: Astray | None = None

    @property
    def reason(self) -> str | None:
        """All reasons in one sentence; None where the press is accepted."""
        return "; ".join(self.reasons) or None


def standing(presses: Sequence[ActionPress]) -> list[Numbered]:
    """The presses that nobody took back: `undo` takes back the newest that is not taken back yet."""
    stack: list[ActionPress] = []
    for press in presses:
        if press.type != UNDO:
            stack.append(press)
        elif stack:
            stack.pop()
    return [Numbered(step, press) for step, press in enumerate(stack)]


def judge(numbered: Numbered, held: Held | None, around: Surroundings, gripper: Sequence[GripperSample]) -> Judgement:
    """Judge a press by what was seen until it, while `held` is held; `gripper` is sorted by stamp."""
    step, press = numbered.step, numbered.press
    if press.type == SIGNAL:
        return _judge_signal(step, press, held)
    try:
        return _understood(step, press, held, around, gripper)
    except DemonstrationRefusedError as error:
        return Judgement(step, press, press.object, "contradicts", (str(error),), held=_held_after(press, held, around))


def judge_all(
    presses: Sequence[Numbered], around: Surroundings, gripper: Sequence[GripperSample]
) -> Iterator[Judgement]:
    """Every press judged in turn, also by what the gripper did after it."""
    held: Held | None = None
    for number, each in enumerate(presses):
        found = judge(each, held, around, gripper)
        later = gripper_after(each, gripper, next_press_ns(presses, number), around.freshness)
        if later and found.verdict != "contradicts":
            found = replace(found, verdict="contradicts", reasons=(later,))
        held = found.held
        yield found


def _judge_signal(step: int, press: ActionPress, held: Held | None) -> Judgement:
    try:
        name = check_name("signal", press.signal)
    except NameRefusedError as error:
        return Judgement(step, press, None, "contradicts", (f"action {step} (signal): {error}",), held=held)
    if press.value is None:
        reason = f"action {step} (signal) sets {name} to no value"
        return Judgement(step, press, None, "contradicts", (reason,), held=held)
    reason = f"action {step} (signal) sets {name} to {json.dumps(press.value)}; {UNPLANNED}"
    return Judgement(step, press, None, "doubtful", (reason,), held=held)


def _understood(
    step: int, press: ActionPress, held: Held | None, around: Surroundings, gripper: Sequence[GripperSample]
) -> Judgement:
    """Raises DemonstrationRefusedError where the press contradicts what was seen."""
    name = _object(step, press, held, around)
    end_effector = _end_effector(step, press, around)
    objects = around.sightings(press.stamp_ns, held)
    if name not in objects:
        raise DemonstrationRefusedError(_stale(step, press, name, around.freshness))
    _check_gripper_before(step, press, gripper, around.freshness)
    astray = around.astray(held, press.stamp_ns) if held and press.type != "pick" else None
    doubts = _doubts(press, name, end_effector, objects, around, astray)
    after = Held(name, press.stamp_ns, end_effector, objects) if press.type == "pick" else None
    verdict: Verdict = "doubtful" if doubts else "accepted"
    return Judgement(step, press, name, verdict, doubts, end_effector, objects, after, astray)


def _doubts(
    press: ActionPress,
    name: str,
    end_effector: Pose,
    objects: Mapping[str, Pose],
    around: Surroundings,
    astray: Astray | None,
) -> tuple[str, ...]:
    if press.type == "pick":
        sentence = unbelievable(end_effector, objects, name, around.scene)
        return (sentence,) if sentence else ()
    return (_gone_astray(name, astray),) if astray else ()


def _gone_astray(name: str, astray: Astray) -> str:
    taken = "" if astray.in_hand else "; it is taken to be where the hand carries it"
    return f"{name} was held, but was seen {100 * astray.away_m:.0f} cm from where the hand carried it{taken}"


def _held_after(press: ActionPress, held: Held | None, around: Surroundings) -> Held | None:
    """What is held after a press that contradicts: as if it were true, where something can be said at all."""
    if press.type != "pick" or held is not None:
        return held if press.type not in ("place", "drop") else None
    if press.object not in around.objects or around.hand_age_s(press.stamp_ns) is None:
        return None
    return Held(press.object, press.stamp_ns, around.hand(press.stamp_ns), around.sightings(press.stamp_ns))


def _object(step: int, press: ActionPress, held: Held | None, around: Surroundings) -> str:
    """The object of a press: the one named, else the nearest (pick) or the one held (place, drop)."""
    if press.type not in get_args(ActionType):
        raise DemonstrationRefusedError(f"action {step} is of type {press.type!r}, not {_listed(TYPES)}")
    if press.object is not None and press.object not in around.objects:
        raise DemonstrationRefusedError(
            f"action {step} names {press.object!r}; the objects are {', '.join(around.objects)}"
        )
    if press.type == "pick":
        if held:
            raise DemonstrationRefusedError(f"action {step} picks while {held.object} is held")
        return press.object or _nearest(step, press, around)
    if held is None or press.object not in (None, held.object):
        what, holding = press.object or "something", held.object if held else "nothing"
        raise DemonstrationRefusedError(f"action {step} ({press.type}) releases {what}, but {holding} is held")
    return held.object


def _nearest(step: int, press: ActionPress, around: Surroundings) -> str:
    objects = around.sightings(press.stamp_ns)
    if not objects:
        raise DemonstrationRefusedError(_stale(step, press, "any object", around.freshness))
    end_effector = _end_effector(step, press, around)
    return min(sorted(objects), key=lambda name: distance_m(objects[name], end_effector))


def _stale(step: int, press: ActionPress, what: str, freshness: Freshness) -> str:
    limit = f"{freshness.object_s:g} s"
    return f"action {step} ({press.type}) has no fresh pose of {what}: none in the {limit} before it"


def _end_effector(step: int, press: ActionPress, around: Surroundings) -> Pose:
    age_s = around.hand_age_s(press.stamp_ns)
    if age_s is None or age_s > around.freshness.end_effector_s:
        age = "none came before it" if age_s is None else f"the last is {age_s:.2f} s old"
        name = around.end_effector_frame
        raise DemonstrationRefusedError(
            f"action {step} ({press.type}) has no fresh pose of the end-effector {name}: {age}"
        )
    return around.hand(press.stamp_ns)


def _check_gripper_before(
    step: int, press: ActionPress, samples: Sequence[GripperSample], freshness: Freshness
) -> None:
    before = "open" if press.type == "pick" else "closed"
    at = _last(samples, press.stamp_ns)
    ahead = _last(samples, press.stamp_ns - int(freshness.gripper_s * NS))
    if at >= 0 and all(samples[index].state != before for index in {at, max(ahead, 0)}):
        raise DemonstrationRefusedError(f"action {step} ({press.type}) contradicts the gripper: it is not {before}")


def gripper_after(
    numbered: Numbered, samples: Sequence[GripperSample], end_ns: int | None, freshness: Freshness
) -> str | None:
    """Why what the gripper did after a press, up to the next one at `end_ns`, contradicts it; None if it does not."""
    step, press = numbered.step, numbered.press
    if press.type not in get_args(ActionType):
        return None
    after = "closed" if press.type == "pick" else "open"
    begin = _last(samples, press.stamp_ns) + 1
    later = [sample for sample in samples[begin:] if end_ns is None or sample.stamp_ns <= end_ns]
    patience_ns = press.stamp_ns + int(freshness.release_s * NS)
    waited = any(sample.stamp_ns > patience_ns for sample in later)
    if waited and all(sample.state != after for sample in later):
        return f"action {step} ({press.type}) contradicts the gripper: it never became {after}"
    return None


def next_press_ns(presses: Sequence[Numbered], number: int) -> int | None:
    """The stamp [ns] of the next press that moves the gripper, after the one at a place of the list."""
    later = (each.press for each in presses[number + 1 :])
    return next((press.stamp_ns for press in later if press.type in get_args(ActionType)), None)


def _last(samples: Sequence[GripperSample], stamp_ns: int) -> int:
    """The index of the last sample at or before a stamp; -1 if there is none."""
    return bisect_right(samples, stamp_ns, key=lambda sample: sample.stamp_ns) - 1


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"
