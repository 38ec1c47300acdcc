"""The rehearsal of a tree before it is published: rollouts on the stage, judged by the truth of the simulated world.

The proof takes relative places and certain actions; here poses are noisy (3 mm, 1 degree), things stand partly in the
way, hands meet them, and what is let go may fall. All work is limited by counts, so that the same demonstrations give
the same words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from learner.execution.ticking import Leaves, Status, Ticker
from learner.model import Node, Tree
from learner.rehearsal.goal import Goal
from learner.rehearsal.rollouts import STEPS_PER_ACTION, Rollout, imagined
from learner.rehearsal.stage import Stage
from learner.simulation.arena import Arena
from learner.simulation.kinematic_world import PERIOD_S

HOLD_STEPS: Final = round(1.0 / PERIOD_S)
"""The goal must hold this long."""
IDLE_STEPS: Final = 3 * HOLD_STEPS
"""A tree that has done nothing for this long will not go on."""
PATIENCE: Final = 3
"""At most this many times the actions of an undisturbed run ..."""
ASIDE: Final = 4
"""... and this many more for each thing that was put in the way: twice a pick and a placement."""
RELEASES: Final = ("Place", "Drop")
SENTENCES: Final = 5
"""So many failures are told."""

Verdict = Literal["done", "false success", "too many actions", "no progress"]


@dataclass(frozen=True)
class Outcome:
    """What came of a rollout. `world` is as it was left."""

    rollout: Rollout
    verdict: Verdict
    world: Arena

    @property
    def done(self) -> bool:
        return self.verdict == "done"

    @cached_property
    def failing(self) -> Counter[tuple[str, str, str, str]]:
        """How often each (action, object, frame, reason) failed."""
        return Counter((d.kind, d.object, d.frame, d.reason) for d in self.world.deeds if d.reason)

    @cached_property
    def placed(self) -> list[tuple[str, str]]:
        """What was let go in the frame of what, in order."""
        deeds = (d for d in self.world.deeds if d.kind in RELEASES and d.ended and not d.reason)
        return [(deed.object, deed.frame) for deed in deeds]

    @cached_property
    def given_up(self) -> Counter[tuple[str, str]]:
        """How often each (action, object) was begun and given up."""
        return Counter((d.kind, d.object) for d in self.world.deeds if not d.ended)

    def __str__(self) -> str:
        return f"{self.rollout}: {self.verdict}; {self._why()}"

    def _why(self) -> str:
        if self.failing:
            (kind, name, _, reason), times = self.failing.most_common(1)[0]
            return f"{kind} {name}: {reason} ({times} times)"
        if self.given_up:
            (kind, name), times = self.given_up.most_common(1)[0]
            return f"{kind} {name} was given up {times} times"
        return f"{len(self.world.deeds)} actions, none failed"


@dataclass(frozen=True)
class Rehearsal:
    """The outcomes of all rollouts of one tree."""

    stage: Stage
    outcomes: tuple[Outcome, ...]

    @property
    def failures(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if not outcome.done]

    @property
    def share(self) -> float:
        """How many of the rollouts were done; 1 if there were none."""
        return 1 - len(self.failures) / len(self.outcomes) if self.outcomes else 1.0

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        kinds = sorted({outcome.rollout.kind for outcome in self.outcomes})
        count = {kind: [o for o in self.outcomes if o.rollout.kind == kind] for kind in kinds}
        return {
            "world": "points" if self.stage.points else "bodies",
            "rollouts": len(self.outcomes),
            "done": len(self.outcomes) - len(self.failures),
            "by_kind": {kind: f"{sum(o.done for o in count[kind])} of {len(count[kind])}" for kind in kinds},
            "false_successes": sum(outcome.verdict == "false success" for outcome in self.outcomes),
            "contacts": sum(outcome.world.faults.contacts for outcome in self.outcomes),
            "failures": [str(outcome) for outcome in self.failures[:SENTENCES]],
            "left_out": dict(self.stage.left_out),
        }


def rehearse(tree: Tree, stage: Stage, goals: Sequence[Goal], seed: int = 0) -> Rehearsal:
    """Run a tree in all rollouts; each has noise of its own, drawn from its number.

    Another `seed` gives rollouts that a tree was not repaired by.
    """
    root = stage.root(tree.flattened())
    picks = frozenset(str(node.port("object")) for node in root.walk() if node.kind == "Pick")
    actor = Actor(root)
    runs = enumerate(imagined(stage, goals, picks, seed), start=1000 * seed)
    return Rehearsal(stage, tuple(perform(rollout, actor, stage, goals, number) for number, rollout in runs))


def perform(rollout: Rollout, actor: Actor, stage: Stage, goals: Sequence[Goal], number: int = 0) -> Outcome:
    """A rollout in the kinematic world, ticked until it is clear how it ends."""
    rng = np.random.default_rng([1, number])
    world = stage.world(rollout.spots, rng)
    return Outcome(rollout, judged(rollout, world, actor.enter(world), goals, rng), world)


def judged(
    rollout: Rollout, world: Arena, ticker: Ticker, goals: Sequence[Goal], rng: np.random.Generator,
    steps_per_action: int = STEPS_PER_ACTION,
) -> Verdict:  # fmt: skip
    """How a rollout ends in a world: the truth decides, not what the tree says."""
    return _Course(rollout, world, ticker, goals, rng, steps_per_action).verdict()


class Actor:
    """A tree compiled once for many worlds, since compiling takes as long as a run; implements `Leaves`."""

    def __init__(self, root: Node) -> None:
        self.world: Leaves | None = None
        self.ticker = Ticker(root, self)

    def enter(self, world: Leaves) -> Ticker:
        """The tree as if it had never run, acting on another world."""
        if self.world is not None:
            self.ticker.halt()
        self.world = world
        return self.ticker

    def check(self, node: Node) -> bool:
        """The world's."""
        assert self.world is not None
        return self.world.check(node)

    def tick_action(self, node: Node) -> Status:
        """The world's."""
        assert self.world is not None
        return self.world.tick_action(node)

    def halt_action(self, node: Node) -> None:
        """The world's."""
        assert self.world is not None
        self.world.halt_action(node)


@dataclass
class _Course:
    rollout: Rollout
    world: Arena
    ticker: Ticker
    goals: Sequence[Goal]
    rng: np.random.Generator
    steps_per_action: int
    said: int = 0
    true: int = 0
    idle: int = 0
    pending: bool = False

    def verdict(self) -> Verdict:
        limit = PATIENCE * max(goal.actions for goal in self.goals) + ASIDE * self.rollout.in_the_way
        self.pending = self.rollout.event is not None
        for _ in range(2 * limit * self.steps_per_action + 10 * HOLD_STEPS):
            self._happen()
            verdict = self._tick()
            if verdict:
                return verdict
            if len(self.world.deeds) > limit:
                return "too many actions"
        return "no progress"

    def _happen(self) -> None:
        """Let the event happen when it is due, unless it never could before all was done."""
        if self.pending and self.rollout.event and self.world.steps >= self.rollout.due:
            self.pending = not self.rollout.event(self.world, self.rng) and self.said < HOLD_STEPS

    def _tick(self) -> Verdict | None:
        before = len(self.world.deeds)
        status = self.ticker.tick()
        true = status is Status.SUCCESS and any(goal.reached(self.world) for goal in self.goals)
        working = status is Status.RUNNING or len(self.world.deeds) > before
        self.said = self.said + 1 if status is Status.SUCCESS else 0
        self.true, self.idle = self.true + 1 if true else 0, 0 if working else self.idle + 1
        self.world.step()
        if self.said >= HOLD_STEPS and not true:
            return "false success"
        if min(self.said, self.true) >= HOLD_STEPS and not self.pending:
            return "done"
        return "no progress" if self.idle > IDLE_STEPS and not self.said else None
