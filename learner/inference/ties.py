"""Ties: frames that the task itself keeps rigid with the one that the evidence speaks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from learner.inference.moves import Moves
from learner.inference.targets import Target
from learner.model.poses import Rows

Anchors = Mapping[str, str]
"""By object, what it was fixed to; an object that is not named was fixed to nothing but itself."""


@dataclass(frozen=True, eq=False)
class Anchored:
    """What every object was fixed to when something was released: alike for all that are rigid by the task.

    Demonstrations that put the same things in the same frames in one order share a `course` (m,), one for each move;
    `place` (m,) is which of the moves of its demonstration it is. `anchors` are by course and place.
    """

    course: Rows
    place: Rows
    anchors: Sequence[Sequence[Anchors]]

    def at(self, numbers: Sequence[int]) -> list[Anchors]:
        """The distinct anchors of some moves."""
        which = np.asarray(numbers, dtype=np.intp)
        longest = max(map(len, self.anchors), default=1)
        found = np.unique(self.course[which] * longest + self.place[which]).tolist()
        return [self.anchors[one // longest][one % longest] for one in found]


def tied_frames(target: Target, anchored: Anchored) -> frozenset[str]:
    """Frames whose object the task itself has put in a fixed place relative to the chosen one, or the reverse."""
    fixed = anchored.at(target.members)
    return frozenset(
        frame
        for frame in target.frames
        if frame != target.frame and all(a.get(frame, frame) == a.get(target.frame, target.frame) for a in fixed)
    )


def anchors_of(moves: Moves, targets: Sequence[Target]) -> Anchored:
    """What is placed is fixed to what its frame is fixed to then; what goes elsewhere, to a spot of its own."""
    names, name = np.unique(moves.object, return_inverse=True)
    frames = sorted({target.frame for target in targets})
    frame = np.full(len(moves), len(frames))
    for target in targets:
        frame[list(target.members)] = frames.index(target.frame)
    codes = (name.reshape(-1) * (len(frames) + 1) + frame) * 2 + moves.put_back
    lengths = np.bincount(moves.demonstration, minlength=len(moves.samples.numbers))
    place = np.arange(len(moves)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    table = np.full((len(lengths), int(lengths.max(initial=0))), -1)
    table[moves.demonstration, place] = codes
    courses, of = np.unique(table, axis=0, return_inverse=True)
    steps = {
        (n * (len(frames) + 1) + f) * 2 + put_back: (str(each), to, bool(put_back))
        for n, each in enumerate(names)
        for f, to in enumerate((*frames, None))
        for put_back in range(2)
    }
    anchors = [_anchors([steps[code] for code in course if code >= 0]) for course in courses.tolist()]
    return Anchored(of.reshape(-1)[moves.demonstration], place, anchors)


def _anchors(course: Sequence[tuple[str, str | None, bool]]) -> list[Anchors]:
    """What each object was fixed to before each step: an object, the frame of its target, and if it was put back."""
    found, fixed = list[Anchors](), dict[str, str]()
    for number, (name, frame, put_back) in enumerate(course):
        found.append(fixed)
        if frame or not put_back:
            fixed = {**fixed, name: fixed.get(frame, frame) if frame else f"move {number}"}
    return found
