"""Turns of an object that look the same, and means of poses modulo those turns.

Only turns about the axis that stands upright are used: they keep an approach from above an approach from above.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from learner.model import Pose
from learner.model.pose import Array, angle_between, conjugate, mean_quaternion, multiply, rotate
from learner.model.poses import Poses
from learner.model.scene import Symmetry
from learner.planning.parameters import MeanParameters

AT_ONCE = 1_000_000
"""So many numbers are worked on at once."""
QUARTERS = {"none": 1, "box": 2, "cube": 4}
"""How many turns about an upright axis leave a shape as it is; `vertical` admits any turn about its z axis."""


def upright_axis(poses_in_base: Poses) -> Array:
    """The object's own axis (3,), one of ±x, ±y, ±z, that points up in the base on average."""
    up = rotate(conjugate(poses_in_base.quaternions_xyzw), np.array([0.0, 0.0, 1.0])).mean(axis=0)
    axis = np.zeros(3)
    strongest = int(np.argmax(np.abs(up)))
    axis[strongest] = math.copysign(1.0, up[strongest])
    return axis


def turns(symmetry: Symmetry, axis: Array) -> Array:
    """The quaternions (k, 4) of the turns about `axis` that look the same; for `vertical` see `nearest_turns`."""
    angles = 2 * math.pi * np.arange(QUARTERS.get(symmetry, 1)) / QUARTERS.get(symmetry, 1)
    return np.concatenate([axis * np.sin(angles / 2)[:, None], np.cos(angles / 2)[:, None]], axis=1)


def nearest_turns(relative: Array, symmetry: Symmetry, axis: Array) -> Array:
    """Of the turns about `axis` that look the same, those nearest to rotations `relative` (..., 4); same shape."""
    if symmetry == "vertical":
        along = np.sum(relative[..., :3] * axis, axis=-1, keepdims=True)
        twist = np.concatenate([axis * along, relative[..., 3:]], axis=-1)
        norm = np.linalg.norm(twist, axis=-1, keepdims=True)
        return np.where(norm > 1e-9, twist / np.maximum(norm, 1e-9), np.array([0.0, 0.0, 0.0, 1.0]))
    candidates = turns(symmetry, axis)
    return np.asarray(candidates[np.argmax(np.abs(relative @ candidates.T), axis=-1)])


def mean_in_object(poses: Poses, symmetry: Symmetry, axis: Array, parameters: MeanParameters) -> Pose:
    """The mean of poses given in an object's frame (grasps), modulo the object's symmetry.

    The others are turned to the pose that most of them agree with; those that do not, at any turn, are left out. Of an
    object that may have no symmetry, grasps a quarter turn from it still tell where it is grasped.
    """
    quaternions = poses.quaternions_xyzw

    def turned(quaternions: Array, reference: Array) -> tuple[Array, Array]:
        turn = nearest_turns(multiply(reference, conjugate(quaternions)), symmetry, axis)
        return turn, multiply(turn, quaternions)

    turn, aligned, agreeing = _most_agreeing(quaternions, turned, parameters)
    mean = mean_quaternion(aligned[agreeing])
    if symmetry == "none":
        quarter = nearest_turns(multiply(mean, conjugate(quaternions)), "cube", axis)
        agreeing = angle_between(multiply(quarter, quaternions), mean) < parameters.aligned_rad
    positions = rotate(turn, poses.positions)
    return Pose.of(robust_mean(positions[agreeing], parameters), mean)


def agreeing_in_object(
    poses: Poses, orientation: Array, symmetry: Symmetry, axis: Array, parameters: MeanParameters
) -> Poses:
    """Those of `poses` in an object's frame that some turn that looks the same brings near `orientation` (4,)."""
    quaternions = poses.quaternions_xyzw
    turn = nearest_turns(multiply(orientation, conjugate(quaternions)), symmetry, axis)
    near = angle_between(multiply(turn, quaternions), orientation) < parameters.aligned_rad
    return poses[near]


def aligned_in_frame(poses: Poses, symmetry: Symmetry, axis: Array, parameters: MeanParameters) -> tuple[Array, Array]:
    """The orientations (n, 4) of an object in some frame, each turned about its own `axis` as looks the same to where
    most agree, and the mean (4,) of those that do.
    """
    quaternions = poses.quaternions_xyzw

    def turned(quaternions: Array, reference: Array) -> tuple[Array, Array]:
        turn = nearest_turns(multiply(conjugate(quaternions), reference), symmetry, axis)
        return turn, multiply(quaternions, turn)

    _, aligned, agreeing = _most_agreeing(quaternions, turned, parameters)
    return aligned, mean_quaternion(aligned[agreeing])


def mean_of_object(poses: Poses, symmetry: Symmetry, axis: Array, parameters: MeanParameters) -> Pose:
    """The mean of an object's poses in some frame (rests), modulo the turns of the object about its own `axis`."""
    _, orientation = aligned_in_frame(poses, symmetry, axis, parameters)
    return Pose.of(robust_mean(poses.positions, parameters), orientation)


def _most_agreeing(
    quaternions: Array, turned: Callable[[Array, Array], tuple[Array, Array]], parameters: MeanParameters
) -> tuple[Array, Array, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """The turns (n, 4) to the best reference, the orientations so turned (n, 4), and which agree with it (n,).

    The best reference is the one about which the orientations lie densest.
    """
    references = quaternions[:: max(1, len(quaternions) // parameters.references)]
    compared = quaternions[:: max(1, len(quaternions) // parameters.compared)]
    densest, best = -1.0, references[0]
    for some in np.array_split(references, math.ceil(references.size * len(compared) / AT_ONCE)):
        angles = _angles(turned(compared, some[:, None])[1], some[:, None])
        for reference, density in zip(
            some, np.exp(-((2 * angles / parameters.aligned_rad) ** 2)).sum(axis=1), strict=True
        ):
            if density > densest + 1e-9:
                densest, best = density, reference
    turn, aligned = turned(quaternions, best)
    return turn, aligned, _angles(aligned, best) < parameters.aligned_rad


def _angles(a_xyzw: Array, b_xyzw: Array) -> Array:
    """Angles [rad] between orientations (..., 4)."""
    return np.asarray(2 * np.arccos(np.clip(np.abs((a_xyzw * b_xyzw).sum(axis=-1)), 0.0, 1.0)))


def robust_mean(points: Array, parameters: MeanParameters) -> Array:
    """The mean (3,) of `points` (n, 3) without those that lie far from the median, as `parameters` say."""
    median = np.median(points, axis=0)
    distances = np.linalg.norm(points - median, axis=1)
    near = distances <= max(parameters.outlying * float(np.median(distances)), parameters.outlying_m)
    return np.asarray(points[near].mean(axis=0))
