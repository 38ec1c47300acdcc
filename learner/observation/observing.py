"""The demonstration that a recording holds, or the reason why it holds none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, get_args

import numpy as np

from learner.errors import DemonstrationRefusedError, NameRefusedError
from learner.model import DemonstratedAction, Demonstration, Recording, check_name
from learner.model.demonstration import Outcome
from learner.model.pose import Vector
from learner.observation.corrections import Correction, corrected, told
from learner.observation.freshness import Freshness
from learner.observation.presses import SIGNAL, Judgement, Numbered, judge_all, next_press_ns
from learner.observation.resting import released_ns, rest_ns, stale_position
from learner.observation.segmenting import done_in
from learner.observation.surroundings import surroundings_of

NO_GRIPPER: Final = "the gripper's states were not recorded; actions are not checked by them"


def observe(
    recording: Recording, freshness: Freshness | None = None, corrections: Sequence[Correction] = ()
) -> Demonstration:
    """The demonstration that a recording holds, by the presses that it leaves standing, else by hand.

    `corrections` are what a person said of them afterwards. Raises DemonstrationRefusedError, with the reason for the
    quarantine, for a recording that breaks the contract: a bad name, no action, an object never seen, or a press that
    contradicts what was seen (see learner.observation.presses).
    """
    found, notes = done_in(recording, freshness)
    noted = replace(recording, notes=(*recording.notes, *notes, *told(found, corrections)))
    return _Observer(noted, freshness or Freshness(), corrected(found, corrections)).demonstration()


class _Observer:
    """One pass over the presses of one recording."""

    def __init__(self, recording: Recording, freshness: Freshness, presses: Sequence[Numbered]) -> None:
        self.recording, self.freshness, self.presses = recording, freshness, presses
        r = recording
        self.around = surroundings_of(r, freshness)

    def demonstration(self) -> Demonstration:
        r = self.recording
        self._check_whole()
        judged = self._judged()
        everything = [int(stamp) for track in r.tracks.values() for stamp in track.stamps_ns[[0, -1]]]
        held = judged[-1].held
        return Demonstration(
            demonstration_id=r.demonstration_id,
            task=r.task,
            user=r.user,
            cell=r.cell,
            base_frame=r.base_frame,
            end_effector_frame=r.end_effector_frame,
            objects=r.objects,
            outcome=r.outcome,  # type: ignore[arg-type]  # checked in _check_whole
            actions=self._actions(judged),
            sha256=r.sha256,
            initial={name: self.around.first_seen(name) for name in r.objects},
            final=self.around.sightings(max(everything), held),
            start_ns=r.start_ns,
            messages_lost=r.messages_lost,
            scene=r.scene,
            warnings=(*(() if r.gripper else (NO_GRIPPER,)), *_about_signals(judged), *r.notes),
            gaps=r.gaps,
        )

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
        if all(each.press.type == SIGNAL for each in self.presses):
            raise DemonstrationRefusedError(self._nothing_done())
        for name in (r.end_effector_frame, *r.objects):
            self._check_seen(name)

    def _nothing_done(self) -> str:
        by_hand = "nor did the gripper close on anything that then moved with it"
        if self.presses:
            return f"nothing but signals was demonstrated, {by_hand}; press pick, place or drop while recording"
        if self.recording.presses:
            return f"every action was taken back, {by_hand}; press pick, place or drop while recording"
        return f"no action was demonstrated, {by_hand}; press pick, place or drop while recording"

    def _check_seen(self, name: str) -> None:
        r = self.recording
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

    def _judged(self) -> list[Judgement]:
        """Every press that stands, judged. Raises DemonstrationRefusedError at the first that contradicts."""
        judged: list[Judgement] = []
        for found in judge_all(self.presses, self.around, self.recording.gripper):
            if found.verdict == "contradicts":
                raise DemonstrationRefusedError(found.reason)
            judged.append(found)
        return judged

    def _actions(self, judged: Sequence[Judgement]) -> tuple[DemonstratedAction, ...]:
        return tuple(
            _pick(found) if found.press.type == "pick" else self._release(judged, number)
            for number, found in enumerate(judged)
            if found.press.type != SIGNAL
        )

    def _release(self, judged: Sequence[Judgement], number: int) -> DemonstratedAction:
        found, held = judged[number], judged[number - 1].held
        name, objects, end_effector = found.object, found.objects, found.end_effector
        assert name is not None
        assert held is not None
        assert end_effector is not None
        frames = tuple(sorted(set(objects) - {name} - self.around.carried(held, objects)))
        stale = stale_position(held, objects[name], found.astray)
        rested_ns = self._rested_ns(judged, number, stale)
        world = objects if rested_ns is None else {**objects, **self.around.sightings(rested_ns)}
        rest = {frame: world[frame].inverse() @ world[name] for frame in frames}
        unseen = () if rested_ns is not None else (f"{name} was not seen at rest; its pose at the press stands in",)
        return DemonstratedAction(
            step=found.step,
            stamp_ns=found.press.stamp_ns,
            type="place" if found.press.type == "place" else "drop",
            object=name,
            end_effector=end_effector,
            objects=objects,
            frames=frames,
            rest={**rest, self.recording.base_frame: world[name]},
            rest_seen=rested_ns is not None,
            warnings=(*found.reasons, *unseen),
        )

    def _rested_ns(self, judged: Sequence[Judgement], number: int, stale: Vector | None) -> int | None:
        found, gripper = judged[number], self.recording.gripper
        opened_ns = released_ns(gripper, found.press.stamp_ns, next_press_ns(self.presses, number))
        of_object = (later.press.stamp_ns for later in judged[number + 1 :] if later.object == found.object)
        track = self.recording.tracks[str(found.object)]
        return rest_ns(track, opened_ns, next(of_object, None), stale, self.freshness)


def _pick(found: Judgement) -> DemonstratedAction:
    assert found.object is not None
    assert found.end_effector is not None
    frames, objects = tuple(sorted(found.objects)), found.objects
    return DemonstratedAction(
        found.step, found.press.stamp_ns, "pick", found.object, found.end_effector, objects, frames,
        warnings=found.reasons,
    )  # fmt: skip


def _about_signals(judged: Iterable[Judgement]) -> list[str]:
    return [reason for found in judged if found.press.type == SIGNAL for reason in found.reasons]


def _refuse_bad_name(kind: str, name: str) -> None:
    try:
        check_name(kind, name)
    except NameRefusedError as error:
        raise DemonstrationRefusedError(str(error)) from error


def warnings_of(demonstration: Demonstration) -> Iterable[str]:
    """Every warning of a demonstration, those of its actions with their step."""
    yield from demonstration.warnings
    for action in demonstration.actions:
        for warning in action.warnings:
            yield f"action {action.step} ({action.type} {action.object}): {warning}"
