"""Conditions, and which of them cannot hold at the same time (paper, Tables I and II)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from learner.errors import ModelError
from learner.model.names import NONE
from learner.model.pose import IDENTITY_XYZW, Quaternion, Vector

GripperState = Literal["open", "closed"]

PLACE_RADIUS_M = 0.05
"""Radius of the sphere in which a placed object counts as there (paper, section III-B)."""
DROP_RADIUS_M = 0.10
"""Radius of the vertical cylinder in which a dropped object counts as there (paper, section III-B)."""

DROP_HEIGHT_M = 0.03
"""Released from higher above where it comes to rest, an object was dropped: more than a hand's noise, less than a wall
of a box."""


@dataclass(frozen=True, order=True)
class GripperIs:
    """The gripper is `state`. The paper's Gripper(state)."""

    state: GripperState

    def __post_init__(self) -> None:
        if self.state not in get_args(GripperState):
            raise ModelError(f"a gripper is open or closed, not {self.state!r}")


@dataclass(frozen=True, order=True)
class InGripper:
    """The gripper holds `object`; `none` means that it holds nothing."""

    object: str


@dataclass(frozen=True, order=True)
class ObjectAt:
    """The origin of `object` lies in the sphere of `radius` [m] about `position` [m] in `frame`, and is not held."""

    object: str
    frame: str
    position: Vector
    radius: float = PLACE_RADIUS_M


@dataclass(frozen=True, order=True)
class ObjectRoughlyAt:
    """The same in an unbounded cylinder along the base frame's vertical. The paper's ObjectAt†."""

    object: str
    frame: str
    position: Vector
    radius: float = DROP_RADIUS_M


@dataclass(frozen=True, order=True)
class ObjectPosedAt(ObjectAt):
    """ObjectAt, and the object's `orientation` (xyzw) in `frame` is within `angle` [rad], up to its symmetry."""

    orientation: Quaternion = IDENTITY_XYZW
    angle: float = math.pi


Condition = GripperIs | InGripper | ObjectAt | ObjectRoughlyAt
"""An ObjectPosedAt is an ObjectAt that says more."""


def compatible(a: Condition, b: Condition) -> bool:
    """Whether both conditions can hold at the same time: comp of the paper, section III-B.

    Symmetric, and every condition is compatible with itself. Positions differ where frame or coordinates differ.
    """
    return not (_excludes(a, b) or _excludes(b, a))


def _excludes(a: Condition, b: Condition) -> bool:
    match a, b:
        case InGripper(), InGripper():
            return a.object != b.object
        case GripperIs(), GripperIs():
            return a.state != b.state
        case GripperIs(state="open"), InGripper():
            return b.object != NONE
        case ((ObjectAt() | ObjectRoughlyAt()), (ObjectAt() | ObjectRoughlyAt())):
            return a.object == b.object and (a.frame, a.position) != (b.frame, b.position)
        case _:
            return False
