"""Tasks as data. To add one, write the placements of its demonstration down and say what must hold at the end.

A `ScriptedMove` is a pick and a place (or drop) of one object: where its origin comes to rest, in which frame. Starts
are drawn anywhere on the table, any yaw, nothing overlapping, such that the demonstration is possible. Lengths [m],
angles [rad].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from learner.model import ObjectShape, Scene
from learner.model.pose import Vector
from learner.model.upright import Spot
from learner.simulation.gravity import WALL_M, Body
from learner.simulation.kinematic_world import WORKSPACE_M
from learner.simulation.script import Inside, MoveType, Rests, ScriptedMove

BASE = "base"
CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))
MARKED = Body(ObjectShape((0.05, 0.05, 0.05), "none"))
BOX = Body(ObjectShape((0.3, 0.3, 0.08), "box"), "open_box")
BOARD = Body(ObjectShape((0.36, 0.16, 0.02), "none"))
ON_TABLE = CUBE.half_height
ON_TOP: Vector = (0.0, 0.0, 0.05)
IN_BOX = WALL_M + CUBE.half_height - BOX.half_height
"""Height of a cube's origin on the floor of the box, in the box's frame."""
ON_BOARD = BOARD.half_height + CUBE.half_height
OVER_BOX: Vector = (0.0, 0.0, 0.1)

Relation = Rests | Inside
Goal = tuple[Relation, ...]
"""What must hold together."""


@dataclass(frozen=True)
class Start:
    """What is special about the starts.

    `stacks` are towers from the bottom up. Each of `near` (object, of, offset, spread) stands about that offset from
    another object; exactly there and aligned with it if the spread is 0. `fixed` objects stand at a spot of the base;
    those of `about` within a standard deviation [m] of one, turned by five times as many [rad].
    """

    stacks: tuple[tuple[str, ...], ...] = ()
    near: tuple[tuple[str, str, Vector, float], ...] = ()
    fixed: Mapping[str, Spot] | None = None
    about: Mapping[str, tuple[Spot, float]] | None = None


def _everywhere(x: float, y: float) -> bool:
    return True


@dataclass(frozen=True)
class Scenario:
    """A task: the objects, the ways in which it is demonstrated, the goals of which one must hold in the end.

    With `any_order`, a demonstrator shuffles the steps. `clear` [m] is kept free between things at the start. `least`
    is the fewest demonstrations from which the task can be learned: three of each way.
    """

    name: str
    objects: Mapping[str, Body]
    scripts: tuple[tuple[ScriptedMove, ...], ...]
    goals: tuple[Goal, ...]
    start: Start = Start()
    any_order: bool = False
    clear: float = 0.02
    least: int = 3
    reaches: Callable[[float, float], bool] = _everywhere
    """Whether an arm reaches what stands at a point of the table [m]."""

    @property
    def placements(self) -> int:
        """k: the distinct demonstrated placements, contexts counted."""
        return len({(step, position) for script in self.scripts for position, step in enumerate(script)} if self.repeats
                   else {step for script in self.scripts for step in script})  # fmt: skip

    @property
    def repeats(self) -> bool:
        """Whether one placement occurs twice in one demonstration (in two contexts)."""
        return any(len(set(script)) < len(script) for script in self.scripts)

    @property
    def scene(self) -> Scene:
        """What the recorder writes about the shapes (CONTRACT, section 2)."""
        return Scene({name: body.shape for name, body in self.objects.items()}, WORKSPACE_M)

    def reached(self, spots: Mapping[str, Spot], held: str | None = None) -> bool:
        """Whether the task is done, by the truth: all relations of one goal hold and nothing is held."""
        return held is None and any(all(self.holds(relation, spots) for relation in goal) for goal in self.goals)

    def holds(self, relation: Relation, spots: Mapping[str, Spot]) -> bool:
        """Whether a relation holds."""
        frame = spots.get(relation.frame, ORIGIN)
        at = frame.relative(spots[relation.object])
        if isinstance(relation, Rests):
            return math.dist((at.x, at.y, at.z), relation.at) <= relation.radius_m
        half_x, half_y, half_z = (size / 2 for size in self.objects[relation.frame].shape.size_m)
        return abs(at.x) < half_x and abs(at.y) < half_y and abs(at.z) < half_z

    def draw_start(
        self, rng: np.random.Generator, script: tuple[ScriptedMove, ...] | None = None, tries: int = 5000
    ) -> dict[str, Spot]:
        """Random spots from which the task can be done without meeting anything.

        To demonstrate `script`, nothing that it moves stands at its place already. Raises RuntimeError if no start is
        found.
        """
        for _ in range(tries):
            spots = _drawn(self, rng)
            ways = (*self._relevant(script), *(_as_steps(goal) for goal in self.goals))
            if spots is None or not all(_possible(self, spots, steps) for steps in ways):
                continue
            if script is None or _worth_showing(spots, script):
                return spots
        raise RuntimeError(f"no start was found for {self.name}; its objects do not fit on the table")

    def _relevant(self, script: tuple[ScriptedMove, ...] | None) -> tuple[tuple[ScriptedMove, ...], ...]:
        return (script,) if script else self.scripts


WORTH_MOVING_M = 0.12
"""Nobody demonstrates a placement by moving something less far than this [m]."""
ORIGIN = Spot(0.0, 0.0, 0.0, 0.0)


def _drawn(scenario: Scenario, rng: np.random.Generator) -> dict[str, Spot] | None:
    """One attempt; None where things overlap."""
    spots: dict[str, Spot] = dict(scenario.start.fixed or {})
    spots |= {name: _about(home, sigma, rng) for name, (home, sigma) in (scenario.start.about or {}).items()}
    stacked = {name: (below, level) for stack in scenario.start.stacks for level, (name, below) in
               enumerate(zip(stack[1:], stack, strict=False), start=1)}  # fmt: skip
    beside = {name: rule for name, *rule in scenario.start.near}
    for name, body in sorted(scenario.objects.items(), key=lambda item: -item[1].radius):
        if name not in spots and name not in stacked and name not in beside:
            spots[name] = _anywhere(body, scenario.reaches, rng)
    for name, (of, offset, spread) in beside.items():
        x, y, z = offset
        shift = rng.uniform(-spread, spread, 2)
        near = spots[of].compose(Spot(x + shift[0], y + shift[1], z, 0.0))
        spots[name] = replace(near, yaw=float(rng.uniform(-math.pi, math.pi))) if spread else near
    for stack in scenario.start.stacks:
        for name in stack[1:]:
            spots[name] = _atop(scenario, spots, name, *stacked[name], rng)
    on_table = [name for name in spots if name not in stacked]
    if not all(scenario.reaches(spots[name].x, spots[name].y) for name in on_table):
        return None
    within = {(name, of) for name, (of, _, spread) in beside.items() if spread == 0.0}
    return spots if _apart(scenario, spots, on_table, within) else None


def _anywhere(body: Body, reaches: Callable[[float, float], bool], rng: np.random.Generator) -> Spot:
    (x0, x1), (y0, y1) = WORKSPACE_M
    edge = body.radius if body.kind == "open_box" or not body.graspable else 0.03
    while True:
        x, y = rng.uniform(x0 + edge, x1 - edge), rng.uniform(y0 + edge, y1 - edge)
        yaw = rng.uniform(-math.pi, math.pi)
        if reaches(x, y):
            return Spot(float(x), float(y), body.half_height, float(yaw))


def _about(home: Spot, sigma: float, rng: np.random.Generator) -> Spot:
    dx, dy, turn = (sigma * rng.standard_normal(3)).tolist()
    return Spot(home.x + dx, home.y + dy, home.z, home.yaw + 5 * turn)


def _atop(scenario: Scenario, spots: Mapping[str, Spot], name: str, below: str, level: int,
          rng: np.random.Generator) -> Spot:  # fmt: skip
    height = scenario.objects[below].half_height + scenario.objects[name].half_height
    return spots[below].compose(Spot(0.0, 0.0, height, float(rng.uniform(-0.1, 0.1))))


def _apart(scenario: Scenario, spots: Mapping[str, Spot], names: list[str], within: set[tuple[str, str]]) -> bool:
    """Whether nothing is near another, but for what is put exactly there."""
    pairs = ((a, b) for a, b in combinations(names, 2) if (a, b) not in within and (b, a) not in within)
    return all(_gap(scenario, spots, a, b) >= scenario.clear for a, b in pairs)


def _gap(scenario: Scenario, spots: Mapping[str, Spot], a: str, b: str) -> float:
    """A lower bound of the distance [m] between two footprints: of their circles, or of a circle and a rectangle."""
    return max(_outside(scenario, spots, a, b), _outside(scenario, spots, b, a))


def _outside(scenario: Scenario, spots: Mapping[str, Spot], a: str, b: str) -> float:
    """Distance from the circle about `a` to the rectangle of `b`."""
    x, y = spots[b].within(spots[a].x, spots[a].y)
    half_x, half_y = (size / 2 for size in scenario.objects[b].shape.size_m[:2])
    return math.hypot(max(abs(x) - half_x, 0.0), max(abs(y) - half_y, 0.0)) - scenario.objects[a].radius


def _as_steps(goal: Goal) -> tuple[ScriptedMove, ...]:
    """A goal straight away, without what a script does on the way; goals are written from below."""
    return tuple(ScriptedMove("place", r.object, r.frame, r.at, r.yaw) for r in goal if isinstance(r, Rests))


def _worth_showing(spots: Mapping[str, Spot], script: tuple[ScriptedMove, ...]) -> bool:
    """Whether every step moves its object away from where it stands."""
    now = dict(spots)
    for step in script:
        before, there = now[step.object], now.get(step.frame, ORIGIN).compose(Spot(*step.at, step.yaw or 0.0))
        if math.dist((before.x, before.y), (there.x, there.y)) < WORTH_MOVING_M:
            return False
        now[step.object] = there
    return True


def _possible(scenario: Scenario, spots: Mapping[str, Spot], steps: tuple[ScriptedMove, ...]) -> bool:
    """Whether every placement of the demonstration finds its place in reach and free."""
    (x0, x1), (y0, y1) = WORKSPACE_M
    now = dict(spots)
    for step in steps:
        frame = now.get(step.frame, ORIGIN)
        there = frame.compose(Spot(*step.at, step.yaw or 0.0))
        if not (x0 <= there.x <= x1 and y0 <= there.y <= y1 and scenario.reaches(there.x, there.y)):
            return False
        now[step.object] = there
        if not _free(scenario, now, step) or not _free(scenario, {**spots, step.object: there}, step):
            return False
        if step.type == "drop":
            now[step.object] = replace(there, z=ON_TABLE)
    return True


def _free(scenario: Scenario, spots: Mapping[str, Spot], step: ScriptedMove) -> bool:
    """Whether nothing but what belongs there stands at the place of a step: what is lower carries it."""
    name, there = step.object, spots[step.object]
    bottom = there.z - scenario.objects[name].half_height
    others = (o for o in spots if o != name and o != step.frame and not _holds_from_below(scenario, spots, o, bottom))
    moved = {s.object for script in scenario.scripts for s in script}
    return all(_gap(scenario, spots, name, other) >= (0.01 if other in moved else scenario.clear) for other in others)


def _holds_from_below(scenario: Scenario, spots: Mapping[str, Spot], name: str, bottom_m: float) -> bool:
    """Whether it carries what has its bottom there; a box, only what does not go through its floor."""
    body = scenario.objects[name]
    if body.kind == "open_box":
        return spots[name].z + WALL_M - body.half_height <= bottom_m + 0.002
    return spots[name].z + body.half_height <= bottom_m + 0.01


def tower(base: ScriptedMove | None, *names: str, verb: MoveType = "place") -> tuple[ScriptedMove, ...]:
    """The steps that build a tower of `names` from the bottom up; `base` places the lowest one first."""
    upwards = tuple(ScriptedMove(verb, upper, lower, ON_TOP) for lower, upper in pairwise(names))
    return (base, *upwards) if base else upwards


def stacked(*names: str) -> Goal:
    """Each of `names` stands on the one before it."""
    return tuple(Rests(upper, lower, ON_TOP, 0.03) for lower, upper in pairwise(names))


def on_spot(name: str, x: float, y: float) -> ScriptedMove:
    """Place a cube on the table at (x, y) of the base."""
    return ScriptedMove("place", name, BASE, (x, y, ON_TABLE))


def goal_of(*steps: ScriptedMove) -> Goal:
    """The end state of steps, each taken literally: a drop into a box is inside it, a place within 5 cm."""
    return tuple(
        Inside(step.object, step.frame) if step.type == "drop" else Rests(step.object, step.frame, step.at)
        for step in steps
    )


def _slots(names: str) -> tuple[ScriptedMove, ...]:
    places = [(x, y) for y in (-0.06, 0.06) for x in (-0.09, 0.0, 0.09)]
    return tuple(
        ScriptedMove("place", name, "box", (x, y, IN_BOX)) for name, (x, y) in zip(names, places, strict=False)
    )


def _cubes(names: str) -> dict[str, Body]:
    return dict.fromkeys(names, CUBE)


OBJECT_IN_BOX = (ScriptedMove("drop", "A", "box", OVER_BOX),)
TOWER_AND_BOX = (*tower(None, "E", "D", "F"), *OBJECT_IN_BOX)
TOWERS = (*tower(on_spot("A", 0.4, -0.3), *"ABC"), *tower(on_spot("D", 0.4, 0.3), *"DEF"))
HANOI = (
    on_spot("D", 0.4, 0.3),
    on_spot("E", 0.4, 0.0),
    ScriptedMove("place", "D", "E", ON_TOP),
    on_spot("F", 0.4, 0.3),
    on_spot("D", 0.4, -0.3),
    ScriptedMove("place", "E", "F", ON_TOP),
    ScriptedMove("place", "D", "E", ON_TOP),
)
BESIDE = (ScriptedMove("place", "A", "R", (0.12, 0.0, 0.0)),)
LEAPFROG = (
    ScriptedMove("place", "A", "R", (0.0, 0.12, 0.0)),
    ScriptedMove("place", "R", "A", (0.0, 0.12, 0.0)),
    ScriptedMove("place", "B", "R", (0.0, 0.12, 0.0)),
)
LEFT_AND_RIGHT = (
    ScriptedMove("place", "circle", "square", (0.0, 0.12, 0.0)),
    ScriptedMove("place", "triangle", "circle", (0.12, 0.0, 0.0)),
    ScriptedMove("place", "circle", "square", (0.0, -0.12, 0.0)),
    ScriptedMove("place", "triangle", "circle", (0.12, 0.0, 0.0)),
)
ON_A_BOARD = tuple(
    ScriptedMove("place", name, "board", (x, 0.0, ON_BOARD)) for name, x in zip("ABC", (-0.12, 0.0, 0.12), strict=True)
)
HERE, THERE = tower(on_spot("A", 0.4, -0.3), *"ABC"), tower(on_spot("A", 0.6, 0.3), *"ABC")
TWICE = (
    on_spot("A", 0.35, -0.3),
    on_spot("B", 0.35, 0.3),
    ScriptedMove("place", "A", "board", (-0.12, 0.0, ON_BOARD)),
    ScriptedMove("place", "B", "A", ON_TOP),
)
PYRAMID = (
    on_spot("A", 0.4, 0.2),
    ScriptedMove("place", "B", "A", (0.0, 0.07, 0.0)),
    ScriptedMove("place", "C", "A", (0.0, 0.035, 0.05)),
)
SORTING = (
    ScriptedMove("drop", "A", "left", (-0.07, 0.0, 0.1)),
    ScriptedMove("drop", "B", "left", (0.07, 0.0, 0.1)),
    ScriptedMove("drop", "C", "right", (-0.07, 0.0, 0.1)),
    ScriptedMove("drop", "D", "right", (0.07, 0.0, 0.1)),
)


def _listed(*scenarios: Scenario) -> dict[str, Scenario]:
    return {scenario.name: scenario for scenario in scenarios}


PAPER = _listed(
    Scenario("object_in_box", {**_cubes("A"), "box": BOX}, (OBJECT_IN_BOX,), (goal_of(*OBJECT_IN_BOX),)),
    Scenario(
        "towers",
        _cubes("ABCDEF"),
        (TOWERS,),
        ((Rests("A", BASE, TOWERS[0].at), Rests("D", BASE, TOWERS[3].at), *stacked(*"ABC"), *stacked(*"DEF")),),
    ),
    Scenario(
        "hanoi",
        _cubes("DEF"),
        (HANOI,),
        ((Rests("F", BASE, HANOI[3].at), *stacked(*"FED")),),
        Start(stacks=(("F", "E", "D"),)),
    ),
    Scenario(
        "kitting4", {**_cubes("ABCD"), "box": BOX}, (_slots("ABCD"),), (goal_of(*_slots("ABCD")),), any_order=True
    ),
    Scenario(
        "kitting6", {**_cubes("ABCDEF"), "box": BOX}, (_slots("ABCDEF"),), (goal_of(*_slots("ABCDEF")),), any_order=True
    ),
    Scenario(
        "tower_and_box",
        {**_cubes("ADEF"), "box": BOX},
        (TOWER_AND_BOX,),
        ((*stacked("E", "D", "F"), Inside("A", "box")),),
    ),
)
"""The paper's tasks a) to e)."""

OWN = _listed(
    Scenario(
        "decoy",
        {**_cubes("ARX"), "box": BOX},
        (BESIDE,),
        (goal_of(*BESIDE),),
        Start(near=(("X", "R", (0.22, 0.0, 0.0), 0.02),)),
    ),
    Scenario(
        "moving_reference",
        {**_cubes("ABX"), "R": CUBE},
        (LEAPFROG,),
        (goal_of(*LEAPFROG[1:]),),
    ),
    Scenario(
        "left_and_right",
        {"triangle": MARKED, "circle": CUBE, "square": CUBE},
        (LEFT_AND_RIGHT,),
        (goal_of(*LEFT_AND_RIGHT[2:]),),
    ),
    Scenario("board", {**_cubes("ABC"), "board": BOARD}, (ON_A_BOARD,), (goal_of(*ON_A_BOARD),)),
    Scenario(
        "two_goals",
        {**_cubes("ABC"), "box": BOX},
        (HERE, THERE),
        tuple((Rests("A", BASE, way[0].at), *stacked(*"ABC")) for way in (HERE, THERE)),
        least=6,
    ),
    Scenario(
        "placed_twice",
        {**_cubes("AB"), "board": BOARD},
        (TWICE,),
        ((Rests("A", "board", TWICE[2].at), *stacked("A", "B")),),
    ),
    Scenario("pyramid", _cubes("ABC"), (PYRAMID,), (goal_of(*PYRAMID),)),
    Scenario(
        "sorting",
        {**_cubes("ABCD"), "left": BOX, "right": BOX},
        (SORTING,),
        (goal_of(*SORTING),),
        any_order=True,
    ),
)
"""Tasks of our own, that stress frames and contexts."""

SCENARIOS = PAPER | OWN
