"""How the hand travels: paths of `tool0`, followed in joint space at limited speed, one physics step at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from learner.model import Pose
from learner.model.pose import Array, conjugate, multiply
from learner.simulation.cell.arm_kinematics import VELOCITY_LIMIT_RAD_PER_S
from learner.simulation.cell.engine import PERIOD_S
from learner.simulation.failure import Failure

if TYPE_CHECKING:
    from learner.simulation.cell.physics import World

KNOT_STEPS: Final = 8
"""Between two knots of inverse kinematics the joints run straight."""
GLIDE_KNOTS: Final = 6
"""Where the arm glides it goes so many knots at once: what World counts for a glide."""
TURN_RAD_PER_S: Final = 2.0
SETTLE_RAD: Final = 5e-4
SETTLE_STEPS: Final = 60

Travel = Generator[None, None, Failure | None]
"""Resumed once before each physics step; returns why it stopped early, None on arrival."""
Watch = Callable[[float], Failure | None]
"""Told the distance [m] left to the path's end, answers with a failure to stop by or None."""


class Path(Protocol):
    """A curve of poses of `tool0`, from 0 to 1, with its length [m] and how far it turns [rad]."""

    @property
    def length_m(self) -> float: ...

    @property
    def turn_rad(self) -> float: ...

    def at(self, fraction: float) -> Pose: ...


@dataclass(frozen=True)
class Straight:
    """A straight line."""

    start: Pose
    end: Pose

    @property
    def length_m(self) -> float:
        return math.dist(self.start.position, self.end.position)

    @property
    def turn_rad(self) -> float:
        return float(np.linalg.norm(_rotation_vector(self.start, self.end)))

    def at(self, fraction: float) -> Pose:
        a, b = np.array(self.start.position), np.array(self.end.position)
        return Pose.of(a + fraction * (b - a), _turned(self.start, self.end, fraction))


@dataclass(frozen=True)
class Around:
    """An arc about the base's axis, distance and height changing evenly, so that the arm never crosses its base.

    The hand turns evenly, the short way.
    """

    start: Pose
    end: Pose

    @property
    def length_m(self) -> float:
        (r0, a0, z0), (r1, a1, z1) = _cylindrical(self.start), _cylindrical(self.end)
        return math.hypot(max(r0, r1) * (a1 - a0), r1 - r0, z1 - z0)

    @property
    def turn_rad(self) -> float:
        return float(np.linalg.norm(_rotation_vector(self.start, self.end)))

    def at(self, fraction: float) -> Pose:
        start, end = np.array(_cylindrical(self.start)), np.array(_cylindrical(self.end))
        distance, angle, height = start + fraction * (end - start)
        position = (distance * math.cos(angle), distance * math.sin(angle), height)
        return Pose.of(position, _turned(self.start, self.end, fraction))


def travel(world: World, path: Path, speed_m_per_s: float, watch: Watch) -> Travel:
    """Follow a path, slowly at its ends, no faster than the joints can; stop where `watch` finds a failure."""
    duration_s = 1.5 * max(path.length_m / speed_m_per_s, path.turn_rad / TURN_RAD_PER_S)
    knots = max(1, math.ceil(duration_s / (KNOT_STEPS * PERIOD_S)))
    knot = 0
    while knot < knots:
        ahead = min(knot + GLIDE_KNOTS, knots)
        glides = world.gliding.wanted and world.gliding.allows(world.arm.tool_pose, path.at(_smooth(ahead / knots)))
        knot = ahead if glides else knot + 1
        fraction = _smooth(knot / knots)
        joints = world.arm.solve(path.at(fraction))
        if joints is None:
            world.arm.hold()
            return Failure("out of reach")
        for move in _glide(world, joints) if glides else _drive(world, joints):
            move()
            yield
            failure = watch((1.0 - fraction) * path.length_m)
            if failure is not None:
                world.arm.hold()
                return failure
    yield from _settle(world)
    return None


def _drive(world: World, joints: Array) -> Iterator[Callable[[], None]]:
    """To joint angles by the motors: a move for each physics step."""
    return (functools.partial(world.arm.command, angles) for angles in _between(world.arm.commanded_rad, joints))


def _glide(world: World, joints: Array) -> Iterator[Callable[[], None]]:
    """To joint angles at once."""
    yield functools.partial(world.gliding.go, joints)


def wait(duration_s: float) -> Generator[None, None, None]:
    """Let time pass."""
    for _ in range(round(duration_s / PERIOD_S)):
        yield


def _settle(world: World) -> Generator[None, None, None]:
    """Wait until the joints have caught up with what they were told."""
    for _ in range(SETTLE_STEPS):
        if np.max(np.abs(world.arm.joints_rad - world.arm.commanded_rad)) < SETTLE_RAD:
            return
        yield


def _between(start: Array, end: Array) -> Iterator[Array]:
    steps = max(KNOT_STEPS, math.ceil(float(np.max(np.abs(end - start) / VELOCITY_LIMIT_RAD_PER_S)) / PERIOD_S))
    for step in range(1, steps + 1):
        yield start + (end - start) * (step / steps)


def _smooth(fraction: float) -> float:
    return fraction * fraction * (3.0 - 2.0 * fraction)


def _cylindrical(pose: Pose) -> tuple[float, float, float]:
    x, y, z = pose.position
    return math.hypot(x, y), math.atan2(y, x), z


def _rotation_vector(start: Pose, end: Pose) -> Array:
    """The shortest turn (3,) [rad] in the base from one orientation to another."""
    turn = multiply(np.array(end.quaternion_xyzw), conjugate(np.array(start.quaternion_xyzw)))
    turn = turn * math.copysign(1.0, turn[3])
    sine = float(np.linalg.norm(turn[:3]))
    return np.asarray(turn[:3] * (2.0 * math.atan2(sine, turn[3]) / sine if sine > 1e-9 else 2.0))


def _turned(start: Pose, end: Pose, fraction: float) -> Array:
    vector = fraction * _rotation_vector(start, end)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-9 else vector
    turn = np.array([*(axis * math.sin(angle / 2)), math.cos(angle / 2)])
    return multiply(turn, np.array(start.quaternion_xyzw))
