"""Actions with their pre- and post-conditions (paper, Table I).

An action is the tuple (type, parameters, target position, target orientation, reference frame). What it *executes*
is the pose of the end-effector; what a Place or Drop *achieves* is where the object's origin came to rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from learner.model.condition import (
    DROP_RADIUS_M,
    PLACE_RADIUS_M,
    Condition,
    GripperIs,
    GripperState,
    InGripper,
    ObjectAt,
    ObjectPosedAt,
    ObjectRoughlyAt,
)
from learner.model.names import NONE
from learner.model.pose import Pose, Quaternion, Vector

Conditions = frozenset[Condition]
RELEASED: Conditions = frozenset({GripperIs("open"), InGripper(NONE)})


@dataclass(frozen=True, order=True)
class Pick:
    """Move the end-effector to the pose in `frame`, close the gripper around `object`."""

    object: str
    frame: str
    position: Vector
    orientation: Quaternion

    @property
    def preconditions(self) -> Conditions:
        return frozenset({GripperIs("open")})

    @property
    def postconditions(self) -> Conditions:
        return frozenset({GripperIs("closed"), InGripper(self.object)})


@dataclass(frozen=True, order=True)
class _Release:
    """What Place and Drop have in common: the end-effector's pose in `frame`, and where the object comes to `rest`."""

    object: str
    frame: str
    position: Vector
    orientation: Quaternion
    rest: Vector

    @property
    def preconditions(self) -> Conditions:
        return frozenset({InGripper(self.object)})


@dataclass(frozen=True, order=True)
class Place(_Release):
    """Move the end-effector to the pose in `frame`, open the gripper: `object` rests at `rest` [m] in `frame`."""

    radius: float = PLACE_RADIUS_M
    turned: tuple[Quaternion, float] | None = None
    """The object's orientation (xyzw) at rest in `frame`, and within what angle [rad]; None where any will do."""

    @property
    def achieves(self) -> ObjectAt:
        if self.turned is None:
            return ObjectAt(self.object, self.frame, self.rest, self.radius)
        return ObjectPosedAt(self.object, self.frame, self.rest, self.radius, *self.turned)

    @property
    def postconditions(self) -> Conditions:
        return RELEASED | {self.achieves}


@dataclass(frozen=True, order=True)
class Drop(_Release):
    """As Place, from the height of the release: `object` comes to rest only roughly at `rest` [m] in `frame`."""

    radius: float = DROP_RADIUS_M

    @property
    def achieves(self) -> ObjectRoughlyAt:
        return ObjectRoughlyAt(self.object, self.frame, self.rest, self.radius)

    @property
    def postconditions(self) -> Conditions:
        return RELEASED | {self.achieves}


@dataclass(frozen=True, order=True)
class SetGripper:
    """Open or close the gripper where it is."""

    state: GripperState

    @property
    def preconditions(self) -> Conditions:
        return frozenset()

    @property
    def postconditions(self) -> Conditions:
        return RELEASED if self.state == "open" else frozenset({GripperIs("closed")})


Action = Pick | Place | Drop | SetGripper


@dataclass(frozen=True)
class Motion:
    """What a cell executes of a Pick, Place or Drop: the end-effector goes to `pose` in `frame`, the gripper acts."""

    type: Literal["Pick", "Place", "Drop"]
    object: str
    frame: str
    pose: Pose
