"""Targets: where a task puts an object. Placements of one object, across demonstrations, that mean the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from learner.inference.clustering import greatest_distance
from learner.inference.frames import frames_of
from learner.inference.labels import LabelCheck, label_check
from learner.inference.moves import Moves
from learner.inference.parameters import InferenceParameters
from learner.inference.support import Support, support_of
from learner.model.poses import Poses


@dataclass(frozen=True)
class Target:
    """One place of one object.

    `members` are numbers of moves; `frames` the posterior probability of each candidate frame, `frame` the one
    chosen; `rests` and `releases` are the object's poses in it, a row a member.
    """

    object: str
    frame: str
    members: tuple[int, ...]
    frames: Mapping[str, float] = field(compare=False)
    label: LabelCheck = field(compare=False)
    rests: Poses = field(compare=False)
    releases: Poses = field(compare=False)
    context: int = 0
    supported: bool = True
    upon: Support | None = None
    """What the object rests upon, and where in its frame [m]; None if that is no object, or it rests in one."""
    tied: frozenset[str] = field(default=frozenset())
    """Frames that the task itself keeps rigid with the chosen one: they are not rivals."""

    @cached_property
    def _hash(self) -> int:
        return hash((self.object, self.frame, self.members, self.context, self.tied))

    def __hash__(self) -> int:
        """Worked out once: there may be very many members."""
        return self._hash

    @property
    def type(self) -> str:
        """place or drop, as the label check judges."""
        return self.label.type

    @property
    def spread_m(self) -> float:
        return greatest_distance(self.rests.positions)

    @property
    def certainty(self) -> float:
        """The posterior probability of the chosen frame and those tied to it."""
        return sum(share for frame, share in self.frames.items() if frame == self.frame or frame in self.tied)

    def rival(self) -> str | None:
        """The likeliest other frame; None if there is none."""
        return next((frame for frame in self.frames if frame != self.frame and frame not in self.tied), None)


def target_of(
    members: Sequence[int], moves: Moves, parameters: InferenceParameters, context: int = 0, among: int | None = None,
    richer: Sequence[str] = (), lasting: bool = True,
) -> Target | None:  # fmt: skip
    """The target of these moves, chosen `among` so many, in the frame that the evidence speaks for.

    None if it speaks for no frame, or, if `lasting`, the placement does not last.
    """
    frames = frames_of(members, moves, parameters, among, richer, lasting)
    return _in_frame(next(iter(frames)), members, moves, parameters, frames, context) if frames else None


def in_frame(target: Target, frame: str, moves: Moves, parameters: InferenceParameters) -> Target:
    """The same placements in another frame."""
    return _in_frame(frame, target.members, moves, parameters, target.frames, target.context)


def alone(number: int, moves: Moves, parameters: InferenceParameters) -> Target:
    """A move that fits nowhere, in the default frame: the base (section III-E)."""
    return _in_frame(moves.samples.base, (number,), moves, parameters, {}, supported=False)


def _in_frame(
    frame: str, members: Sequence[int], moves: Moves, parameters: InferenceParameters, frames: Mapping[str, float],
    context: int = 0, supported: bool = True,
) -> Target:  # fmt: skip
    samples = moves.releases(members)
    rests, upon = samples.rest(frame), support_of(samples, parameters)
    label = label_check(samples, greatest_distance(rests.positions), upon is not None, parameters)
    name, releases = str(samples.object[0]), samples.release(frame)
    return Target(name, frame, tuple(members), frames, label, rests, releases, context, supported, upon)
