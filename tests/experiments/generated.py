"""Tasks that nobody wrote: `generated(seed)` draws a task at random, the same for the same seed.

One to seven objects to move, of several shapes; boxes and boards, and things that never take part; one to eight steps:
onto the table, beside, upon, into a slot, dropped into a box; objects moved twice, orders free or fixed, references
fixed or anywhere, now and then a tower or a full box at the start, or two acceptable goals; names of every kind that
the contract allows. What cannot be done
from random starts is drawn again, so that every task can be demonstrated and every start is worth it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from learner.model import ObjectShape
from learner.model.pose import Vector
from learner.model.upright import Spot
from learner.simulation.gravity import WALL_M, Body
from learner.simulation.kinematic_world import WORKSPACE_M
from learner.simulation.script import Inside, Rests, ScriptedMove

from .scenarios import BASE, Goal, Scenario, Start

MOST_STEPS: Final = 8
MOST_MOVABLE: Final = 7
TRIES: Final = 60
"""A start must be found among so many, ..."""
FEWEST_STARTS: Final = 2
"""... so many times."""
APART_M: Final = 0.16
"""Spots on the table are at least so far apart [m]."""
SLOT_GAP_M: Final = 0.02
"""What stands in one box or on one board keeps this distance [m]."""

SIDES_M: Final = (0.04, 0.045, 0.05, 0.05, 0.05, 0.06)
FLAT_M: Final = ((0.1, 0.05, 0.03), (0.08, 0.06, 0.04), (0.12, 0.04, 0.03))
ROUND_M: Final = ((0.05, 0.05, 0.07), (0.04, 0.04, 0.05), (0.06, 0.06, 0.04))
SLOTS_APART_M: Final = 0.1
"""What stands in one box at the start, of origins [m]."""

NAMES: Final = (
    "A", "B", "C", "cube-1", "cube.1", "cube_1", "bolt-M8.long", "0815", "gear.left", "gear-left", "R2-D2", "x", "Y",
    "red.cube-big", "7up", "part_3", "Sequence", "Pick", "base-2", "tool", "z9", "lid",
)  # fmt: skip
PLACES: Final = ("box", "crate.blue", "tray-1", "tray.1", "board", "shelf-2.top", "Box")


@cache
def generated(seed: int) -> Scenario:
    """The task with this seed, named after it."""
    rng = np.random.default_rng([seed, 20_260])
    for _ in range(200):
        scenario = _Draft(rng).scenario(f"generated{seed}")
        if scenario is not None and _can_be_shown(scenario, rng):
            return scenario
    raise RuntimeError(f"no task was found for the seed {seed}; the table is too full")


def habitual(scenario: Scenario, seed: int) -> Scenario:
    """The same task shown by people who hardly tidy up: some things stand nearly the same way in each demonstration.

    How nearly is drawn for each thing; where they stand, from a start of the task.
    """
    rng = np.random.default_rng([seed, 20_261])
    for _ in range(100):
        homes = scenario.draw_start(rng, scenario.scripts[0])
        some = [name for name in sorted(homes) if rng.random() < 0.5 and name not in (scenario.start.fixed or {})]
        about = {name: (homes[name], float(10 ** rng.uniform(-3.0, -0.7))) for name in some}
        candidate = replace(scenario, start=replace(scenario.start, about=about))
        if _can_be_shown(candidate, rng):
            return candidate
    raise RuntimeError(f"no habit was found for {scenario.name}")


def _can_be_shown(scenario: Scenario, rng: np.random.Generator) -> bool:
    """Whether starts for every way, and starts for runs, are found soon enough."""
    try:
        for way in (None, *scenario.scripts) * FEWEST_STARTS:
            scenario.draw_start(rng, way, TRIES)
    except RuntimeError:
        return False
    return True


@dataclass
class _Draft:
    """A task on its way. `at` is where each moved object stands now, as the step that put it there; `stack` and `full`
    what stands upon or in something at the start, from below, and `waiting` what of it has not been moved yet.
    """

    rng: np.random.Generator
    objects: dict[str, Body] = field(default_factory=dict)
    steps: list[ScriptedMove] = field(default_factory=list)
    at: dict[str, ScriptedMove] = field(default_factory=dict)
    stack: tuple[str, ...] = ()
    full: dict[str, tuple[str, Vector]] = field(default_factory=dict)
    waiting: dict[str, str] = field(default_factory=dict)

    def scenario(self, name: str) -> Scenario | None:
        """A whole task; None if it came to nothing."""
        self._furnish()
        self._pile()
        self._fill()
        steps = int(self.rng.integers(1, MOST_STEPS + 1))
        for _ in range(3 * steps):
            if len(self.steps) < steps:
                self._add()
        goal = self.goal(self.steps)
        if not goal or not self._all_lasting():
            return None
        scripts, goals, least = self._ways(goal)
        free = len(goals) == 1 and not any(self._bound(a, b) for a, b in combinations(self.steps, 2))
        return Scenario(name, self.objects, scripts, goals, self._start(), any_order=free, least=least)

    # -- what there is -------------------------------------------------------------------------------------------

    def _furnish(self) -> None:
        """Movable things and places, with names drawn by lot."""
        names, places = self.rng.permutation(NAMES).tolist(), self.rng.permutation(PLACES).tolist()
        for _ in range(int(self.rng.integers(1, MOST_MOVABLE + 1))):
            self.objects[names.pop()] = self._movable()
        for _ in range(int(self.rng.choice(3, p=(0.3, 0.5, 0.2)))):
            self.objects[places.pop()] = self._place()

    def _movable(self) -> Body:
        kind = self.rng.choice(["cube", "flat", "round"], p=(0.65, 0.2, 0.15))
        if kind == "cube":
            side = float(self.rng.choice(SIDES_M))
            return Body(ObjectShape((side, side, side), "cube" if self.rng.random() < 0.7 else "none"))
        sizes, symmetry = (FLAT_M, "box") if kind == "flat" else (ROUND_M, "vertical")
        x, y, z = sizes[int(self.rng.integers(len(sizes)))]
        return Body(ObjectShape((x, y, z), "box" if symmetry == "box" else "vertical"))

    def _place(self) -> Body:
        x, y = (round(float(side), 2) for side in self.rng.uniform(0.2, 0.36, 2))
        if self.rng.random() < 0.6:
            height = round(float(self.rng.uniform(0.05, 0.1)), 2)
            return Body(ObjectShape((x, y, height), "box" if self.rng.random() < 0.7 else "none"), "open_box")
        return Body(ObjectShape((x, min(y, 0.24), 0.02), "none"))

    def _pile(self) -> None:
        """Now and then two or three things stand upon each other at the start."""
        names = sorted(self._movables(), key=lambda name: -self.objects[name].radius)[: int(self.rng.integers(2, 4))]
        if self.rng.random() < 0.15 and all(self._bears(*pair) for pair in pairwise(names)):
            self.stack = tuple(names)
            self.waiting |= {upper: lower for lower, upper in pairwise(names)}

    def _fill(self) -> None:
        """Now and then some things stand in a box or on a board at the start."""
        frame = self._one_of([name for name, body in self.objects.items() if not body.graspable])
        if frame is None or self.rng.random() > 0.15:
            return
        for name in self._movables()[:3]:
            spot = None if name in self.stack else self._slot(name, frame)
            if spot is not None and not any(math.dist(spot, at[:2]) < SLOTS_APART_M for _, at in self.full.values()):
                self.full[name] = frame, (*spot, round(self._floor(frame) + self.objects[name].half_height, 4))
                self.waiting[name] = frame

    def _floor(self, frame: str) -> float:
        """The height of what carries things in a box or on a board, in its frame [m]."""
        place = self.objects[frame]
        return WALL_M - place.half_height if place.kind == "open_box" else place.half_height

    def _bears(self, lower: str, upper: str) -> bool:
        lower_m, upper_m = self.objects[lower].shape.size_m, self.objects[upper].shape.size_m
        return min(lower_m[:2]) >= 0.6 * max(upper_m[:2])

    def _start(self) -> Start:
        """Now and then a reference that nobody moves stands always at the same spot."""
        stacks = (self.stack,) if self.stack else ()
        near = tuple((name, of, at, 0.0) for name, (of, at) in self.full.items())
        references = sorted(
            {s.frame for s in self.steps} - {s.object for s in self.steps} - {BASE, *self.stack, *self.full}
        )
        if not references or self.rng.random() > 0.15:
            return Start(stacks, near)
        name = str(self.rng.choice(references))
        x, y = self._table_spot(self.objects[name].radius)
        spot = Spot(x, y, self.objects[name].half_height, float(self.rng.uniform(-1.5, 1.5)))
        return Start(stacks, near, {name: spot})

    # -- steps ---------------------------------------------------------------------------------------------------

    def _add(self) -> None:
        """One more step, if the lot falls on one that can be done."""
        names = [name for name in self._movables() if self._takable(name)]
        if not names:
            return
        fresh = [name for name in names if name not in self.at]
        name = str(self.rng.choice(sorted(fresh if fresh and self.rng.random() < 0.75 else names)))
        ways = [self._onto_table, self._beside, self._upon, self._into]
        step = ways[int(self.rng.choice(4, p=(0.2, 0.25, 0.3, 0.25)))](name)
        again = bool(self.steps) and self.steps[-1].object == name
        if step is not None and not again:
            self.steps.append(step)
            self.at[name] = step
            self.waiting.pop(name, None)

    def _movables(self) -> list[str]:
        return [name for name, body in self.objects.items() if body.graspable]

    def _takable(self, name: str) -> bool:
        """Nothing stands on it; what stands beside it is left in peace, nearly always; a drop is not taken out."""
        dropped = name in self.at and self.at[name].type == "drop"
        leaning = any(step.frame == name for step in self.at.values())
        upon = any(step.frame == name and step.at[:2] == (0.0, 0.0) for step in self.at.values())
        upon = upon or name in self.waiting.values()
        return not dropped and not upon and (not leaning or self.rng.random() < 0.1)

    def _yaw(self) -> float:
        return float(self.rng.choice([0.0, 0.0, 0.0, math.pi / 2, -math.pi / 4, 0.5]))

    def _onto_table(self, name: str) -> ScriptedMove:
        x, y = self._table_spot(self.objects[name].radius)
        return ScriptedMove("place", name, BASE, (x, y, self.objects[name].half_height), self._yaw())

    def _table_spot(self, radius: float) -> tuple[float, float]:
        taken = [step.at for step in self.steps if step.frame == BASE]
        (x0, x1), (y0, y1) = WORKSPACE_M
        for _ in range(100):
            x, y = (
                round(float(v), 3) for v in self.rng.uniform((x0 + radius, y0 + radius), (x1 - radius, y1 - radius))
            )
            if all(math.dist((x, y), at[:2]) > APART_M for at in taken):
                break
        return x, y

    def _beside(self, name: str) -> ScriptedMove | None:
        """Beside what stands on the table, some centimetres away or further."""
        standing = [other for other in self.objects if other != name and self._on_table(other)]
        frame = self._one_of(standing)
        if frame is None:
            return None
        near = self.objects[frame].radius + self.objects[name].radius
        distance = near + float(self.rng.choice([0.01, 0.03, 0.06, 0.1]))
        angle = float(self.rng.choice([0.0, math.pi / 2, math.pi, -math.pi / 2, self.rng.uniform(-3, 3)]))
        height = self.objects[name].half_height - self.objects[frame].half_height
        at = (round(distance * math.cos(angle), 3), round(distance * math.sin(angle), 3), round(height, 4))
        return ScriptedMove("place", name, frame, at, self._yaw())

    def _on_table(self, name: str) -> bool:
        """Whether it stands there by the steps so far, at its start or beside something that does."""
        if name not in self.at:
            return name not in self.waiting
        step = self.at[name]
        return step.frame == BASE or (step.at[:2] != (0.0, 0.0) and self.objects[step.frame].graspable)

    def _upon(self, name: str) -> ScriptedMove | None:
        """Upon a movable thing that bears it and on which nothing stands."""
        body = self.objects[name]
        busy = {step.frame for step in self.at.values() if step.at[:2] == (0.0, 0.0)} | set(self.waiting.values())
        dropped = {step.object for step in self.at.values() if step.type == "drop"}
        bearing = [
            other for other in self._movables()
            if other not in (name, *busy, *dropped) and self._level(other) < 4
            and self._bears(other, name)
        ]  # fmt: skip
        placed = [other for other in bearing if other in self.at]
        frame = self._one_of(placed if placed and self.rng.random() < 0.7 else bearing)
        if frame is None:
            return None
        height = round(self.objects[frame].half_height + body.half_height, 4)
        return ScriptedMove("place", name, frame, (0.0, 0.0, height), self._yaw() if self.rng.random() < 0.3 else 0.0)

    def _level(self, name: str) -> int:
        """How many things it stands upon."""
        step = self.at.get(name)
        upon = step is not None and step.at[:2] == (0.0, 0.0) and self.objects[step.frame].graspable
        return 1 + self._level(step.frame) if upon and step is not None else 0

    def _into(self, name: str) -> ScriptedMove | None:
        """Onto a board, into a slot of a box, or dropped into a box."""
        frame = self._one_of([other for other, body in self.objects.items() if not body.graspable])
        if frame is None:
            return None
        place, body = self.objects[frame], self.objects[name]
        spot = self._slot(name, frame)
        if spot is None:
            return None
        lowest = self._floor(frame) + body.half_height
        if place.kind == "open_box" and lowest > place.half_height - 0.01:
            return None
        if place.kind == "open_box" and self.rng.random() < 0.5:
            return ScriptedMove("drop", name, frame, (*spot, round(place.half_height + body.half_height + 0.03, 4)))
        return ScriptedMove("place", name, frame, (*spot, round(lowest, 4)), self._yaw())

    def _slot(self, name: str, frame: str) -> tuple[float, float] | None:
        """A place within a box or board that is free of what the steps so far have put there."""
        radius = self.objects[name].radius
        half_x, half_y = (size / 2 - radius - 0.015 for size in self.objects[frame].shape.size_m[:2])
        taken = [(step.at, self.objects[step.object].radius) for step in self.steps if step.frame == frame]
        for _ in range(30):
            if min(half_x, half_y) < 0:
                return None
            x, y = (round(float(v), 3) for v in self.rng.uniform((-half_x, -half_y), (half_x, half_y)))
            if all(math.dist((x, y), at[:2]) > radius + other + SLOT_GAP_M for at, other in taken):
                return x, y
        return None

    def _one_of(self, names: Sequence[str]) -> str | None:
        return str(self.rng.choice(sorted(names))) if names else None

    # -- what it means -------------------------------------------------------------------------------------------

    def goal(self, steps: Sequence[ScriptedMove]) -> Goal:
        """What holds at the end of steps, from below: each object's last place, if its frame stays where it is."""
        last = {step.object: number for number, step in enumerate(steps)}
        return tuple(
            self._relation(step)
            for number, step in enumerate(steps)
            if last[step.object] == number and last.get(step.frame, -1) < number
        )

    def _relation(self, step: ScriptedMove) -> Rests | Inside:
        if step.type == "drop":
            return Inside(step.object, step.frame)
        upon = step.at[:2] == (0.0, 0.0)
        return Rests(step.object, step.frame, step.at, 0.03 if upon else 0.05, step.yaw or 0.0)

    def _all_lasting(self) -> bool:
        """Whether no object ends where only a frame that has moved on would tell why."""
        last = {step.object: number for number, step in enumerate(self.steps)}
        return all(last.get(self.steps[number].frame, -1) < number for number in last.values())

    def _ways(self, goal: Goal) -> tuple[tuple[tuple[ScriptedMove, ...], ...], tuple[Goal, ...], int]:
        """The scripts, the goals, and the fewest demonstrations: other orders, or another place for one object."""
        script = tuple(self.steps)
        lot = self.rng.random()
        other = self._otherwise(script) if lot < 0.12 else None
        if other is not None:
            return (script, other), (goal, self.goal(other)), 6
        if lot < 0.55 or len({step.object for step in script}) < len(script):
            return (script,), (goal,), 3
        orders = dict.fromkeys((script, *(self._shuffled(script) for _ in range(2))))
        return tuple(orders), (goal,), 3

    def _otherwise(self, script: tuple[ScriptedMove, ...]) -> tuple[ScriptedMove, ...] | None:
        """The same with one thing put onto another spot of the table."""
        numbers = [n for n, step in enumerate(script) if step.frame == BASE and script[n] is self.at[step.object]]
        if not numbers:
            return None
        number = int(self.rng.choice(numbers))
        x, y = self._table_spot(self.objects[script[number].object].radius)
        moved = replace(script[number], at=(x, y, script[number].at[2]))
        return (*script[:number], moved, *script[number + 1 :])

    def _shuffled(self, script: tuple[ScriptedMove, ...]) -> tuple[ScriptedMove, ...]:
        """The steps in another order in which each still finds what it needs."""
        left, result = list(script), []
        while left:
            free = [b for number, b in enumerate(left) if not any(self._bound(a, b) for a in left[:number])]
            result.append(free[int(self.rng.integers(len(free)))])
            left.remove(result[-1])
        return tuple(result)

    def _bound(self, a: ScriptedMove, b: ScriptedMove) -> bool:
        """Whether two steps keep their order: one moves what the other moves, stands by, or lies upon at the start."""
        piled = {a.object, b.object} <= set(self.stack)
        return piled or a.object in (b.object, b.frame) or b.object == a.frame
