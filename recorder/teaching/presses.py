"""Presses as they come: each judged at once, by the rules by which ingest judges it (learner.observation.presses)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from learner.model import ActionPress
from learner.observation.presses import UNDO, Judgement, Numbered, Verdict, gripper_after, judge, next_press_ns
from learner.observation.surroundings import Surroundings
from recorder.recording import Demonstrated, parse_scene
from recorder.teaching.feedback import Finding, Plausible, Sightings, find
from recorder.wire import ACTION

NO_GRIPPER: Final = "no state of the gripper has come, so the action is not checked by it"
NOTHING_LEFT: Final = "there is no action that could be taken back"


@dataclass
class Pressed:
    """A press, its stamp [ns] as it was given and on the timeline of the poses (`press`), and what it came to."""

    stamp_ns: int
    press: ActionPress
    judgement: Judgement
    finding: Finding
    checked: bool = True
    """Whether any state of the gripper had come."""

    @property
    def verdict(self) -> Verdict:
        """As ingest has it; what is odd about other poses is a doubt here."""
        return "doubtful" if self.judgement.verdict == "accepted" and self.sentences else self.judgement.verdict

    @property
    def reason(self) -> str | None:
        """All reasons in one sentence; None where the press is accepted."""
        return "; ".join(self.sentences) or None

    @property
    def sentences(self) -> tuple[str, ...]:
        """Everything that there is to say; of what contradicts, why it does."""
        if self.judgement.verdict == "contradicts":
            return self.judgement.reasons
        unchecked = () if self.checked else (NO_GRIPPER,)
        return (*self.judgement.reasons, *unchecked, *self.finding.sentences)

    def to_data(self) -> dict[str, Any]:
        """The reply to a press (CONTRACT, section 1)."""
        return {
            "step": self.judgement.step,
            "type": self.press.type,
            "object": self.judgement.object,
            "stamp_ns": self.stamp_ns,
            "verdict": self.verdict,
            "reason": self.reason,
        }


class Presses:
    """The presses of one demonstration that stand. Not safe for threads."""

    def __init__(self, demonstrated: Demonstrated, plausible: Plausible) -> None:
        self._objects, self._hand = demonstrated.objects, demonstrated.end_effector_frame
        self._scene = None if demonstrated.scene is None else parse_scene(demonstrated.scene)
        self._plausible = plausible
        self._standing: list[Pressed] = []
        self._none: str | None = None

    def take_none(self, reason: str) -> None:
        """A message came that is no action: what was pressed nobody knows, and ingest refuses the recording."""
        self._none = self._none or f"a message on {ACTION} {reason}"

    def take(self, press: ActionPress, stamp_ns: int, sightings: Sightings) -> Pressed:
        """Judge a press by what was seen until now; `stamp_ns` is its stamp as it was given."""
        if press.type == UNDO:
            return self._undone(press, stamp_ns)
        pressed = self._judged(press, stamp_ns, len(self._standing), self._around(sightings), sightings)
        self._standing.append(pressed)
        return pressed

    def again(self, pressed: Pressed, sightings: Sightings) -> Pressed:
        """The same press judged by what has been seen meanwhile, and those after it; one taken back stays as it was."""
        place = next((place for place, each in enumerate(self._standing) if each is pressed), None)
        if place is None:
            return pressed
        around = self._around(sightings)
        for number, each in list(enumerate(self._standing))[place:]:
            found = self._judged(each.press, each.stamp_ns, number, around, sightings)
            each.judgement, each.finding, each.checked = found.judgement, found.finding, found.checked
        return pressed

    def contradiction(self, sightings: Sightings) -> str | None:
        """The first reason why what stands contradicts what was seen, the gripper after each press included."""
        if self._none:
            return self._none
        numbered = [Numbered(number, each.press) for number, each in enumerate(self._standing)]
        for number, each in enumerate(self._standing):
            if each.verdict == "contradicts":
                return each.reason
            end_ns = next_press_ns(numbered, number)
            later = gripper_after(numbered[number], sightings.gripper, end_ns, sightings.freshness)
            if later:
                return later
        return None

    def _undone(self, press: ActionPress, stamp_ns: int) -> Pressed:
        if not self._standing:
            judgement = Judgement(0, press, None, "doubtful", (NOTHING_LEFT,))
        else:
            taken = self._standing.pop().judgement
            judgement = Judgement(taken.step, press, taken.object, "accepted")
        return Pressed(stamp_ns, press, judgement, Finding((), ()))

    def _around(self, sightings: Sightings) -> Surroundings:
        tracks = sightings.tracks((self._hand, *self._objects))
        return Surroundings(tracks, self._objects, self._hand, self._scene, sightings.freshness)

    def _judged(
        self, press: ActionPress, stamp_ns: int, number: int, around: Surroundings, sightings: Sightings
    ) -> Pressed:
        held = self._standing[number - 1].judgement.held if number else None
        judgement = judge(Numbered(number, press), held, around, sightings.gripper)
        others = [name for name in self._objects if held is None or name != held.object]
        finding = find(sightings, self._hand, others, press.stamp_ns, self._plausible)
        return Pressed(stamp_ns, press, judgement, finding, bool(sightings.gripper))
