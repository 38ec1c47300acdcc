"""The proof: sound trees pass, wrong ones are refused with the state that refutes them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.mutations import teeth
from experiments.proofs import failures
from experiments.scenarios import SCENARIOS

from learner.learned import Learned
from learner.learning import METHODS, learn
from learner.model import Definition, Drop, GripperIs, InGripper, Node, ObjectRoughlyAt, Pick, Place, SetGripper, Tree
from learner.model.tree import fallback, leaf, sequence
from learner.parameters import Parameters
from learner.proof.abstract_world import AbstractWorld
from learner.proof.parameters import ProofParameters
from learner.proof.prover import Keys, prove
from learner.relations.things import Things

LEVELS = 5
"""So many things upon one the planner takes down."""
DOWN = (1.0, 0.0, 0.0, 0.0)
ZERO = (0.0, 0.0, 0.0)
DROP = Drop("A", "box", (0.0, 0.0, 0.1), DOWN, ZERO)


def picked(name: str) -> Node:
    opened = fallback(leaf(GripperIs("open")), leaf(SetGripper("open")))
    return fallback(leaf(InGripper(name)), sequence(opened, leaf(Pick(name, name, ZERO, DOWN))))


def placed(name: str, frame: str) -> Node:
    place = Place(name, frame, (0.0, 0.0, 0.055), DOWN, (0.0, 0.0, 0.05), 0.024)
    return fallback(leaf(place.achieves), sequence(picked(name), leaf(place)))


def refuted(*children: Node) -> str | None:
    tree = Tree(Definition("t", sequence(*children)))
    return prove(tree, "base", np.random.default_rng(0), levels=LEVELS).counterexample


def test_a_sound_tree_reaches_its_goal_from_every_state() -> None:
    tree = Tree(Definition("t", sequence(fallback(leaf(DROP.achieves), sequence(picked("A"), leaf(DROP))))))
    certificate = prove(tree, "base", np.random.default_rng(0), levels=LEVELS)
    assert certificate.counterexample is None
    assert (certificate.exhaustive, certificate.states, certificate.bound) == (True, 5, 3)


def test_a_tree_that_never_picks_is_refuted_with_the_state_in_which_it_is_stuck() -> None:
    found = refuted(fallback(leaf(DROP.achieves), sequence(leaf(InGripper("A")), leaf(DROP))))
    assert found is not None
    assert "A away" in found


def test_two_goals_that_exclude_each_other_are_refuted_as_a_circle() -> None:
    elsewhere = ObjectRoughlyAt("A", "lid", ZERO)
    other = Drop("A", "lid", (0.0, 0.0, 0.1), DOWN, ZERO)
    found = refuted(
        fallback(leaf(DROP.achieves), sequence(picked("A"), leaf(DROP))),
        fallback(leaf(elsewhere), sequence(picked("A"), leaf(other))),
    )
    assert found is not None
    assert "never to the goal" in found


def test_a_tower_that_cannot_be_taken_down_is_refuted() -> None:
    """The published trees' failure: what is to be placed is covered by what comes after it."""
    found = refuted(placed("D", "E"), placed("F", "D"))
    assert found is not None
    assert "F at D" in found


def things_of(learned: Learned) -> Things:
    assert learned.draft is not None
    return learned.draft.things


def test_beyond_the_limit_a_seeded_sample_is_checked_and_the_certificate_says_so() -> None:
    scenario = SCENARIOS["tower_and_box"]
    learned = learn(demonstrated(scenario, scenario.least, 31))
    tree, things = learned.tree, things_of(learned)
    whole = prove(tree, "base", np.random.default_rng(0), levels=LEVELS, things=things)
    few = ProofParameters(exhaustive=100, sampled=50)
    rngs = [np.random.default_rng(0) for _ in range(2)]
    samples = [prove(tree, "base", rng, parameters=few, levels=LEVELS, things=things) for rng in rngs]
    assert samples[0] == samples[1]
    assert whole.bound is not None
    assert samples[0].bound is not None
    assert (samples[0].exhaustive, samples[0].states, samples[0].counterexample) == (False, 50, None)
    assert (whole.exhaustive, whole.states > 100, samples[0].bound <= whole.bound) == (True, True, True)


def test_a_sample_is_of_different_states_that_are_all_possible() -> None:
    scenario = SCENARIOS["towers"]
    learned = learn(demonstrated(scenario, scenario.least, 31))
    root, things = learned.tree.flattened(), things_of(learned)
    world = AbstractWorld("base", root, levels=LEVELS, things=things)
    whole, every = world.states(np.random.default_rng(0))
    numbers = ProofParameters(exhaustive=5000, sampled=1000)
    few = AbstractWorld("base", root, levels=LEVELS, parameters=numbers, things=things)
    some, rest = few.states(np.random.default_rng(0))
    keys = Keys(world)
    assert (every, rest) == (True, False)
    assert len(whole) > 5000
    assert len(np.unique(keys.of(some))) == len(some) == 1000
    assert np.isin(keys.of(some), keys.of(whole)).all()


@pytest.mark.parametrize(("names", "left_out"), [("ABCDEF", None), ("ABCDEFG", "piles of more than 6 objects")])
def test_the_certificate_says_which_piles_were_left_out(names: str, left_out: str | None) -> None:
    tower = [placed(upper, lower) for lower, upper in pairwise(names)]
    certificate = prove(Tree(Definition("t", sequence(*tower))), "base", np.random.default_rng(0), levels=LEVELS)
    assert certificate.left_out == left_out


@pytest.mark.parametrize("name", ["object_in_box", "tower_and_box", "hanoi", "two_goals", "kitting4"])
def test_learned_trees_are_proven(name: str) -> None:
    scenario = SCENARIOS[name]
    learned = learn(demonstrated(scenario, scenario.least, 31))
    assert learned.certificate is not None
    assert learned.certificate["counterexample"] is None
    assert learned.certificate["exhaustive"]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("name", ["object_in_box", "tower_and_box"])
def test_trees_of_too_few_demonstrations_for_a_frame_are_proven_too(name: str, count: int) -> None:
    """What was dropped has its place in the base then, which is no free spot."""
    learned = learn(demonstrated(SCENARIOS[name], count, 31))
    assert learned.certificate is not None
    assert learned.certificate["counterexample"] is None


@pytest.mark.parametrize("name", ["tower_and_box", "two_goals", "sorting"])
def test_a_tree_that_forgets_a_part_of_what_was_demonstrated_is_refuted(name: str) -> None:
    """It reaches what it calls its goal; but the draft knows better."""
    scenario = SCENARIOS[name]
    learned = METHODS["treewright"](demonstrated(scenario, scenario.least, 31), Parameters())
    assert learned.draft is not None
    main, rng, things = learned.tree.main, np.random.default_rng(0), things_of(learned)
    forgetful = Tree(replace(main, root=replace(main.root, children=main.root.children[:-1])), learned.tree.subtrees)
    goal = learned.draft.goal
    sound, own, wrong = (
        prove(tree, "base", rng, goal, at_once=False, levels=LEVELS, things=things).counterexample
        for tree, goal in ((learned.tree, goal), (forgetful, None), (forgetful, goal))
    )
    assert (sound, own) == (None, None)
    assert "it ends before the task is done" in str(wrong)


@pytest.mark.parametrize("name", ["object_in_box", "left_and_right", "placed_twice", "two_goals"])
def test_hardly_a_worse_tree_made_on_purpose_is_proven(name: str) -> None:
    scenario = SCENARIOS[name]
    learned = learn(demonstrated(scenario, scenario.least, 31))
    runs = failures(scenario, rounds=1, grasps=learned.grasps)
    found = teeth(learned.tree, "base", runs, things=things_of(learned))
    assert found.different >= 10
    assert found.caught >= 0.9 * found.different
    assert found.share >= 0.95
