"""Recovery is added to what was demonstrated and changes nothing of it; its SubTrees are the same for any number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from support_demonstrations import Put, repeated

from learner.inference.understanding import understand
from learner.learning import METHODS
from learner.model import Definition, ObjectShape, Place, Scene
from learner.model.tree import Node, is_recovery
from learner.parameters import Parameters
from learner.planning.draft import Draft
from learner.planning.relational import RelationalRecovery

NAMES = ["object_in_box", "towers", "tower_and_box", "board", "two_goals", "moving_reference", "kitting6", "hanoi"]


@cache
def draft_of(name: str) -> Draft:
    least = SCENARIOS[name].least
    demonstrations = sorted(demonstrated(SCENARIOS[name], least, 1000), key=lambda d: d.demonstration_id)
    return Draft(understand(demonstrations, Parameters().inference), Parameters().planning, {})


@pytest.mark.parametrize("name", NAMES)
def test_without_what_recovers_the_tree_is_the_nominal_one(name: str) -> None:
    tree, nominal = draft_of(name).tree(), draft_of(name).nominal_tree()
    assert tree.flattened(recovery=False) == nominal.flattened()
    assert tree.nodes_recovery > 0
    assert nominal.nodes_recovery == 0


@pytest.mark.parametrize("name", NAMES)
def test_the_tree_is_as_small_as_was_promised(name: str) -> None:
    tree = draft_of(name).tree()
    groups = draft_of(name).understood.groups
    count = len({target for group in groups for subgoal in group.subgoals for target in subgoal.targets()})
    assert tree.nodes_written <= 12 * count + 100
    assert tree.nodes_recovery <= 80 * count
    assert tree.nodes <= 12 * count + len(groups) + 1


def test_what_recovers_is_the_same_for_few_and_for_many() -> None:
    def shared(name: str) -> Mapping[str, Node]:
        found = draft_of(name).tree().subtrees
        return {definition.id: definition.root for definition in found if "_for_" not in definition.id}

    few, many = shared("tower_and_box"), shared("towers")
    assert {key: root for key, root in few.items() if key in many} == {k: r for k, r in many.items() if k in few}
    assert "Recover_Room" in few


def test_every_subtree_that_is_kept_is_used_and_only_recovers_but_for_holding() -> None:
    tree = draft_of("tower_and_box").tree()
    used = {node.id for definition in tree.definitions.values() for node in definition.root.walk() if node.id}
    assert used == {definition.id for definition in tree.subtrees}
    assert {node.id for d in tree.subtrees for node in d.root.walk() if node.id and not is_recovery(node)} == set()
    assert {i for i in used if not i.startswith("Recover_")} == {"Hold"}


def test_what_can_be_taken_has_grasps_in_the_order_in_which_they_are_tried() -> None:
    draft = draft_of("towers")
    grasps = [grasp.pose for grasp in draft.grasps if grasp.object == "A"]
    assert len(grasps) == 4
    assert grasps[0] == draft.actions.grasp_of(draft.actions.pick("A"))
    assert len({grasp.object for grasp in draft.grasps}) == len(SCENARIOS["towers"].objects)


def test_a_fixed_thing_is_never_put_aside() -> None:
    draft = draft_of("tower_and_box")
    demonstrations = [
        replace(d, scene=Scene({n: ObjectShape((0.05, 0.05, 0.05), "cube", fixed=n == "C") for n in d.objects}))
        for d in draft.understood.demonstrations
    ]
    fixed = Draft(understand(demonstrations, Parameters().inference), Parameters().planning, {})
    assert "C" not in {grasp.object for grasp in fixed.grasps}
    assert "D" in {grasp.object for grasp in fixed.grasps}


def test_without_a_scene_only_what_was_shown_upon_another_is_taken_off_in_words_of_vocabulary_1() -> None:
    script = [Put("A", "box", (0.2, 0.0, 0.0)), Put("B", "A", (0.0, 0.0, 0.05))]
    learned = METHODS["treewright"](repeated(["A", "B", "box"], [script] * 3), Parameters())
    assert learned.tree.vocabulary == 1
    assert learned.grasps == ()
    room = [definition for definition in learned.tree.subtrees if definition.id.startswith("Recover_Room_for_A")]
    assert [node.port("frame") for d in room for node in d.root.walk() if node.kind == "ObjectAt"][-1] == "A"


def test_a_place_upon_what_may_stand_upon_another_is_begun_with_that_on_the_table() -> None:
    recovery = draft_of("tower_and_box").recovery(draft_of("tower_and_box").actions)
    assert isinstance(recovery, RelationalRecovery)
    group = draft_of("tower_and_box").understood.groups[0]
    standing = {subgoal.target.frame: len(recovery.standing(subgoal)) for subgoal in group.subgoals}
    assert standing["box"] == 0
    assert 1 in standing.values()
    for subgoal in group.subgoals:
        placed = isinstance(draft_of("tower_and_box").placements[subgoal.target], Place)
        assert isinstance(recovery.before(subgoal, ()), Node if placed else Definition)
