"""What to show next: for each action whose frame is not certain, the one demonstration that would decide it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from learner.inference.frames import NO_FRAME
from learner.inference.goals import Group
from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target
from learner.model import Demonstration


def questions(
    demonstrations: Sequence[Demonstration], targets: Sequence[Target], parameters: InferenceParameters,
    groups: Sequence[Group] = (),
) -> list[dict[str, Any]]:  # fmt: skip
    """A question for each target that is not sure, the least certain first, one if there are several goals, and one if
    there are too few demonstrations to tell anything.
    """
    base = demonstrations[0].base_frame
    unsure = [t for t in targets if t.supported and t.certainty < parameters.sure and t.rival() is not None]
    asked = [_question(target, base) for target in sorted(unsure, key=lambda t: (t.certainty, t.object, t.members))]
    if len(groups) > 1:
        asked.append(_which(groups, base))
    if targets and not any(target.supported for target in targets):
        asked.insert(0, _more(demonstrations, parameters))
    return asked


def _question(target: Target, base: str) -> dict[str, Any]:
    rival = target.rival()
    show = _contrast(target.frame, str(rival), base)
    action = f"{target.type} {target.object}"
    other = "it lies so by chance" if rival == NO_FRAME else str(rival)
    return {
        "action": action,
        "frame": target.frame,
        "rival": rival,
        "certainty": round(target.certainty, 4),
        "show": show,
        "sentence": f"{action}: the frame may be {target.frame} ({100 * target.certainty:.0f} %) or {other}; "
        f"to decide it, {show} and demonstrate once more",
    }  # fmt: skip


def _contrast(frame: str, rival: str, base: str) -> str:
    if rival == base or (rival == NO_FRAME and frame != base):
        return f"move {frame} to another place"
    if rival == NO_FRAME:
        return "move every object to another place"
    if frame == base:
        return f"move {rival} to another place"
    return f"move {rival}, leave {frame}"


def _which(groups: Sequence[Group], base: str) -> dict[str, Any]:
    goals = [" and ".join(f"{s.target.object} at {s.target.frame}" for s in group.subgoals) for group in groups]
    show = "show both from one and the same start"
    sentence = (
        f"the demonstrations have {len(groups)} goals ({'; '.join(goals)}), and the tree pursues the first that it "
        f"can; if that is not all one, {show}, or name them as two tasks"
    )
    return {"action": None, "frame": base, "rival": None, "certainty": None, "show": show, "sentence": sentence}


def _more(demonstrations: Sequence[Demonstration], parameters: InferenceParameters) -> dict[str, Any]:
    count = len(demonstrations)
    missing = max(parameters.min_samples - count, 1)
    where = "there" if count == 1 else f"in one of them (first of all {demonstrations[0].demonstration_id})"
    sentence = (
        f"from {count} demonstration{'s' if count > 1 else ''} the tree works only where things start as they did "
        f"{where}; show {missing} more, with every object moved to another place"
    )
    return {"action": None, "frame": demonstrations[0].base_frame, "rival": None, "certainty": None,
            "show": "move every object to another place", "sentence": sentence}  # fmt: skip
