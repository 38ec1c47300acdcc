"""Reference frames that are more than an object or the base (CONTRACT, section 3, vocabulary 2).

`A+B` has its origin midway between two objects, x from A's origin to B's along the horizontal, z up; `A@axes` has A's
origin and the base's axes; `A@start` is A as it stood when the run (or the demonstration) began. No name of an object
holds a `+` or an `@`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from learner.errors import ModelError, NameRefusedError
from learner.model.names import check_name
from learner.model.pose import Array, Pose
from learner.model.poses import Poses

BETWEEN: Final = "+"
AXES: Final = "@axes"
START: Final = "@start"


def between(one: str, other: str) -> str:
    """The frame midway between two objects, x pointing from the first to the second."""
    return f"{one}{BETWEEN}{other}"


def on_axes(name: str) -> str:
    """The frame at an object's origin with the base's axes."""
    return f"{name}{AXES}"


def at_start(name: str) -> str:
    """The frame of an object as it stood at the beginning."""
    return f"{name}{START}"


def objects_of(frame: str) -> tuple[str, ...]:
    """The objects by which a frame goes: itself, where it is an object."""
    return tuple(frame.removesuffix(AXES).removesuffix(START).split(BETWEEN))


def check_frame(frame: str) -> str:
    """Return a frame of a tree if all that it goes by has names that the contract admits.

    Raises NameRefusedError otherwise.
    """
    parts = objects_of(frame)
    if len(parts) > 2 or (len(parts) == 2 and len(set(parts)) == 1):
        raise NameRefusedError("frame", frame, "a frame goes by one object, or by two that differ")
    for name in parts:
        check_name("frame", name)
    return frame


def is_composed(frame: str) -> bool:
    """Whether a frame is more than an object or the base."""
    return BETWEEN in frame or frame.endswith((AXES, START))


def pose_of(frame: str, pose_of_object: Callable[[str], Pose]) -> Pose:
    """The pose in the base of a frame, by the poses of the objects that it goes by, as they are now.

    Raises ModelError for a frame that goes by how things stood at the beginning: nothing here knows that.
    """
    if frame.endswith(START):
        raise ModelError(f"the frame {frame} goes by how things stood at the beginning, which is not known here")
    if BETWEEN in frame:
        (x0, y0, z0), (x1, y1, z1) = (pose_of_object(name).position for name in objects_of(frame))
        half = math.atan2(y1 - y0, x1 - x0) / 2
        return Pose(((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), (0.0, 0.0, math.sin(half), math.cos(half)))
    (name,) = objects_of(frame)
    return Pose(pose_of_object(name).position) if frame.endswith(AXES) else pose_of_object(name)


def midway(ones: Poses, others: Poses) -> Poses:
    """The frames (n,) midway between objects at these poses in the base (n,)."""
    middle = (ones.positions + others.positions) / 2
    along = others.positions - ones.positions
    half = np.arctan2(along[:, 1], along[:, 0]) / 2
    return Poses(middle, _about_z(half))


def upright(poses: Poses) -> Poses:
    """The frames (n,) at the origins of these poses (n,), with the axes in which those are given."""
    return Poses(poses.positions, _about_z(np.zeros(len(poses)) * poses.positions[:, 0]))


def _about_z(half_rad: Array) -> Array:
    """Quaternions (n, 4) of turns about z, by their half angles [rad] (n,)."""
    zeros = np.zeros_like(half_rad) + 0 * half_rad
    return np.stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)], axis=1)
