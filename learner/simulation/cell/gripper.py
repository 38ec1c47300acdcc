"""The gripper: what the fingers grasp, hold and touch.

A grasp holds only if the fingers close within 1 cm and 15 degrees of a graspable pose: straight down on an upright side
of a cube, at a quarter turn of it, at a height at which they cover it. Then a fixed joint holds the object; otherwise
nothing does, since the fingers have no friction.
"""

from __future__ import annotations

import math
from typing import Final

from learner.model import Pose
from learner.model.condition import GripperState
from learner.simulation.cell.arm import GRIPPER_LINKS, OPEN_WIDTH_M, TOOL_LINK, Arm
from learner.simulation.cell.bodies import Bodies
from learner.simulation.cell.engine import Engine
from learner.simulation.cell.rest import Rest

GRASP_M: Final = 0.01
GRASP_RAD: Final = math.radians(15)
GRIP_FORCE_N: Final = 100.0
FINGER_PLAY_M: Final = 0.002
ROOM_M: Final = 0.018
"""Between the open fingers and what they take or leave, both sides together: about what a good grasp needs."""
COVER_M: Final = 0.01
"""The fingers may close by so much above or below the middle of a cube and still cover its sides."""


class Gripper:
    """Open or closed, with what it holds by the world's truth."""

    def __init__(self, engine: Engine, arm: Arm, bodies: Bodies, rest: Rest) -> None:
        self._engine, self._arm, self._bodies, self._rest = engine, arm, bodies, rest
        self.state: GripperState = "open"
        self.held: str | None = None
        self._joint: int | None = None

    def reset(self) -> None:
        """Open, and nothing held."""
        self.let_go()
        self.state = "open"

    def make_ready(self, name: str) -> None:
        """Let the open fingers move as far apart as it takes to grasp an object: neighbours have less to fear."""
        self._arm.set_width(min(self._width_m(name) + ROOM_M, OPEN_WIDTH_M))

    def open(self) -> None:
        """Release what is held and let the fingers move apart, as far as that needs."""
        released = self.held
        self.let_go()
        self.state = "open"
        if released is None:
            self._arm.set_width(OPEN_WIDTH_M)
        else:
            self.make_ready(released)

    def close(self) -> str | None:
        """Let the fingers close; returns the object that they are about to grasp well, None where there is none."""
        grasped = self._graspable_here()
        # Fingers that press on could squeeze out what no friction holds.
        self._arm.set_width(0.0 if grasped is None else self._width_m(grasped) + FINGER_PLAY_M)
        return grasped

    def finish_closing(self, grasped: str | None) -> None:
        """The fingers have closed: hold what was grasped well, unless it slipped away meanwhile."""
        self.state = "closed"
        if grasped is not None and self._is_graspable(grasped, self._arm.tool_pose):
            self._hold(grasped)
        else:
            self._arm.set_width(0.0)

    def grasp_again(self, name: str) -> None:
        """Hold an object that stands where it was held before: takes back that it was taken away."""
        self._arm.jump_to_width(self._width_m(name))
        self._hold(name)

    def take_away(self) -> None:
        """Somebody takes what is held; the fingers close on nothing."""
        self.let_go()
        self._arm.set_width(0.0)

    def let_go(self) -> None:
        """Hold nothing, the fingers where they are."""
        if self.held is not None:
            self._engine.removeConstraint(self._joint)
            self._let_fingers_touch(self.held, True)
            self._rest.end()
        self.held = self._joint = None

    def obstacle(self, ignored: str | None) -> str | None:
        """What the hand or the held object presses against: a name, or TABLE; None if nothing.

        An object that is `ignored` may brush the fingers from the side, but not stand in their way from below.
        """
        for touch in self._arm.touches():
            name = self._bodies.name(touch.body)
            if name != self.held and not (name == ignored and touch.verticality < 0.7):
                return name
        return self._obstacle_of_held()

    def is_in_the_way_of(self, name: str) -> bool:
        """Whether the arm, or what it holds, stands where an object stands."""
        others = [self._arm.body, *([self._bodies.id(self.held)] if self.held else [])]
        return any(self._engine.getClosestPoints(self._bodies.id(name), other, 0.0) for other in others)

    def _obstacle_of_held(self) -> str | None:
        if self.held is None:
            return None
        for contact in self._engine.getContactPoints(bodyA=self._bodies.id(self.held)):
            other: int = contact[2]
            if other != self._arm.body and contact[9] > 0.0:
                return self._bodies.name(other)
        return None

    def _width_m(self, name: str) -> float:
        return self._bodies.kinds[name].size_m[1]

    def _graspable_here(self) -> str | None:
        tool = self._arm.tool_pose
        near = [name for name in self._bodies.names if self._is_graspable(name, tool)]
        return min(near, key=lambda name: math.dist(self._bodies.pose(name).position, tool.position), default=None)

    def _is_graspable(self, name: str, tool: Pose) -> bool:
        body, pose = self._bodies.kinds[name], self._bodies.pose(name)
        if not body.graspable:
            return False
        x, y, z = tool.inverse().apply(pose.position)
        too_high = max(abs(z) - COVER_M, 0.0)
        return math.hypot(x, y, too_high) <= GRASP_M and _angle_to_quarter_turns(tool, pose) <= GRASP_RAD

    def _hold(self, name: str) -> None:
        object_in_tool = self._arm.tool_pose.inverse() @ self._bodies.pose(name)
        self._joint = self._engine.createConstraint(
            self._arm.body,
            TOOL_LINK,
            self._bodies.id(name),
            -1,
            self._engine.JOINT_FIXED,
            (0.0, 0.0, 0.0),
            object_in_tool.position,
            (0.0, 0.0, 0.0),
            object_in_tool.quaternion_xyzw,
            (0.0, 0.0, 0.0, 1.0),
        )
        self._engine.changeConstraint(self._joint, maxForce=GRIP_FORCE_N)
        self.held = name
        self._let_fingers_touch(name, False)
        self._rest.end()
        # The fingers stay where they met the object: pressing on would fight the joint that holds it.
        self._arm.set_width(self._arm.width_m)

    def _let_fingers_touch(self, name: str, touching: bool) -> None:
        for link in GRIPPER_LINKS:
            self._engine.setCollisionFilterPair(self._arm.body, self._bodies.id(name), link, -1, int(touching))


def _angle_to_quarter_turns(tool: Pose, cube: Pose) -> float:
    """The angle [rad] between the hand and the nearest of the 24 turns of a cube that look the same."""
    relative = (cube.inverse() @ Pose((0.0, 0.0, 0.0), tool.quaternion_xyzw)).quaternion_xyzw
    # As unit quaternions the 24 are of three kinds: no or half turns, quarter turns, third turns.
    a, b, c, d = sorted((abs(value) for value in relative), reverse=True)
    cosine = max(a, (a + b) / math.sqrt(2), (a + b + c + d) / 2)
    return 2 * math.acos(min(1.0, cosine))
