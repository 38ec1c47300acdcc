"""What the physical cell can be asked to show: the things on its table, how they start, what is done, what is the goal.

A scenario is data: to add one, add an entry to SCENARIOS. Positions are of an object's own origin (its centre) in
metres; frames are objects or BASE. The five are those of the paper's experiments a) to e), with cubes of 5 cm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from learner.errors import LearnerError
from learner.model import ObjectShape, Pose, Scene
from learner.model.pose import Vector
from learner.model.scene import Range, Symmetry
from learner.simulation.script import Inside, Rests, ScriptedMove

BASE: Final = "base"
TOOL: Final = "tool0"
CUBE_M: Final = 0.05
REACH_M: Final = (0.38, 0.70)
"""Distances from the base's axis at which the arm can grasp and stack everywhere."""
REACH_RAD: Final = math.radians(75)
"""To either side of straight ahead."""
WORKSPACE_M: Final = ((0.36, 0.60), (-0.36, 0.36))
"""The largest upright rectangle that is all within reach."""
ANYWHERE: Final[Range] = (-math.inf, math.inf)
FINGER_ROOM_M: Final = 0.14
"""Between the centres of two cubes, so that the hand fits beside a tower on either at any yaw."""
HAND_ROOM_M: Final = 0.13
"""Between the centre of a cube and what is wide, so that the hand fits at any yaw."""


class UnknownScenarioError(LearnerError):
    """A scenario that is not among SCENARIOS."""

    def __init__(self, name: str) -> None:
        super().__init__(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")


class NoStartError(LearnerError):
    """No random start without overlap was found: the table is too full."""


@dataclass(frozen=True)
class Body:
    """A thing on the table: a solid block, or with `wall_m` an open container whose walls and floor are that thick."""

    size_m: Vector
    mass_kg: float
    symmetry: Symmetry = "none"
    wall_m: float | None = None
    graspable: bool = False

    @property
    def shape(self) -> ObjectShape:
        return ObjectShape(self.size_m, self.symmetry)


CUBE: Final = Body((CUBE_M, CUBE_M, CUBE_M), 0.1, "cube", graspable=True)
BOX: Final = Body((0.30, 0.30, 0.08), 0.8, "box", wall_m=0.005)
TRAY: Final = Body((0.30, 0.30, 0.03), 0.8, "none", wall_m=0.005)
BOARD: Final = Body((0.42, 0.10, 0.01), 0.8, "none")


@dataclass(frozen=True)
class On:
    """`upper` stands on `lower`, centred within 2 cm: the towers' goal."""

    upper: str
    lower: str


Relation = On | Rests | Inside


@dataclass(frozen=True)
class Scenario:
    """`orders` are the orders in which people do the steps; `stacked` objects start on others, not on their own.

    `workspace_m` is the upright rectangle in which all that stands on its own begins; None: anywhere in reach.
    """

    bodies: Mapping[str, Body]
    steps: tuple[ScriptedMove, ...]
    goal: tuple[Relation, ...]
    orders: tuple[tuple[int, ...], ...] = ()
    stacked: tuple[Rests, ...] = field(default=())
    workspace_m: tuple[Range, Range] | None = None

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(sorted(self.bodies))

    @property
    def scene(self) -> Scene:
        return Scene({name: body.shape for name, body in self.bodies.items()}, self.workspace_m or WORKSPACE_M)

    def reached(self, poses_in_base: Mapping[str, Pose]) -> bool:
        """Whether every relation of the goal holds at these true poses."""
        return all(self._holds(relation, poses_in_base) for relation in self.goal)

    def _holds(self, relation: Relation, poses: Mapping[str, Pose]) -> bool:
        match relation:
            case On(upper, lower):
                x, y, z = np.subtract(poses[upper].position, poses[lower].position)
                height = (self.bodies[upper].size_m[2] + self.bodies[lower].size_m[2]) / 2
                return math.hypot(x, y) < 0.02 and abs(z - height) < 0.01
            case Rests(name, frame, position, radius):
                there = position if frame == BASE else poses[frame].apply(position)
                return math.dist(poses[name].position, there) < radius
            case Inside(name, container):
                x, y, z = poses[container].inverse().apply(poses[name].position)
                length, width, height = self.bodies[container].size_m
                return abs(x) < length / 2 and abs(y) < width / 2 and abs(z) < height / 2

    def step_orders(self) -> tuple[tuple[int, ...], ...]:
        """The orders in which the steps may be done; the written one where none is given."""
        return self.orders or (tuple(range(len(self.steps))),)


def scenario_named(name: str) -> Scenario:
    """The scenario of that name. Raises UnknownScenarioError."""
    if name not in SCENARIOS:
        raise UnknownScenarioError(name)
    return SCENARIOS[name]


def sample_start(scenario: Scenario, rng: np.random.Generator) -> dict[str, Pose]:
    """A random start: every object anywhere in reach at any yaw, none touching another or in another's way.

    Raises NoStartError if a thousand tries find no room.
    """
    for _ in range(1000):
        start = _try_start(scenario, rng)
        if start is not None:
            return start
    raise NoStartError(f"found no start for {', '.join(scenario.objects)}: the table is too full for the fingers")


def sample_spot(scenario: Scenario, name: str, others: Mapping[str, Pose], rng: np.random.Generator) -> Pose:
    """A random free spot in reach for one object among others at their poses in the base.

    Raises NoStartError if a thousand tries find none.
    """
    for pose in _candidates(scenario, name, rng, tries=1000):
        if _fits(scenario, name, pose, others):
            return pose
    raise NoStartError(f"found no free spot for {name}: the table is too full")


def _try_start(scenario: Scenario, rng: np.random.Generator) -> dict[str, Pose] | None:
    stacked = {relation.object for relation in scenario.stacked}
    own = sorted(set(scenario.bodies) - stacked, key=lambda name: (-scenario.bodies[name].size_m[0], name))
    poses: dict[str, Pose] = {}
    for name in own:
        pose = next((pose for pose in _candidates(scenario, name, rng) if _fits(scenario, name, pose, poses)), None)
        if pose is None:
            return None
        poses[name] = pose
    for relation in scenario.stacked:
        position = poses[relation.frame].apply(relation.at)
        poses[relation.object] = _standing(position, float(rng.uniform(-math.pi, math.pi)))
    return poses


def _candidates(scenario: Scenario, name: str, rng: np.random.Generator, tries: int = 60) -> Iterator[Pose]:
    height = scenario.bodies[name].size_m[2]
    for _ in range(tries):
        distance = math.sqrt(rng.uniform(REACH_M[0] ** 2, REACH_M[1] ** 2))
        direction = rng.uniform(-REACH_RAD, REACH_RAD)
        position = (distance * math.cos(direction), distance * math.sin(direction), height / 2)
        yield _standing(position, float(rng.uniform(-math.pi, math.pi)))


def _fits(scenario: Scenario, name: str, pose: Pose, others: Mapping[str, Pose]) -> bool:
    return _in_reach(scenario, name, pose) and all(
        _clear(scenario.bodies[name], pose, scenario.bodies[other], at) for other, at in others.items()
    )


def _in_reach(scenario: Scenario, name: str, pose: Pose) -> bool:
    """Whether the hand reaches the object and every place on it that a step needs, and the base is left free."""
    places = [step.at for step in scenario.steps if step.frame == name]
    places += [relation.at for relation in scenario.stacked if relation.frame == name]
    points = [pose.position, *(pose.apply(place) for place in places)]
    (x0, x1), (y0, y1) = scenario.workspace_m or (ANYWHERE, ANYWHERE)
    if not (x0 <= pose.position[0] <= x1 and y0 <= pose.position[1] <= y1):
        return False
    within = all(REACH_M[0] <= math.hypot(x, y) <= REACH_M[1] for x, y, _ in points)
    return within and _distance_to(scenario.bodies[name], pose, (0.0, 0.0)) > 0.2


def _clear(body: Body, pose: Pose, other: Body, at: Pose) -> bool:
    if not body.graspable and not other.graspable:
        return math.dist(pose.position, at.position) > (max(body.size_m) + max(other.size_m)) / math.sqrt(2)
    if body.graspable and other.graspable:
        return math.dist(pose.position, at.position) > FINGER_ROOM_M
    wide, where, cube = (other, at, pose) if body.graspable else (body, pose, at)
    return _distance_to(wide, where, cube.position) > HAND_ROOM_M


def _distance_to(body: Body, pose: Pose, point: Sequence[float]) -> float:
    """The horizontal distance [m] from a point of the base to the outline of a standing body; 0 inside."""
    x, y, _ = pose.inverse().apply((point[0], point[1], pose.position[2]))
    return math.hypot(max(abs(x) - body.size_m[0] / 2, 0.0), max(abs(y) - body.size_m[1] / 2, 0.0))


def _standing(position: Vector, yaw_rad: float) -> Pose:
    return Pose(position, (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))


ON_TOP: Final = (0.0, 0.0, CUBE_M)
OVER_BOX: Final = (0.0, 0.0, 0.09)
_SLOTS: Final = tuple((x, y, -0.015 + 0.005 + CUBE_M / 2) for x in (-0.06, 0.06) for y in (-0.06, 0.06))
_PEGS: Final = tuple((x, 0.0, 0.005 + CUBE_M / 2) for x in (-0.15, 0.0, 0.15))

SCENARIOS: Final[Mapping[str, Scenario]] = {
    "object_in_box": Scenario(
        {"A": CUBE, "box": BOX},
        (ScriptedMove("drop", "A", "box", OVER_BOX, spread_m=0.015),),
        (Inside("A", "box"),),
    ),
    "towers": Scenario(
        dict.fromkeys("ABCDEF", CUBE),
        (
            ScriptedMove("place", "B", "C", ON_TOP),
            ScriptedMove("place", "A", "B", ON_TOP),
            ScriptedMove("place", "E", "F", ON_TOP),
            ScriptedMove("place", "D", "E", ON_TOP),
        ),
        (On("B", "C"), On("A", "B"), On("E", "F"), On("D", "E")),
        orders=((0, 1, 2, 3), (2, 3, 0, 1), (0, 2, 1, 3)),
    ),
    "tower_and_box": Scenario(
        {**dict.fromkeys("ADEF", CUBE), "box": BOX},
        (
            ScriptedMove("place", "D", "E", ON_TOP),
            ScriptedMove("place", "F", "D", ON_TOP),
            ScriptedMove("drop", "A", "box", OVER_BOX, spread_m=0.015),
        ),
        (On("D", "E"), On("F", "D"), Inside("A", "box")),
        orders=((0, 1, 2), (2, 0, 1)),
    ),
    "kitting": Scenario(
        {**dict.fromkeys("ABCD", CUBE), "tray": TRAY},
        tuple(ScriptedMove("place", name, "tray", slot) for name, slot in zip("ABCD", _SLOTS, strict=True)),
        tuple(Rests(name, "tray", slot) for name, slot in zip("ABCD", _SLOTS, strict=True)),
        orders=((0, 1, 2, 3), (3, 1, 0, 2), (2, 3, 1, 0), (1, 0, 3, 2)),
    ),
    "hanoi": Scenario(
        {**dict.fromkeys("DEF", CUBE), "board": BOARD},
        (
            ScriptedMove("place", "D", "board", _PEGS[2]),
            ScriptedMove("place", "E", "board", _PEGS[1]),
            ScriptedMove("place", "D", "E", ON_TOP),
            ScriptedMove("place", "F", "board", _PEGS[2]),
            ScriptedMove("place", "D", "board", _PEGS[0]),
            ScriptedMove("place", "E", "F", ON_TOP),
            ScriptedMove("place", "D", "E", ON_TOP),
        ),
        (Rests("F", "board", _PEGS[2]), On("E", "F"), On("D", "E")),
        stacked=(Rests("F", "board", _PEGS[0]), Rests("E", "F", ON_TOP), Rests("D", "E", ON_TOP)),
    ),
}
