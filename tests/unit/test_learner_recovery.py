"""Recovery is added to what was demonstrated and changes nothing of it; each part says what it was made to say."""

from __future__ import annotations

from functools import cache

import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS

from learner.inference.understanding import understand
from learner.model import ObjectAt, ObjectRoughlyAt, Place
from learner.model.tree import is_recovery
from learner.parameters import Parameters
from learner.planning.draft import Draft
from learner.planning.occupations import Occupations
from learner.planning.recovery import NoRecovery, PileRecovery, Recovery


@cache
def draft_of(name: str) -> Draft:
    demonstrations = sorted(demonstrated(SCENARIOS[name], 3, 1000), key=lambda d: d.demonstration_id)
    return Draft(understand(demonstrations, Parameters().inference), Parameters().planning, {})


@cache
def recovery_of(name: str) -> PileRecovery:
    draft = draft_of(name)
    return PileRecovery.of(draft.understood.demonstrations, draft.actions, draft.shared_targets())


@pytest.mark.parametrize("name", ["object_in_box", "towers", "tower_and_box", "board", "two_goals", "moving_reference"])
def test_without_what_recovers_the_tree_is_the_nominal_one(name: str) -> None:
    tree, nominal = draft_of(name).tree(), draft_of(name).nominal_tree()
    assert tree.flattened(recovery=False) == nominal.flattened()
    assert tree.nodes_recovery > 0
    assert nominal.nodes_recovery == 0


def test_every_subtree_that_is_kept_is_used_and_only_recovers_but_for_holding() -> None:
    tree = draft_of("tower_and_box").tree()
    used = {node.id for definition in tree.definitions.values() for node in definition.root.walk() if node.id}
    assert used == {definition.id for definition in tree.subtrees}
    assert {node.id for d in tree.subtrees for node in d.root.walk() if node.id and not is_recovery(node)} == set()
    assert {i for i in used if not i.startswith("Recover_")} == {"Hold"}


@pytest.mark.parametrize("recovery", [NoRecovery(), recovery_of("towers")], ids=["none", "piles"])
def test_whatever_a_recovery_uses_it_defines(recovery: Recovery) -> None:
    subgoals = draft_of("towers").understood.groups[0].subgoals
    given = [recovery.before(s, ()) for s in subgoals] + [recovery.standing(s) for s in subgoals]
    given += [recovery.otherwise(s) for s in subgoals]
    all_of_them = [*recovery.definitions, *(definition for definition in given if definition)]
    used = {node.id for definition in all_of_them for node in definition.root.walk() if node.id}
    assert used <= {definition.id for definition in recovery.definitions}


def test_a_pile_is_lifted_from_its_top() -> None:
    covers = recovery_of("towers").covers
    for name in covers.obstacles.picks:
        heights = [float(covers.obstacles.ups[name] @ cover.position) for cover in covers.of(name)]
        assert heights == sorted(heights, reverse=True)
        assert len(heights) > len(covers.obstacles.picks)


def test_an_occupation_is_looked_for_wider_where_a_rehearsal_has_taught_so() -> None:
    recovery = recovery_of("board")
    target = next(t for t, p in recovery.obstacles.actions.placements.items() if isinstance(p, Place))
    other = recovery.occupations.of(target)[0].object
    wider = Occupations(recovery.obstacles, recovery.occupations.targets, frozenset({(target, other)}))
    (before, *rest), (after, *same) = recovery.occupations.of(target), wider.of(target)
    assert isinstance(before, ObjectAt)
    assert isinstance(after, ObjectRoughlyAt)
    assert after.radius > before.radius
    assert rest == same


@pytest.mark.parametrize(("name", "still"), [("kitting4", False), ("pyramid", False), ("tower_and_box", True)])
def test_what_was_just_checked_is_in_nobodys_way_unless_what_it_rests_on_may_be(name: str, still: bool) -> None:
    recovery, group = recovery_of(name), draft_of(name).understood.groups[0]
    last, done = group.subgoals[-1], [subgoal.target for subgoal in group.subgoals[:-1]]
    assert recovery.before(last, ()) is not None
    assert (recovery.before(last, done) is not None) == still
