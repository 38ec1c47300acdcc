"""Numbers as trees carry them: rounded to micrometres, so that equal input gives equal bytes on every machine."""

from __future__ import annotations

from collections.abc import Iterable

from learner.model import Pose
from learner.model.pose import Quaternion, Vector

DIGITS = 6


def rounded(value: float) -> float:
    """The number to micrometres; a zero has no sign."""
    return round(float(value), DIGITS) + 0.0


def rounded_vector(values: Iterable[float]) -> Vector:
    """Three numbers, rounded."""
    x, y, z = (rounded(value) for value in values)
    return (x, y, z)


def rounded_quaternion(values: Iterable[float]) -> Quaternion:
    """A quaternion xyzw, rounded, with w >= 0."""
    x, y, z, w = (float(value) for value in values)
    sign = -1.0 if w < 0 else 1.0
    return (rounded(sign * x), rounded(sign * y), rounded(sign * z), rounded(sign * w))


def rounded_pose(pose: Pose) -> Pose:
    """A pose whose numbers are rounded; its quaternion is a unit one within the rounding."""
    rounded_one = Pose(rounded_vector(pose.position), pose.quaternion_xyzw)
    object.__setattr__(rounded_one, "quaternion_xyzw", rounded_quaternion(pose.quaternion_xyzw))
    return rounded_one
