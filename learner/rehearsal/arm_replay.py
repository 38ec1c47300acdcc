"""The replay of a tree in PyBullet, with the arm, before it is published: undisturbed, from where demonstrations began.

The simulated arm reaches a ring around itself, so that what was demonstrated is shifted over the table until all that
is moved, and where it goes, lies within. Where that is not possible, or shapes are not known, there is no replay, and
the reason is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import numpy as np

from learner.model import Tree
from learner.progress import tell
from learner.rehearsal.goal import Goal
from learner.rehearsal.rehearsal import Actor, RolloutResult, judged
from learner.rehearsal.rollouts import Rollout
from learner.rehearsal.stage import Stage, Start
from learner.relations.grasping import Grasp
from learner.simulation.arena import Aftermath

STEPS_PER_ACTION: Final = 45
"""An action takes the arm about this many periods."""
Goals = Callable[[Stage], Sequence[Goal]]
"""The goals in the terms of a stage."""


@dataclass(frozen=True)
class Replay:
    """What came of it: `results`, or the `reason` why there are none."""

    results: tuple[RolloutResult, ...] = ()
    reason: str | None = None

    @property
    def failures(self) -> list[RolloutResult]:
        """The runs that the tree has failed, not the simulated arm, which reaches and fits where others may not."""
        return [result for result in self.results if not result.done and not _arm_is_at_fault(result)]

    @property
    def failed(self) -> bool:
        """Whether every run failed: then the tree is not for use."""
        return bool(self.results) and len(self.failures) == len(self.results)

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "world": "PyBullet",
            "runs": [
                {
                    "demonstration_id": result.rollout.demonstration_id,
                    "verdict": result.judgement,
                    "actions": len(result.world.attempts),
                    "contacts": result.world.faults.contacts,
                    "sentence": None if result.done else str(result),
                }
                for result in self.results
            ],
            "reason": self.reason,
        }


def replay(tree: Tree, stage: Stage, goals: Goals, grasps: Sequence[Grasp] = ()) -> Replay:
    """Run a tree from the first demonstrations' starts that the arm can do."""
    if stage.points:
        return Replay(reason="no demonstration tells the shapes of all objects")
    if not stage.starts:
        return Replay(reason="the stage reproduces no demonstration")
    here = goals(stage)
    numbers = stage.parameters.replay
    count = max(1, min(numbers.replays, numbers.actions // max(1, *(goal.actions for goal in here))))
    roomy = sorted(range(len(stage.starts)), key=lambda n: not _roomy(stage, stage.starts[n], here))
    shifted = ((number, _within_reach(stage, stage.starts[number], goals)) for number in roomy)
    stages = ((number, moved) for number, moved in shifted if moved is not None)
    runs = (_run(tree, moved, number, goals(moved), grasps) for number, moved in stages)
    results = list(islice(runs, count))
    while len(results) < numbers.tries and not any(result.done for result in results) and (more := next(runs, None)):
        results.append(more)
    reason = None if results else "no demonstration fits into the reach of the simulated arm"
    return Replay(tuple(results), reason)


def _run(tree: Tree, stage: Stage, number: int, goals: Sequence[Goal], grasps: Sequence[Grasp]) -> RolloutResult:
    from learner.simulation.physical_world import PhysicalWorld  # loads pybullet

    tell(f"replaying with the arm, run {number + 1}")
    start, rng = stage.starts[number], np.random.default_rng([2, number])
    rollout = Rollout(start.demonstration_id, start.spots, "replay")
    root = stage.root(tree.flattened())
    actor = Actor(root, stage.knowledge(root, grasps))
    with PhysicalWorld(
        stage.bodies, start.spots, rng, stage.noise, base_frame=stage.base, sizes=stage.sizes,
        end_effector=stage.end_effector, knowledge=actor.knowledge,
    ) as world:  # fmt: skip
        ticker = actor.enter(world)
        judgement = judged(rollout, world, ticker, goals, rng, stage.parameters.judging, STEPS_PER_ACTION)
        return RolloutResult(rollout, judgement, Aftermath.of(world))


def _arm_is_at_fault(result: RolloutResult) -> bool:
    """Whether what failed most is out of the simulated arm's reach, or its hand met something beside what is picked."""
    often = result.failing.most_common(1)
    if not often:
        return False
    kind, _, _, failure = often[0][0]
    return failure.kind == "out of reach" or (kind == "Pick" and failure.kind == "contact")


def _roomy(stage: Stage, start: Start, goals: Sequence[Goal]) -> bool:
    """Whether nothing stands close beside what is to be moved."""
    table, hand_m = stage.world(start.spots, np.random.default_rng(0)).table, stage.parameters.replay.hand_m
    moved = {name for goal in goals for name in goal.objects}
    hulls = {name: table.footprint(name) for name in table.spots}
    return not any(
        hulls[other].covers(start.spots[name].x, start.spots[name].y, hand_m) and not hulls[other].overlaps(hulls[name])
        for name in moved
        for other in hulls
        if other != name
    )


def _within_reach(stage: Stage, start: Start, goals: Goals) -> Stage | None:
    """The stage shifted such that the arm reaches all that it has to; None if it cannot."""
    from learner.simulation.cell.arm_kinematics import REACH_M, REACH_RAD

    world = stage.world(start.spots, np.random.default_rng(0))
    here = goals(stage)
    needed = [goal.place(relation, world) for goal in here for relation in (*goal.relations, *goal.meanwhile)]
    needed += [start.spots[name] for goal in here for name in (*goal.objects, *([goal.held] if goal.held else []))]
    numbers = stage.parameters.replay
    steps = numbers.grid_m * np.arange(-numbers.shifts, numbers.shifts + 1)
    shifts = np.array(np.meshgrid(steps, steps)).reshape(2, -1).T
    points = np.array([(spot.x, spot.y) for spot in needed]) + shifts[:, None]
    away, direction = np.hypot(points[..., 0], points[..., 1]), np.arctan2(points[..., 1], points[..., 0])
    fits = ((away >= REACH_M[0]) & (away <= REACH_M[1]) & (np.abs(direction) <= REACH_RAD)).all(axis=1)
    others = np.array([(spot.x, spot.y) for spot in start.spots.values()]) + shifts[:, None]
    radii = np.array([stage.bodies[name].radius for name in start.spots])
    fits &= (np.hypot(others[..., 0], others[..., 1]) > numbers.room_m + radii).all(axis=1)
    fits &= (others[..., 0] > numbers.behind_m + radii).all(axis=1)
    if not fits.any():
        return None
    x, y = min(shifts[fits].tolist(), key=lambda shift: (shift[0] ** 2 + shift[1] ** 2, shift))
    return stage.moved(x, y)
