"""Every number of the rehearsal: how a stage is set up, which rollouts are done, and how they are judged.

They are the method's; the numbers of the simulated bodies and of the arm stand where those are simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class StageParameters:
    """How a stage is set up as the demonstrations were."""

    floating_m: float = 0.5
    """How high above the table points begin: nothing falls there, and the hand meets no table."""
    upright_rad: float = math.radians(20)
    """A body tilted further against how it usually stands lies on another face."""
    inside_m: float = 0.01
    """What reaches this far below the top of another, within its outline, lies in it."""
    origin_m: float = 0.01
    """An origin is taken to be in the middle of a body unless that would sink into the table by more than this."""
    placed_m: float = 0.025
    """The stage does as was shown if what is let go comes to rest this near to where it did ..."""
    dropped_m: float = 0.08
    """... and what is dropped, or fell further than `fell_m`, this near."""
    fell_m: float = 0.03
    agreed_m: float = 0.009
    """What is placed comes to rest, in the median of all demonstrations, no further from where it did: three times
    what a camera scatters. Further off, the stage lacks a pocket or a rim."""
    absent_m: float = 5.0
    """Objects that a demonstration never saw stand this far away."""
    least_turn: float = 0.5
    """Faces that agree less than this on a turn of the hand tell none (the length of the mean of unit vectors)."""
    most_starts: int = 60
    """Of more demonstrations, so many that are spread evenly over all make the starts of a stage."""


@dataclass(frozen=True)
class RolloutParameters:
    """Which rollouts there are."""

    shown: int = 10
    """At most so many begin where a demonstration began, with nothing changed."""
    kinds: Mapping[str, int] = field(
        default_factory=lambda: {
            "scattered": 8,
            "occupied": 5,
            "partly": 8,
            "covered": 5,
            "tower": 2,
            "taken": 3,
            "moved": 3,
        }
    )
    """How many rollouts of each other kind there are."""
    draws: int = 30
    """So many attempts to imagine a start in which the task can be done."""
    gap_m: float = 0.025
    """Scattered things keep this distance from each other."""
    clear_m: float = 0.01
    """What cannot be moved keeps this distance from a goal's place."""
    partly_m: tuple[float, float] = (0.03, 0.065)
    """How far from the middle of a goal's place a thing stands that is partly in its way."""


@dataclass(frozen=True)
class JudgingParameters:
    """When a rollout is over, and how it ended."""

    hold_s: float = 1.0
    """The goal must hold this long."""
    idle_s: float = 3.0
    """A tree that has done nothing for this long will not go on."""
    patience: int = 3
    """At most this many times the actions of an undisturbed run ..."""
    aside: int = 4
    """... and this many more for each thing that was put in the way: twice a pick and a placement."""
    slack_m: float = 0.015
    """The truth may lie this much outside of the paper's radius: the camera may have seen it within."""
    slack_rad: float = math.radians(4)
    """The same of an orientation."""
    told: int = 5
    """So many failures are told."""


@dataclass(frozen=True)
class LessonParameters:
    """What a failure teaches."""

    trials: int = 4
    """So many repaired trees are rehearsed at the most."""
    often: int = 3
    """What happens so often in one rollout is no accident."""


@dataclass(frozen=True)
class ReplayParameters:
    """How often a tree is replayed with the arm, and where things stand for it."""

    actions: int = 12
    """Runs are done while they are expected to take no more actions than this together, but one at least ..."""
    replays: int = 2
    """... and not more than this, unless all of them fail ..."""
    tries: int = 3
    """... when so many starts are tried in all, before a tree is refused."""
    grid_m: float = 0.05
    shifts: int = 30
    """The table is shifted on a grid of `grid_m`, so many steps to each side."""
    room_m: float = 0.25
    """Nothing stands nearer to the arm's base ..."""
    behind_m: float = -0.2
    """... nor further behind it, where the table ends soon."""
    hand_m: float = 0.12
    """From the middle of an object to what stands beside it, so that the simulated hand fits at any yaw."""


@dataclass(frozen=True)
class UserParameters:
    """How often the tree of the others is tried on what each user showed."""

    most_trials: int = 60
    """So many demonstrations are tried in all at most, the same number of each user, spread evenly ..."""
    least_trials: int = 3
    """... but of each user at least so many: enough to tell half."""


@dataclass(frozen=True)
class RehearsalParameters:
    """The numbers of the rehearsal by what they are for."""

    stage: StageParameters = field(default_factory=StageParameters)
    rollouts: RolloutParameters = field(default_factory=RolloutParameters)
    judging: JudgingParameters = field(default_factory=JudgingParameters)
    lessons: LessonParameters = field(default_factory=LessonParameters)
    replay: ReplayParameters = field(default_factory=ReplayParameters)
    users: UserParameters = field(default_factory=UserParameters)
