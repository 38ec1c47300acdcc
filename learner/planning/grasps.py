"""Grasps of objects that nobody picked, borrowed from those of objects that somebody did.

Only a scene tells enough for it: what lies in the way is of a known size, though its grasp was never demonstrated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from learner.model import ObjectShape, Pose
from learner.model.pose import Array, cross, multiply
from learner.planning.parameters import GraspParameters


@dataclass(frozen=True)
class Upright:
    """A shape and the direction (3,), in the object's own frame, that points up where it stands."""

    shape: ObjectShape
    up: Array

    @property
    def axis(self) -> int:
        """Which of its axes stands upright."""
        return int(np.argmax(np.abs(self.up)))

    @property
    def height_m(self) -> float:
        """Its size along that axis [m]."""
        return self.shape.size_m[self.axis]

    @property
    def sides_m(self) -> tuple[float, float]:
        """Its horizontal sizes [m], the narrower first."""
        a, b = sorted(size for axis, size in enumerate(self.shape.size_m) if axis != self.axis)
        return a, b

    def fits(self, stroke_m: float) -> bool:
        """Whether a gripper that opens so far spans it in one direction."""
        return 0.0 < self.sides_m[0] <= stroke_m

    def is_square(self, within_m: float) -> bool:
        """Whether a gripper may as well close across the other side."""
        return self.sides_m[1] - self.sides_m[0] < within_m

    def distance_m(self, other: Upright) -> float:
        """How much two shapes differ as they stand [m]."""
        return float(np.linalg.norm(np.subtract((*self.sides_m, self.height_m), (*other.sides_m, other.height_m))))


def borrowed_grasp(
    of: Upright, grasps: Mapping[str, Pose], known: Mapping[str, Upright], parameters: GraspParameters
) -> Pose | None:
    """The end-effector's pose in the frame of an object that was never picked; None where it is too wide.

    As the most similar object in `known` is grasped, whose grasp `grasps` holds: from the same side, at the same share
    of the height, over the middle. One of exactly the same shape is grasped exactly alike.
    """
    models = sorted(set(grasps) & set(known), key=lambda name: (of.distance_m(known[name]), name))
    if not models:
        return None
    model, grasp = known[models[0]], grasps[models[0]]
    if model.shape == of.shape and float(model.up @ of.up) > parameters.parallel:
        return grasp
    if not of.fits(parameters.stroke_m):
        return None
    share = float(np.array(grasp.position) @ model.up) / max(model.height_m, 1e-9)
    turn = _turn(model.up, of.up, parameters.parallel)
    return Pose.of(of.up * share * of.height_m, multiply(turn, np.array(grasp.quaternion_xyzw)))


def quarter_turned(grasp: Pose, up: Array) -> Pose:
    """The grasp turned by a quarter about the upright axis (3,) of the object: the same one, where that is square."""
    quarter = Pose.of((0.0, 0.0, 0.0), np.append(np.sin(np.pi / 4) * up, np.cos(np.pi / 4)))
    return quarter @ grasp


def _turn(a: Array, b: Array, parallel: float) -> Array:
    """The least rotation (4,) that brings direction a to direction b; about x, or y, where they are opposite."""
    cosine = float(a @ b)
    if cosine < -parallel:
        return np.array([0.0, 1.0, 0.0, 0.0]) if abs(a[0]) > 0.5 else np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.append(cross(a, b), 1.0 + cosine)
    return np.asarray(quaternion / np.linalg.norm(quaternion))
