"""A table with cubes and an arm that obey physics (PyBullet), in steps of 1/240 s.

The base frame lies on the table's top under the arm, z up.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from types import TracebackType
from typing import Self

import numpy as np

from learner.model import Pose
from learner.model.frame import objects_of, pose_of
from learner.simulation.cell.arm import Arm
from learner.simulation.cell.bodies import Bodies, UnknownObjectError, add_table, upright
from learner.simulation.cell.camera import SAMPLES, Camera, Noise
from learner.simulation.cell.engine import PERIOD_S, Engine
from learner.simulation.cell.gliding import GLIDE_STEPS, Gliding
from learner.simulation.cell.goal import LOOK_S, Goal
from learner.simulation.cell.gripper import Gripper
from learner.simulation.cell.rest import LOOK_STEPS, Rest
from learner.simulation.scenarios import BASE, Scenario, sample_start, scenario_named

Activity = Generator[None, None, None]


class World:
    """The physical world of one scenario, standing at a random start. A context manager: it owns a physics engine.

    `scenario` is one of SCENARIOS by its name (raises UnknownScenarioError) or any other; `start` are the poses at
    which its bodies begin, drawn at random if not given. `rng` decides the start and the camera's noise; its estimates
    average so many `looks`. Nothing moves but by `step`; `activity`, a generator, is resumed once before each step and
    moves the arm. With `glides`, the arm moves without physics while nothing else moves and nothing is near the hand,
    GLIDE_STEPS at once, and what lies still sleeps: the same poses and the same contacts, a few times faster.
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
        self._engine = Engine()
        table = add_table(self._engine)
        self.arm = Arm(self._engine)
        self._engine.setCollisionFilterPair(self.arm.body, table, -1, -1, 0)
        self.bodies = Bodies(self._engine, self.scenario.bodies)
        self.rest, self.goal = Rest(self.bodies), Goal(self.scenario)
        self.gripper = Gripper(self._engine, self.arm, self.bodies, self.rest)
        self.gliding = Gliding(glides, self.arm, self.bodies, self.gripper, self.rest)
        self.camera = Camera(noise or Noise(), rng, looks)
        self.activity: Activity | None = None
        self.reset(rng, start)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._engine.disconnect()

    def reset(self, rng: np.random.Generator, start: Mapping[str, Pose] | None = None) -> None:
        """Stand at `start`, or at a new random one: the arm at home with open fingers, nothing held, no activity."""
        self.gripper.reset()
        self.activity = None
        self.arm.go_home()
        self.time_s = 0.0
        self.goal.forget()
        self.camera.forget()
        for name, pose in (start or sample_start(self.scenario, rng)).items():
            self._put(name, pose)
        self._steps = 0
        self._look_at_goal()

    @property
    def objects(self) -> tuple[str, ...]:
        """The names of all objects."""
        return self.scenario.objects

    @property
    def held(self) -> str | None:
        """The object that the gripper holds, by the world's truth."""
        return self.gripper.held

    # --- time

    def step(self) -> None:
        """Let the activity decide, then let 1/240 s pass; GLIDE_STEPS of that where the arm glided."""
        self.gliding.glided = False
        if self.activity is not None and next(self.activity, "ended") == "ended":
            self.activity = None
        if not self.gliding.glided:
            self._engine.stepSimulation()
            if self.gliding.wanted and self._steps % LOOK_STEPS == 0:
                self.rest.look(self.held)
        passed = GLIDE_STEPS if self.gliding.glided else 1
        self._steps += passed
        self.time_s += passed * PERIOD_S
        if self.gliding.glided or self._steps % round(LOOK_S / PERIOD_S) == 0:
            self._look_at_goal()

    def pause(self, duration_s: float) -> None:
        """Let time pass in which nothing moves, without physics: for a world at rest without an activity."""
        self.time_s += duration_s

    def run(self, duration_s: float) -> None:
        """Let time pass."""
        for _ in range(round(duration_s / PERIOD_S)):
            self.step()

    def halt(self) -> None:
        """Stop the arm where it is; the fingers stay as they are."""
        self.activity = None
        self.arm.hold()

    # --- what is seen

    def pose_in_base(self, name: str) -> Pose:
        """The true pose of an object. Raises UnknownObjectError."""
        return self.bodies.pose(name)

    def poses_in_base(self) -> dict[str, Pose]:
        """The true poses of all objects that nobody took away."""
        return {name: self.pose_in_base(name) for name in self.objects if name not in self.bodies.away}

    def observe(self) -> dict[str, Pose]:
        """One noisy look of the camera at all objects."""
        return self.camera.observe(self.shown())

    def shown(self) -> dict[str, Pose]:
        """The poses at which objects look to stand: a cube that came to lie on another side looks as if it stood."""
        poses = self.poses_in_base()
        cubes = (name for name in poses if self.scenario.bodies[name].symmetry == "cube")
        return poses | {name: upright(poses[name]) for name in cubes}

    def frame_in_base(self, frame: str) -> Pose:
        """The pose of a frame as the cell perceives it: the base, or by the estimates of the objects that it goes by.

        Raises UnknownObjectError.
        """
        if frame == BASE:
            return Pose((0.0, 0.0, 0.0))
        if not set(objects_of(frame)) <= set(self.objects):
            raise UnknownObjectError("frame", frame, (BASE, *self.objects))
        self.observe()
        return pose_of(frame, self._estimate)

    def obstacle(self, ignored: str | None = None) -> str | None:
        """What the hand or the held object presses against, as `Gripper.obstacle`; an arm that glides meets nothing."""
        return None if self.gliding.glided else self.gripper.obstacle(ignored)

    def _estimate(self, name: str) -> Pose:
        estimate = self.camera.estimate(name)
        if estimate is None:  # it was taken away before anybody looked
            raise UnknownObjectError("frame", name, (BASE, *self.poses_in_base()))
        return estimate

    def _look_at_goal(self) -> None:
        if self.scenario.goal:
            self.goal.look(self.time_s, self.held, {name: self.pose_in_base(name) for name in self.objects})

    # --- a person's hands

    def teleport(self, name: str, pose: Pose, with_content: bool = True) -> None:
        """Put an object elsewhere at once, as a person would; a container or board takes along what is on it.

        A held object leaves the gripper, which stays closed. Raises UnknownObjectError.
        """
        content = self.bodies.content(name) if with_content else []
        moved = [name, *(each for each in content if each != self.held)]
        motion = pose @ self.pose_in_base(name).inverse()
        for each in moved:
            if each == self.held:
                self.gripper.take_away()
            self._put(each, motion @ self.pose_in_base(each))
        self._look_at_goal()

    def take_away(self, name: str) -> None:
        """Take an object off the table: nothing sees or meets it until it is put somewhere, or at a reset.

        A held object leaves the gripper, which stays closed. Raises UnknownObjectError.
        """
        if name == self.held:
            self.gripper.take_away()
        self.bodies.take_away(name)
        self.rest.end()
        self._look_at_goal()

    def put(self, name: str, pose: Pose) -> bool:
        """Put an object alone elsewhere at once; whether neither the arm nor what it holds is in its way there.

        A held object leaves the gripper, which stays closed. Raises UnknownObjectError.
        """
        self.teleport(name, pose, with_content=False)
        return not self.gripper.is_in_the_way_of(name)

    def _put(self, name: str, pose: Pose) -> None:
        self.bodies.put(name, pose)
        self.rest.end()
