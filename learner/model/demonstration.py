"""A demonstration as learning sees it: the chosen actions, each with the world at its moment and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from learner.model.pose import Pose
from learner.model.scene import Scene

ActionType = Literal["pick", "place", "drop"]
Outcome = Literal["success", "failure", "unknown"]


@dataclass(frozen=True)
class DemonstratedAction:
    """One press of a button with the world around it.

    `end_effector` is its pose in the base at the press; `objects` the pose in the base of every object known then,
    a held one moved with the gripper. `frames` names those of them in whose frame the action may be expressed: the
    held object and what it carries are left out of a place or drop. `rest` is, for a place or drop, the pose of the
    released object in each frame (base and `frames`) once it rested (CONTRACT, section 2: rest pose); where it was
    not seen at rest, the pose at the press stands in and `rest_seen` is False. `warnings` are sentences.
    """

    step: int
    stamp_ns: int
    type: ActionType
    object: str
    end_effector: Pose
    objects: Mapping[str, Pose]
    frames: tuple[str, ...]
    rest: Mapping[str, Pose] | None = None
    rest_seen: bool = True
    warnings: tuple[str, ...] = ()
    relabelled: bool = False
    """Whether a person gave the type afterwards: the label check leaves it as it is."""


@dataclass(frozen=True)
class Demonstration:
    """A demonstration that keeps the contract. `sha256` is the digest of the recording that it came from.

    `initial` and `final` hold the pose in the base of every object seen at the beginning and at the end.
    """

    demonstration_id: str
    task: str
    user: str
    cell: str
    base_frame: str
    end_effector_frame: str
    objects: tuple[str, ...]
    outcome: Outcome
    actions: tuple[DemonstratedAction, ...]
    sha256: str
    initial: Mapping[str, Pose]
    final: Mapping[str, Pose]
    start_ns: int | None = None
    messages_lost: Mapping[str, int | None] | None = None
    scene: Scene | None = None
    warnings: tuple[str, ...] = ()
    gaps: tuple[str, ...] = ()
    """Sentences about messages lost near an action; learning leaves such a demonstration out unless told."""

    @cached_property
    def first_seen(self) -> Mapping[str, Pose]:
        """The pose in the base of every object when it was first seen: at the beginning, else at the next action."""
        worlds = [self.initial, *(action.objects for action in self.actions)]
        return {name: pose for world in reversed(worlds) for name, pose in world.items()}
