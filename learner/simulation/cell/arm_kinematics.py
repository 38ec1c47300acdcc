"""Kinematics of a Franka Panda whose end-effector frame `tool0` is the point between its fingertips.

Axes of `tool0`: z along the approach (down, when the hand points down), y along the way of the fingers, x across it.
At yaw 0 with the hand pointing down its x is the base's x and its quaternion_xyzw is (1, 0, 0, 0). Lengths [m] are
those of the Panda's data sheet, but for longer fingers. The wrist (joint 7) turns without a stop, as a continuous
wrist does, so that every yaw is within reach everywhere.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from learner.model.pose import Array, Pose, rotate

SHOULDER_M: Final = 0.333
UPPER_ARM_M: Final = 0.316
FOREARM_M: Final = 0.384
ELBOW_M: Final = 0.0825
WRIST_M: Final = 0.088
FINGERS_LONGER_M: Final = 0.02
"""Than the maker's: so the hand clears the walls of a box of 8 cm when it grasps a cube inside."""
HAND_M: Final = 0.107 + 0.105 + FINGERS_LONGER_M
"""From the flange's joint to the point between the fingertips."""

JOINTS: Final = 7
VELOCITY_LIMIT_RAD_PER_S: Final = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
POSITION_LIMIT_RAD: Final = np.array(
    [(-2.96, 2.96), (-1.83, 1.83), (-2.96, 2.96), (-3.14, -0.07), (-2.96, 2.96), (-0.08, 3.82), (-np.inf, np.inf)]
)

REACH_M: Final = (0.28, 0.75)
"""Horizontal distances from the base's axis within which a hand pointing down reaches every height up to 0.35 m."""
REACH_RAD: Final = 2.8
"""... to either side of straight ahead."""

# Each joint turns about the z axis of its frame: offset [m] and roll [rad] about x from the frame before.
_OFFSETS: Final = np.array(
    [
        (0, 0, SHOULDER_M),
        (0, 0, 0),
        (0, -UPPER_ARM_M, 0),
        (ELBOW_M, 0, 0),
        (-ELBOW_M, FOREARM_M, 0),
        (0, 0, 0),
        (WRIST_M, 0, 0),
    ]
)
_ROLLS: Final = np.array([0, -1, 1, 1, -1, 1, 1]) * (math.pi / 2)
_HAND_YAW: Final = -math.pi / 4


def _about_x(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


_ROLLED: Final = [_about_x(roll) for roll in _ROLLS]
_HAND: Final = _about_z(_HAND_YAW)


def forward(joints_rad: Array) -> Pose:
    """The pose of `tool0` in the base at joint angles (7,)."""
    position, rotation, _, _ = _chain(joints_rad)
    return Pose.of(position, _quaternion(rotation))


def inverse(target: Pose, tolerance_m: float = 1e-4, iterations: int = 12) -> Array | None:
    """Joint angles (7,) that bring `tool0` to `target` in the base; None where the arm cannot reach.

    Starts from the closed form for a hand pointing straight down, with the elbow above, and refines it by damped
    least squares, so that nearby targets have nearby answers and no history enters. Hands tilted by more than 45
    degrees count as out of reach: the elbow would leave its plane.
    """
    joints = _straight_down(target)
    if joints is None:
        return None
    goal_position, goal_rotation = np.array(target.position), _rotation(target)
    for _ in range(iterations):
        position, rotation, origins, axes = _chain(joints)
        error = np.concatenate([goal_position - position, _turn(goal_rotation @ rotation.T)])
        if np.linalg.norm(error) < tolerance_m:
            return joints if _within_limits(joints) else None
        jacobian = np.concatenate([_cross(axes, position - origins).T, axes.T])
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), error)
        joints = joints + np.clip(step, -0.3, 0.3)
    return None


def reaches(x: float, y: float) -> bool:
    """Whether a hand that points about straight down reaches a point of the table [m] at any yaw, and what is on it."""
    return REACH_M[0] <= math.hypot(x, y) <= REACH_M[1] and abs(math.atan2(y, x)) <= REACH_RAD


def tilt_rad(pose: Pose) -> float:
    """The angle [rad] between the approach of `tool0` and straight down."""
    downwards = -pose.apply((0.0, 0.0, 1.0))[2] + pose.position[2]
    return math.acos(max(-1.0, min(1.0, downwards)))


def pointing_down(x: float, y: float, z: float, yaw_rad: float) -> Pose:
    """The pose of `tool0` at a point [m] of the base with the hand straight down at a yaw about the vertical."""
    return Pose((x, y, z), (math.cos(yaw_rad / 2), math.sin(yaw_rad / 2), 0.0, 0.0))


def yaw_of(pose: Pose) -> float:
    """The yaw [rad] about the base's vertical of a hand that points about straight down."""
    ahead = np.subtract(pose.apply((1.0, 0.0, 0.0)), pose.position)
    return math.atan2(ahead[1], ahead[0])


def _straight_down(target: Pose) -> Array | None:
    """The closed form: the arm in one vertical plane through the base's axis, the hand straight down at its end."""
    if tilt_rad(target) > math.pi / 4:
        return None
    x, y, z = target.position
    turn, ahead, above = math.atan2(y, x), math.hypot(x, y) - WRIST_M, z + HAND_M - SHOULDER_M
    upper, fore = math.hypot(UPPER_ARM_M, ELBOW_M), math.hypot(FOREARM_M, ELBOW_M)
    distance = math.hypot(ahead, above)
    if not abs(upper - fore) < distance < upper + fore:
        return None
    direction = math.atan2(ahead, above)
    at_shoulder = math.acos((upper**2 + distance**2 - fore**2) / (2 * upper * distance))
    at_wrist = math.acos((fore**2 + distance**2 - upper**2) / (2 * fore * distance))
    shoulder = direction - at_shoulder - math.atan2(ELBOW_M, UPPER_ARM_M)
    lean = direction + at_wrist + math.atan2(ELBOW_M, FOREARM_M)
    wrist = turn - yaw_of(target) - _HAND_YAW
    return np.array([turn, shoulder, 0.0, shoulder - lean, 0.0, lean, wrist])


def _within_limits(joints_rad: Array) -> bool:
    return bool(np.all((joints_rad >= POSITION_LIMIT_RAD[:, 0]) & (joints_rad <= POSITION_LIMIT_RAD[:, 1])))


def _chain(joints_rad: Array) -> tuple[Array, Array, Array, Array]:
    """Position (3,) and rotation (3, 3) of `tool0`, and the origins (7, 3) and axes (7, 3) of the joints."""
    position, rotation = np.zeros(3), np.eye(3)
    origins, axes = np.empty((JOINTS, 3)), np.empty((JOINTS, 3))
    for index, angle in enumerate(joints_rad):
        position = position + rotation @ _OFFSETS[index]
        rotation = rotation @ _ROLLED[index] @ _about_z(angle)
        origins[index], axes[index] = position, rotation[:, 2]
    return position + rotation @ np.array([0.0, 0.0, HAND_M]), rotation @ _HAND, origins, axes


def _cross(a: Array, b: Array) -> Array:
    """The products of vectors (n, 3), several times faster on a few of them than numpy's general one."""
    return np.stack(
        [a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1], a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
         a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1,
    )  # fmt: skip


def _rotation(pose: Pose) -> Array:
    return rotate(np.array(pose.quaternion_xyzw), np.eye(3)).T


def _turn(rotation: Array) -> Array:
    """The rotation vector (3,) [rad] of a rotation (3, 3), to first order: exact where it vanishes."""
    m = rotation
    return 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def _quaternion(rotation: Array) -> Array:
    """The unit quaternion xyzw (4,) of a rotation matrix (3, 3): the largest of its four forms, for accuracy."""
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    forms = (
        (squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]),
        (m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]),
        (m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]),
        (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]),
    )
    chosen = np.array(forms[int(np.argmax(squares))])
    return np.asarray(chosen / np.linalg.norm(chosen))
