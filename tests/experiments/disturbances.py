"""What happens to a robot at work, as data: each disturbance does one thing to the world and says what, or None.

None means that it cannot happen now (nothing is held, no cube is free); the runner then tries again later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, TypeVar

import numpy as np

from learner.model.upright import Spot
from learner.simulation.arena import Arena
from learner.simulation.gravity import GIVE_M
from learner.simulation.kinematic_world import WORKSPACE_M
from learner.simulation.script import Rests, ScriptedMove

from .scenarios import Goal, Relation, Scenario

T = TypeVar("T")
Happening = Callable[[Arena, Scenario, np.random.Generator], str | None]
When = Literal["progress", "after"]

FREE_M: Final = 0.03
"""What a human puts on the table keeps this distance from everything [m]."""
NEAR_M: Final = 0.01
"""What is nearer to a goal place than this may be in the way [m]."""
ATTEMPTS: Final = 20
BESIDE_M: Final = 0.075
"""Distance of the origins of two cubes put close beside each other [m]: nearer than a drop's tolerance."""


@dataclass(frozen=True)
class Disturbance:
    """Something that happens once, at a random point of the robot's progress or after success; or all along."""

    name: str
    happen: Happening | None = None
    failing: float = 0.0
    """The share of skills that fail without reason, all along."""
    at_start: bool = False
    """It has happened before the robot begins."""
    after: bool = True
    """Whether it can happen after success too."""
    beyond: bool = False
    """It may leave what no demonstration shows a way out of: a covered cube, an occupied place (issue: recovery)."""

    def apply(self, world: Arena, scenario: Scenario, rng: np.random.Generator, actions_left: int) -> str | None:
        """Let it happen if it can, such that the task can still be done in so many actions; says what happened."""
        for _ in range(ATTEMPTS if self.happen else 0):
            memory = world.remember()
            what = self.happen(world, scenario, rng) if self.happen else None
            if what is None or (world.hand_is_clear() and can_be_done(world, scenario, self.beyond, actions_left)):
                return what
            world.recall(memory)
        return None


def far(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """An uncovered cube is moved somewhere else on the table."""
    name = _one_of(_free_cubes(world, scenario), rng)
    spot = name and free_spot(world, name, rng)
    if not name or not spot:
        return None
    world.lay(name, spot)
    return f"{name} was moved far"


def beside(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """An uncovered cube is put down close beside another object that stands on the table."""
    name = _one_of(_free_cubes(world, scenario), rng)
    other = _one_of([o for o in _cubes(scenario) if o != name and o != world.held and _on_table(world, o)], rng)
    if not name or not other:
        return None
    for angle in rng.uniform(-math.pi, math.pi, 20).tolist():
        at = world.spot(other)
        spot = Spot(at.x + BESIDE_M * math.cos(angle), at.y + BESIDE_M * math.sin(angle), 0.0, at.yaw)
        in_reach = world.reaches((spot.x, spot.y, spot.z))
        if in_reach and _is_free(world, name, spot, 0.005, {other}):
            world.lay(name, spot)
            return f"{name} was moved beside {other}"
    return None


def on_top(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """An uncovered cube is put on top of another uncovered one."""
    cubes = _free_cubes(world, scenario)
    if len(cubes) < 2:
        return None
    upper, lower = (str(name) for name in rng.choice(sorted(cubes), 2, replace=False))
    world.lay(upper, world.spot(lower))
    return f"{upper} was put on {lower}"


def on_goal(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """A cube is put where another one belongs; if that one is there already, it is moved far before."""
    cubes = _free_cubes(world, scenario)
    for relation in _shuffled([r for r in _relations(scenario) if isinstance(r, Rests)], rng):
        there = scenario.holds(relation, world.table.spots)
        name = _one_of([cube for cube in cubes if cube not in (relation.object, relation.frame)], rng)
        if not name or relation.frame == world.held or (there and relation.object not in cubes):
            continue
        away = free_spot(world, relation.object, rng)
        if there and away:
            world.lay(relation.object, away)
        spot = world.spot(relation.frame).compose(Spot(*relation.at, relation.yaw))
        if _is_free(world, name, spot, 0.0, {*_ungraspable(scenario), relation.frame}):
            world.lay(name, spot)
            return f"{name} was put where {relation.object} belongs"
    return None


def taken(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """The held cube is taken out of the gripper and laid elsewhere."""
    name = world.held
    spot = name and free_spot(world, name, rng)
    if not name or not spot:
        return None
    world.take_away(spot)
    return f"{name} was taken away"


def container(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """A box or board is moved and turned with its content."""
    name = _one_of(_ungraspable(scenario), rng)
    spot = name and free_spot(world, name, rng, world.table.load(name))
    if not name or not spot:
        return None
    world.carry(name, spot)
    return f"{name} was moved with its content"


def helper(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """A human does one step of the task that is not done yet."""
    cubes = _free_cubes(world, scenario)
    for relation in _relations(scenario):
        done = scenario.holds(relation, world.table.spots)
        if (
            not done
            and relation.object in cubes
            and relation.frame != world.held
            and _put(world, scenario, relation, rng)
        ):
            return f"a human put {relation.object} to its place"
    return None


def covered(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """A covered cube is pulled out and laid elsewhere; what stood on it falls."""
    cubes = [name for name in _cubes(scenario) if name != world.held and world.table.covered(name)]
    name = _one_of(cubes, rng)
    spot = name and free_spot(world, name, rng)
    if not name or not spot:
        return None
    world.lay(name, spot)
    return f"{name} was pulled out from below"


def buried(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """A tower is moved as a whole, so that a covered cube stands where it is not wanted."""
    bases = [n for n in _cubes(scenario) if n != world.held and world.table.covered(n) and _on_table(world, n)]
    name = _one_of(bases, rng)
    spot = name and free_spot(world, name, rng)
    if not name or not spot:
        return None
    world.carry(name, replace(spot, z=world.spot(name).z))
    return f"the tower on {name} was moved as a whole"


def wrong_tower(world: Arena, scenario: Scenario, rng: np.random.Generator) -> str | None:
    """All cubes that are free are stacked upon each other in a random order (at most three)."""
    names = _shuffled(_free_cubes(world, scenario), rng)[:3]
    if len(names) < 2 or not all(_on_table(world, name) for name in names):
        return None
    for lower, upper in pairwise(names):
        world.lay(upper, world.spot(lower))
    return f"a tower of {', '.join(names)} was built from the bottom up"


DISTURBANCES: Final[Mapping[str, Disturbance]] = {
    disturbance.name: disturbance
    for disturbance in (
        Disturbance("far", far),
        Disturbance("beside", beside),
        Disturbance("on_top", on_top, beyond=True),
        Disturbance("on_goal", on_goal, beyond=True),
        Disturbance("taken", taken, after=False),
        Disturbance("container", container),
        Disturbance("helper", helper, after=False),
        Disturbance("failing", failing=0.2, after=False),
        Disturbance("covered", covered, beyond=True),
        Disturbance("buried", buried, beyond=True),
        Disturbance("wrong_tower", wrong_tower, at_start=True, after=False, beyond=True),
    )
}


def can_be_done(world: Arena, scenario: Scenario, beyond: bool, actions_left: int) -> bool:
    """Whether every place of a goal is in reach, not in the air, and free: of everything, or of what cannot be moved.

    In the air is a place whose reference was put on top of something; no demonstration tells where that belongs. And
    whether any robot could do it in so many actions, and what is placed on the way has its places open as well.
    """
    return any(_way_is_open(world, scenario, script) for script in scenario.scripts) and any(
        _goal_can_be_done(world, scenario, goal, beyond) and least_actions(world, scenario, goal) <= actions_left
        for goal in scenario.goals
    )


def _way_is_open(world: Arena, scenario: Scenario, script: tuple[ScriptedMove, ...]) -> bool:
    """Whether every place of a script is in reach, and free of what cannot be moved, if it is done from here."""
    fixed = world.table.obstacles(_cubes(scenario))
    moved: dict[str, Spot] = {}
    for step in script:
        frame = moved.get(step.frame) or world.spot(step.frame)
        there = moved[step.object] = frame.compose(Spot(*step.at, step.yaw or 0.0))
        hull = world.table.footprint(step.object, there)
        blocked = any(b.overlaps(hull) and b.top > hull.bottom + GIVE_M and b.bottom < hull.top for b in fixed)
        if blocked or not world.reaches((there.x, there.y, there.z)):
            return False
    return True


def least_actions(world: Arena, scenario: Scenario, goal: Goal) -> int:
    """A lower bound of the actions that must still begin to reach a goal from here, by the truth.

    A pick and a release for each object that is not in its place; the same for each that stands upon one or in its
    place, twice for those that belong where they stand; and for a held object whose place is not ready, putting it
    down and taking it again. What has begun counts as done.
    """
    missing = [relation for relation in goal if not scenario.holds(relation, world.table.spots)]
    moved = {relation.object for relation in missing}
    occupants = {relation.object: _occupants(world, scenario, goal, relation) for relation in missing}
    in_the_way = set().union(*(world.table.load(name) | occupants[name] for name in moved)) - moved
    belonging = in_the_way & {relation.object for relation in goal}
    waiting = any(r.object == world.held and (r.frame in moved or occupants[r.object]) for r in missing)
    return 2 * (len(moved) + len(in_the_way) + len(belonging) + waiting) - _begun(world, moved | in_the_way, waiting)


def _begun(world: Arena, moved: set[str], waiting: bool) -> int:
    """How many of the picks and releases of these objects are done or under way."""
    last = world.attempts[-1] if world.attempts else None
    under_way = last is not None and not last.ended and last.object in moved
    if world.held in moved:
        return 1 + (under_way and not waiting)
    return int(under_way)


def _goal_can_be_done(world: Arena, scenario: Scenario, goal: Goal, beyond: bool) -> bool:
    for relation in goal:
        there = _place(world, goal, relation)
        if not world.reaches((there.x, there.y, there.z)):
            return False
        blocking = _occupants(world, scenario, goal, relation)
        if any(not beyond or not world.bodies[name].graspable for name in blocking):
            return False
        if _hangs(world, scenario, goal, relation):
            return False
    return True


def needs_recovery(world: Arena, scenario: Scenario) -> bool:
    """Whether something stands on a cube that must be moved, or where one must go: for every goal, by the truth."""
    return all(_goal_needs_recovery(world, scenario, goal) for goal in scenario.goals)


def _goal_needs_recovery(world: Arena, scenario: Scenario, goal: Goal) -> bool:
    missing = [relation for relation in goal if not scenario.holds(relation, world.table.spots)]
    return any(
        world.table.covered(relation.object) or _occupants(world, scenario, goal, relation) for relation in missing
    )


def _place(world: Arena, goal: Goal, relation: Relation) -> Spot:
    """Where the object of a relation shall be once the goal is reached; frames that are placed too come first."""
    there = Spot(*relation.at, relation.yaw) if isinstance(relation, Rests) else Spot(0.0, 0.0, 0.0, 0.0)
    frame = next((other for other in goal if other.object == relation.frame), None)
    origin = _place(world, goal, frame) if frame else world.spot(relation.frame)
    return origin.compose(there)


def _occupants(world: Arena, scenario: Scenario, goal: Goal, relation: Relation) -> set[str]:
    """What stands where the object of a relation shall be."""
    if not isinstance(relation, Rests) or scenario.holds(relation, world.table.spots):
        return set()
    hull = world.table.footprint(relation.object, _place(world, goal, relation))
    others = world.table.obstacles({relation.object, world.held or ""})
    near = (b for b in others if b.overlaps(hull, -NEAR_M))
    return {b.name for b in near if b.top > hull.bottom + GIVE_M and b.bottom < hull.top}


def _hangs(world: Arena, scenario: Scenario, goal: Goal, relation: Relation) -> bool:
    """Whether the place is in the air because its frame, which nothing in the goal places, does not stand as it did."""
    if not isinstance(relation, Rests) or any(other.object == relation.frame for other in goal):
        return False
    there = _place(world, goal, relation)
    return world.table.footprint(relation.object, there).bottom > world.table.support_m(relation.object, there) + GIVE_M


def free_spot(world: Arena, name: str, rng: np.random.Generator, ignored: set[str] | None = None) -> Spot | None:
    """A random spot on the table where a body stands free; None if a hundred draws find none."""
    (x0, x1), (y0, y1) = WORKSPACE_M
    body = world.bodies[name]
    edge = body.radius if not body.graspable else 0.03
    for _ in range(100):
        x, y = rng.uniform(x0 + edge, x1 - edge), rng.uniform(y0 + edge, y1 - edge)
        spot = Spot(float(x), float(y), body.half_height, float(rng.uniform(-math.pi, math.pi)))
        in_reach = world.reaches((spot.x, spot.y, spot.z))
        if in_reach and _is_free(world, name, spot, FREE_M, ignored or set()):
            return spot
    return None


def _is_free(world: Arena, name: str, spot: Spot, gap: float, ignored: set[str]) -> bool:
    hull = world.table.footprint(name, spot)
    others = (block for block in world.table.obstacles({name, *ignored, world.held or ""}))
    return not any(block.overlaps(hull, -gap) for block in others)


def _put(world: Arena, scenario: Scenario, relation: Relation, rng: np.random.Generator) -> bool:
    """Put an object where a relation wants it, if the place is free; whether it holds now."""
    if isinstance(relation, Rests):
        there = Spot(*relation.at, relation.yaw)
    else:
        there = Spot(*rng.uniform(-0.05, 0.05, 2).tolist(), 0.0, 0.0)
    memory = world.remember()
    world.lay(relation.object, world.spot(relation.frame).compose(there))
    if scenario.holds(relation, world.table.spots):
        return True
    world.recall(memory)
    return False


def _relations(scenario: Scenario) -> tuple[Relation, ...]:
    """Of the first goal, what must hold first before what needs it, as goals are written from below."""
    return scenario.goals[0]


def _cubes(scenario: Scenario) -> list[str]:
    return [name for name, body in scenario.objects.items() if body.graspable]


def _ungraspable(scenario: Scenario) -> list[str]:
    return [name for name, body in scenario.objects.items() if not body.graspable]


def _free_cubes(world: Arena, scenario: Scenario) -> list[str]:
    return [name for name in _cubes(scenario) if name != world.held and not world.table.covered(name)]


def _on_table(world: Arena, name: str) -> bool:
    return abs(world.spot(name).z - world.bodies[name].half_height) < 0.005


def _one_of(names: list[str], rng: np.random.Generator) -> str | None:
    return str(rng.choice(sorted(names))) if names else None


def _shuffled(items: list[T], rng: np.random.Generator) -> list[T]:
    return [items[index] for index in rng.permutation(len(items))]
