"""Rehearsal finds what is wrong with a tree by the truth of simulated worlds, and the planner repairs what it can."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from support_demonstrations import BASE, Put, at, repeated

from learner.execution.ticking import Status
from learner.inference.targets import Target
from learner.inference.understanding import understand
from learner.learning import METHODS
from learner.model import Demonstration, ObjectAt, Place, Tree
from learner.model.upright import Spot
from learner.parameters import Parameters
from learner.planning.draft import Draft, in_order
from learner.planning.repairs import NOTHING, Repairs
from learner.planning.synthesis import main_id, tree_of
from learner.rehearsal.goal import Goal, goals_of, holds
from learner.rehearsal.lessons import Candidate, Lessons, candidates
from learner.rehearsal.parameters import RolloutParameters
from learner.rehearsal.rehearsal import Actor, rehearse
from learner.rehearsal.rollouts import rollouts
from learner.rehearsal.stage import Stage
from learner.simulation.gravity import Body

PARAMETERS = Parameters()


@dataclass(frozen=True)
class Weakened(Draft):
    """A draft that makes the tree worse than it should be, until it is repaired."""

    backwards: bool = False

    def tree(self, repairs: Repairs = NOTHING) -> Tree:
        groups = [replace(group, subgoals=in_order(group, repairs)) for group in self._groups()]
        return tree_of(main_id(self.understood.demonstrations), groups, self.actions, self.recovery(self.actions))

    def orders(self, repairs: Repairs = NOTHING) -> list[list[Target]]:
        return [[subgoal.target for subgoal in in_order(group, repairs)] for group in self._groups()]

    def _groups(self):  # type: ignore[no-untyped-def]  # the type of Understanding.groups
        groups = self.understood.groups
        return [replace(group, subgoals=group.subgoals[::-1]) for group in groups] if self.backwards else groups


@cache
def demonstrations_of(name: str) -> tuple[Demonstration, ...]:
    return tuple(sorted(demonstrated(SCENARIOS[name], 3, 1002), key=lambda d: d.demonstration_id))


@cache
def setting(name: str) -> tuple[Stage, Draft, list[Goal]]:
    demonstrations = demonstrations_of(name)
    draft = Draft(understand(demonstrations, PARAMETERS.inference), PARAMETERS.planning, {})
    stage = Stage(demonstrations)
    return stage, draft, goals_of(draft.understood.groups, draft.placements, stage)


def candidates_of(name: str, **weakness: bool) -> list[Candidate]:
    """The attempts at repairing a tree that is weakened on purpose."""
    stage, draft, goals = setting(name)
    weak = Weakened(draft.understood, PARAMETERS.planning, {}, **weakness)
    lessons = Lessons(weak.placements, weak.orders, goals, stage.bodies)
    return candidates(weak.tree(), weak.tree, lambda tree: rehearse(tree, stage, goals, grasps=weak.grasps), lessons.of)


def test_an_order_in_which_one_placement_undoes_another_is_turned_round() -> None:
    first, *_, last = candidates_of("tower_and_box", backwards=True)
    assert float(first.rehearsal.share) < 0.5
    assert {(a.object, b.object) for a, b in last.repairs.before} == {("D", "F")}
    assert float(last.rehearsal.share) == 1.0


def test_a_tree_that_rehearses_well_is_left_as_it_is() -> None:
    (only,) = candidates_of("object_in_box")
    assert only.repairs == NOTHING
    assert only.rehearsal.failures == []


def test_an_attempt_that_is_no_better_is_not_kept() -> None:
    stage, draft, goals = setting("tower_and_box")
    a, b = draft.understood.targets[:2]
    worse = candidates_of("tower_and_box", backwards=True)[0].tree
    found = candidates(
        draft.tree(),
        lambda _: worse,
        lambda tree: rehearse(tree, stage, goals, grasps=draft.grasps),
        lambda *_: [Repairs(before=frozenset({(a, b)}))],
    )
    assert [attempt.tree for attempt in found] == [draft.tree()]


def test_success_that_the_truth_does_not_bear_out_is_a_false_success() -> None:
    stage, draft, goals = setting("tower_and_box")
    group = draft.understood.groups[0]
    shorter = replace(draft.understood, groups=(replace(group, subgoals=group.subgoals[:-1]),))
    rehearsal = rehearse(Draft(shorter, PARAMETERS.planning, {}).tree(), stage, goals, grasps=draft.grasps)
    assert {result.judgement for result in rehearsal.results if result.rollout.kind == "shown"} == {"false success"}
    assert rehearsal.to_data()["false_successes"] > 0


def test_a_tree_that_can_do_nothing_makes_no_progress() -> None:
    stage, draft, goals = setting("object_in_box")
    names = dict.fromkeys(draft.understood.targets, "nowhere")
    rehearsal = rehearse(_out_of_reach(draft, names), stage, goals, grasps=draft.grasps)
    assert "done" not in {result.judgement for result in rehearsal.results}
    assert "out of reach" in str(rehearsal.failures[0])


def _out_of_reach(draft: Draft, targets: Mapping[Target, str]) -> Tree:
    actions = copy(draft.actions)
    far = {target: replace(draft.placements[target], position=(9.0, 9.0, 0.1)) for target in targets}
    actions.placements = {**draft.placements, **far}
    return tree_of("far", draft.understood.groups, actions, draft.recovery(actions))


def test_the_same_demonstrations_rehearse_the_same() -> None:
    stage, draft, goals = setting("decoy")
    once, again = (rehearse(draft.tree(), stage, goals, grasps=draft.grasps).to_data() for _ in range(2))
    assert once == again
    assert Stage(demonstrations_of("decoy")[::1]).starts == stage.starts


def test_every_imagined_start_leaves_the_task_possible_and_is_not_done_yet() -> None:
    for name in ("board", "hanoi", "towers"):
        stage, draft, goals = setting(name)
        picks = frozenset(str(grasp.object) for grasp in draft.grasps)
        made = list(rollouts(stage, goals, picks))
        kinds = {rollout.kind for rollout in made}
        assert {"shown", "scattered", "partly", "taken", "moved"} <= kinds
        assert len(made) <= RolloutParameters().shown + sum(RolloutParameters().kinds.values())
        for rollout in made:
            world = stage.world(rollout.spots, np.random.default_rng(0))
            assert not any(goal.reached(world) for goal in goals)
            assert all(world.table.support_m(n, s, s.z) == pytest.approx(s.z - stage.bodies[n].half_height, abs=0.006)
                       for n, s in rollout.spots.items())  # fmt: skip


def test_an_unmovable_thing_on_a_goals_place_is_no_fault_of_the_tree() -> None:
    stage, _, goals = setting("towers")
    post = Body(replace(stage.bodies["A"].shape, size_m=(0.2, 0.2, 0.3)))
    stage = Stage(demonstrations_of("towers"))
    place = goals[0].place(next(r for r in goals[0].relations if r.frame == BASE), stage.world({}, _rng()))
    stage.bodies["post"] = post
    stage.starts = [replace(start, spots={**start.spots, "post": replace(place, z=0.15)}) for start in stage.starts]
    assert list(rollouts(stage, goals, frozenset("ABCDEF"))) == []


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_tree_compiled_once_forgets_the_world_that_it_leaves() -> None:
    stage, draft, _ = setting("tower_and_box")
    root = stage.root(draft.tree().flattened())
    actor = Actor(root, stage.knowledge(root, draft.grasps))
    first, second = (stage.world(stage.starts[0].spots, _rng(), knowledge=actor.knowledge) for _ in range(2))
    ticker = actor.enter(first)
    for _ in range(25):
        ticker.tick()
        first.step()
    ticker = actor.enter(second)
    while ticker.tick() is not Status.SUCCESS:
        second.step()
    assert [(attempt.kind, attempt.object) for attempt in second.attempts[:2]] == [("Pick", "D"), ("Place", "D")]
    assert len(first.attempts) < len(second.attempts)


def test_goals_hold_by_the_papers_radius_whatever_the_tree_looks_for() -> None:
    stage, draft, goals = setting("tower_and_box")
    relation = next(relation for relation in goals[0].relations if isinstance(relation, ObjectAt))
    assert relation.radius == 0.05 + stage.parameters.judging.slack_m
    assert max(p.radius for p in draft.placements.values() if isinstance(p, Place)) < 0.05
    world = stage.world(stage.starts[0].spots, _rng())
    x, y, z = relation.position
    world.table.spots[relation.object] = world.spot(relation.frame).compose(Spot(x + 0.04, y, z, 0.0))
    assert holds(relation, world)
    world.held = relation.object
    assert not holds(relation, world)


def test_without_shapes_trees_are_rehearsed_among_points() -> None:
    script = [Put("A", "box", (0.0, 0.0, 0.0)), Put("B", "A", (0.0, 0.0, 0.05))]
    demonstrations = repeated(["A", "B", "box"], [script] * 3)
    stage, learned = Stage(demonstrations), METHODS["treewright"](demonstrations, PARAMETERS)
    assert learned.draft
    goals = goals_of(learned.draft.understood.groups, learned.draft.placements, stage)
    data = rehearse(learned.tree, stage, goals).to_data()
    assert data["world"] == "points"
    assert data["done"] == data["rollouts"] >= 6
    assert set(data["by_kind"]) == {"shown", "taken", "moved"}


def test_of_contrary_orders_the_first_is_kept() -> None:
    a, b = setting("tower_and_box")[1].understood.targets[:2]
    first, contrary = Repairs(before=frozenset({(a, b)})), Repairs(before=frozenset({(b, a)}))
    assert first | contrary == first


def test_nothing_that_stands_on_the_table_counts_as_demonstrated_in_the_air() -> None:
    start = {"A": at(0.4, 0.2), "box": at(0.6, -0.2)}
    assert Stage(repeated(list(start), [[Put("A", "box", (0.1, 0.0, 0.0))]] * 3)).left_out == {}
