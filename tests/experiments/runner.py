"""One run of a tree in a world, judged by the truth.

    result = run(tree.flattened(), SCENARIOS["towers"], seed=1, disturbance=DISTURBANCES["far"])

A run succeeds when the truth of the goal has held for a second, nothing is held, the tree says SUCCESS, and the
disturbance has happened; with at most three times the actions of an undisturbed run. It fails at once when the tree
says SUCCESS for a second while the task is not done.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from learner.execution.ticking import Status, Ticker
from learner.model import Node, Tree
from learner.model.pose import Quaternion
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge
from learner.simulation.arena import Arena
from learner.simulation.kinematic_world import PERIOD_S, Behavior, KinematicWorld, Noise

from .disturbances import Disturbance, When, needs_recovery
from .scenarios import Scenario

HOLD_STEPS: Final = round(1.0 / PERIOD_S)
STEPS_PER_ACTION: Final = 7
"""In the kinematic world."""
PATIENCE: Final = 3
"""At most this many times the actions of an undisturbed run."""

Verdict = Literal["done", "false success", "too many actions", "no progress"]


@dataclass(frozen=True)
class Result:
    """What came of a run. `budget` is the number of actions it was allowed; `disturbed` says what happened;
    `beyond`, whether it left a covered cube or an occupied place, out of which no demonstration shows a way."""

    scenario: str
    disturbance: str
    when: str
    seed: int
    verdict: Verdict
    actions: int
    budget: int
    contacts: int
    wrong_picks: int
    steps: int
    disturbed: str | None
    beyond: bool
    last_reasons: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        return self.verdict == "done"


def run(
    tree: Tree | Node,
    scenario: Scenario,
    seed: int,
    disturbance: Disturbance | None = None,
    when: When = "progress",
    noise: Noise | None = None,
    markers: Mapping[str, Quaternion] | None = None,
    grasps: Sequence[Grasp] = (),
) -> Result:
    """Run a tree in the kinematic world from a random start (drawn from `seed` alone) until the verdict."""
    rng = np.random.default_rng([seed, 1])
    spots = scenario.draw_start(np.random.default_rng(seed))
    behavior = Behavior(failing=disturbance.failing if disturbance else 0.0, opens_on_loss=bool(rng.integers(2)))
    known = Knowledge.of(tree.flattened() if isinstance(tree, Tree) else tree, grasps)
    world = KinematicWorld(
        scenario.objects, spots, rng, noise or Noise(), markers=markers or {}, behavior=behavior, knowledge=known
    )
    return judge(tree, world, scenario, seed, rng, disturbance, when)


def judge(
    tree: Tree | Node,
    world: Arena,
    scenario: Scenario,
    seed: int,
    rng: np.random.Generator,
    disturbance: Disturbance | None = None,
    when: When = "progress",
    steps_per_action: int = STEPS_PER_ACTION,
) -> Result:
    """Run a tree in a world that stands at its start; `seed` is only noted."""
    root = tree.flattened() if isinstance(tree, Tree) else tree
    course = _Run(world, scenario, Ticker(root, world), disturbance, when, rng, steps_per_action)
    verdict = course.verdict()
    return Result(
        scenario=scenario.name,
        disturbance=disturbance.name if disturbance else "none",
        when=when,
        seed=seed,
        verdict=verdict,
        actions=len(world.attempts),
        budget=budget(scenario),
        contacts=world.faults.contacts,
        wrong_picks=world.faults.wrong_picks,
        steps=world.steps,
        disturbed=course.disturbed,
        beyond=course.beyond,
        last_reasons=tuple(f"{d.kind} {d.object}: {d.failure}" for d in world.attempts[-4:] if d.failure),
    )


def nominal_actions(scenario: Scenario) -> int:
    """A pick and a release for each step of the (longest) script."""
    return 2 * max(len(script) for script in scenario.scripts)


def budget(scenario: Scenario) -> int:
    """The most actions that a run may take."""
    return PATIENCE * nominal_actions(scenario)


@dataclass
class _Run:
    world: Arena
    scenario: Scenario
    ticker: Ticker
    disturbance: Disturbance | None
    when: When
    rng: np.random.Generator
    steps_per_action: int
    disturbed: str | None = None
    pending: bool = False
    due_step: int = 0
    said: int = 0
    true: int = 0
    beyond: bool = False
    watched: int | None = None

    def verdict(self) -> Verdict:
        """Tick until it is clear."""
        self._plan()
        limit = budget(self.scenario)
        for _ in range(2 * limit * self.steps_per_action + 10 * HOLD_STEPS):
            if self.pending:
                self._disturb()
            self._watch()
            verdict = self._tick()
            if verdict:
                return verdict
            if len(self.world.attempts) > limit:
                return "too many actions"
        return "no progress"

    def _plan(self) -> None:
        """When it shall happen: at a random point of the robot's own progress, or once the task is done."""
        if self.disturbance is None or self.disturbance.happen is None:
            return
        self.pending = True
        if not self.disturbance.at_start and self.when == "progress":
            self.due_step = int(self.rng.integers(1, nominal_actions(self.scenario) * self.steps_per_action))

    def _disturb(self) -> None:
        finished = self.said >= HOLD_STEPS
        due = self.world.steps >= self.due_step and self.when == "progress"
        if not (due or finished or self._at_start) or self.disturbance is None or self.disturbance.happen is None:
            return
        actions_left = budget(self.scenario) - len(self.world.attempts)
        self.disturbed = self.disturbance.apply(self.world, self.scenario, self.rng, actions_left)
        if self.disturbed:
            self.said = self.true = 0
            self.watched = len(self.world.attempts)
        self.pending = self.disturbed is None and not finished and not self._at_start

    def _watch(self) -> None:
        """Whether a way out has to be found: at the disturbance, and when the action ends that it interrupted."""
        if self.watched is not None:
            self.beyond = self.beyond or needs_recovery(self.world, self.scenario)
            self.watched = self.watched if self.watched == len(self.world.attempts) else None

    @property
    def _at_start(self) -> bool:
        return self.disturbance is not None and self.disturbance.at_start and self.world.steps == 0

    def _tick(self) -> Verdict | None:
        said = self.ticker.tick() is Status.SUCCESS
        true = self.scenario.reached(self.world.table.spots, self.world.held)
        self.said, self.true = (self.said + 1 if said else 0), (self.true + 1 if true else 0)
        self.world.step()
        if self.said >= HOLD_STEPS and not true:
            return "false success"
        both = min(self.said, self.true) >= HOLD_STEPS
        return "done" if both and not self.pending else None
