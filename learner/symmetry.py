"""Turns of an object that look the same, and means of poses modulo those turns.

Only turns about the axis that stands upright are used: they keep an approach from above an approach from above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from learner.model import Pose
from learner.model.demonstration import Symmetry
from learner.model.pose import Array, angle_between, conjugate, mean_quaternion, multiply, rotate

QUARTERS = {"none": 1, "box": 2, "cube": 4}
"""How many turns about an upright axis leave a shape as it is; `vertical` admits any turn about its z axis."""


def upright_axis(poses_in_base: Sequence[Pose]) -> Array:
    """The object's own axis (3,), one of ±x, ±y, ±z, that points up in the base on average."""
    quaternions = np.array([pose.quaternion_xyzw for pose in poses_in_base])
    up = rotate(conjugate(quaternions), np.array([0.0, 0.0, 1.0])).mean(axis=0)
    axis = np.zeros(3)
    strongest = int(np.argmax(np.abs(up)))
    axis[strongest] = math.copysign(1.0, up[strongest])
    return axis


def about(axis: Array, angle_rad: float) -> Array:
    """The quaternion xyzw (4,) of a turn about a unit axis (3,)."""
    return np.append(axis * math.sin(angle_rad / 2), math.cos(angle_rad / 2))


def turns(symmetry: Symmetry, axis: Array) -> list[Array]:
    """The turns about `axis` that look the same; for `vertical` only the identity, see `aligned`."""
    count = QUARTERS.get(symmetry, 1)
    return [about(axis, 2 * math.pi * k / count) for k in range(count)]


def twist_to(axis: Array, from_xyzw: Array, to_xyzw: Array) -> Array:
    """The turn q about `axis` for which q * from is nearest to `to` (4,)."""
    relative = multiply(to_xyzw, conjugate(from_xyzw))
    twist = np.append(axis * float(relative[:3] @ axis), relative[3])
    norm = np.linalg.norm(twist)
    return np.asarray(twist / norm) if norm > 1e-9 else np.array([0.0, 0.0, 0.0, 1.0])


def aligned(pose: Pose, reference: Pose, symmetry: Symmetry, axis: Array) -> Pose:
    """A pose in an object's frame, turned by the object's symmetry to be nearest to a reference orientation."""
    quaternion, wanted = np.array(pose.quaternion_xyzw), np.array(reference.quaternion_xyzw)
    candidates = [twist_to(axis, quaternion, wanted)] if symmetry == "vertical" else turns(symmetry, axis)
    turn = min(candidates, key=lambda q: float(angle_between(multiply(q, quaternion), wanted)))
    return Pose((0.0, 0.0, 0.0), tuple(turn.tolist())) @ pose


def mean_in_object(poses: Sequence[Pose], symmetry: Symmetry, axis: Array, aligned_rad: float) -> Pose:
    """The mean of poses given in an object's frame (grasps), modulo the object's symmetry.

    The reference is the pose that most others agree with; those that do not, at any turn, are left out.
    """
    families = [[aligned(pose, reference, symmetry, axis) for pose in poses] for reference in poses]
    return _mean_of_largest(families, list(poses), aligned_rad)


def mean_of_object(poses: Sequence[Pose], symmetry: Symmetry, axis: Array, aligned_rad: float) -> Pose:
    """The mean of an object's poses in some frame (rests), modulo the turns of the object about its own `axis`."""
    families = [
        [aligned(pose.inverse(), reference.inverse(), symmetry, axis).inverse() for pose in poses]
        for reference in poses
    ]
    mean = _mean_of_largest(families, list(poses), aligned_rad)
    position = robust_mean(np.array([pose.position for pose in poses]))
    return Pose.of(position, mean.quaternion_xyzw)


def _mean_of_largest(families: Sequence[Sequence[Pose]], references: Sequence[Pose], aligned_rad: float) -> Pose:
    best: list[Pose] = []
    for family, reference in zip(families, references, strict=True):
        wanted = np.array(reference.quaternion_xyzw)
        agreeing = [p for p in family if angle_between(np.array(p.quaternion_xyzw), wanted) < aligned_rad]
        if len(agreeing) > len(best):
            best = agreeing
    position = robust_mean(np.array([pose.position for pose in best]))
    return Pose.of(position, mean_quaternion(np.array([pose.quaternion_xyzw for pose in best])))


def robust_mean(points: Array, floor_m: float = 0.005) -> Array:
    """The mean (3,) of `points` (n, 3) without those that lie far from the median: beyond three median distances."""
    median = np.median(points, axis=0)
    distances = np.linalg.norm(points - median, axis=1)
    near = distances <= max(3 * float(np.median(distances)), floor_m)
    return np.asarray(points[near].mean(axis=0))
