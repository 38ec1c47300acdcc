"""A fast world without dynamics, in which trees are judged by the truth (issue: thousands of runs with many seeds).

An arm that is a point with a gripper moves among upright bodies on a table; gravity is `learner.simulation.gravity`.
The world offers the leaves of `learner.execution.ticking` as CONTRACT, section 3, describes the cell's nodes: what a
leaf learns comes through a noisy camera, what happens is decided by the truth. The end-effector frame is the point
between the fingertips, its z pointing down along the approach.

    world = KinematicWorld(bodies, spots, rng)
    ticker = Ticker(tree.flattened(), world)
    while ticker.tick() is not Status.SUCCESS:
        world.step()
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from learner.errors import LearnerError
from learner.execution.entries import Found
from learner.execution.perception import query_of
from learner.execution.ticking import Status
from learner.model import Motion as MotionWord
from learner.model import Node, Pose
from learner.model.condition import GripperState
from learner.model.frame import START, is_composed, objects_of, pose_of
from learner.model.holding import Grasp, Sighting, Sizes, grasped
from learner.model.names import NONE
from learner.model.pose import IDENTITY_XYZW, Quaternion, Vector, rotated
from learner.model.query import CountAt, SignalIs, signal_of
from learner.model.scene import Scene
from learner.model.tree import Value
from learner.model.turning import turned_rad
from learner.model.upright import Spot, spot_of
from learner.relations import answering
from learner.relations.answering import Answering, Signal
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.simulation.failure import Failure
from learner.simulation.gravity import GIVE_M, Body, Table

PERIOD_S: Final = 0.1
"""One step of the world, and one tick [s]."""
PERIOD_NS: Final = round(PERIOD_S * 1e9)
GRASP_M: Final = 0.01
"""A grasp holds if the fingers close at most this far from the object's axis [m] ..."""
GRASP_HEIGHT_M: Final = 0.02
"""... and this far above or below its centre [m], of a tall body until above or below its sides ..."""
TIP_M: Final = 0.005
"""The fingers' least hold on a body's sides [m]."""
GRASP_RAD: Final = math.radians(15)
"""... and turned by at most this much from one of its faces, and from the vertical [rad]."""
HOVER_M: Final = 0.12
"""Height of the poses before and after an action above its target [m]."""
TRAVEL_STEPS: Final = 3
LIFT_STEPS: Final = 3
"""A lift takes so long [steps] that what does not follow is seen to stay behind before the pick ends."""
FINGER_M: Final = 0.01
"""Half the thickness of the hand above the fingers, for contacts [m]."""
PALM_M: Final = 0.045
"""Length of the fingers: the hand begins this far above the fingertips [m]."""

WORKSPACE_M: Final = ((0.2, 0.9), (-0.6, 0.6))
REACH_M: Final = 0.1
"""The arm reaches this far beyond the workspace [m]."""

Motion = Generator[None, None, Failure | None]
"""One step of the arm at each `next`; returns the failure, or None for success."""


@dataclass(frozen=True)
class Noise:
    """Of the camera at run time: standard deviations of each coordinate [m] and of the angle [rad]."""

    position_m: float = 0.003
    angle_rad: float = math.radians(1.0)


NOISELESS: Final = Noise(0.0, 0.0)


@dataclass
class Attempt:
    """An action as the world saw it: what was tried, when [steps], and how it failed (None: it did not, or runs)."""

    kind: str
    object: str
    frame: str
    step: int
    failure: Failure | None = None
    ended: bool = False


@dataclass
class Faults:
    """What went wrong, counted: collisions of hand or held object, and picks that closed on another object."""

    contacts: int = 0
    wrong_picks: int = 0


@dataclass
class _UnderWay:
    node: Node
    motion: Motion
    attempt: Attempt
    gripper: GripperState
    held: str
    ended: bool = False


@dataclass
class Behavior:
    """What the contract leaves open or a cell may do badly: `failing` is the share of actions that fail for nothing.

    With `opens_on_loss`, a Place whose object was lost on the way opens the gripper before it fails.
    """

    failing: float = 0.0
    opens_on_loss: bool = False


@dataclass
class KinematicWorld:
    """Bodies on a table, an arm, a camera; implements `learner.execution.ticking.Leaves`.

    bodies, spots: what there is and where it stands. `knowledge` is that of the tree; `signals` is what machines say.
    `markers` are the rotations by which a marker is glued crooked: the camera reports the body's pose turned by it. Use
    the leaves (`check`, `find`, `tick_action`, `halt_action`) with `step` between ticks to run a tree; `move_hand`,
    `close`, `open` to be the arm oneself; `table` for the truth and `lay`, `carry`, `take_away` to disturb.
    """

    bodies: Mapping[str, Body]
    spots: Mapping[str, Spot]
    rng: np.random.Generator
    noise: Noise = field(default_factory=Noise)
    base_frame: str = "base"
    markers: Mapping[str, Quaternion] = field(default_factory=dict)
    behavior: Behavior = field(default_factory=Behavior)
    workspace_m: tuple[tuple[float, float], tuple[float, float]] = WORKSPACE_M
    sizes: Sizes | None = None
    end_effector: Vector = (0.0, 0.0, 0.0)
    knowledge: Knowledge = UNKNOWING

    def __post_init__(self) -> None:
        self._began = dict(self.spots)
        self.table = Table(self.bodies, self.spots, self.rng)
        self.hand: Vector = (0.45, 0.0, 0.4)
        self.hand_xyzw: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.gripper: GripperState = "open"
        self.held: str | None = None
        self.faults = Faults()
        self.attempts: list[Attempt] = []
        self.steps = 0
        self._grip: Spot | None = None
        self._load: frozenset[str] = frozenset()
        self._grasp: Grasp | None = None
        self._sizes = (
            {name: body.shape.size_m for name, body in self.bodies.items()} if self.sizes is None else self.sizes
        )
        self.signals: dict[str, Signal] = {}
        self._answering = Answering(self._scene(), self.knowledge)
        self._under_way: _UnderWay | None = None
        self._begun: dict[str, Sighting] = {}
        self._answered_at: tuple[int, str, Vector] | None = None
        self._last_answered: answering.Seen | None = None
        self._seen: dict[str, Sighting] = {}
        self._known_ports: dict[int, tuple[Node, Mapping[str, Value]]] = {}
        self._draws: Iterator[list[float]] = iter(())

    # -- what is true --------------------------------------------------------------------------------------------

    def spot(self, name: str) -> Spot:
        """Where an object, a frame or the base really is."""
        if name == self.base_frame:
            return Spot(0.0, 0.0, 0.0, 0.0)
        if name.endswith(START):
            return self._began[name.removesuffix(START)]
        return self.table.spots.get(name) or spot_of(name, self.table.spots)

    @property
    def hand_spot(self) -> Spot:
        """The fingertips; the yaw is that of the end-effector's x axis."""
        x, y, z, w = self.hand_xyzw
        return Spot(*self.hand, math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))

    # -- leaves --------------------------------------------------------------------------------------------------

    def check(self, node: Node) -> bool:
        """Whether a condition holds for the robot: by camera and gripper, not by the truth."""
        ports = self._ports(node)
        if node.kind == "GripperIs":
            return self._gripper_now == ports["state"]
        if node.kind == "InGripper":
            return self._held_now == ports["object"]
        if node.kind in ("SignalIs", "CountAt"):
            word = node.word
            assert isinstance(word, SignalIs | CountAt)
            return self._answering.holds(word, self._answered())
        return self._is_at(node.kind, ports)

    def find(self, node: Node) -> Found | None:
        """What a query finds for the robot: by the camera, not by the truth."""
        return self._answering.find(query_of(node), self._answered())

    def _answered(self) -> answering.Seen:
        """What was seen in this step, made once."""
        now = self.steps, self._held_now, self.hand
        if self._answered_at != now or self._last_answered is None:
            held, poses = self._held_now, {name: Pose(*self.see(name)) for name in self.table.spots}
            hand = Pose(self.hand, self.hand_xyzw)
            self._answered_at = now
            self._last_answered = answering.Seen(poses, hand, None if held == NONE else held, self._frame, self.signals)
        return self._last_answered

    def _frame(self, name: str) -> Pose:
        return Pose(*self.see(name))

    def _scene(self) -> Scene:
        """What the robot knows of the bodies; nothing where it is told no sizes."""
        shapes = {name: body.shape for name, body in self.bodies.items() if name in self._sizes}
        return Scene(shapes, self.workspace_m)

    def _ports(self, node: Node) -> Mapping[str, Value]:
        """The ports as a dictionary, made once per leaf; the node is kept so that its id stays its own."""
        known = self._known_ports.get(id(node))
        if known is None:
            known = self._known_ports[id(node)] = node, dict(node.ports)
        return known[1]

    @property
    def _gripper_now(self) -> GripperState:
        return self._under_way.gripper if self._under_way else self.gripper

    @property
    def _held_now(self) -> str:
        return self._under_way.held if self._under_way else self.believed

    @property
    def believed(self) -> str:
        """What the robot believes to hold: CONTRACT, section 3, InGripper."""
        return self._grasp.object if self._grasp and not self._grasp.lost else NONE

    @property
    def _end_effector(self) -> Sighting:
        """Where the end-effector is; the robot knows it without looking."""
        (x, y, z), (a, b, c) = self.hand, rotated(self.hand_xyzw, self.end_effector)
        return (x + a, y + b, z + c), self.hand_xyzw

    def _is_at(self, kind: str, ports: Mapping[str, Value]) -> bool:
        name = str(ports["object"])
        if name == self.believed:
            return False
        target = self._in_base(str(ports["frame"]), ports["position"])  # type: ignore[arg-type]  # ports are checked by Tree
        position = self.see(name)[0]
        height = 0.0 if kind == "ObjectRoughlyAt" else position[2] - target[2]
        distance = math.hypot(position[0] - target[0], position[1] - target[1], height)
        near = distance <= float(ports["radius"])  # type: ignore[arg-type]  # as above
        return near and (kind != "ObjectPosedAt" or self._is_turned(name, ports))

    def _is_turned(self, name: str, ports: Mapping[str, Value]) -> bool:
        inside = (Pose(*self.see(str(ports["frame"]))).inverse() @ Pose(*self.see(name))).quaternion_xyzw
        symmetry = self.bodies[name].shape.symmetry
        return turned_rad(inside, ports["orientation"], symmetry) <= float(ports["angle"])  # type: ignore[arg-type]  # as above

    def _in_base(self, frame: str, position: Vector) -> Vector:
        origin, quaternion = self.see(frame)
        turned = rotated(quaternion, position)
        return (origin[0] + turned[0], origin[1] + turned[1], origin[2] + turned[2])

    def tick_action(self, node: Node) -> Status:
        """Start the action, or tell how it goes. A start while another is under way ends that one where it is."""
        if self._under_way is None or self._under_way.node is not node:
            self._start(node)
        now = self._under_way
        if now is None or not now.ended:
            return Status.RUNNING
        self._under_way = None
        return Status.SUCCESS if now.attempt.failure is None else Status.FAILURE

    def _start(self, node: Node) -> None:
        ports = dict(node.ports)
        attempt = Attempt(node.kind, str(ports.get("object", "")), str(ports.get("frame", "")), self.steps)
        self.attempts.append(attempt)
        held, gripper = self.believed, self.gripper
        self._under_way = _UnderWay(node, self._motion(node), attempt, gripper, held)
        self._advance()

    def halt_action(self, node: Node) -> None:
        """Stop the arm, leave the fingers as they are."""
        if self._under_way and self._under_way.node is node:
            self._under_way = None

    def step(self) -> None:
        """Let one period pass: the arm goes on, the camera looks again."""
        self.steps += 1
        self._seen.clear()
        if self._under_way and not self._under_way.ended:
            self._advance()
        self._notice_slip()

    def _advance(self) -> None:
        now = self._under_way
        if now is None:
            return
        try:
            next(now.motion)
        except StopIteration as end:
            now.ended = now.attempt.ended = True
            now.attempt.failure = end.value
            self._learn_of(now)

    def _learn_of(self, ended: _UnderWay) -> None:
        """A grasp that has failed is not the first to be tried again; with a closed gripper none was tried."""
        if ended.node.kind == "Pick" and ended.attempt.failure is not None and ended.gripper != "closed":
            word = ended.node.word
            assert isinstance(word, MotionWord)
            self._answering.grasping.failed(word.object, Pose(*self.see(word.object)), word.pose)

    # -- camera --------------------------------------------------------------------------------------------------

    def see(self, name: str) -> Sighting:
        """The pose that the camera gives for a frame, the same for everyone until the next step."""
        if name not in self._seen:
            if name == self.base_frame:
                return (0.0, 0.0, 0.0), IDENTITY_XYZW
            if name.endswith(START):
                return self._see_begin(*objects_of(name))
            if is_composed(name):
                pose = pose_of(name, lambda each: Pose(*self.see(each)))
                return pose.position, pose.quaternion_xyzw
            if name not in self.table.spots:
                raise LearnerError(f"there is no {name!r} in this world; there are {', '.join(self.table.spots)}")
            self._seen[name] = self._look(name, self.table.spots[name])
        return self._seen[name]

    def _see_begin(self, name: str) -> Sighting:
        """Where an object was seen at the beginning."""
        if name not in self._begun:
            self._begun[name] = self._look(name, self._began[name])
        return self._begun[name]

    def _look(self, name: str, spot: Spot) -> Sighting:
        (dx, dy, dz, angle, *axis) = self._draw()
        quaternion: Quaternion = (0.0, 0.0, math.sin(spot.yaw / 2), math.cos(spot.yaw / 2))
        if name in self.markers:
            quaternion = _multiply(quaternion, self.markers[name])
        half = 0.5 * self.noise.angle_rad * angle / (math.hypot(*axis) or 1.0)
        shaken = _multiply(quaternion, _unit((half * axis[0], half * axis[1], half * axis[2], 1.0)))
        sigma = self.noise.position_m
        return (spot.x + sigma * dx, spot.y + sigma * dy, spot.z + sigma * dz), shaken

    def _draw(self) -> list[float]:
        """Seven normal numbers; drawn in bulk, because one by one numpy is slow."""
        draw = next(self._draws, None)
        if draw is None:
            self._draws = iter(self.rng.standard_normal((256, 7)).tolist())
            draw = next(self._draws)
        return draw

    # -- gripper -------------------------------------------------------------------------------------------------

    def move_hand(self, position: Vector, quaternion_xyzw: Quaternion | None = None) -> None:
        """Put the end-effector there at once, with what it holds; nothing collides on the way."""
        self.hand = position
        self.hand_xyzw = quaternion_xyzw or self.hand_xyzw
        if self.held and self._grip:
            self.table.spots[self.held] = self.hand_spot.compose(self._grip)
            self._shed()

    def _shed(self) -> None:
        """What stood on the held object when it was grasped falls as it moves: a fault like a contact."""
        if self._load:
            self.faults.contacts += 1
            load, self._load = self._load, frozenset()
            self.table.settle(load)

    def close(self) -> None:
        """Close the fingers: what is graspable between them is held from now on."""
        if self.gripper == "closed":
            return
        self.gripper = "closed"
        self.held = next((name for name in self.table.spots if self._grasps(name)), None)
        self._grip = self.hand_spot.relative(self.table.spots[self.held]) if self.held else None
        self._load = frozenset(self.table.load(self.held)) if self.held else frozenset()
        self._believe()

    def open(self) -> None:
        """Open the fingers: what was held falls."""
        self.gripper, self._grasp, self._load = "open", None, frozenset()
        if self.held:
            name, self.held = self.held, None
            self.table.drop(name, self.table.spots[name])

    def _grasps(self, name: str) -> bool:
        body, spot, hand = self.table.bodies[name], self.table.spots[name], self.hand_spot
        beside = math.hypot(hand.x - spot.x, hand.y - spot.y)
        if (
            not body.graspable
            or beside > GRASP_M
            or abs(hand.z - spot.z) > max(GRASP_HEIGHT_M, body.half_height - TIP_M)
        ):
            return False
        turn = abs(math.remainder(hand.yaw - spot.yaw, math.pi / 2))
        round_body = body.shape.symmetry == "vertical"
        return (round_body or turn <= GRASP_RAD) and self._tilt() <= GRASP_RAD

    def _tilt(self) -> float:
        """Angle [rad] between the approach (z of the end-effector) and straight down."""
        return math.acos(max(-1.0, min(1.0, -rotated(self.hand_xyzw, (0.0, 0.0, 1.0))[2])))

    def _believe(self) -> None:
        self._grasp = grasped(self._end_effector, {name: self.see(name) for name in self.table.spots}, self._sizes)

    def _notice_slip(self) -> None:
        if self._grasp is not None:
            position, _ = self.see(self._grasp.object)
            self._grasp.follow(self.steps * PERIOD_NS, self._end_effector, position)

    def take_away(self, spot: Spot) -> None:
        """A human pulls the held object out of the fingers, which stay closed, and puts it down at `spot`."""
        if self.held:
            name, self.held = self.held, None
            self.table.lay(name, spot)

    def lay(self, name: str, spot: Spot) -> None:
        """A human puts an object that is not held onto whatever lies under `spot`; what stood on it falls."""
        self.table.lay(name, spot)

    def carry(self, name: str, spot: Spot) -> None:
        """A human moves an object with all that stands on it."""
        self.table.carry(name, spot)

    def remember(self) -> tuple[dict[str, Spot], str | None]:
        """What `recall` needs."""
        return dict(self.table.spots), self.held

    def recall(self, memory: tuple[dict[str, Spot], str | None]) -> None:
        """Let everything stand, and be held, as it was at `remember`."""
        spots, self.held = memory
        self.table.spots.update(spots)

    def hand_is_clear(self) -> bool:
        """Whether nothing lies upon what is held: nobody lays a thing in the air."""
        return self.held is None or not self.table.covered(self.held)

    def reaches(self, position: Vector) -> bool:
        """Whether the arm can bring its fingertips there [m]."""
        return reachable(position, self.workspace_m)

    # -- motions -------------------------------------------------------------------------------------------------

    def _motion(self, node: Node) -> Motion:
        if node.kind == "SetGripper":
            return self._set_gripper(str(node.port("state")))
        if node.kind == "SetSignal":
            return self._set_signal(str(node.port("signal")), str(node.port("value")))
        return self._pick(node) if node.kind == "Pick" else self._release(node)

    def _set_gripper(self, state: str) -> Motion:
        yield
        if state == "open":
            self.open()
        else:
            self.close()
        return None

    def _set_signal(self, name: str, value: str) -> Motion:
        yield
        self.signals[name] = signal_of(value)
        return None

    def _pick(self, node: Node) -> Motion:
        name = str(node.port("object"))
        if self.gripper == "closed":
            return Failure("gripper closed", name)
        failure = yield from self._approach(node)
        if failure:
            return failure
        self.close()
        if self.held not in (None, name):
            self.faults.wrong_picks += 1
        yield
        self._lift()
        for _ in range(LIFT_STEPS):
            yield
        return None if self.held == name else Failure("missed", name, self.held)

    def _release(self, node: Node) -> Motion:
        name = str(node.port("object"))
        failure = yield from self._approach(node)
        if failure:
            return failure
        if self.held != name:
            if self.behavior.opens_on_loss:
                self.open()
            return Failure("not held", name, self.held)
        self.open()
        yield
        self._lift()
        yield
        return None

    def _approach(self, node: Node) -> Motion:
        """To above the target, then down to it; the failure if the arm cannot or collides."""
        pose = Pose(node.port("position"), node.port("orientation"))  # type: ignore[arg-type]  # checked by Tree
        origin, quaternion = self.see(str(node.port("frame")))
        target = Pose(origin, quaternion) @ pose
        if not self.reaches(target.position):
            return Failure("out of reach", at=target.position)
        yield from self._travel(target)
        self.move_hand(target.position)
        failure = self._contact() or self._random_failure()
        if failure:
            self._lift()
            return failure
        yield
        return None

    def _travel(self, target: Pose) -> Generator[None, None, None]:
        x, y, z = target.position
        begin, above = self.hand, (x, y, z + HOVER_M)
        for step in range(1, TRAVEL_STEPS + 1):
            part = step / TRAVEL_STEPS
            arch = 0.2 * math.sin(math.pi * part)
            way = tuple(b + part * (a - b) for a, b in zip(above, begin, strict=True))
            self.move_hand((way[0], way[1], way[2] + arch), target.quaternion_xyzw)
            yield

    def _lift(self) -> None:
        x, y, z = self.hand
        self.move_hand((x, y, z + HOVER_M))

    def _contact(self) -> Failure | None:
        """What the hand or the held object meets where the hand is now."""
        if self._tilt() > math.radians(40) or self.hand[2] < 0.0:
            met: str | None = "the table"
        else:
            met = self.met_by_held() or self._met_by_hand()
        if met is None:
            return None
        self.faults.contacts += 1
        return Failure("contact", with_=met)

    def met_by_held(self) -> str | None:
        """What the held object collides with where it is now, if anything."""
        if not self.held:
            return None
        hull = self.table.footprint(self.held)
        if hull.bottom < -GIVE_M:
            return "the table"
        high = (block for block in self.table.obstacles({self.held}) if block.top > hull.bottom + GIVE_M)
        return next((block.name for block in high if block.overlaps(hull)), None)

    def _met_by_hand(self) -> str | None:
        x, y, z = self.hand
        high = (block for block in self.table.obstacles({self.held or ""}) if block.top > z + PALM_M)
        return next((block.name for block in high if block.covers(x, y, FINGER_M)), None)

    def _random_failure(self) -> Failure | None:
        fails = self.behavior.failing > 0 and self.rng.random() < self.behavior.failing
        return Failure("random") if fails else None


def reachable(position: Vector, workspace_m: tuple[tuple[float, float], tuple[float, float]] = WORKSPACE_M) -> bool:
    """Whether the arm can bring its fingertips there [m]."""
    (x0, x1), (y0, y1) = workspace_m
    x, y, _ = position
    return x0 - REACH_M <= x <= x1 + REACH_M and y0 - REACH_M <= y <= y1 + REACH_M


def _multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product in plain floats: a tick has no time for numpy's overhead on four numbers."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _unit(quaternion: Quaternion) -> Quaternion:
    x, y, z, w = quaternion
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / norm, y / norm, z / norm, w / norm)
