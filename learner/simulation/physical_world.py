"""A world with dynamics and the arm (PyBullet), in which trees are judged as in the kinematic one.

It is the cell of `treewright sim` in this process and without a clock: the same engine, arm and skills, and the same
perception as a controller's. It is built from the same things as `learner.simulation.kinematic_world`, and
both are a `learner.simulation.arena.Arena`.

    with PhysicalWorld(bodies, spots, rng) as world:
        ticker = Ticker(tree.flattened(), world)
        while ticker.tick() is not Status.SUCCESS:
            world.step()
        world.table.spots  # the truth

Where it differs from the kinematic world: an action takes about forty steps instead of seven; the arm stands at the
origin of the base and reaches a ring around it (`reaches`) instead of a rectangle; things can topple and be pushed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Self

import numpy as np

from learner.execution.entries import Found
from learner.execution.perception import CellState, Checked, condition_of, query_of
from learner.execution.ticking import Status
from learner.model import Motion, Node, Pose
from learner.model.condition import GripperState
from learner.model.frame import START
from learner.model.holding import Sizes
from learner.model.names import NONE
from learner.model.pose import Vector
from learner.model.query import SetSignal, signal_of
from learner.model.scene import Scene
from learner.model.upright import Spot, spot_of
from learner.relations.answering import Answering
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.simulation import scenarios
from learner.simulation.cell import arm_kinematics, camera, skills
from learner.simulation.cell.physics import Activity, World
from learner.simulation.cell.skills import Skill, SkillResult
from learner.simulation.failure import Failure
from learner.simulation.gravity import WALL_M, Body, Table
from learner.simulation.kinematic_world import PERIOD_S, Attempt, Behavior, Faults, Noise

DENSITY_KG_PER_M3: Final = 800.0
"""Of what things are made of: a cube of 5 cm weighs 0.1 kg."""
SETTLED_S: Final = 2.0
"""After a human's hands things are left to come to rest for at most this long."""
RESUMES_BEFORE_FAILURE: Final = 30
"""A skill that fails for nothing does so before its generator was resumed this often: with the hand on its way."""
PERIOD_NS: Final = round(PERIOD_S * 1e9)


@dataclass
class _UnderWay:
    node: Node
    attempt: Attempt


@dataclass(frozen=True)
class _Memory:
    poses: Mapping[str, Pose]
    held: str | None


class PhysicalWorld:
    """Bodies on a table, a Panda, a camera; implements `learner.simulation.arena.Arena`. A context manager.

    bodies, spots: what there is and where it stands, within `reaches`. `noise` is that of each single look of the
    camera, which is all that conditions and skills get. What is graspable is a cube to the fingers. `table` is a
    picture of where everything stands now, taken as upright; what is laid there moves nothing. `sizes` and
    `end_effector` are as in the kinematic world.
    """

    def __init__(
        self,
        bodies: Mapping[str, Body],
        spots: Mapping[str, Spot],
        rng: np.random.Generator,
        noise: Noise | None = None,
        base_frame: str = scenarios.BASE,
        behavior: Behavior | None = None,
        sizes: Sizes | None = None,
        end_effector: Vector = (0.0, 0.0, 0.0),
        knowledge: Knowledge = UNKNOWING,
    ) -> None:
        self.bodies, self.base_frame, self.behavior = dict(bodies), base_frame, behavior or Behavior()
        self._began = dict(spots)
        self.attempts: list[Attempt] = []
        self.faults = Faults()
        self.steps = 0
        self._rng = rng
        scenario = scenarios.Scenario({name: _as_simulated(body) for name, body in bodies.items()}, (), ())
        start = {name: spot.pose() for name, spot in spots.items()}
        self._world = World(scenario, rng, _as_simulated_noise(noise or Noise()), start, glides=True, looks=1)
        known = Scene({name: body.shape for name, body in bodies.items() if sizes is None or name in sizes})
        self._cell = CellState(base_frame, scenarios.TOOL, Answering(known, knowledge))
        self._end_effector = Pose(end_effector)
        self._under_way: _UnderWay | None = None
        self._conditions: dict[int, tuple[Node, Checked]] = {}
        self._hand_is_clear = True
        self._now_ns = 0
        self._perceive()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._world.__exit__(kind, error, trace)

    # -- what is true --------------------------------------------------------------------------------------------

    def spot(self, name: str) -> Spot:
        """Where an object, a frame or the base really is."""
        if name == self.base_frame:
            return Spot(0.0, 0.0, 0.0, 0.0)
        if name.endswith(START):
            return self._began[name.removesuffix(START)]
        return self.table.spots.get(name) or spot_of(name, self.table.spots)

    @property
    def held(self) -> str | None:
        """The object that the gripper holds, by the truth."""
        return self._world.held

    @property
    def gripper(self) -> GripperState:
        """Whether the gripper is open or closed."""
        return self._world.gripper.state

    @property
    def hand(self) -> Vector:
        """The point between the fingertips [m]."""
        return self._world.arm.tool_pose.position

    def reaches(self, position: Vector) -> bool:
        """Whether the arm can bring its fingertips there [m]."""
        return arm_kinematics.reaches(position[0], position[1])

    # -- leaves --------------------------------------------------------------------------------------------------

    @property
    def believed(self) -> str:
        """What the robot believes to hold, `none` for nothing: CONTRACT, section 3, InGripper."""
        return self._cell.held or NONE

    def check(self, node: Node) -> bool:
        """Whether a condition holds for the robot: by camera and gripper, not by the truth."""
        known = self._conditions.get(id(node))
        if known is None:
            known = self._conditions[id(node)] = node, condition_of(node)
        return self._cell.holds(known[1])

    def find(self, node: Node) -> Found | None:
        """What a query finds for the robot; a pose is the simulated hand's."""
        found = self._cell.find(query_of(node))
        if node.kind != "FindSpot" or found is None:
            return found
        hand = Pose(found["position"], found["orientation"]) @ self._end_effector.inverse()  # type: ignore[arg-type]  # as queries write
        return {"position": hand.position, "orientation": hand.quaternion_xyzw}

    def tick_action(self, node: Node) -> Status:
        """Start the action, or tell how it goes. A start while another is under way ends that one where it is."""
        if self._under_way is None or self._under_way.node is not node:
            self._start(node)
        now = self._under_way
        if now is None or not now.attempt.ended:
            return Status.RUNNING
        self._stop()
        return Status.SUCCESS if now.attempt.failure is None else Status.FAILURE

    def halt_action(self, node: Node) -> None:
        """Stop the arm, leave the fingers as they are."""
        if self._under_way and self._under_way.node is node:
            self._stop()
            self._world.halt()

    def _start(self, node: Node) -> None:
        self._stop()
        self._cell.freeze_gripper()
        attempt = Attempt(node.kind, str(dict(node.ports).get("object", "")), self._frame(node), self.steps)
        self.attempts.append(attempt)
        self._under_way = _UnderWay(node, attempt)
        self._world.halt()
        self._world.activity = self._do(node, attempt)

    def _stop(self) -> None:
        self._under_way = None
        self._cell.thaw_gripper()

    def _frame(self, node: Node) -> str:
        frame = str(dict(node.ports).get("frame", ""))
        return scenarios.BASE if frame == self.base_frame else frame

    def _do(self, node: Node, attempt: Attempt) -> Activity:
        result = yield from self._as_it_behaves(node, self._skill(node))
        attempt.ended, attempt.failure = True, result.failure
        if isinstance(node.word, Motion) and node.kind == "Pick" and result.failure is not None:
            self._cell.pick_failed(node.word.object, node.word.pose)
        self.faults.contacts += result.failure is not None and result.failure.kind == "contact"
        self.faults.wrong_picks += node.kind == "Pick" and self.held not in (None, attempt.object)

    def _skill(self, node: Node) -> Skill:
        if isinstance(word := node.word, SetSignal):
            return self._set_signal(word)
        if node.kind == "SetGripper":
            return skills.set_gripper(self._world, "open" if node.port("state") == "open" else "closed")
        perform = skills.pick if node.kind == "Pick" else skills.place
        pose = Pose(node.port("position"), node.port("orientation"))  # type: ignore[arg-type]  # checked by Tree
        return perform(self._world, str(node.port("object")), self._frame(node), pose)

    def _set_signal(self, word: SetSignal) -> Skill:
        yield
        self._cell.update_signal(word.signal, self._now_ns, signal_of(word.value))
        return skills.SUCCESS

    def _as_it_behaves(self, node: Node, skill: Skill) -> Skill:
        if node.kind != "SetGripper" and self._rng.random() < self.behavior.failing:
            return (yield from self._given_up(skill))
        result = yield from skill
        lost = node.kind in ("Place", "Drop") and self.held != node.port("object") and result.failure is not None
        if lost and self.behavior.opens_on_loss and self.gripper == "closed":
            yield from skills.open_gripper(self._world)
        return result

    def _given_up(self, skill: Skill) -> Skill:
        """A skill that fails for nothing while the hand is on its way."""
        for _ in range(int(self._rng.integers(1, RESUMES_BEFORE_FAILURE))):
            try:
                yield next(skill)
            except StopIteration as end:
                return end.value if isinstance(end.value, SkillResult) else skills.SUCCESS
        self._world.arm.hold()
        return SkillResult(Failure("random"))

    # -- time ----------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Let one period pass: the arm goes on, the camera looks again."""
        self.steps += 1
        self._hand_is_clear = True
        self._let_live(self.steps * PERIOD_S)
        self._perceive()

    def _let_live(self, until_s: float) -> None:
        world = self._world
        while world.time_s < until_s - 1e-9:
            if world.activity is None and world.rest:
                world.pause(until_s - world.time_s)
            else:
                world.step()

    def _perceive(self) -> None:
        """Look at everything: by the truth for `table`, through the camera for the robot."""
        self._now_ns += PERIOD_NS
        now_ns, shown = self._now_ns, self._world.shown()
        self.table = Table(self.bodies, {name: Spot.of(pose) for name, pose in shown.items()}, self._rng)
        for name, pose in self._world.camera.observe(shown).items():
            self._cell.update_pose(name, now_ns, pose)
        self._cell.update_pose(scenarios.TOOL, now_ns, self._world.arm.tool_pose @ self._end_effector)
        self._cell.update_gripper(now_ns, self._world.gripper.state)

    # -- a human's hands -----------------------------------------------------------------------------------------

    def lay(self, name: str, spot: Spot) -> None:
        """Put an object onto whatever lies under `spot` (its z unused); what stood on it falls."""
        picture = Table(self.bodies, self.table.spots, self._rng)
        picture.lay(name, spot)
        self._put({name: picture.spots[name].pose()})

    def carry(self, name: str, spot: Spot) -> None:
        """Move an object with all that stands on it."""
        motion = spot.pose() @ self.spot(name).pose().inverse()
        moved = [name, *sorted(self.table.load(name) - {self.held or ""})]
        self._put({each: motion @ self._world.pose_in_base(each) for each in moved})

    def take_away(self, spot: Spot) -> None:
        """Pull the held object out of the fingers, which stay closed, and lay it at `spot`."""
        if self.held:
            self.lay(self.held, spot)

    def hand_is_clear(self) -> bool:
        """Whether nothing was put into the arm since the last step."""
        return self._hand_is_clear

    def remember(self) -> _Memory:
        """What `recall` needs."""
        return _Memory(self._world.poses_in_base(), self.held)

    def recall(self, memory: _Memory) -> None:
        """Let everything stand, and be held, as it was at `remember`."""
        for name, pose in memory.poses.items():
            self._world.put(name, pose)
        if memory.held:
            self._world.gripper.grasp_again(memory.held)
        self._settle()
        self._hand_is_clear = True

    def _put(self, poses: Mapping[str, Pose]) -> None:
        for name, pose in poses.items():
            self._hand_is_clear &= self._world.put(name, pose)
        self._settle()

    def _settle(self) -> None:
        """Let things come to rest, and the camera look again; the arm waits, and no time is counted."""
        world = self._world
        activity, now_s, world.activity = world.activity, world.time_s, None
        while not world.rest and world.time_s < now_s + SETTLED_S:
            world.step()
        world.activity, world.time_s = activity, now_s
        self._perceive()


def _as_simulated(body: Body) -> scenarios.Body:
    volume = sum(4 * solid.half_x * solid.half_y * (solid.top - solid.bottom) for solid in body.solids)
    wall_m = WALL_M if body.kind == "open_box" else None
    shape = body.shape
    return scenarios.Body(shape.size_m, DENSITY_KG_PER_M3 * volume, shape.symmetry, wall_m, body.graspable)


def _as_simulated_noise(noise: Noise) -> camera.Noise:
    """The same angle on average: the camera's is given by axis."""
    return camera.Noise(noise.position_m, noise.angle_rad / math.sqrt(3))
