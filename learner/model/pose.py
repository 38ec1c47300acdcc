"""Poses: rigid transforms [m], quaternions xyzw, and the same algebra on arrays.

The array functions broadcast over leading dimensions: positions are (..., 3), quaternions (..., 4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learner.errors import ModelError

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Array = NDArray[np.float64]

IDENTITY_XYZW: Quaternion = (0.0, 0.0, 0.0, 1.0)


def cross(a: Array, b: Array) -> Array:
    """The cross product (..., 3); numpy's own takes three times as long for the few vectors that poses have."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def multiply(a_xyzw: Array, b_xyzw: Array) -> Array:
    """Hamilton product (..., 4): the rotation b, then a."""
    av, aw = a_xyzw[..., :3], a_xyzw[..., 3:]
    bv, bw = b_xyzw[..., :3], b_xyzw[..., 3:]
    vector = aw * bv + bw * av + cross(av, bv)
    scalar = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def conjugate(quaternion_xyzw: Array) -> Array:
    """The inverse rotation (..., 4) of unit quaternions."""
    return np.asarray(quaternion_xyzw * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotate(quaternion_xyzw: Array, points: Array) -> Array:
    """`points` (..., 3) turned by unit quaternions (..., 4)."""
    axis, scalar = quaternion_xyzw[..., :3], quaternion_xyzw[..., 3:]
    twice = 2.0 * cross(axis, points)
    return np.asarray(points + scalar * twice + cross(axis, twice))


def express(points: Array, frame_positions: Array, frame_quaternions_xyzw: Array) -> Array:
    """`points` (..., 3) of the base in frames given by their poses in the base."""
    return rotate(conjugate(frame_quaternions_xyzw), points - frame_positions)


def angle_between(a_xyzw: Array, b_xyzw: Array) -> Array:
    """Angle [rad] in [0, pi] of the rotation between unit quaternions (..., 4); q and -q are one rotation."""
    relative = multiply(conjugate(a_xyzw), b_xyzw)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(relative[..., :3], axis=-1), np.abs(relative[..., 3])))


def mean_quaternion(quaternions_xyzw: Array) -> Array:
    """Mean (4,) on the rotation group of quaternions (n, 4), signs ignored.

    The eigenvector of the largest eigenvalue of the sum of outer products (Markley et al. 2007, equation 12),
    with w >= 0.
    """
    outer = np.einsum("ni,nj->ij", quaternions_xyzw, quaternions_xyzw)
    mean = np.linalg.eigh(outer)[1][:, -1]
    return np.asarray(-mean if mean[3] < 0 else mean)


@dataclass(frozen=True)
class Pose:
    """A pose of a frame in another: `position` [m] and a unit `quaternion_xyzw`.

    The quaternion is normalised at construction; ModelError if it has no direction or a number is not finite.
    """

    position: Vector
    quaternion_xyzw: Quaternion = IDENTITY_XYZW

    def __post_init__(self) -> None:
        position = _finite(self.position, 3, "position")
        x, y, z, w = quaternion = _finite(self.quaternion_xyzw, 4, "quaternion")
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if norm < 1e-6:
            raise ModelError(f"the quaternion {quaternion} has no direction")
        if abs(norm - 1.0) > 1e-12:
            quaternion = (x / norm, y / norm, z / norm, w / norm)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "quaternion_xyzw", quaternion)

    def __matmul__(self, other: Pose) -> Pose:
        """`pose_a_in_base @ pose_b_in_a` is `pose_b_in_base`."""
        return Pose(self._applied(other.position), _product(self.quaternion_xyzw, other.quaternion_xyzw))

    def inverse(self) -> Pose:
        """`pose_a_in_base.inverse()` is `pose_base_in_a`."""
        x, y, z, w = self.quaternion_xyzw
        back = (-x, -y, -z, w)
        a, b, c = rotated(back, self.position)
        return Pose((-a, -b, -c), back)

    def apply(self, point: Sequence[float] | Array) -> Vector:
        """A point (3,) of this frame, in the frame in which this pose is given."""
        x, y, z = point
        return self._applied((float(x), float(y), float(z)))

    def _applied(self, point: Vector) -> Vector:
        (x, y, z), (a, b, c) = self.position, rotated(self.quaternion_xyzw, point)
        return (x + a, y + b, z + c)

    @staticmethod
    def of(position: Sequence[float] | Array, quaternion_xyzw: Sequence[float] | Array) -> Pose:
        """A pose from any sequences of three and four numbers."""
        return Pose(tuple(float(v) for v in position), tuple(float(v) for v in quaternion_xyzw))  # type: ignore[arg-type]  # lengths are checked at construction

    @staticmethod
    def unchecked(position: Vector, quaternion_xyzw: Quaternion) -> Pose:
        """A pose of finite numbers and a unit quaternion that were checked with many others."""
        pose = object.__new__(Pose)
        pose.__dict__.update(position=position, quaternion_xyzw=quaternion_xyzw)
        return pose


def rotated(quaternion_xyzw: Quaternion, point: Vector) -> Vector:
    """As `rotate`, for one point: an array of three numbers costs more than all that is done with them."""
    x, y, z, w = quaternion_xyzw
    px, py, pz = point
    tx, ty, tz = 2.0 * (y * pz - z * py), 2.0 * (z * px - x * pz), 2.0 * (x * py - y * px)
    return (
        px + w * tx + (y * tz - z * ty),
        py + w * ty + (z * tx - x * tz),
        pz + w * tz + (x * ty - y * tx),
    )


def _product(a_xyzw: Quaternion, b_xyzw: Quaternion) -> Quaternion:
    """As `multiply`, for one pair."""
    ax, ay, az, aw = a_xyzw
    bx, by, bz, bw = b_xyzw
    return (
        aw * bx + bw * ax + (ay * bz - az * by),
        aw * by + bw * ay + (az * bx - ax * bz),
        aw * bz + bw * az + (ax * by - ay * bx),
        aw * bw - (ax * bx + ay * by + az * bz),
    )


def _finite(values: Sequence[float], length: int, what: str) -> tuple[float, ...]:
    numbers = tuple(map(float, values))
    if len(numbers) != length or not all(map(math.isfinite, numbers)):
        raise ModelError(f"a {what} is {length} finite numbers, not {tuple(values)}")
    return numbers
