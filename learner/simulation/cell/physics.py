"""A table with cubes and an arm that obey physics (PyBullet), in steps of 1/240 s.

The base frame lies on the table's top under the arm, z up. A grasp holds only if the fingers close within 1 cm and
15 degrees of a graspable pose: straight down on an upright side of a cube, at a quarter turn of it, at a height at
which they cover it. Then a fixed joint holds the object; otherwise nothing does, since the fingers have no friction.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Generator, Mapping
from types import TracebackType
from typing import Any, Final, Literal, Self

import numpy as np
import pybullet

from learner.errors import LearnerError
from learner.model import Pose
from learner.model.condition import GripperState
from learner.model.frame import objects_of, pose_of
from learner.model.pose import Array
from learner.simulation.cell.arm import GRIPPER_LINKS, OPEN_WIDTH_M, TOOL_LINK, Arm
from learner.simulation.cell.camera import SAMPLES, Camera, Noise
from learner.simulation.scenarios import BASE, Body, Scenario, sample_start, scenario_named

PERIOD_S: Final = 1 / 240
GRASP_M: Final = 0.01
GRASP_RAD: Final = math.radians(15)
GRIP_FORCE_N: Final = 100.0
FINGER_PLAY_M: Final = 0.002
ROOM_M: Final = 0.018
"""Between the open fingers and what they take or leave, both sides together: about what a good grasp needs."""
COVER_M: Final = 0.01
"""The fingers may close by so much above or below the middle of a cube and still cover its sides."""
TABLE: Final = "the table"
LOOK_S: Final = 1 / 30
"""How often the goal is looked at."""
LOOK_STEPS: Final = 4
"""How often it is looked whether anything moves."""
GLIDE_STEPS: Final = 48
"""So many steps pass at once where nothing moves but an arm far from everything."""
HAND_M: Final = 0.08
"""No part of the hand is further than this to the side of `tool0` [m] ..."""
FINGERTIP_M: Final = 0.02
"""... or below it [m]."""
CLEARANCE_M: Final = 0.02
"""What is nearer than this to the hand may touch it soon [m]."""
STILL_STEPS: Final = 24
STILL_M_PER_S: Final = 0.01
STILL_RAD_PER_S: Final = 0.1
"""What moves more slowly than this for STILL_STEPS is at rest."""

Activity = Generator[None, None, None]


class UnknownObjectError(LearnerError):
    """An object or frame that the cell does not have."""

    def __init__(self, kind: Literal["object", "frame"], name: object, known: tuple[str, ...]) -> None:
        super().__init__(f"no {kind} {str(name)[:80]!r} in this cell; it has {', '.join(known)}")


class _Client:
    """One physics engine of its own; pybullet's functions, called upon it.

    Not pybullet_utils' client: that one writes on standard output.
    """

    def __init__(self) -> None:
        self._number: int = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        found = getattr(pybullet, name)
        return functools.partial(found, physicsClientId=self._number) if callable(found) else found


class World:
    """The physical world of one scenario, standing at a random start. A context manager: it owns a physics engine.

    `scenario` is one of SCENARIOS by its name (raises UnknownScenarioError) or any other; `start` are the poses at
    which its bodies begin, drawn at random if not given. `rng` decides the start and the camera's noise; its estimates
    average so many `looks`. Nothing moves but by `step`; `activity`, a generator, is resumed once before each step and
    moves the arm. With `glides`, the arm moves without physics while nothing else moves and nothing is near the hand,
    GLIDE_STEPS at once: the same poses and the same contacts, a few times faster.
    """

    def __init__(
        self,
        scenario: str | Scenario,
        rng: np.random.Generator,
        noise: Noise | None = None,
        start: Mapping[str, Pose] | None = None,
        glides: bool = False,
        looks: int = SAMPLES,
    ) -> None:
        self.scenario_name = scenario if isinstance(scenario, str) else ""
        self.scenario = scenario_named(scenario) if isinstance(scenario, str) else scenario
        self.glides = glides
        self._glided = False
        self._still_steps = 0
        self._bullet: Any = _Client()
        self._bullet.setTimeStep(PERIOD_S)
        self._bullet.setGravity(0.0, 0.0, -9.81)
        table = self._add_table()
        self.arm = Arm(self._bullet)
        self._bullet.setCollisionFilterPair(self.arm.body, table, -1, -1, 0)
        self._ids = {name: self._add(body) for name, body in sorted(self.scenario.bodies.items())}
        self._names: dict[int, str] = {body: name for name, body in self._ids.items()}
        self.camera = Camera(noise or Noise(), rng, looks)
        self.activity: Activity | None = None
        self._held: str | None = None
        self._grip: int | None = None
        self.reset(rng, start)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bullet.disconnect()

    def reset(self, rng: np.random.Generator, start: Mapping[str, Pose] | None = None) -> None:
        """Stand at `start`, or at a new random one: the arm at home with open fingers, nothing held, no activity."""
        self._detach()
        self.activity = None
        self.arm.go_home()
        self.gripper_state: GripperState = "open"
        self.time_s = self.goal_since_s = 0.0
        self.goal_reached = False
        self.camera.forget()
        for name, pose in (start or sample_start(self.scenario, rng)).items():
            self._put(name, pose)
        self._steps = 0
        self._look_at_goal()

    def step(self) -> None:
        """Let the activity decide, then let 1/240 s pass; GLIDE_STEPS of that where the arm glided."""
        self._glided = False
        if self.activity is not None and next(self.activity, "ended") == "ended":
            self.activity = None
        if not self._glided:
            self._bullet.stepSimulation()
            if self.glides and self._steps % LOOK_STEPS == 0:
                self._notice_rest()
        passed = GLIDE_STEPS if self._glided else 1
        self._steps += passed
        self.time_s += passed * PERIOD_S
        if self._glided or self._steps % round(LOOK_S / PERIOD_S) == 0:
            self._look_at_goal()

    def pause(self, duration_s: float) -> None:
        """Let time pass in which nothing moves, without physics: for a world at rest without an activity."""
        self.time_s += duration_s

    @property
    def at_rest(self) -> bool:
        """Whether nothing but the arm, and what it holds, has moved for a while."""
        return self._still_steps >= STILL_STEPS

    def _notice_rest(self) -> None:
        moving = any(self._moves(body) for name, body in self._ids.items() if name != self._held)
        self._still_steps = 0 if moving else self._still_steps + LOOK_STEPS

    def _moves(self, body: int) -> bool:
        linear, angular = self._bullet.getBaseVelocity(body)
        return math.hypot(*linear) > STILL_M_PER_S or math.hypot(*angular) > STILL_RAD_PER_S

    def may_glide(self, *tool_poses: Pose) -> bool:
        """Whether nothing else moves and the hand, with what it holds, is clear of everything at these poses."""
        return self.glides and self.at_rest and all(self._is_clear(pose) for pose in tool_poses)

    def _is_clear(self, tool: Pose) -> bool:
        x, y, z = tool.position
        held = 0.0 if self._held is None else math.hypot(*self.scenario.bodies[self._held].size_m) / 2
        bottom = z - max(held, FINGERTIP_M) - CLEARANCE_M
        return bottom > 0.0 and not any(
            self._reaches_up(name, x, y, bottom) for name in self._ids if name != self._held
        )

    def _reaches_up(self, name: str, x: float, y: float, height_m: float) -> bool:
        """Whether a body may come within the hand's width of (x, y) and up to a height."""
        length, width, height = self.scenario.bodies[name].size_m
        (bx, by, bz), _ = self._bullet.getBasePositionAndOrientation(self._ids[name])
        beside = math.hypot(bx - x, by - y) < HAND_M + CLEARANCE_M + math.hypot(length, width) / 2
        # A little thing may lie on another side; a wide one stands.
        upwards = max(length, width, height) if self.scenario.bodies[name].graspable else height
        return beside and bz + upwards / 2 > height_m

    def glide(self, joints_rad: Array) -> None:
        """Bring the arm to joint angles (7,) at once with what it holds; GLIDE_STEPS pass at the step that follows.

        Only where `may_glide`.
        """
        grip = None if self._held is None else self.arm.tool_pose.inverse() @ self.pose_in_base(self._held)
        self.arm.jump(joints_rad)
        if self._held is not None and grip is not None:
            self._move(self._held, self.arm.tool_pose @ grip)
        self._glided = True

    def run(self, duration_s: float) -> None:
        """Let time pass."""
        for _ in range(round(duration_s / PERIOD_S)):
            self.step()

    def halt(self) -> None:
        """Stop the arm where it is; the fingers stay as they are."""
        self.activity = None
        self.arm.hold()

    @property
    def objects(self) -> tuple[str, ...]:
        return self.scenario.objects

    @property
    def held(self) -> str | None:
        """The object that the gripper holds, by the world's truth."""
        return self._held

    @property
    def goal_held_s(self) -> float:
        """For how long [s of the world] the goal has held with nothing in the gripper; 0 where it does not."""
        return self.time_s - self.goal_since_s if self.goal_reached else 0.0

    def pose_in_base(self, name: str) -> Pose:
        """The true pose of an object. Raises UnknownObjectError."""
        position, quaternion_xyzw = self._bullet.getBasePositionAndOrientation(self._id(name))
        return Pose.of(position, quaternion_xyzw)

    def poses_in_base(self) -> dict[str, Pose]:
        """The true poses of all objects."""
        return {name: self.pose_in_base(name) for name in self.objects}

    def observe(self) -> dict[str, Pose]:
        """One noisy look of the camera at all objects."""
        return self.camera.observe(self.shown())

    def shown(self) -> dict[str, Pose]:
        """The poses at which objects look to stand: a cube that came to lie on another side looks as if it stood."""
        poses = self.poses_in_base()
        cubes = (name for name, body in self.scenario.bodies.items() if body.symmetry == "cube")
        return poses | {name: upright(poses[name]) for name in cubes}

    def frame_in_base(self, frame: str) -> Pose:
        """The pose of a frame as the cell perceives it: the base, or by the estimates of the objects that it goes by.

        Raises UnknownObjectError.
        """
        if frame == BASE:
            return Pose((0.0, 0.0, 0.0))
        if not set(objects_of(frame)) <= self._ids.keys():
            raise UnknownObjectError("frame", frame, (BASE, *self.objects))
        self.observe()
        return pose_of(frame, self._estimate)

    def _estimate(self, name: str) -> Pose:
        estimate = self.camera.estimate(name)
        assert estimate is not None  # just observed
        return estimate

    def teleport(self, name: str, pose: Pose, with_content: bool = True) -> None:
        """Put an object elsewhere at once, as a person would; a container or board takes along what is on it.

        A held object leaves the gripper, which stays closed. Raises UnknownObjectError.
        """
        moved = [name, *(self._content(name) if with_content else [])]
        motion = pose @ self.pose_in_base(name).inverse()
        for each in moved:
            if each == self._held:
                self._detach()
                self.arm.set_width(0.0)
            self._put(each, motion @ self.pose_in_base(each))
        self._look_at_goal()

    def put(self, name: str, pose: Pose) -> bool:
        """Put an object alone elsewhere at once; whether neither the arm nor what it holds is in its way there.

        A held object leaves the gripper, which stays closed. Raises UnknownObjectError.
        """
        self.teleport(name, pose, with_content=False)
        others = [self.arm.body, *([self._ids[self._held]] if self._held else [])]
        return not any(self._bullet.getClosestPoints(self._ids[name], other, 0.0) for other in others)

    def grasp_again(self, name: str) -> None:
        """Hold an object that stands where it was held before: takes back that it was taken away."""
        self.arm.jump_to_width(self.scenario.bodies[name].size_m[1])
        self._attach(name)

    def make_ready(self, name: str) -> None:
        """Let the open fingers move as far apart as it takes to grasp an object: neighbours have less to fear."""
        self.arm.set_width(min(self.scenario.bodies[name].size_m[1] + ROOM_M, OPEN_WIDTH_M))

    def open_fingers(self) -> None:
        """Release what is held and let the fingers move apart, as far as that needs."""
        released = self._held
        self._detach()
        self.gripper_state = "open"
        if released is None:
            self.arm.set_width(OPEN_WIDTH_M)
        else:
            self.make_ready(released)

    def close_fingers(self) -> str | None:
        """Let the fingers close; returns the object that they are about to grasp well, None where there is none."""
        grasped = self._graspable_here()
        # Fingers that press on could squeeze out what no friction holds.
        self.arm.set_width(0.0 if grasped is None else self.scenario.bodies[grasped].size_m[1] + FINGER_PLAY_M)
        return grasped

    def finish_closing(self, grasped: str | None) -> None:
        """The fingers have closed: hold what was grasped well, unless it slipped away meanwhile."""
        self.gripper_state = "closed"
        if grasped is not None and self._is_graspable(grasped, self.arm.tool_pose):
            self._attach(grasped)
        else:
            self.arm.set_width(0.0)

    def obstacle(self, ignored: str | None = None) -> str | None:
        """What the hand or the held object presses against: a name, or TABLE; None if nothing.

        An object that is `ignored` may brush the fingers from the side, but not stand in their way from below.
        """
        if self._glided:
            return None
        for touch in self.arm.touches():
            name = self._names.get(touch.body, TABLE)
            if name != self._held and not (name == ignored and touch.verticality < 0.7):
                return name
        return self._obstacle_of_held()

    def _obstacle_of_held(self) -> str | None:
        if self._held is None:
            return None
        for contact in self._bullet.getContactPoints(bodyA=self._ids[self._held]):
            other: int = contact[2]
            if other != self.arm.body and contact[9] > 0.0:
                return self._names.get(other, TABLE)
        return None

    def _look_at_goal(self) -> None:
        if not self.scenario.goal:
            return
        reached = self._held is None and self.scenario.reached(self.poses_in_base())
        if reached and not self.goal_reached:
            self.goal_since_s = self.time_s
        self.goal_reached = reached

    def _graspable_here(self) -> str | None:
        tool = self.arm.tool_pose
        near = [name for name in self.objects if self._is_graspable(name, tool)]
        return min(near, key=lambda name: math.dist(self.pose_in_base(name).position, tool.position), default=None)

    def _is_graspable(self, name: str, tool: Pose) -> bool:
        body, pose = self.scenario.bodies[name], self.pose_in_base(name)
        if not body.graspable:
            return False
        x, y, z = tool.inverse().apply(pose.position)
        too_high = max(abs(z) - COVER_M, 0.0)
        return math.hypot(x, y, too_high) <= GRASP_M and _angle_to_quarter_turns(tool, pose) <= GRASP_RAD

    def _attach(self, name: str) -> None:
        object_in_tool = self.arm.tool_pose.inverse() @ self.pose_in_base(name)
        self._grip = self._bullet.createConstraint(
            self.arm.body,
            TOOL_LINK,
            self._ids[name],
            -1,
            self._bullet.JOINT_FIXED,
            (0.0, 0.0, 0.0),
            object_in_tool.position,
            (0.0, 0.0, 0.0),
            object_in_tool.quaternion_xyzw,
            (0.0, 0.0, 0.0, 1.0),
        )
        self._bullet.changeConstraint(self._grip, maxForce=GRIP_FORCE_N)
        self._held = name
        self._let_fingers_touch(name, False)
        self._still_steps = 0
        # The fingers stay where they met the object: pressing on would fight the joint that holds it.
        self.arm.set_width(self.arm.width_m)

    def _detach(self) -> None:
        if self._held is not None:
            self._bullet.removeConstraint(self._grip)
            self._let_fingers_touch(self._held, True)
            self._still_steps = 0
        self._held = self._grip = None

    def _let_fingers_touch(self, name: str, touching: bool) -> None:
        for link in GRIPPER_LINKS:
            self._bullet.setCollisionFilterPair(self.arm.body, self._ids[name], link, -1, int(touching))

    def _content(self, name: str) -> list[str]:
        """What lies within or upon an object that is wider than a cube."""
        length, width, height = self.scenario.bodies[name].size_m
        frame = self.pose_in_base(name).inverse()
        inside = {other: frame.apply(self.pose_in_base(other).position) for other in self.objects if other != name}
        return [
            other
            for other, (x, y, z) in inside.items()
            if not self.scenario.bodies[name].graspable
            and abs(x) < length / 2
            and abs(y) < width / 2
            and -height / 2 < z < 0.3
            and other != self._held
        ]

    def _put(self, name: str, pose: Pose) -> None:
        self._move(name, pose)
        self._still_steps = 0

    def _move(self, name: str, pose: Pose) -> None:
        self._bullet.resetBasePositionAndOrientation(self._ids[name], pose.position, pose.quaternion_xyzw)
        self._bullet.resetBaseVelocity(self._ids[name], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def _id(self, name: str) -> int:
        if name not in self._ids:
            raise UnknownObjectError("object", name, self.objects)
        return self._ids[name]

    def _add_table(self) -> int:
        half = (0.8, 1.0, 0.05)
        shape = self._bullet.createCollisionShape(self._bullet.GEOM_BOX, halfExtents=half)
        table: int = self._bullet.createMultiBody(0.0, shape, basePosition=(0.5, 0.0, -half[2]))
        self._bullet.changeDynamics(table, -1, lateralFriction=0.8)
        return table

    def _add(self, body: Body) -> int:
        slabs = _slabs(body)
        shape = self._bullet.createCollisionShapeArray(
            shapeTypes=[self._bullet.GEOM_BOX] * len(slabs),
            halfExtents=[[side / 2 for side in size] for size, _ in slabs],
            collisionFramePositions=[list(center) for _, center in slabs],
        )
        number: int = self._bullet.createMultiBody(body.mass_kg, shape)
        self._bullet.changeDynamics(number, -1, lateralFriction=0.8, rollingFriction=1e-4, spinningFriction=1e-3)
        return number


def upright(cube: Pose) -> Pose:
    """The pose of a cube whose sides look the same, with its z axis on the side that is up: the same if it stands."""
    x, y, z, w = cube.quaternion_xyzw
    ups = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )  # of its axes: the last row of the rotation
    side = max(range(3), key=lambda axis: abs(ups[axis]))
    if side == 2 and ups[2] > 0:
        return cube
    half = math.pi / 2 if side == 2 else math.copysign(math.pi / 4, ups[side])
    about = {0: (0.0, math.sin(half), 0.0), 1: (-math.sin(half), 0.0, 0.0), 2: (math.sin(half), 0.0, 0.0)}[side]
    return cube @ Pose((0.0, 0.0, 0.0), (*about, math.cos(half)))


def _slabs(body: Body) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """The blocks (size, center) [m] that a body is made of: one, or a floor and four walls."""
    length, width, height = body.size_m
    if body.wall_m is None:
        return [(body.size_m, (0.0, 0.0, 0.0))]
    wall = body.wall_m
    walls = [((wall, width, height), (side * (length - wall) / 2, 0.0, 0.0)) for side in (-1, 1)]
    walls += [((length, wall, height), (0.0, side * (width - wall) / 2, 0.0)) for side in (-1, 1)]
    return [((length, width, wall), (0.0, 0.0, (wall - height) / 2)), *walls]


def _angle_to_quarter_turns(tool: Pose, cube: Pose) -> float:
    """The angle [rad] between the hand and the nearest of the 24 turns of a cube that look the same."""
    relative = (cube.inverse() @ Pose((0.0, 0.0, 0.0), tool.quaternion_xyzw)).quaternion_xyzw
    # As unit quaternions the 24 are of three kinds: no or half turns, quarter turns, third turns.
    a, b, c, d = sorted((abs(value) for value in relative), reverse=True)
    cosine = max(a, (a + b) / math.sqrt(2), (a + b + c + d) / 2)
    return 2 * math.acos(min(1.0, cosine))
