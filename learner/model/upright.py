"""Where upright things stand: a spot for a pose, an upright block for a body.

Everything stands upright, so that a pose is a `Spot`: the origin and a yaw about the base frame's vertical.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from learner.model.frame import pose_of
from learner.model.pose import Pose, Vector, rotated

MARGIN_M: Final = 0.004
"""Side faces may overlap by this much before that counts as a collision [m]."""


@dataclass(frozen=True)
class Spot:
    """Where an upright body stands in the base: its origin [m] and its yaw [rad]."""

    x: float
    y: float
    z: float
    yaw: float

    def pose(self) -> Pose:
        return Pose((self.x, self.y, self.z), (0.0, 0.0, math.sin(self.yaw / 2), math.cos(self.yaw / 2)))

    @staticmethod
    def of(pose: Pose) -> Spot:
        """The spot of a pose, its tilt left out."""
        x, y, z, w = pose.quaternion_xyzw
        return Spot(*pose.position, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def point(self, x: float, y: float) -> tuple[float, float]:
        """A point (x, y) of the body's frame, in the base."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + cos * x - sin * y, self.y + sin * x + cos * y

    def within(self, x: float, y: float) -> tuple[float, float]:
        """A point (x, y) of the base, in the body's frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * (x - self.x) + sin * (y - self.y), -sin * (x - self.x) + cos * (y - self.y)

    def compose(self, other: Spot) -> Spot:
        """`spot_a_in_base.compose(spot_b_in_a)` is `spot_b_in_base`."""
        x, y = self.point(other.x, other.y)
        return Spot(x, y, self.z + other.z, self.yaw + other.yaw)

    def relative(self, other: Spot) -> Spot:
        """`other`, given in the base, in this spot's frame."""
        x, y = self.within(other.x, other.y)
        return Spot(x, y, other.z - self.z, other.yaw - self.yaw)


def spot_of(frame: str, spots: Mapping[str, Spot]) -> Spot:
    """Where a frame is that goes by objects at these spots."""
    return Spot.of(pose_of(frame, lambda name: spots[name].pose()))


@dataclass(frozen=True)
class Block:
    """A solid where it stands in the base: its spot (z unused), half sizes, bottom and top [m]."""

    name: str
    spot: Spot
    half_x: float
    half_y: float
    bottom: float
    top: float

    def covers(self, x: float, y: float, wider: float = 0.0) -> bool:
        """Whether the point (x, y) of the base lies over the footprint, `wider` [m] on every side."""
        along, across = self.spot.within(x, y)
        return abs(along) <= self.half_x + wider and abs(across) <= self.half_y + wider

    def overlaps(self, other: Block, margin: float = MARGIN_M) -> bool:
        """Whether the footprints overlap by more than `margin` [m] (separating axes)."""
        return _overlap_along(self, other) > margin and _overlap_along(other, self) > margin


def _overlap_along(a: Block, b: Block) -> float:
    """The smaller overlap [m] of both footprints along the axes of `a`; negative where there is none."""
    x, y = a.spot.within(b.spot.x, b.spot.y)
    cos, sin = abs(math.cos(b.spot.yaw - a.spot.yaw)), abs(math.sin(b.spot.yaw - a.spot.yaw))
    reach_x, reach_y = b.half_x * cos + b.half_y * sin, b.half_x * sin + b.half_y * cos
    return min(a.half_x + reach_x - abs(x), a.half_y + reach_y - abs(y))


def block_of(name: str, pose: Pose, size_m: Vector) -> Block:
    """The upright block that an object with this pose in the base and this size [m] along its own axes fills."""
    axes = [rotated(pose.quaternion_xyzw, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    up = max(range(3), key=lambda axis: abs(axes[axis][2]))
    along, across = (axis for axis in range(3) if axis != up)
    x, y, z = pose.position
    spot = Spot(x, y, z, math.atan2(axes[along][1], axes[along][0]))
    half_z = size_m[up] / 2
    return Block(name, spot, size_m[along] / 2, size_m[across] / 2, z - half_z, z + half_z)
