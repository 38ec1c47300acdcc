"""What could be: starts and events of rollouts, rollouts from what was demonstrated.

A seeded imagination puts things where the demonstrations did not: everything elsewhere, something on or beside a
goal's place, something upon what is to be moved, something taken out of the hand. In each the task can still be done.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from learner.model.condition import ObjectRoughlyAt
from learner.model.upright import Spot
from learner.rehearsal.goal import Goal, Relation, holds
from learner.rehearsal.stage import Points, Spots, Stage, Start
from learner.simulation.arena import Arena
from learner.simulation.gravity import GIVE_M, Table

STEPS_PER_ACTION: Final = 7


@dataclass(frozen=True)
class Rollout:
    """A run to be done: from `spots`, which are the start of a demonstration with a `change`.

    `event` happens at step `due` or as soon after as it can. `in_the_way` counts things put there.
    """

    demonstration_id: str
    spots: Spots
    kind: str = "shown"
    change: str = ""
    event: Callable[[Arena, np.random.Generator], bool] | None = None
    due: int = 0
    in_the_way: int = 0

    def __str__(self) -> str:
        return f"from the start of demonstration {self.demonstration_id}{self.change and ' with ' + self.change}"


def rollouts(stage: Stage, goals: Sequence[Goal], picks: frozenset[str], seed: int = 0) -> Iterator[Rollout]:
    """The rollouts: from the demonstrations' starts, and from changed ones in which the task can still be done.

    `picks` are the objects that the tree can put aside. Among points nothing is in the way of anything. Another `seed`
    imagines otherwise.
    """
    numbers = stage.parameters.rollouts
    worlds = ((start, stage.world(start.spots, _rng(0))) for start in stage.starts)
    starts = [start for start, world in worlds if _can_be_done(world, goals, picks, numbers.clear_m)]
    yield from (Rollout(start.demonstration_id, start.spots) for start in starts[: numbers.shown])
    makers = _Maker(stage, goals, picks)
    for number, (kind, count) in enumerate(numbers.kinds.items() if starts else ()):
        for index in range(count):
            if not stage.points or kind in ("taken", "moved"):
                made = makers.make(kind, index, starts[index % len(starts)], _rng(seed, number + 2, index))
                yield from [made] if made else []


def _rng(*numbers: int) -> np.random.Generator:
    return np.random.default_rng(list(numbers))


class _Maker:
    """Makes rollouts of each kind."""

    def __init__(self, stage: Stage, goals: Sequence[Goal], picks: frozenset[str]) -> None:
        self.stage, self.goals, self.picks, self.parameters = stage, goals, picks, stage.parameters.rollouts
        self._makers = {
            "scattered": self._scattered,
            "occupied": self._occupied,
            "partly": self._partly,
            "covered": self._covered,
            "tower": self._tower,
            "taken": self._taken,
            "moved": self._moved,
        }
        (x0, x1), (y0, y1) = stage.workspace_m
        scene = stage.scene.workspace_m if stage.scene else None
        shift_x, shift_y, _ = stage.shift
        if scene:
            (a0, a1), (b0, b1) = scene
            x0, x1, y0, y1 = a0 + shift_x, a1 + shift_x, b0 + shift_y, b1 + shift_y
        self.room_m = (x0, x1), (y0, y1)

    def make(self, kind: str, index: int, start: Start, rng: np.random.Generator) -> Rollout | None:
        """A rollout of a kind; None if no attempt gives one in which the task can be done."""
        for _ in range(self.parameters.draws):
            world = self.stage.world(start.spots, rng)
            made = self._makers[kind](Rollout(start.demonstration_id, {}, kind), world, rng, index)
            if made is not None and _can_be_done(world, self.goals, self.picks, self.parameters.clear_m):
                return replace(made, spots=dict(world.table.spots))
        return None

    def _scattered(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """Everything that stands on the table is carried elsewhere and turned, with what stands on it."""
        table = world.table
        ground = [name for name in table.spots if _bottom(table, name) < GIVE_M and _near(world, name)]
        aside = {name: table.load(name) for name in ground}
        placed: set[str] = set()
        for name in sorted(ground, key=lambda name: (-table.bodies[name].radius, name)):
            others = set(table.spots) - placed - aside[name]
            spot = self._free(world, name, rng, others | aside[name])
            if spot is None:
                return None
            table.carry(name, spot)
            placed |= {name} | aside[name]
        return replace(rollout, change="everything elsewhere")

    def _occupied(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """A thing stands on the place of another."""
        return self._in_the_way(rollout, world, rng, index, 0.0)

    def _partly(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """A thing stands partly on the place of another."""
        return self._in_the_way(rollout, world, rng, index, float(rng.uniform(*self.parameters.partly_m)))

    def _in_the_way(
        self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int, away_m: float
    ) -> Rollout | None:
        goal = self.goals[index % len(self.goals)]
        if not goal.grounded:
            return None
        relation = goal.grounded[index // len(self.goals) % len(goal.grounded)]
        name = _one_of(self._loose(world) - {relation.object, relation.frame}, rng)
        if name is None or holds(relation, world):
            return None
        angle, yaw = rng.uniform(-math.pi, math.pi, 2).tolist()
        place = goal.place(relation, world)
        beside = replace(place, x=place.x + away_m * math.cos(angle), y=place.y + away_m * math.sin(angle), yaw=yaw)
        if not _is_free(world, name, replace(beside, z=place.z), 0.0, {*self._fixed(world), relation.frame}):
            return None
        world.table.lay(name, beside)
        where = f"{'partly ' if away_m else ''}on the place of {relation.object}"
        return replace(rollout, change=f"{name} {where}", in_the_way=1)

    def _covered(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """A thing stands on one that is to be moved."""
        objects = self.goals[index % len(self.goals)].objects
        if not objects:
            return None
        lower = objects[index // len(self.goals) % len(objects)]
        name = _one_of(self._loose(world) - {lower}, rng)
        if name is None or world.table.covered(lower):
            return None
        world.table.lay(name, replace(world.spot(lower), yaw=float(rng.uniform(-math.pi, math.pi))))
        return replace(rollout, change=f"{name} upon {lower}", in_the_way=1) if lower in _under(world, name) else None

    def _tower(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """A pile of three."""
        names = [str(name) for name in rng.permutation(sorted(self._loose(world)))][:3]
        if len(names) < 2 or any(_bottom(world.table, name) > GIVE_M for name in names):
            return None
        for lower, upper in pairwise(names):
            world.table.lay(upper, world.spot(lower))
        return replace(rollout, change=f"a pile of {', '.join(names)}", in_the_way=len(names) - 1)

    def _taken(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """What is held is taken out of the hand."""

        def take(running: Arena, rng: np.random.Generator) -> bool:
            spot = self._free(running, running.held, rng, set()) if running.held else None
            if spot is not None:
                running.take_away(spot)
            return spot is not None

        due = int(rng.integers(1, STEPS_PER_ACTION * self.goals[0].actions))
        return replace(rollout, change="what is held taken away", event=take, due=due, in_the_way=1)

    def _moved(self, rollout: Rollout, world: Arena, rng: np.random.Generator, index: int) -> Rollout | None:
        """Something is moved elsewhere meanwhile."""

        def move(running: Arena, rng: np.random.Generator) -> bool:
            name = _one_of(self._loose(running), rng)
            before = running.remember()
            spot = self._free(running, name, rng, set()) if name else None
            if name is None or spot is None:
                return False
            running.lay(name, spot)
            if _can_be_done(running, self.goals, self.picks, self.parameters.clear_m):
                return True
            running.recall(before)
            return False

        due = int(rng.integers(1, STEPS_PER_ACTION * self.goals[0].actions))
        return replace(rollout, change="something moved meanwhile", event=move, due=due)

    def _loose(self, world: Arena) -> set[str]:
        """What the tree can put aside and nothing stands on."""
        names = {name for name in self.picks if name != world.held and _near(world, name)}
        return {name for name in names if not world.table.covered(name)}

    def _fixed(self, world: Arena) -> set[str]:
        return set(world.bodies) - self.picks

    def _free(self, world: Arena, name: str, rng: np.random.Generator, ignored: set[str]) -> Spot | None:
        """A random spot on which a body stands free."""
        (x0, x1), (y0, y1) = self.room_m
        body = world.bodies[name]
        edge = 0.03 if body.graspable else min(body.radius, (x1 - x0) / 2, (y1 - y0) / 2)
        for _ in range(self.parameters.draws):
            x, y = rng.uniform((x0 + edge, y0 + edge), (x1 - edge, y1 - edge)).tolist()
            spot = Spot(x, y, body.half_height, float(rng.uniform(-math.pi, math.pi)))
            if _is_free(world, name, spot, self.parameters.gap_m, ignored):
                return spot
        return None


def _can_be_done(world: Arena, goals: Sequence[Goal], picks: frozenset[str], clear_m: float) -> bool:
    """Whether every place of a goal is in reach, not in the air, and kept free by what cannot be moved."""
    return any(_can_be_reached(goal, world, picks, clear_m) for goal in goals)


def _can_be_reached(goal: Goal, world: Arena, picks: frozenset[str], clear_m: float) -> bool:
    if not all(_near(world, relation.object) for relation in goal.relations):
        return False
    table, here = goal.reached_in(world), world.table
    meanwhile = [relation for relation in goal.grounded if relation not in goal.relations]
    aside = picks - set(goal.objects)
    places = [(relation, table, goal.place(relation, world), aside) for relation in goal.relations]
    places += [(r, here, world.spot(r.frame).compose(Spot(*r.position, 0.0)), picks) for r in meanwhile]
    return all(_can_hold(relation, on, world, there, away, clear_m) for relation, on, there, away in places)


def _can_hold(
    relation: Relation, table: Table, world: Arena, there: Spot, aside: frozenset[str], clear_m: float
) -> bool:
    """Whether an object can be brought to its place `there`, and stays on what `table` has there.

    What can be put `aside` does not matter.
    """
    if not world.reaches((there.x, there.y, there.z)):
        return False
    if isinstance(relation, ObjectRoughlyAt) or isinstance(world.table, Points):
        return True
    hull = table.footprint(relation.object, there)
    others = table.obstacles({relation.object, relation.frame, *aside})
    blocked = any(
        block.overlaps(hull, 0.0 if world.bodies[block.name].graspable else -clear_m)
        and block.top > hull.bottom + GIVE_M
        and block.bottom < hull.top - GIVE_M
        for block in others
    )
    return not blocked and hull.bottom <= table.support_m(relation.object, there) + GIVE_M


def _bottom(table: Table, name: str) -> float:
    return table.spots[name].z - table.bodies[name].half_height


def _near(world: Arena, name: str) -> bool:
    """Whether an object is in reach (and so not absent)."""
    spot = world.spot(name)
    return world.reaches((spot.x, spot.y, spot.z))


def _under(world: Arena, name: str) -> set[str]:
    """What a body stands on."""
    return {other for other in world.table.spots if name in world.table.on(other)}


def _is_free(world: Arena, name: str, spot: Spot, gap_m: float, ignored: set[str]) -> bool:
    hull = world.table.footprint(name, spot)
    others = world.table.obstacles({name, *ignored, world.held or ""})
    return not any(block.overlaps(hull, -gap_m) for block in others)


def _one_of(names: set[str], rng: np.random.Generator) -> str | None:
    return str(rng.choice(sorted(names))) if names else None
