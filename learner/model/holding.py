"""What a gripper holds: the one rule of CONTRACT, section 3 (InGripper), for cells, recordings and simulations.

A gripper that closes takes the object whose body was nearest to the end-effector then, within NEAR_M, and holds it as
long as the object is seen to move with it. A body is the object's size in the scene; an object without one is its
origin. In a body within which another object's origin lies there is room: it is its walls and floor.

Positions [m] and quaternions xyzw are in the base frame unless a name says otherwise. In plain floats: every tick does
this for every object.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from learner.model.pose import Quaternion, Vector, rotated

NEAR_M: Final = 0.05
"""What the gripper closed on is the object whose body is nearest to the end-effector within this distance [m]."""
SLIP_M: Final = 0.03
"""An object seen further than this from where the gripper carries it has not moved with it [m]: beyond the few
millimetres of a camera's noise and the slip of a grasp, below the size of what is grasped."""
SLIP_NS: Final = 200_000_000
"""... if it stays there this long [ns]: one jump of a marker does not open a gripper."""

Sighting = tuple[Vector, Quaternion]
"""The position and the orientation in which something is seen."""
Sizes = Mapping[str, Vector]
"""The size of each object that has one, along its own axes; its origin is in the middle."""


@dataclass
class Grasp:
    """What a gripper closed on: `origin` is the object's, in the end-effector's frame when it closed.

    `reach_m` is how far the body was away, `lost` whether the object is seen elsewhere than the gripper carries it.
    """

    object: str
    origin: Vector
    reach_m: float
    away_since_ns: int | None = None
    lost: bool = False

    @property
    def nearness(self) -> tuple[float, float, str]:
        """What grasps are compared by: of bodies equally near, the one with the nearer origin."""
        return self.reach_m, math.hypot(*self.origin), self.object

    def slip_m(self, end_effector: Sighting, position: Vector) -> float:
        """How far the object's origin is seen from where the gripper carries it."""
        return math.dist(inside(end_effector, position), self.origin)

    def follow(self, stamp_ns: int, end_effector: Sighting, position: Vector) -> None:
        """Judge by one sighting of the object's origin, and of the end-effector at the same moment.

        Lost once it has been away for SLIP_NS; found again where it is seen moving with the gripper.
        """
        if self.slip_m(end_effector, position) <= SLIP_M:
            self.away_since_ns, self.lost = None, False
        elif self.away_since_ns is None:
            self.away_since_ns = stamp_ns
        else:
            self.lost = stamp_ns - self.away_since_ns >= SLIP_NS


def grasped(end_effector: Sighting, objects: Mapping[str, Sighting], sizes: Sizes) -> Grasp | None:
    """What a gripper holds that closes here; None if no body is within NEAR_M."""
    nearest = next(iter(reaches(end_effector, objects, sizes)), None)
    return nearest if nearest is not None and nearest.reach_m <= NEAR_M else None


def reaches(end_effector: Sighting, objects: Mapping[str, Sighting], sizes: Sizes) -> list[Grasp]:
    """Every object as the gripper would hold it that closes here, the nearest body first, however far."""
    hollow = _hollow(objects, sizes)
    grasps = (_grasp(end_effector, name, objects[name], sizes.get(name), name in hollow) for name in objects)
    return sorted(grasps, key=lambda grasp: grasp.nearness)


def _grasp(end_effector: Sighting, name: str, seen: Sighting, size_m: Vector | None, hollow: bool) -> Grasp:
    point, origin = inside(seen, end_effector[0]), inside(end_effector, seen[0])
    if size_m is None:
        return Grasp(name, origin, math.hypot(*point))
    return Grasp(name, origin, _to_walls_m(point, seen[1], size_m) if hollow else _to_box_m(point, size_m))


def _hollow(objects: Mapping[str, Sighting], sizes: Sizes) -> set[str]:
    """The objects within whose size another's origin lies."""

    def holds_another(name: str) -> bool:
        return any(_to_box_m(point, sizes[name]) == 0.0 for point in _others_in(name, objects))

    return {name for name in objects if name in sizes and holds_another(name)}


def _others_in(name: str, objects: Mapping[str, Sighting]) -> Iterator[Vector]:
    return (inside(objects[name], position) for other, (position, _) in objects.items() if other != name)


def _to_box_m(point: Vector, size_m: Vector) -> float:
    """From a point of a box's frame to the box; 0 within it."""
    x, y, z = (max(0.0, abs(value) - size / 2) for value, size in zip(point, size_m, strict=True))
    return math.hypot(x, y, z)


def _to_walls_m(point: Vector, quaternion_xyzw: Quaternion, size_m: Vector) -> float:
    """From a point of a box's frame to the box without its lid: the face that is turned up."""
    outside_m = _to_box_m(point, size_m)
    ups = [rotated(quaternion_xyzw, axis)[2] for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    up = max(range(3), key=lambda axis: abs(ups[axis]))
    beside = [size_m[axis] / 2 - abs(point[axis]) for axis in range(3) if axis != up]
    if min(beside) < 0:
        return outside_m
    height = math.copysign(1.0, ups[up]) * point[up]
    above_floor_m, above_rim_m = height + size_m[up] / 2, height - size_m[up] / 2
    return min(abs(above_floor_m), math.hypot(min(beside), max(0.0, above_rim_m)))


def inside(frame: Sighting, point: Vector) -> Vector:
    """A point of the base in the coordinates of a frame."""
    (a, b, c), (x, y, z, w) = frame
    return rotated((-x, -y, -z, w), (point[0] - a, point[1] - b, point[2] - c))
