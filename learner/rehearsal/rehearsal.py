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

from learner.execution.entries import Found
from learner.execution.ticking import Leaves, Status, Ticker
from learner.model import Node, Tree
from learner.model.tree import is_reference
from learner.progress import tell
from learner.rehearsal.goal import Goal
from learner.rehearsal.parameters import JudgingParameters
from learner.rehearsal.rollouts import STEPS_PER_ACTION, Rollout, rollouts
from learner.rehearsal.share import Share
from learner.rehearsal.stage import Stage
from learner.rehearsal.visits import Visits
from learner.relations.grasping import Grasp
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.simulation.arena import Aftermath, Arena
from learner.simulation.failure import Failure
from learner.simulation.kinematic_world import PERIOD_S

RELEASES: Final = ("Place", "Drop")
Judgement = Literal["done", "false success", "too many actions", "no progress"]


@dataclass(frozen=True)
class RolloutResult:
    """What came of a rollout. `world` is as it was left."""

    rollout: Rollout
    judgement: Judgement
    world: Aftermath

    @property
    def done(self) -> bool:
        return self.judgement == "done"

    @cached_property
    def failing(self) -> Counter[tuple[str, str, str, Failure]]:
        """How often each (action, object, frame) failed in which way."""
        return Counter((a.kind, a.object, a.frame, a.failure) for a in self.world.attempts if a.failure)

    @cached_property
    def placed(self) -> list[tuple[str, str]]:
        """What was let go in the frame of what, in order."""
        attempts = (a for a in self.world.attempts if a.kind in RELEASES and a.ended and not a.failure)
        return [(attempt.object, attempt.frame) for attempt in attempts]

    @cached_property
    def given_up(self) -> Counter[tuple[str, str]]:
        """How often each (action, object) was begun and given up."""
        return Counter((a.kind, a.object) for a in self.world.attempts if not a.ended)

    def __str__(self) -> str:
        return f"{self.rollout}: {self.judgement}; {self._why()}"

    def _why(self) -> str:
        if self.failing:
            (kind, name, _, failure), times = self.failing.most_common(1)[0]
            return f"{kind} {name}: {failure} ({times} times)"
        if self.given_up:
            (kind, name), times = self.given_up.most_common(1)[0]
            return f"{kind} {name} was given up {times} times"
        return f"{len(self.world.attempts)} actions, none failed"


@dataclass(frozen=True)
class Rehearsal:
    """The results of all rollouts of one tree."""

    stage: Stage
    results: tuple[RolloutResult, ...]

    @property
    def failures(self) -> list[RolloutResult]:
        return [result for result in self.results if not result.done]

    @property
    def share(self) -> Share:
        """How many of the rollouts were done."""
        return _done(self.results)

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        kinds = sorted({result.rollout.kind for result in self.results})
        by_kind = {kind: [result for result in self.results if result.rollout.kind == kind] for kind in kinds}
        return {
            "world": "points" if self.stage.points else "bodies",
            "rollouts": len(self.results),
            "done": self.share.done,
            "by_kind": {kind: str(_done(results)) for kind, results in by_kind.items()},
            "false_successes": sum(result.judgement == "false success" for result in self.results),
            "contacts": sum(result.world.faults.contacts for result in self.results),
            "failures": [str(result) for result in self.failures[: self.stage.parameters.judging.told]],
            "left_out": dict(self.stage.left_out),
            **({} if self.results else {"reason": self._reason()}),
        }

    def _reason(self) -> str:
        """Why there are no rollouts."""
        left_out = next(iter(self.stage.left_out.values()), "no start is known")
        return "the task is done, or cannot be done, at every start" if self.stage.starts else left_out


def _done(results: Sequence[RolloutResult]) -> Share:
    return Share(sum(result.done for result in results), len(results))


def rehearse(tree: Tree, stage: Stage, goals: Sequence[Goal], seed: int = 0, grasps: Sequence[Grasp] = ()) -> Rehearsal:
    """Run a tree in all rollouts; each has noise of its own, drawn from its number.

    Another `seed` gives rollouts that a tree was not repaired by. `grasps` are those that the tree is published with.
    """
    root = stage.root(tree.flattened())
    actor = Actor(root, stage.knowledge(root, grasps))
    picks = _picked(root) | {grasp.object for grasp in grasps if grasp.object is not None}
    runs = enumerate(rollouts(stage, goals, picks, seed), start=1000 * seed)
    return Rehearsal(stage, tuple(perform(rollout, actor, stage, goals, number) for number, rollout in runs))


def _picked(root: Node) -> frozenset[str]:
    """The objects that a flattened tree picks by name."""
    picks = (node.port("object") for node in root.walk() if node.kind == "Pick")
    return frozenset(str(name) for name in picks if not is_reference(name))


def perform(rollout: Rollout, actor: Actor, stage: Stage, goals: Sequence[Goal], number: int = 0) -> RolloutResult:
    """A rollout in the kinematic world, ticked until it is clear how it ends."""
    tell(f"rehearsing: {rollout}")
    rng = np.random.default_rng([1, number])
    world = stage.world(rollout.spots, rng, knowledge=actor.knowledge)
    judgement = judged(rollout, world, actor.enter(world), goals, rng, stage.parameters.judging)
    return RolloutResult(rollout, judgement, Aftermath.of(world))


def judged(
    rollout: Rollout, world: Arena, ticker: Ticker, goals: Sequence[Goal], rng: np.random.Generator,
    parameters: JudgingParameters, steps_per_action: int = STEPS_PER_ACTION,
) -> Judgement:  # fmt: skip
    """How a rollout ends in a world: the truth decides, not what the tree says."""
    return _Course(rollout, world, ticker, goals, rng, parameters, steps_per_action).judgement()


class Actor:
    """A tree compiled once for many worlds, since compiling takes as long as a run; implements `Leaves`."""

    def __init__(self, root: Node, knowledge: Knowledge = UNKNOWING) -> None:
        self.world: Leaves | None = None
        self.knowledge = knowledge
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

    def find(self, node: Node) -> Found | None:
        """The world's."""
        assert self.world is not None
        return self.world.find(node)

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
    parameters: JudgingParameters
    steps_per_action: int
    said: int = 0
    true: int = 0
    idle: int = 0
    pending: bool = False

    def __post_init__(self) -> None:
        undisturbed = self.rollout.event is None
        self.visits = [Visits(goal, self.world) for goal in self.goals] if undisturbed else []

    def judgement(self) -> Judgement:
        p = self.parameters
        limit = p.patience * max(goal.actions for goal in self.goals) + p.aside * self.rollout.in_the_way
        self.pending = self.rollout.event is not None
        for _ in range(2 * limit * self.steps_per_action + 10 * self.hold_steps):
            self._happen()
            judgement = self._tick()
            if judgement:
                return judgement
            if len(self.world.attempts) > limit:
                return "too many actions"
        return "no progress"

    def _happen(self) -> None:
        """Let the event happen when it is due, unless it never could before all was done."""
        if self.pending and self.rollout.event and self.world.steps >= self.rollout.due:
            self.pending = not self.rollout.event(self.world, self.rng) and self.said < self.hold_steps

    def _tick(self) -> Judgement | None:
        before = len(self.world.attempts)
        status = self.ticker.tick()
        for visits in self.visits:
            visits.look(self.world)
        true = status is Status.SUCCESS and self._is_reached()
        working = status is Status.RUNNING or len(self.world.attempts) > before
        self.said = self.said + 1 if status is Status.SUCCESS else 0
        self.true, self.idle = self.true + 1 if true else 0, 0 if working else self.idle + 1
        self.world.step()
        if self.said >= self.hold_steps and not true:
            return "false success"
        if min(self.said, self.true) >= self.hold_steps and not self.pending:
            return "done"
        idle = self.idle > round(self.parameters.idle_s / PERIOD_S)
        return "no progress" if idle and not self.said else None

    def _is_reached(self) -> bool:
        """Whether a goal is, and in an undisturbed rollout every object has come to its stops before."""
        missed = [visits.missed for visits in self.visits] or [False] * len(self.goals)
        return any(goal.reached(self.world) and not some for goal, some in zip(self.goals, missed, strict=True))

    @property
    def hold_steps(self) -> int:
        """For so many steps the goal must hold."""
        return round(self.parameters.hold_s / PERIOD_S)
