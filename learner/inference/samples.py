"""Demonstrated actions as samples: one row an action, its positions in every candidate frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learner.model import DemonstratedAction, Demonstration, Pose
from learner.model.pose import Array


@dataclass(frozen=True)
class Sample:
    """One demonstrated action: the number of its demonstration, and the action."""

    demonstration: int
    user: str
    base_frame: str
    action: DemonstratedAction

    @property
    def frames(self) -> tuple[str, ...]:
        """The candidate frames: the base and, as the observation left them, the objects."""
        return (self.base_frame, *self.action.frames)

    def pose_of(self, frame: str) -> Pose:
        """The pose in the base of a candidate frame at the press."""
        return Pose((0.0, 0.0, 0.0)) if frame == self.base_frame else self.action.objects[frame]

    def target(self, frame: str) -> Pose:
        """The end-effector's pose in a candidate frame at the press."""
        return self.pose_of(frame).inverse() @ self.action.end_effector

    def release(self, frame: str) -> Pose:
        """The object's pose in a candidate frame at the press."""
        return self.pose_of(frame).inverse() @ self.action.objects[self.action.object]

    def rest(self, frame: str) -> Pose:
        """Where the object came to rest, in a candidate frame. For a pick, where it was."""
        return self.release(frame) if self.action.rest is None else self.action.rest[frame]


def samples_of(demonstrations: Sequence[Demonstration]) -> list[Sample]:
    """Every action of every demonstration, in order."""
    return [
        Sample(number, demonstration.user, demonstration.base_frame, action)
        for number, demonstration in enumerate(demonstrations)
        for action in demonstration.actions
    ]


def candidate_frames(samples: Iterable[Sample]) -> list[str]:
    """Every frame that is a candidate for at least one sample, the base frame first, then by name."""
    samples = list(samples)
    bases = {sample.base_frame for sample in samples}
    objects = {frame for sample in samples for frame in sample.frames} - bases
    return sorted(bases) + sorted(objects)


def positions_in(
    frame: str, samples: Sequence[Sample], numbers: Iterable[int], what: str
) -> tuple[NDArray[np.intp], Array]:
    """Which of the numbered samples know `frame` (n,), and their positions in it [m] (n, 3).

    `what` is 'target' (the end-effector's), 'release' or 'rest' (the object's).
    """
    known = [number for number in numbers if frame in samples[number].frames]
    points = [getattr(samples[number], what)(frame).position for number in known]
    return np.array(known, dtype=np.intp), np.array(points, dtype=np.float64).reshape(-1, 3)
