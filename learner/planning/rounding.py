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
    """A quaternion xyzw, rounded, of the two signs the one whose last number that is not zero is positive."""
    x, y, z, w = (rounded(value) for value in values)
    if next((value for value in (w, z, y, x) if value), 1.0) < 0:
        return (-x + 0.0, -y + 0.0, -z + 0.0, -w + 0.0)
    return (x, y, z, w)


def rounded_pose(pose: Pose) -> Pose:
    """A pose whose numbers are rounded; its quaternion is a unit one within the rounding."""
    rounded_one = Pose(rounded_vector(pose.position), pose.quaternion_xyzw)
    object.__setattr__(rounded_one, "quaternion_xyzw", rounded_quaternion(pose.quaternion_xyzw))
    return rounded_one
