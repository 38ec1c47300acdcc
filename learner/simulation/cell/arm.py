"""The Franka Panda of pybullet_data in a physics world: joint motors, fingers, and what it touches.

Its hand is made for cubes that stand close together and in boxes: slimmer than the maker's, with longer fingers.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pybullet_data

from learner.model.pose import Array, Pose
from learner.simulation.cell.arm_kinematics import FINGERS_LONGER_M, JOINTS, inverse, pointing_down

ARM_FORCE_N: Final = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
FINGER_JOINTS: Final = (9, 10)
FINGER_FORCE_N: Final = 20.0
FINGER_SPEED_M_PER_S: Final = 0.08
OPEN_WIDTH_M: Final = 0.08
TOOL_LINK: Final = 11
GRIPPER_LINKS: Final = (8, *FINGER_JOINTS)
FINGER_M: Final = (0.018, 0.006, 0.05 + FINGERS_LONGER_M)
"""The size of a finger: across, thickness, length."""
PALM_M: Final = (0.06, 0.09, 0.092)
"""The size of the hand above the fingers, in the same axes."""
MAKERS_PALM: Final = re.compile(r'<collision>\s*<geometry>\s*<mesh filename="\S*collision/hand\.obj"/>')
MAKERS_FINGER: Final = re.compile(
    r'(?:<origin rpy="0 0 3\.14159265359" xyz="0 0 0"/>\s*)?<geometry>\s*<mesh filename="\S*collision/finger\.obj"/>'
)
TOUCH_N: Final = 0.5
"""Below this a contact is a brush that physics has not resolved yet."""
HOME: Final = pointing_down(0.38, 0.0, 0.35, 0.0)


@dataclass(frozen=True)
class Touch:
    """A contact of the hand or arm with a body, and the vertical part [0, 1] of its normal."""

    body: int
    verticality: float


class Arm:
    """One Panda standing at the base's origin. `bullet` is the client of the world that it stands in."""

    def __init__(self, bullet: Any) -> None:
        self._bullet = bullet
        with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:  # PyBullet loads from files alone
            file.write(_description())
            file.flush()
            self.body: int = bullet.loadURDF(file.name, useFixedBase=True)
        # The contract of arm_kinematics: a wrist without a stop.
        bullet.changeDynamics(self.body, JOINTS - 1, jointLowerLimit=-1e3, jointUpperLimit=1e3)
        for finger in FINGER_JOINTS:
            # Only the constraint of a good grasp holds an object; friction must not hold a bad one.
            bullet.changeDynamics(self.body, finger, lateralFriction=0.0)
        self._commanded = np.zeros(JOINTS)
        self.go_home()

    def go_home(self) -> None:
        """Stand at HOME with open fingers at once, without moving there."""
        joints = inverse(HOME)
        assert joints is not None  # HOME is a constant within reach
        self.jump(joints)
        self.jump_to_width(OPEN_WIDTH_M)

    @property
    def joints_rad(self) -> Array:
        """The joint angles (7,) as they are."""
        return np.array([state[0] for state in self._bullet.getJointStates(self.body, range(JOINTS))])

    @property
    def commanded_rad(self) -> Array:
        """The joint angles (7,) that the motors hold."""
        return self._commanded

    @property
    def tool_pose(self) -> Pose:
        """The pose of `tool0` in the base."""
        state = self._bullet.getLinkState(self.body, TOOL_LINK, computeForwardKinematics=True)
        return Pose.of(state[4], state[5])

    @property
    def width_m(self) -> float:
        """The distance between the fingers."""
        return float(sum(state[0] for state in self._bullet.getJointStates(self.body, FINGER_JOINTS)))

    @property
    def finger_speed_m_per_s(self) -> float:
        """How fast the quicker finger moves."""
        return float(max(abs(state[1]) for state in self._bullet.getJointStates(self.body, FINGER_JOINTS)))

    def command(self, joints_rad: Array) -> None:
        """Let the motors drive the joints to these angles."""
        self._commanded = joints_rad
        self._bullet.setJointMotorControlArray(
            self.body,
            range(JOINTS),
            self._bullet.POSITION_CONTROL,
            targetPositions=joints_rad.tolist(),
            forces=ARM_FORCE_N,
            positionGains=[0.5] * JOINTS,
        )

    def jump(self, joints_rad: Array) -> None:
        """Stand at these angles at once, and hold them: the motors have nothing to do."""
        for index, angle in enumerate(joints_rad.tolist()):
            self._bullet.resetJointState(self.body, index, angle)
        self.command(joints_rad)

    def hold(self) -> None:
        """Stop where the arm is."""
        self.command(self.joints_rad)

    def solve(self, target: Pose) -> Array | None:
        """Joint angles (7,) for `tool0` at `target`, the wrist wound as it is now; None if out of reach."""
        joints = inverse(target)
        if joints is None:
            return None
        turns = np.round((self._commanded[-1] - joints[-1]) / (2 * np.pi))
        joints[-1] += 2 * np.pi * turns
        return joints

    def set_width(self, width_m: float) -> None:
        """Let the fingers move to a distance from each other, or as far as they can."""
        for finger in FINGER_JOINTS:
            self._bullet.setJointMotorControl2(
                self.body,
                finger,
                self._bullet.POSITION_CONTROL,
                targetPosition=width_m / 2,
                force=FINGER_FORCE_N,
                maxVelocity=FINGER_SPEED_M_PER_S,
            )

    def jump_to_width(self, width_m: float) -> None:
        """Let the fingers stand at a distance from each other at once."""
        for finger in FINGER_JOINTS:
            self._bullet.resetJointState(self.body, finger, width_m / 2)
        self.set_width(width_m)

    def touches(self) -> list[Touch]:
        """What the arm and its hand press against, itself not counted."""
        contacts: Sequence[tuple[Any, ...]] = self._bullet.getContactPoints(bodyA=self.body)
        return [
            Touch(contact[2], abs(contact[7][2]))
            for contact in contacts
            if contact[2] != self.body and contact[9] > TOUCH_N
        ]


@cache
def _description() -> str:
    """The URDF of the arm with our fingers, without what is only there to be seen: loading that takes longest."""
    folder = Path(pybullet_data.getDataPath()) / "franka_panda"
    text = (folder / "panda.urdf").read_text().replace("package://", f"{folder}/")
    text = re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)
    sides = iter((1, -1))
    across, thickness, length = FINGER_M

    def ours(found: re.Match[str]) -> str:
        return (
            f'<origin xyz="0 {next(sides) * thickness / 2} {length / 2 + 0.004}"/>'
            f'<geometry><box size="{across} {thickness} {length}"/>'
        )

    text, count = MAKERS_FINGER.subn(ours, text)
    text, palms = MAKERS_PALM.subn(
        '<collision><origin xyz="0 0 0.02"/><geometry><box size="{} {} {}"/>'.format(*PALM_M), text
    )
    text = text.replace('xyz="0 0 0.105"', f'xyz="0 0 {0.105 + FINGERS_LONGER_M}"')
    assert (count, palms) == (2, 1)  # the file is part of an installed package of a known version
    return text
