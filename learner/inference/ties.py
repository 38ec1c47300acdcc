"""Ties: frames that the task itself keeps rigid with the one that the evidence speaks for."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from learner.inference.moves import Moves
from learner.inference.targets import Target

Anchors = Mapping[str, str]
"""By object, what it was fixed to; an object that is not named was fixed to nothing but itself."""


def tied_frames(target: Target, anchors: Sequence[Anchors]) -> frozenset[str]:
    """Frames whose object the task itself has put in a fixed place relative to the chosen one, or the reverse."""
    fixed = _distinct([anchors[number] for number in target.members])
    return frozenset(
        frame
        for frame in target.frames
        if frame != target.frame and all(a.get(frame, frame) == a.get(target.frame, target.frame) for a in fixed)
    )


def anchors_of(moves: Moves, targets: Sequence[Target]) -> list[Anchors]:
    """For every move what each object was fixed to when it was released: alike for all that are rigid by the task.

    What is placed is fixed to what its frame is fixed to then; what goes elsewhere, to a spot of its own.
    """
    frames = {number: target.frame for target in targets for number in target.members}
    fixed: dict[int, Anchors] = defaultdict(dict)
    found = []
    columns = moves.demonstration.tolist(), moves.object.tolist(), moves.put_back.tolist()
    for number, (demonstration, name, put_back) in enumerate(zip(*columns, strict=True)):
        here, frame = fixed[demonstration], frames.get(number)
        found.append(here)
        if frame or not put_back:
            fixed[demonstration] = {**here, name: here.get(frame, frame) if frame else f"move {number}"}
    return found


def _distinct(anchors: Sequence[Anchors]) -> list[Anchors]:
    """Each of them once."""
    return list({tuple(sorted(each.items())): each for each in anchors}.values())
