"""Motion without physics while nothing else moves and nothing is near the hand: the same poses, sooner."""

from __future__ import annotations

import math
from typing import Final

from learner.model import Pose
from learner.model.pose import Array
from learner.simulation.cell.arm import Arm
from learner.simulation.cell.bodies import Bodies
from learner.simulation.cell.gripper import Gripper
from learner.simulation.cell.rest import Rest

GLIDE_STEPS: Final = 48
"""So many steps pass at once where nothing moves but an arm far from everything."""
HAND_M: Final = 0.08
"""No part of the hand is further than this to the side of `tool0` [m] ..."""
FINGERTIP_M: Final = 0.02
"""... or below it [m]."""
CLEARANCE_M: Final = 0.02
"""What is nearer than this to the hand may touch it soon [m]."""


class Gliding:
    """Lets the arm glide, if `wanted` at all; `glided` tells of the present step."""

    def __init__(self, wanted: bool, arm: Arm, bodies: Bodies, gripper: Gripper, rest: Rest) -> None:
        self.wanted, self.glided = wanted, False
        self._arm, self._bodies, self._gripper, self._rest = arm, bodies, gripper, rest

    def allows(self, *tool_poses: Pose) -> bool:
        """Whether nothing else moves and the hand, with what it holds, is clear of everything at these poses."""
        return self.wanted and bool(self._rest) and all(self._is_clear(pose) for pose in tool_poses)

    def go(self, joints_rad: Array) -> None:
        """Bring the arm to joint angles (7,) at once with what it holds; GLIDE_STEPS pass at the step that follows.

        Only where gliding `allows` it.
        """
        held = self._gripper.held
        grip = None if held is None else self._arm.tool_pose.inverse() @ self._bodies.pose(held)
        self._arm.jump(joints_rad)
        if held is not None and grip is not None:
            self._bodies.put(held, self._arm.tool_pose @ grip)
        self.glided = True

    def _is_clear(self, tool: Pose) -> bool:
        x, y, z = tool.position
        held = self._gripper.held
        below = 0.0 if held is None else math.hypot(*self._bodies.kinds[held].size_m) / 2
        bottom = z - max(below, FINGERTIP_M) - CLEARANCE_M
        return bottom > 0.0 and not any(
            self._reaches_up(name, x, y, bottom) for name in self._bodies.names if name != held
        )

    def _reaches_up(self, name: str, x: float, y: float, height_m: float) -> bool:
        """Whether a body may come within the hand's width of (x, y) and up to a height."""
        kind = self._bodies.kinds[name]
        length, width, height = kind.size_m
        bx, by, bz = self._bodies.position(name)
        beside = math.hypot(bx - x, by - y) < HAND_M + CLEARANCE_M + math.hypot(length, width) / 2
        # A little thing may lie on another side; a wide one stands.
        upwards = max(length, width, height) if kind.graspable else height
        return beside and bz + upwards / 2 > height_m
